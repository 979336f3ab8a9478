"""Conditions as PlanSys2's trees: negations before atoms, and what a tree cannot carry."""

import pytest

from kbstore.errors import InvalidKnowledge
from kbstore.interop.plansys2 import read
from kbstore.interop.plansys2_messages import MessageWriter
from kbstore.pddl.domain_reader import read_domain
from kbstore.pddl.parse import parse_condition
from kbstore.pddl.printer import condition_text
from tests.ros.plansys2_calls import Messages, text

DOMAIN = read_domain("""
(define (domain trees)
  (:types robot place)
  (:constants base - place)
  (:predicates (at ?r - robot ?p - place) (idle) (lit))
  (:functions (battery ?r - robot)))
""")


def written(condition):
    return MessageWriter(Messages(), DOMAIN).tree([parse_condition(condition, DOMAIN)])


@pytest.mark.parametrize(
    ("condition", "tree"),
    [
        ("(idle)", "(and (idle))"),
        ("(and)", ""),
        ("(and (idle) (and (lit) (idle)))", "(and (idle) (lit) (idle))"),
        ("(not (and (idle) (lit)))", "(and (or (not (idle)) (not (lit))))"),
        ("(not (or (idle) (not (lit))))", "(and (and (not (idle)) (lit)))"),
        ("(imply (idle) (lit))", "(and (or (not (idle)) (lit)))"),
        ("(not (imply (idle) (lit)))", "(and (and (idle) (not (lit))))"),
        ("(not (not (idle)))", "(and (idle))"),
        ("(not (forall (?p - place) (at r ?p)))", "(and (exists ?p:place (not (at r ?p))))"),
        ("(not (exists (?p - place) (at r ?p)))", "(and (not (exists ?p:place (at r ?p))))"),
        ("(or (and) (idle))", "(and (or (and) (idle)))"),
        ("(not (or (and) (idle)))", "(and (and (or) (not (idle))))"),
        ("(< (battery r) (- 3))", "(and (< (battery r) (- 0.0 3.0)))"),
        ("(= (/ (battery r) 2) (+ 1 (battery r)))", "(and (= (/ (battery r) 2.0) (+ 1.0 (battery r))))"),
        ("(preference p (idle))", ""),
        ("(exists (?p - place) (= ?p base))", "(and (exists ?p:place (= ?p base)))"),
    ],
)
def test_conditions_as_trees(condition, tree):
    """PlanSys2 evaluates a negated conjunction wrongly, so negations are moved to the atoms."""
    assert text(written(condition)) == tree


@pytest.mark.parametrize(
    "condition",
    [
        "(and (idle) (or (lit) (not (at r p))))",
        "(and (exists (?p - place) (and (at r ?p) (not (= ?p base)))))",
        "(and (>= (battery r) (+ 1 (* 2 (battery r)))))",
    ],
)
def test_a_tree_reads_back_as_the_condition(condition):
    """A written tree is read as the same condition; a PARAMETER has its name among its parameters."""
    assert condition_text(read(written(condition))) == condition


@pytest.mark.parametrize("condition", ["(forall (?p - place) (at r ?p))", "r - robot"])
def test_conditions_without_a_tree_are_refused(condition):
    """It is refused, as PlanSys2 would not evaluate it."""
    with pytest.raises(InvalidKnowledge, match="PlanSys2's messages cannot carry"):
        written(condition)
