"""The state read from a server is exactly the recorded one."""

import math
import uuid

import psycopg
import pytest
import sqlalchemy as sa

import kbstore
from kbstore import ManualClock, seconds

START = seconds(1_700_000_000)
SMALLEST, LARGEST = 5e-324, 1.7976931348623157e308


@pytest.fixture
def kb(postgresql_url):
    """A new knowledge base on a server."""
    with kbstore.open(postgresql_url, f"whole{uuid.uuid4().hex[:8]}", clock=ManualClock(START)) as kb:
        yield kb


def test_a_state_equals_the_recorded_one(kb):
    """Numbers to the last bit and texts in any script, of all knowledge types, of both signs; now, too."""
    numbers = {"tiny": SMALLEST, "huge": -LARGEST, "third": 1 / 3, "zero": -0.0}
    kb.add("kenny - robot", "küche - œuvre", "wp0 - place")
    kb.add("(at kenny küche)", "(not (at kenny wp0))", *(f"(= ({name}) {value!r})" for name, value in numbers.items()))
    kb.add("(> (tiny) 5)", "(not (<= (huge) (third)))")
    kb.add_goal("(at kenny wp0)", "(or (at kenny küche) (at kenny wp0))")
    kb.add_metric("minimize (third)")
    kb._clock.advance(seconds(10))
    for state in (kb.state(), kb.state(at=kb.now() - 1)):
        assert {item.instance_name: item.instance_type for item in state.instances} == {
            "kenny": "robot",
            "küche": "œuvre",
            "wp0": "place",
        }
        assert {str(item) for item in state.facts} == {"(at kenny küche)", "(not (at kenny wp0))"}
        assert {item.initial_time for item in state.facts} == {START}
        found = {item.attribute_name: item.function_value for item in state.functions}
        assert found == numbers
        assert math.copysign(1, found["zero"]) == -1
        assert {str(item) for item in state.inequalities} == {"(> (tiny) 5)", "(not (<= (huge) (third)))"}
        assert {str(item) for item in state.goals} == {"(at kenny wp0)", "(or (at kenny küche) (at kenny wp0))"}
        assert state.metric.optimization == "minimize"


def test_a_caller_with_client_side_cursors_reads_the_same_state(kb, postgresql_url):
    """On an engine whose cursors have no binary answers, numbers and bytes are read as text."""
    kb.add("kenny - robot", "(at kenny küche)", "(= (third) 0.3333333333333333)", f"(= (huge) {-LARGEST!r})")
    kb.add("(at kenny lab)", initial_time=START + seconds(60))
    engine = sa.create_engine(postgresql_url, connect_args={"cursor_factory": psycopg.ClientCursor})
    with kbstore.open(engine, kb.name, clock=kb._clock) as other:
        for at in (None, START, START + seconds(70)):
            assert other.state(at).to_dict() == kb.state(at).to_dict()
        assert other.add("(at kenny hall)").changes == 1
    engine.dispose()


def test_a_clock_behind_the_latest_transaction(kb):
    """T3: now is the time of the latest transaction, and its state includes that transaction."""
    kb.add("(at kenny hall)")
    kb._clock.set(START - 1)
    assert [str(item) for item in kb.state().facts] == ["(at kenny hall)"]
    assert kb.state().at == START


def test_a_transaction_committed_while_the_clock_is_behind(kb, postgresql_url, monkeypatch):
    """T3: a state includes all of another process's transaction, or nothing, if the state's time was not known."""
    kb.add("(at kenny hall)")
    kb._clock.set(START - 1)
    resolve = kb._reader.resolver.resolve
    written = []

    def write_and_resolve(*args):
        with kbstore.open(postgresql_url, kb.name, clock=kb._clock) as other, other.transaction() as tx:
            tx.remove("(at kenny hall)")
            tx.add("(= (battery kenny) 80)")
        written.append(tx.result)
        return resolve(*args)

    monkeypatch.setattr(kb._reader.resolver, "resolve", write_and_resolve)
    state = kb.state()
    assert [transaction.changes for transaction in written] == [2]
    assert [str(item) for item in (*state.facts, *state.functions)] == ["(at kenny hall)"]
    monkeypatch.undo()
    assert [str(item) for item in (*kb.state().facts, *kb.state().functions)] == ["(= (battery kenny) 80)"]


def test_a_new_kind_of_knowledge_of_another_process_is_read(kb, postgresql_url):
    """The state includes a type of knowledge that only another process has recorded so far."""
    kb.add("(at kenny hall)")
    kb._clock.advance(seconds(10))
    assert len(kb.state().facts) == 1
    with kbstore.open(postgresql_url, kb.name, clock=kb._clock) as other:
        other.add("kenny - robot", "(= (battery kenny) 80)")
        other.add("(at kenny lab)", initial_time=other.now() + seconds(60))
        kb._clock.advance(1)
        state = kb.state()
    assert ([len(part) for part in (state.instances, state.functions, state.timed_knowledge)]) == [1, 1, 1]
