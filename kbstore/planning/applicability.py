"""Applicability of operators (rules O1, O7)."""

from collections.abc import Iterable

from kbstore.errors import InvalidKnowledge
from kbstore.evaluation.evaluator import Evaluation
from kbstore.evaluation.interpretation import Interpretation
from kbstore.messages import Truth
from kbstore.model.formulas import Formula, Timing
from kbstore.planning import durations, effects, start_conditions
from kbstore.planning.durations import Failing
from kbstore.planning.effects import Effects
from kbstore.planning.grounding import GroundAction


def failing(
    ground: GroundAction, timing: Timing, world: Interpretation, *, duration: float | None = None
) -> list[Failing]:
    """Return the conditions of a part of an action that are not true in the world.

    Conjunctions are split, and parameters replaced by objects, so that each condition names what is missing.
    `duration`, in seconds, is the value of ``?duration``.
    """
    pairs = judged(ground.conditions(timing), world, duration)
    return [(condition, truth) for condition, truth in pairs if truth is not Truth.TRUE]


def judged(conditions: Iterable[Formula], world: Interpretation, duration: float | None = None) -> list[Failing]:
    """Return conditions with their truth values in the world."""
    evaluation = Evaluation(world, duration=duration)
    return [(condition, evaluation.truth(condition)) for condition in conditions]


def unsatisfied(
    ground: GroundAction,
    world: Interpretation,
    *,
    duration: float | None = None,
    at_start: Effects | None = None,
    force: bool = False,
) -> list[Failing]:
    """Return the conditions that keep an operator from being applied or started in the world (rule O1).

    The duration's constraints and the at-start conditions are evaluated on the world, the over-all conditions on the
    world after the at-start effects. A missing number that the duration or an effect needs fails as ``Defined`` (or as
    ``(not (= divisor 0))``). `duration`, in seconds, is the one that the domain fixes unless it is given; with `force`
    its constraints don't count. A caller that has seen the at-start conditions hold passes on the effects `at_start`
    that it evaluated then.

    Raises `InvalidKnowledge` where no condition fails, but the effects conflict with each other or overflow.
    """
    if duration is not None:
        found = [] if force else durations.failing_constraints(ground, Timing.AT_START, world, duration)
    else:
        found = judged(durations.without_value(ground, world), world)
        if found:
            return found + _failing_without_duration(ground, world)
        fixed = durations.fixed_duration(ground, world)
        if fixed is not None:
            duration = fixed.seconds
            found = durations.failing_constraints(ground, Timing.AT_START, world, duration)
    if at_start is None:
        found += failing(ground, Timing.AT_START, world, duration=duration)
    try:
        if at_start is None:
            lacking = effects.lacking(ground, Timing.AT_START, world, duration=duration)
            if lacking:
                return found + judged(lacking, world, duration)
            at_start = effects.evaluate(ground, Timing.AT_START, world, duration=duration)
        after = effects.StateAfter(world, at_start)
        found += failing(ground, Timing.OVER_ALL, after, duration=duration)
        before = start_conditions.remembered(ground, Timing.OVER_ALL, world, duration=duration)
        needed = effects.lacking(ground, Timing.OVER_ALL, after, duration=duration, remembered=before)
        found += judged(needed, after, duration)
    except InvalidKnowledge:
        # effects may conflict where a condition forbids them anyway, for instance a swap of a thing with itself
        if not found:
            raise
    return found


def _failing_without_duration(ground: GroundAction, world: Interpretation) -> list[Failing]:
    """Return the at-start conditions that are not true, where the fixed duration has no value."""
    evaluation = Evaluation(world)
    found: list[Failing] = []
    for condition in ground.conditions(Timing.AT_START):
        try:
            truth = evaluation.truth(condition)
        except InvalidKnowledge:  # it reads ?duration
            truth = Truth.UNKNOWN
        if truth is not Truth.TRUE:
            found.append((condition, truth))
    return found
