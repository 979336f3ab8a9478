"""Follows a knowledge base: each transaction, and what takes effect by the clock alone, as it happens (rule Q6)."""

import threading
import time as _time
from abc import abstractmethod
from collections import deque
from collections.abc import Iterator
from dataclasses import replace
from typing import Generic, Self, TypeVar

from kbstore.errors import InvalidKnowledge, StoreUnavailable
from kbstore.model.results import Assertion, Change, Transaction
from kbstore.model.symbols import SymbolTable
from kbstore.reading.history import History
from kbstore.reading.patterns import Pattern
from kbstore.reading.questions import Knowledge
from kbstore.reading.reader import Reader
from kbstore.reading.runs import Runs
from kbstore.storage.memory import went_back
from kbstore.storage.records import LogPosition
from kbstore.storage.repository import Repository

Found = TypeVar("Found")


class Watch(Iterator[Found], Generic[Found]):
    """An iterator that waits for its next item; `close`, which any thread may call, ends it without an error.

    Args:
        poll: how many seconds it waits between two looks at the store.
        timeout: how many seconds it waits for an item before it ends; None: for ever.
        deadline: a time of `time.monotonic` at which it ends in any case, after the items that are there already.
    """

    def __init__(self, *, poll: float, timeout: float | None, deadline: float | None = None) -> None:
        self.poll = poll
        self._timeout = timeout
        self._deadline = deadline
        self._found: deque[Found] = deque()
        self._closed = threading.Event()

    @abstractmethod
    def _look(self) -> bool:
        """Append to `_found` what has happened by now, or a part of it, and return whether that is all."""

    def close(self) -> None:
        """End the iteration, also in another thread that is waiting for the next item."""
        self._closed.set()

    def __iter__(self) -> Self:
        return self

    def __next__(self) -> Found:
        begin = _time.monotonic()
        while not self.look(begin):
            self._closed.wait(self.poll)
        return self.take()

    @property
    def is_ready(self) -> bool:
        """Whether `take` can answer without a look at the store, with the next item or the end."""
        return bool(self._found) or self._closed.is_set()

    def look(self, begin: float) -> bool:
        """Look once for the next item, and return whether it is there, or the iteration has ended.

        `begin` is the time of `time.monotonic` since which the caller has waited.
        """
        while not self.is_ready:
            try:
                is_all = self._look()
            except StoreUnavailable:
                if self._closed.is_set():
                    break
                raise
            if is_all and not self._found:
                if not self._has_expired(begin):
                    return False
                self._closed.set()
        return True

    def take(self) -> Found:
        """Return the next item. Raises `StopIteration` if there is none, or this was closed."""
        if not self._found:
            self._closed.set()
        if self._closed.is_set():
            raise StopIteration
        return self._found.popleft()

    def _has_expired(self, begin: float) -> bool:
        now = _time.monotonic()
        if self._deadline is not None and now >= self._deadline:
            return True
        return self._timeout is not None and now - begin >= self._timeout


class ChangeWatch(Watch[Change]):
    """Iterates over the changes of a knowledge base after a given one, or from now on (rule Q6).

    No change is missed or repeated. Raises `InvalidKnowledge` or `UnknownSymbol` for a pattern that nothing can match.
    """

    def __init__(
        self,
        reader: Reader,
        history: History,
        pattern: Knowledge | None,
        after: int | Change | None,
        *,
        poll: float,
        timeout: float | None,
    ) -> None:
        super().__init__(poll=poll, timeout=timeout)
        self._reader = reader
        self._returns = reader.memory.progress.returns
        self._history = history
        self._runs = Runs(reader)
        self._delivered: set[tuple[int, str, int]] = set()
        """The latest broken invariants that have been delivered: run, condition, since when."""
        self._pattern = pattern
        if pattern is not None:
            with reader.repository() as repository:
                try:
                    Pattern(pattern, self._symbols(repository)).timelines(repository)
                except InvalidKnowledge as error:
                    raise InvalidKnowledge(*error.violations, "watch_condition() follows a condition") from None
        self._last, self._seen = self._begin(after)
        self._head = self._last.number

    def _look(self) -> bool:
        # one look goes as far as the head was when it began, so that a busy writer does not prolong it for ever
        if self._last.number >= self._head:
            with self._reader.repository() as repository:
                self._head = repository.head().number
        with self._reader.repository() as repository:
            number = repository.head().number
            if self._reader.memory.progress.returns != self._returns:
                raise went_back(self._reader.name, self._last.number, number)
            before = self._seen
            changes, self._seen = self._next(repository, self._last, before)
            if self._pattern is None:
                changes = self._with_breaks(repository, changes, before)
            symbol_table = self._symbols(repository)
        for change in changes:
            self._last = change.transaction
            wanted = change if self._pattern is None else _matching(change, self._pattern, symbol_table)
            if wanted is not None:
                self._found.append(wanted)
        return self._last.number >= self._head

    def _begin(self, after: int | Change | None) -> tuple[Transaction, int]:
        """Return the transaction to begin after, and the time up to which changes by the clock count as delivered."""
        if isinstance(after, Change):
            return after.transaction, after.time
        with self._reader.repository() as repository:
            head = repository.head()
            if after is None:
                number, seen = head.number, self._reader.resolver.now(head)
            else:
                number, seen = after, -1
            rows = self._history.transactions(repository, [number])
            last = rows.get(number, Transaction(number, 0))
            return last, last.time if seen < 0 else seen

    def _next(self, repository: Repository, last: Transaction, seen: int) -> tuple[list[Change], int]:
        """Return the changes after a transaction and a time, and the time up to which they are complete."""
        head = repository.head()
        batch = self._history.batch(repository, head, last.number)
        found: list[Change] = []
        for change in batch:
            found += self._by_clock(repository, last, seen, change.transaction.time)
            found.append(change)
            last, seen = change.transaction, max(seen, change.transaction.time)
        if last.number == head.number:
            now = self._reader.resolver.now(head)
            found += self._by_clock(repository, last, seen, now)
            seen = max(seen, now)
        return found, seen

    def _with_breaks(self, repository: Repository, changes: list[Change], after: int) -> list[Change]:
        """Insert the invariants of runs that break, each at the time at which it breaks (rule O6)."""
        if not repository.head().last_run:
            return changes
        times = {change.time for change in changes}
        for broken in self._runs.beginning(repository, after, self._seen):
            key = (broken.run, broken.condition, broken.since)
            if key in self._delivered or (broken.since <= after and broken.since not in times):
                continue
            self._delivered = {other for other in self._delivered if other[2] >= after} | {key}
            place = sum(change.time <= broken.since for change in changes)
            if place and changes[place - 1].time == broken.since:
                change = changes[place - 1]
                changes[place - 1] = replace(change, broken=[*change.broken, broken])
            else:
                transaction = changes[place - 1].transaction if place else self._last
                changes.insert(place, Change(transaction.number, transaction, time=broken.since, broken=[broken]))
        return changes

    def _by_clock(self, repository: Repository, last: Transaction, seen: int, upto: int) -> list[Change]:
        if upto <= seen:
            return []
        return self._history.clock_changes(repository, repository.head(), last, seen, upto)

    def _symbols(self, repository: Repository) -> SymbolTable:
        head = repository.head()
        return self._reader.symbol_table(repository, head, LogPosition(self._reader.resolver.now(head)))


def _matching(change: Change, pattern: Knowledge, symbol_table: SymbolTable) -> Change | None:
    """Return the change with only the assertions that match; None if none does."""
    wanted = Pattern(pattern, symbol_table)

    def matching(assertions: list[Assertion]) -> list[Assertion]:
        return [found for found in assertions if not found.is_goal and wanted.matches(found.item)]

    asserted, ended, cancelled = matching(change.asserted), matching(change.ended), matching(change.cancelled)
    superseded = matching(change.superseded)
    if not (asserted or ended or cancelled or superseded):
        return None
    return replace(change, asserted=asserted, ended=ended, cancelled=cancelled, superseded=superseded)
