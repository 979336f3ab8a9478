import pytest
from hypothesis import given, settings

from kbstore.errors import UnknownSymbol
from kbstore.evaluation.conditions import deciding, truth
from kbstore.messages import ComparisonType, Truth
from kbstore.model.formulas import (
    And,
    Atom,
    Comparison,
    Defined,
    Formula,
    Imply,
    IsA,
    Not,
    Or,
    Preference,
    Same,
    Truism,
)
from tests.evaluation import brute_force
from tests.evaluation.interpretations import World
from tests.evaluation.strategies import DOMAIN, conditions, exists, forall, worlds

T, F, U = Truth.TRUE, Truth.FALSE, Truth.UNKNOWN
ALARM = Atom("alarm")
AT1, AT2 = Atom("at", ("r1", "p1")), Atom("at", ("r2", "p1"))
FREE1, FREE2 = Atom("free", ("p1",)), Atom("free", ("p2",))
OBJECTS = {"r1": "robot", "r2": "robot", "p1": "place", "p2": "place"}
WORLD = World(DOMAIN, objects=OBJECTS, facts={"at r1 p1": True, "free p2": True}, numbers={"level r1": 10.0})
OPEN = World(DOMAIN, objects=OBJECTS, facts={"free p2": True, "alarm": False}, use_unknowns=True)
POOR = Comparison(ComparisonType.LESS, (Atom("level", ("?r",)),), (20.0,))


@pytest.mark.parametrize(
    ("condition", "parts"),
    [
        (AT1, [(AT1, T)]),
        (Not(AT1), [(AT1, T)]),
        (Truism(), [(Truism(), T)]),
        (And(()), [(And(()), T)]),
        (And((AT1, Truism())), [(AT1, T)]),
        (And((AT1, FREE2)), [(AT1, T), (FREE2, T)]),
        (And((AT1, FREE1, AT2)), [(FREE1, F)]),
        (Or((FREE1, AT1, FREE2)), [(AT1, T)]),
        (Or((FREE1, AT2)), [(FREE1, F), (AT2, F)]),
        (Imply(FREE1, AT2), [(FREE1, F)]),
        (Imply(AT1, FREE1), [(AT1, T), (FREE1, F)]),
        (Preference("wish", And((AT1, Not(FREE1)))), [(AT1, T), (FREE1, F)]),
        (And((AT1, Or((AT1, FREE2)))), [(AT1, T)]),
        (Same("r1", "r2"), [(Same("r1", "r2"), F)]),
        (IsA("r1", "place"), [(IsA("r1", "place"), F)]),
        (Defined(Atom("level", ("?",))), [(Defined(Atom("level", ("r1",))), T)]),
    ],
)
def test_the_first_decisive_part_or_all_that_are_needed(condition: Formula, parts: list[tuple[Formula, Truth]]) -> None:
    """V6: a false conjunction and a true disjunction are decided by one part, the others by all parts."""
    assert deciding(condition, WORLD) == parts


def test_unknown_is_decided_by_all_unknown_parts() -> None:
    """V6: only the unknown parts make the answer unknown."""
    assert deciding(And((FREE2, FREE1, AT1)), OPEN) == [(FREE1, U), (AT1, U)]
    assert deciding(Or((ALARM, FREE1)), OPEN) == [(FREE1, U)]
    assert deciding(And((FREE1, ALARM)), OPEN) == [(ALARM, F)]


def test_a_witness_or_a_counterexample_replaces_its_quantifier() -> None:
    """V6: a true exists and a false forall are decided by one instance, with its objects."""
    somewhere = exists("r:robot p:place", And((Atom("at", ("?r", "?p")), POOR)))
    poor = Comparison(ComparisonType.LESS, (Atom("level", ("r1",)),), (20.0,))
    assert deciding(somewhere, WORLD) == [(AT1, T), (poor, T)]
    everywhere = forall("p:place", Atom("free", ("?P",)))
    assert deciding(everywhere, World(DOMAIN, objects={"p1": "place"}, facts={"free home": True})) == [(FREE1, F)]


def test_a_quantifier_that_needs_all_instances_is_one_part() -> None:
    """V6: a false exists and a true forall stay whole; variables that are bound outside are filled in."""
    nowhere = exists("p:place", Atom("at", ("?r", "?p")))
    assert deciding(nowhere, WORLD, {"r": "r2"}) == [(exists("p:place", Atom("at", ("r2", "?p"))), F)]
    empty = forall("x:dock", Same("?x", "home"))
    assert deciding(empty, WORLD) == [(empty, T)]


def test_a_wildcard_is_replaced_by_the_first_match() -> None:
    """V6: a true atom with a wildcard is decided by a fact; where no fact matches, it stays as it is."""
    assert deciding(Atom("at", ("?", "?where")), WORLD) == [(AT1, T)]
    assert deciding(Not(Atom("at", ("r2", "?"))), WORLD) == [(Atom("at", ("r2", "?")), F)]
    linked = World(DOMAIN, objects=OBJECTS, facts={"linked p1 p2": True})
    assert deciding(Atom("reach", ("?", "p2")), linked) == [(Atom("reach", ("p1", "p2")), T)]


def test_bindings_are_filled_in() -> None:
    """V6: parts have objects for the variables that the caller binds; names stay as written."""
    assert deciding(And((Atom("AT", ("?R", "P1")), FREE2)), WORLD, {"r": "r1"})[0] == (Atom("AT", ("r1", "P1")), T)


def test_questions_are_checked_first() -> None:
    """V8: unknown symbols are refused also in parts that decide nothing."""
    with pytest.raises(UnknownSymbol, match="no predicate flies"):
        deciding(Or((AT1, Atom("flies"))), WORLD)


@settings(max_examples=50, deadline=None)
@given(conditions(), worlds())
def test_every_deciding_part_has_the_returned_truth_value(condition: Formula, world: World) -> None:
    """V6: parts are ground, contain no connectives, and have the returned truth value."""
    parts = deciding(condition, world)
    assert parts
    for part, part_truth in parts:
        assert not isinstance(part, Not | Imply | Preference)
        assert truth(part, world) is brute_force.truth(part, world) is part_truth
