"""Raw `sqlite3` on the same rows, laid out for exactly the questions that are asked."""

import sqlite3
from collections.abc import Sequence
from pathlib import Path

from kbstore import State

Row = tuple[str, str, bool, int]


def connect(path: Path, *, synchronous: str = "FULL") -> sqlite3.Connection:
    """Connect with the settings of a kbstore store and manual transactions."""
    connection = sqlite3.connect(path, isolation_level=None)
    connection.execute("PRAGMA journal_mode = WAL")
    connection.execute(f"PRAGMA synchronous = {synchronous}")
    connection.execute("PRAGMA cache_size = -65536")
    return connection


class Answers:
    """The rows of some states, each on pages of its own: nothing fetches them with fewer reads."""

    def __init__(self, path: Path, states: Sequence[State]) -> None:
        self._connection = connect(path, synchronous="OFF")
        self._connection.execute(
            "CREATE TABLE answers (state INTEGER, number INTEGER, name TEXT, arguments TEXT, is_negative INTEGER,"
            " initial_time INTEGER, PRIMARY KEY (state, number)) WITHOUT ROWID"
        )
        for state, answer in enumerate(states):
            rows = [(state, number, *row) for number, row in enumerate(rows_of(answer))]
            self._connection.executemany("INSERT INTO answers VALUES (?, ?, ?, ?, ?, ?)", rows)

    def fetch(self, state: int) -> list[Row]:
        """All rows of a state."""
        rows: list[Row] = self._connection.execute(
            "SELECT name, arguments, is_negative, initial_time FROM answers WHERE state = ?", (state,)
        ).fetchall()
        return rows


def rows_of(state: State) -> list[Row]:
    """What holds, as plain rows."""
    facts = [
        (fact.attribute_name, " ".join(fact.arguments), fact.is_negative, fact.initial_time) for fact in state.facts
    ]
    objects = [
        (item.instance_name, item.instance_type, item.is_negative, item.initial_time) for item in state.instances
    ]
    return [*facts, *objects]


class Points:
    """The facts of a store by timeline and time, in one clustered index."""

    def __init__(self, path: Path, store: Path) -> None:
        self._connection = connect(path, synchronous="OFF")
        self._connection.execute(
            "CREATE TABLE points (timeline INTEGER, initial_time INTEGER, end_time INTEGER, is_negative INTEGER,"
            " PRIMARY KEY (timeline, initial_time)) WITHOUT ROWID"
        )
        self._connection.execute("ATTACH ? AS store", (str(store),))
        self._connection.execute(
            "INSERT INTO points SELECT timeline_id, initial_time, end_time, is_negative FROM store.facts"
            " ORDER BY timeline_id, initial_time"
        )

    def timeline(self, key: str) -> int:
        """The number of a fact's timeline."""
        found = self._connection.execute("SELECT id FROM store.timelines WHERE key = ? AND role = 0", (key,)).fetchone()
        return int(found[0])

    def fetch(self, timeline: int, t: int) -> bool:
        """Whether the fact is asserted at `t`."""
        row = self._connection.execute(
            "SELECT is_negative, end_time FROM points WHERE timeline = ? AND initial_time <= ?"
            " ORDER BY initial_time DESC LIMIT 1",
            (timeline, t),
        ).fetchone()
        return row is not None and row[1] > t and not row[0]
