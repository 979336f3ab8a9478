"""Rule O8: effects on sensed symbols are not written, but expected."""

import pytest

import kbstore
from kbstore import Truth, seconds
from tests.conftest import START

HALL = """
(define (domain hall)
  (:predicates (door_open) (inside) (lit) (moving))
  (:functions (position) (speed) (count))
  (:durative-action enter :parameters () :duration (= ?duration 10)
    :condition (over all (moving))
    :effect (and (at start (moving)) (at start (not (lit))) (at end (inside)) (at end (assign (count) 7))
                 (increase (position) (* #t (speed)))))
  (:action shut :parameters () :effect (and (not (door_open)) (increase (count) 1))))
"""


@pytest.fixture
def hall(open_kb):
    kb = open_kb()
    kb.load(HALL)
    kb.add("(door_open)", "(lit)", "(= (position) 0)", "(= (speed) 2)", "(= (count) 0)")
    return kb


def at(clock, t):
    clock.set(START + seconds(t))


def test_effects_on_sensed_symbols_are_not_written(hall, clock):
    """O8: at start, at end, and of instantaneous actions; a sensor reports them."""
    for name in ("moving", "lit", "inside", "count", "door_open"):
        hall.set_sensed(name, True)
    run = hall.start("enter")
    assert hall.holds("(and (lit) (not (moving)))")
    at(clock, 10)
    hall.end(run)
    hall.apply("shut")
    assert hall.holds("(and (lit) (not (moving)) (not (inside)) (door_open))")
    assert hall.value("(count)") == 0


HEATERS = """
(define (domain heaters)
  (:types heater)
  (:predicates (on ?h - heater) (linked ?h - heater))
  (:functions (level))
  (:durative-action warm :parameters (?h - heater) :duration (= ?duration 10)
    :condition (and (over all (on ?h)) (over all (>= (level) 5)) (over all (exists (?x - heater) (on ?x))))
    :effect (and (forall (?x - heater) (when (at start (linked ?x)) (at start (on ?x))))
                 (at start (increase (level) 4)))))
"""


@pytest.mark.parametrize("use_unknowns", [False, True])
def test_every_unwritten_effect_counts_for_invariants(open_kb, clock, use_unknowns):
    """O8: conditional ones as decided before the start, those in forall, and numbers; each until it is reported."""
    kb = open_kb(use_unknowns=use_unknowns)
    kb.load(HEATERS)
    kb.add("a - heater", "b - heater", "(linked a)", "(= (level) 3)")
    for name in ("on", "level"):
        kb.set_sensed(name, True)
    with pytest.raises(kbstore.NotApplicable):
        kb.start("warm", "b")
    run = kb.start("warm", "a")
    kb.remove("(linked a)")
    at(clock, 4)
    assert kb.broken(run) == []
    kb.add("(= (level) 4)")
    at(clock, 6)
    kb.add("(= (level) 6)", "(on b)", "(not (on a))")
    assert [(b.condition, b.since, b.until) for b in kb.broken(run)] == [
        ("(>= (level) 5)", START + seconds(4), START + seconds(6)),
        ("(on a)", START + seconds(6), None),
    ]


def test_an_unreported_effect_does_not_start_a_rate(open_kb, clock):
    """O8, O5: a rate whose condition only an unwritten effect makes true does not act, nor is it refused."""
    kb = open_kb()
    kb.load("""
      (define (domain d) (:predicates (open)) (:functions (level) (inflow))
        (:durative-action leak :parameters () :duration (= ?duration 10) :condition (over all (>= (level) 0))
          :effect (and (at start (open)) (when (over all (open)) (increase (level) (* #t (inflow)))))))
    """)
    kb.set_sensed("open", True)
    kb.add("(= (level) 1)", "(= (inflow) 1)", "(increase (inflow) (* #t 1))")
    kb.start("leak")
    assert kb.value("(level)", at=START + seconds(5)) == 1
    at(clock, 5)
    with pytest.raises(kbstore.NotLinear):
        kb.add("(open)")
    kb.add("(= (inflow) 2)")
    kb.add("(open)")
    assert kb.value("(level)", at=START + seconds(7)) == 5


def test_a_continuous_effect_on_a_sensed_function_does_not_move_it(hall, clock):
    """O8: a question about a time after now computes it as if it did."""
    hall.set_sensed("position", True)
    run = hall.start("enter")
    assert [hall.value("(position)", at=START + seconds(t)) for t in (0, 3, 10, 20)] == [0, 6, 20, 20]
    at(clock, 4)
    assert hall.value("(position)") == 0
    hall.add("(= (position) 7)")
    assert [hall.value("(position)", at=START + seconds(t)) for t in (4, 6, 10, 20)] == [7, 11, 19, 19]
    at(clock, 10)
    hall.end(run)
    assert [hall.value("(position)", at=START + seconds(t)) for t in (3, 4, 10, 20)] == [0, 7, 7, 7]


def test_at_end_effects_on_sensed_symbols_are_expected(hall, clock):
    """O8: as long as the end is ahead."""
    hall.set_sensed("inside", True)
    hall.start("enter")
    assert hall.holds("(inside)", at=START + seconds(10))
    at(clock, 11)
    assert not hall.holds("(inside)")


def test_an_invariant_that_an_unwritten_effect_makes_true_counts_as_true(hall, clock):
    """O8: until the next assertion on its timeline."""
    hall.set_sensed("moving", True)
    run = hall.start("enter")
    at(clock, 2)
    assert not hall.holds("(moving)")
    assert hall.broken(run) == []
    hall.add("(not (moving))")
    at(clock, 3)
    hall.add("(moving)")
    at(clock, 10)
    assert [(b.condition, b.truth, b.since, b.until) for b in hall.end(run).broken] == [
        ("(moving)", Truth.FALSE, START + seconds(2), START + seconds(3))
    ]
