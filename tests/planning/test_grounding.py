"""Objects for the parameters of an operator (rules O1, D1, D3)."""

import pytest

from kbstore.errors import InvalidKnowledge, UnknownSymbol
from kbstore.messages import ComparisonType
from kbstore.model.formulas import (
    And,
    Comparison,
    Defined,
    Exists,
    Forall,
    Formula,
    Imply,
    IsA,
    Not,
    Or,
    Preference,
    Same,
    Truism,
)
from kbstore.planning.grounding import ground
from tests.planning.robots import OVER_ALL, START, action, atom, grounded, parameters, robots, tokens, world


def test_bindings_map_parameters_to_objects_as_keys():
    """D3: names are compared without case, and the arguments keep their spelling."""
    act = action("R:robot To:wp")
    found = ground(robots(act), "ACT", ("Kenny", "WP0"), world(act))
    assert found.bindings == {"r": "kenny", "to": "wp0"}
    assert found.arguments == ("Kenny", "WP0")
    assert str(found) == "(act Kenny WP0)"


def test_an_unknown_operator_is_an_unknown_symbol():
    """V8: the domain has to know the operator; the error lists its operators."""
    with pytest.raises(UnknownSymbol, match="no operator fly; it has act"):
        ground(robots(action()), "fly", (), world())


def test_subtypes_and_constants_fit():
    """D1: an argument is of the declared type or a subtype; constants are objects, too."""
    act = action("m:mover p:wp")
    assert ground(robots(act), "act", ("t1", "depot"), world(act)).bindings == {"m": "t1", "p": "depot"}


def test_any_type_of_an_either_fits():
    """D1: an ``either`` type takes objects of each of its types, and no others."""
    act = action("m:truck|wp")
    for name in ("t1", "wp0"):
        ground(robots(act), "act", (name,), world(act))
    with pytest.raises(InvalidKnowledge, match=r"\(either truck wp\)"):
        ground(robots(act), "act", ("kenny",), world(act))


def test_all_violations_are_reported_together():
    """D1: each argument that does not exist or fit is named, with the expected type."""
    act = action("r:Robot a:wp b:wp")
    with pytest.raises(InvalidKnowledge) as caught:
        ground(robots(act), "act", ("T1", "nowhere", "?x"), world(act))
    wrong_type, missing, variable = caught.value.violations
    assert "(act T1 nowhere ?x)" in wrong_type
    assert "?r is T1, which is of the type truck" in wrong_type
    assert "type Robot is expected" in wrong_type
    assert "?a is nowhere, which does not exist" in missing
    assert "?b is '?x', which is a variable" in variable


@pytest.mark.parametrize("arguments", [(), ("kenny",), ("kenny", "wp0", "wp1")])
def test_the_number_of_arguments_has_to_fit(arguments: tuple[str, ...]):
    """D1: too few and too many arguments are refused, with the operator's parameters."""
    act = action("r:robot p:wp")
    with pytest.raises(InvalidKnowledge, match=r"but \(act \?r - robot \?p - wp\) takes 2"):
        ground(robots(act), "act", arguments, world(act))


def test_arguments_are_checked_even_if_their_number_is_wrong():
    """D1: a wrong number does not hide a wrong object."""
    act = action("r:robot p:wp")
    with pytest.raises(InvalidKnowledge) as caught:
        ground(robots(act), "act", ("nobody",), world(act))
    assert len(caught.value.violations) == 2


def test_conditions_show_objects_and_are_split():
    """O1: conjunctions are split into their parts, with objects in the places of the parameters."""
    condition = And((atom("at ?r ?p"), And((Not(atom("docked ?R")), Truism())), atom("door")))
    act = action("r:robot p:wp", conditions=[(START, condition), (OVER_ALL, atom("seen ?p"))])
    ground_action = grounded(act, "Kenny", "wp0")
    assert ground_action.conditions(START) == [atom("at Kenny wp0"), Not(atom("docked Kenny")), atom("door")]
    assert ground_action.conditions(OVER_ALL) == [atom("seen wp0")]


def test_every_form_of_condition_is_instantiated():
    """O1: parameters are replaced by objects in conditions of every form."""
    more = ComparisonType.GREATER
    pairs: list[tuple[Formula, Formula]] = [
        (Or((atom("at ?r ?p"), atom("door"))), Or((atom("at kenny wp0"), atom("door")))),
        (Imply(atom("docked ?r"), atom("seen ?p")), Imply(atom("docked kenny"), atom("seen wp0"))),
        (Same("?p", "depot"), Same("wp0", "depot")),
        (Comparison(more, tokens("battery ?r"), (20.0,)), Comparison(more, tokens("battery kenny"), (20.0,))),
        (Defined(atom("battery ?r")), Defined(atom("battery kenny"))),
        (IsA("?r", "truck"), IsA("kenny", "truck")),
        (Or(()), Or(())),
    ]
    act = action("r:robot p:wp", conditions=[(START, given) for given, _ in pairs])
    assert grounded(act, "kenny", "wp0").conditions(START) == [expected for _, expected in pairs]


def test_variables_of_a_quantifier_are_not_replaced():
    """O1: a variable of a quantifier hides a parameter of the same name, and no others."""
    inner = Exists(parameters("P:wp"), And((atom("at ?r ?p"), atom("near ?p ?q"))))
    act = action("r:robot p:wp q:wp", conditions=[(START, Forall(parameters("q:wp"), inner))])
    (found,) = grounded(act, "kenny", "wp0", "wp1").conditions(START)
    assert found == Forall(
        parameters("q:wp"), Exists(parameters("P:wp"), And((atom("at kenny ?p"), atom("near ?p ?q"))))
    )


def test_a_preference_is_not_a_condition():
    """PDDL 3.0: a preference in a precondition never makes the action inapplicable."""
    soft = Preference("soft", atom("door"))
    act = action(
        "r:robot",
        conditions=[(START, And((soft, Forall(parameters("p:wp"), And((soft, atom("at ?r ?p"))))))), (START, soft)],
    )
    assert grounded(act, "kenny").conditions(START) == [Forall(parameters("p:wp"), atom("at kenny ?p"))]
