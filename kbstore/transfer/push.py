"""Continues a knowledge base in another store, transaction by transaction: from the robot's file to a fleet's server.

A push reads the head of the target, reads the transactions after it from one snapshot of the source, and writes them in
one transaction of the target, under the lock of its head, which must not have moved. Nothing is stored elsewhere, so an
interrupted push is simply repeated, and each transaction arrives exactly once. The random tokens of transactions prove
that the target has the beginning of the source's record.
"""

import os
import socket
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

from kbstore.clock import isoformat
from kbstore.errors import Conflict, HistoryUnavailable, InvalidKnowledge, StoreUnavailable, StoreWentBack
from kbstore.model.plain import Result
from kbstore.reading.reader import Reader
from kbstore.storage import directory, queries
from kbstore.storage.connection import LOG, StoreConnection
from kbstore.storage.database import Database
from kbstore.storage.memory import StoreMemory
from kbstore.storage.recorder import put_head
from kbstore.storage.records import Head
from kbstore.storage.repository import Repository
from kbstore.transfer.archive_mark import is_archive
from kbstore.transfer.delta import Delta, Span
from kbstore.transfer.delta_queries import sizes
from kbstore.transfer.rows import Progress, RowTarget, StoreLike, opened
from kbstore.writing.derived_rates import derive_rates

CHUNK = 10_000
"""About how many changed timelines are pushed at once; a transaction is never divided."""

_POLL = 0.1
"""Seconds between two looks at the source by a push that follows it."""

_LONGEST_PAUSE = 30.0
"""The most seconds between two tries to reach a target."""

_NOWHERE = Head(0, 0, 0, 0, 0, 0, 0, 0, 0, None)


@dataclass(frozen=True, slots=True)
class Pushed(Result):
    """The result of a push.

    Attributes:
        name: the knowledge base, by its name in the target.
        number: the last transaction that the target has.
        transactions: how many were pushed.
        rows: how many rows were written for them.
    """

    name: str
    number: int
    transactions: int
    rows: int


class Push:
    """Continues one knowledge base in a target; `close`, which any thread may call, ends it."""

    def __init__(self, reader: Reader, target: Database, name: str, progress: Progress | None) -> None:
        self._reader = reader
        self._target = target
        self._name = name
        self._progress = progress
        self._place = shown(target)
        self._source = f"{reader.name} in {shown(reader.database)}"
        self._closed = threading.Event()
        self._transactions = 0
        self._rows = 0
        self._number = 0

    def close(self) -> None:
        """End a push that follows, also in another thread."""
        self._closed.set()

    def catch_up(self) -> Pushed:
        """Push the transactions that the target lacks."""
        while not self._closed.is_set() and self._advance():
            pass
        return Pushed(self._name, self._number, self._transactions, self._rows)

    def follow(self) -> Pushed:
        """Push, and go on as the source is written to, until `close`; a target that is lost is tried again."""
        pause, seen = 0.0, None
        try:
            while not self._closed.is_set():
                latest = self._latest()
                if latest != seen:
                    try:
                        self.catch_up()
                        pause, seen = 0.0, latest
                    except StoreUnavailable as error:
                        # if it is the source, that is raised when it is looked at again
                        pause = min(_LONGEST_PAUSE, pause * 2 or 1.0)
                        LOG.warning("%s; the push goes on in %g s", error, pause)
                self._closed.wait(pause or _POLL)
        except StoreUnavailable:
            # a source that was closed ends it
            if not self._closed.is_set():
                raise
        return Pushed(self._name, self._number, self._transactions, self._rows)

    def _latest(self) -> tuple[int, int]:
        with self._reader.repository() as repository:
            head = repository.head()
        return head.number, head.token

    def _advance(self) -> bool:
        """Push the next part, and return whether there may be more."""
        before = self._target_head()
        with self._reader.database.read() as session:
            session.be_patient()
            head = Repository(session, self._reader.kb, self._reader.memory).head()
            self._refuse(session, head, before)
            self._number = before.number
            span = _next(session, self._reader.kb, head, before)
            if span is None:
                self._report(head)
                return False
            delta = Delta(session, self._reader.name, span)
            with self._target.begin() as there:
                target = RowTarget(there, self._name, use_unknowns=self._reader.use_unknowns)
                now = Repository(there, target.kb, StoreMemory()).head(for_update=True)
                if (now.number, now.token) != (before.number, before.token):
                    # another process has pushed meanwhile
                    return True
                after = delta.write(there, target, self._source)
                if not delta.is_latest:
                    copied = Repository(there, target.kb, StoreMemory())
                    derive_rates(copied, after, use_unknowns=self._reader.use_unknowns)
        self._number = after.number
        self._transactions += after.number - before.number
        self._rows += delta.rows
        self._report(head)
        LOG.info("pushed %s up to transaction %d to %s", self._name, after.number, self._place)
        return not delta.is_latest

    def _report(self, head: Head) -> None:
        if self._progress is not None:
            self._progress(self._number, head.number)

    # -- what is refused --------------------------------------------------------------------------------------

    def _target_head(self) -> Head:
        """Return the head of the target. Raises `InvalidKnowledge` if its `use_unknowns` differs."""
        with self._target.read() as session:
            found = directory.find(session, self._name)
            if found is None:
                return _NOWHERE
            if found.use_unknowns != self._reader.use_unknowns:
                raise InvalidKnowledge(
                    f"{self._name} in {self._place} has use_unknowns={found.use_unknowns}, {self._reader.name} has "
                    f"not; push under another name"
                )
            return Repository(session, found.kb, StoreMemory()).head()

    def _refuse(self, session: StoreConnection, head: Head, there: Head) -> None:
        """Raise an error unless the target has the beginning of the source's record."""
        name, both = self._name, f"it is at transaction {there.number}, {self._source} at {head.number}"
        if not there.number:
            return
        token = session.first(queries.token, {"kb": self._reader.kb, "number": there.number})
        is_known = token is not None and token[0] == there.token
        if there.source is None and is_known:
            raise Conflict(
                f"{name} in {self._place} was imported, restored or adopted there, and may be written to: {both}, with "
                "the same history so far. Nothing has been pushed; push under another name, or into a store without "
                f"{name}: a first push brings the whole history, and needs no import"
            )
        if there.source is None:
            raise Conflict(
                f"{name} in {self._place} has been written to by others: {both}. Nothing has been pushed; push under "
                "another name, so that both are kept"
            )
        if is_known and there.time >= head.history_from:
            return
        if is_known or (token is None and there.number < head.number):
            raise HistoryUnavailable(
                f"{name} in {self._place} ends with transaction {there.number}, of {isoformat(there.time)}, but "
                f"{self._source}, at transaction {head.number}, keeps its history from {isoformat(head.history_from)} "
                "on only; what lies between has been archived. Push under another name"
            )
        if there.source != self._source:
            raise Conflict(
                f"{name} in {self._place} continues another knowledge base, {there.source}: {both}, with another "
                "history. Nothing has been pushed; push under another name"
            )
        raise StoreWentBack(
            f"the store has gone back: {self._source} has lost transactions that had been pushed to {name} in "
            f"{self._place}: {both}" + ("" if there.number > head.number else ", with another history") + ". Nothing "
            "has been pushed; push under another name, or export what is there and go on with it here"
        )


def _next(session: StoreConnection, kb: int, head: Head, before: Head) -> Span | None:
    """Return the next transactions to be pushed; None if there are none."""
    number, moment, size = before.number, before.time, 0
    for following, time, changes in session.all(sizes, {"kb": kb, "after": before.number, "most": CHUNK}):
        # in a store that has archived its history, no state before that is known
        if size and size + changes > CHUNK and moment >= head.history_from:
            break
        number, moment, size = following, time, size + changes
    if moment < head.history_from:
        number, moment = head.number, head.time
    # an empty knowledge base is pushed, too, so that its copy is marked as one, and refuses other writers
    return None if number == before.number and before.source is not None else Span(before, number, moment)


def shown(database: Database) -> str:
    """Return the name of a store for people: its URL without the password, and for a file also the machine."""
    url = database.engine.url
    if url.get_backend_name() == "sqlite" and url.database and url.database != ":memory:":
        url = url.set(database=os.path.abspath(url.database))
        return f"{url.render_as_string(hide_password=True)} on {socket.gethostname()}"
    return url.render_as_string(hide_password=True)


@contextmanager
def pushing(reader: Reader, url: StoreLike, name: str | None, progress: Progress | None) -> Iterator[Push]:
    """Open a push of a knowledge base into a store; an empty database is set up."""
    if reader.resolver.is_archive:
        raise InvalidKnowledge(f"{reader.name} is an archive here, and not continued elsewhere; push its store")
    with opened(url, writing=True) as target:
        if is_archive(target):
            raise InvalidKnowledge(f"{shown(target)} is an archive, which nobody writes to; push into another store")
        yield Push(reader, target, reader.name if name is None else name, progress)


def adopt(url: StoreLike, name: str) -> str:
    """Turn the copy that pushes have written into an original, which is written to like any other.

    Later pushes to it are refused. Returns the name of its former original.
    """
    with opened(url, writing=True) as database, database.begin() as session:
        found = directory.find(session, name)
        if found is None:
            raise StoreUnavailable(f"there is no knowledge base {name!r} in {shown(database)}")
        head = Repository(session, found.kb, StoreMemory()).head(for_update=True)
        if head.source is None:
            raise Conflict(f"{name} in {shown(database)} is not a copy: it has been written to here all along")
        put_head(session, found.kb, head._replace(source=None))
    return head.source
