"""Runs that another program carries out: their starts and ends are recorded, and nothing is evaluated."""

import pytest

from kbstore.clock import seconds
from kbstore.errors import InvalidKnowledge, NotApplicable

DOMAIN = """
(define (domain moving)
  (:types robot place)
  (:predicates (at ?r - robot ?p - place))
  (:functions (battery ?r - robot))
  (:durative-action go
    :parameters (?r - robot ?from ?to - place)
    :duration (= ?duration 10)
    :condition (at start (at ?r ?from))
    :effect (and (at start (not (at ?r ?from))) (at end (at ?r ?to)) (at end (decrease (battery ?r) 1))))
  (:durative-action rest
    :parameters (?r - robot)
    :duration (= ?duration (battery ?r))
    :condition ()
    :effect ())
  (:action blink :parameters (?r - robot ?p - place) :precondition (at ?r ?p) :effect (not (at ?r ?p))))
"""


@pytest.fixture
def moving(bare):
    bare.load(DOMAIN)
    bare.add("kenny - robot", "a - place", "b - place", "(at kenny b)")
    return bare


def test_a_reported_run_changes_nothing_else(moving, clock):
    """Neither the conditions, which fail here, nor the effects are evaluated; the battery is undefined."""
    with moving.transaction() as tx:
        run = tx.report_start("go", "kenny", "a", "b")
    clock.advance(seconds(10))
    with moving.transaction() as tx:
        tx.report_end(run)
    (found,) = moving.runs()
    assert (found.started, found.duration, found.ended, found.outcome) == (
        run.started,
        seconds(10),
        run.started + seconds(10),
        "ended",
    )
    assert [*map(str, moving.propositions())] == ["(at kenny b)"]


def test_the_duration_of_a_reported_run(moving):
    """It is the given one, else the one that the domain fixes, else 0."""
    with moving.transaction() as tx:
        given = tx.report_start("go", "kenny", "a", "b", duration=seconds(7))
        unknown = tx.report_start("rest", "kenny")
    assert (given.duration, unknown.duration) == (seconds(7), 0)


def test_a_reported_run_runs_once(moving):
    """O3: a run cannot start a second time, nor end where it is not running."""
    with moving.transaction() as tx:
        run = tx.report_start("go", "kenny", "a", "b")
    with moving.transaction() as tx, pytest.raises(NotApplicable, match="runs already"):
        tx.report_start("GO", "Kenny", "a", "b")
    with moving.transaction() as tx:
        tx.report_end(run)
    with moving.transaction() as tx, pytest.raises(NotApplicable, match="does not run"):
        tx.report_end(run)


def test_an_instantaneous_action_can_be_reported(moving):
    """The program that carries it out needs time for it, so it is a run."""
    with moving.transaction() as tx:
        run = tx.report_start("blink", "kenny", "a", duration=seconds(1))
    assert moving.state().running == [run]
    with moving.transaction() as tx:
        tx.report_end(run)
    assert [found.outcome for found in moving.runs()] == ["ended"]


def test_the_objects_of_a_reported_run_must_exist(moving):
    """A run names objects of the types of its operator (D1)."""
    with moving.transaction() as tx, pytest.raises(InvalidKnowledge, match="nowhere"):
        tx.report_start("go", "kenny", "a", "nowhere")
