"""The per-process memory of a knowledge base, and the check whether its store has gone back.

A store goes back when a backup is restored over it, when an asynchronous standby takes over, or when its file is
copied back. From then on numbers of timelines, of versions and of transactions may mean something else. Each
transaction has a random token, so that one comparison decides: the store has gone back if it is at a lower number than
before, or if the last transaction that was seen has another token now.
"""

import threading
from collections import defaultdict
from collections.abc import Callable, Iterable, Mapping
from typing import NamedTuple

from kbstore.errors import StoreWentBack
from kbstore.messages import KnowledgeType
from kbstore.model.timelines import Identity, Role, Timeline
from kbstore.storage.caches import ABSENT, LRU, OPEN_ROWS, TIMELINES
from kbstore.storage.connection import LOG
from kbstore.storage.records import Head, StoredAssertion


class Mark(NamedTuple):
    """A transaction, by its number and its token."""

    number: int
    token: int


class TimelineCache:
    """The timelines that this process has seen; they never change, so rows are read with their numbers alone.

    Attributes:
        by_id, by_key: the timelines.
        absent: keys that had no timeline, each with the number of the last timeline then.
    """

    def __init__(self, bound: int = TIMELINES) -> None:
        self.by_id: LRU[int, Timeline] = LRU(bound)
        self.by_key: dict[tuple[Role, KnowledgeType], LRU[str, Timeline]] = defaultdict(lambda: LRU(bound))
        self.absent: LRU[Identity, int] = LRU(min(bound, ABSENT))

    def put(self, timeline: Timeline) -> None:
        """Cache a timeline that is committed."""
        self.by_id.put(timeline.id, timeline)
        self.by_key[timeline.role, timeline.kind].put(timeline.key, timeline)

    def put_all(self, timelines: Iterable[Timeline]) -> None:
        """Cache timelines that are committed."""
        by_key: dict[tuple[Role, KnowledgeType], dict[str, Timeline]] = defaultdict(dict)
        for timeline in timelines:
            by_key[timeline.role, timeline.kind][timeline.key] = timeline
        for group, found in by_key.items():
            self.by_id.put_all({timeline.id: timeline for timeline in found.values()})
            self.by_key[group].put_all(found)


class OpenRows:
    """The open rows that a writer read or wrote lately, at most one for each timeline, as of one transaction.

    A sensor replaces the same values again and again, and would read each time what it has just written. The rows are
    valid only for a writer that has locked the head of that very transaction.
    """

    def __init__(self, bound: int) -> None:
        self._rows: LRU[int, StoredAssertion] = LRU(bound)
        self._token: int | None = None
        self._lock = threading.Lock()

    def of(self, token: int, ids: Iterable[int]) -> dict[int, StoredAssertion]:
        """Return the cached rows as of the transaction with a token, by timeline."""
        with self._lock:
            if token != self._token:
                self._rows.clear()
                self._token = token
            rows = self._rows
            return {id: row for id in ids if (row := rows.get(id) or rows.find(id)) is not None}

    def put(self, token: int, rows: Mapping[int, StoredAssertion]) -> None:
        """Cache rows that were read as of the transaction with a token."""
        self.follow(token, token, (), rows)

    def follow(self, before: int, token: int, gone: Iterable[int], rows: Mapping[int, StoredAssertion]) -> None:
        """Go on to the transaction `token`, which followed `before`, wrote `rows`, and changed the timelines `gone`."""
        with self._lock:
            # if another thread has gone further, its rows are as of its own transaction
            if before == self._token:
                # so that an interrupt half-way leaves the rows without a transaction, and unused
                self._token = None
                self._rows.drop(gone)
                self._rows.put_all(rows)
                self._token = token


class LogEnd:
    """The end of the log when it was last read; shared by copies of a memory.

    Attributes:
        seen: the last transaction that has been seen.
        acknowledged: the last transaction that this process committed.
        present: which kinds of rows there were then, as in `Head`.
        has_runs: whether there was a run.
        returns: how often the store has gone back.
        is_gone: whether it has gone back to before the knowledge base was made.
    """

    def __init__(self) -> None:
        self.seen = Mark(0, 0)
        self.acknowledged: Mark | None = None
        self.present = 0
        self.has_runs = False
        self.returns = 0
        self.is_gone = False
        self.forgetting: list[Callable[[], None]] = []
        self.lock = threading.Lock()


class StoreMemory:
    """The memory of this process about one knowledge base.

    A copy shares everything but the timelines.

    Attributes:
        bound: the most timelines that are cached; 0: none.
        timelines: those that have been read or written.
        open_rows: the rows that a writer need not read.
        progress: how far the record has been seen.
    """

    def __init__(self, name: str = "", bound: int = TIMELINES) -> None:
        self.name = name
        self.timelines = TimelineCache(bound)
        self.open_rows = OpenRows(min(bound, OPEN_ROWS))
        self.bound = bound
        self.progress = LogEnd()
        self.progress.forgetting.append(self._forget_timelines)

    def gone(self) -> StoreWentBack:
        """Return the error for a knowledge base that is not in the store any more, and refuse it from now on."""
        self.progress.is_gone = True
        number = self.progress.seen.number
        return StoreWentBack(
            f"the store has gone back: {self.name} was at transaction {number}, and there is no such knowledge base "
            "any more (transaction 0); open what is there now with kbstore.open()"
        )

    def when_gone_back(self, forget: Callable[[], None]) -> None:
        """Register a function to be called whenever the store has gone back."""
        self.progress.forgetting.append(forget)

    def acknowledge(self, head: Head, timelines: Iterable[Timeline]) -> None:
        """Remember the end of the log for this process, and the timelines that it made in a transaction."""
        progress = self.progress
        with progress.lock:
            # a thread that committed later may have been here before
            if progress.acknowledged is None or progress.acknowledged.number <= head.number:
                progress.seen = progress.acknowledged = Mark(head.number, head.token)
        self.timelines.put_all(timelines)

    def look(self, seen: Mark, now: Mark, token_of: Callable[[int], int | None]) -> bool:
        """Take note of the end of the log.

        Args:
            seen: what had been seen before the record was looked at.
            now: the last transaction.
            token_of: reads the token of a transaction; None if it is not stored any more.

        Returns:
            Whether the store has gone back; everything that was cached is forgotten then.

        Raises:
            StoreWentBack: a transaction of this process is gone. It is raised once.
        """
        progress = self.progress
        if now.number > seen.number and (not seen.number or token_of(seen.number) == seen.token):
            with progress.lock:
                if now.number > progress.seen.number:
                    progress.seen = now
            return False
        with progress.lock:
            own = progress.acknowledged
            if progress.seen != now:
                LOG.warning("%s: the store has gone back from transaction %d to %d", self.name, seen.number, now.number)
                progress.seen = now
                progress.returns += 1
                for forget in progress.forgetting:
                    forget()
            self._forget_timelines()
            if own is None or (own.number <= now.number and token_of(own.number) in (own.token, None)):
                return True
            progress.acknowledged = None
        raise went_back(self.name, own.number, now.number)

    def _forget_timelines(self) -> None:
        self.timelines = TimelineCache(self.bound)


def went_back(name: str, known: int, now: int) -> StoreWentBack:
    """Return the error for a store that was at the transaction `known`, and is now at the transaction `now`."""
    where = f"has another transaction {known}" if now == known else f"is at transaction {now}"
    return StoreWentBack(
        f"the store has gone back: {name} was at transaction {known}, and {where}; a backup was restored, or a "
        "standby took over. Transactions are lost: read the state again, and record what is still true"
    )
