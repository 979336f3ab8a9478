"""D1, V7: messages of ROSPlan and PlanSys2 are read wherever knowledge is given, as objects and as mappings."""

from types import SimpleNamespace

import pytest

import kbstore
from kbstore import DomainInequality, ExprComposite, Truth
from tests.rules.reading import facts

AND, OR, NOT, ACTION, PREDICATE, FUNCTION, EXPRESSION, MODIFIER, NUMBER, CONSTANT, PARAMETER, EXISTS = range(1, 13)
EQ, GE, GT, LE, LT, MULT, DIV, ADD, SUB, ASSIGN, INCREASE = range(13, 24)


def message(shape):
    """The object with the attributes of a mapping, all the way down, as rclpy has it."""
    if isinstance(shape, dict):
        return SimpleNamespace(**{name: message(value) for name, value in shape.items()})
    return [message(part) for part in shape] if isinstance(shape, list) else shape


FORMS = pytest.mark.parametrize("form", [dict, message], ids=["mapping", "object"])


def param(name, type_name=""):
    return {"name": name, "type": type_name, "sub_types": []}


def node(node_type, name="", *parameters, children=(), value=0.0, negate=False, **types):
    """A Node, with all of the fields that the message has."""
    return {
        "node_type": node_type,
        "expression_type": types.get("expression", 0),
        "modifier_type": types.get("modifier", 0),
        "node_id": 0,
        "children": list(children),
        "name": name,
        "parameters": [param(name) for name in parameters],
        "value": value,
        "negate": negate,
    }


def tree(*nodes):
    """A Tree of nodes, numbered in order."""
    return {"nodes": [{**found, "node_id": index} for index, found in enumerate(nodes)]}


def comparison(kind, left, right):
    """A tree that compares two leaves."""
    return tree(node(EXPRESSION, expression=kind, children=(1, 2)), left, right)


@pytest.fixture
def world(kb):
    """Kenny at wp0, with 80."""
    kb.add("(near kenny wp0)", "(= (battery kenny) 80)")
    return kb


BATTERY = {
    "tokens": [{"expr_type": 1, "function": {"name": "battery", "typed_parameters": [{"key": "r", "value": "kenny"}]}}]
}
SUM = {"tokens": [{"expr_type": 2, "op": 0}, *BATTERY["tokens"], {"expr_type": 0, "constant": 5.0}]}
LOW = {"comparison_type": 2, "LHS": BATTERY, "RHS": {"tokens": [{"expr_type": 0, "constant": 90.0}]}, "grounded": True}


# -- ROSPlan's expressions ----------------------------------------------------------------------------------------


@FORMS
def test_an_expression_is_a_question(world, form):
    """V5: an ExprComposite has a value; it cannot be true, or be added."""
    for asked in (form(SUM), ExprComposite.model_validate(SUM)):
        assert world.value(asked) == world.state().value(asked) == 85
        for method in (world.holds, world.add, world.add_goal, world.history):
            with pytest.raises(kbstore.InvalidKnowledge, match=r"kb\.value"):
                method(asked)


@FORMS
def test_a_comparison_is_a_question_and_a_statement(world, form):
    """C10, C11: a DomainInequality is asked, added as a goal, and recorded, as its PDDL text is."""
    for asked in (form(LOW), DomainInequality.model_validate(LOW)):
        assert world.holds(asked)
        assert world.query(asked).results == [True]
        assert world.when(asked, world.now(), "+1s") == [(world.now(), world.now() + 10**9)]
        world.add(asked)
        world.add_goal(asked)
    assert [str(item) for item in world.state().inequalities] == ["(< (battery kenny) 90)"]
    assert [str(goal) for goal in world.goals()] == ["(< (battery kenny) 90)"]
    with pytest.raises(kbstore.InvalidKnowledge, match="has no value"):
        world.value(form(LOW))


def test_a_wrong_expression_is_refused_with_its_place(world):
    """D1: the error is one sentence that names the field."""
    with pytest.raises(kbstore.InvalidKnowledge, match=r"ExprComposite: tokens\.0\.expr_type: "):
        world.value({"tokens": [{"expr_type": 9}]})
    with pytest.raises(kbstore.InvalidKnowledge, match=r"DomainInequality: RHS: the expression .* lacks 1 operand"):
        world.holds({**LOW, "RHS": {"tokens": [{"expr_type": 2, "op": 4}]}})


# -- PlanSys2 -----------------------------------------------------------------------------------------------------


@FORMS
def test_a_param_is_an_object(world, form):
    """A Param declares an object and its type."""
    world.add(form(param("wp7", "place")))
    assert world.holds(form(param("wp7", "place")))
    assert not world.holds(form(param("wp7", "robot")))
    assert [str(item) for item in world.instances("place")] == ["wp0 - place", "wp1 - place", "wp7 - place"]
    world.remove(form(param("wp7", "place")))
    assert not world.holds("wp7 - place")


@FORMS
def test_a_node_is_a_fact_or_a_value(world, form):
    """A Node is added, asked, removed, made a goal, and found in history."""
    world.add(form(node(PREDICATE, "near", "kenny", "wp1")))
    world.add(form(node(PREDICATE, "open", "wp1", negate=True)))
    world.add(form(node(FUNCTION, "battery", "kenny", value=7.5)))
    assert facts(world) == ["(near kenny wp0)", "(near kenny wp1)", "(not (open wp1))"]
    assert world.value(form(node(FUNCTION, "battery", "kenny"))) == 7.5
    assert world.holds(form(node(FUNCTION, "battery", "kenny", value=7.5)))
    assert world.truth(form(node(PREDICATE, "open", "wp1"))) is Truth.FALSE
    assert len(world.history(form(node(PREDICATE, "near", "kenny", "?")))) == 2
    world.add_goal(form(node(PREDICATE, "open", "wp0")))
    assert [str(goal) for goal in world.goals()] == ["(open wp0)"]
    world.remove(form(node(PREDICATE, "near", "kenny", "?")))
    assert facts(world) == ["(not (open wp1))"]


TREES = [
    (tree(node(PREDICATE, "near", "kenny", "wp0")), "(near kenny wp0)"),
    (tree(node(NOT, children=(1,)), node(PREDICATE, "near", "kenny", "wp1")), "(not (near kenny wp1))"),
    # the parser marks what is below NOT, too; the evaluation of PlanSys2 goes by NOT alone
    (tree(node(NOT, children=(1,)), node(PREDICATE, "near", "kenny", "wp1", negate=True)), "(not (near kenny wp1))"),
    (comparison(GT, node(FUNCTION, "battery", "kenny"), node(NUMBER, value=20.0)), "(> (battery kenny) 20)"),
    (comparison(LE, node(NUMBER, value=20.0), node(FUNCTION, "battery", "kenny")), "(<= 20 (battery kenny))"),
    (comparison(EQ, node(CONSTANT, "wp0"), node(CONSTANT, "wp0")), "(= wp0 wp0)"),
    (
        tree(
            node(AND, children=(1, 2, 3)),
            node(PREDICATE, "near", "kenny", "wp0"),
            node(OR, children=(4, 5)),
            node(EXPRESSION, expression=LT, children=(6, 9)),
            node(PREDICATE, "raining"),
            node(PREDICATE, "near", "kenny", "wp0"),
            node(EXPRESSION, expression=SUB, children=(7, 8)),
            node(FUNCTION, "battery", "kenny"),
            node(NUMBER, value=1.0),
            node(NUMBER, value=80.0),
        ),
        "(and (near kenny wp0) (or (raining) (near kenny wp0)) (< (- (battery kenny) 1) 80))",
    ),
    (
        tree(node(EXISTS, "", "?p", children=(1,)), node(PREDICATE, "near", "kenny", "?p")),
        "(exists (?p - object) (near kenny ?p))",
    ),
]


@FORMS
@pytest.mark.parametrize(("shape", "text"), TREES, ids=lambda value: value if isinstance(value, str) else "")
def test_a_tree_is_the_condition_of_its_text(world, form, shape, text):
    """Each Tree is asked, and made a goal, like its PDDL text; all of these hold."""
    assert world.holds(form(shape))
    assert world.explain(form(shape)).subject == world.explain(text).subject
    world.add_goal(text)
    wanted = [str(goal) for goal in world.goals()]
    assert world.add_goal(form(shape)).changes == 0
    assert [str(goal) for goal in world.goals()] == wanted


@FORMS
def test_a_tree_that_is_one_item_is_knowledge(world, form):
    """It is read as its PDDL text is; a tree of several items is a condition, and the error says what to do."""
    world.add(form(tree(node(NOT, children=(1,)), node(PREDICATE, "open", "wp0"))))
    world.add(form(comparison(EQ, node(FUNCTION, "battery", "kenny"), node(NUMBER, value=3.0))))
    change = tree(
        node(MODIFIER, modifier=INCREASE, children=(1, 2)), node(FUNCTION, "battery", "kenny"), node(NUMBER, value=2.0)
    )
    world.add(form(change))
    assert facts(world) == ["(near kenny wp0)", "(not (open wp0))"]
    assert world.value("(battery kenny)") == 5
    with pytest.raises(kbstore.InvalidKnowledge, match="is a condition, which is not one item"):
        world.add(form(TREES[6][0]))


WRONG = [
    (tree(node(ACTION, "go")), "a node of type ACTION is not a condition"),
    (tree(node(NUMBER, value=3.0)), "a node of type NUMBER is not a condition"),
    (tree(node(99)), "99 is not the type of a Node"),
    ({"nodes": []}, "a Tree has a list of nodes"),
    (tree(node(NOT)), "a node of type NOT has 1 child nodes, not 0"),
    (tree(node(AND, children=(1,))), r"has the children \[1\], of 1 nodes"),
    (tree(node(AND, children=(1,)), node(NOT, children=(0,))), "node 0 of the tree is below itself"),
    (tree(*(node(NOT, children=(n + 1,)) for n in range(400)), node(PREDICATE, "raining")), "deeper than"),
    (comparison(GT, node(PREDICATE, "raining"), node(NUMBER)), "a node of type PREDICATE is not a number"),
    (tree(node(PREDICATE, "open", "wp0) (raining")), "contains"),
    (tree(node(PREDICATE, "fly")), "fly"),
    (tree(node(PREDICATE, "open")), "open"),
]


@pytest.mark.parametrize(("shape", "reason"), WRONG, ids=[reason[:30] for _, reason in WRONG])
def test_a_message_that_is_not_well_formed_is_refused(world, shape, reason):
    """D1: with a typed error that says what is wrong, in questions and in goals; nothing is stored."""
    for method in (world.holds, world.add_goal):
        for form in (dict, message):
            with pytest.raises(kbstore.KbStoreError, match=reason):
                method(form(shape))
    assert world.goals() == []
