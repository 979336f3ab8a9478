"""Problems compared with those that unified_planning itself reads from the same PDDL."""

from typing import Any

import pytest
from unified_planning.io import PDDLReader
from unified_planning.shortcuts import And

from kbstore.interop.unified_planning import to_problem
from tests.interop.states import HEAD, state

ACTIONS = """
(:action look :parameters (?m - mover ?p - place)
  :precondition (and (at ?m ?p) (not (open)) (or (visited ?p) (= ?p depot)) (imply (open) (path depot ?p))
    (exists (?q - place) (path ?p ?q)) (forall (?q - place) (path ?q ?p)) (>= (battery ?m) (+ (* 2 (dist ?p depot)) 3)))
  :effect (and (at ?m ?p) (not (open)) (assign (speed) 2) (increase (battery ?m) (speed))
    (when (and (open) (visited ?p)) (not (visited ?p))) (forall (?q - place) (when (path ?p ?q) (visited ?q)))))
(:durative-action go :parameters (?m - robot ?a ?b - place)
  :duration (and (>= ?duration 1) (<= ?duration (/ (dist ?a ?b) (speed))))
  :condition (and (at start (at ?m ?a)) (at start (open)) (over all (>= (battery ?m) 0)) (at end (path ?a ?b)))
  :effect (and (at start (not (at ?m ?a))) (at end (at ?m ?b)) (at end (visited ?b)) (increase (battery ?m) (* #t 2))))
"""
INIT = ["(at kenny wp0)", "(= (dist wp0 wp1) 10)", "(= (speed) 2.5)", "(= (battery kenny) 0.1)", "(open)"]
GOALS = ["(visited wp1)", "(> (battery kenny) 3)", "(not (open))"]
PROBLEM = f"""
(define (problem kenny) (:domain robots) (:objects kenny - robot wp0 wp1 - place)
  (:init {" ".join(INIT)} (at 5 (not (open))) (at 7.5 (open)))
  (:goal (and {" ".join(GOALS)})) (:metric minimize (total-time)))
"""


@pytest.fixture(scope="module")
def problems() -> tuple[Any, Any]:
    """The problem as made here, and as read there; in lower case, as the library's reader does not keep the case."""
    given = state(
        ACTIONS,
        head=HEAD.lower(),
        init=INIT,
        goals=GOALS,
        metric="minimize (total-time)",
        timed={5: "(not (open))", 7.5: "(open)"},
    )
    return to_problem(given), PDDLReader().parse_problem_string(f"{HEAD.lower()} {ACTIONS})", PROBLEM)


@pytest.mark.filterwarnings("ignore")  # the library's reader uses old names of pyparsing
@pytest.mark.parametrize("part", ["user_types", "fluents", "all_objects", "initial_values", "quality_metrics"])
def test_each_part_is_as_the_library_reads_it(problems: tuple[Any, Any], part: str):
    """P2: the problem is that of the PDDL text."""
    ours, theirs = (getattr(problem, part) for problem in problems)
    assert ours == theirs


@pytest.mark.filterwarnings("ignore")
def test_actions_and_goals_are_as_the_library_reads_them(problems: tuple[Any, Any]):
    """P2: the same actions and goals; conjunctions, which are kept whole there, are split here."""
    ours, theirs = problems
    assert ours.action("go") == theirs.action("go")
    assert ours.action("look").effects == theirs.action("look").effects
    assert And(ours.action("look").preconditions) == And(theirs.action("look").preconditions)
    assert And(ours.goals) == And(theirs.goals)


@pytest.mark.filterwarnings("ignore")
def test_timed_effects_are_as_the_library_reads_them(problems: tuple[Any, Any]):
    """P3: the same effects after the same delays, which count from the start of the plan."""
    ours, theirs = ({t.delay: effects for t, effects in problem.timed_effects.items()} for problem in problems)
    assert ours == theirs
    assert all(timing.is_global() for timing in problems[0].timed_effects)
