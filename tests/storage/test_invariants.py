"""Random transactions keep the invariants of the tables: nodes, ends, numbers, and no overlaps."""

import random
from contextlib import suppress

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import kbstore
from kbstore import KbStoreError
from kbstore.clock import OPEN, seconds
from tests.conftest import START
from tests.storage.invariants import EMPTY_LEVEL, violations

DOMAIN = """
(define (domain rooms)
  (:requirements :typing :fluents :durative-actions :negative-preconditions)
  (:types place robot)
  (:predicates (open ?p - place) (near ?r - robot ?p - place) (raining))
  (:functions (battery ?r - robot) (cost))
  (:durative-action go :parameters (?r - robot ?to - place) :duration (<= ?duration 100)
    :condition (and (at start (not (near ?r ?to))))
    :effect (and (decrease (battery ?r) (* #t 0.5)) (increase (cost) (* #t 1)) (at end (near ?r ?to)))))
"""

OBJECTS = ("wp0 - place", "wp1 - place", "kenny - robot", "rita - robot")
FACTS = ("(open wp0)", "(open wp1)", "(near kenny wp0)", "(near kenny wp1)", "(near rita wp0)", "(raining)")
SIGNED = (*FACTS, *(f"(not {fact})" for fact in FACTS))
NUMBERS = ("(= (battery kenny) 3)", "(= (battery rita) 7)", "(= (cost) 2)", "(= (cost) 5)")
RELATIVE = ("(increase (battery kenny) 1)", "(scale-up (cost) 2)", "(increase (cost) (* #t 2))")
OTHERS = ("(> (cost) 3)", "minimize (battery kenny)", "minimize (cost)")
PATTERNS = ("(near ? wp0)", "(open ?)", "wp0", "kenny", "(not (wp1 - place))")
ENDS = ("(not (wp0 - place))", "(not (wp1 - place))", "(not (kenny - robot))")
DELAYS = (None, None, None, 2, 3, 4, 6)
LATE = ("late", "late", "late", "late", "late end", "late end")
ACTIONS = tuple((robot, place) for robot in ("kenny", "rita") for place in ("wp0", "wp1"))


def steps(choose):
    """A step of a transaction: the change, its item, and the seconds until it; `choose` takes one of several."""
    kind = choose(
        (*["add"] * 12, "change", *["remove"] * 5, "goal", *["start"] * 3, "end", "end", "abort", "clear", *LATE)
    )
    match kind:
        case "late" | "late end":
            return kind, choose((*OBJECTS, *SIGNED, *SIGNED, *NUMBERS)), (choose(range(1, 12)), choose((None, 1, 3)))
        case "add":
            return kind, choose((*OBJECTS, *ENDS, *SIGNED, *NUMBERS, *NUMBERS, *OTHERS)), choose(DELAYS)
        case "change":
            return "add", choose(RELATIVE), None
        case "remove":
            return kind, choose((*OBJECTS, *ENDS, *SIGNED, *SIGNED, *PATTERNS)), choose(DELAYS)
        case "goal":
            return kind, choose(SIGNED), choose(DELAYS)
        case "start":
            return kind, choose(ACTIONS), None
    return kind, None, None


def sequences(choose):
    """Transactions: the seconds before each, its steps, and whether it is rolled back at the end."""
    return [
        (choose(range(5)), [steps(choose) for _ in range(choose((1, 1, 2, 4)))], choose((False, False, False, True)))
        for _ in range(choose((3, 8, 14)))
    ]


def take_step(transaction, step, now):
    kind, what, delay = step
    if kind.startswith("late"):
        ago, length = delay
        since = max(START, now - seconds(ago))
        until = None if length is None else min(now, since + seconds(length))
        (transaction.add if kind == "late" else transaction.remove)(what, since=since, until=until)
        return
    t = None if delay is None else now + seconds(delay)
    match kind:
        case "add":
            transaction.add(what, initial_time=t)
        case "remove":
            transaction.remove(what, initial_time=t)
        case "goal":
            transaction.add_goal(what, initial_time=t)
        case "start":
            transaction.start("go", *what, duration=seconds(6))
        case "clear":
            transaction.clear()
        case _:
            running = transaction.state().running
            if running:
                getattr(transaction, kind)(running[0])


def reading(kb):
    """A function that runs SQL on the store of a knowledge base, and the number of the knowledge base."""

    def execute(sql):
        with kb._database.connect() as session:
            return [tuple(row) for row in session.driver.execute(sql).fetchall()]

    return execute, execute(f"SELECT id FROM knowledge_bases WHERE name = '{kb.name}'")[0][0]


class GivenUp(Exception):
    """Leaves a transaction without storing it."""


def play(kb, clock, sequence):
    """Make random transactions; refused steps, and transactions that are rolled back, leave nothing."""
    kb.load(DOMAIN)
    kb.add(*OBJECTS, "(= (cost) 0)", "(= (battery kenny) 9)", "(= (battery rita) 9)")
    for wait, together, given_up in sequence:
        clock.advance(seconds(wait))
        before = kb.to_pddl()
        with suppress(GivenUp), kb.transaction() as transaction:
            for step in together:
                with suppress(KbStoreError):
                    take_step(transaction, step, clock.now())
            if given_up:
                raise GivenUp
        if given_up:
            assert kb.to_pddl() == before


@given(st.data())
@settings(max_examples=40, deadline=None, suppress_health_check=list(HealthCheck))
def test_the_tables_are_sound_after_random_transactions(data):
    """V1, C5, C6, C9, Q6: levels fit, ends are those derived, numbers have no gaps, nothing overlaps."""
    clock = kbstore.ManualClock(START)
    with kbstore.open("sqlite://", clock=clock) as kb:
        play(kb, clock, sequences(lambda choices: data.draw(st.sampled_from(choices))))
        assert violations(*reading(kb)) == []


def test_the_tables_are_sound_on_every_store(open_kb, clock):
    """The invariants hold on every kind of store."""
    chance = random.Random(7)
    for _ in range(5):
        kb = open_kb()
        play(kb, clock, sequences(chance.choice))
        assert violations(*reading(kb)) == []


WRONG = {
    "UPDATE facts SET level = level + 1": "is kept on the wrong level",
    "UPDATE schedules SET node = 1": "was pending at the wrong node",
    "DELETE FROM schedules": "is not of its transaction's time",
    "UPDATE facts SET end_time = end_time - 1 WHERE ended_tx IS NOT NULL": "did not end with its transaction",
    "UPDATE facts SET initial_time = initial_time + 1": "is not of its transaction's time",
    f"UPDATE facts SET end_time = {OPEN}, level = 62": "overlaps",
    f"UPDATE facts SET retired_tx = 4, level = {EMPTY_LEVEL}, end_time = initial_time": "retired without a revision",
    "DELETE FROM revisions": "was retired without a revision",
    "UPDATE revisions SET knowledge_type = 3": "was revised as another kind",
    "UPDATE facts SET seq = seq + 1": "have gaps",
    "UPDATE transactions SET recorded_time = 0 WHERE number = 3": "time runs backwards",
    "UPDATE transactions SET token = 7": "tokens are not random",
    "UPDATE heads SET last_number = 9": "numbers have gaps",
    "UPDATE heads SET last_token = 9": "the head is not that of the last transaction",
    "UPDATE heads SET last_timeline = 9": "timelines have gaps",
    "UPDATE heads SET present = 0": "does not list what is present",
    "DELETE FROM mentions": "is not known to mention",
}


@pytest.mark.parametrize("damage", WRONG)
def test_violations_are_found(damage):
    """The tests of this file can fail: damage to the tables is noticed."""
    clock = kbstore.ManualClock(START)
    with kbstore.open("sqlite://", clock=clock) as kb:
        kb.load(DOMAIN)
        kb.add("wp0 - place", "(open wp0)")
        kb.add("(not (open wp0))", initial_time=START + seconds(5))
        kb.add("(open wp0)", initial_time=START + seconds(6))
        kb.remove("(open wp0)", initial_time=START + seconds(6))
        clock.advance(seconds(1))
        kb.add("(not (open wp0))")
        assert violations(*reading(kb)) == []
        with kb._database.connect() as session:
            session.driver.execute(damage)
        assert any(WRONG[damage] in found for found in violations(*reading(kb)))
