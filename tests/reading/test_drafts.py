"""Explanations within an open transaction: by what it changed itself, or else by the record (rules V6, O1)."""

import random
from contextlib import suppress

import pytest

from kbstore import InvalidKnowledge, seconds
from tests.conftest import START

DOMAIN = """
(define (domain house)
  (:requirements :typing :fluents)
  (:types room)
  (:predicates (open ?r - room) (lit ?r - room) (alarm))
  (:functions (charge))
  (:action enter :parameters (?r - room) :precondition (and (open ?r) (> (charge) 2)) :effect (alarm)))
"""
ATOMS = ("(open hall)", "(open lab)", "(lit hall)", "(alarm)")
QUESTIONS = (
    *ATOMS,
    "(not (alarm))",
    "(and (open hall) (lit hall))",
    "(or (open hall) (alarm))",
    "(> (charge) 2)",
    "(exists (?r - room) (open ?r))",
    "(forall (?r - room) (open ?r))",
)


@pytest.fixture
def house(open_kb):
    kb = open_kb()
    kb.load(DOMAIN)
    kb.add("hall - room", "lab - room", "(open hall)", "(= (charge) 5)")
    return kb


def test_what_the_transaction_removed_is_false_since_now(house, clock):
    """V6, O1: the reason and the time are the transaction's, which has no number yet."""
    clock.advance(seconds(9))
    with house.transaction() as tx:
        tx.remove("(open hall)")
        explained = tx.state().explain("(open hall)")
        failing = tx.applicable("enter", "hall").failing
    assert (explained.reason, explained.since, explained.transaction) == ("removed", START + seconds(9), None)
    assert [(str(part.condition), part.since) for part in failing] == [("(open hall)", START + seconds(9))]


def test_what_the_transaction_added_is_asserted_now(house, clock):
    """V6: not "never told"; a fact beside it keeps the transaction that recorded it."""
    clock.advance(seconds(9))
    with house.transaction() as tx:
        tx.add("(lit hall)", "(not (alarm))")
        lit, alarm, is_open = (tx.state().explain(atom) for atom in ("(lit hall)", "(alarm)", "(open hall)"))
    assert (lit.reason, lit.since, lit.transaction) == ("asserted", START + seconds(9), None)
    assert (alarm.reason, alarm.since) == ("explicitly false", START + seconds(9))
    assert (is_open.reason, is_open.since, is_open.transaction.number) == ("asserted", START, 2)


def explained(state):
    """What each question's explanation says; the error of a question about an object that does not exist."""
    for question in (*QUESTIONS, "lab - room"):
        try:
            found = state.explain(question)
        except InvalidKnowledge as error:
            yield question, str(error), None
        else:
            yield question, (found.truth, found.reason, found.since), found.transaction


@pytest.mark.parametrize("seed", range(12))
def test_a_draft_is_explained_as_it_will_be(house, clock, seed):
    """V6: truth, reason and time are those that the store gives for the same time after the commit."""
    chance = random.Random(seed)
    for _ in range(8):
        clock.advance(seconds(chance.randrange(1, 4)))
        with house.transaction() as tx:
            for _ in range(chance.randrange(1, 4)):
                atom = chance.choice(ATOMS)
                # what mentions an object that does not exist is refused
                with suppress(InvalidKnowledge):
                    match chance.randrange(7):
                        case 0:
                            tx.remove(atom)
                        case 1:
                            tx.add(f"(not {atom})")
                        case 2:
                            tx.add(f"(= (charge) {chance.randrange(5)})")
                        case 3:
                            tx.remove("lab")
                        case 4:
                            tx.add("lab - room")
                        case _:
                            tx.add(atom)
            drafted = list(explained(tx.state()))
        for (question, draft, by), (_, later, then) in zip(drafted, explained(house.state()), strict=True):
            assert draft == later, question
            assert by == (None if then == tx.result else then), question
