"""The rows that a writer caches: it reads none of them again, and none that another writer has changed."""

import random

import pytest

import kbstore
from kbstore import StoreUnavailable, seconds
from kbstore.storage.memory import OpenRows
from kbstore.storage.records import StoredAssertion
from kbstore.storage.sqlite_connection import SqliteConnection
from tests.conftest import START

PLACES = tuple(f"p{n}" for n in range(4))


def row(number):
    """An open row."""
    return StoredAssertion(number, 0, number, kbstore.clock.OPEN, None, None, (False,))


def spans(kb):
    """Every assertion with its span and value, as stored."""
    return [(str(found.item), found.initial_time, found.end_time) for found in kb.history()]


def write_something(kb, chance, clock):
    """Change some values, some of them later or in the past, or end an object."""
    atom = f"(open {chance.choice(PLACES)})"
    match chance.randrange(9):
        case 0:
            kb.remove(atom)
        case 1:
            kb.add(atom, initial_time=clock.now() + seconds(2))
        case 2:
            kb.remove(atom, initial_time=clock.now() + seconds(2))
        case 3:
            kb.add(f"(not {atom})", since=clock.now() - seconds(1))
        case 4:
            place = chance.choice(PLACES)
            kb.add(f"(not ({place} - place))", initial_time=clock.now() + seconds(3))
            kb.add(f"{place} - place", initial_time=clock.now() + seconds(4))
        case 5:
            kb.add(f"(increase (level) {chance.randrange(3)})")
        case _:
            kb.add(*(f"(not (open {place}))" if chance.random() < 0.5 else f"(open {place})" for place in PLACES))


@pytest.mark.parametrize("seed", range(4))
def test_writers_in_turns_record_the_same_history(tmp_path, seed):
    """C1, V1, T5: writers that cache rows, in turns, record the same history as one without caches."""
    histories = []
    for caching in ((True, True), (False, False)):
        chance, clock = random.Random(seed), kbstore.ManualClock(START)
        store = tmp_path / f"{caching[0]}.db"
        with (
            kbstore.open(store, clock=clock, cache=caching[0]) as kb,
            kbstore.open(store, clock=clock, cache=caching[1]) as other,
        ):
            kb.add(*(f"{place} - place" for place in PLACES), "(= (level) 1)")
            for _ in range(40):
                clock.advance(seconds(chance.choice((0, 1, 1))))
                write_something(kb if chance.random() < 0.8 else other, chance, clock)
            histories.append(spans(kb))
    assert histories[0] == histories[1]


def test_values_added_repeatedly_are_not_read(tmp_path):
    """From the second time on a value is replaced without reading the row; another writer's rows are read."""
    clock = kbstore.ManualClock(START)
    store = tmp_path / "store.db"
    with kbstore.open(store, clock=clock) as kb, kbstore.open(store, clock=clock) as other:
        kb.add(*(f"(= (level {place}) 0)" for place in PLACES))
        read = []
        with kb._database.connect() as connection:
            connection.driver.set_trace_callback(lambda text: read.append(text) if "FROM functions" in text else None)

        def replace(writer, number):
            clock.advance(1)
            read.clear()
            writer.add(*(f"(= (level {place}) {number})" for place in PLACES))
            return len(read)

        def ended():
            return [found.end_time for found in other.history("(level p0)")]

        assert replace(kb, 1) > 0
        assert replace(kb, 2) == replace(kb, 3) == 0
        replace(other, 4)
        assert replace(kb, 5) > 0
        assert replace(kb, 6) == 0
        assert ended() == [*range(START + 1, START + 7), None]


def test_uncommitted_rows_are_not_cached(tmp_path, monkeypatch):
    """C1: after a transaction that failed, the next one ends the rows that are stored."""
    clock = kbstore.ManualClock(START)
    with kbstore.open(tmp_path / "store.db", clock=clock) as kb:
        kb.add("(open p0)")
        clock.advance(1)
        kb.add("(not (open p0))")
        clock.advance(1)

        def full(_connection):
            raise StoreUnavailable("the disk is full")

        with monkeypatch.context() as patch:
            patch.setattr(SqliteConnection, "commit", full)
            with pytest.raises(StoreUnavailable):
                kb.add("(open p0)")
        kb.add("(open p0)")
        assert spans(kb) == [
            ("(open p0)", START, START + 1),
            ("(not (open p0))", START + 1, START + 2),
            ("(open p0)", START + 2, None),
        ]


def test_rows_that_are_ahead_for_a_clock_that_is_behind(tmp_path):
    """T3, C5: a row read as begun, in a transaction that recorded nothing, can be cancelled if it is still ahead."""
    clock = kbstore.ManualClock(START)
    with kbstore.open(tmp_path / "store.db", clock=clock, tolerance=seconds(9)) as kb:
        kb.add("(open p0)", initial_time=START + 5)
        clock.set(START + 6)
        assert kb.add("(open p0)").changes == 0
        clock.set(START + 1)
        assert kb.remove("(open p0)", initial_time=START + 5).changes == 1
        clock.set(START + 6)
        assert not kb.holds("(open p0)")


def test_cached_rows_are_those_of_one_transaction():
    """A thread that is late with a transaction that others have followed changes nothing."""
    rows = OpenRows(10)
    assert rows.of(1, [7]) == {}
    rows.put(1, {7: row(1), 8: row(1)})
    rows.follow(1, 2, [8], {7: row(2)})
    assert rows.of(2, [7, 8]) == {7: row(2)}
    rows.follow(1, 3, (), {7: row(3)})
    assert rows.of(2, [7]) == {7: row(2)}
    assert rows.of(3, [7]) == {}


def test_an_interrupt_half_way_leaves_no_old_rows():
    """Ctrl-C while rows are dropped and put leaves none that the transaction has ended."""

    def interrupted():
        yield 8
        raise KeyboardInterrupt

    rows = OpenRows(10)
    rows.of(1, ())
    rows.put(1, {7: row(1), 8: row(1)})
    with pytest.raises(KeyboardInterrupt):
        rows.follow(1, 2, interrupted(), {7: row(2)})
    assert rows.of(2, [7, 8]) == {}
