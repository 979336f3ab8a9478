"""Operators as actions of unified_planning, compared with actions built by hand through that library's interface."""

from collections import OrderedDict
from typing import Any

import pytest
from unified_planning.shortcuts import (
    GE,
    LT,
    And,
    ClosedTimeInterval,
    DurativeAction,
    EndTiming,
    Equals,
    Exists,
    Forall,
    Implies,
    InstantaneousAction,
    Minus,
    Not,
    OpenTimeInterval,
    Or,
    Plus,
    StartTiming,
    Times,
    Variable,
)
from unified_planning.shortcuts import Div as Divide

from kbstore.errors import InvalidKnowledge
from kbstore.interop.unified_planning import to_problem
from tests.interop.states import HEAD, state


def translate(act: str, **more: Any) -> tuple[Any, Any]:
    """The problem with one operator, and the operator's action."""
    problem = to_problem(state(act, **more))
    return problem, problem.actions[0]


def test_conditions_of_every_form():
    """Each form of condition becomes the library's own; conjunctions become several preconditions."""
    problem, found = translate(
        """(:action act :parameters (?m - mover ?p - place) :precondition (and (at ?m ?p) (and (not (open)))
          (or (visited ?p) (= ?p depot)) (imply (open) (path depot ?p)) (exists (?q - place) (path ?p ?q))
          (forall (?q - place) (path ?q ?p)) (>= (battery ?m) (+ (* 2 (dist ?p depot)) (- (speed)))) (< (speed) 2.5)
          (= (/ (speed) 2) (- (battery ?m) 1))) :effect (visited ?p))"""
    )
    fluent = problem.fluent
    expected = InstantaneousAction("act", OrderedDict(m=problem.user_type("mover"), p=problem.user_type("place")))
    m, p, depot = expected.parameter("m"), expected.parameter("p"), problem.object("Depot")
    q = Variable("q", problem.user_type("place"))
    expected.add_precondition(fluent("At")(m, p))
    expected.add_precondition(Not(fluent("open")))
    expected.add_precondition(Or(fluent("visited")(p), Equals(p, depot)))
    expected.add_precondition(Implies(fluent("open"), fluent("path")(depot, p)))
    expected.add_precondition(Exists(fluent("path")(p, q), q))
    expected.add_precondition(Forall(fluent("path")(q, p), q))
    needed = Plus(Times(2, fluent("dist")(p, depot)), Minus(0, fluent("speed")))
    expected.add_precondition(GE(fluent("battery")(m), needed))
    expected.add_precondition(LT(fluent("speed"), 2.5))
    expected.add_precondition(Equals(Divide(fluent("speed"), 2), Minus(fluent("battery")(m), 1)))
    expected.add_effect(fluent("visited")(p), True)
    assert found == expected
    assert len(found.preconditions) == 9


def test_effects_of_every_form():
    """Adds, deletes, every numeric operation, conditional and universal effects."""
    problem, found = translate(
        """(:action act :parameters (?m - mover ?p - place) :effect (and (at ?m ?p) (not (open))
          (assign (speed) 2) (increase (battery ?m) (speed)) (when (and (open) (visited ?p)) (not (visited ?p)))
          (forall (?q - place) (when (path ?p ?q) (and (visited ?q) (decrease (dist ?p ?q) 1))))
          (scale-up (total-cost) 3)))"""
    )
    fluent = problem.fluent
    expected = InstantaneousAction("act", OrderedDict(m=problem.user_type("mover"), p=problem.user_type("place")))
    m, p = expected.parameter("m"), expected.parameter("p")
    q = Variable("q", problem.user_type("place"))
    expected.add_effect(fluent("At")(m, p), True)
    expected.add_effect(fluent("open"), False)
    expected.add_effect(fluent("speed"), 2)
    expected.add_increase_effect(fluent("battery")(m), fluent("speed"))
    expected.add_effect(fluent("visited")(p), False, And(fluent("open"), fluent("visited")(p)))
    expected.add_effect(fluent("visited")(q), True, fluent("path")(p, q), [q])
    expected.add_decrease_effect(fluent("dist")(p, q), 1, fluent("path")(p, q), [q])
    expected.add_effect(fluent("total-cost"), Times(fluent("total-cost"), 3))
    assert found == expected


def test_the_times_of_a_durative_action():
    """Conditions and effects at start, over all and at end; a continuous effect lasts, and a loss is a decrease."""
    problem, found = translate(
        """(:durative-action act :parameters (?m - mover ?p - place) :duration (= ?duration (speed))
          :condition (and (at start (open)) (over all (at ?m ?p)) (at end (visited ?p)))
          :effect (and (at start (not (open))) (at end (open)) (at end (scale-down (battery ?m) 2))
            (increase (total-cost) (* #t (speed))) (decrease (dist ?p depot) (* #t 2))
            (decrease (battery ?m) (* #t (speed)))))"""
    )
    fluent, start, end = problem.fluent, StartTiming(), EndTiming()
    expected = DurativeAction("act", OrderedDict(m=problem.user_type("mover"), p=problem.user_type("place")))
    m, p = expected.parameter("m"), expected.parameter("p")
    expected.set_fixed_duration(fluent("speed"))
    expected.add_condition(start, fluent("open"))
    expected.add_condition(OpenTimeInterval(start, end), fluent("At")(m, p))
    expected.add_condition(end, fluent("visited")(p))
    expected.add_effect(start, fluent("open"), False)
    expected.add_effect(end, fluent("open"), True)
    expected.add_effect(end, fluent("battery")(m), Divide(fluent("battery")(m), 2))
    whole = ClosedTimeInterval(start, end)
    expected.add_increase_continuous_effect(whole, fluent("total-cost"), fluent("speed"))
    loss = found.continuous_effects[whole][1]
    assert loss.is_continuous_increase()
    assert loss.value.constant_value() == -2
    expected.add_increase_continuous_effect(whole, fluent("dist")(p, problem.object("Depot")), -2)
    expected.add_decrease_continuous_effect(whole, fluent("battery")(m), fluent("speed"))
    assert found == expected


@pytest.mark.parametrize(
    ("constraint", "lower", "upper", "opened"),
    [
        ("(= ?duration 5)", 5, 5, (False, False)),
        ("(and (>= ?duration 2) (<= ?duration 5))", 2, 5, (False, False)),
        ("(and (< ?duration 5) (> ?duration 2))", 2, 5, (True, True)),
        ("(<= ?duration 5)", 0, 5, (False, False)),
        ("(> ?duration 2)", 2, 4611686018, (True, False)),
        ("()", 0, 4611686018, (False, False)),
    ],
)
def test_duration_intervals(constraint: str, lower: int, upper: int, opened: tuple[bool, bool]):
    """A duration without a bound is bounded by 0 and by the greatest duration, 2**62 nanoseconds (T1)."""
    act = f"(:durative-action act :parameters () :duration {constraint} :condition () :effect (at end (open)))"
    duration = translate(act)[1].duration
    assert (duration.lower.constant_value(), duration.upper.constant_value()) == (lower, upper)
    assert (duration.is_left_open(), duration.is_right_open()) == opened


def test_a_fixed_duration_is_written_out():
    """``?duration`` has no counterpart; a fixed duration is written out where nothing changes it."""
    problem, found = translate(
        """(:durative-action act :parameters (?m - mover) :duration (= ?duration (* 2 (speed)))
          :condition (at start (>= (battery ?m) ?duration))
          :effect (and (at start (decrease (battery ?m) ?duration)) (at end (increase (total-cost) ?duration))))"""
    )
    twice = Times(2, problem.fluent("speed"))
    battery = problem.fluent("battery")(found.parameter("m"))
    ((condition,),) = found.conditions.values()
    assert condition == GE(battery, twice)
    assert found.effects[StartTiming()][0].value == twice
    assert found.effects[EndTiming()][0].value == twice


def test_a_fixed_duration_that_changes_is_known_at_the_start():
    """The functions of a fixed duration have their values at the start, also if they change later."""
    _, found = translate(
        """(:durative-action act :parameters () :duration (= ?duration (speed)) :condition ()
          :effect (and (at start (increase (total-cost) ?duration)) (at end (assign (speed) 1))))"""
    )
    assert str(found.effects[StartTiming()][0].value) == "speed"


def test_a_fixed_duration_that_is_scheduled_to_change_is_not_known_at_the_end():
    """Timed knowledge changes functions as operators do."""
    act = """(:durative-action act :parameters () :duration (= ?duration (speed)) :condition ()
      :effect (at end (increase (total-cost) ?duration)))"""
    translate(act)
    with pytest.raises(InvalidKnowledge, match=r"\?duration"):
        translate(act, timed={5: "(= (speed) 1)"})


def test_effects_nest():
    """All the conditions and all the variables around an effect belong to it."""
    problem, found = translate(
        """(:action act :parameters () :effect (forall (?p - place) (when (visited ?p)
          (forall (?q - place) (when (path ?p ?q) (not (path ?q ?p)))))))"""
    )
    p, q = (Variable(name, problem.user_type("place")) for name in "pq")
    (effect,) = found.effects
    path = problem.fluent("path")
    assert effect.condition == And(problem.fluent("visited")(p), path(p, q))
    assert effect.forall == (p, q)
    assert (effect.fluent, effect.value.is_false()) == (path(q, p), True)


def test_parameters_of_an_either_type_are_narrowed():
    """D1: a parameter gets the common supertype, and a condition that it is one of the objects of either type."""
    problem, found = translate(
        "(:action act :parameters (?m - (either robot truck)) :effect (open))",
    )
    assert found.parameter("m").type == problem.user_type("mover")
    robot, truck = (Variable("same", problem.user_type(name)) for name in ("Robot", "truck"))
    m = found.parameter("m")
    assert found.preconditions == [Or(Exists(Equals(robot, m), robot), Exists(Equals(truck, m), truck))]


def test_quantifiers_over_an_either_type_are_spelled_out():
    """V4: some object of either type is some of the one or some of the other; all are all of both."""
    problem, found = translate(
        """(:action act :parameters () :precondition (and (exists (?x - (either robot truck)) (at ?x depot))
          (forall (?x - (either robot truck)) (at ?x depot)))
          :effect (forall (?x - (either robot truck)) (at ?x depot)))"""
    )
    robot, truck = (Variable("x", problem.user_type(name)) for name in ("Robot", "truck"))
    here = [problem.fluent("At")(x, problem.object("Depot")) for x in (robot, truck)]
    assert found.preconditions == [
        Or(Exists(here[0], robot), Exists(here[1], truck)),
        And(Forall(here[0], robot), Forall(here[1], truck)),
    ]
    assert [(effect.fluent, effect.forall) for effect in found.effects] == [(here[0], (robot,)), (here[1], (truck,))]


def test_variables_that_hide_others_are_renamed():
    """An inner variable with a name that is in use is renamed."""
    problem, found = translate(
        """(:action act :parameters (?p - place) :precondition (exists (?p - place) (visited ?p))
          :effect (forall (?p - place) (when (open) (forall (?p - mover) (at ?p depot)))))"""
    )
    p2 = Variable("p_2", problem.user_type("place"))
    assert found.preconditions == [Exists(problem.fluent("visited")(p2), p2)]
    p3 = Variable("p_3", problem.user_type("mover"))
    (effect,) = found.effects
    assert (effect.fluent, effect.forall) == (problem.fluent("At")(p3, problem.object("Depot")), (p3,))


@pytest.mark.parametrize(
    ("act", "named"),
    [
        ("(:action act :parameters () :precondition (preference soft (open)) :effect (open))", "preference soft"),
        ("(:action act :parameters () :precondition (near depot) :effect (open))", "near"),
        (
            "(:durative-action act :parameters () :duration (<= ?duration 5) :condition ()"
            " :effect (at end (increase (speed) ?duration)))",
            r"\?duration",
        ),
        (
            "(:durative-action act :parameters () :duration (= ?duration (speed)) :condition ()"
            " :effect (and (at start (assign (speed) 1)) (at end (increase (total-cost) ?duration))))",
            r"\?duration",
        ),
        (
            "(:durative-action act :parameters () :duration (at end (<= ?duration (speed))) :condition ()"
            " :effect (at end (open)))",
            "at end",
        ),
        (
            "(:durative-action act :parameters () :duration (and (<= ?duration 5) (<= ?duration (speed)))"
            " :condition () :effect (at end (open)))",
            "several bounds",
        ),
        (
            "(:durative-action act :parameters () :duration (<= ?duration 5) :condition ()"
            " :effect (forall (?m - mover) (increase (battery ?m) (* #t 1))))",
            r"\(increase \(battery \?m\)",
        ),
        (
            "(:durative-action act :parameters () :duration (<= ?duration 5) :condition ()"
            " :effect (forall (?p - place) (when (at start (visited ?p)) (at end (assign (speed) 1)))))",
            r"\(when \(at start \(visited \?p\)\) \(assign \(speed\) 1\)\) has no counterpart.*effect's own moment",
        ),
        ("(:action act :parameters () :effect (and (assign (speed) 1) (assign (speed) 2)))", "conflict"),
    ],
)
def test_parts_without_a_counterpart_are_refused(act: str, named: str):
    """A part that the library cannot express is an error that names the operator and the part."""
    rule = "(:derived (near ?p - place) (exists (?q - place) (path ?p ?q)))"
    head = HEAD.replace("(open)", "(open) (near ?p - place)")
    with pytest.raises(InvalidKnowledge, match=named) as caught:
        to_problem(state(rule + act, head=head))
    assert all("the operator act" in violation for violation in caught.value.violations)


def test_all_refused_parts_are_reported_together():
    """One error names all parts without a counterpart."""
    soft = "(:action {} :parameters () :precondition (preference soft (open)) :effect (open))"
    with pytest.raises(InvalidKnowledge) as caught:
        to_problem(state(soft.format("one") + soft.format("two"), init=[], metric="minimize (+ (total-time) 1)"))
    one, two, metric = caught.value.violations
    assert "the operator one" in one
    assert "the operator two" in two
    assert "(total-time)" in metric
