"""The duration of an action (rule O3)."""

import pytest

from kbstore.errors import DivisionByZero, InvalidKnowledge, UndefinedFunction
from kbstore.messages import ComparisonType, Operator
from kbstore.model.actions import Action, DurationConstraint
from kbstore.planning.durations import Duration, fixed_duration
from tests.planning.robots import END, action, grounded, tokens, world

MORE, LESSEQ, EQUALS = ComparisonType.GREATEREQ, ComparisonType.LESSEQ, ComparisonType.EQUALS


def test_the_domain_fixes_the_duration():
    """O3: ``(= ?duration ...)`` fixes the duration, in seconds of the domain, which are nanoseconds here."""
    act = action("r:robot a:wp b:wp", duration=[(EQUALS, tokens(Operator.DIV, "distance ?a ?b", "speed ?r"))])
    before = world(numbers={"distance wp0 wp1": 3, "speed kenny": 2})
    assert fixed_duration(grounded(act, "Kenny", "WP0", "wp1"), before) == Duration(1.5, 1_500_000_000)


@pytest.mark.parametrize(
    ("seconds", "expected"), [(0.1, 100_000_000), (1 / 3, 333_333_333), (2 / 3, 666_666_667), (0.0, 0), (1e-10, 0)]
)
def test_a_fixed_duration_is_rounded_to_the_nearest_nanosecond(seconds: float, expected: int):
    """O7: ``?duration`` is exactly the fixed number; only the time of the end is rounded."""
    assert fixed_duration(grounded(action(duration=[(EQUALS, (seconds,))])), world()) == (seconds, expected)


def test_other_constraints_fix_nothing():
    """O3: without ``(= ?duration ...)`` the caller gives the duration."""
    assert fixed_duration(grounded(action(duration=[(MORE, (5.0,)), (LESSEQ, (5.0,))])), world()) is None
    assert fixed_duration(grounded(action(durative=True)), world()) is None


def test_a_fixed_duration_must_be_a_finite_number():
    """O3, V5: an undefined, infinite or negative duration is an error, not 0."""
    act = action(duration=[(EQUALS, tokens(Operator.DIV, 1.0, "x"))])
    with pytest.raises(UndefinedFunction, match=r"\(x\)"):
        fixed_duration(grounded(act), world())
    with pytest.raises(DivisionByZero):
        fixed_duration(grounded(act), world(numbers={"x": 0}))
    with pytest.raises(InvalidKnowledge, match=r"\(= \?duration \(/ 1 \(x\)\)\)"):
        fixed_duration(grounded(act), world(numbers={"x": -1}))
    with pytest.raises(InvalidKnowledge, match="62"):
        fixed_duration(grounded(act), world(numbers={"x": 1e-10}))


def test_a_constraint_at_the_end_fixes_nothing_at_the_start():
    """O3: ``(at end (= ?duration ...))`` is evaluated at the end."""
    fixed = Action("act", durative=True, duration=(DurationConstraint(EQUALS, tokens("x"), END),))
    assert fixed_duration(grounded(fixed), world(numbers={"x": 1})) is None
