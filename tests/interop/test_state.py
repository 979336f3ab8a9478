"""Timed knowledge, goals, metric and constraints of a unified_planning problem."""

from fractions import Fraction

import pytest
from unified_planning.shortcuts import (
    GT,
    Always,
    Equals,
    Exists,
    Forall,
    GlobalStartTiming,
    MaximizeExpressionOnFinalState,
    MinimizeExpressionOnFinalState,
    MinimizeMakespan,
    Not,
    Or,
    Plus,
    Sometime,
    SometimeBefore,
    Variable,
)

from kbstore.errors import InvalidKnowledge
from kbstore.interop.unified_planning import to_problem
from kbstore.messages import Condition, Expression, Function, Instance
from tests.interop.states import state


def test_timed_knowledge_is_relative_to_the_state():
    """P3: timed knowledge becomes timed effects, at its time less the state's."""
    problem = to_problem(state(timed={12.5: "(open)", 60: "(not (open))", 13: "(= (speed) 0.5)"}, at=10))
    effects = {timing: effect for timing, (effect,) in problem.timed_effects.items()}
    assert set(effects) == {GlobalStartTiming(Fraction(5, 2)), GlobalStartTiming(50), GlobalStartTiming(3)}
    assert effects[GlobalStartTiming(Fraction(5, 2))].value.is_true()
    assert effects[GlobalStartTiming(50)].value.is_false()
    assert effects[GlobalStartTiming(3)].value.constant_value() == Fraction(1, 2)


def test_runs_become_timed_effects_at_their_expected_ends():
    """O4: the end effects of runs are timed effects at the expected ends."""
    run = "(go kenny wp0 wp1)"
    problem = to_problem(state(ends=[(40, "(at kenny wp1)", run), (40, "(not (open))", run)], at=10))
    ((timing, effects),) = problem.timed_effects.items()
    assert timing == GlobalStartTiming(30)
    assert [str(effect) for effect in effects] == ["At(kenny, wp1) := true", "open := false"]


def test_a_function_moved_by_runs_is_constant_until_their_ends():
    """O3, O4: such a function has a constant value until their ends, where it has the values expected then."""
    ends = [(20, "(= (battery kenny) 70)", "(go)"), (30, "(= (battery kenny) 65)", "(shine)")]
    moving = state(init=["(= (battery kenny) 80)"], ends=ends)
    moving.functions[0] = moving.functions[0].changed(rate=-1.0)
    t, item, run = moving.end_effects[0]
    moving.end_effects[0] = t, item.changed(rate=-0.5), run
    problem = to_problem(moving)
    battery = problem.fluent("battery")(problem.object("kenny"))
    assert problem.initial_value(battery).constant_value() == 80
    assert [(timing.delay, str(effect)) for timing, (effect,) in problem.timed_effects.items()] == [
        (20, "battery(kenny) := 70"),
        (30, "battery(kenny) := 65"),
    ]
    moving.end_effects.reverse()
    with pytest.raises(InvalidKnowledge, match=r"moves by -1 per second"):
        to_problem(moving)


def test_the_last_of_several_effects_at_one_time_counts():
    """V1: of two effects on one fluent at one time, the later counts; an end effect comes after the schedule."""
    ends = [(5, "(= (speed) 2)", "(go)"), (5, "(= (speed) 3)", "(go)"), (5, "(not (open))", "(go)")]
    problem = to_problem(state(timed={5: "(open)"}, ends=ends))
    ((_, effects),) = problem.timed_effects.items()
    assert [str(effect) for effect in effects] == ["open := false", "speed := 3"]


def test_goals_of_every_form():
    """C10: facts, negative facts, comparisons, and conditions kept as PDDL."""
    goals = ["(visited wp0)", "(not (OPEN))", "(> (battery kenny) (+ (speed) 1))"]
    kept = "(or (open) (exists (?p - place) (at kenny ?p)))"
    problem = to_problem(state(goals=[*goals, Condition(text=kept)]))
    fluent, kenny = problem.fluent, problem.object("kenny")
    p = Variable("p", problem.user_type("place"))
    assert problem.goals == [
        fluent("visited")(problem.object("wp0")),
        Not(fluent("open")),
        GT(fluent("battery")(kenny), Plus(fluent("speed"), 1)),
        Or(fluent("open"), Exists(fluent("At")(kenny, p), p)),
    ]


def test_metrics():
    """The makespan, and the final value of an expression, minimized or maximized."""
    (makespan,) = to_problem(state(metric="minimize (total-time)")).quality_metrics
    assert makespan == MinimizeMakespan()
    problem = to_problem(state(metric="minimize (total-cost)"))
    assert problem.quality_metrics == [MinimizeExpressionOnFinalState(problem.fluent("total-cost")())]
    problem = to_problem(state(metric="maximize (+ (battery kenny) (speed))"))
    charge = Plus(problem.fluent("battery")(problem.object("kenny")), problem.fluent("speed"))
    assert problem.quality_metrics == [MaximizeExpressionOnFinalState(charge)]
    assert to_problem(state()).quality_metrics == []


@pytest.mark.parametrize("metric", ["maximize (total-time)", "minimize (+ (total-time) (speed))"])
def test_metrics_without_a_counterpart_are_refused(metric: str):
    """A part that the library cannot express is an error that names it."""
    with pytest.raises(InvalidKnowledge, match=r"the metric .*total-time"):
        to_problem(state(metric=metric))


def test_a_metric_that_counts_preferences_is_refused():
    """It is named beside the preference itself, and other refused parts."""
    with pytest.raises(InvalidKnowledge) as caught:
        to_problem(state(goals=[Condition(text="(preference a (open))")], metric="minimize (is-violated a)"))
    goal, metric = caught.value.violations
    assert "(preference a (open))" in goal
    assert "the metric minimize (is-violated a): (is-violated ...) counts preferences" in metric


def test_constraints():
    """PDDL 3.0: the trajectory constraints that the library can express."""
    constraints = [
        "(always (not (open)))",
        "(sometime-before (visited wp0) (visited wp1))",
        "(forall (?p - place) (sometime (visited ?p)))",
        "(and (always (open)) (sometime (= (speed) 2)))",
    ]
    problem = to_problem(state(constraints=constraints))
    is_open, visited = problem.fluent("open"), problem.fluent("visited")
    p = Variable("p", problem.user_type("place"))
    always, before, each, both = problem.trajectory_constraints
    assert always == Always(Not(is_open))
    assert before == SometimeBefore(visited(problem.object("wp0")), visited(problem.object("wp1")))
    assert each == Forall(Sometime(visited(p)), p)
    assert set(both.args) == {Always(is_open), Sometime(Equals(problem.fluent("speed"), 2))}


@pytest.mark.parametrize(
    "constraint",
    ["(within 10 (open))", "(preference soft (always (open)))", "(at end (open))", "(hold-after 3 (open))"],
)
def test_constraints_without_a_counterpart_are_refused(constraint: str):
    """A part that the library cannot express is an error that names it."""
    with pytest.raises(InvalidKnowledge) as caught:
        to_problem(state(constraints=[constraint]))
    assert constraint in str(caught.value)


def test_goals_without_a_counterpart_are_refused():
    """A preference among the goals has no counterpart without its weight."""
    with pytest.raises(InvalidKnowledge, match=r"the goal \(preference soft \(open\)\)"):
        to_problem(state(goals=[Condition(text="(preference soft (open))")]))


def test_moving_functions_are_refused():
    """C7: functions are constant in the initial state of a problem; one with a rate is named."""
    moving = state(init=["(= (speed) 1)", "(= (battery kenny) 80)"])
    moving.functions[1] = moving.functions[1].changed(rate=-0.5)
    with pytest.raises(InvalidKnowledge, match=r"\(= \(battery kenny\) 80\): it moves by -0\.5 per second"):
        to_problem(moving)
    scheduled = state(timed={5: "(= (speed) 1)"})
    scheduled.timed_knowledge[0] = scheduled.timed_knowledge[0].changed(rate=1.0)
    with pytest.raises(InvalidKnowledge, match="moves by 1 per second"):
        to_problem(scheduled)


def test_scheduled_objects_are_refused():
    """C9: the objects of a problem always exist; a scheduled one is named."""
    coming = state()
    coming.timed_knowledge = [
        Instance(instance_name="wp7", instance_type="place", initial_time=5),
        Instance(instance_name="wp0", is_negative=True, initial_time=7),
    ]
    with pytest.raises(InvalidKnowledge) as caught:
        to_problem(coming)
    assert [violation[:15] for violation in caught.value.violations] == ["wp7 - place at ", "(not (wp0)) at "][:2]


def test_a_metric_that_is_scheduled_is_refused():
    """C11: the metric of a problem does not change."""
    changing = state()
    changing.timed_knowledge = [Expression(optimization="minimize", initial_time=5)]
    with pytest.raises(InvalidKnowledge, match="the metric of a"):
        to_problem(changing)


def test_recorded_inequalities_are_left_out():
    """C11: a recorded inequality is a statement, without effect in a problem."""
    stated = state(timed={5: "(> (speed) 1)"})
    assert to_problem(stated).timed_effects == {}
    assert isinstance(state(init=["(= (speed) 1)"]).functions[0], Function)
