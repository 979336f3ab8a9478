"""Formulas: the children of a node, and replacing them."""

from typing import get_args

import pytest

from kbstore.messages import AssignOp, ComparisonType
from kbstore.model.formulas import (
    Add,
    And,
    AssignObject,
    Atom,
    Comparison,
    Defined,
    Delete,
    Effect,
    Exists,
    Forall,
    ForEach,
    Formula,
    Imply,
    IsA,
    Not,
    NumericEffect,
    Or,
    Parameter,
    Preference,
    Same,
    Truism,
    When,
    WhenAtStart,
    children,
    map_children,
)

P, Q, R = Atom("p"), Atom("q"), Atom("r", ("?x",))
X = (Parameter("x", ("place",)),)

CONDITIONS = {
    Atom("p"): (),
    Truism(): (),
    Not(P): (P,),
    And((P, Q)): (P, Q),
    Or((P, Q, P)): (P, Q, P),
    Imply(P, Q): (P, Q),
    Exists(X, R): (R,),
    Forall(X, R): (R,),
    Same("a", "b"): (),
    Comparison(ComparisonType.LESS, (1.0,), (2.0,)): (),
    Defined(P): (),
    IsA("a", "place"): (),
    Preference("nice", P): (P,),
}

EFFECTS = {
    Add(P): (),
    Delete(P): (),
    NumericEffect(AssignOp.ASSIGN, P, (1.0,)): (),
    AssignObject(P, "a"): (),
    When(P, (Add(Q), Delete(P))): (P, Add(Q), Delete(P)),
    WhenAtStart(P, (Add(Q),)): (P, Add(Q)),
    ForEach(X, (Add(R),)): (Add(R),),
}


def test_the_examples_cover_every_kind_of_node():
    """A new kind of node of the model needs an example here."""
    assert {type(node) for node in CONDITIONS} == set(get_args(Formula))
    assert {type(node) for node in EFFECTS} == set(get_args(Effect))


@pytest.mark.parametrize("node", [*CONDITIONS, *EFFECTS], ids=str)
def test_children_are_the_direct_parts(node):
    """`children` has the parts in the order of the text, without those further down."""
    assert children(node) == {**CONDITIONS, **EFFECTS}[node]
    assert children(Not(node)) == (node,)


@pytest.mark.parametrize("node", CONDITIONS, ids=str)
def test_children_are_mapped_in_place(node):
    """`map_children` replaces each child, and keeps everything else of the node."""
    assert map_children(node, lambda part: part) == node
    mapped = map_children(node, Not)
    assert type(mapped) is type(node)
    assert children(mapped) == tuple(Not(part) for part in CONDITIONS[node])
    assert getattr(mapped, "parameters", None) == getattr(node, "parameters", None)
    assert getattr(mapped, "name", None) == getattr(node, "name", None)
