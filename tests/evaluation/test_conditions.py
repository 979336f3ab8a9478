from itertools import product

import pytest
from hypothesis import given, settings

from kbstore.clock import SECOND
from kbstore.errors import InvalidKnowledge, UnknownSymbol
from kbstore.evaluation.conditions import truth
from kbstore.evaluation.evaluator import Evaluation
from kbstore.evaluation.interpretation import Number
from kbstore.evaluation.wellformed import check
from kbstore.messages import ComparisonType, Operator, SpecialType, Truth
from kbstore.model.expressions import NumericExpression
from kbstore.model.formulas import (
    And,
    Atom,
    Comparison,
    Defined,
    Exists,
    Formula,
    Imply,
    IsA,
    Not,
    Or,
    Parameter,
    Preference,
    Same,
    Truism,
)
from tests.evaluation import brute_force
from tests.evaluation.interpretations import World
from tests.evaluation.strategies import DOMAIN, FREE_OF_RULES, conditions, exists, forall, worlds

T, F, U = Truth.TRUE, Truth.FALSE, Truth.UNKNOWN
GREATER, EQUALS = ComparisonType.GREATER, ComparisonType.EQUALS
ALARM = Atom("alarm")
OBJECTS = {"r1": "robot", "r2": "robot", "p1": "place", "p2": "place", "d1": "dock"}


def world(*facts: str, unknowns: bool = False, **kwargs: object) -> World:
    """A world of the facts ``"free p1"`` and ``"not free p2"``."""
    signs = {text.removeprefix("not "): not text.startswith("not ") for text in facts}
    given = {"objects": OBJECTS, **kwargs}
    return World(DOMAIN, use_unknowns=unknowns, facts=signs, **given)  # type: ignore[arg-type]


def function(text: str) -> Atom:
    name, *arguments = text.split()
    return Atom(name, tuple(arguments))


def of_truth(value: Truth) -> Formula:
    """A condition with a truth value in an open world where free p1 is asserted, and free p2 explicitly false."""
    return Atom("free", ({T: "p1", F: "p2", U: "d1"}[value],))


OPEN = world("free p1", "not free p2", unknowns=True)


# -- random formulas ------------------------------------------------------------------------------------------


@settings(max_examples=120, deadline=None)
@given(conditions(), worlds())
def test_random_conditions_agree_with_brute_force(condition: Formula, random_world: World) -> None:
    """V2 to V5, V7 to V9, in closed and open worlds, against an evaluator that tries everything."""
    assert truth(condition, random_world) is brute_force.truth(condition, random_world)


@settings(max_examples=80, deadline=None)
@given(conditions(domain=FREE_OF_RULES), worlds(domain=FREE_OF_RULES))
def test_random_conditions_without_a_domain(condition: Formula, random_world: World) -> None:
    """D2: without a domain the same conditions are evaluated on what is asserted."""
    random_world.domain = None
    assert truth(condition, random_world) is brute_force.truth(condition, random_world)


# -- truth of facts -------------------------------------------------------------------------------------------


def test_v2_a_fact_is_true_false_or_absent() -> None:
    """V2: in a closed world absent reads as false, with unknowns as unknown."""
    for unknowns, absent in ((False, F), (True, U)):
        state = world("free p1", "not free p2", unknowns=unknowns)
        assert [truth(Atom("free", (p,)), state) for p in ("p1", "p2", "d1")] == [T, F, absent]


def test_v3_not_is_true_where_false() -> None:
    """V3: in a closed world wherever p is not asserted, in an open one only where p is explicitly false."""
    for unknowns, absent in ((False, T), (True, U)):
        state = world("free p1", "not free p2", unknowns=unknowns)
        assert [truth(Not(Atom("free", (p,))), state) for p in ("p1", "p2", "d1")] == [F, T, absent]


def test_d3_names_are_compared_without_regard_to_case() -> None:
    """D3: predicates, objects and variables in any case."""
    condition = exists("P:Place", And((Atom("FREE", ("?p",)), Same("?P", "D1"))))
    assert truth(condition, world("free d1")) is T
    assert truth(Atom("Free", ("?Where",)), world("free d1"), {"WHERE": "D1"}) is T


# -- three-valued logic ---------------------------------------------------------------------------------------

RANK = {F: 0, U: 1, T: 2}


@pytest.mark.parametrize(("a", "b"), list(product([T, F, U], repeat=2)))
def test_v4_connectives_follow_kleene(a: Truth, b: Truth) -> None:
    """V4: `and` is the least, `or` the greatest in the order false, unknown, true; `imply` is (or (not a) b)."""
    left, right = of_truth(a), of_truth(b)
    least, greatest = min(a, b, key=RANK.__getitem__), max(a, b, key=RANK.__getitem__)
    assert truth(And((left, right)), OPEN) is least
    assert truth(Or((left, right)), OPEN) is greatest
    assert truth(Imply(left, right), OPEN) is max({T: F, F: T, U: U}[a], b, key=RANK.__getitem__)
    assert truth(Not(left), OPEN) is {T: F, F: T, U: U}[a]
    assert truth(Preference("p", left), OPEN) is a


def test_v4_empty_connectives() -> None:
    """V4: the empty conjunction is true, the empty disjunction false."""
    assert [truth(c, OPEN) for c in (And(()), Or(()), Truism())] == [T, F, T]


def test_v4_quantifiers_range_over_subtypes_and_constants() -> None:
    """V4: the objects of the type and its subtypes that exist, constants included."""
    everywhere = world("free p1", "free p2", "free d1", "free home")
    assert truth(forall("x:place", Atom("free", ("?x",))), everywhere) is T
    assert truth(forall("x:place", Atom("free", ("?x",))), world("free p1", "free p2", "free d1")) is F
    assert truth(exists("x:dock", Atom("free", ("?x",))), world("free d1")) is T
    assert truth(exists("x:dock", Atom("free", ("?x",))), world("free p1")) is F
    assert truth(exists("x:robot|dock", Same("?x", "p1")), everywhere) is F


def test_v4_quantifiers_over_nothing() -> None:
    """V4: over no objects, forall is true and exists is false."""
    empty = world(objects={})
    assert truth(forall("x:robot", Or(())), empty) is T
    assert truth(exists("x:robot", And(())), empty) is F
    assert truth(exists("x:robot y:place", And(())), empty) is F


def test_v4_an_inner_variable_hides_the_outer_one_of_the_same_name() -> None:
    """V4: a variable belongs to the innermost quantifier that declares it."""
    state = world("free p1", "at r1 p2")
    condition = exists("x:robot", And((Atom("at", ("?x", "p2")), exists("x:place", Atom("free", ("?x",))))))
    assert truth(condition, state) is T
    assert truth(exists("x:place", Atom("free", ("?x",))), state, {"x": "p2"}) is T


def test_v4_unknown_instances_make_quantifiers_unknown() -> None:
    """V4: exists is unknown where no instance is true and some is unknown; forall dually."""
    assert truth(exists("x:dock", Atom("free", ("?x",))), world("not free d1", unknowns=True)) is U
    state = world("not free d1", "not free home", unknowns=True)
    assert truth(exists("x:dock", Atom("free", ("?x",))), state) is F
    assert truth(forall("x:dock", Atom("free", ("?x",))), world("free d1", unknowns=True)) is U
    assert truth(forall("x:dock", Atom("free", ("?x",))), state) is F


def test_v4_equality_compares_names() -> None:
    """V4, V8: `=` over objects compares names, of objects that do not exist, too."""
    assert truth(Same("R1", "r1"), OPEN) is T
    assert truth(Same("r1", "r2"), OPEN) is F
    assert truth(Same("ghost", "ghost"), OPEN) is T


def test_quantifiers_over_many_objects_read_the_facts() -> None:
    """A join over 4,000 facts takes time for the facts, not for the 4,000 x 4,000 pairs of objects."""
    names = {f"p{i}": "place" for i in range(4000)}
    chain = {f"linked p{i} p{i + 1}": True for i in range(3999)}
    big = World(DOMAIN, objects=names, facts={**chain, "free p3999": True})
    pairs = exists("x:place y:place", And((Atom("linked", ("?x", "?y")), Atom("free", ("?y",)))))
    assert truth(pairs, big) is T
    backwards = forall("x:place y:place", Imply(Atom("linked", ("?x", "?y")), Not(Atom("linked", ("?y", "?x")))))
    assert truth(backwards, big) is T


# -- comparisons ----------------------------------------------------------------------------------------------


def compare(left: str | float, comparison: ComparisonType, right: str | float) -> Comparison:
    sides = [(function(side) if isinstance(side, str) else side,) for side in (left, right)]
    return Comparison(comparison, *sides)


@pytest.mark.parametrize("rate", [0.0, 1.0])
@pytest.mark.parametrize(("value", "true"), [(1.0, {"<", "<="}), (2.0, {"<=", "=", ">="}), (3.0, {">", ">="})])
def test_v5_comparisons(value: float, true: set[str], rate: float) -> None:
    """V5: the five comparisons of a number with 2, whether or not it moves."""
    state = world(time=5, numbers={"total": Number(value, rate, 5)})
    assert {c.pddl for c in ComparisonType if truth(compare("total", c, 2.0), state) is T} == true
    assert {c.pddl for c in ComparisonType if truth(compare("total", c, 2.0), state) is F} == {
        "<",
        "<=",
        "=",
        ">=",
        ">",
    } - true


@pytest.mark.parametrize("unknowns", [False, True])
def test_v5_undefined_division_by_zero_and_overflow_are_unknown(unknowns: bool) -> None:
    """V5: a comparison without a value is unknown, in both worlds, and so is its negation."""
    state = world(unknowns=unknowns, numbers={"total": 0.0, "level r2": Number(0.0, 1.0, 0)})
    undefined = compare("level r1", GREATER, 0.0)
    for left in (
        (Operator.DIV, 1.0, Atom("total")),
        (Operator.MUL, 1e200, 1e200),
        (Operator.DIV, 1.0, function("level r2")),
    ):
        comparison = Comparison(GREATER, left, (0.0,))
        assert truth(comparison, state) is U
        assert truth(Not(comparison), state) is U
    assert truth(undefined, state) is U
    assert truth(Not(undefined), state) is U
    assert truth(Or((undefined, Truism())), state) is T


def test_v5_without_rates_numbers_are_doubles() -> None:
    """V5: arithmetic is that of IEEE doubles, in which 0.1 + 0.2 is not 0.3."""
    tenths = Comparison(EQUALS, (Operator.ADD, Atom("total"), 0.2), (0.3,))
    assert truth(tenths, world(numbers={"total": 0.1})) is F
    assert truth(Comparison(EQUALS, (Operator.ADD, 2.0**53, 1.0), (2.0**53,)), world()) is T


def test_v5_with_a_rate_numbers_are_exact() -> None:
    """V5: a comparison that reads a function with a rate is decided in rationals of the stored doubles.

    At t = 3 s a function that starts at 0 and moves by 0.1 has three times the value of the double 0.1, which is more
    than the double 0.3; rounded to doubles it would be 0.30000000000000004, and 2**53 + 1 would be 2**53.
    """
    state = world(time=3 * SECOND, numbers={"total": Number(0.0, 0.1, 0), "level r1": Number(2.0**53, 1.0, 0)})
    assert truth(compare("total", GREATER, 0.3), state) is T
    assert truth(Comparison(EQUALS, (Atom("total"),), (Operator.MUL, 3.0, 0.1)), state) is T
    assert truth(Comparison(EQUALS, (function("level r1"),), (Operator.ADD, 2.0**53, 3.0)), state) is T
    just_after = world(time=3 * SECOND + 1, numbers={"total": Number(0.0, 0.1, 0)})
    assert truth(Comparison(GREATER, (Atom("total"),), (Operator.MUL, 3.0, 0.1)), just_after) is T


def test_v5_exact_numbers_do_not_overflow() -> None:
    """V5: rationals have no largest number; only absurd sizes are refused."""
    state = world(time=SECOND, numbers={"total": Number(1e300, 1e300, 0)})
    huge = (Operator.MUL, Atom("total"), Atom("total"))
    assert truth(Comparison(GREATER, huge, (1e308,)), state) is T
    absurd = (Operator.MUL, Atom("total")) * 1000 + (1.0,)
    with pytest.raises(InvalidKnowledge, match="write a simpler expression"):
        truth(Comparison(GREATER, absurd, (0.0,)), state)


def test_v7_defined_asks_whether_a_function_has_a_value() -> None:
    """V7: a question about a function without a value asks whether it is defined; `?` for any object."""
    state = world(unknowns=True, numbers={"level r1": 0.0})
    assert truth(Defined(function("level r1")), state) is T
    assert truth(Defined(function("level r2")), state) is F
    assert truth(Defined(function("level ?")), state) is T
    assert truth(Defined(function("cost ?")), state) is F


def test_expressions_in_comparisons_may_be_of_any_length() -> None:
    """Expressions of any length stay below Python's recursion limit, in doubles and in rationals."""
    long = (Operator.ADD, 1.0) * 100_000 + (Atom("total"),)
    for rate in (0.0, 1.0):
        state = world(numbers={"total": Number(0.5, rate, 0)})
        assert truth(Comparison(EQUALS, long, (100_000.5,)), state) is T


# -- wildcards ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("wild", ["?", "?anything", ""])
def test_v7_a_wildcard_is_an_exists_within_its_atom(wild: str) -> None:
    """V7: `?` matches any object, and `not` applies outside of it."""
    state = world("at r1 p1")
    assert truth(Atom("at", (wild, "p1")), state) is T
    assert truth(Atom("at", (wild, "p2")), state) is F
    assert truth(Not(Atom("at", (wild, "p1"))), state) is F
    assert truth(Not(Atom("at", (wild, "p2"))), state) is T


def test_v7_two_wildcards_do_not_join() -> None:
    """V7: two wildcards, of the same name or not, match objects independently."""
    state = world("linked p1 p2")
    assert truth(Atom("linked", ("?", "?")), state) is T
    assert truth(Atom("linked", ("?x", "?x")), state) is T
    assert truth(exists("x:place", Atom("linked", ("?x", "?x"))), state) is F


def test_v7_in_an_open_world_a_wildcard_is_false_only_if_false_of_all() -> None:
    """V2, V7: unknown until it is explicitly false of every object of the parameter's type."""
    denied = [f"not free {p}" for p in ("p1", "p2", "d1", "home")]
    assert truth(Atom("free", ("?",)), world(*denied[:3], unknowns=True)) is U
    assert truth(Atom("free", ("?",)), world(*denied, unknowns=True)) is F
    assert truth(Not(Atom("free", ("?",))), world(*denied, unknowns=True)) is T
    assert truth(Atom("free", ("?",)), world(*denied[:3], "free home", unknowns=True)) is T


def test_v7_without_a_domain_a_wildcard_is_never_false_in_an_open_world() -> None:
    """V7, D2: objects may exist that are not known, so a wildcard is never false in an open world."""
    state = World(use_unknowns=True, objects={"a": "thing"}, facts={"p a": False})
    assert truth(Atom("p", ("?",)), state) is U
    assert truth(Atom("p", ("?",)), World(facts={"p a": True})) is T


@pytest.mark.parametrize(
    "condition",
    [
        compare("level ?", GREATER, 0.0),
        compare(0.0, GREATER, "level ?r"),
        Same("?x", "r1"),
        Same("r1", ""),
        exists("x:robot", And((Atom("stuck", ("?x",)), compare("level ?y", GREATER, 0.0)))),
    ],
)
def test_v7_a_wildcard_in_a_comparison_is_refused(condition: Formula) -> None:
    """V7: in a comparison `exists` has to be written."""
    with pytest.raises(InvalidKnowledge, match="say exists"):
        truth(condition, world())


def test_v7_a_bound_variable_is_not_a_wildcard() -> None:
    """V7: a variable that a quantifier or the caller binds is its object."""
    state = world(numbers={"level r1": 1.0, "level r2": 3.0})
    assert truth(compare("level ?r", GREATER, 2.0), state, {"r": "r2"}) is T
    assert truth(exists("r:robot", compare("level ?r", GREATER, 2.0)), state) is T
    assert truth(forall("r:robot", compare("level ?r", GREATER, 2.0)), state) is F


# -- what does not exist, and what is not known ---------------------------------------------------------------


@pytest.mark.parametrize("unknowns", [False, True])
def test_v8_facts_about_a_missing_object_are_absent(unknowns: bool) -> None:
    """V8: facts are absent, functions undefined, and no type matches; derived predicates are absent, too."""
    state = world("free p1", unknowns=unknowns)
    absent = U if unknowns else F
    assert truth(Atom("free", ("ghost",)), state) is absent
    assert truth(Atom("reach", ("ghost", "p1")), state) is absent
    assert truth(exists("x:place", Atom("reach", ("?x", "ghost"))), state) is absent
    assert truth(Atom("reach", ("?", "ghost")), state) is absent
    assert truth(compare("level ghost", GREATER, 0.0), state) is U
    assert truth(IsA("ghost", "robot"), state) is F
    assert truth(IsA("ghost"), state) is F


def test_is_a_asks_for_the_type_and_its_subtypes() -> None:
    """V4: an object is of its type and of all supertypes; without a type the question is whether it exists."""
    state = world()
    kinds = [truth(IsA("D1", kind), state) for kind in ("dock", "Place", "thing", "object", "", "robot")]
    assert kinds == [T, T, T, T, T, F]
    assert truth(IsA("home", "dock"), state) is T
    assert truth(IsA("?", "robot"), state) is T
    assert truth(IsA("?", "robot"), world(objects={})) is F


@pytest.mark.parametrize(
    ("condition", "sentence"),
    [
        (Atom("flies", ("r1",)), "no predicate flies"),
        (Atom("level", ("r1",)), "no predicate level"),
        (compare("weight r1", GREATER, 0.0), "no function weight"),
        (Defined(function("at r1 p1")), "no function at"),
        (IsA("r1", "dragon"), "no type dragon"),
        (exists("x:dragon", Truism()), "no type dragon"),
    ],
)
def test_v8_unknown_symbols_are_refused_in_every_branch(condition: Formula, sentence: str) -> None:
    """V8: a symbol that the domain does not know is UnknownSymbol, also in a branch that is not evaluated."""
    for hidden in (condition, Or((Truism(), Not(condition))), forall("z:robot", Imply(Or(()), condition))):
        with pytest.raises(UnknownSymbol, match=sentence):
            truth(hidden, world(objects={}))


@pytest.mark.parametrize("condition", [Atom("free"), Atom("free", ("p1", "p2")), compare("total r1", GREATER, 0.0)])
def test_a_wrong_number_of_arguments_is_refused(condition: Formula) -> None:
    """D1: the number of arguments is that of the domain."""
    with pytest.raises(InvalidKnowledge, match=r"arguments?, but .* takes"):
        truth(Or((Truism(), condition)), world())


def test_without_a_domain_every_symbol_is_known() -> None:
    """D2: a predicate without any assertion is absent."""
    assert truth(Atom("flies", ("r1",)), World()) is F
    assert truth(Atom("p", ("a", "?", "?")), World(facts={"p a": True})) is F


@pytest.mark.parametrize(
    ("expression", "sentence"),
    [
        ((SpecialType.DURATION,), r"\?duration has a value only"),
        ((SpecialType.HASHT,), "#t has a value only"),
        ((SpecialType.TOTAL_TIME,), "total-time"),
        ((Operator.ADD, 1.0), "lacks an operand"),
        ((float("nan"),), "nan cannot stand in an expression"),
    ],
)
def test_meaningless_expressions_are_refused(expression: NumericExpression, sentence: str) -> None:
    """A comparison has numbers on both sides."""
    with pytest.raises(InvalidKnowledge, match=sentence):
        truth(Comparison(EQUALS, (1.0,), expression), world())


def test_duration_is_given_with_the_question() -> None:
    """`?duration` is the number of seconds that the caller gives."""
    short = Comparison(GREATER, (10.0,), (SpecialType.DURATION,))
    assert truth(short, world(), duration=5.0) is T
    assert truth(short, world(), duration=10.0) is F


def test_a_variable_declared_twice_is_refused() -> None:
    """One quantifier may declare a variable only once."""
    with pytest.raises(InvalidKnowledge, match=r"declares \?X twice"):
        check(exists("x:robot X:place", Truism()), DOMAIN)


@pytest.mark.parametrize("depth", [150, 100_000])
def test_deep_nesting_is_evaluated_or_refused(depth: int) -> None:
    """Conditions nested 150 deep are evaluated in any form; far deeper ones are refused, never a RecursionError."""
    nested: dict[str, Formula] = {"not": ALARM, "and": ALARM, "exists": ALARM, "imply": ALARM}
    robots = (Parameter("x", ("robot",)),)
    for _ in range(depth):
        nested["not"] = Not(nested["not"])
        nested["and"] = And((nested["and"],))
        nested["imply"] = Imply(Truism(), nested["imply"])
        nested["exists"] = Exists(robots, nested["exists"])
    for condition in nested.values():
        if depth > 150:
            with pytest.raises(InvalidKnowledge, match="nested deeper"):
                truth(condition, world("alarm"))
        else:
            assert truth(condition, world("alarm")) is T


def test_a_quantifier_of_many_variables() -> None:
    """The number of variables of a quantifier does not reach Python's recursion limit."""
    parameters = tuple(Parameter(f"v{i}", ("robot",)) for i in range(5000))
    assert truth(Exists(parameters, ALARM), world("alarm")) is T


def test_one_evaluation_answers_several_questions_of_one_world() -> None:
    """An Evaluation reads and derives once; its answers are those of separate questions."""
    reads = []

    class Counting(World):
        def facts(self, name: str):  # type: ignore[no-untyped-def]
            reads.append(name)
            return super().facts(name)

    state = Counting(DOMAIN, objects=OBJECTS, facts={"linked p1 p2": True, "linked p2 d1": True})
    evaluation = Evaluation(state)
    assert evaluation.truth(Atom("reach", ("p1", "d1"))) is T
    assert evaluation.truth(Atom("reach", ("d1", "p1"))) is F
    assert evaluation.truth(Atom("reach", ("?x", "p2")), {"x": "p1"}) is T
    assert reads == ["linked"]
