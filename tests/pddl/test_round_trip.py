"""Written formulas and items read back equal."""

import pytest
from hypothesis import example, given, settings

from kbstore.conversion import composite_of, from_composite, unlabelled
from kbstore.messages import AssignOp, ComparisonType, Function, Operator
from kbstore.model.formulas import Add, Atom, Comparison, Delete, Forall, ForEach, NumericEffect, Parameter, When
from kbstore.pddl.domain_reader import read_domain
from kbstore.pddl.parse import parse_condition, parse_expression, parse_item
from kbstore.pddl.printer import condition_text, effect_text, expression_text
from kbstore.pddl.sexpr import SourceText, node_text
from tests.pddl import strategies


def shape(expression):
    """An expression with the types of its tokens, as numbers of different types may be equal."""
    return [(type(token), token, repr(token)) for token in expression]


@settings(deadline=None)
@given(strategies.expressions())
def test_expressions(expression):
    """Expressions read back from their text, and from their message, to the last bit of each number."""
    assert shape(parse_expression(expression_text(expression))) == shape(expression)
    assert shape(from_composite(composite_of(expression, unlabelled))) == shape(expression)
    assert str(composite_of(expression, unlabelled)) == expression_text(expression)


@settings(deadline=None)
@given(strategies.conditions())
def test_conditions(condition):
    """Conditions read back from their text, which is canonical."""
    text = condition_text(condition)
    found = parse_condition(text)
    assert found == condition
    assert condition_text(found) == text
    assert node_text(SourceText(text).read()) == text


@settings(deadline=None)
@given(strategies.facts | strategies.instances)
def test_items(item):
    """Facts and objects read back from their text."""
    assert parse_item(str(item)) == item


@settings(deadline=None)
@given(strategies.functions)
def test_functions(item):
    """Values, changes and rates read back from their text."""
    found = parse_item(str(item))
    assert isinstance(found, Function)
    assert found == item
    assert repr(found.function_value) == repr(item.function_value)


@settings(deadline=None)
@given(strategies.comparisons())
@example(Comparison(ComparisonType.GREATER, (Operator.ADD, 0.0, -0.0), (0.0,)))
def test_inequalities(comparison):
    """Comparisons are items that read back from their text."""
    text = condition_text(comparison)
    item = parse_item(text)
    if not (isinstance(item, Function) and item.assign_op is AssignOp.ASSIGN):
        assert str(item) == text
        assert parse_item(str(item)) == item


def test_effects():
    """Effects of every kind are written as they were read."""
    effects = (
        "(p ?x)",
        "(not (p ?x))",
        "(increase (f) (+ (f) 1))",
        "(when (and (p ?x) (not (p ?x))) (and (p ?x) (assign (f) 2)))",
        "(forall (?y - object) (when (p ?y) (not (p ?y))))",
    )
    domain = read_domain(
        f"""(define (domain d) (:predicates (p ?x)) (:functions (f))
        (:action a :parameters (?x) :effect (and {" ".join(effects)}))
        (:durative-action b :duration () :effect (decrease (f) (* #t (f)))))"""
    )
    assert tuple(effect_text(effect) for _, effect in domain.action("a").effects) == effects
    assert [effect_text(effect) for _, effect in domain.action("b").effects] == ["(increase (f) (* #t (- (f))))"]


def test_effects_that_depend_on_the_start():
    """An effect has no time of its own in its text, so only the other time is written."""
    domain = read_domain(
        """(define (domain d) (:predicates (p ?x) (q)) (:durative-action a :duration ()
        :effect (forall (?x) (when (and (at start (and (p ?x) (q))) (at end (not (q)))) (at end (not (p ?x)))))))"""
    )
    assert [(timing.value, effect_text(effect)) for timing, effect in domain.action("a").effects] == [
        ("at end", "(forall (?x - object) (when (at start (and (p ?x) (q))) (when (not (q)) (not (p ?x)))))")
    ]


def test_built_effects():
    """Effects built by a program are written, too."""
    p = Atom("p")
    effect = ForEach(
        (Parameter("x", ("a", "b")),),
        (When(Forall((), p), (Add(p), Delete(p))), NumericEffect(AssignOp.ASSIGN_CTS, p, (1.0,))),
    )
    assert effect_text(effect) == (
        "(forall (?x - (either a b)) (and (when (forall () (p)) (and (p) (not (p)))) (increase (p) (* #t 1))))"
    )


@pytest.mark.parametrize(
    "text",
    [
        "(+ (f) 1 2 (g))",
        "(* 2 (f) 3)",
        "(+ 1 (+ 2 3 4) 5)",
        "(* (+ 1 2 3) 4 (- 5 6))",
        "(- (- 1 2) 3)",
        "(/ (/ 1 2) 3)",
    ],
)
def test_sums_and_products_of_several_operands(text):
    """P5: they are written as they were read, not nested; a difference of three has to be nested."""
    assert expression_text(parse_expression(text)) == text
    assert str(composite_of(parse_expression(text), unlabelled)) == text


def test_a_sum_of_a_sum_is_one():
    """P5: (+ (+ 1 2) 3) has the same value to the last bit, and the same tokens, as (+ 1 2 3)."""
    assert expression_text(parse_expression("(+ (+ 1 2) 3)")) == "(+ 1 2 3)"
    assert expression_text(parse_expression("(+ 1 (+ 2 3))")) == "(+ 1 (+ 2 3))"
