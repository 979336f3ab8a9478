"""Follows a condition: its truth now, and each change of it as it happens (rule Q9)."""

from collections.abc import Iterator, Sequence
from itertools import pairwise

from kbstore.evaluation.evaluator import Evaluation
from kbstore.messages import Truth
from kbstore.model.formulas import Formula, Not
from kbstore.model.results import Transaction
from kbstore.reading.history import History
from kbstore.reading.questions import Question
from kbstore.reading.reader import Reader
from kbstore.reading.resolver import TemporalPoint
from kbstore.reading.trajectory import when_true
from kbstore.reading.watching import Watch
from kbstore.storage.records import LogPosition
from kbstore.storage.repository import Repository

TruthChange = tuple[int, Truth, Transaction | None]
"""A time in nanoseconds, the truth from then on, and the transaction that changed it; None if the clock alone did."""

Piece = tuple[int, Truth]
"""A time in nanoseconds, and the truth from then on."""


class ConditionWatch(Watch[TruthChange]):
    """Iterates over the truth of one condition, from now on.

    Raises what `KnowledgeBase.truth` raises; also during the iteration, if the condition cannot be answered any more.
    """

    def __init__(
        self,
        reader: Reader,
        history: History,
        condition: Question,
        *,
        poll: float,
        timeout: float | None = None,
        deadline: float | None = None,
    ) -> None:
        super().__init__(poll=poll, timeout=timeout, deadline=deadline)
        self._reader = reader
        self._history = history
        self._condition = condition
        with reader.repository() as repository:
            now = reader.resolver.resolve(repository)
            self._formula = self._as_formula(repository, now)
            self._number = now.head.number
            self._seen = now.valid_time
            self._truth = self._pieces(repository, self._seen, self._seen + 1)[0][1]
        self._found.append((self._seen, self._truth, None))

    def _look(self) -> bool:
        with self._reader.repository() as repository:
            now = self._reader.resolver.resolve(repository)
            time, number = now.valid_time, now.head.number
            if time != self._seen or number != self._number:
                self._formula = self._as_formula(repository, now)
                numbers = range(self._number + 1, number + 1)
                found = self._history.transactions(repository, numbers) if numbers else {}
                new = [found[number] for number in numbers]
                is_late = now.head.late > self._number
                pieces = self._believed(repository, time + 1, new if is_late else ())
                self._found.extend(self._changes(repository, pieces, new))
                self._seen, self._number, self._truth = time, number, pieces[-1][1]
        return True

    def _as_formula(self, repository: Repository, now: TemporalPoint) -> Formula:
        """Read the condition under the domain in force. Raises `UnknownSymbol` if a new version lacks a symbol."""
        symbols = self._reader.symbols_at(repository, now)
        return self._reader.questions.condition(self._condition, symbols).formula

    def _changes(
        self, repository: Repository, pieces: Sequence[Piece], new: Sequence[Transaction]
    ) -> Iterator[TruthChange]:
        """Yield the changes of the truth within pieces that begin where the last look ended."""
        truth = self._truth
        for time, value in pieces:
            if value is not truth:
                truth = value
                yield time, value, self._cause(repository, time, value, [tx for tx in new if tx.time == time])

    def _cause(
        self, repository: Repository, time: int, truth: Truth, transactions: Sequence[Transaction]
    ) -> Transaction | None:
        """Return the last of some transactions of `time` before which another truth was believed; None if none is."""
        for transaction in reversed(transactions):
            before = repository.after_transaction(transaction.number - 1, time)
            if self._truth_as_of(repository, before) is not truth:
                return transaction
        return None

    def _truth_as_of(self, repository: Repository, position: LogPosition) -> Truth:
        point = self._reader.resolver.at_position(repository.head(), position)
        state = self._reader.state(repository, point)
        return Evaluation(state.snapshot).truth(self._formula)

    def _believed(self, repository: Repository, until: int, new: Sequence[Transaction]) -> list[Piece]:
        """Return the truth since the last look; at each time, as it was believed at that time (rule L7).

        `new` are the transactions since then, if late knowledge is among them.
        """
        times = sorted({self._seen, *(transaction.time for transaction in new), until})
        found: list[Piece] = []
        for since, end in pairwise(times):
            found += self._pieces(repository, since, end, None if end == until else end - 1)
        return found

    def _pieces(self, repository: Repository, since: int, until: int, as_of: int | None = None) -> list[Piece]:
        """Return the truth throughout a span: each time at which it changes, and the truth from then on."""
        found: dict[int, Truth] = {since: Truth.UNKNOWN}
        for formula, truth in ((self._formula, Truth.TRUE), (Not(self._formula), Truth.FALSE)):
            for start, end in when_true(self._reader, repository, formula, since, until, as_of):
                found[start] = truth
                if end < until:
                    found.setdefault(end, Truth.UNKNOWN)
        return sorted(found.items())
