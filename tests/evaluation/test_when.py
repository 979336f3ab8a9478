import random
from itertools import pairwise

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from kbstore.clock import SECOND
from kbstore.errors import InvalidKnowledge, NotLinear, UnknownSymbol
from kbstore.evaluation import when
from kbstore.evaluation.conditions import truth
from kbstore.evaluation.interpretation import Arguments, Number
from kbstore.evaluation.intervals import Intervals
from kbstore.evaluation.trajectory_views import TrajectoryAt
from kbstore.messages import ComparisonType, Operator, SpecialType, Truth
from kbstore.model.expressions import NumericExpression
from kbstore.model.formulas import And, Atom, Comparison, Defined, Formula, Imply, IsA, Not, Or, Same, Truism
from tests.evaluation import brute_force
from tests.evaluation.interpretations import History
from tests.evaluation.strategies import (
    DOMAIN,
    FREE_OF_RULES,
    OBJECTS,
    conditions,
    exists,
    expressions,
    forall,
    histories,
)

T, F, U = Truth.TRUE, Truth.FALSE, Truth.UNKNOWN
GREATER, LESS, LESSEQ, EQUALS = (
    ComparisonType.GREATER,
    ComparisonType.LESS,
    ComparisonType.LESSEQ,
    ComparisonType.EQUALS,
)
ADD, SUB, MUL, DIV, MINUS = Operator.ADD, Operator.SUB, Operator.MUL, Operator.DIV, Operator.UMINUS
X, Y, TOTAL = Atom("level", ("r1",)), Atom("level", ("r2",)), Atom("total")
FREE = Atom("free", ("p1",))


def history(*, end: int = 100, unknowns: bool = False, **kwargs: object) -> History:
    """A history over [0, end) in which all objects exist."""
    given_pieces = {"objects": OBJECTS, **kwargs}
    return History((0, end), DOMAIN, use_unknowns=unknowns, **given_pieces)  # type: ignore[arg-type]


def moving(end: int, **numbers: Number) -> History:
    """A history over [0, end) of x, y and total, each of which has one number throughout."""
    names = {"x": "level r1", "y": "level r2", "total": "total"}
    return history(end=end, numbers={names[k]: [(0, end, n)] for k, n in numbers.items()})


def agrees(condition: Formula, trajectory: History) -> bool:
    """Whether the pieces fill the span, neighbours differ, and each has the truth of brute force at every time."""
    pieces = when.truths(condition, trajectory)
    assert [pieces[0][0], *(end for _, end, _ in pieces)] == [*(start for start, _, _ in pieces), trajectory.span[1]]
    assert all(a[2] is not b[2] for a, b in pairwise(pieces))
    assert when.intervals(condition, trajectory) == [(start, end) for start, end, value in pieces if value is T]
    found = [value for start, end, value in pieces for _ in range(start, end)]
    return found == [brute_force.truth(condition, trajectory.at(t)) for t in range(*trajectory.span)]


# -- against brute force --------------------------------------------------------------------------------------


@settings(max_examples=60, deadline=None)
@given(st.one_of([conditions(linear=True, depth=depth) for depth in (0, 1, 2, 4)]), histories())
def test_when_agrees_with_brute_force_at_every_nanosecond(condition: Formula, trajectory: History) -> None:
    """Q4: any condition of V4 and V5, with derived predicates, over histories of a few nanoseconds."""
    assert agrees(condition, trajectory)


@settings(max_examples=40, deadline=None)
@given(conditions(linear=True, depth=2, domain=FREE_OF_RULES), histories(domain=FREE_OF_RULES))
def test_when_without_a_domain(condition: Formula, trajectory: History) -> None:
    """Q4, D2: assertions without a domain give the same answers."""
    trajectory.domain = None
    assert agrees(condition, trajectory)


@settings(max_examples=60, deadline=None)
@given(expressions(()), expressions(()), st.sampled_from(ComparisonType), histories())
def test_any_comparison_is_right_or_not_linear(
    left: NumericExpression, right: NumericExpression, comparison: ComparisonType, trajectory: History
) -> None:
    """Q4: products and quotients of functions give the right answer, or NotLinear, never a wrong one."""
    try:
        assert agrees(Comparison(comparison, left, right), trajectory)
    except NotLinear as error:
        assert "not linear in time" in str(error)  # noqa: PT017 - both outcomes are right


@settings(max_examples=100, deadline=None)
@given(
    st.floats(-1e3, 1e3),
    st.floats(-10, 10),
    st.integers(0, 10**9),
    st.floats(-1e3, 1e3),
    st.sampled_from(ComparisonType),
)
def test_crossings_are_exact_to_the_nanosecond(
    value: float, rate: float, since: int, bound: float, comparison: ComparisonType
) -> None:
    """Q4, V5: at the ends of each piece, and one nanosecond to each side, the answer at that time is the same."""
    trajectory = moving(2**61, x=Number(value, rate, since))
    condition = Comparison(comparison, (X,), (bound,))
    for start, end, found in when.truths(condition, trajectory):
        for t in (start, start + 1, (start + end) // 2, end - 2, end - 1):
            if start <= t < end:
                assert brute_force.truth(condition, trajectory.at(t)) is found
                assert truth(condition, TrajectoryAt(trajectory, t)) is found


@settings(max_examples=30, deadline=None)
@given(conditions(), histories(), st.integers(0, 20))
def test_moment_gives_the_state_at_one_time_of_the_span(condition: Formula, trajectory: History, t: int) -> None:
    """Q4: `moment` returns the state at one time of the span."""
    t = trajectory.span[0] + t % (trajectory.span[1] - trajectory.span[0])
    view, world = TrajectoryAt(trajectory, t), trajectory.at(t)
    assert truth(condition, view) is truth(condition, world)
    for name in DOMAIN.predicate_signatures:
        assert dict(view.facts(name)) == dict(world.facts(name))
    assert [view.type_of(name) for name in OBJECTS] == [world.type_of(name) for name in OBJECTS]


# -- facts ----------------------------------------------------------------------------------------------------


def test_maximal_half_open_intervals() -> None:
    """Q4: adjacent pieces are joined into one interval, inside the span only."""
    trajectory = history(facts={"free p1": [(0, 10, True), (10, 20, True), (20, 30, False), (40, 50, True)]})
    assert when.intervals(FREE, trajectory) == [(0, 20), (40, 50)]
    assert when.intervals(Not(FREE), trajectory) == [(20, 40), (50, 100)]
    assert when.truths(FREE, trajectory) == [(0, 20, T), (20, 40, F), (40, 50, T), (50, 100, F)]


def test_v3_in_an_open_world_not_is_true_only_where_explicitly_false() -> None:
    """V2, V3: absent is unknown."""
    trajectory = history(unknowns=True, facts={"free p1": [(10, 20, True), (20, 30, False)]})
    assert when.truths(FREE, trajectory) == [(0, 10, U), (10, 20, T), (20, 30, F), (30, 100, U)]
    assert when.intervals(Not(FREE), trajectory) == [(20, 30)]


def test_v4_connectives_over_time() -> None:
    """V4: conditions are true when their parts are."""
    trajectory = history(facts={"free p1": [(10, 30, True)], "free p2": [(20, 40, True)], "alarm": [(25, 27, True)]})
    both = And((FREE, Atom("free", ("p2",)), Not(Atom("alarm"))))
    assert when.intervals(both, trajectory) == [(20, 25), (27, 30)]
    assert when.intervals(Or((FREE, Atom("free", ("p2",)))), trajectory) == [(10, 40)]
    assert when.intervals(Imply(FREE, Atom("alarm")), trajectory) == [(0, 10), (25, 27), (30, 100)]
    assert when.intervals(Truism(), trajectory) == [(0, 100)]
    assert when.intervals(Or(()), trajectory) == []


def test_v4_quantifiers_respect_when_objects_exist() -> None:
    """V4: at each time the objects that exist then; a constant always exists."""
    objects = {"r1": [(0, 100, "robot")], "r2": [(20, 60, "robot"), (80, 90, "robot")]}
    facts = {"at r1 home": [(0, 50, True)], "at r2 home": [(30, 60, True)]}
    trajectory = history(objects=objects, facts=facts)
    assert when.intervals(forall("r:robot", Atom("at", ("?r", "home"))), trajectory) == [(0, 20), (30, 50)]
    assert when.intervals(exists("r:robot", Not(Atom("at", ("?r", "home")))), trajectory) == [(20, 30), (50, 100)]
    assert when.intervals(forall("r:robot d:dock", Atom("at", ("?r", "?d"))), trajectory) == [(0, 20), (30, 50)]


def test_v7_wildcards_over_time() -> None:
    """V7: of any object at each time; false in an open world only while explicitly false of all that exist."""
    objects = {"r1": [(0, 100, "robot")], "r2": [(20, 60, "robot")]}
    facts = {"at r1 home": [(0, 10, True), (10, 100, False)], "at r2 home": [(30, 50, False), (50, 60, True)]}
    wild = Atom("at", ("?", "home"))
    assert when.intervals(wild, history(objects=objects, facts=facts)) == [(0, 10), (50, 60)]
    trajectory = history(objects=objects, facts=facts, unknowns=True)
    assert when.truths(wild, trajectory) == [
        (0, 10, T),
        (10, 20, F),
        (20, 30, U),
        (30, 50, F),
        (50, 60, T),
        (60, 100, F),
    ]


def test_v7_a_wildcard_is_unknown_again_when_an_explicit_negative_ends() -> None:
    """V7: in an open world a wildcard is unknown again when one fact is no longer explicitly false."""
    objects = {"r1": [(0, 100, "robot")]}
    trajectory = history(unknowns=True, objects=objects, facts={"at r1 home": [(10, 20, False)]})
    assert when.truths(Atom("at", ("?", "home")), trajectory) == [(0, 10, U), (10, 20, F), (20, 100, U)]


def test_v4_quantifiers_over_time_in_an_open_world() -> None:
    """V4: exists is false only while it is explicitly false of all that exist; forall dually."""
    objects = {"d1": [(0, 80, "dock")]}
    facts = {"free d1": [(10, 40, False), (40, 50, True)], "free home": [(20, 60, False), (60, 90, True)]}
    trajectory, free = history(unknowns=True, objects=objects, facts=facts), Atom("free", ("?d",))
    assert when.truths(exists("d:dock", free), trajectory) == [
        (0, 20, U), (20, 40, F), (40, 50, T), (50, 60, U), (60, 90, T), (90, 100, U),
    ]  # fmt: skip
    assert when.truths(exists("d:dock", free), history(unknowns=True)) == [(0, 100, U)]
    assert when.truths(forall("d:dock", free), trajectory) == [
        (0, 10, U), (10, 60, F), (60, 80, U), (80, 90, T), (90, 100, U),
    ]  # fmt: skip


def test_existence_equality_and_definedness_over_time() -> None:
    """Q4, V8: a missing object has no type; a function is defined in its pieces."""
    objects = {"p1": [(10, 20, "place"), (30, 40, "dock")]}
    trajectory = history(objects=objects, numbers={"total": [(5, 15, Number(1.0))]})
    assert when.intervals(IsA("p1"), trajectory) == [(10, 20), (30, 40)]
    assert when.intervals(IsA("p1", "dock"), trajectory) == [(30, 40)]
    assert when.intervals(IsA("?", "place"), trajectory) == [(0, 100)]
    assert when.intervals(Same("ghost", "GHOST"), trajectory) == [(0, 100)]
    assert when.intervals(Defined(TOTAL), trajectory) == [(5, 15)]
    objects = {"r1": [(10, 20, "robot")]}
    trajectory = history(objects=objects, numbers={"level r1": [(0, 15, Number(1.0)), (17, 30, Number(1.0))]})
    assert when.intervals(Defined(Atom("level", ("?",))), trajectory) == [(10, 15), (17, 20)]


def test_bindings_and_duration() -> None:
    """Q4: free variables and `?duration` are given with the question."""
    trajectory = history(facts={"free p1": [(10, 20, True)]}, numbers={"total": [(0, 50, Number(3.0))]})
    assert when.intervals(Atom("free", ("?X",)), trajectory, {"x": "P1"}) == [(10, 20)]
    longer = Comparison(GREATER, (SpecialType.DURATION,), (TOTAL,))
    assert when.intervals(longer, trajectory, duration=4.0) == [(0, 50)]
    with pytest.raises(InvalidKnowledge, match=r"\?duration"):
        when.intervals(longer, trajectory)
    with pytest.raises(InvalidKnowledge, match=r"\?duration"):
        when.truths(longer, trajectory)


def test_questions_are_checked_and_an_empty_span_has_no_intervals() -> None:
    """V8: unknown symbols are refused, over an empty span, too."""
    trajectory = history(end=0)
    assert when.intervals(FREE, trajectory) == []
    assert isinstance(when.intervals(FREE, trajectory), Intervals)
    with pytest.raises(UnknownSymbol, match="no predicate flies"):
        when.truths(Or((Truism(), Atom("flies"))), trajectory)


def test_v8_derived_predicates_over_time() -> None:
    """V9, V8: atoms are derived where the rules apply; for a missing object absent, unknown in an open world."""
    objects = {"p1": [(0, 80, "place")], "p2": [(0, 100, "place")], "d1": [(0, 100, "dock")]}
    facts = {"linked p1 p2": [(10, 40, True), (60, 80, True)], "linked p2 d1": [(30, 70, True)]}
    reach = Atom("reach", ("p1", "d1"))
    assert when.intervals(reach, history(objects=objects, facts=facts)) == [(30, 40), (60, 70)]
    assert when.intervals(Atom("reach", ("p2", "d1")), history(objects=objects, facts=facts)) == [(30, 70)]
    assert when.intervals(Atom("reach", ("?", "d1")), history(objects=objects, facts=facts)) == [(30, 70)]
    assert when.truths(reach, history(objects=objects, facts=facts, unknowns=True)) == [
        (0, 30, U), (30, 40, T), (40, 60, U), (60, 70, T), (70, 100, U),
    ]  # fmt: skip


def test_v9_a_derived_predicate_that_compares_changes_at_the_crossing() -> None:
    """V9, Q4: between changes of its facts, too, a derived predicate is exact to the nanosecond."""
    trajectory = moving(10 * SECOND, x=Number(10.0, -1.0, 0), y=Number(50.0, 0.0, 0), total=Number(4.0, 0.5, 0))
    # 10 - t < 4 + t / 2 from t = 4 on
    assert when.intervals(Atom("low", ("r1",)), trajectory) == [(4 * SECOND + 1, 10 * SECOND)]
    assert when.intervals(exists("r:robot", Atom("low", ("?r",))), trajectory) == [(4 * SECOND + 1, 10 * SECOND)]


# -- comparisons that move ------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("comparison", "left", "right", "expected"),
    [
        # x falls from 10 by 2 a second: it is 5 at 2.5 s
        (GREATER, (X,), (5.0,), [(0, 2_500_000_000)]),
        (ComparisonType.GREATEREQ, (X,), (5.0,), [(0, 2_500_000_001)]),
        (EQUALS, (X,), (5.0,), [(2_500_000_000, 2_500_000_001)]),
        (LESS, (X,), (5.0,), [(2_500_000_001, 10 * SECOND)]),
        (LESSEQ, (X,), (5.0,), [(2_500_000_000, 10 * SECOND)]),
        (LESS, (5.0,), (X,), [(0, 2_500_000_000)]),
        (GREATER, (MUL, 2.0, X), (10.0,), [(0, 2_500_000_000)]),
        (GREATER, (DIV, X, 2.0), (2.5,), [(0, 2_500_000_000)]),
        (GREATER, (MINUS, X), (-5.0,), [(2_500_000_001, 10 * SECOND)]),
        # y rises from 0 by 1 a second: they meet at 10 / 3 s, between two nanoseconds
        (GREATER, (X,), (Y,), [(0, 3_333_333_334)]),
        (EQUALS, (X,), (Y,), []),
        (GREATER, (SUB, X, Y), (1.0,), [(0, 3 * SECOND)]),
        (LESS, (ADD, X, MUL, 2.0, Y), (10.5,), [(0, 10 * SECOND)]),
        # total does not move from 4
        (GREATER, (MUL, X, TOTAL), (20.0,), [(0, 2_500_000_000)]),
        (GREATER, (DIV, X, TOTAL), (1.25,), [(0, 2_500_000_000)]),
        # what is not linear cancels out
        (GREATER, (SUB, MUL, X, Y, MUL, Y, X), (-1.0,), [(0, 10 * SECOND)]),
        (GREATER, (DIV, MUL, X, Y, Y), (5.0,), [(1, 2_500_000_000)]),
        # 0 / x is 0, except at 5 s, where x is 0
        (EQUALS, (DIV, 0.0, X), (0.0,), [(0, 5 * SECOND), (5 * SECOND + 1, 10 * SECOND)]),
        (EQUALS, (DIV, 1.0, SUB, X, X), (0.0,), []),
    ],
)
def test_q4_crossings_of_linear_expressions(
    comparison: ComparisonType, left: NumericExpression, right: NumericExpression, expected: list[tuple[int, int]]
) -> None:
    """Q4: the crossing of a comparison linear in time is solved; equality holds for single nanoseconds."""
    trajectory = moving(10 * SECOND, x=Number(10.0, -2.0, 0), y=Number(0.0, 1.0, 0), total=Number(4.0))
    assert when.intervals(Comparison(comparison, left, right), trajectory) == expected


@pytest.mark.parametrize(
    "expression",
    [
        (MUL, X, Y),
        (MUL, X, X),
        (DIV, 1.0, X),
        (DIV, X, Y),
        (DIV, ADD, X, 1.0, X),
        (MUL, X, MUL, Y, MUL, X, MUL, X, Y),
    ],
)
def test_q4_a_nonlinear_comparison_is_refused(expression: NumericExpression) -> None:
    """Q4: a product of two moving functions, or a division by one, is NotLinear and names them."""
    trajectory = moving(10 * SECOND, x=Number(10.0, -2.0, 0), y=Number(0.0, 1.0, 0))
    with pytest.raises(NotLinear, match=r"1970-01-01T00:00:00Z to 1970-01-01T00:00:10Z, where \(level r[12]\)"):
        when.intervals(Comparison(GREATER, expression, (1.0,)), trajectory)


def test_q4_a_comparison_must_be_linear_in_the_span_only() -> None:
    """Q4: the product is linear while one of the functions does not move or has no value."""
    rest, rise = Number(2.0), Number(0.0, 1e9, 0)
    product = Comparison(GREATER, (MUL, X, Y), (40.0,))
    numbers = {"level r1": [(0, 50, rest), (50, 60, rise)], "level r2": [(0, 50, rise)]}
    assert when.truths(product, history(numbers=numbers)) == [(0, 21, F), (21, 50, T), (50, 100, U)]


def test_q4_a_function_of_many_pieces() -> None:
    """Q4: each piece has its own crossing; undefined pieces are unknown; jumps count."""
    pieces = [(0, 10, Number(5.0)), (10, 30, Number(20.0, -1e9, 10)), (40, 60, Number(0.0, 1e9, 38))]
    trajectory = history(numbers={"total": pieces})
    low = Comparison(LESS, (TOTAL,), (10.0,))
    assert when.truths(low, trajectory) == [
        (0, 10, T),
        (10, 21, F),
        (21, 30, T),
        (30, 40, U),
        (40, 48, T),
        (48, 60, F),
        (60, 100, U),
    ]


def test_q4_a_constant_comparison_is_one_piece() -> None:
    """V5: numbers alone are compared as at one time; without a value it is unknown throughout."""
    trajectory = history()
    assert when.truths(Comparison(LESS, (1.0,), (2.0,)), trajectory) == [(0, 100, T)]
    assert when.truths(Comparison(LESS, (DIV, 1.0, 0.0), (2.0,)), trajectory) == [(0, 100, U)]


# -- how much is read, and how fast ---------------------------------------------------------------------------


class Reading(History):
    """A history that records which parts of it are read."""

    def __init__(self, *args: object, **kwargs: object) -> None:
        super().__init__(*args, **kwargs)  # type: ignore[arg-type]
        self.reads: list[str] = []

    def signs(self, name: str, arguments: Arguments):  # type: ignore[no-untyped-def]
        self.reads.append(" ".join((name, *arguments)))
        return super().signs(name, arguments)

    def all_signs(self, name: str):  # type: ignore[no-untyped-def]
        self.reads.append(name)
        return super().all_signs(name)


def test_a_question_about_one_fact_reads_that_fact_only() -> None:
    """Q4: it reads the facts that the question needs; a predicate under a quantifier is read once, whole."""
    trajectory = Reading(
        (0, 100), DOMAIN, objects=OBJECTS, facts={"free p1": [(0, 5, True)], "free p2": [(3, 9, True)]}
    )
    assert when.intervals(And((FREE, Not(Not(FREE)))), trajectory) == [(0, 5)]
    assert trajectory.reads == ["free p1"]
    trajectory.reads.clear()
    assert when.intervals(forall("p:place", Imply(Atom("free", ("?p",)), FREE)), trajectory) == [(0, 5), (9, 100)]
    assert trajectory.reads == ["free"]


def test_ten_thousand_intervals_come_back_one_by_one() -> None:
    """Q4: a long history of one fact is returned interval by interval."""
    size, chance = 10_000, random.Random(3)
    cuts = sorted(chance.sample(range(10**6), 2 * size))
    spans = list(zip(cuts[::2], cuts[1::2], strict=True))
    facts = {"free p1": [(a, b, True) for a, b in spans], "free p2": [(a + 1, b + 1, True) for a, b in spans]}
    trajectory = history(end=10**6 + 2, facts=facts)
    assert when.intervals(FREE, trajectory) == spans
    assert agrees_at(And((FREE, Atom("free", ("p2",)))), trajectory, chance.sample(range(10**6), 10))


def agrees_at(condition: Formula, trajectory: History, times: list[int]) -> bool:
    """Whether intervals and brute force agree at some times."""
    found = when.intervals(condition, trajectory)
    return all(
        any(a <= t < b for a, b in found) is (brute_force.truth(condition, trajectory.at(t)) is T) for t in times
    )
