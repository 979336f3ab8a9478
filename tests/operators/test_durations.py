"""How long an action takes (rule O3)."""

import pytest

from kbstore.actions import Action, DurationConstraint
from kbstore.errors import DivisionByZero, InvalidKnowledge, UndefinedFunction
from kbstore.messages import ComparisonType, Operator
from kbstore.planning.operators import check_duration, fixed_duration
from tests.operators.robots import DURATION, END, action, grounded, tokens, world

SECOND = 1_000_000_000
GREATER, MORE, LESS, LESSEQ, EQUALS = (
    ComparisonType.GREATER,
    ComparisonType.GREATEREQ,
    ComparisonType.LESS,
    ComparisonType.LESSEQ,
    ComparisonType.EQUALS,
)


def test_the_domain_fixes_the_duration():
    """O3: ``(= ?duration ...)`` fixes the duration, in seconds of the domain and nanoseconds here."""
    act = action("r:robot a:wp b:wp", duration=[(EQUALS, tokens(Operator.DIV, "distance ?a ?b", "speed ?r"))])
    before = world(numbers={"distance wp0 wp1": 3, "speed kenny": 2})
    assert fixed_duration(grounded(act, "Kenny", "WP0", "wp1"), before) == 1_500_000_000


@pytest.mark.parametrize(
    ("seconds", "expected"), [(0.1, 100_000_000), (1 / 3, 333_333_333), (2 / 3, 666_666_667), (0.0, 0), (1e-10, 0)]
)
def test_a_fixed_duration_is_rounded_to_the_nearest_nanosecond(seconds: float, expected: int):
    """O3, T1: durations are whole nanoseconds."""
    assert fixed_duration(grounded(action(duration=[(EQUALS, (seconds,))])), world()) == expected


def test_other_constraints_fix_nothing():
    """O3: without ``(= ?duration ...)`` the caller gives the duration."""
    assert fixed_duration(grounded(action(duration=[(MORE, (5.0,)), (LESSEQ, (5.0,))])), world()) is None
    assert fixed_duration(grounded(action(durative=True)), world()) is None


def test_a_fixed_duration_has_to_be_had():
    """O3, V5: an undefined, infinite or negative duration is an error, never 0."""
    act = action(duration=[(EQUALS, tokens(Operator.DIV, 1.0, "x"))])
    with pytest.raises(UndefinedFunction, match=r"\(x\)"):
        fixed_duration(grounded(act), world())
    with pytest.raises(DivisionByZero):
        fixed_duration(grounded(act), world(numbers={"x": 0}))
    with pytest.raises(InvalidKnowledge, match=r"\(= \?duration \(/ 1 \(x\)\)\)"):
        fixed_duration(grounded(act), world(numbers={"x": -1}))
    with pytest.raises(InvalidKnowledge, match="62"):
        fixed_duration(grounded(act), world(numbers={"x": 1e-10}))


@pytest.mark.parametrize(
    ("comparison", "below", "equal", "above"),
    [
        (GREATER, False, False, True),
        (MORE, False, True, True),
        (LESS, True, False, False),
        (LESSEQ, True, True, False),
        (EQUALS, False, True, False),
    ],
)
def test_durations_are_compared_to_the_nanosecond(comparison: ComparisonType, below: bool, equal: bool, above: bool):
    """O3: each comparison against a bound of 0.3 s, which no double is exactly, at it and one nanosecond beside."""
    ground_action = grounded(action(duration=[(comparison, (0.3,))]))
    fits = [not check_duration(ground_action, world(), 300_000_000 + d) for d in (-1, 0, 1)]
    assert fits == [below, equal, above]


def test_every_violation_is_named():
    """O3: each constraint that the duration violates is named in PDDL, with the bound's value."""
    act = action("r:robot", duration=[(MORE, (5.0,)), (LESSEQ, tokens("speed ?r")), (GREATER, (1.0,))])
    found = check_duration(grounded(act, "Kenny"), world(numbers={"speed kenny": 2.5}), 4_250_000_000)
    assert len(found) == 2
    assert "(act Kenny) cannot take 4.25 s: (>= ?duration 5)" in found[0]
    assert "(<= ?duration (speed Kenny))" in found[1]
    assert "2.5 s" in found[1]


def test_a_bound_without_value_is_a_violation():
    """O3, V5: a bound that reads an undefined function, or divides by zero, is met by no duration."""
    act = action(duration=[(LESSEQ, tokens("x")), (MORE, tokens(Operator.DIV, 1.0, "y"))])
    undefined, divides = check_duration(grounded(act), world(numbers={"y": 0}), SECOND)
    assert "(<= ?duration (x))" in undefined
    assert "no value" in undefined
    assert "zero" in divides


def test_constraints_at_end_wait_for_the_end():
    """O3: ``(at end (<= ?duration ...))`` is checked at the end, with the world as it is then."""
    act = Action("act", durative=True, duration=(DurationConstraint(LESSEQ, tokens("x"), END),))
    late = world(numbers={"x": 1})
    assert check_duration(grounded(act), late, 2 * SECOND) == []
    assert len(check_duration(grounded(act), late, 2 * SECOND, END)) == 1
    fixed = Action("act", durative=True, duration=(DurationConstraint(EQUALS, tokens("x"), END),))
    assert fixed_duration(grounded(fixed), late) is None


def test_a_bound_may_read_the_duration():
    """O3: within a bound ``?duration`` is the duration in seconds."""
    act = action(duration=[(LESSEQ, (Operator.MUL, 2.0, DURATION))])
    assert check_duration(grounded(act), world(), SECOND) == []


def test_a_bound_that_overflows_is_refused():
    """V5: a bound beyond the numbers is an error."""
    act = action(duration=[(LESSEQ, tokens(Operator.MUL, "x", "x"))])
    with pytest.raises(InvalidKnowledge, match="overflow"):
        check_duration(grounded(act), world(numbers={"x": 1e300}), SECOND)
