"""The record of a knowledge base: histories of timelines, changes of transactions, what the clock brought about."""

from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence

from kbstore.clock import OPEN, TimeLike
from kbstore.errors import UnknownSymbol
from kbstore.messages import KnowledgeType
from kbstore.model.results import Assertion, Assertions, Change, Transaction
from kbstore.model.symbols import SymbolTable
from kbstore.model.timelines import Role
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
"""How many transactions `changes` reads at once."""


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
                for row in repository.history(wanted.kind, wanted.timelines(repository), first, last)
                if wanted.matches_row(row) and _overlaps(row, first)
            ]
            rows.sort(key=_order)
            return Assertions(self.as_assertions(repository, rows, symbol_table))

    def _symbols(self, repository: Repository, now: TemporalPoint, pattern: Knowledge, until: int) -> SymbolTable:
        """Return the latest symbols among which the pattern's is known (rule D4)."""
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
        ends = self.enders(repository, rows)
        numbers = {row.recorded for row in rows} | {row.cancelled for row in rows} | set(ends)
        transactions = self.transactions(repository, {number for number in numbers if number is not None})
        reader = ItemFactory(symbol_table)
        found = []
        for row, ended in zip(rows, ends, strict=True):
            cancelled = row.cancelled
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
    def enders(repository: Repository, rows: Sequence[RecordedAssertion]) -> list[int | None]:
        """For each row the transaction that ended it, or scheduled what ends it; None for one that has no end."""
        by_clock = [row for row in rows if row.ended is None and row.cancelled is None and row.end_time != OPEN]
        ends = {(row.timeline.id, row.end_time): (row.timeline, row.end_time) for row in by_clock}
        # of several that begin then, the first to take effect ended it: what was scheduled before what was told
        following: dict[tuple[int, int], int] = {}
        for found in repository.beginning_at(ends.values()):
            if found.cancelled is None:
                end = found.timeline.id, found.initial_time
                following[end] = min(found.recorded, following.get(end, found.recorded))
        # else an object did
        left = [row for row in by_clock if (row.timeline.id, row.end_time) not in following]
        mentioned = {id(row): mentions(row.timeline, row.value) for row in left}
        names = list(dict.fromkeys(name for found in mentioned.values() for name in found))
        objects = repository.find(Role.STATE, KnowledgeType.INSTANCE, names) if names else {}
        ends_of = dict.fromkeys((name, row.end_time) for row in left for name in mentioned[id(row)] if name in objects)
        gone: dict[tuple[str, int], int] = {}
        for found in repository.beginning_at((objects[name], t) for name, t in ends_of):
            if found.cancelled is None and found.value[0]:
                end_of = found.timeline.key, found.initial_time
                gone[end_of] = min(found.recorded, gone.get(end_of, found.recorded))

        def ender(row: RecordedAssertion) -> int | None:
            if row.ended is not None or row.cancelled is not None or row.end_time == OPEN:
                return row.ended
            follower = following.get((row.timeline.id, row.end_time))
            if follower is not None:
                return follower
            ended = [gone.get((name, row.end_time)) for name in mentioned[id(row)]]
            return min((number for number in ended if number is not None), default=None)

        return [ender(row) for row in rows]

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
        if after > head.number:
            raise went_back(self._reader.name, after, head.number)
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
        if not due:
            return []
        symbol_table = self._reader.symbol_table(repository, head, LogPosition(head.time))
        ended = self._ended_by_clock(repository, due)
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
        repository: Repository, due: Mapping[int, Sequence[RecordedAssertion]]
    ) -> dict[int, list[RecordedAssertion]]:
        """What ended as something took effect, by time: on its own timeline, or by the end of an object."""
        points = {(row.timeline.id, t): (row.timeline, t) for t, rows in due.items() for row in rows}
        gone: dict[int, set[str]] = {
            t: {row.timeline.key for row in rows if row.timeline.kind is KnowledgeType.INSTANCE and row.value[0]}
            for t, rows in due.items()
        }
        objects = {row.timeline.id for t, rows in due.items() for row in rows if row.timeline.key in gone[t]}
        mentioning = repository.mentioning(list(objects)) if objects else []
        points |= {(line.id, t): (line, t) for t, names in gone.items() if names for line in mentioning}
        found: dict[int, list[RecordedAssertion]] = defaultdict(list)
        for row in repository.latest_before(points.values()):
            if row.ended is None and row.cancelled is None and (row.timeline.id, row.end_time) in points:
                found[row.end_time].append(row)
        return found


def as_transaction(row: Sequence[object]) -> Transaction:
    """A transaction from its row."""
    number, recorded, changes, client, note = row
    return Transaction(number, recorded, client or "", note or "", changes)  # type: ignore[arg-type]


def _overlaps(row: RecordedAssertion, first: int) -> bool:
    return row.end_time > first or (row.initial_time >= first and row.end_time <= row.initial_time)


def _order(row: RecordedAssertion) -> tuple[int, int, int]:
    return row.initial_time, row.recorded, row.timeline.id
