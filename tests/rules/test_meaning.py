"""V10: a question that cannot be meant is refused, with a suggestion; a false one is answered."""

import pytest

from kbstore import Fact, Function, InvalidKnowledge, Truth, seconds
from tests.conftest import START

DOMAIN = """(define (domain floor)
  (:types robot place item - object  dock - place  crate - item)
  (:constants base - dock)
  (:predicates (robot_at ?r - robot ?p - place) (linked ?a ?b - place) (seen ?x) (moved ?x - (either robot item))
               (reachable ?p - place))
  (:functions (battery ?r - robot) (cost))
  (:derived (reachable ?p - place) (linked base ?p))
  (:action go :parameters (?r - object ?p - place) :precondition (not (robot_at ?r ?p)) :effect (seen ?r)))"""


@pytest.fixture
def world(open_kb, clock):
    """Kenny at wp0, and a box."""
    kb = open_kb(clock=clock)
    kb.load(DOMAIN)
    kb.add(
        "kenny - robot", "wp0 - place", "wp1 - place", "box - crate", "(robot_at kenny wp0)", "(= (battery kenny) 5)"
    )
    return kb


def asking(kb):
    """Every way to ask a condition."""
    return [
        kb.truth,
        kb.holds,
        kb.query,
        kb.explain,
        kb.state().truth,
        kb.state().explain,
        lambda question: kb.holds(question, at=START),
        lambda question: kb.holds(question, as_of=START),
        lambda question: kb.when(question, START, START + 9),
    ]


WRONG = [
    ("(robot_at wp0 kenny)", r"did you mean \(robot_at kenny wp0\)\?"),
    ("(robot_at base kenny)", r"base is a dock, and \?r of robot_at is a robot.* did you mean \(robot_at kenny base\)"),
    ("(robot_at kenny box)", r"box is a crate, and \?p of robot_at is a place: \(robot_at \?r - robot \?p - place\)$"),
    ("(robot_at ? box)", r"box is a crate"),
    ("(linked wp0 kenny)", "kenny is a robot"),
    ("(moved base)", r"base is a dock, and \?x of moved is a robot or item"),
    ("(reachable kenny)", "kenny is a robot"),
    ("(not (robot_at kenny box))", "box is a crate"),
    ("(and (robot_at kenny wp0) (or (robot_at kenny box) (seen kenny)))", "box is a crate"),
    ("(imply (robot_at kenny box) (seen kenny))", "box is a crate"),
    ("(exists (?r - robot) (robot_at ?r box))", "box is a crate"),
    ("(> (battery wp0) 3)", "wp0 is a place"),
    ("(exists (?x - item) (robot_at ?x wp0))", r"\?x is an item, and \?r of robot_at is a robot"),
    ("(forall (?x - (either item dock)) (robot_at ?x wp0))", r"\?x is an item or dock"),
    ("(exists (?p - place) (> (battery ?p) 3))", r"\?p is a place"),
    ("raining", r"a fact is in brackets: \(raining\).*raining - object"),
    ("kenny", r"kenny - object"),
]


@pytest.mark.parametrize(("question", "reason"), WRONG)
def test_a_question_that_cannot_be_meant_is_refused(world, question, reason):
    """V10: in every method, and however often it is asked; the answer would be the same in every state."""
    for _ in range(2):
        for ask in asking(world):
            with pytest.raises(InvalidKnowledge, match=reason):
                ask(question)


def test_items_and_values_are_refused_alike(world):
    """V10: a question may be an item, and may ask for a value."""
    with pytest.raises(InvalidKnowledge, match="did you mean"):
        world.holds(Fact(attribute_name="robot_at", values=["wp0", "kenny"]))
    with pytest.raises(InvalidKnowledge, match="wp0 is a place"):
        world.holds(Function(attribute_name="battery", values=["wp0"]))
    for _ in range(2):
        for ask in (world.value, world.state().value):
            with pytest.raises(InvalidKnowledge, match="wp0 is a place"):
                ask("(battery wp0)")
            with pytest.raises(InvalidKnowledge, match="box is a crate"):
                ask("(+ 1 (battery box))")


RIGHT = [
    ("(robot_at kenny wp1)", Truth.FALSE),
    ("(robot_at kenny nowhere)", Truth.FALSE),
    ("(robot_at kenny base)", Truth.FALSE),
    ("(robot_at nobody wp0)", Truth.FALSE),
    ("(seen wp0)", Truth.FALSE),
    ("(moved box)", Truth.FALSE),
    ("(exists (?x - object) (robot_at ?x wp0))", Truth.TRUE),
    ("(exists (?x - (either item robot)) (robot_at ?x wp0))", Truth.TRUE),
    ("(exists (?d - dock) (robot_at kenny ?d))", Truth.FALSE),
    ("(exists (?x) (robot_at kenny ?x))", Truth.TRUE),
    ("wp7 - place", Truth.FALSE),
    ("box - place", Truth.FALSE),
    ("(= kenny wp0)", Truth.FALSE),
]


@pytest.mark.parametrize(("question", "truth"), RIGHT)
def test_a_question_that_can_be_meant_is_answered(world, question, truth):
    """V8, V10: unknown objects, a type that could fit, a subtype, a variable over more types than fit."""
    for _ in range(2):
        assert world.truth(question) is world.state().truth(question) is truth
    assert world.when(question, START, START + 1) == ([(START, START + 1)] if truth is Truth.TRUE else [])


def test_arguments_of_an_action_are_not_refused(world):
    """V10: where the object does not fit, the atom is absent: go takes any object, and a box is nowhere."""
    assert world.applicable("go", "box", "wp0")


def test_the_types_are_those_at_the_time_that_is_asked_about(world, clock):
    """V10: an object that gets another type later is refused then, and not before."""
    before = world.now()
    assert not world.holds("(robot_at ghost wp0)")
    clock.advance(10)
    world.add("ghost - item")
    clock.advance(10)
    for _ in range(2):
        with pytest.raises(InvalidKnowledge, match="ghost is an item"):
            world.holds("(robot_at ghost wp0)")
        assert not world.holds("(robot_at ghost wp0)", at=before)
        assert not world.holds("(robot_at ghost wp0)", as_of=before)
    world.remove("ghost - item")
    clock.advance(10)
    world.add("ghost - robot", "(robot_at ghost wp1)")
    assert not world.holds("(robot_at ghost wp0)")
    assert world.holds("(robot_at ghost wp1)")
    with pytest.raises(InvalidKnowledge, match="ghost is an item"):
        world.holds("(robot_at ghost wp0)", at=before + 15)


def test_over_a_span_a_type_that_fits_anywhere_is_enough(world, clock):
    """V10: a name is refused where it exists in the span, and is nowhere of a type that fits."""
    clock.advance(10)
    world.add("ghost - item")
    clock.advance(10)
    world.remove("ghost - item")
    clock.advance(10)
    world.add("ghost - robot", "(robot_at ghost wp1)")
    assert world.when("(robot_at ghost wp1)", START, START + 40) == [(START + 30, START + 40)]
    assert world.when("(robot_at ghost wp1)", START, START + 10) == []
    with pytest.raises(InvalidKnowledge, match="ghost is an item"):
        world.when("(robot_at ghost wp1)", START, START + 30)


def test_without_a_domain_nothing_is_excluded(open_kb):
    """V10, D2: there are no parameters that could exclude a type."""
    kb = open_kb()
    kb.add("kenny - robot", "wp0 - place", "(robot_at kenny wp0)")
    assert not kb.holds("(robot_at wp0 kenny)")
    with pytest.raises(InvalidKnowledge, match="bare word"):
        kb.holds("kenny")


def test_a_question_in_a_transaction_uses_its_own_objects(world):
    """V10: including an object that the transaction itself has added."""
    with world.transaction() as tx:
        tx.add("lid - item")
        with pytest.raises(InvalidKnowledge, match="lid is an item"):
            tx.holds("(robot_at lid wp0)")
        with pytest.raises(InvalidKnowledge, match="lid is an item"):
            tx.state().holds("(robot_at lid wp0)")
    assert not world.holds("(robot_at kenny wp1)", at=world.now() + seconds(1))
