"""Durations of actions: the domain's constraints on ``?duration`` (rules O3, O7)."""

from collections.abc import Iterator
from fractions import Fraction
from math import isfinite
from typing import NamedTuple

from kbstore import clock
from kbstore.clock import SECOND, TIME_LIMIT
from kbstore.errors import DivisionByZero, InvalidKnowledge, InvalidTime, UndefinedFunction
from kbstore.evaluation import expressions
from kbstore.evaluation.interpretation import Interpretation
from kbstore.evaluation.substitution import instantiated_expression
from kbstore.messages import ComparisonType, SpecialType, Truth
from kbstore.model.expressions import NumericExpression
from kbstore.model.formulas import Comparison, Formula, Timing
from kbstore.pddl.printer import condition_text
from kbstore.planning import effects
from kbstore.planning.grounding import GroundAction

MILLISECOND = 1_000_000

Failing = tuple[Formula, Truth]
"""A condition that fails, and its truth value where it was evaluated: false, or unknown."""


class Duration(NamedTuple):
    """A duration: exactly in seconds, the value of ``?duration``, and rounded to nanoseconds, for the expected end."""

    seconds: float
    nanoseconds: int


def given_duration(given: clock.DurationLike) -> int:
    """Return a caller's duration (an int of nanoseconds, a `timedelta` or a stamp) in nanoseconds.

    Raises `InvalidTime` for anything else, and for a bare number below a millisecond, which is meant as seconds.
    """
    if type(given) is int and 0 < given < MILLISECOND:
        raise InvalidTime(
            f"the duration {given} is in nanoseconds, less than a millisecond; write kbstore.seconds({given}) for "
            f"{given} s, or a timedelta"
        )
    return clock.duration(given)


def fixed_duration(ground: GroundAction, world: Interpretation) -> Duration | None:
    """Return the duration that the domain fixes with ``(= ?duration ...)``; None if it does not.

    Raises `UndefinedFunction` or `DivisionByZero` where it cannot be evaluated, and `InvalidKnowledge` where it is
    negative or beyond the range of times.
    """
    for comparison, bound in _constraints(ground, Timing.AT_START):
        if comparison is ComparisonType.EQUALS:
            seconds = expressions.evaluate(bound, world)
            if not isfinite(seconds) or not 0 <= _nanoseconds(seconds) < TIME_LIMIT:
                raise InvalidKnowledge(
                    f"{ground} would take {seconds} s by {condition_text(_constraint(comparison, bound))}; a duration "
                    "is at least 0 and below 2**62 nanoseconds"
                )
            return Duration(seconds, _nanoseconds(seconds))
    return None


def chosen_duration(ground: GroundAction, world: Interpretation, given: int | None) -> Duration:
    """Return the duration of an action that starts: the one that the domain fixes, or the one `given`, in nanoseconds.

    If both agree to a nanosecond, it is the fixed one (rule O7). Raises `InvalidKnowledge` if there is neither, and
    as `fixed_duration` does.
    """
    if given is None:
        fixed = fixed_duration(ground, world)
        if fixed is None:
            raise InvalidKnowledge(
                f"{ground}: the domain does not fix its duration; give one, as: duration=kbstore.seconds(30)"
            )
        return fixed
    try:
        fixed = fixed_duration(ground, world)
    except (UndefinedFunction, DivisionByZero, InvalidKnowledge):
        fixed = None
    if fixed is not None and abs(given - Fraction(fixed.seconds) * SECOND) <= 1:
        return fixed
    return Duration(given / SECOND, given)


def failing_constraints(ground: GroundAction, timing: Timing, world: Interpretation, duration: float) -> list[Failing]:
    """Return the constraints of a part of an action that do not allow a duration, in seconds, or are unknown (rule O7).

    A duration may be off by a nanosecond.
    """
    found: list[Failing] = []
    for comparison, bound in _constraints(ground, timing):
        try:
            truth = _allows(comparison, expressions.evaluate(bound, world), duration)
        except (UndefinedFunction, DivisionByZero):
            truth = Truth.UNKNOWN
        if truth is not Truth.TRUE:
            found.append((_constraint(comparison, bound), truth))
    return found


def without_value(ground: GroundAction, world: Interpretation) -> list[Formula]:
    """Return why constraints at the start have no value, or the fixed duration is negative, as conditions that fail."""
    missing: list[Formula] = []
    for comparison, bound in _constraints(ground, Timing.AT_START):
        reasons = effects.without_value(bound, world)
        if not reasons and comparison is ComparisonType.EQUALS and expressions.evaluate(bound, world) < 0:
            reasons.append(Comparison(ComparisonType.GREATEREQ, bound, (0.0,)))
        missing += reasons
    return missing


def _constraints(ground: GroundAction, timing: Timing) -> Iterator[tuple[ComparisonType, NumericExpression]]:
    """Yield the constraints on ``?duration`` of a part of an action, with objects for its parameters."""
    for constraint in ground.action.duration:
        if constraint.timing is timing:
            yield constraint.comparison, instantiated_expression(constraint.bound, ground.spellings)


def _constraint(comparison: ComparisonType, bound: NumericExpression) -> Formula:
    return Comparison(comparison, (SpecialType.DURATION,), bound)


def _allows(comparison: ComparisonType, bound: float, duration: float) -> Truth:
    """Compare within a nanosecond."""
    over: Fraction | float = (Fraction(duration) - Fraction(bound)) * SECOND if isfinite(bound) else -bound
    too_long = comparison not in (ComparisonType.GREATER, ComparisonType.GREATEREQ) and over > 1
    too_short = comparison not in (ComparisonType.LESS, ComparisonType.LESSEQ) and over < -1
    return Truth.FALSE if too_long or too_short else Truth.TRUE


def _nanoseconds(seconds: float) -> int:
    return round(Fraction(seconds) * SECOND)
