"""Conditions and expressions from text, and items as questions (rule V7)."""

import pytest

from kbstore.conversion import from_composite
from kbstore.errors import InvalidKnowledge, KbStoreError, PddlSyntaxError, UnknownSymbol
from kbstore.messages import AssignOp, ComparisonType, Fact, Function, Inequality, Instance, Operator, SpecialType
from kbstore.messages import Condition as ConditionMessage
from kbstore.model.formulas import (
    And,
    Atom,
    Comparison,
    Defined,
    Exists,
    Forall,
    Imply,
    IsA,
    Not,
    Or,
    Parameter,
    Preference,
    Same,
    Truism,
)
from kbstore.pddl.domain_reader import read_domain
from kbstore.pddl.parse import condition_of, goals_of, parse_condition, parse_expression, parse_item
from kbstore.pddl.printer import condition_text, expression_text

P, Q = Atom("p"), Atom("q")
DOMAIN = read_domain(
    """(define (domain d) (:types robot waypoint)
    (:predicates (robot_at ?r - robot ?wp - waypoint) (p) (preference ?x))
    (:functions (battery ?r - robot) (cost)))"""
)


class TestConnectives:
    @pytest.mark.parametrize(
        ("text", "condition"),
        [
            ("(p)", P),
            ("()", Truism()),
            ("(and)", Truism()),
            ("(and (p) (q))", And((P, Q))),
            ("(AND (p) (and (q) (and)) ())", And((P, Q))),
            ("(or (p) (or (q)))", Or((P, Q))),
            ("(or)", Or(())),
            ("(not (p))", Not(P)),
            ("(not (not (p)))", P),
            ("(not (not (not (and (p)))))", Not(And((P,)))),
            ("(imply (p) (q))", Imply(P, Q)),
            ("(preference name (p))", Preference("name", P)),
            ("(preference (p))", Preference("", P)),
            (
                "(exists (?x - t ?y) (r ?x ?y))",
                Exists((Parameter("x", ("t",)), Parameter("y")), Atom("r", ("?x", "?y"))),
            ),
            (
                "(forall (?x ?y - (either a b)) (p))",
                Forall((Parameter("x", ("a", "b")), Parameter("y", ("a", "b"))), P),
            ),
            ("(exists () (p))", Exists((), P)),
        ],
    )
    def test_reading(self, text, condition):
        """Every connective; nested ones of the same kind and double negations are flattened."""
        assert parse_condition(text) == condition

    @pytest.mark.parametrize(
        ("text", "condition"),
        [
            ("(= ?x a)", None),
            ("(= a b)", Same("a", "b")),
            ("(= (f a) 3)", Comparison(ComparisonType.EQUALS, (Atom("f", ("a",)),), (3.0,))),
            ("(= total-cost 0)", Comparison(ComparisonType.EQUALS, (Atom("total-cost"),), (0.0,))),
            ("(>= 3 (f))", Comparison(ComparisonType.GREATEREQ, (3.0,), (Atom("f"),))),
            ("(< (f) total-time)", Comparison(ComparisonType.LESS, (Atom("f"),), (SpecialType.TOTAL_TIME,))),
        ],
    )
    def test_comparisons(self, text, condition):
        """(= a b) compares objects, (= (f a) 3) values; a free variable in a comparison is refused (rule V7)."""
        if condition is None:
            with pytest.raises(InvalidKnowledge, match="exists"):
                parse_condition(text)
        else:
            assert parse_condition(text) == condition

    def test_bound_variables_may_be_compared(self):
        """Variables of a quantifier may be compared."""
        condition = parse_condition("(exists (?x ?y) (and (= ?x ?y) (> (f ?x) (f ?y))))")
        assert condition.part.parts[0] == Same("?x", "?y")

    def test_bare_function_of_the_domain(self):
        """A name that the domain knows as a function without parameters is a value."""
        assert parse_condition("(= cost cost)", DOMAIN) == Comparison(
            ComparisonType.EQUALS, (Atom("cost"),), (Atom("cost"),)
        )

    def test_keyword_as_predicate(self):
        """A declared predicate may have the name of a keyword."""
        assert parse_condition("(preference kenny)", DOMAIN) == Atom("preference", ("kenny",))

    def test_objects(self):
        """wp7 - waypoint asks for an object, also inside a condition."""
        assert parse_condition("wp7 - waypoint") == IsA("wp7", "waypoint")
        assert parse_condition("wp7") == IsA("wp7")
        assert parse_condition("(and (wp7 - waypoint) (not (wp8 - waypoint)))") == And(
            (IsA("wp7", "waypoint"), Not(IsA("wp8", "waypoint")))
        )

    def test_definedness(self):
        """A function of the domain as a condition asks whether it is defined (rule V7)."""
        assert parse_condition("(battery ?)", DOMAIN) == Defined(Atom("battery", ("?",)))

    def test_wildcards(self):
        """Free variables in atoms are patterns (rule V7)."""
        assert parse_condition("(not (robot_at ? ?wp))", DOMAIN) == Not(Atom("robot_at", ("?", "?wp")))


class TestRefusals:
    @pytest.mark.parametrize(
        ("text", "kind", "reason"),
        [
            ("(docked)", UnknownSymbol, "no predicate docked; it has robot_at"),
            ("(> (fuel) 3)", UnknownSymbol, "no numeric function fuel"),
            ("(> (p) 3)", UnknownSymbol, "is a predicate"),
            ("(exists (?x - truck) (p))", UnknownSymbol, "type truck"),
            ("kenny - truck", UnknownSymbol, "type truck"),
            ("(robot_at kenny)", InvalidKnowledge, r"\(robot_at \?r - robot \?wp - waypoint\) takes 2"),
            ("(> (battery) 3)", InvalidKnowledge, "takes 1"),
            ("(> battery 3)", InvalidKnowledge, "needs its arguments"),
            ("(> (battery ?) 3)", InvalidKnowledge, "exists"),
            ("p", PddlSyntaxError, r"like \(p\)"),
            ("p q", PddlSyntaxError, "brackets"),
            ("(p) (q)", PddlSyntaxError, "2 items"),
            ("(and p)", PddlSyntaxError, "brackets"),
            ("(imply (p))", PddlSyntaxError, "two conditions"),
            ("(not (p) (q))", PddlSyntaxError, "one condition"),
            ("(exists ?x (p))", PddlSyntaxError, "list of variables"),
            ("(exists (?x ?X) (p))", PddlSyntaxError, "declared twice"),
            ("(exists (x) (p))", PddlSyntaxError, "a variable is expected"),
            ("(exists (?x -) (p))", PddlSyntaxError, "type is missing"),
            ("(exists (?x - (some t)) (p))", PddlSyntaxError, "either"),
            ("(> (battery kenny))", PddlSyntaxError, "compares two values"),
            ("(> (battery kenny) ())", PddlSyntaxError, "expression"),
            ("(> (/ 1 2 3) 4)", PddlSyntaxError, "two operands"),
            ("(> (- 1 2 3) 4)", PddlSyntaxError, "one or two"),
            ("(> (+) 4)", PddlSyntaxError, "at least one"),
            ("(> ?x 4)", PddlSyntaxError, "no numeric value"),
            ("(> + 4)", PddlSyntaxError, "operation"),
            ("(> (3) 4)", PddlSyntaxError, "without brackets"),
            ("(always (p))", PddlSyntaxError, "constrains a plan"),
            ("(at start (p))", PddlSyntaxError, "durative"),
            ("(robot_at kenny (dock))", PddlSyntaxError, "names of objects"),
            ("minimize (cost)", PddlSyntaxError, "not a condition"),
        ],
    )
    def test_refused(self, text, kind, reason):
        """Each is refused with its kind of error, and with what was expected."""
        with pytest.raises(kind, match=reason):
            parse_condition(text, DOMAIN)

    @pytest.mark.parametrize("opening", ["(and (or ", "(forall (?x) ", "(imply (p) ", "(not (and ", "(preference n "])
    def test_too_deep(self, opening):
        """Conditions that stay nested too deep are refused, to limit recursion."""
        depth = 20_000
        with pytest.raises(PddlSyntaxError, match="nested deeper than"):
            parse_condition(opening * depth + "(p)" + ")" * (depth * opening.count("(") - depth * opening.count(") ")))

    @pytest.mark.parametrize("opening", ["(and ", "(or ", "(not "])
    def test_deep(self, opening):
        """Conditions that can be flattened may be nested to any depth."""
        depth = 100_000
        condition = parse_condition(opening * depth + "(p)" + ")" * depth)
        assert condition in (P, And((P,)), Or((P,)))


class TestExpressions:
    @pytest.mark.parametrize(
        ("text", "tokens"),
        [
            ("3", (3.0,)),
            ("-3.50", (-3.5,)),
            ("+1e-3", (0.001,)),
            ("(f a)", (Atom("f", ("a",)),)),
            ("f", (Atom("f"),)),
            ("(- 5)", (Operator.UMINUS, 5.0)),
            ("(+ 1 2 3)", (Operator.ADD, Operator.ADD, 1.0, 2.0, 3.0)),
            ("(* (f) (/ 1 2))", (Operator.MUL, Atom("f"), Operator.DIV, 1.0, 2.0)),
            ("(- (+ 1 2) 10)", (Operator.SUB, Operator.ADD, 1.0, 2.0, 10.0)),
            ("(+ 4)", (4.0,)),
            ("(* #t ?duration)", (Operator.MUL, SpecialType.HASHT, SpecialType.DURATION)),
        ],
    )
    def test_reading(self, text, tokens):
        """Expressions are flat and in prefix order."""
        found = parse_expression(text)
        assert found == tokens
        assert list(map(type, found)) == list(map(type, tokens))

    def test_deep(self):
        """An expression of any depth is read and written."""
        depth = 100_000
        text = "(- " * depth + "1" + ")" * depth
        assert expression_text(parse_expression(text)) == text

    @pytest.mark.parametrize("text", ["", "1 2", "()", "(", "1 (f)"])
    def test_refused(self, text):
        """Exactly one expression is expected."""
        with pytest.raises(PddlSyntaxError):
            parse_expression(text)


class TestItemsAsQuestions:
    def test_facts(self):
        """A fact asks for itself; a negative one for its negation (rule V7)."""
        assert condition_of(parse_item("(robot_at kenny ?)")) == Atom("robot_at", ("kenny", "?"))
        assert condition_of(Fact(attribute_name="p", values=[""], is_negative=True)) == Not(Atom("p", ("?",)))

    def test_functions(self):
        """A function asks whether it is defined, or equal to the value; its assign_op does not matter."""
        assert condition_of(Function(attribute_name="cost")) == Defined(Atom("cost"))
        assert condition_of(
            Function(attribute_name="cost", function_value=3, assign_op=AssignOp.INCREASE, is_negative=True)
        ) == Not(Comparison(ComparisonType.EQUALS, (Atom("cost"),), (3.0,)))

    def test_others(self):
        """Inequalities, objects and conditions are asked as they are."""
        assert condition_of(parse_item("(not (> (f) 3))")) == Not(
            Comparison(ComparisonType.GREATER, (Atom("f"),), (3.0,))
        )
        assert condition_of(Instance(instance_name="a", instance_type="t")) == IsA("a", "t")
        assert condition_of(Instance(instance_name="a", is_negative=True)) == Not(IsA("a"))
        assert condition_of(ConditionMessage(text="(or (p) (q))")) == Or((P, Q))

    def test_labels_in_any_order(self):
        """With a domain, labelled values may come in any order (rule D1)."""
        fact = Fact(attribute_name="ROBOT_AT", values={"WP": "wp0", "r": "kenny"})
        assert condition_of(fact, DOMAIN) == Atom("ROBOT_AT", ("kenny", "wp0"))

    @pytest.mark.parametrize(
        "item",
        [
            Fact(attribute_name="robot_at", values={"r": "kenny", "place": "wp0"}),
            Fact(attribute_name="robot_at", values={"r": "kenny", "": "wp0"}),
            Fact(attribute_name="robot_at", values=["kenny"]),
            Fact(attribute_name="robot_at", values=[{"key": "r", "value": "a"}, {"key": "r", "value": "b"}]),
            parse_item("minimize (cost)"),
            ConditionMessage(text="(robot_at kenny)"),
            Inequality(ineq={"LHS": {"tokens": []}, "RHS": {"tokens": []}}),
        ],
    )
    def test_invalid_items(self, item):
        """Wrong labels, a wrong number of arguments, a metric and an empty expression are refused."""
        with pytest.raises(InvalidKnowledge):
            condition_of(item, DOMAIN)

    @pytest.mark.parametrize(
        "item", [Fact(attribute_name="x"), Function(attribute_name="x"), Instance(instance_name="a", instance_type="x")]
    )
    def test_unknown(self, item):
        """A symbol that the domain does not have is unknown."""
        with pytest.raises(UnknownSymbol):
            condition_of(item, DOMAIN)

    def test_not_a_number(self):
        """An infinite constant in a client's expression is refused."""
        item = Inequality(
            ineq={
                "LHS": {"tokens": [{"expr_type": 0, "constant": float("inf")}]},
                "RHS": {"tokens": [{"expr_type": 0, "constant": 1}]},
            }
        )
        with pytest.raises(InvalidKnowledge, match="finite"):
            condition_of(item)
        assert from_composite(item.ineq.RHS) == (1.0,)


class TestGoals:
    def test_parts(self):
        """A conjunction is split; a part that is not an item is kept as text (rule C10)."""
        condition = parse_condition(
            "(and (robot_at kenny wp0) (not (p)) (and (> (cost) 3) (not (< (cost) 9))) (or (p) (p)) (exists (?x) (p)))"
        )
        goals = goals_of(condition, DOMAIN)
        assert [type(goal).__name__ for goal in goals] == [
            "Fact",
            "Fact",
            "Inequality",
            "Inequality",
            "Condition",
            "Condition",
        ]
        assert [goal.is_negative for goal in goals[:4]] == [False, True, False, True]
        assert goals[0].labels == ("r", "wp")
        assert goals[4].text == "(or (p) (p))"
        assert goals[5].text == "(exists (?x - object) (p))"

    @pytest.mark.parametrize("text", ["()", "(and)", "(and (and) ())"])
    def test_a_truism_is_not_a_goal(self, text):
        """A condition that is always true is not a goal."""
        assert goals_of(parse_condition(text)) == []

    @pytest.mark.parametrize("text", ["kenny - robot", "(not (kenny - robot))", "(or (p) (battery kenny))"])
    def test_existence_is_not_a_goal(self, text):
        """Existence of an object and definedness of a function can be asked, but not be goals."""
        with pytest.raises(InvalidKnowledge, match="is not a goal"):
            goals_of(parse_condition(text, DOMAIN), DOMAIN)


class TestText:
    @pytest.mark.parametrize(
        "text",
        [
            "(and)",
            "(and (p a) (not (q)))",
            "(or)",
            "(imply (p) (or (q) (p)))",
            "(forall (?x - (either a b) ?y - object) (exists () (= ?x ?y)))",
            "(preference p1 (> (f a) (- (g))))",
            "(preference (p))",
            "(not (wp7 - waypoint))",
            "wp7 - waypoint",
        ],
    )
    def test_canonical(self, text):
        """Canonical text stays as it is, and reads back to an equal condition."""
        condition = parse_condition(text)
        assert condition_text(condition) == text

    def test_existence(self):
        """Existence without a type is written as being an object."""
        assert condition_text(Not(IsA("a"))) == "(not (a - object))"

    def test_deep(self):
        """A condition built by a program is written at any depth."""
        condition = P
        for _ in range(20_000):
            condition = Not(condition)
        try:
            assert condition_text(condition).count("not") == 20_000
        finally:
            while isinstance(condition, Not):  # the interpreter frees it level by level, too
                condition = condition.part

    @pytest.mark.parametrize(
        "text",
        [
            f"(p {'x ' * 100_000}(q))",
            f"(p {'x ' * 100_000})",
            f"({'x' * 100_000})",
            f"(> ({'x' * 100_000}) 1)",
            f"(> ?{'x' * 100_000} 1)",
            f"(exists (?x - {'x' * 100_000}) (p))",
            f"(> (battery ?{'x' * 100_000}) 1)",
        ],
    )
    def test_refusals_are_short(self, text):
        """A refusal quotes only the beginning of a long text."""
        with pytest.raises(KbStoreError) as caught:
            parse_condition(text, DOMAIN)
        assert len(str(caught.value)) < 1500
