"""V11: `find` returns the bindings of a condition's free variables for which it is true."""

import random
from itertools import product

import pytest

import kbstore
from kbstore import InvalidKnowledge, Truth
from tests.conftest import START

DOMAIN = """(define (domain floor)
  (:types robot place - object  room - place)
  (:constants Base - place)
  (:predicates (robot_at ?r - robot ?p - place) (linked ?a ?b - place) (visited ?p - place) (raining)
               (reachable ?p - place))
  (:functions (battery ?r - robot) (distance ?a ?b - place) (cost))
  (:derived (reachable ?p - place) (or (linked Base ?p) (exists (?q - place) (and (reachable ?q) (linked ?q ?p))))))"""


@pytest.fixture
def world(open_kb, clock):
    """Two robots, three places of which one is a room, and the base."""
    kb = open_kb(clock=clock)
    kb.load(DOMAIN)
    kb.add("Kenny - robot", "amy - robot", "wp0 - place", "wp1 - place", "Hall - room")
    kb.add("(robot_at kenny wp0)", "(robot_at amy hall)", "(linked base wp0)", "(linked wp0 hall)")
    kb.add("(= (battery kenny) 80)", "(= (battery amy) 10)", "(= (distance wp0 hall) 7)", "(visited wp0)")
    return kb


FOUND = [
    ("(robot_at ?r ?w)", ["amy Hall", "Kenny wp0"]),
    ("(and (robot_at ?r ?w) (> (battery ?r) 20))", ["Kenny wp0"]),
    ("(and (robot_at ?r ?w) (not (> (battery ?r) 20)))", ["amy Hall"]),
    ("(not (> (battery ?r) 20))", ["amy"]),
    ("(and (robot_at ?r ?w) (linked ?v ?w))", ["amy Hall wp0", "Kenny wp0 Base"]),
    ("(and (linked ?a ?b) (linked ?b ?c))", ["Base wp0 Hall"]),
    ("(linked ?a ?a)", []),
    ("(robot_at kenny ?W)", ["wp0"]),
    ("(robot_at ? ?w)", ["Hall", "wp0"]),
    ("(> (distance ?a ?b) 5)", ["wp0 Hall"]),
    ("(>= (+ (battery ?r) (distance ?a hall)) 17)", ["amy wp0", "Kenny wp0"]),
    ("(= (battery ?r) (battery ?s))", ["amy amy", "Kenny Kenny"]),
    ("(battery ?r)", ["amy", "Kenny"]),
    ("(not (visited ?w - place))", ["Base", "Hall", "wp1"]),
    ("(not (visited ?w - room))", ["Hall"]),
    ("(not (visited ?w - (either room robot)))", ["amy", "Hall", "Kenny"]),
    ("(and (linked ?a ?b) (not (visited ?b)))", ["wp0 Hall"]),
    ("(and (not (visited ?b - room)) (linked ?a ?b))", ["Hall wp0"]),
    ("(and (linked ?a ?b) (not (= ?a base)))", ["wp0 Hall"]),
    ("(or (robot_at kenny ?w) (robot_at amy ?w))", ["Hall", "wp0"]),
    ("(or (visited ?w) (linked ?w hall))", ["wp0"]),
    ("(and (or (visited ?w) (linked base ?w)) (robot_at ?r ?w))", ["wp0 Kenny"]),
    ("(imply (not (visited ?w)) (robot_at amy ?w))", ["Hall", "wp0"]),
    ("(not (or (not (visited ?w)) (not (robot_at kenny ?w))))", ["wp0"]),
    ("(reachable ?w)", ["Hall", "wp0"]),
    ("(and (reachable ?w) (not (visited ?w)))", ["Hall"]),
    ("(exists (?r - robot) (robot_at ?r ?w))", ["Hall", "wp0"]),
    ("(exists (?r - robot) (and (robot_at ?r ?w) (> (battery ?r) 20)))", ["wp0"]),
    ("(forall (?p - place) (or (not (linked ?p ?w - place)) (visited ?p)))", ["Base", "Hall", "wp1"]),
    ("?w - room", ["Hall"]),
    ("(and (?r - robot) (not (robot_at ?r hall)))", ["Kenny"]),
    ("(visited wp0)", [""]),
    ("(raining)", []),
    ("(not (raining))", [""]),
    ("(and)", [""]),
]  # fmt: skip


LEAVES = [
    *("(robot_at ?r ?p)", "(robot_at ?r ?q)", "(linked ?p ?q)", "(linked ?q ?p)", "(visited ?p)", "(visited ?q)"),
    *("(reachable ?q)", "(> (battery ?r) 4)", "(= ?p ?q)", "(not (visited ?q))"),
]


def rows(found):
    """The answers as text, their objects in the order of the variables."""
    return [" ".join(answer.values()) for answer in found]


@pytest.mark.parametrize(("condition", "expected"), FOUND, ids=[condition for condition, _ in FOUND])
def test_find_returns_the_bindings_that_make_the_condition_true(world, condition, expected):
    """V11: joins, negation, comparisons, quantifiers, rules; without repetition, in the order of the objects."""
    for ask in (world.find, world.state().find, lambda text: world.find(text, at=START, as_of=START)):
        found = ask(condition)
        assert rows(found) == sorted(expected, key=str.lower)


def test_variables_are_named_as_written(world):
    """V11, D3: the keys are the variables as first written, in any case."""
    assert world.find("(and (robot_at ?R ?w) (> (battery ?r) 20))") == [{"R": "Kenny", "w": "wp0"}]


@pytest.mark.parametrize(
    "condition",
    [
        "(not (visited ?w))",
        "(or (visited ?w) (raining))",
        "(or (visited ?w) (robot_at ?r hall))",
        "(and (raining) (not (= ?a ?b)))",
        "(= ?a wp0)",
        "(forall (?p - place) (linked ?p ?w))",
        "(imply (visited ?w) (raining))",
    ],
)
def test_an_unbound_variable_needs_a_type(world, condition):
    """V11: where a branch is true without it, it could be anything; `=` and `forall` bind nothing."""
    with pytest.raises(InvalidKnowledge, match=r"give its type where it first occurs: \?\w - object"):
        world.find(condition)


@pytest.mark.parametrize(
    ("condition", "error"),
    [
        ("(robot_at wp0 ?w)", InvalidKnowledge),
        ("(robot_at ?r ?w - robot)", InvalidKnowledge),
        ("(flying ?r)", kbstore.UnknownSymbol),
        ("(robot_at ?r ?w - planet)", kbstore.UnknownSymbol),
        ("(robot_at ?r)", InvalidKnowledge),
        ("(robot_at ?r ?w", kbstore.PddlSyntaxError),
        ("hall", kbstore.KbStoreError),
        ("(> (battery ?) 3)", InvalidKnowledge),
    ],
)
def test_find_refuses_what_a_question_refuses(world, condition, error):
    """V7, V8, V10: `find` raises the same errors as the question."""
    for ask in (world.find, world.state().find):
        with pytest.raises(error):
            ask(condition)


def test_find_takes_at_and_as_of(world, clock):
    """V11: at a time, as of a time, and in a transaction, which sees its own writes."""
    before = world.now()
    clock.advance(10)
    world.remove("(robot_at amy ?)")
    assert rows(world.find("(robot_at ?r ?)")) == ["Kenny"]
    assert rows(world.find("(robot_at ?r ?)", at=before)) == ["amy", "Kenny"]
    world.add("(robot_at amy wp1)", initial_time=clock.now() + 50)
    assert rows(world.find("(robot_at amy ?w)", at=clock.now() + 50)) == ["wp1"]
    assert rows(world.find("(robot_at amy ?w)", at=clock.now() + 50, as_of=before)) == ["Hall"]
    with world.transaction() as tx:
        tx.add("(visited hall)")
        assert rows(tx.state().find("(visited ?w)")) == ["Hall", "wp0"]


def test_messages_are_queries_too(world):
    """V11: an item whose arguments are variables, and a formula."""
    assert rows(world.find(kbstore.Fact(attribute_name="robot_at", values=["?r", "?w"]))) == ["amy Hall", "Kenny wp0"]


def test_without_a_domain_arguments_need_not_exist(open_kb):
    """D2: true atoms of undeclared names are found."""
    kb = open_kb()
    kb.add("(seen a b)", "(seen b c)", "(= (size a) 3)")
    assert rows(kb.find("(and (seen ?x ?y) (seen ?y ?z))")) == ["a b c"]
    assert rows(kb.find("(and (seen ?x ?) (> (size ?x) 2))")) == ["a"]
    assert rows(kb.find("(> (size ?x) 2)")) == ["a"]
    with pytest.raises(InvalidKnowledge, match="give its type"):
        kb.find("(not (seen ?x b))")


@pytest.mark.parametrize("use_unknowns", [False, True])
@pytest.mark.parametrize("seed", range(6))
def test_random_queries_agree_with_trying_every_object(open_kb, clock, seed, use_unknowns):
    """V11: every binding found makes the condition true, and no other binding does."""
    chance = random.Random(seed)
    kb = open_kb(clock=clock, use_unknowns=use_unknowns)
    kb.load(DOMAIN)
    places, robots = ["wp0", "wp1", "hall"], ["kenny", "amy"]
    kb.add("kenny - robot", "amy - robot", "wp0 - place", "wp1 - place", "hall - room")
    everywhere = [*places, "base"]
    for robot, place in product(robots, everywhere):
        if chance.random() < 0.5:
            kb.add(f"(robot_at {robot} {place})" if chance.random() < 0.7 else f"(not (robot_at {robot} {place}))")
    for one, other in product(everywhere, repeat=2):
        if chance.random() < 0.4:
            kb.add(f"(linked {one} {other})")
    for place in everywhere:
        if chance.random() < 0.4:
            kb.add(f"(visited {place})" if chance.random() < 0.6 else f"(not (visited {place}))")
    kb.add(f"(= (battery kenny) {chance.randrange(9)})")

    def condition(depth):
        if not depth:
            return chance.choice(LEAVES)
        parts = [condition(depth - 1) for _ in range(2)]
        return chance.choice([f"(and {' '.join(parts)})", f"(or {' '.join(parts)})", f"(not {parts[0]})"])

    for _ in range(25):
        text = condition(chance.randrange(3))
        query = f"(and (?r - robot) (?p - place) (?q - place) {text})"
        expected = []
        for robot, place, other in product(robots, everywhere, everywhere):
            asked = text.replace("?r", robot).replace("?p", place).replace("?q", other)
            if kb.truth(asked) is Truth.TRUE:
                expected.append(f"{robot} {place} {other}")
        assert [row.lower() for row in rows(kb.find(query))] == sorted(expected)
