"""Whole knowledge bases, row by row: out of one store and into another, on either engine, in flat memory."""

import os
import sqlite3
from array import array
from bisect import bisect_left
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from itertools import islice
from pathlib import Path
from typing import Any, Final, NamedTuple

from sqlalchemy import Engine
from sqlalchemy.engine import URL

from kbstore.clock import OPEN
from kbstore.errors import InvalidKnowledge, StoreUnavailable
from kbstore.storage import queries, schema
from kbstore.storage.connection import StoreConnection
from kbstore.storage.database import Database
from kbstore.storage.interval_tree import level, node
from kbstore.transfer.queries import (
    ARCHIVE,
    HEAD_COLUMNS,
    TableQueries,
    application_id,
    by_table,
    mark_archive,
    put_head,
)

Store = str | os.PathLike[str] | URL | Engine
"""What names a store: a SQLAlchemy URL, the path of an SQLite file, or an `Engine` of the caller's."""

Record = dict[str, Any]
"""A row, by the names of its columns."""

Progress = Callable[[int, int], None]
"""Told of long work again and again: how much is done, and of how much."""

BATCH = 2000
"""How many rows are held in memory, and written, at once."""


class Part(NamedTuple):
    """What is taken of a knowledge base: what transactions after one and up to another recorded.

    Of rows that have an end, those that had ended before `since` are left out.
    """

    after: int = 0
    upto: int = OPEN
    since: int = 0


EVERYTHING = Part()


class RowSource:
    """Reads a knowledge base on one snapshot of its store."""

    def __init__(self, session: StoreConnection, name: str, part: Part = EVERYTHING) -> None:
        row = session.first(queries.find_knowledge_base, {"name": name})
        if row is None:
            names = ", ".join(names_in(session)) or "none"
            raise StoreUnavailable(f"there is no knowledge base {name!r} in this store; there is: {names}")
        self.name = name
        self.use_unknowns = bool(row[1])
        self._session = session
        self._chosen = {"kb": row[0], **part._asdict()}
        head = session.first(queries.head, {"kb": row[0]})
        assert head is not None
        self.head: dict[str, int] = dict(zip(HEAD_COLUMNS, head, strict=True))
        # what an archiving that was interrupted has yet to delete is not there any more
        self._chosen["since"] = max(part.since, self.head["history_from"])

    def counts(self) -> dict[str, int]:
        """The number of rows of each table."""
        found = {}
        for name, statements in by_table.items():
            row = self._session.first(statements.count, self._chosen)
            found[name] = 0 if row is None else int(row[0])
        return found

    def records(self, table: str) -> Iterator[Record]:
        """The rows of a table, in an order in which they can be written again; within a transaction."""
        statements = by_table[table]
        names = [column.name for column in statements.columns]
        flags = [column.name for column in statements.columns if column.type is bool]
        for row in self._session.stream(statements.read, self._chosen):
            record = dict(zip(names, row, strict=True))
            for name in flags:
                record[name] = bool(record[name])
            yield record


class RowTarget:
    """Writes rows of one knowledge base, on a session with a write transaction; timelines get numbers of this store.

    A new knowledge base is made if there is none of that name; `is_new` tells.
    """

    def __init__(self, session: StoreConnection, name: str, *, use_unknowns: bool) -> None:
        self.is_new = bool(
            session.run(queries.add_knowledge_base, {"name": name, "use_unknowns": use_unknowns}),
        )
        row = session.first(queries.find_knowledge_base, {"name": name})
        assert row is not None
        self.kb: int = row[0]
        self._session = session
        self._old = array("q")
        self._new = array("q")

    def add(self, table: str, records: Sequence[Record]) -> None:
        """Write rows of a table; tables come in the order of `by_table`, timelines in the order of their numbers."""
        statements = by_table[table]
        if table == "timelines":
            records = self._numbered(records)
        else:
            records = [self._renumbered(statements, record) for record in records]
        self._session.many(statements.add, records)

    def put_head(self, head: Mapping[str, int]) -> None:
        """Where the record stands."""
        self._session.run(put_head, {"kb": self.kb, **head})

    def _numbered(self, records: Sequence[Record]) -> list[Record]:
        """Those timelines that are new, with their numbers; all of them are remembered."""
        there = {} if self.is_new else self._there(records)
        new = [record for record in records if _identity(record) not in there]
        numbers = dict(zip(map(_identity, new), self._session.timeline_ids(len(new)), strict=True))
        for record in records:
            self._old.append(record["id"])
            self._new.append((there if _identity(record) in there else numbers)[_identity(record)])
        return [record | {"id": numbers[_identity(record)], "kb": self.kb} for record in new]

    def _there(self, records: Iterable[Record]) -> dict[tuple[Any, ...], int]:
        """The numbers of timelines that are stored already."""
        keys: dict[tuple[int, int], list[str]] = {}
        for record in records:
            keys.setdefault((record["role"], record["knowledge_type"]), []).append(record["key"])
        found = {}
        for (role, kind), wanted in keys.items():
            parameters = {"kb": self.kb, "role": role, "kind": kind, "keys": self._session.array(wanted)}
            for id, *identity, _ in self._session.all(queries.timelines_by_key, parameters):
                found[tuple(identity)] = id
        return found

    def _renumbered(self, statements: TableQueries, record: Record) -> Record:
        """A row with this store's numbers, and with what is derived from its columns."""
        record = record | {"kb": self.kb}
        for name in ("timeline_id", "object_id"):
            if name in record:
                record[name] = self._new[bisect_left(self._old, record[name])]
        for name in statements.derived:
            record[name] = _derived[name](record)
        return record


def _pending_node(record: Record) -> int | None:
    recorded, cancelled = record["recorded_time"], record["cancelled_time"]
    until = record["initial_time"] if cancelled is None else cancelled
    return None if recorded is None else node(recorded, until)


_derived: Final[dict[str, Callable[[Record], int | None]]] = {
    "level": lambda record: level(record["initial_time"], record["end_time"]),
    "node": lambda record: node(record["initial_time"], record["end_time"]),
    "pending_node": _pending_node,
}


def copy(source: RowSource, target: RowTarget, step: Callable[[int], None]) -> None:
    """Write all rows of a source; `step` is told how many more have been written."""
    for table in by_table:
        for records in batches(source.records(table)):
            target.add(table, records)
            step(len(records))


def batches(records: Iterable[Record]) -> Iterator[list[Record]]:
    """Rows in lists of at most `BATCH`."""
    rows = iter(records)
    while batch := list(islice(rows, BATCH)):
        yield batch


class Steps:
    """Counts what is done, and tells a callback of it."""

    def __init__(self, progress: Progress | None, total: int) -> None:
        self._progress = progress
        self._total = total
        self._done = 0

    def __call__(self, more: int) -> None:
        """So much more is done."""
        self._done += more
        if self._progress is not None:
            self._progress(self._done, self._total)


def names_in(session: StoreConnection) -> list[str]:
    """The names of the knowledge bases in a store."""
    return [row[0] for row in session.all(queries.knowledge_base_names, {})]


@contextmanager
def opened(url: Store, *, writing: bool = False) -> Iterator[Database]:
    """A store for a while: to be read, or to be written to and set up where it is empty."""
    # of an engine of the caller's, a connection may be shared, and stays as it is
    database = Database(url, read_only=not writing and not isinstance(url, Engine))
    try:
        with database.wrap_errors():
            schema.ensure(database.engine, read_only=not writing)
        yield database
    finally:
        database.close()


# -- files --------------------------------------------------------------------------------------------------------


@contextmanager
def new_file(path: Path) -> Iterator[Path]:
    """Where to write what becomes the file `path`: whole and on the disk, or not there at all."""
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
    """Make sure that a new file is found after a loss of power."""
    if os.name == "posix":
        directory = os.open(path.parent, os.O_RDONLY)
        try:
            os.fsync(directory)
        finally:
            os.close(directory)


def make_archive(path: Path) -> None:
    """Make a file that does not exist, or is empty, one into which history can be archived."""
    try:
        with closing(sqlite3.connect(path)) as connection:
            connection.execute(mark_archive.sqlite)
    except sqlite3.Error as error:
        raise StoreUnavailable(f"{path}: {error}; nothing has been archived") from error


def is_archive(database: Database) -> bool:
    """Whether a store is a file into which history was archived: it ends, and nothing is written to it."""
    if database.dialect != "sqlite":
        return False
    return database.first(application_id, {}) == (ARCHIVE,)


def _identity(record: Record) -> tuple[Any, ...]:
    return record["role"], record["knowledge_type"], record["key"]
