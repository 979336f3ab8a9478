"""The record of a knowledge base: histories of timelines, changes of transactions, what the clock brought about."""

from collections import defaultdict
from collections.abc import Iterable, Iterator, Sequence

from kbstore.clock import OPEN, TimeLike
from kbstore.errors import UnknownSymbol
from kbstore.messages import KnowledgeType
from kbstore.model.results import Assertion, Assertions, Change, Transaction
from kbstore.model.symbols import SymbolTable
from kbstore.model.timelines import Role, Timeline
from kbstore.reading.item_factory import ItemFactory
from kbstore.reading.mentions import mentions
from kbstore.reading.patterns import Pattern
from kbstore.reading.questions import Knowledge
from kbstore.reading.reader import Reader
from kbstore.reading.resolver import TemporalPoint
from kbstore.storage.records import Head, LogPosition, RecordedAssertion
from kbstore.storage.repository import Repository

BATCH = 256
"""How many transactions `changes` reads at once."""

_FEW = 32
"""Up to this many timelines, each is read from where the span begins; more are read as a whole."""


class History:
    """Reads the record of one knowledge base."""

    def __init__(self, reader: Reader) -> None:
        self._reader = reader

    # -- one pattern ------------------------------------------------------------------------------------------

    def assertions(
        self, pattern: Knowledge, since: TimeLike | None = None, until: TimeLike | None = None
    ) -> Assertions:
        """The assertions that match a pattern and overlap ``[since, until)``, in order of time (rule Q3)."""
        with self._reader.repository() as repository:
            first, last, now = self._reader.resolver.resolve_span(repository, since, until)
            symbol_table = self._symbols(repository, now, pattern, last)
            wanted = Pattern(pattern, symbol_table)
            rows = [
                row
                for row in self.rows(repository, wanted.kind, wanted.timelines(repository), first, last)
                if wanted.matches_row(row) and _overlaps(row, first)
            ]
            rows.sort(key=_order)
            return Assertions(self.as_assertions(repository, rows, symbol_table))

    def rows(
        self, repository: Repository, kind: KnowledgeType, timelines: Sequence[Timeline], first: int, until: int
    ) -> list[RecordedAssertion]:
        """The rows of timelines from the one that stands at `first` on."""
        if not timelines:
            return []
        if len(timelines) > _FEW or not first:
            return repository.history(kind, timelines, 0, until)
        rows: list[RecordedAssertion] = []
        for timeline in timelines:
            rows += repository.history(kind, [timeline], repository.latest_start(timeline, first), until)
        return rows

    def _symbols(self, repository: Repository, now: TemporalPoint, pattern: Knowledge, until: int) -> SymbolTable:
        """The latest vocabulary that knows the pattern's symbol (rule D4)."""
        versions = [v for v in self._reader.domains.all(repository, now.head) if v.time < until]
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

    # -- rows to assertions -----------------------------------------------------------------------------------

    def as_assertions(
        self, repository: Repository, rows: Sequence[RecordedAssertion], symbol_table: SymbolTable
    ) -> list[Assertion]:
        """Assertions with their transactions; ends that came by the clock with the transaction that scheduled them."""
        ends = {index: self.ender(repository, row) for index, row in enumerate(rows)}
        numbers = {row.recorded for row in rows} | {row.cancelled for row in rows} | set(ends.values())
        transactions = self.transactions(repository, {number for number in numbers if number is not None})
        reader = ItemFactory(symbol_table)
        found = []
        for index, row in enumerate(rows):
            ended, cancelled = ends[index], row.cancelled
            found.append(
                Assertion(
                    item=reader.item(row.timeline, row.initial_time, row.value, row.initial_time),
                    initial_time=row.initial_time,
                    end_time=None if row.end_time == OPEN else row.end_time,
                    recorded=transactions[row.recorded],
                    ended=None if ended is None else transactions[ended],
                    cancelled=None if cancelled is None else transactions[cancelled],
                    is_goal=row.timeline.role is Role.GOAL,
                )
            )
        return found

    @staticmethod
    def ender(repository: Repository, row: RecordedAssertion) -> int | None:
        """The transaction that ended a row, or scheduled what ends it."""
        if row.ended is not None or row.cancelled is not None or row.end_time == OPEN:
            return row.ended
        kind, end = row.timeline.kind, row.end_time
        # of several that begin then, the first to take effect ended it: what was scheduled before what was told
        followers = repository.history(kind, [row.timeline], end, end + 1)
        numbers = [follower.recorded for follower in followers if follower.cancelled is None]
        if numbers:
            return min(numbers)
        objects = repository.find(Role.STATE, KnowledgeType.INSTANCE, list(mentions(row.timeline, row.value)))
        followers = repository.history(KnowledgeType.INSTANCE, list(objects.values()), end, end + 1)
        gone = [follower.recorded for follower in followers if follower.value[0] and follower.cancelled is None]
        return min(gone, default=None)

    @staticmethod
    def transactions(repository: Repository, numbers: Iterable[int]) -> dict[int, Transaction]:
        """Transactions by number."""
        return {row[0]: as_transaction(row) for row in repository.transactions(numbers)}

    # -- changes ----------------------------------------------------------------------------------------------

    def changes(self, after: int) -> Iterator[Change]:
        """Each transaction after a number, with all that it asserted, ended and cancelled (rule Q6)."""
        while True:
            with self._reader.repository() as repository:
                batch = self.batch(repository, repository.head(), after)
            if not batch:
                return
            yield from batch
            after = batch[-1].number

    def batch(self, repository: Repository, head: Head, after: int) -> list[Change]:
        """The next changes after a transaction, at most `BATCH`."""
        upto = min(head.number, after + BATCH)
        if upto <= after:
            return []
        transactions = [as_transaction(row) for row in repository.transactions_between(after, upto)]
        self._refuse_gap(repository, transactions, after, head)
        symbol_table = self._reader.symbol_table(repository, head, LogPosition(head.time))
        rows = repository.changes_between(after, upto)
        everything = [*rows.recorded, *rows.ended, *rows.cancelled]
        assertions = dict(
            zip(map(id, everything), self.as_assertions(repository, everything, symbol_table), strict=True)
        )
        asserted_by: dict[int | None, list[Assertion]] = defaultdict(list)
        ended_by: dict[int | None, list[Assertion]] = defaultdict(list)
        cancelled_by: dict[int | None, list[Assertion]] = defaultdict(list)
        for row in rows.recorded:
            asserted_by[row.recorded].append(assertions[id(row)])
        for row in rows.ended:
            ended_by[row.ended].append(assertions[id(row)])
        for row in rows.cancelled:
            cancelled_by[row.cancelled].append(assertions[id(row)])
        return [
            Change(
                transaction.number,
                transaction,
                asserted_by[transaction.number],
                ended_by[transaction.number],
                cancelled_by[transaction.number],
                transaction.time,
            )
            for transaction in transactions
        ]

    def _refuse_gap(self, repository: Repository, transactions: Sequence[Transaction], after: int, head: Head) -> None:
        """Raise where the transactions after a number have been archived, or what they ended."""
        if not head.history_from:
            return
        following = transactions[0] if transactions else None
        if following is None or following.number != after + 1 or following.time < head.history_from:
            first = repository.first_transaction_from(head.history_from)
            advice = "" if first is None else f" (changes that are kept follow transaction {first - 1})"
            raise self._reader.resolver.archived(f"what followed transaction {after}{advice}", head)

    # -- what the clock brings about --------------------------------------------------------------------------

    def clock_changes(
        self, repository: Repository, head: Head, last: Transaction, after: int, upto: int
    ) -> list[Change]:
        """What took effect by the clock alone after a time and up to another, by time; `last` was before it."""
        self._reader.resolver.refuse_archived(after + 1, head)
        due: dict[int, list[RecordedAssertion]] = defaultdict(list)
        for row in repository.due_between(after, upto):
            due[row.initial_time].append(row)
        symbol_table = self._reader.symbol_table(repository, head, LogPosition(head.time))
        found = []
        for t in sorted(due):
            ended = self._ended_by_clock(repository, due[t], t)
            asserted = self.as_assertions(repository, due[t], symbol_table)
            found.append(
                Change(last.number, last, asserted, self.as_assertions(repository, ended, symbol_table), [], t)
            )
        return found

    def _ended_by_clock(
        self, repository: Repository, due: Sequence[RecordedAssertion], t: int
    ) -> list[RecordedAssertion]:
        timelines = {row.timeline.id: row.timeline for row in due}
        gone = [row.timeline.id for row in due if row.timeline.kind is KnowledgeType.INSTANCE and row.value[0]]
        if gone:
            timelines |= {timeline.id: timeline for timeline in repository.mentioning(gone)}
        found: list[RecordedAssertion] = []
        for timeline in timelines.values():
            first = repository.latest_start(timeline, t - 1)
            rows = repository.history(timeline.kind, [timeline], first, t)
            found += [row for row in rows if row.end_time == t and row.ended is None and row.cancelled is None]
        return found


def as_transaction(row: Sequence[object]) -> Transaction:
    """A transaction from its row."""
    number, recorded, changes, client, note = row
    return Transaction(number, recorded, client or "", note or "", changes)  # type: ignore[arg-type]


def _overlaps(row: RecordedAssertion, first: int) -> bool:
    return row.end_time > first or (row.initial_time >= first and row.end_time <= row.initial_time)


def _order(row: RecordedAssertion) -> tuple[int, int, int]:
    return row.initial_time, row.recorded, row.timeline.id
