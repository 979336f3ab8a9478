"""Reads the record of a knowledge base: histories of timelines, changes by transactions, changes by the clock."""

from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import NamedTuple

from kbstore.clock import OPEN, TimeLike
from kbstore.errors import UnknownSymbol
from kbstore.messages import KnowledgeType
from kbstore.model.assertions import Assertions
from kbstore.model.results import AsOf, Assertion, Change, Transaction
from kbstore.model.symbols import SymbolTable
from kbstore.model.timelines import EndCause, Role
from kbstore.reading.item_factory import ItemFactory
from kbstore.reading.mentions import mentions
from kbstore.reading.patterns import Pattern
from kbstore.reading.questions import Knowledge
from kbstore.reading.reader import Reader
from kbstore.reading.resolver import TemporalPoint
from kbstore.storage.memory import went_back
from kbstore.storage.records import Head, LogPosition, RecordedAssertion
from kbstore.storage.repository import Repository

BATCH = 256
"""The number of transactions that `changes` reads at once."""


class Baseline(NamedTuple):
    """What is on record at a time, from which later changes continue.

    Attributes:
        number: the last transaction until then.
        time: the time, in nanoseconds.
        assertions: those that hold then or later, and those that later transactions changed.
    """

    number: int
    time: int
    assertions: list[Assertion]


class History:
    """Reads the record of one knowledge base."""

    def __init__(self, reader: Reader) -> None:
        self._reader = reader

    # -- one pattern ------------------------------------------------------------------------------------------

    def assertions(
        self,
        pattern: Knowledge | None,
        since: TimeLike | None = None,
        until: TimeLike | None = None,
        as_of: AsOf | None = None,
    ) -> Assertions:
        """Return the assertions that match a pattern and overlap ``[since, until)``, in order of time (rule Q3).

        Without a pattern, all of the state. With `as_of`, those that were on record then, as they were.
        """
        with self._reader.repository() as repository:
            first, last, point = self._reader.resolver.resolve_span(repository, since, until, as_of)
            upto = self._reader.resolver.known_by(repository, point)
            if pattern is None:
                symbol_table = self._reader.symbol_table(repository, point.head, point.position)
                kinds = [(kind, repository.of_kind(Role.STATE, kind)) for kind in KnowledgeType]
                found = [row for kind, lines in kinds for row in repository.history(kind, lines, first, last, upto)]
            else:
                symbol_table = self._symbols(repository, point, pattern, last)
                wanted = Pattern(pattern, symbol_table)
                found = repository.history(wanted.kind, wanted.timelines(repository), first, last, upto)
                found = [row for row in found if wanted.matches_row(row)]
            rows = [row for row in found if _overlaps(row, first)]
            rows.sort(key=_order)
            return Assertions(self.as_assertions(repository, rows, symbol_table, upto))

    def transactions_within(
        self, since: TimeLike | None = None, until: TimeLike | None = None, as_of: AsOf | None = None
    ) -> list[Transaction]:
        """Return the transactions of ``[since, until)``, in order; with `as_of`, those that had been committed then."""
        with self._reader.repository() as repository:
            head = repository.head()
            begin = head.history_from if since is None else since
            first, last, point = self._reader.resolver.resolve_span(repository, begin, until, as_of)
            upto = self._reader.resolver.known_by(repository, point)
            after = repository.last_number_at(first - 1)
            rows = repository.transactions_between(after, head.number if upto is None else upto)
            return [found for found in map(as_transaction, rows) if found.time < last]

    def _symbols(self, repository: Repository, now: TemporalPoint, pattern: Knowledge, until: int) -> SymbolTable:
        """Return the symbols of the latest version of the domain that knows the pattern's symbol (rule D4)."""
        upto = self._reader.resolver.known_by(repository, now)
        versions = self._reader.domains.all(repository, now.head)
        versions = [v for v in versions if v.time < until and (upto is None or v.transaction <= upto)]
        if not versions:
            return self._reader.symbol_table(repository, now.head, now.position)
        refusal: UnknownSymbol | None = None
        for version in reversed(versions):
            symbol_table = SymbolTable(version.domain)
            try:
                Pattern(pattern, symbol_table)
            except UnknownSymbol as error:
                refusal = refusal or error
            else:
                return symbol_table
        assert refusal is not None
        raise refusal

    def baseline(self, since: int | None, most: int | None = None) -> Baseline:
        """Return what is on record at a time, in nanoseconds; see `KnowledgeBase.baseline`."""
        with self._reader.repository() as repository:
            head = repository.head()
            first = max(since or 0, head.history_from)
            if since is None and most is not None and head.number > most:
                first = max(first, *(row[1] for row in repository.transactions([head.number - most])))
            if since is None and not first:
                return Baseline(0, 0, [])
            following = repository.first_transaction_from(first + 1)
            last = head.number if following is None else following - 1
            rows = [
                row
                for role in (Role.STATE, Role.GOAL)
                for kind in KnowledgeType
                for row in repository.history(kind, repository.of_kind(role, kind), first, OPEN)
                if row.recorded <= last and _matters(row, first, last)
            ]
            symbol_table = self._reader.symbol_table(repository, head, LogPosition(head.time))
            return Baseline(last, first, self.as_assertions(repository, rows, symbol_table))

    # -- rows to assertions -----------------------------------------------------------------------------------

    def as_assertions(
        self,
        repository: Repository,
        rows: Sequence[RecordedAssertion],
        symbol_table: SymbolTable,
        upto: int | None = None,
    ) -> list[Assertion]:
        """Return rows as assertions; an end by the clock has the transaction that scheduled it."""
        enders = self.enders(repository, rows, upto)
        spans = [(row.first_recorded or row.recorded, ended) for row, (ended, _) in zip(rows, enders, strict=True)]
        numbers = {number for pair in spans for number in pair}
        numbers |= {number for row in rows for number in (row.cancelled, row.superseded)}
        transactions = self.transactions(repository, {number for number in numbers if number is not None})
        reader = ItemFactory(symbol_table)
        found = []
        for row, (recorded, ended) in zip(rows, spans, strict=True):
            found.append(
                Assertion(
                    item=reader.item(row.timeline, row.initial_time, row.value, row.initial_time),
                    initial_time=row.initial_time,
                    end_time=None if row.end_time == OPEN else row.end_time,
                    recorded=transactions[recorded],
                    ended=None if ended is None else transactions[ended],
                    cancelled=None if row.cancelled is None else transactions[row.cancelled],
                    superseded=None if row.superseded is None else transactions[row.superseded],
                    is_goal=row.timeline.role is Role.GOAL,
                )
            )
        return found

    @staticmethod
    def enders(
        repository: Repository, rows: Sequence[RecordedAssertion], upto: int | None = None
    ) -> list[tuple[int | None, EndCause]]:
        """Return for each row the transaction that ended it, or scheduled its end, and why; None if it has no end.

        With `upto`, as was known after that transaction.
        """
        by_clock = [row for row in rows if row.ended is None and row.cancelled is None and row.end_time != OPEN]
        ends = {(row.timeline.id, row.end_time): (row.timeline, row.end_time) for row in by_clock}
        following: dict[tuple[int, int], list[RecordedAssertion]] = defaultdict(list)
        for found in repository.beginning_at(ends.values(), upto):
            following[found.timeline.id, found.initial_time].append(found)
        mentioned = {id(row): mentions(row.timeline, row.value) for row in by_clock}
        names = list(dict.fromkeys(name for found in mentioned.values() for name in found))
        objects = repository.find(Role.STATE, KnowledgeType.INSTANCE, names) if names else {}
        ends_of = {(name, row.end_time) for row in by_clock for name in mentioned[id(row)] if name in objects}
        gone: dict[tuple[str, int], list[RecordedAssertion]] = defaultdict(list)
        for found in repository.beginning_at(((objects[name], t) for name, t in ends_of), upto):
            if found.value[0]:
                gone[found.timeline.key, found.initial_time].append(found)

        def ender(row: RecordedAssertion) -> tuple[int | None, EndCause]:
            if row.ended is not None or row.cancelled is not None or row.end_time == OPEN:
                return row.ended, EndCause.REMOVED if row.cause is None else EndCause(row.cause)
            # if several began then, the first to be recorded ended it
            followers = [found.recorded for found in following[row.timeline.id, row.end_time] if found.followed(row)]
            if followers:
                return min(followers), EndCause.REPLACED
            # otherwise the end of an object did
            ended = [gone[name, row.end_time] for name in mentioned[id(row)]]
            numbers = [found.recorded for group in ended for found in group if found.followed(row)]
            return min(numbers, default=None), EndCause.OBJECT

        return [ender(row) for row in rows]

    @staticmethod
    def transactions(repository: Repository, numbers: Iterable[int]) -> dict[int, Transaction]:
        """Return transactions by number."""
        return {row[0]: as_transaction(row) for row in repository.transactions(numbers)}

    # -- changes ----------------------------------------------------------------------------------------------

    def changes(self, after: int) -> Iterator[Change]:
        """Yield each transaction after a number, with what it asserted, ended, cancelled and superseded (rule Q6)."""
        while True:
            with self._reader.repository() as repository:
                batch = self.batch(repository, repository.head(), after)
            if not batch:
                return
            yield from batch
            after = batch[-1].number

    def batch(self, repository: Repository, head: Head, after: int) -> list[Change]:
        """Return the next changes after a transaction, at most `BATCH`."""
        upto = min(head.number, after + BATCH)
        if after > head.number:
            raise went_back(self._reader.name, after, head.number)
        if upto <= after:
            return []
        transactions = [as_transaction(row) for row in repository.transactions_between(after, upto)]
        self._refuse_gap(repository, transactions, after, head)
        symbol_table = self._reader.symbol_table(repository, head, LogPosition(head.time))
        rows = repository.changes_between(after, upto)
        everything = [*rows.recorded, *rows.ended, *rows.cancelled, *rows.superseded]
        assertions = dict(
            zip(map(id, everything), self.as_assertions(repository, everything, symbol_table), strict=True)
        )
        asserted_by: dict[int | None, list[Assertion]] = defaultdict(list)
        ended_by: dict[int | None, list[Assertion]] = defaultdict(list)
        cancelled_by: dict[int | None, list[Assertion]] = defaultdict(list)
        superseded_by: dict[int | None, list[Assertion]] = defaultdict(list)
        for row in rows.recorded:
            asserted_by[row.recorded].append(assertions[id(row)])
        for row in rows.ended:
            ended_by[row.ended].append(assertions[id(row)])
        for row in rows.cancelled:
            cancelled_by[row.cancelled].append(assertions[id(row)])
        for row in rows.superseded:
            superseded_by[row.superseded].append(assertions[id(row)])
        versions = self._reader.domains.all(repository, head)
        domains = {version.transaction: version.domain.name for version in versions if version.domain is not None}
        return [
            Change(
                transaction.number,
                transaction,
                asserted_by[transaction.number],
                ended_by[transaction.number],
                cancelled_by[transaction.number],
                transaction.time,
                superseded=superseded_by[transaction.number],
                domain=domains.get(transaction.number),
            )
            for transaction in transactions
        ]

    def _refuse_gap(self, repository: Repository, transactions: Sequence[Transaction], after: int, head: Head) -> None:
        """Raise `HistoryUnavailable` if a transaction after a number, or what it ended, has been archived."""
        if not head.history_from:
            return
        following = transactions[0] if transactions else None
        if following is None or following.number != after + 1 or following.time < head.history_from:
            first = repository.first_transaction_from(head.history_from)
            advice = "" if first is None else f" (changes that are kept follow transaction {first - 1})"
            raise self._reader.resolver.archived(f"what followed transaction {after}{advice}", head)

    # -- changes by the clock ---------------------------------------------------------------------------------

    def clock_changes(
        self, repository: Repository, head: Head, last: Transaction, after: int, upto: int
    ) -> list[Change]:
        """Return what took effect by the clock alone after a time and up to another, in order of time.

        `last` is the latest transaction before it.
        """
        self._reader.resolver.refuse_archived(after + 1, head)
        due: dict[int, list[RecordedAssertion]] = defaultdict(list)
        for row in repository.due_between(after, upto):
            due[row.initial_time].append(row)
        if not due:
            return []
        symbol_table = self._reader.symbol_table(repository, head, LogPosition(head.time))
        ended = self._ended_by_clock(repository, due, last.number if head.late > last.number else None)
        rows = [row for t in due for row in (*due[t], *ended[t])]
        assertions = dict(zip(map(id, rows), self.as_assertions(repository, rows, symbol_table), strict=True))
        return [
            Change(
                last.number,
                last,
                [assertions[id(row)] for row in due[t]],
                [assertions[id(row)] for row in ended[t]],
                [],
                t,
            )
            for t in sorted(due)
        ]

    @staticmethod
    def _ended_by_clock(
        repository: Repository, due: Mapping[int, Sequence[RecordedAssertion]], upto: int | None
    ) -> dict[int, list[RecordedAssertion]]:
        """Return, by time, what ended when scheduled assertions took effect: on their timelines, or with an object.

        With `upto`, as was known after that transaction, because late knowledge has been recorded since.
        """
        points = {(row.timeline.id, t): (row.timeline, t) for t, rows in due.items() for row in rows}
        gone: dict[int, set[str]] = {
            t: {row.timeline.key for row in rows if row.timeline.kind is KnowledgeType.INSTANCE and row.value[0]}
            for t, rows in due.items()
        }
        objects = {row.timeline.id for t, rows in due.items() for row in rows if row.timeline.key in gone[t]}
        mentioning = repository.mentioning(list(objects)) if objects else []
        points |= {(line.id, t): (line, t) for t, names in gone.items() if names for line in mentioning}
        if upto is None:
            ending = repository.latest_before(points.values())
        else:
            lines = {line.id: line for line, _ in points.values()}.values()
            ending = [row for line in lines for row in repository.history(line.kind, [line], 0, max(due), upto)]
        found: dict[int, list[RecordedAssertion]] = defaultdict(list)
        for row in ending:
            if row.ended is None and row.is_known and (row.timeline.id, row.end_time) in points:
                found[row.end_time].append(row)
        return found


def as_transaction(row: Sequence[object]) -> Transaction:
    """Return the transaction of a row."""
    number, recorded, changes, client, note = row
    return Transaction(number, recorded, client or "", note or "", changes)  # type: ignore[arg-type]


def _overlaps(row: RecordedAssertion, first: int) -> bool:
    return row.end_time > first or (row.initial_time >= first and row.end_time <= row.initial_time)


def _matters(row: RecordedAssertion, first: int, last: int) -> bool:
    """Return whether a row holds after the time `first`, or was changed after the transaction `last`."""
    gone = row.cancelled or row.superseded or 0
    return max(gone, row.ended or 0) > last or (not gone and row.end_time > first)


def _order(row: RecordedAssertion) -> tuple[int, int, int]:
    return row.initial_time, row.recorded, row.timeline.id
