"""DuckDB: a table of intervals, scanned, which is what a columnar database is made for; loaded from a file."""

import csv
from collections.abc import Iterable
from pathlib import Path

import duckdb

from benchmarks.peers.peer import Change, Standing, intervals
from kbstore.clock import OPEN


class Duck:
    """Facts with the interval in which they held. The write-ahead log is synced at each commit."""

    def __init__(self, path: Path) -> None:
        self._csv = path.with_suffix(".csv")
        # a history of this size is one row group, which one thread scans; others would only add to the CPU time
        self._connection = duckdb.connect(str(path), config={"threads": 1})
        self._connection.execute(
            "CREATE TABLE facts (key VARCHAR, is_negative BOOLEAN, initial_time BIGINT, end_time BIGINT)"
        )

    def tell(self, changes: Iterable[Change]) -> None:
        """As intervals, by COPY from a file: its guide advises against inserting row by row."""
        self._copy(intervals(changes))

    def _copy(self, rows: Iterable[tuple[str, bool, int, int]]) -> None:
        with self._csv.open("w", newline="") as file:
            csv.writer(file).writerows(rows)
        self._connection.execute(f"COPY facts FROM '{self._csv}' (FORMAT csv, HEADER false)")

    def state(self, t: int) -> Standing:
        """The rows whose interval contains the time."""
        query = "SELECT key, is_negative FROM facts WHERE initial_time <= $1 AND end_time > $1"
        return dict(self._connection.execute(query, [t]).fetchall())

    def point(self, key: str, t: int) -> bool:
        """The same of one key; an index on the key makes it no faster at these sizes."""
        query = "SELECT is_negative FROM facts WHERE key = $1 AND initial_time <= $2 AND end_time > $2"
        row = self._connection.execute(query, [key, t]).fetchone()
        return row is not None and not row[0]

    def write(self, change: Change) -> None:
        """End the current row, and add the next."""
        time, key, is_negative = change
        self._connection.begin()
        self._connection.execute("UPDATE facts SET end_time = $1 WHERE key = $2 AND end_time = $3", [time, key, OPEN])
        self._connection.execute("INSERT INTO facts VALUES ($1, $2, $3, $4)", [key, is_negative, time, OPEN])
        self._connection.commit()

    def bulk(self, keys: list[str], t: int) -> None:
        """Through a file as well; writing it counts."""
        self._copy((key, False, t, OPEN) for key in keys)

    def close(self) -> None:
        """Close the database."""
        self._connection.close()
