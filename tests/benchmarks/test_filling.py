"""Histories that benchmarks write directly equal those written by the public methods."""

import sqlite3

import pytest

import kbstore
from benchmarks.filling import fill
from benchmarks.histories import PASSING, SHAPES, STANDING, START, STEP, History, replay
from kbstore import ManualClock

_ASSERTIONS = (
    "SELECT t.key, x.initial_time, x.end_time, x.is_negative, x.recorded_tx, x.ended_tx, x.end_cause, x.retired_tx,"
    " x.told_tx, x.level{own} FROM {table} x JOIN timelines t ON t.id = x.timeline_id ORDER BY t.key, x.initial_time"
)
_CONTENT = {
    "facts": _ASSERTIONS.format(table="facts", own=""),
    "instances": _ASSERTIONS.format(table="instances", own=", x.instance_type"),
    "timelines": "SELECT kb_id, role, knowledge_type, key, spelling FROM timelines ORDER BY role, knowledge_type, key",
    "mentions": (
        "SELECT o.key, t.key FROM mentions m JOIN timelines o ON o.id = m.object_id"
        " JOIN timelines t ON t.id = m.timeline_id ORDER BY o.key, t.key"
    ),
    "transactions": (
        "SELECT kb_id, number, recorded_time, changes, client, note, late_from, last_timeline FROM transactions"
        " ORDER BY number"
    ),
    "knowledge_bases": "SELECT * FROM knowledge_bases",
    "heads": (
        "SELECT kb_id, last_number, last_time, last_late, last_timeline, last_run, domain_version, history_from,"
        " present FROM heads"
    ),
}


@pytest.fixture(scope="module", params=SHAPES)
def history(request):
    """A small history of each shape."""
    return History(request.param, 1300)


@pytest.fixture(scope="module")
def stores(history, tmp_path_factory):
    """The same history written directly, and by a knowledge base."""
    directory = tmp_path_factory.mktemp("stores")
    fill(history, directory / "filled.db")
    replay(history, f"sqlite:///{directory / 'replayed.db'}")
    return directory / "filled.db", directory / "replayed.db"


@pytest.mark.parametrize("table", _CONTENT)
def test_histories_written_directly_equal_those_of_the_public_methods(stores, table):
    """Each table has the same rows, either way; only positions in a transaction, and tokens, may differ."""
    filled, replayed = (_rows(store, _CONTENT[table]) for store in stores)
    assert filled
    assert filled == replayed


def test_a_thousand_facts_hold_at_any_time(history, stores):
    """At each of the six times about a thousand facts hold: exactly a thousand, or those of 250 objects."""
    with kbstore.open(stores[0], "bench", clock=ManualClock(START + history.size * STEP)) as kb:
        assert [len(kb.state(at=t).facts) for t in history.moments()] == [STANDING] * 6
        if history.shape == PASSING:
            assert [len(kb.state(at=t).instances) for t in history.moments()] == [STANDING // 4] * 6


def _rows(store, query):
    connection = sqlite3.connect(store)
    try:
        return connection.execute(query).fetchall()
    finally:
        connection.close()
