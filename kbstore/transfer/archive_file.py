"""Archive files: SQLite stores, marked as archives, in which a knowledge base ends just before a time.

In an archive the knowledge base is exactly as it was then: it has everything recorded until then, later ends and
cancellations are not known yet, and the ends that were expected are derived anew.
"""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from kbstore.clock import isoformat
from kbstore.errors import HistoryUnavailable, InvalidKnowledge, StoreUnavailable
from kbstore.storage import directory
from kbstore.storage.connection import StoreConnection
from kbstore.storage.database import Database
from kbstore.storage.memory import StoreMemory
from kbstore.storage.records import Head
from kbstore.storage.repository import Repository
from kbstore.transfer.archive_mark import ARCHIVE
from kbstore.transfer.past import PastRows
from kbstore.transfer.queries import assertions, by_table, quick_check
from kbstore.transfer.rows import LogRange, Record, RowSource, RowTarget, batches, make_archive, sync_directory

CHECKED = (*assertions, "schedules", "runs")
"""The tables whose rows are counted before any is deleted."""

_MAGIC = b"SQLite format 3\0"
_MARK = slice(68, 72)
"""The offset of the application's number in the header of an SQLite file."""


class ArchiveFile:
    """The archive of one knowledge base in a file, which may hold those of others, too."""

    def __init__(self, database: Database, path: Path, name: str) -> None:
        self._database = database
        self._path = path
        self._name = name

    @classmethod
    @contextmanager
    def opened(cls, path: Path, name: str) -> Iterator["ArchiveFile"]:
        """Open an archive, and create it if there is no file. Raises `InvalidKnowledge` for any other file."""
        _mark(path)
        database = Database(path)
        try:
            database.ensure_schema(read_only=False)
            sync_directory(path)
            yield cls(database, path, name)
        finally:
            database.close()

    def head(self) -> Head | None:
        """Return the end of its log; None if it has nothing of the knowledge base yet."""
        with self._database.read() as session:
            found = directory.find(session, self._name)
            return None if found is None else Repository(session, found.kb, StoreMemory()).head()

    def refuse_other(self, session: StoreConnection, head: Head, own: Head) -> None:
        """Refuse an archive, which ends with `own`, unless the store that `session` reads continues it.

        Raises `HistoryUnavailable` if there is a gap between the two, `InvalidKnowledge` if the archive is that of
        another knowledge base of the same name.
        """
        if own.time + 1 < head.history_from:
            raise HistoryUnavailable(
                f"{self._path} ends at {isoformat(own.time + 1)}, but the store has {self._name} only from "
                f"{isoformat(head.history_from)} on; go on in the file that ends there, or give a new one"
            )
        part = LogRange(upto=own.number)
        with self._database.read() as there:
            archived = RowSource(there, self._name, part).records("transactions")
            stored = RowSource(session, self._name, part).records("transactions")
            if not _is_part(stored, archived):
                raise InvalidKnowledge(
                    f"{self._path} has the archive of another knowledge base named {self._name}; give another file"
                )

    # -- writing ----------------------------------------------------------------------------------------------

    def take(self, session: StoreConnection, before: int, part: LogRange, step: Callable[[int], None]) -> None:
        """Write a part of the store's record, as it was just before a time, in one transaction."""
        own = self.head()
        if own is not None:
            part = part._replace(after=own.number)
        source = RowSource(session, self._name, part)
        past = PastRows(session, source.kb, part.upto, before - 1)
        head = Head(
            number=part.upto,
            time=before - 1,
            token=source.token,
            late=0 if own is None else own.late,
            timeline=source.timeline,
            last_run=0 if own is None else own.last_run,
            domain_version=0,
            history_from=part.since if own is None else own.history_from,
            present=source.head.present,
            source=None,
        )
        with self._database.begin() as there:
            target = RowTarget(there, self._name, use_unknowns=source.use_unknowns)
            for table in by_table:
                for records in batches(source.records(table)):
                    target.add(table, [past.of(table, record) for record in records])
                    step(len(records))
                    if table == "domains":
                        head = head._replace(domain_version=records[-1]["version"])
                    elif table == "runs":
                        head = head._replace(last_run=max(head.last_run, records[-1]["number"]))
                    elif table == "transactions":
                        late = [record["number"] for record in records if record["late_from"] is not None]
                        head = head._replace(late=max(head.late, *late, 0))
            target.put_head(head)

    def check(self, part: LogRange, counts: dict[str, int]) -> None:
        """Raise `StoreUnavailable` unless the file is sound and has as many rows of each table as were counted."""
        with self._database.read() as session:
            found = RowSource(session, self._name, part).counts()
            sound = session.all(quick_check, {})
        wrong = [table for table in CHECKED if found[table] != counts[table]]
        if wrong or sound != [("ok",)]:
            raise StoreUnavailable(
                f"{self._path} cannot be trusted ({', '.join(wrong) or sound[0][0]}); nothing has been deleted from "
                "the store; archive into another file"
            )


def _mark(path: Path) -> None:
    """Create an archive if there is no file, or an empty one. Raises `InvalidKnowledge` for any other file."""
    try:
        with open(path, "rb") as file:
            header = file.read(100)
    except FileNotFoundError:
        header = b""
    except OSError as error:
        raise StoreUnavailable(f"{path}: {error.strerror or error}; nothing has been archived") from error
    if header:
        if not header.startswith(_MAGIC) or int.from_bytes(header[_MARK]) != ARCHIVE:
            raise InvalidKnowledge(
                f"{path} is not an archive of kbstore; give the name of a new file, or of an archive"
            )
        return
    make_archive(path)


def _is_part(some: Iterator[Record], all_of_them: Iterator[Record]) -> bool:
    """Return whether all records of one iterator, which is in order, are among those of another."""
    return all(any(record == other for other in all_of_them) for record in some)
