"""The messages of a state: made once for a row, and never used where another is right."""

import pytest

import kbstore
from kbstore import seconds
from tests.conftest import START

DOMAIN = """
(define (domain house) (:requirements :typing :fluents) (:types robot place - object)
  (:predicates (at ?r - robot ?p - place)) (:functions (charge ?r - robot)))
"""


@pytest.fixture
def clock():
    """A clock that does not advance."""
    return kbstore.ManualClock(START)


@pytest.fixture
def kb(clock):
    """A robot at a place, with a number."""
    with kbstore.open(":memory:", clock=clock) as kb:
        kb.load(DOMAIN)
        kb.add("r0 - robot", "p0 - place", "(at r0 p0)", "(= (charge r0) 9)")
        yield kb


def parts(state):
    """All messages of a state."""
    return [*state.instances, *state.facts, *state.functions]


def test_a_row_has_one_message(kb, clock):
    """An unchanged row has the same object in the states of different times."""
    before = parts(kb.state())
    clock.advance(1)
    assert all(one is other for one, other in zip(before, parts(kb.state()), strict=True))
    assert kb.propositions("at")[0] is before[2]


def test_a_message_is_that_of_its_row(kb, clock):
    """V1, C3: each state has the sign and the time of the row that holds then, in any order of asking."""
    clock.advance(1)
    kb.add("(not (at r0 p0))")
    clock.advance(1)
    kb.add("(at r0 p0)", "(= (charge r0) 7)")
    seen = {t: [(f.is_negative, f.initial_time) for f in kb.state(at=t).facts] for t in (START + 2, START, START + 1)}
    assert seen == {START: [(False, START)], START + 1: [(True, START + 1)], START + 2: [(False, START + 2)]}
    assert [kb.state(at=t).functions[0].function_value for t in (START + 1, START + 2, START)] == [9, 7, 9]


def test_a_number_that_moves_has_a_message_for_each_time(kb, clock):
    """C7: its value is that at the time of the state."""
    kb.add("(increase (charge r0) (* #t -1))")
    values = []
    for _ in range(3):
        values.append(kb.state().functions[0].function_value)
        clock.advance(seconds(1))
    assert values == [9, 8, 7]


def test_labels_are_those_of_the_domain_at_that_time(kb, clock):
    """D4: a state has the labels of the version in force at its time."""
    clock.advance(1)
    kb.load(DOMAIN.replace("(at ?r - robot ?p - place)", "(at ?who - robot ?where - place)"))
    labels = {t: kb.state(at=t).facts[0].labels for t in (START + 1, START, START + 1)}
    assert labels == {START: ("r", "p"), START + 1: ("who", "where")}


def test_without_a_domain_labels_are_learned(clock):
    """D2: a fact gets the labels that were given later, also in a state that was returned without them."""
    with kbstore.open(":memory:", clock=clock) as kb:
        kb.add("(at r0 p0)")
        assert kb.state().facts[0].labels == ("arg1", "arg2")
        clock.advance(1)
        kb.add(kbstore.Fact(attribute_name="at", values={"r": "r1", "p": "p1"}))
        assert [fact.labels for fact in kb.state().facts] == [("r", "p"), ("r", "p")]
