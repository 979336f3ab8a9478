"""Moves history out of a store, into an archive that can be asked as the store was (rule Q7).

The store keeps what is needed to answer about a time T and later: what held then, and the transactions that recorded
it. The archive has everything that had been recorded before T.

Archiving that was killed at any moment can be called again with the same arguments, and finishes: the archive is
written in one transaction and checked; only then is T stored as the beginning of the store's history; only after that
is anything deleted, in transactions so small that writers hardly wait.
"""

import os
from dataclasses import dataclass
from pathlib import Path

from kbstore.clock import TimeLike, isoformat, time
from kbstore.errors import HistoryUnavailable, InvalidTime
from kbstore.model.plain import Result
from kbstore.reading.reader import Reader
from kbstore.storage.connection import LOG, StoreConnection
from kbstore.storage.records import Head
from kbstore.storage.repository import Repository
from kbstore.transfer import queries as statements
from kbstore.transfer.archive_file import ArchiveFile
from kbstore.transfer.rows import LogRange, Progress, RowSource, Steps

WINDOW = 500
"""The number of transactions whose rows are deleted at once."""

MOST = 5000
"""The most rows of a table that are deleted at once."""


@dataclass(frozen=True, slots=True)
class Archived(Result):
    """The result of archiving: the archive, the new beginning of the store's history, and the rows deleted there."""

    path: Path
    history_from: int
    rows: int


def archive(
    reader: Reader, before: TimeLike, path: str | os.PathLike[str], *, progress: Progress | None = None
) -> Archived:
    """Move the history of a knowledge base before a time into an archive; see `KnowledgeBase.archive`."""
    return _Archiving(reader, time(before), Path(path), progress).done()


class _Archiving:
    """Archiving the history of one knowledge base before a time."""

    def __init__(self, reader: Reader, before: int, path: Path, progress: Progress | None) -> None:
        self._reader = reader
        self._database = reader.database
        self._before = before
        self._path = path
        self._progress = progress
        self._steps = Steps(None, 0)

    def done(self) -> Archived:
        """Copy, check, delete, and free the space."""
        LOG.info("archiving %s before %s into %s", self._reader.name, isoformat(self._before), self._path)
        with self._database.read() as session:
            session.be_patient()
            repository = Repository(session, self._reader.kb, self._reader.memory)
            head = repository.head()
            self._refuse_future(head)
            # rows that an interrupted archiving has left are deleted, too
            self._before = max(self._before, head.history_from)
            upto = self._last_before(repository, head)
            if not upto:
                return Archived(self._path, head.history_from, 0)
            self._copy(session, head, upto)
        with self._database.begin() as session:
            session.run(statements.archive_history, self._at())
        deleted = self._delete(upto)
        with self._database.connect() as session:
            session.be_patient()
            for statement in statements.reclaim[self._database.dialect]:
                session.run(statement, {})
        LOG.info("archived %s: %d rows deleted from the store", self._reader.name, deleted)
        return Archived(self._path, self._before, deleted)

    def _at(self) -> dict[str, int]:
        return {"kb": self._reader.kb, "t": self._before}

    # -- what is refused --------------------------------------------------------------------------------------

    def _refuse_future(self, head: Head) -> None:
        if self._before > head.time:
            raise InvalidTime(
                f"{isoformat(self._before)} is after the latest transaction of {self._reader.name}, of "
                f"{isoformat(head.time)}; the future cannot be archived: give that time at the latest"
            )

    def _refuse_gone(self, head: Head) -> None:
        """Raise `HistoryUnavailable` if a new archive would need history that the store does not have any more."""
        if self._before <= head.history_from:
            raise HistoryUnavailable(
                f"{self._reader.name} keeps its history from {isoformat(head.history_from)} on; what was before has "
                f"been archived, and is not in {self._path}"
            )

    # -- copying ----------------------------------------------------------------------------------------------

    def _last_before(self, repository: Repository, head: Head) -> int:
        """Return the number of the last transaction before the time; 0 if there was none."""
        following = repository.first_transaction_from(self._before)
        return head.number if following is None else following - 1

    def _copy(self, session: StoreConnection, head: Head, upto: int) -> None:
        """Copy into the archive what it lacks of the history before the time, and check it."""
        part = LogRange(upto=upto, since=head.history_from)
        if not self._path.exists():
            self._refuse_gone(head)
        with ArchiveFile.opened(self._path, self._reader.name) as file:
            own = file.head()
            if own is None:
                self._refuse_gone(head)
            else:
                file.refuse_other(session, head, own)
            counts = RowSource(session, self._reader.name, part).counts()
            parameters = self._at() | {"upto": upto}
            ended = sum(row[0] for count in statements.count_ended for row in session.all(count, parameters))
            self._steps = Steps(self._progress, sum(counts.values()) + ended)
            if own is None or own.time + 1 < self._before:
                file.take(session, self._before, part, self._steps)
            else:
                self._steps(sum(counts.values()))
            file.check(part, counts)

    # -- deleting ---------------------------------------------------------------------------------------------

    def _delete(self, upto: int) -> int:
        """Delete the rows that ended before the time, and the transactions that nothing refers to any more."""
        parameters = self._at() | {"upto": upto, "most": MOST}
        with self._database.begin() as session:
            deleted = session.run(statements.delete_ended_runs, parameters)
            for statement in statements.delete_side_rows:
                session.run(statement, parameters)
        self._steps(deleted)
        for after in range(0, upto, WINDOW):
            window = parameters | {"after": after, "last": min(upto, after + WINDOW)}
            more = True
            while more:
                with self._database.begin() as session:
                    counts = [session.run(statement, window) for statement in statements.delete_ended]
                    more = max(counts) >= MOST
                deleted += sum(counts)
                self._steps(sum(counts))
        self._delete_transactions(parameters, upto)
        return deleted

    def _delete_transactions(self, parameters: dict[str, int], upto: int) -> None:
        """Delete the transactions that nothing refers to any more."""
        with self._database.read() as session:
            found = [row[0] for row in session.all(statements.referred, parameters)]
            referred = session.array(found)
        for after in range(0, upto, WINDOW):
            with self._database.begin() as session:
                window = parameters | {"after": after, "last": min(upto, after + WINDOW), "referred": referred}
                session.run(statements.delete_transactions, window)
