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
    """Measure one add at a time, values replaced together, then many new facts at once."""
    yield from _single(settings)
    yield from _replacing(settings)
    yield from _bulk(settings)


def copy(source: Path, target: Path) -> None:
    """A store with the same tables, indexes and rows."""
    origin, other = sqlite3.connect(source), sqlite3.connect(target)
    origin.backup(other)
    origin.close()
    other.close()


class RawFlips:
    """Changes the sign of facts with the statements that kbstore uses for it."""

    def __init__(self, path: Path, t: int, *, synchronous: str = "FULL") -> None:
        self._connection = raw.connect(path, synchronous=synchronous)
        self._t = t
        self._number, self._last = self._connection.execute("SELECT last_number, last_timeline FROM heads").fetchone()
        rows = self._connection.execute(
            "SELECT timeline_id, recorded_tx, seq, initial_time, is_negative FROM facts WHERE end_time = ?", (OPEN,)
        )
        self._rows = {timeline: tuple(row) for timeline, *row in rows}
        self._choice = random.Random(1)
        self._timelines = list(self._rows)

    def flip(self, count: int = 1) -> None:
        """One transaction, with as many changes."""
        self._t += 1000
        self._number += 1
        t, number = self._t, self._number
        ended, begun = [], []
        for seq, timeline in enumerate(self._choice.sample(self._timelines, count)):
            recorded, place, start, is_negative = self._rows[timeline]
            ended.append((t, level(start, t), number, recorded, place))
            begun.append((seq, number, timeline, t, OPEN, OPEN_LEVEL, not is_negative))
            self._rows[timeline] = (number, seq, t, not is_negative)
        execute, execute_many = self._connection.execute, self._connection.executemany
        execute("BEGIN IMMEDIATE")
        execute_many(
            "UPDATE facts SET end_time = ?, level = ?, ended_tx = ?, end_cause = 2"
            " WHERE kb_id = 1 AND recorded_tx = ? AND seq = ?",
            ended,
        )
        execute_many(
            "INSERT INTO facts (kb_id, seq, recorded_tx, timeline_id, initial_time, end_time, level, is_negative)"
            " VALUES (1, ?, ?, ?, ?, ?, ?, ?)",
            begun,
        )
        token = random.getrandbits(62)
        execute(
            "INSERT INTO transactions VALUES (1, ?, ?, ?, ?, ?, NULL, '', '')", (count, number, t, token, self._last)
        )
        execute(
            "UPDATE heads SET last_number = ?, last_time = ?, last_token = ? WHERE kb_id = 1",
            (self._number, self._t, token),
        )
        execute("COMMIT")


class _Flips:
    """The same through kbstore, on a copy of a store, beside the raw statements on another."""

    def __init__(self, settings: Settings, history: History, durability: str = "full") -> None:
        store, other = settings.new("flips"), settings.new("flips-raw")
        copy(settings.store(history), store)
        copy(store, other)
        self._clock = ManualClock(START + (history.size + 1) * STEP)
        synchronous = "FULL" if durability == "full" else "NORMAL"
        self.raw = RawFlips(other, self._clock.now(), synchronous=synchronous)
        self.kb = kbstore.open(store, "bench", clock=self._clock, durability=durability)
        self._signs = {" ".join(item.key): item.is_negative for item in self.kb.state().facts}
        self._items = {key: (fact(key), fact(key, is_negative=True)) for key in self._signs}
        self._keys = list(self._signs)
        self._choice = random.Random(1)

    def flip(self, count: int = 1) -> None:
        """One transaction, with as many changes."""
        items = []
        for key in self._choice.sample(self._keys, count):
            self._signs[key] = not self._signs[key]
            items.append(self._items[key][self._signs[key]])
        self._clock.advance(1000)
        self.kb.add(*items)


def _single(settings: Settings) -> Iterator[Result]:
    history = History(UNIFORM, min(settings.size, 100_000))
    for durability, what in (("full", "single durable add"), ("normal", 'single add, durability="normal"')):
        flips = _Flips(settings, history, durability)
        ways = {"raw": flips.raw.flip, "kbstore": flips.flip}
        for name, meter in (("", WALL), (", computing alone", CPU)):
            bar = None if name else 1.6 if durability == "full" else 2.5
            found = side_by_side(ways, clock=meter, seconds=settings.seconds, minimum=200)
            yield Result(f"{what}{name}", "raw, the same writes", found["kbstore"], found["raw"], bar)
        flips.kb.close()


def _replacing(settings: Settings) -> Iterator[Result]:
    """Replace the values of many facts in one transaction, in a short and in a long history."""
    small, large = min(settings.size // 10, 100_000), settings.size
    for count in (200, 1_000):
        found = {}
        for size in (small, large):
            flips = _Flips(settings, History(UNIFORM, size))
            ways = {"raw": lambda: flips.raw.flip(count), "kbstore": lambda: flips.flip(count)}  # noqa: B023
            found[size] = side_by_side(ways, clock=CPU, seconds=settings.seconds, minimum=20)
            flips.kb.close()
            what = f"replace {count:,} values in a transaction, {size:,}"
            yield Result(what, "raw, the same writes", found[size]["kbstore"], found[size]["raw"], 1.5)
        ours, theirs = (found[large][way] / found[small][way] for way in ("kbstore", "raw"))
        what = f"growth of replacing {count:,} values, {small:,} to {large:,}"
        yield Result(what, "that of the raw writes", ours, theirs, 1.05, "times")


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
