"""A loaded domain: lookups by name in any case (D3), read-only mappings, and messages."""

import pickle

import pytest

import kbstore
from kbstore.names import NameMapping
from kbstore.pddl.domain_reader import read_domain

DOMAIN = read_domain(
    """(define (domain rooms) (:types Room robot) (:constants Dock - Room)
    (:predicates (robot_at ?r - robot ?where - room) (lit ?where - (either room robot)))
    (:functions (battery ?r - robot))
    (:action Visit :parameters (?r - robot ?to - room) :precondition (robot_at ?r Dock) :effect (robot_at ?r ?to)))"""
)


def test_operators_are_found_in_any_case_and_listed_as_written():
    """D3: `operators` is a mapping by name, like `predicates` and `functions` in this."""
    assert list(DOMAIN.operators) == ["Visit"]
    assert "VISIT" in DOMAIN.operators
    assert DOMAIN.operators["visit"] is DOMAIN.operator("VISIT")
    assert DOMAIN.operators.get("leave") is None
    assert 7 not in DOMAIN.operators
    assert DOMAIN.predicates["ROBOT_AT"] is DOMAIN.predicate("robot_at")
    assert DOMAIN.functions[0] is DOMAIN.function("Battery")
    with pytest.raises(KeyError, match="leave"):
        DOMAIN.operators["leave"]


@pytest.mark.parametrize(
    "mapping",
    [DOMAIN.types, DOMAIN.constants, DOMAIN.operators, DOMAIN.actions, DOMAIN.predicate_signatures],
    ids=["types", "constants", "operators", "actions", "predicates"],
)
def test_a_domain_cannot_be_changed_by_its_mappings(mapping):
    """The loaded domain is the one that is checked against: assigning to a mapping is a TypeError."""
    with pytest.raises(TypeError):
        mapping["new"] = "object"
    with pytest.raises(TypeError):
        del mapping[next(iter(mapping))]


def test_types_and_constants_compare_as_dicts_do():
    """They print, compare and pickle like the dict that they were made from."""
    assert DOMAIN.types == {"Room": "object", "robot": "object"}
    assert DOMAIN.constants == {"Dock": "Room"}
    assert repr(DOMAIN.constants) == "{'Dock': 'Room'}"
    assert DOMAIN.constants["dock"] == "Room"
    assert pickle.loads(pickle.dumps(DOMAIN.types)) == DOMAIN.types


def test_a_mapping_is_not_changed_through_what_it_was_made_from():
    """The mapping has a copy of its own."""
    given = {"a": "object"}
    mapping = NameMapping(given)
    given["b"] = "object"
    assert dict(mapping) == {"a": "object"}


def test_the_public_domain_has_the_messages():
    """`kbstore.Domain` is the class of `kb.domain` and of a state, also after a predicate was marked as sensed."""
    with kbstore.open("sqlite://") as kb:
        kb.load(DOMAIN.source)
        kb.set_sensed("lit", True)
        for domain in (kb.domain, kb.state().domain):
            assert isinstance(domain, kbstore.Domain)
            assert isinstance(domain.operator("visit"), kbstore.DomainOperator)
            assert [formula.declaration() for formula in domain.predicates] == [
                "(robot_at ?r - robot ?where - Room)",
                "(lit ?where - (either Room robot))",
            ]
            assert [str(signature) for signature in domain.predicate_signatures.values()] == [
                formula.declaration() for formula in domain.predicates
            ]
