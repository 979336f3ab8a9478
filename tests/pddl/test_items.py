"""The text forms of knowledge items."""

import pytest

from kbstore.conversion import composite_of, from_composite, unlabelled
from kbstore.errors import InvalidKnowledge, KbStoreError, PddlSyntaxError
from kbstore.messages import (
    AssignOp,
    ComparisonType,
    Expression,
    Fact,
    Function,
    Inequality,
    Instance,
    KeyValue,
    Operator,
    SpecialType,
)
from kbstore.pddl.domain_reader import read_domain
from kbstore.pddl.parse import parse_item

DOMAIN = read_domain(
    """(define (domain d) (:types robot waypoint)
    (:predicates (robot_at ?r - robot ?wp - waypoint) (docked))
    (:functions (battery ?r - robot) (distance ?a ?b - waypoint) (cost)))"""
)


class TestObjects:
    @pytest.mark.parametrize("text", ["wp7 - waypoint", "(wp7 - waypoint)", "wp7 -waypoint", "wp7- waypoint"])
    def test_positive(self, text):
        """An object with its type, also where the '-' is glued to a name."""
        assert parse_item(text) == Instance(instance_name="wp7", instance_type="waypoint")

    def test_negative(self):
        """(not (wp7 - waypoint)) is the end of the object."""
        assert parse_item("(not (wp7 - waypoint))") == Instance(
            instance_name="wp7", instance_type="waypoint", is_negative=True
        )

    def test_without_type(self):
        """A name alone is an object, for a removal or a question."""
        assert parse_item("wp7") == Instance(instance_name="wp7")

    @pytest.mark.parametrize(
        "text", ["docked", "battery", "cost", "robot_at kenny wp0", "- waypoint", "a - -", "a b c"]
    )
    def test_without_brackets(self, text):
        """A fact without its brackets is refused, with the right spelling."""
        with pytest.raises(PddlSyntaxError):
            parse_item(text, DOMAIN)


class TestFacts:
    def test_positive_and_negative(self):
        """A fact of each sign."""
        fact = parse_item("(robot_at Kenny wp0)")
        assert fact == Fact(attribute_name="robot_at", values=["Kenny", "wp0"])
        assert parse_item("(not (robot_at Kenny wp0))") == fact.changed(is_negative=True)
        assert parse_item("(not (not (robot_at Kenny wp0)))") == fact

    def test_labels(self):
        """With a domain the arguments get the labels of its declaration, in order (rule D1)."""
        item = parse_item("(robot_at kenny wp0)", DOMAIN)
        assert item.values == (KeyValue("r", "kenny"), KeyValue("wp", "wp0"))

    def test_wrong_arity_is_left_to_the_check(self):
        """An item that does not fit the domain is read, so that all violations are reported together (rule D1)."""
        assert parse_item("(robot_at kenny)", DOMAIN).labels == ("",)
        assert parse_item("(nonsense kenny)", DOMAIN) == Fact(attribute_name="nonsense", values=["kenny"])

    def test_patterns(self):
        """Patterns keep their variables (rule V7)."""
        assert parse_item("(robot_at ? ?wp)").arguments == ("?", "?wp")

    @pytest.mark.parametrize("word", ["at", "over", "start", "minimise", "when", "total-time", "is-violated"])
    def test_keywords_as_names(self, word):
        """Keywords are names of predicates here."""
        assert parse_item(f"({word} a b)") == Fact(attribute_name=word, values=["a", "b"])

    def test_minus_and_digits(self):
        """Arguments may look like numbers."""
        assert parse_item("(p 7 3d -x)").arguments == ("7", "3d", "-x")


class TestFunctions:
    @pytest.mark.parametrize(
        ("text", "operation", "value"),
        [
            ("(= (battery kenny) 3.5)", AssignOp.ASSIGN, 3.5),
            ("(assign (battery kenny) -2)", AssignOp.ASSIGN, -2.0),
            ("(increase (battery kenny) 2)", AssignOp.INCREASE, 2.0),
            ("(decrease (battery kenny) .5)", AssignOp.DECREASE, 0.5),
            ("(scale-up (battery kenny) 1e3)", AssignOp.SCALE_UP, 1000.0),
            ("(SCALE-DOWN (battery kenny) 4.)", AssignOp.SCALE_DOWN, 4.0),
            ("(increase (battery kenny) (* #t 2))", AssignOp.ASSIGN_CTS, 2.0),
            ("(increase (battery kenny) (* 2 #t))", AssignOp.ASSIGN_CTS, 2.0),
            ("(decrease (battery kenny) (* #t 0.25))", AssignOp.ASSIGN_CTS, -0.25),
            ("(decrease (battery kenny) (* #T (- 3)))", AssignOp.ASSIGN_CTS, 3.0),
            ("(increase (battery kenny) #t)", AssignOp.ASSIGN_CTS, 1.0),
            ("(= (battery kenny) (- 5))", AssignOp.ASSIGN, -5.0),
        ],
    )
    def test_operations(self, text, operation, value):
        """Every assignment operator, and rates (rule C7)."""
        assert parse_item(text) == Function(
            attribute_name="battery", values=["kenny"], function_value=value, assign_op=operation
        )

    def test_without_brackets(self):
        """A function without parameters may stand without brackets before its value."""
        assert parse_item("(= total-cost 0)") == Function(attribute_name="total-cost", function_value=0)
        assert parse_item("(increase total-cost 2)") == Function(
            attribute_name="total-cost", function_value=2, assign_op=AssignOp.INCREASE
        )

    def test_asking(self):
        """Where the domain declares it as a function, its term asks whether it is defined (rule V7)."""
        assert parse_item("(battery kenny)", DOMAIN) == Function(
            attribute_name="battery", values=[KeyValue("r", "kenny")], function_value=None
        )
        assert isinstance(parse_item("(battery kenny)"), Fact)
        assert parse_item("(not (battery kenny))", DOMAIN).is_negative

    def test_labels(self):
        """With a domain the arguments get their labels."""
        assert parse_item("(= (distance a b) 1)", DOMAIN).labels == ("a", "b")

    @pytest.mark.parametrize(
        "text",
        [
            "(increase (f) (g))",
            "(increase (f) (* 2 (g)))",
            "(increase (f) (* #t (g)))",
            "(increase (f) (* #t #t))",
            "(assign (f) (* #t 2))",
            "(not (= (f) 3))",
            "(increase (f))",
            "(= (f) 1e999)",
            "(= (f) nan)",
            "(= (f) (g))",
            "(= 3 4 5)",
            "(= a b)",
            "(assign 3 4)",
            "(assign ?x 4)",
        ],
    )
    def test_refused(self, text):
        """A change by anything but a number or a constant rate is not an item."""
        try:
            item = parse_item(text)
        except KbStoreError:
            return
        assert isinstance(item, Inequality)


class TestInequalities:
    @pytest.mark.parametrize("comparison", list(ComparisonType))
    def test_comparisons(self, comparison):
        """Every comparison of two expressions; = of a function and a number is a value instead."""
        item = parse_item(f"({comparison.pddl} (+ (f a) 1) (* (g) (- 2)))")
        assert isinstance(item, Inequality)
        assert item.ineq.comparison_type is comparison
        assert from_composite(item.ineq.LHS)[0] is Operator.ADD
        assert from_composite(item.ineq.RHS)[2:] == (Operator.UMINUS, 2.0)
        assert item.ineq.grounded

    def test_equality_of_functions(self):
        """(= (f a) (g b)) compares."""
        assert isinstance(parse_item("(= (f a) (g b))"), Inequality)

    def test_negative(self):
        """An inequality may be negative."""
        assert parse_item("(not (> (f) 3))").is_negative

    def test_labels(self):
        """With a domain the functions in it are labelled."""
        item = parse_item("(> (battery kenny) 3)", DOMAIN)
        assert item.ineq.LHS.tokens[0].function.typed_parameters == (KeyValue("r", "kenny"),)

    def test_deep(self):
        """An expression of 100,000 levels is an item like any other."""
        depth = 100_000
        item = parse_item(f"(> {'(+ 1 ' * depth}2{')' * depth} 3)")
        assert len(item.ineq.LHS.tokens) == 2 * depth + 1


class TestMetrics:
    @pytest.mark.parametrize(
        "text",
        ["minimize (total-time)", "minimize total-time", "(minimize (total-time))", "(:metric MINIMIZE (total-time))"],
    )
    def test_spellings(self, text):
        """A metric, with and without its brackets."""
        item = parse_item(text)
        assert item == Expression(optimization="minimize", expr=composite_of((SpecialType.TOTAL_TIME,), unlabelled))

    def test_maximize(self):
        """The other direction, and the count of a violated preference."""
        item = parse_item("maximize (- (total-cost) (* 3 (is-violated p1)))")
        assert item.optimization == "maximize"
        assert str(item) == "maximize (- (total-cost) (* 3 (is-violated p1)))"

    @pytest.mark.parametrize("text", ["(minimize)", "(:metric (f))", "minimize (f) (g)", "minimize ()"])
    def test_refused(self, text):
        """A metric is one direction and one expression."""
        with pytest.raises(PddlSyntaxError):
            parse_item(text)


class TestRefusals:
    @pytest.mark.parametrize(
        "text", ["", "()", "(p", "p)", "((p))", "(p (q))", "(p) (q)", "(not)", "(not p)", "(> (f))"]
    )
    def test_syntax(self, text):
        """Text that is not PDDL is refused with its position."""
        with pytest.raises(PddlSyntaxError) as caught:
            parse_item(text)
        assert caught.value.line == 1

    @pytest.mark.parametrize("text", ["(and (p) (q))", "(or (p))", "(forall (?x) (p ?x))", "(exists (?x) (p ?x))"])
    def test_conditions(self, text):
        """A condition is not one item, and the refusal explains what an item is."""
        with pytest.raises(InvalidKnowledge, match="an item is"):
            parse_item(text)

    def test_timed(self):
        """A timed literal is not an item: the refusal names initial_time."""
        with pytest.raises(InvalidKnowledge, match="initial_time"):
            parse_item("(at 5 (p a))")

    @pytest.mark.parametrize("opening", ["(", "(and ", "(p ", "(= "])
    def test_deep(self, opening):
        """Nesting of 100,000 levels ends in a refusal, which quotes only its beginning."""
        depth = 100_000
        with pytest.raises(KbStoreError) as caught:
            parse_item(opening * depth + "(p)" + ")" * depth)
        assert len(str(caught.value)) < 2000

    def test_deep_negation(self):
        """Any number of double negations is flattened."""
        depth = 100_000
        assert parse_item("(not " * depth + "(p)" + ")" * depth) == Fact(attribute_name="p")
