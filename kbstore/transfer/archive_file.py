"""The file that history is archived into: an SQLite store, marked, in which a knowledge base ends before a time.

In it a knowledge base is exactly as it was just before that time: it holds whatever had been recorded by then, ends
and cancellations that came later are not known yet, and the ends that were expected are derived anew.
"""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from kbstore.clock import OPEN, isoformat
from kbstore.errors import HistoryUnavailable, InvalidKnowledge, StoreUnavailable
from kbstore.messages import KnowledgeType
from kbstore.model.timelines import Timeline
from kbstore.reading.mentions import mentions
from kbstore.reading.reader import as_running
from kbstore.storage import queries, schema
from kbstore.storage.connection import StoreConnection
from kbstore.storage.database import Database
from kbstore.storage.repository import Head, LogPosition, Repository, TimelineCache
from kbstore.transfer.queries import ARCHIVE, HEAD_COLUMNS, assertions, by_table, drop_unfinished, quick_check
from kbstore.transfer.rows import Part, Record, RowSource, RowTarget, batches, make_archive, sync_directory
from kbstore.writing.action_executor import ActionExecutor
from kbstore.writing.change_set import ChangeSet
from kbstore.writing.recorder import Recorder

CHECKED = (*assertions, "runs", "run_rates")
"""The tables whose rows are counted before any is deleted."""

_UNFINISHED: Record = {
    "end_time": OPEN,
    "ended_tx": None,
    "end_cause": None,
    "cancelled_tx": None,
    "cancelled_time": None,
    "outcome": None,
}
"""What is not known yet of what goes on."""

_MAGIC = b"SQLite format 3\0"
_MARK = slice(68, 72)
"""Where the header of an SQLite file has its application's number."""


class ArchiveFile:
    """The archive of one knowledge base in a file, which may hold those of others, too."""

    def __init__(self, database: Database, path: Path, name: str) -> None:
        self._database = database
        self._path = path
        self._name = name

    @classmethod
    @contextmanager
    def opened(cls, path: Path, name: str) -> Iterator["ArchiveFile"]:
        """An archive for a while; the file is made if there is none. Raises `InvalidKnowledge` for any other file."""
        _mark(path)
        database = Database(path)
        try:
            with database.wrap_errors():
                schema.ensure(database.engine, read_only=False)
            sync_directory(path)
            yield cls(database, path, name)
        finally:
            database.close()

    def head(self) -> Head | None:
        """Where its record stands; None if it has nothing of the knowledge base yet. It ends right after that time."""
        with self._database.read() as session:
            row = session.first(queries.find_knowledge_base, {"name": self._name})
            return None if row is None else Repository(session, row[0], TimelineCache()).head()

    def refuse_other(self, session: StoreConnection, head: Head, own: Head) -> None:
        """Raise unless what it has, up to `own`, goes on in the store that `session` reads.

        Raises `HistoryUnavailable` if there is a gap between the two, `InvalidKnowledge` if it was taken from another
        knowledge base of that name.
        """
        if own.time + 1 < head.history_from:
            raise HistoryUnavailable(
                f"{self._path} ends at {isoformat(own.time + 1)}, but the store has {self._name} only from "
                f"{isoformat(head.history_from)} on; go on in the file that ends there, or give a new one"
            )
        part = Part(upto=own.number)
        with self._database.read() as there:
            archived = RowSource(there, self._name, part).records("transactions")
            stored = RowSource(session, self._name, part).records("transactions")
            if not _is_part(stored, archived):
                raise InvalidKnowledge(
                    f"{self._path} has the archive of another knowledge base named {self._name}; give another file"
                )

    # -- writing ----------------------------------------------------------------------------------------------

    def take(self, session: StoreConnection, before: int, part: Part, step: Callable[[int], None]) -> None:
        """Write what the store has of a part of the record, as it was just before a time; in one transaction."""
        own = self.head()
        if own is not None:
            part = part._replace(after=own.number)
        source = RowSource(session, self._name, part)
        with self._database.begin() as there:
            target = RowTarget(there, self._name, use_unknowns=source.use_unknowns)
            if not target.is_new:
                for statement in drop_unfinished:
                    there.run(statement, {"kb": target.kb, "since": part.since})
            domain_version, last_run = 0, 0 if own is None else own.last_run
            for table in by_table:
                for records in batches(source.records(table)):
                    target.add(table, [_as_before(record, before) for record in records])
                    step(len(records))
                    if table == "domains":
                        domain_version = records[-1]["version"]
                    elif table == "runs":
                        last_run = max(last_run, records[-1]["number"])
            history_from = part.since if own is None else own.history_from
            head = Head(part.upto, before - 1, history_from, domain_version, last_run)
            target.put_head(dict(zip(HEAD_COLUMNS, head, strict=True)))
            _settle(there, target.kb, head)

    def check(self, part: Part, counts: dict[str, int]) -> None:
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
    """Make a file that does not exist, or is empty, an archive; refuse one that is none."""
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
    """Whether all records of one iterator, which is in order, are among those of another."""
    return all(any(record == other for other in all_of_them) for record in some)


def _as_before(record: Record, before: int) -> Record:
    """A row as it was just before a time: what ended or was cancelled later goes on."""
    end, cancelled = record.get("end_time"), record.get("cancelled_time")
    if end is None or end < before or (cancelled is not None and cancelled < before):
        return record
    return record | {name: value for name, value in _UNFINISHED.items() if name in record}


def _settle(session: StoreConnection, kb: int, head: Head) -> None:
    """Derive the ends that lie ahead, and the rates of what is scheduled, as they were expected then."""
    repository = Repository(session, kb, TimelineCache())
    moment = LogPosition(head.time)
    draft = ChangeSet(repository, head.time, mentions)
    timelines: dict[int, Timeline] = {}
    for kind in KnowledgeType:
        for timeline, *_ in (*repository.state_at(kind, moment), *repository.scheduled_at(kind, moment)):
            timelines[timeline.id] = timeline
    draft.loaded(timelines.values())
    running = [as_running(row) for row in repository.running(moment)]
    draft.contributions = ActionExecutor(draft, running, head.last_run).contributions()
    writes = draft.finish(head.number)
    assert not writes.changes
    Recorder(session, kb, head.number, head.time).write(writes)
