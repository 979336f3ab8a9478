"""Bytes on disk for each assertion, indexes, transactions and timelines included."""

import sqlite3
from collections.abc import Iterator
from itertools import islice
from pathlib import Path

import kbstore
from benchmarks.histories import DOMAIN, SHAPES, START, History, updates
from benchmarks.report import Result
from benchmarks.settings import Settings
from kbstore import ManualClock

_BAR = 160
"""Bytes."""

_TOLD = 20_000
"""Assertions, at most, of the histories that are played in transactions, so that pages are split as in real use."""


def measure(settings: Settings) -> Iterator[Result]:
    """Measure histories played through the public methods, one and ten steps in a transaction, and the large stores."""
    for shape in SHAPES:
        told = History(shape, min(_TOLD, settings.size // 5))
        for steps in (1, 10):
            each = _told(settings.new("size"), told, steps)
            what = f"bytes an assertion, {shape}, {steps} step{'s' if steps > 1 else ''} a transaction"
            yield Result(what, f"{_BAR} bytes", each, _BAR, 1, "bytes")
        history = History(shape, settings.size)
        size, rows = _measured(settings.store(history))
        what = f"bytes an assertion, {shape}, {settings.size:,} rows written"
        yield Result(what, f"{_BAR} bytes", size / rows, _BAR, 1, "bytes")


def _told(path: Path, history: History, together: int) -> float:
    """Bytes that each assertion adds to a store with the first thousand."""
    clock = ManualClock(START)
    steps = history.steps()
    with kbstore.open(path, "bench", clock=clock, durability="normal") as kb:
        kb.load(DOMAIN)
        kb.update([update for step in islice(steps, 1) for update in updates(step, history.type_name)])
    size, rows = _measured(path)
    with kbstore.open(path, "bench", clock=clock, durability="normal") as kb:
        while group := list(islice(steps, together)):
            clock.set(group[-1].time)
            kb.update([update for step in group for update in updates(step, history.type_name)])
    grown, more = _measured(path)
    return (grown - size) / (more - rows)


def _measured(path: Path) -> tuple[int, int]:
    """Bytes and assertions of a store."""
    connection = sqlite3.connect(path)
    connection.execute("PRAGMA wal_checkpoint(TRUNCATE)")
    count = "SELECT (SELECT count(*) FROM facts) + (SELECT count(*) FROM instances)"
    (rows,) = connection.execute(count).fetchone()
    connection.close()
    return path.stat().st_size, int(rows)
