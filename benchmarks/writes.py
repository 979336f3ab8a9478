"""Writing: a single durable add, and a bulk update that is validated, against raw writes of the same rows."""

import random
import sqlite3
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import kbstore
from benchmarks import raw
from benchmarks.histories import DOMAIN, START, STEP, UNIFORM, History, fact
from benchmarks.measuring import CPU, WALL, once, side_by_side
from benchmarks.report import Result
from benchmarks.settings import Settings
from kbstore import ManualClock, UpdateType
from kbstore.clock import OPEN
from kbstore.storage.interval_tree import OPEN_LEVEL, level

_CONTENT = ("timelines", "mentions", "transactions", "instances", "facts")


def measure(settings: Settings) -> Iterator[Result]:
    """Measure one add at a time, then many at once."""
    yield from _single(settings)
    yield from _bulk(settings)


def copy(source: Path, target: Path) -> None:
    """A store with the same tables, indexes and rows."""
    origin, other = sqlite3.connect(source), sqlite3.connect(target)
    origin.backup(other)
    origin.close()
    other.close()


class RawFlips:
    """Changes the sign of facts with the statements that kbstore uses for it."""

    def __init__(self, path: Path, t: int) -> None:
        self._connection = raw.connect(path)
        self._t = t
        self._number, self._last = self._connection.execute("SELECT last_number, last_timeline FROM heads").fetchone()
        rows = self._connection.execute(
            "SELECT timeline_id, recorded_tx, seq, initial_time, is_negative FROM facts WHERE end_time = ?", (OPEN,)
        )
        self._rows = {timeline: tuple(row) for timeline, *row in rows}
        self._choice = random.Random(1)
        self._timelines = list(self._rows)

    def flip(self) -> None:
        """One transaction."""
        self._t += 1000
        self._number += 1
        timeline = self._choice.choice(self._timelines)
        recorded, seq, start, is_negative = self._rows[timeline]
        execute = self._connection.execute
        execute("BEGIN IMMEDIATE")
        execute(
            "UPDATE facts SET end_time = ?, level = ?, ended_tx = ?, end_cause = 2"
            " WHERE kb_id = 1 AND recorded_tx = ? AND seq = ?",
            (self._t, level(start, self._t), self._number, recorded, seq),
        )
        execute(
            "INSERT INTO facts (kb_id, seq, recorded_tx, timeline_id, initial_time, end_time, level, is_negative)"
            " VALUES (1, 0, ?, ?, ?, ?, ?, ?)",
            (self._number, timeline, self._t, OPEN, OPEN_LEVEL, not is_negative),
        )
        token = random.getrandbits(62)
        execute(
            "INSERT INTO transactions VALUES (1, 1, ?, ?, ?, ?, NULL, '', '')",
            (self._number, self._t, token, self._last),
        )
        execute(
            "UPDATE heads SET last_number = ?, last_time = ?, last_token = ? WHERE kb_id = 1",
            (self._number, self._t, token),
        )
        execute("COMMIT")
        self._rows[timeline] = (self._number, 0, self._t, not is_negative)


def _single(settings: Settings) -> Iterator[Result]:
    history = History(UNIFORM, min(settings.size, 100_000))
    store, other = settings.new("single"), settings.new("single-raw")
    copy(settings.store(history), store)
    copy(store, other)
    clock = ManualClock(START + (history.size + 1) * STEP)
    flips = RawFlips(other, clock.now())
    choice = random.Random(1)
    with kbstore.open(store, "bench", clock=clock) as kb:
        signs = {" ".join(item.key): item.is_negative for item in kb.state().facts}
        keys = list(signs)

        def flip() -> None:
            key = choice.choice(keys)
            signs[key] = not signs[key]
            clock.advance(1000)
            kb.add(fact(key, signs[key]))

        for name, meter, bar in (("", WALL, 2.0), (", computing alone", CPU, None)):
            ways = {"raw": flips.flip, "kbstore": flip}
            found = side_by_side(ways, clock=meter, seconds=settings.seconds, minimum=200)
            yield Result(f"single durable add{name}", "raw, the same writes", found["kbstore"], found["raw"], bar)


def _bulk(settings: Settings) -> Iterator[Result]:
    count = settings.bulk
    places = [f"wp{number}" for number in range(int(count**0.5) + 1)]
    keys = [f"reachable {a} {b}" for a in places for b in places][:count]
    items: dict[str, list[Any]] = {"items": [fact(key) for key in keys], "texts": [f"({key})" for key in keys]}
    for form, told in items.items():
        store, empty = settings.new("bulk"), settings.new("bulk-raw")
        clock = ManualClock(START)
        with kbstore.open(store, "bench", clock=clock) as kb:
            kb.load(DOMAIN)
            kb.add(*(f"{place} - place" for place in places))
            copy(store, empty)
            clock.advance(STEP)
            new = [(UpdateType.ADD_KNOWLEDGE, item) for item in told]
            ours = once(lambda: kb.update(new), CPU)  # noqa: B023 - called before the loop goes on
        theirs = once(same_rows(store, empty), CPU)
        yield Result(f"bulk update, {count:,} new facts as {form}", "raw, the same rows", ours, theirs, 3)
        plain = once(_plain_rows(settings.new("plain"), keys), CPU)
        yield Result(f"bulk update, {count:,} new facts as {form}", "raw, one table, one index", ours, plain)


def same_rows(store: Path, empty: Path) -> Callable[[], None]:
    """Writes the rows that one store has and another lacks, with all columns and indexes."""
    origin = sqlite3.connect(store)
    connection = raw.connect(empty)
    rows: dict[str, list[Any]] = {}
    for table in _CONTENT:
        known = connection.execute(f"SELECT count(*) FROM {table}").fetchone()[0]
        rows[table] = origin.execute(f"SELECT * FROM {table}").fetchall()[known:]
    origin.close()

    def write() -> None:
        connection.execute("BEGIN IMMEDIATE")
        for table, new in rows.items():
            if new:
                connection.executemany(f"INSERT INTO {table} VALUES ({', '.join('?' * len(new[0]))})", new)
        connection.execute("COMMIT")

    return write


def _plain_rows(path: Path, keys: list[str]) -> Callable[[], None]:
    """Writes facts into a plain table that records only what held when."""
    connection = raw.connect(path)
    connection.execute(
        "CREATE TABLE facts (id INTEGER PRIMARY KEY, name TEXT, arguments TEXT, is_negative INTEGER,"
        " initial_time INTEGER, end_time INTEGER)"
    )
    connection.execute("CREATE INDEX facts_by_name ON facts (name, arguments, initial_time)")
    rows = [(*key.split(" ", 1), False, START, OPEN) for key in keys]

    def write() -> None:
        connection.execute("BEGIN IMMEDIATE")
        connection.executemany(
            "INSERT INTO facts (name, arguments, is_negative, initial_time, end_time) VALUES (?, ?, ?, ?, ?)", rows
        )
        connection.execute("COMMIT")

    return write
