"""Fill a store with a history by writing its rows directly, as the recorder would leave them.

`tests/benchmarks` compares the rows with those of the same history played through the public methods.
"""

import itertools
import random
import sqlite3
from array import array
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import kbstore
from benchmarks.histories import DOMAIN, START, History
from kbstore import KnowledgeType, ManualClock
from kbstore.clock import OPEN
from kbstore.model.timelines import EndCause, Role
from kbstore.storage.interval_tree import level

_CHUNK = 100_000
"""Assertions in one commit."""


class _Rows:
    """The assertions of one table, in columns and in order of their starts; what holds is open."""

    def __init__(self) -> None:
        self.timeline, self.start, self.end = array("q"), array("q"), array("q")
        self.recorded, self.seq, self.ended = array("q"), array("q"), array("q")
        self.negative, self.cause = array("b"), array("b")

    def begin(self, timeline: int, start: int, key: tuple[int, int], negative: bool) -> int:
        """Append an assertion; its index."""
        self.timeline.append(timeline)
        self.start.append(start)
        self.end.append(OPEN)
        self.recorded.append(key[0])
        self.seq.append(key[1])
        self.ended.append(0)
        self.negative.append(negative)
        self.cause.append(0)
        return len(self.timeline) - 1

    def finish(self, index: int, end: int, number: int, cause: EndCause) -> None:
        """End an assertion."""
        self.end[index] = end
        self.ended[index] = number
        self.cause[index] = cause

    def tuples(self, kb: int) -> Iterator[tuple[Any, ...]]:
        """As they are stored."""
        columns = zip(
            self.recorded,
            self.seq,
            self.timeline,
            self.start,
            self.end,
            self.negative,
            self.ended,
            self.cause,
            strict=True,
        )
        for recorded, seq, timeline, start, end, negative, ended, cause in columns:
            yield (
                kb,
                recorded,
                seq,
                timeline,
                start,
                end,
                negative,
                ended or None,
                cause or None,
                level(start, end),
            )


_COLUMNS = "kb_id, recorded_tx, seq, timeline_id, initial_time, end_time, is_negative, ended_tx, end_cause, level"


def fill(history: History, path: Path, name: str = "bench") -> None:
    """Create an SQLite store with a history in a new knowledge base."""
    with kbstore.open(path, name, clock=ManualClock(START)) as kb:
        number = kb.load(DOMAIN).number
    connection = sqlite3.connect(path, isolation_level=None)
    connection.execute("PRAGMA synchronous = OFF")
    connection.execute("PRAGMA cache_size = -524288")
    try:
        _write(connection, history, name, number)
        connection.execute("PRAGMA wal_checkpoint(TRUNCATE)")
    finally:
        connection.close()


def _write(connection: sqlite3.Connection, history: History, name: str, number: int) -> None:
    (kb,) = connection.execute("SELECT id FROM knowledge_bases WHERE name = ?", (name,)).fetchone()
    (last_id,) = connection.execute("SELECT coalesce(max(id), 0) FROM timelines").fetchone()
    instances, facts = _Rows(), _Rows()
    timelines: list[tuple[int, int, int, int, str]] = []
    mentions: list[tuple[int, int, int]] = []
    transactions: list[tuple[int, int, int, int, int, int]] = []
    ids: dict[str, int] = {}
    standing: dict[str, int] = {}
    speaking: dict[str, list[str]] = {}
    time, token = START, 0
    for time, gone, come, said in history.steps():
        number += 1
        changes = len(come) + len(said)
        seq = itertools.count()
        for name_gone in gone:
            keys = speaking.pop(name_gone)
            instances.finish(standing.pop(name_gone), time, number, EndCause.REMOVED)
            del ids[name_gone]
            changes += 1 + len(keys)
            for key in keys:
                facts.finish(standing.pop(key), time, number, EndCause.OBJECT)
                del ids[key]
        for name_come in come:
            last_id += 1
            ids[name_come] = last_id
            speaking[name_come] = []
            timelines.append((last_id, kb, Role.STATE, KnowledgeType.INSTANCE, name_come))
            standing[name_come] = instances.begin(last_id, time, (number, next(seq)), False)
        for key, negative in said:
            timeline = ids.get(key)
            if timeline is None:
                last_id += 1
                timeline = ids[key] = last_id
                timelines.append((timeline, kb, Role.STATE, KnowledgeType.FACT, key))
                for mentioned in dict.fromkeys(key.split(" ")[1:]):
                    mentions.append((kb, ids[mentioned], timeline))
                    speaking[mentioned].append(key)
            else:
                facts.finish(standing[key], time, number, EndCause.REPLACED)
            standing[key] = facts.begin(timeline, time, (number, next(seq)), negative)
        token = random.getrandbits(62)
        transactions.append((kb, number, time, changes, token, last_id))
    _insert(connection, "timelines (id, kb_id, role, knowledge_type, key)", 5, timelines)
    _insert(connection, "mentions (kb_id, object_id, timeline_id)", 3, mentions)
    _insert(
        connection,
        "transactions (client, note, kb_id, number, recorded_time, changes, token, last_timeline)",
        8,
        (("", "", *transaction) for transaction in transactions),
    )
    typed = ((*row, history.type_name) for row in instances.tuples(kb))
    _insert(connection, f"instances ({_COLUMNS}, instance_type)", 11, typed)
    _insert(connection, f"facts ({_COLUMNS})", 10, facts.tuples(kb))
    connection.execute(
        "UPDATE heads SET last_number = ?, last_time = ?, last_token = ?, last_timeline = ?, present = ?"
        " WHERE kb_id = ?",
        (number, time, token, last_id, 1 << KnowledgeType.INSTANCE | 1 << KnowledgeType.FACT, kb),
    )


def _insert(connection: sqlite3.Connection, target: str, columns: int, rows: Iterable[tuple[Any, ...]]) -> None:
    statement = f"INSERT INTO {target} VALUES ({', '.join('?' * columns)})"
    connection.execute("BEGIN IMMEDIATE")
    connection.executemany(statement, rows)
    connection.execute("COMMIT")
