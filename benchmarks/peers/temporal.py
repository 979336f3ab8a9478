"""PostgreSQL 18's own temporal tables: a range of time in the key, of which no two overlap."""

from collections.abc import Iterable
from typing import Any

import psycopg

from benchmarks.peers.peer import Change, Standing, intervals
from kbstore.clock import OPEN


class Temporal:
    """Facts with the range of time in which they held, on a server; indexed by fact and range, and by range."""

    def __init__(self, connection: "psycopg.Connection[Any]") -> None:
        self._connection = connection
        connection.execute("CREATE EXTENSION IF NOT EXISTS btree_gist")
        connection.execute("DROP TABLE IF EXISTS temporal")
        connection.execute(
            "CREATE TABLE temporal (key text, is_negative boolean, valid int8range,"
            " PRIMARY KEY (key, valid WITHOUT OVERLAPS))"
        )
        connection.execute("CREATE INDEX ON temporal USING gist (valid)")

    def tell(self, changes: Iterable[Change]) -> None:
        """Load a history, by COPY."""
        with self._connection.cursor().copy("COPY temporal FROM STDIN") as copy:
            for key, is_negative, start, end in intervals(changes):
                copy.write_row((key, is_negative, f"[{start},{'' if end == OPEN else end})"))
        self._connection.execute("VACUUM ANALYZE temporal")

    def state(self, t: int) -> Standing:
        """The rows whose range contains the time."""
        return dict(
            self._connection.execute("SELECT key, is_negative FROM temporal WHERE valid @> %s::bigint", (t,)).fetchall()
        )

    def point(self, key: str, t: int) -> bool:
        """The same of one key."""
        row = self._connection.execute(
            "SELECT is_negative FROM temporal WHERE key = %s AND valid @> %s::bigint", (key, t)
        ).fetchone()
        return row is not None and not row[0]

    def write(self, change: Change) -> None:
        """End the current row, and add the next."""
        time, key, is_negative = change
        with self._connection.transaction():
            self._connection.execute(
                "UPDATE temporal SET valid = int8range(lower(valid), %s::bigint) WHERE key = %s AND upper_inf(valid)",
                (time, key),
            )
            self._connection.execute(
                "INSERT INTO temporal VALUES (%s, %s, int8range(%s, NULL))", (key, is_negative, time)
            )
