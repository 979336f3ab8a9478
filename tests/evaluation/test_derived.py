import random
from itertools import product

import pytest
from hypothesis import given, settings

from kbstore.errors import InvalidKnowledge, UnknownSymbol
from kbstore.evaluation import when
from kbstore.evaluation.conditions import Evaluation, truth
from kbstore.messages import ComparisonType, Truth
from kbstore.model.domain import DerivedRule, Domain
from kbstore.model.formulas import (
    And,
    Atom,
    Comparison,
    Exists,
    Forall,
    Formula,
    Imply,
    Not,
    Or,
    Parameter,
    Preference,
    Truism,
)
from kbstore.model.stratification import strata
from tests.evaluation import brute_force
from tests.evaluation.interpretations import History, World, signatures
from tests.evaluation.strategies import DOMAIN, RULES, exists, forall, rule, worlds

T, F, U = Truth.TRUE, Truth.FALSE, Truth.UNKNOWN


def domain(*rules: DerivedRule, predicates: tuple[str, ...] = ()) -> Domain:
    """A domain of nodes with rules, one declaration for each head, and further predicates."""
    by_name: dict[str, tuple[DerivedRule, ...]] = {}
    for each in rules:
        by_name[each.head.name] = (*by_name.get(each.head.name, ()), each)
    declared = {each.head.name: each.head for each in reversed(rules)}
    return Domain(
        "graph",
        types={"node": "object", "leaf": "node"},
        predicate_signatures={**signatures("edge a:node b:node", "marked n:node", *predicates), **declared},
        function_signatures=signatures("cost n:node"),
        rules=by_name,
    )


def graph(about: Domain, *edges: str, unknowns: bool = False, **facts: bool) -> World:
    """Nodes a to e with the edges ``"ab"``."""
    facts = {f"edge {a} {b}": True for a, b in map(tuple, edges)} | {
        f.replace("_", " "): sign for f, sign in facts.items()
    }
    return World(about, use_unknowns=unknowns, objects=dict.fromkeys("abcde", "node"), facts=facts)


EDGE_XY, REACH_XY = Atom("edge", ("?x", "?y")), Atom("reach", ("?x", "?y"))
STEP = exists("z:node", And((Atom("edge", ("?x", "?z")), Atom("reach", ("?z", "?y")))))
REACH = domain(rule("reach x:node y:node", Or((EDGE_XY, STEP))))


@settings(max_examples=40, deadline=None)
@given(worlds())
def test_v9_every_derived_atom_of_random_worlds(world: World) -> None:
    """V9: derived predicates equal the naive fixpoints of all ground rules, in closed and open worlds."""
    table = brute_force.derived_table(world)
    evaluation = Evaluation(world)
    for name in RULES:
        parameters = DOMAIN.predicate_signatures[name].parameters
        for row in product(*(world.objects(p.types) for p in parameters)):
            expected = brute_force.TRUTHS[table.get((name, row), brute_force.FALSE)]
            assert evaluation.truth(Atom(name, row)) is expected


def test_v9_transitive_closure() -> None:
    """V9: an atom is true if derivable; otherwise it is false in a closed world."""
    world = graph(REACH, "ab", "bc", "de", "ed")
    true = {pair for pair in product("abcde", repeat=2) if truth(Atom("reach", pair), world) is T}
    assert true == set(map(tuple, ("ab", "bc", "ac", "de", "ed", "dd", "ee")))
    assert truth(Atom("reach", ("c", "?")), world) is F
    assert truth(Atom("reach", ("?", "c")), world) is T


def test_v9_in_an_open_world_false_needs_proof() -> None:
    """V9: false only if not derivable even where unknown is read as true."""
    denied = {f"edge_{a}_{b}": False for a, b in product("abc", "de")}
    world = graph(REACH, "ab", "bc", unknowns=True, **denied)
    assert truth(Atom("reach", ("a", "c")), world) is T
    assert truth(Atom("reach", ("c", "a")), world) is U
    assert truth(Atom("reach", ("a", "d")), world) is F
    assert truth(Not(Atom("reach", ("a", "d"))), world) is T
    assert truth(Atom("reach", ("a", "?")), world) is T


def test_v8_a_wildcard_next_to_a_missing_object() -> None:
    """V7, V8: in an open world the atom is unknown while objects of the type exist, and false if there are none."""
    wild = Atom("reach", ("?", "ghost"))
    assert truth(wild, graph(REACH, unknowns=True)) is U
    assert truth(wild, World(REACH, use_unknowns=True)) is F
    trajectory = History((0, 100), REACH, use_unknowns=True, objects={"a": [(10, 30, "node")]})
    assert when.truths(wild, trajectory) == [(0, 10, F), (10, 30, U), (30, 100, F)]


def test_v8_a_rule_may_name_a_missing_object() -> None:
    """V8, V9: a derived predicate of it is absent, in an open world unknown, also by a recursive rule."""
    step = exists("y:node", And((EDGE_XY, Atom("p", ("?y",)), Atom("low", ("ghost",)))))
    about = domain(rule("p x:node", Or((Atom("marked", ("?x",)), step))), rule("low x:node", Atom("marked", ("?x",))))
    facts = {f"edge_{a}_{b}": a + b in ("ab", "bc", "cd", "de") for a, b in product("abcde", repeat=2)}
    facts |= {f"marked_{n}": n == "e" for n in "abcde"}
    for unknowns, expected in ((False, [F, F, F, F, T]), (True, [U, U, U, U, T])):
        world = graph(about, unknowns=unknowns, **facts)
        assert [truth(Atom("p", (n,)), world) for n in "abcde"] == expected


def test_v7_a_wildcard_matches_existing_objects_only() -> None:
    """V7: existing objects of the parameter's type, in questions, in rules and over time."""
    about = domain(rule("leads x:node", Atom("edge", ("?x", "?"))))
    objects, facts = {"a": "node", "c": "object"}, {"edge a ghost": True, "edge a c": True}
    world, trajectory = World(about, objects=objects, facts=facts), History((0, 10), about, objects=objects)
    trajectory.pieces_of_facts = {row: [(0, 10, True)] for row in world.signs}
    for wild in (Atom("edge", ("a", "?")), Atom("leads", ("a",))):
        assert truth(wild, world) is F
        assert when.intervals(wild, trajectory) == []


def test_v9_derived_predicates_change_when_objects_come_and_go() -> None:
    """V9, Q4: with the objects of heads, of quantifiers and of wildcards, and with those that a rule names."""
    about = domain(
        rule("p x:node", Truism()),
        rule("some", exists("x:leaf", Truism())),
        rule("quiet", Not(Atom("marked", ("?",)))),
        rule("strange", Atom("p", ("c",))),
    )
    objects = {"a": [(0, 100, "node")], "b": [(10, 30, "leaf")], "c": [(40, 50, "object")]}
    trajectory = History((0, 100), about, objects=objects, facts={"marked a": [(0, 100, False)]}, use_unknowns=True)
    assert when.intervals(Atom("p", ("b",)), trajectory) == [(10, 30)]
    assert when.intervals(Atom("some"), trajectory) == [(10, 30)]
    assert when.truths(Atom("quiet"), trajectory) == [(0, 10, T), (10, 30, U), (30, 100, T)]
    assert when.truths(Atom("strange"), trajectory) == [(0, 40, U), (40, 50, F), (50, 100, U)]


def test_v9_a_comparison_without_a_value_makes_unknown() -> None:
    """V9, V5: in a closed world, too, an atom that depends on an undefined function is unknown."""
    cheap = Comparison(ComparisonType.LESS, (Atom("cost", ("?x",)),), (5.0,))
    about = domain(
        rule("good x:node", And((Atom("marked", ("?x",)), cheap))),
        rule("some", exists("x:node", Atom("good", ("?x",)))),
        rule("none", Not(Atom("some"))),
    )
    world = graph(about, marked_a=True, marked_b=True)
    world.values = World(numbers={"cost b": 7.0, "cost c": 1.0}).values
    assert [truth(Atom("good", (n,)), world) for n in "abc"] == [U, F, F]
    assert [truth(Atom(name), world) for name in ("some", "none")] == [U, U]
    world.values |= World(numbers={"cost a": 1.0}).values
    assert [truth(Atom(name), world) for name in ("some", "none")] == [T, F]


def test_v9_heads_range_over_the_types_of_rule_and_declaration() -> None:
    """V9: a rule derives only atoms with the types of its own head and of the predicate's declaration."""
    about = domain(rule("p x:node", Or(())), rule("p x:leaf", Truism()), rule("p x", Atom("marked", ("?x",))))
    world = World(about, objects={"a": "node", "b": "leaf", "c": "object"}, facts={"marked a": True, "marked c": True})
    assert [truth(Atom("p", (n,)), world) for n in "abc"] == [T, T, F]


def test_v9_rules_with_quantifiers_of_one_name() -> None:
    """V9: variables of different quantifiers are independent, even with equal names."""
    twice = And(
        (exists("y:node", EDGE_XY), exists("y:node", Atom("edge", ("?y", "?x"))), Not(Atom("edge", ("?x", "?y"))))
    )
    about = domain(rule("inner x:node", exists("y:node", twice)), rule("loose x:node", Atom("edge", ("?x", "?y"))))
    world = graph(about, "ab", "bc")
    assert [n for n in "abcde" if truth(Atom("inner", (n,)), world) is T] == ["b"]
    assert [n for n in "abcde" if truth(Atom("loose", (n,)), world) is T] == ["a", "b"]
    apart = And((exists("z:node", Atom("marked", ("?z",))), Atom("edge", ("?x", "?z"))))
    world = graph(domain(rule("apart x:node", apart)), "ab", marked_c=True)
    assert [n for n in "abcde" if truth(Atom("apart", (n,)), world) is T] == ["a"]


def test_v9_a_head_may_name_a_variable_twice() -> None:
    """V9: the rule's arguments are then the same object."""
    about = domain(rule("same x:node x:node", Atom("marked", ("?x",))), predicates=())
    world = graph(about, marked_a=True)
    assert truth(Atom("same", ("a", "a")), world) is T
    assert truth(Atom("same", ("a", "b")), world) is F
    assert truth(Atom("same", ("b", "b")), World(about, use_unknowns=True, objects={"a": "node", "b": "node"})) is U


def test_v9_rules_that_are_never_true_and_heads_without_arguments() -> None:
    """V9: a predicate whose rules are never true is false, in an open world, too; heads may lack arguments."""
    about = domain(rule("never", Or(())), rule("always", Preference("p", Truism())))
    assert truth(Atom("never"), graph(about, unknowns=True)) is F
    assert truth(Atom("always"), graph(about)) is T


def test_v9_many_alternatives_in_one_rule() -> None:
    """V9: a rule whose disjunctions multiply enormously is evaluated all the same."""
    choice = Or((Atom("marked", ("?x",)), exists("z:node", And((Atom("edge", ("?x", "?z")), Atom("p", ("?z",)))))))
    about = domain(rule("p x:node", And((choice,) * 12)))
    world = graph(about, "ab", "bc", "de", marked_c=True)
    assert [n for n in "abcde" if truth(Atom("p", (n,)), world) is T] == ["a", "b", "c"]


@pytest.mark.parametrize("unknowns", [False, True])
@pytest.mark.parametrize("density", [0.0, 0.02, 1.0])
def test_v9_the_closure_of_200_nodes(density: float, unknowns: bool) -> None:
    """V9: the closure of a random graph equals that of Warshall's algorithm, found without trying all triples."""
    size, chance = 200, random.Random(7)
    nodes = [f"n{i}" for i in range(size)]
    successors = [{j for j in range(size) if j == i + 1 or chance.random() < density} for i in range(size)]
    facts = {f"edge n{i} n{j}": True for i in range(size) for j in successors[i]}
    for k in range(size):
        for i in range(size):
            if k in successors[i]:
                successors[i] |= successors[k]
    world = World(REACH, use_unknowns=unknowns, objects=dict.fromkeys(nodes, "node"), facts=facts)
    certain, possible = Evaluation(world).derived.relations("reach")
    assert set(certain) == {(nodes[i], nodes[j]) for i in range(size) for j in successors[i]}
    assert len(possible) == (size * size if unknowns else len(certain))


def test_only_needed_predicates_are_derived() -> None:
    """A question derives only the predicates that it names and those on which they depend."""
    about = domain(
        rule("reach x:node y:node", Or((EDGE_XY, STEP))),
        rule("hit x:node", Atom("target", ("?x",))),
        predicates=("target n:node",),
    )
    asked = []

    class Counting(World):
        def facts(self, name: str):  # type: ignore[no-untyped-def]
            asked.append(name)
            return super().facts(name)

    world = Counting(about, objects={"a": "node"}, facts={"edge a a": True})
    assert truth(Atom("reach", ("a", "a")), world) is T
    assert asked == ["edge"]


def test_deep_rules_and_deep_questions() -> None:
    """V9: rules and questions may be deep together."""

    def nested(condition: Formula) -> Formula:
        for _ in range(75):
            condition = Exists((Parameter("v", ("node",)),), And((condition, Truism())))
        return condition

    about = domain(rule("p x:node", nested(Atom("marked", ("?x",)))), rule("q x:node", nested(Atom("p", ("?x",)))))
    question = nested(Atom("q", ("a",)))
    assert truth(question, World(about, objects={"a": "node"}, facts={"marked a": True})) is T
    trajectory = History((0, 100), about, objects={"a": "node"}, facts={"marked a": [(2, 5, True)]})
    assert when.intervals(question, trajectory) == [(2, 5)]


# -- strata ---------------------------------------------------------------------------------------------------


def test_strata_come_in_the_order_of_evaluation() -> None:
    """V9: each stratum depends on those before it; mutually recursive predicates share one."""
    order = strata(DOMAIN)
    assert sorted(map(sorted, order)) == [["calm"], ["even", "odd"], ["low"], ["reach"], ["stuck"]]
    assert order.index(frozenset({"reach"})) < order.index(frozenset({"stuck"})) < order.index(frozenset({"calm"}))
    assert order.index(frozenset({"low"})) < order.index(frozenset({"calm"}))


P, Q = Atom("p", ("?x",)), Atom("q", ("?x",))


@pytest.mark.parametrize(
    "body",
    [
        Not(Q),
        Imply(Q, Truism()),
        Not(And((Truism(), Or((Q, Truism()))))),
        forall("y:node", Imply(Atom("q", ("?y",)), EDGE_XY)),
    ],
)
def test_recursion_through_a_negation_is_refused(body: Formula) -> None:
    """V9: rules must be stratified."""
    about = domain(rule("p x:node", body), rule("q x:node", Or((Atom("marked", ("?x",)), P))))
    with pytest.raises(InvalidKnowledge, match="p depends on itself through the negation of q"):
        strata(about)
    with pytest.raises(InvalidKnowledge, match="stratified"):
        truth(Atom("p", ("a",)), graph(about))


def test_a_predicate_under_two_negations_counts_as_positive() -> None:
    """V9: recursion through a double negation is allowed, as it is positive."""
    about = domain(
        rule(
            "p x:node",
            Not(And((Not(Atom("marked", ("?x",))), Not(exists("y:node", And((EDGE_XY, Atom("p", ("?y",))))))))),
        )
    )
    assert strata(about) == [frozenset({"p"})]
    world = graph(about, "ab", "bc", marked_c=True)
    assert [n for n in "abcde" if truth(Atom("p", (n,)), world) is T] == ["a", "b", "c"]


def test_a_long_chain_of_rules_does_not_recurse() -> None:
    """V9: 3,000 derived predicates, each from the next, stay below Python's recursion limit."""
    size = 3_000
    chain = [rule(f"p{i}", Atom(f"p{i + 1}") if i < size - 1 else Truism()) for i in range(size)]
    about = domain(*chain)
    assert strata(about) == [frozenset({f"p{i}"}) for i in reversed(range(size))]
    assert truth(Atom("p0"), World(about)) is T


def test_rules_that_are_not_well_formed_are_refused() -> None:
    """V8: an unknown symbol in a rule is refused when a derived predicate is asked for."""
    about = domain(rule("p x:node", Truism()), rule("q x:node", Forall((), Atom("nothing", ("?x",)))))
    with pytest.raises(UnknownSymbol, match="no predicate nothing"):
        truth(Atom("p", ("a",)), graph(about))
    wrong = Domain("d", predicate_signatures=signatures("p a b"), rules={"p": (rule("p a", Truism()),)})
    with pytest.raises(InvalidKnowledge, match="declared as"):
        truth(Atom("p", ("a", "b")), World(wrong))
