"""PlanSys2's domain expert on a knowledge base: the declarations of the domain, in the form of PlanSys2's clients."""

import pytest

import kbstore
from kbstore.clock import ManualClock
from kbstore.interop.plansys2 import NodeType
from kbstore.ros.plansys2_domain import DomainExpert
from tests.ros.plansys2_calls import Messages, call, text

DOMAIN = """
(define (domain Simple)
  (:requirements :strips :typing :fluents :durative-actions :derived-predicates)
  (:types person robot room - object
          teleporter_room - room)
  (:constants hall - room lab - teleporter_room)
  (:predicates (Robot_At ?r - robot ?p - room) (person_at ?p - person ?r - room) (quiet)
               (inferred_at ?r - robot ?p - room))
  (:functions (distance ?a ?b - room) (battery ?r - robot))
  (:derived (inferred_at ?who - robot ?where - room) (robot_at ?who ?where))
  (:derived (inferred_at ?who - robot ?where - room) (exists (?p - person) (person_at ?p ?where)))
  (:durative-action Move
    :parameters (?r - robot ?from ?to - room)
    :duration (= ?duration 5)
    :condition (and (at start (robot_at ?r ?from)) (at start (or (quiet) (not (= ?from hall))))
                    (over all (>= (battery ?r) (* 2 (distance ?from ?to)))))
    :effect (and (at start (not (robot_at ?r ?from))) (at end (robot_at ?r ?to))
                 (at end (decrease (battery ?r) (- (distance ?from ?to) 1)))))
  (:durative-action drain
    :parameters (?r - robot)
    :duration (= ?duration 5)
    :condition ()
    :effect (decrease (battery ?r) (* #t 1)))
  (:action meet
    :parameters (?r - robot ?p - person)
    :precondition (exists (?w - room) (and (robot_at ?r ?w) (person_at ?p ?w)))
    :effect (and (quiet) (assign (battery ?r) 3)))
  (:action shout
    :parameters ()
    :precondition (and (forall (?p - person) (person_at ?p hall)))
    :effect (when (quiet) (not (quiet)))))
"""


@pytest.fixture
def expert():
    with kbstore.open("sqlite://", "experts", clock=ManualClock()) as kb:
        kb.load(DOMAIN)
        yield DomainExpert(kb, Messages())


def answer(expert, service, field, **request):
    response = call(expert, service, **request)
    assert (response.success, response.error_info) == (True, "")
    return getattr(response, field)


def refusal(expert, service, **request):
    response = call(expert, service, **request)
    assert response.success is False
    return response.error_info


def names(nodes):
    return [(node.node_type, node.name, list(node.parameters)) for node in nodes]


def parameters(found):
    return [(p.name, p.type, p.sub_types) for p in found]


def test_names_types_and_constants(expert):
    """Symbols are in lower case, `object` is the first type, and constants are of exactly one type."""
    assert answer(expert, "get_domain_name", "name") == "simple"
    assert answer(expert, "get_domain_types", "types") == ["object", "person", "robot", "room", "teleporter_room"]
    assert answer(expert, "get_domain_constants", "constants", type="Room") == ["hall"]
    assert "no type planet" in refusal(expert, "get_domain_constants", type="planet")


def test_predicates_and_functions_are_listed_by_name(expert):
    """The lists have names without parameters."""
    assert names(answer(expert, "get_domain_predicates", "states")) == [
        (NodeType.PREDICATE, name, []) for name in ("robot_at", "person_at", "quiet", "inferred_at")
    ]
    assert names(answer(expert, "get_domain_functions", "states")) == [
        (NodeType.FUNCTION, name, []) for name in ("distance", "battery")
    ]
    assert (
        names(answer(expert, "get_domain_derived_predicates", "states"))
        == [(NodeType.PREDICATE, "inferred_at", [])] * 2
    )


def test_the_details_of_symbols(expert):
    """PlanSys2 names parameters by type and position, and lists the subtypes."""
    found = answer(expert, "get_domain_predicate_details", "node", expression="ROBOT_AT")
    assert parameters(found.parameters) == [("?robot0", "robot", []), ("?room1", "room", ["teleporter_room"])]
    found = answer(expert, "get_domain_function_details", "node", expression="battery")
    assert (found.node_type, parameters(found.parameters)) == (NodeType.FUNCTION, [("?robot0", "robot", [])])
    assert "no predicate battery" in refusal(expert, "get_domain_predicate_details", expression="battery")
    assert "no function quiet" in refusal(expert, "get_domain_function_details", expression="quiet")


def test_actions_are_listed_by_kind(expert):
    """Instantaneous and durative actions are separate."""
    assert answer(expert, "get_domain_actions", "actions") == ["meet", "shout"]
    assert answer(expert, "get_domain_durative_actions", "actions") == ["move", "drain"]


def test_a_durative_action(expert):
    """Without arguments its parameters are positions; each part is a conjunction, or a tree without nodes."""
    move = answer(expert, "get_domain_durative_action_details", "durative_action", durative_action="MOVE")
    assert move.name == "move"
    assert parameters(move.parameters) == [
        ("?0", "robot", []),
        ("?1", "room", ["teleporter_room"]),
        ("?2", "room", ["teleporter_room"]),
    ]
    assert text(move.at_start_requirements) == "(and (robot_at ?0 ?1) (or (quiet) (not (= ?1 hall))))"
    assert text(move.over_all_requirements) == "(and (>= (battery ?0) (* 2.0 (distance ?1 ?2))))"
    assert move.at_end_requirements.nodes == []
    assert text(move.at_start_effects) == "(and (not (robot_at ?0 ?1)))"
    assert text(move.at_end_effects) == "(and (robot_at ?0 ?2) (decrease (battery ?0) (- (distance ?1 ?2) 1.0)))"


def test_an_action_with_arguments(expert):
    """Arguments replace parameters as far as they are given, also in quantified conditions."""
    move = answer(
        expert,
        "get_domain_durative_action_details",
        "durative_action",
        durative_action="move",
        parameters=["leia", "hall"],
    )
    assert [p.name for p in move.parameters] == ["leia", "hall", "?2"]
    assert text(move.at_start_requirements) == "(and (robot_at leia hall) (or (quiet) (not (= hall hall))))"
    meet = answer(expert, "get_domain_action_details", "action", action="meet", parameters=["leia", "jack"])
    assert text(meet.preconditions) == "(and (exists ?w:room (and (robot_at leia ?w) (person_at jack ?w))))"
    assert text(meet.effects) == "(and (quiet) (assign (battery leia) 3.0))"


def test_types_of_arguments_are_in_the_tree(expert):
    """A node's parameters have the types that the predicate declares."""
    move = answer(expert, "get_domain_durative_action_details", "durative_action", durative_action="move")
    assert parameters(move.at_start_effects.nodes[2].parameters) == [
        ("?0", "robot", []),
        ("?1", "room", ["teleporter_room"]),
    ]


def test_actions_that_are_refused(expert):
    """Unknown ones, those of the other kind, too many arguments, and conditions that the messages cannot carry."""
    assert "no operator fly" in refusal(expert, "get_domain_action_details", action="fly")
    assert "takes time" in refusal(expert, "get_domain_action_details", action="move")
    assert "takes no time" in refusal(expert, "get_domain_durative_action_details", durative_action="meet")
    assert "parameters" in refusal(expert, "get_domain_action_details", action="meet", parameters=["a", "b", "c"])
    assert "continuous" in refusal(expert, "get_domain_durative_action_details", durative_action="drain")
    assert "forall" in refusal(expert, "get_domain_action_details", action="shout", parameters=["shout"])


def test_derived_predicates(expert):
    """Each rule has its head, with parameters by type and position, and its condition, with positions."""
    found = answer(expert, "get_domain_derived_predicate_details", "predicates", predicate="Inferred_at")
    assert [[p.name for p in rule.predicate.parameters] for rule in found] == [["?robot0", "?room1"]] * 2
    assert [text(rule.preconditions) for rule in found] == [
        "(and (robot_at ?0 ?1))",
        "(and (exists ?p:person (person_at ?p ?1)))",
    ]
    assert "no rule for quiet" in refusal(expert, "get_domain_derived_predicate_details", predicate="quiet")


def test_the_domain_is_written_in_pddl(expert):
    """It reads back as the same domain."""
    written = answer(expert, "get_domain", "domain")
    with kbstore.open("sqlite://", "again", clock=ManualClock()) as kb:
        kb.load(written)
        assert [found.name for found in kb.domain.predicates] == ["Robot_At", "person_at", "quiet", "inferred_at"]
        assert list(kb.domain.actions) == ["move", "drain", "meet", "shout"]


def test_without_a_domain_everything_is_refused():
    """The error of every service says that a domain has to be loaded."""
    with kbstore.open("sqlite://", "experts", clock=ManualClock()) as kb:
        expert = DomainExpert(kb, Messages())
        assert {"load one" in refusal(expert, service) for service in expert.TYPES} == {True}
