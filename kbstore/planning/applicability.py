"""Whether an operator can be applied (rule O1), and how long it takes (rule O3)."""

from collections.abc import Iterable, Iterator
from fractions import Fraction

from kbstore.clock import SECOND, TIME_LIMIT
from kbstore.errors import InvalidKnowledge
from kbstore.evaluation import expressions
from kbstore.evaluation.evaluator import Evaluation
from kbstore.evaluation.interpretation import Interpretation
from kbstore.messages import ComparisonType, SpecialType, Truth
from kbstore.model.expressions import NumericExpression
from kbstore.model.formulas import Comparison, Formula, Timing
from kbstore.pddl.printer import condition_text
from kbstore.planning import effects, start_conditions
from kbstore.planning.effects import Effects
from kbstore.planning.grounding import GroundAction, ground, with_objects

__all__ = ["Failing", "GroundAction", "failing", "fixed_duration", "ground", "unsatisfied"]

Failing = tuple[Formula, Truth]
"""A condition that fails, and what it is where it was asked for: false, or unknown."""


def failing(
    ground: GroundAction, timing: Timing, world: Interpretation, *, duration: float | None = None
) -> list[Failing]:
    """The conditions of a moment that are not true in the world.

    Conjunctions are split, and parameters replaced by objects, so that each condition says what is missing.
    `duration`, in seconds, is the value of ``?duration``.
    """
    judged = _judged(ground.conditions(timing), world, duration)
    return [(condition, truth) for condition, truth in judged if truth is not Truth.TRUE]


def _judged(conditions: Iterable[Formula], world: Interpretation, duration: float | None) -> list[Failing]:
    evaluation = Evaluation(world, duration=duration)
    return [(condition, evaluation.truth(condition)) for condition in conditions]


def unsatisfied(
    ground: GroundAction,
    world: Interpretation,
    *,
    duration: float | None = None,
    at_start: Effects | None = None,
) -> list[Failing]:
    """Everything that keeps an operator from being applied or started in the world; empty if it can be (rule O1).

    The at-start conditions are evaluated on the world, the over-all conditions on the world after the at-start
    effects. A number that the duration or an effect needs and that is not there is among what fails, as ``Defined``
    (or as ``(not (= divisor 0))``). `duration`, in seconds, is what the domain fixes unless it is given. A caller that
    has seen the at-start conditions hold passes on the effects `at_start` that it evaluated then.

    Raises `InvalidKnowledge` where no condition fails, but the effects conflict with each other or overflow.
    """
    missing = _judged(_unbounded(ground, world), world, duration)
    if missing and duration is None:
        return missing + _failing_without_duration(ground, world)
    if duration is None:
        fixed = fixed_duration(ground, world)
        duration = None if fixed is None else fixed / SECOND
    found = missing
    if at_start is None:
        found += failing(ground, Timing.AT_START, world, duration=duration)
    try:
        if at_start is None:
            lacking = effects.lacking(ground, Timing.AT_START, world, duration=duration)
            if lacking:
                return found + _judged(lacking, world, duration)
            at_start = effects.evaluate(ground, Timing.AT_START, world, duration=duration)
        after = effects.StateAfter(world, at_start)
        found += failing(ground, Timing.OVER_ALL, after, duration=duration)
        before = start_conditions.remembered(ground, Timing.OVER_ALL, world, duration=duration)
        needed = effects.lacking(ground, Timing.OVER_ALL, after, duration=duration, remembered=before)
        found += _judged(needed, after, duration)
    except InvalidKnowledge:
        # effects may conflict just where a condition forbids them, for instance a swap of a thing with itself
        if not found:
            raise
    return found


def fixed_duration(ground: GroundAction, world: Interpretation) -> int | None:
    """The duration that the domain fixes with ``(= ?duration ...)``, to the nearest nanosecond; None if it does not.

    Raises `UndefinedFunction` or `DivisionByZero` where it cannot be evaluated, and `InvalidKnowledge` where it is
    negative or beyond the range of times.
    """
    for comparison, bound in _bounds(ground):
        if comparison is ComparisonType.EQUALS:
            seconds = expressions.evaluate(bound, world)
            if not 0 <= _nanoseconds(seconds) < TIME_LIMIT:
                raise InvalidKnowledge(
                    f"{ground} would take {seconds} s by {_text(comparison, bound)}; a duration is at least 0 and"
                    " below 2**62 nanoseconds"
                )
            return _nanoseconds(seconds)
    return None


def _unbounded(ground: GroundAction, world: Interpretation) -> list[Formula]:
    """Why the bounds of the duration have no value, or why the fixed one is no duration."""
    missing: list[Formula] = []
    for comparison, bound in _bounds(ground):
        reasons = effects.without_value(bound, world)
        if not reasons and comparison is ComparisonType.EQUALS and expressions.evaluate(bound, world) < 0:
            reasons.append(Comparison(ComparisonType.GREATEREQ, bound, (0.0,)))
        missing += reasons
    return missing


def _failing_without_duration(ground: GroundAction, world: Interpretation) -> list[Failing]:
    """The at-start conditions that are not true where the fixed duration cannot be had."""
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


def _bounds(ground: GroundAction) -> Iterator[tuple[ComparisonType, NumericExpression]]:
    """The constraints on ``?duration`` at the start, with the objects in their places."""
    for constraint in ground.action.duration:
        if constraint.timing is Timing.AT_START:
            yield constraint.comparison, with_objects(constraint.bound, ground.spellings)


def _nanoseconds(seconds: float) -> int:
    return round(Fraction(seconds) * SECOND)


def _text(comparison: ComparisonType, bound: NumericExpression) -> str:
    return condition_text(Comparison(comparison, (SpecialType.DURATION,), bound))
