"""Messages as users of Pydantic know them: one error for one mistake, at its position, however a message is made."""

from types import SimpleNamespace

import pytest
from pydantic import BaseModel, TypeAdapter, ValidationError

import kbstore
from kbstore import ExprComposite, Fact, Function, Inequality, InvalidKnowledge, InvalidTime, KeyValue, KnowledgeItem

FACT = {"knowledge_type": 1, "attribute_name": "robot_at", "values": [{"key": "r", "value": "kenny"}]}
WHOLE = {
    "initial_time": SimpleNamespace(sec=1, nanosec=5),
    "is_negative": False,
    "instance_type": "",
    "instance_name": "",
    "function_value": 0.0,
    "assign_op": 0,
    "optimization": "",
    "expr": {"tokens": []},
    "ineq": {"comparison_type": 0, "LHS": {"tokens": []}, "RHS": {"tokens": []}, "grounded": False},
    **FACT,
}
"""A mapping of a ROS message, which always has the fields of all five types."""


class Body(BaseModel):
    """The body of a request to a service."""

    item: KnowledgeItem


WRONG = [
    ({**FACT, "attribute_name": 7}, ("item", 1, "attribute_name")),
    ({**FACT, "values": ["kenny", 7]}, ("item", 1, "values", 1)),
    ({**FACT, "values": [{"key": "r", "value": None}]}, ("item", 1, "values", 0, "value")),
    ({**FACT, "initial_time": 3.5}, ("item", 1, "initial_time")),
    ({**FACT, "is_negtive": True}, ("item", 1, "is_negtive")),
    ({"knowledge_type": 2, "attribute_name": "f", "assign_op": 9}, ("item", 2, "assign_op")),
    ({"knowledge_type": 4, "ineq": {"LHS": {"tokens": [{"expr_type": 2}]}}}, ("item", 4, "ineq", "LHS")),
    ({"knowledge_type": 3, "expr": {"tokens": [{"expr_type": 8}]}}, ("item", 3, "expr", "tokens", 0, "expr_type")),
    ({"knowledge_type": 9}, ("item",)),
    ({"attribute_name": "p"}, ("item",)),
]  # fmt: skip


@pytest.mark.parametrize(("wrong", "place"), WRONG, ids=lambda value: str(value)[:60])
def test_one_wrong_field_is_one_error_at_its_place(wrong, place):
    """The union is discriminated by `knowledge_type`: no error mentions the other four types."""
    with pytest.raises(ValidationError) as caught:
        Body(item=wrong)
    assert [error["loc"] for error in caught.value.errors()] == [place]


@pytest.mark.parametrize("wrong", [wrong for wrong, _ in WRONG], ids=lambda value: str(value)[:60])
def test_kbstore_raises_its_own_error_for_them(wrong):
    """D1, T2: where kbstore reads a mapping, a mistake is `InvalidKnowledge`, or `InvalidTime`, with the field."""
    expected = InvalidTime if "initial_time" in wrong else InvalidKnowledge
    with pytest.raises(expected) as caught:
        kbstore.item(wrong)
    with kbstore.open("sqlite://") as kb:
        for method in (kb.add, kb.remove, kb.add_goal, kb.holds, kb.history):
            with pytest.raises(expected):
                method(wrong)
    assert not isinstance(caught.value, ValidationError)
    assert caught.value.__cause__ is None


def test_all_wrong_fields_are_named():
    """D1: one sentence for each, with its position in the message."""
    with pytest.raises(InvalidKnowledge) as caught:
        kbstore.item({**FACT, "attribute_name": 7, "values": ["kenny", 7]})
    first, second = caught.value.violations
    assert first.startswith("Fact: attribute_name: ")
    assert second.startswith("Fact: values.1: a value is a name")


@pytest.mark.parametrize(
    ("model", "fields"),
    [
        (Fact, {"attribute_name": 7}),
        (Fact, {"values": 3}),
        (Fact, {"colour": "red"}),
        (Fact, {"function_value": 3}),
        (Function, {"function_value": True}),
        (Function, {"initial_time": 3.5}),
        (Inequality, {}),
        (KeyValue, {"key": 5}),
        (ExprComposite, {"tokens": [{"expr_type": 2}]}),
    ],
)
def test_a_constructor_raises_what_validation_raises(model, fields):
    """`Fact(...)` and `Fact.model_validate(...)` raise the same exception, with the same positions."""
    with pytest.raises(ValidationError) as made:
        model(**fields)
    with pytest.raises(ValidationError) as validated:
        model.model_validate(fields)
    places = [(error["type"], error["loc"]) for error in validated.value.errors()]
    assert [(error["type"], error["loc"]) for error in made.value.errors()] == places
    assert len(places) == 1


def test_a_whole_message_is_read_as_its_type():
    """The fields of the other types are ignored, in a mapping and in an object."""
    expected = Fact(attribute_name="robot_at", values={"r": "kenny"}, initial_time=1_000_000_005)
    for message in (WHOLE, SimpleNamespace(**WHOLE)):
        assert kbstore.item(message) == expected
        assert Body(item=message).item == expected
        assert Fact.model_validate(message) == expected


def test_a_message_of_another_type_is_refused():
    """A FACT is not read as a Function although it has the fields."""
    with pytest.raises(ValidationError):
        Function.model_validate(WHOLE)


def test_the_schema_has_the_discriminator():
    """OpenAPI: `knowledge_type` selects one of the five schemas."""
    schema = TypeAdapter(KnowledgeItem).json_schema()
    assert schema["discriminator"]["propertyName"] == "knowledge_type"
    assert schema["discriminator"]["mapping"]["1"] == "#/$defs/Fact"
    assert len(schema["oneOf"]) == 5


def test_items_read_back_their_dump():
    """Each type of item is read back from its dump, as Python and as JSON."""
    for text in ("wp7 - waypoint", "(not (p a b))", "(= (f a) 3.5)", "(> (f a) (+ (g) 32))", "minimize (total-time)"):
        item = kbstore.item(text)
        adapter = TypeAdapter(KnowledgeItem)
        assert adapter.validate_python(item.model_dump()) == adapter.validate_json(item.model_dump_json()) == item
        assert kbstore.item(item.model_dump(mode="json")) == item


@pytest.mark.parametrize("value", [float("nan"), float("inf")])
def test_a_number_that_is_not_finite_is_refused_when_added(value):
    """C7: a message may have NaN, as a float64 may; adding it is `InvalidKnowledge` that names the function."""
    moving = Function(attribute_name="f", values=["a"], function_value=1, rate=value)
    set_to = Function(attribute_name="f", values=["a"], function_value=value)
    with kbstore.open("sqlite://") as kb:
        for method, wrong in ((kb.add, moving), (kb.add, set_to), (kb.add_goal, set_to), (kb.holds, set_to)):
            for given in (wrong, wrong.model_dump()):
                with pytest.raises(InvalidKnowledge, match="finite"):
                    method(given)
        assert kb.state().functions == kb.goals() == []
