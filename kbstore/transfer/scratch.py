"""Scratch files, in which the rows of an import wait until all of them have been checked.

A scratch file has the tables of a store with their keys, but no other constraints, so that a contradiction can be
reported with its line.
"""

import sqlite3
from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from sqlalchemy.dialects import sqlite
from sqlalchemy.schema import CreateTable

from kbstore.storage import tables
from kbstore.storage.connection import Options, SqlRow
from kbstore.storage.records import Head
from kbstore.storage.sqlite_connection import SqliteConnection
from kbstore.storage.statements import Statement
from kbstore.transfer.queries import assertions, by_table
from kbstore.transfer.rows import Record, RowSource, RowTarget

_DIALECT = sqlite.dialect()

_UNSAFE = "PRAGMA journal_mode = OFF; PRAGMA synchronous = OFF; PRAGMA foreign_keys = OFF; PRAGMA temp_store = FILE"
"""Settings for a file that nobody looks into after a crash."""


class Scratch:
    """The rows of one knowledge base; it knows how many lines of the file are before those of each table.

    Attributes:
        connection: the connection on which the rows can be read.
    """

    def __init__(self, connection: SqliteConnection, counts: Mapping[str, int], *, use_unknowns: bool) -> None:
        self.connection = connection
        self._target = RowTarget(connection, _NAME, use_unknowns=use_unknowns)
        self.kb = self._target.kb
        self._before = {}
        lines = 1
        for table in by_table:
            self._before[table] = lines
            lines += counts[table]

    def add(self, table: str, records: Sequence[Record]) -> None:
        """Write rows of a table."""
        self._target.add(table, records)

    def finish(self, head: Head) -> None:
        """Write the head and create indexes, after all rows have been written."""
        self._target.put_head(head)
        for index in _INDEXES:
            self.connection.driver.execute(index)
        # without figures SQLite takes a knowledge base for ten rows, and looks through all of it for each row
        self.connection.driver.execute("ANALYZE")

    def source(self) -> RowSource:
        """Return a source of all rows, to be copied."""
        return RowSource(self.connection, _NAME)

    def rows(self, statement: Statement, **parameters: Any) -> Iterator[SqlRow]:
        """Yield the rows that a statement selects of the knowledge base."""
        return self.connection.stream(statement, {"kb": self.kb, **parameters})

    def line(self, table: str, *key: Any) -> int:
        """Return the line of the file that has the row with a key, as rows are in the order of their keys."""
        parameters = {f"key{place}": part for place, part in enumerate(key)}
        [(count,)] = self.rows(by_table[table].upto, **parameters)
        return self._before[table] + int(count)


_NAME = "import"

_INDEXES = (
    *(f"CREATE INDEX scratch_{table} ON {table} (kb_id, timeline_id, initial_time)" for table in assertions),
    "CREATE INDEX scratch_timelines ON timelines (kb_id, role, knowledge_type, key)",
    "CREATE INDEX scratch_mentions ON mentions (kb_id, timeline_id)",
)


@contextmanager
def scratch(counts: Mapping[str, int], *, use_unknowns: bool) -> Iterator[Scratch]:
    """Open a scratch file among the temporary files (TMPDIR), and remove it afterwards."""
    with TemporaryDirectory(prefix="kbstore-import-", ignore_cleanup_errors=True) as directory:
        path = Path(directory) / "rows.db"
        options = Options(f"{path} (a temporary file: TMPDIR)", busy_timeout=0, durability="normal", read_only=False)
        with closing(sqlite3.connect(path, isolation_level=None)) as driver:
            driver.executescript(_UNSAFE)
            for table in tables.metadata.sorted_tables:
                driver.execute(str(CreateTable(table).compile(dialect=_DIALECT)))
            driver.execute("BEGIN")
            yield Scratch(SqliteConnection(driver, options), counts, use_unknowns=use_unknowns)
