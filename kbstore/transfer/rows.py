"""Copies whole knowledge bases row by row between stores, on either engine, in constant memory."""

import os
import sqlite3
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import closing, contextmanager
from itertools import islice
from pathlib import Path
from typing import Any, Final, NamedTuple

from sqlalchemy import Engine
from sqlalchemy.engine import URL

from kbstore.clock import OPEN
from kbstore.errors import InvalidKnowledge, StoreUnavailable
from kbstore.storage import directory
from kbstore.storage.connection import StoreConnection
from kbstore.storage.database import Database
from kbstore.storage.interval_tree import EMPTY_LEVEL, level, node, superseded
from kbstore.storage.memory import StoreMemory
from kbstore.storage.recorder import put_head
from kbstore.storage.records import Head
from kbstore.storage.repository import Repository
from kbstore.storage.statements import Statement
from kbstore.transfer.archive_mark import mark_archive
from kbstore.transfer.queries import by_table, last_transaction

StoreLike = str | os.PathLike[str] | URL | Engine
"""A store: a SQLAlchemy URL, the path of an SQLite file, or an `Engine` of the caller's."""

Record = dict[str, Any]
"""A row, by the names of its columns."""

Progress = Callable[[int, int], None]
"""A progress callback: how much is done, and of how much."""

BATCH = 2000
"""The number of rows held in memory, and written, at once."""


class LogRange(NamedTuple):
    """A part of a knowledge base: the rows that transactions after one and up to another recorded.

    Rows that had ended before `since` are left out, as the archive that ends at that time has them, unless they were
    recorded or retired after the last transaction before that time.
    """

    after: int = 0
    upto: int = OPEN
    since: int = 0


EVERYTHING = LogRange()


class RowSource:
    """Reads a part of a knowledge base on one snapshot of its store.

    Attributes:
        head: the end of the log in the store.
        token: that of the last transaction of the part.
        timeline: the last timeline of the part.
    """

    def __init__(self, connection: StoreConnection, name: str, part: LogRange = EVERYTHING) -> None:
        found = directory.find(connection, name)
        if found is None:
            names = ", ".join(directory.names(connection)) or "none"
            raise StoreUnavailable(f"there is no knowledge base {name!r} in this store; there is: {names}")
        self.name = name
        self.use_unknowns = found.use_unknowns
        self._connection = connection
        self.kb = found.kb
        self.repository = Repository(connection, found.kb, StoreMemory())
        self.head = self.repository.head()
        # rows that an interrupted archiving has yet to delete do not count
        since = max(part.since, self.head.history_from)
        self._chosen = {"kb": found.kb, **part._asdict(), "since": since}
        self._chosen["gone"] = self._last_before(since) if since else 0
        last = connection.first(last_transaction, self._chosen)
        self.token, self.timeline = (0, 0) if last is None else last
        self._chosen["timelines"] = self.timeline

    def _last_before(self, time: int) -> int:
        following = self.repository.first_transaction_from(time)
        return self.head.number if following is None else following - 1

    def counts(self) -> dict[str, int]:
        """Count the rows of each table."""
        found = {}
        for name, statements in by_table.items():
            row = self._connection.first(statements.count, self._chosen)
            found[name] = 0 if row is None else int(row[0])
        return found

    def records(self, table: str, statement: Statement | None = None, **parameters: Any) -> Iterator[Record]:
        """Read the rows of a table, within a transaction, in an order in which they can be written again.

        With `statement`, these are the rows that it selects by its own `parameters`.
        """
        statements = by_table[table]
        names = [column.name for column in statements.columns]
        flags = [column.name for column in statements.columns if column.type is bool]
        for row in self._connection.stream(statement or statements.read, self._chosen | parameters):
            record = dict(zip(names, row, strict=True))
            for name in flags:
                record[name] = bool(record[name])
            yield record


class RowTarget:
    """Writes rows of one knowledge base, on a connection with a write transaction.

    The knowledge base is created if there is none of that name (`is_new`). Rows whose keys are there already are
    replaced as far as they can change.
    """

    def __init__(self, connection: StoreConnection, name: str, *, use_unknowns: bool) -> None:
        found, self.is_new = directory.create(connection, name, use_unknowns=use_unknowns)
        self.kb = found.kb
        self._connection = connection

    def add(self, table: str, records: Sequence[Record]) -> None:
        """Write rows of a table; tables must be written in the order of `by_table`."""
        statement = by_table[table].add
        self._connection.many(statement, [self._row(statement.columns, record) for record in records])

    def put_head(self, head: Head) -> None:
        """Write the head."""
        put_head(self._connection, self.kb, head)

    def _row(self, columns: Sequence[str], record: Record) -> list[Any]:
        record["kb_id"] = self.kb
        return [record[name] if name in record else _derived[name](record) for name in columns]


def _level(record: Record) -> int:
    found = level(record["initial_time"], record["end_time"])
    return found if record["retired_tx"] is None or found == EMPTY_LEVEL else superseded(found)


def _node(record: Record) -> int | None:
    if "until_time" in record:
        return node(record["recorded_time"], record["until_time"])
    return node(record["initial_time"], record["end_time"])


_derived: Final[dict[str, Callable[[Record], int | None]]] = {"level": _level, "node": _node}


def copy(source: RowSource, target: RowTarget, step: Callable[[int], None]) -> None:
    """Write all rows of a source; `step` is called with how many more have been written."""
    for table in by_table:
        for records in batches(source.records(table)):
            target.add(table, records)
            step(len(records))


def batches(records: Iterable[Record]) -> Iterator[list[Record]]:
    """Yield rows in lists of at most `BATCH`."""
    rows = iter(records)
    while batch := list(islice(rows, BATCH)):
        yield batch


class Steps:
    """Adds up progress, and reports it to a callback."""

    def __init__(self, progress: Progress | None, total: int) -> None:
        self._progress = progress
        self._total = total
        self._done = 0

    def __call__(self, more: int) -> None:
        """Add `more`, and report."""
        self._done += more
        if self._progress is not None:
            self._progress(self._done, self._total)


@contextmanager
def opened(url: StoreLike, *, writing: bool = False) -> Iterator[Database]:
    """Open a store to be read, or to be written to; then an empty one is set up."""
    # a connection of the caller's engine may be shared, and its settings stay as they are
    database = Database(url, read_only=not writing and not isinstance(url, Engine))
    try:
        database.ensure_schema(read_only=not writing)
        yield database
    finally:
        database.close()


# -- files --------------------------------------------------------------------------------------------------------


@contextmanager
def new_file(path: Path) -> Iterator[Path]:
    """Yield a path to write to, which becomes the file `path` when it is complete and on the disk, or not at all.

    Raises `InvalidKnowledge` if the file exists, `StoreUnavailable` if it cannot be written.
    """
    if path.exists():
        raise InvalidKnowledge(f"{path} exists, and is not overwritten; remove it, or give another name")
    partial = path.with_name(f"{path.name}.{os.getpid()}.partial")
    try:
        partial.touch(exist_ok=False)
        yield partial
        with open(partial, "rb") as written:
            os.fsync(written.fileno())
        partial.replace(path)
        sync_directory(path)
    except OSError as error:
        if isinstance(error, StoreUnavailable):
            raise
        raise StoreUnavailable(f"{path}: {error.strerror or error}; nothing has been written") from error
    finally:
        for suffix in ("", "-journal", "-wal", "-shm"):
            partial.with_name(partial.name + suffix).unlink(missing_ok=True)


def sync_directory(path: Path) -> None:
    """Sync the directory of a new file, so that it is found after a loss of power."""
    if os.name == "posix":
        directory = os.open(path.parent, os.O_RDONLY)
        try:
            os.fsync(directory)
        finally:
            os.close(directory)


def make_archive(path: Path) -> None:
    """Mark a file that does not exist, or is empty, as an archive."""
    try:
        with closing(sqlite3.connect(path)) as connection:
            connection.execute(mark_archive.sqlite)
    except sqlite3.Error as error:
        raise StoreUnavailable(f"{path}: {error}; nothing has been archived") from error
