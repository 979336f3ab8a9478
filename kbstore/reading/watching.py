"""Following a knowledge base: each transaction, and what takes effect by the clock alone, as it happens (rule Q6)."""

import time as _time
from collections.abc import Iterator
from dataclasses import replace

from kbstore.model.results import Assertion, Change, Transaction
from kbstore.model.symbols import SymbolTable
from kbstore.reading.history import History
from kbstore.reading.patterns import Pattern
from kbstore.reading.questions import Knowledge
from kbstore.reading.reader import Reader
from kbstore.storage.records import LogPosition
from kbstore.storage.repository import Repository


class Watch:
    """Follows one knowledge base from a change on; misses nothing, and repeats nothing."""

    def __init__(
        self, reader: Reader, history: History, pattern: Knowledge | None, *, poll: float, timeout: float | None
    ) -> None:
        self._reader = reader
        self._history = history
        self._pattern = pattern
        self._poll = poll
        self._timeout = timeout

    def changes(self, after: int | Change | None) -> Iterator[Change]:
        """The changes after one, waiting for more; of none, after the latest at the time of this call."""
        return self._follow(*self._begin(after))

    def _follow(self, last: Transaction, seen: int) -> Iterator[Change]:
        quiet_since = _time.monotonic()
        while True:
            with self._reader.repository() as repository:
                found, seen = self._next(repository, last, seen)
                symbol_table = self._symbols(repository)
            for change in found:
                last = change.transaction
                wanted = change if self._pattern is None else _matching(change, self._pattern, symbol_table)
                if wanted is not None:
                    yield wanted
            if found:
                quiet_since = _time.monotonic()
                continue
            if self._timeout is not None and _time.monotonic() - quiet_since >= self._timeout:
                return
            _time.sleep(self._poll)

    def _begin(self, after: int | Change | None) -> tuple[Transaction, int]:
        """The last transaction that was seen, and the time up to which the clock's doings were."""
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
        """What there is after a transaction and a time, and the time up to which that is everything."""
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

    def _by_clock(self, repository: Repository, last: Transaction, seen: int, upto: int) -> list[Change]:
        if upto <= seen:
            return []
        return self._history.clock_changes(repository, repository.head(), last, seen, upto)

    def _symbols(self, repository: Repository) -> SymbolTable:
        head = repository.head()
        return self._reader.symbol_table(repository, head, LogPosition(self._reader.resolver.now(head)))


def _matching(change: Change, pattern: Knowledge, symbol_table: SymbolTable) -> Change | None:
    """Return the change with the assertions that match; None if there are none."""
    wanted = Pattern(pattern, symbol_table)

    def kept(assertions: list[Assertion]) -> list[Assertion]:
        return [found for found in assertions if not found.is_goal and wanted.matches(found.item)]

    asserted, ended, cancelled = kept(change.asserted), kept(change.ended), kept(change.cancelled)
    if not (asserted or ended or cancelled):
        return None
    return replace(change, asserted=asserted, ended=ended, cancelled=cancelled)
