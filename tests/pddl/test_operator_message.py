"""Operators as messages: simple parts are in their lists."""

from kbstore.messages import AssignOp, ComparisonType, KeyValue
from kbstore.pddl.domain_reader import read_domain

DOMAIN = read_domain(
    """(define (domain d)
    (:types robot place) (:constants Home - place)
    (:predicates (at ?who - robot ?x - place) (busy ?who - robot) (dark))
    (:functions (battery ?who - robot) (cost))
    (:action visit :parameters (?r - robot ?to - (either place robot))
      :precondition (and (at ?R home) (not (busy ?r)) (> (battery ?r) (* 2 (cost))) (or (dark) (busy ?r)))
      :effect (and (dark) (not (at ?r home)) (decrease (battery ?r) 5) (when (dark) (busy ?r))))
    (:durative-action go :parameters (?r - robot) :duration (= ?duration 5)
      :condition (and (at start (dark)) (at start (not (busy ?r))) (at start (> (cost) 1))
                      (over all (busy ?r)) (over all (not (dark))) (over all (< (cost) 9))
                      (at end (at ?r home)) (at end (not (dark))) (at end (= (cost) 3))
                      (forall (?x - robot) (at end (busy ?x))))
      :effect (and (at start (busy ?r)) (at start (not (dark))) (at start (assign (cost) 1))
                   (at end (dark)) (at end (not (busy ?r))) (at end (increase (cost) ?duration))
                   (increase (battery ?r) (* #t 2)))))"""
)


def texts(formulas):
    """Formulas as PDDL."""
    return [str(formula) for formula in formulas]


def test_parameters():
    """The formula maps each parameter to its type."""
    operator = DOMAIN.operator("VISIT")
    assert operator.formula.typed_parameters == (KeyValue("r", "robot"), KeyValue("to", "(either place robot)"))


def test_instantaneous():
    """An instantaneous action has everything at start; other parts are left to the action."""
    operator = DOMAIN.operator("visit")
    (condition,) = operator.at_start_simple_condition
    assert condition.typed_parameters == (KeyValue("R", "robot"), KeyValue("home", "place"))
    assert operator.at_start_neg_condition[0].typed_parameters == (KeyValue("r", "robot"),)
    assert [str(comparison.comparison_type.pddl) for comparison in operator.at_start_comparison] == [">"]
    assert str(operator.at_start_comparison[0].RHS) == "(* 2 (cost))"
    assert not operator.at_start_comparison[0].grounded
    assert [formula.name for formula in operator.at_start_add_effects] == ["dark"]
    assert [formula.name for formula in operator.at_start_del_effects] == ["at"]
    (change,) = operator.at_start_assign_effects
    assert (change.assign_type, str(change.RHS), change.grounded) == (AssignOp.DECREASE, "5", False)
    assert change.LHS.typed_parameters == (KeyValue("r", "robot"),)
    assert len(DOMAIN.action("visit").conditions) == 4


def test_durative():
    """A durative action has lists for each time; a continuous effect begins at the start."""
    operator = DOMAIN.operator("go")
    assert {
        "start": texts(operator.at_start_simple_condition),
        "not start": texts(operator.at_start_neg_condition),
        "all": texts(operator.over_all_simple_condition),
        "not all": texts(operator.over_all_neg_condition),
        "end": [formula.name for formula in operator.at_end_simple_condition],
        "not end": texts(operator.at_end_neg_condition),
        "start adds": texts(operator.at_start_add_effects),
        "start deletes": texts(operator.at_start_del_effects),
        "end adds": texts(operator.at_end_add_effects),
        "end deletes": texts(operator.at_end_del_effects),
    } == {
        "start": ["(dark)"],
        "not start": ["(busy robot)"],
        "all": ["(busy robot)"],
        "not all": ["(dark)"],
        "end": ["at"],
        "not end": ["(dark)"],
        "start adds": ["(busy robot)"],
        "start deletes": ["(dark)"],
        "end adds": ["(dark)"],
        "end deletes": ["(busy robot)"],
    }
    assert [change.assign_type for change in operator.at_start_assign_effects] == [AssignOp.ASSIGN, AssignOp.ASSIGN_CTS]
    assert str(operator.at_end_assign_effects[0].RHS) == "?duration"
    comparisons = (operator.at_start_comparison, operator.over_all_comparison, operator.at_end_comparison)
    assert [comparison.comparison_type for (comparison,) in comparisons] == [
        ComparisonType.GREATER,
        ComparisonType.LESS,
        ComparisonType.EQUALS,
    ]
