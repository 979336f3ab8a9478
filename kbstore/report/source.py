"""What a report reads: the record of a knowledge base."""

from collections.abc import Iterator
from typing import Protocol

from kbstore.clock import TimeLike
from kbstore.evaluation.intervals import Intervals
from kbstore.model.assertions import Assertions
from kbstore.model.results import AsOf, Change, Run, Transaction
from kbstore.reading.history import Baseline
from kbstore.reading.questions import Knowledge, Question
from kbstore.reading.state import State


class RecordSource(Protocol):
    """A `KnowledgeBase`, as far as reports read it."""

    @property
    def name(self) -> str:
        """The name of the knowledge base."""

    @property
    def use_unknowns(self) -> bool:
        """Whether what is not asserted is unknown, instead of false."""

    @property
    def history_from(self) -> int:
        """The time, in nanoseconds, from which on the history is in the store."""

    def now(self) -> int:
        """Return now, in nanoseconds."""

    def state(self, at: TimeLike | None = None, as_of: AsOf | None = None) -> State:
        """Return the state at a time, as of another."""

    def when(self, condition: Question, since: TimeLike, until: TimeLike, as_of: AsOf | None = None) -> Intervals:
        """Return the intervals in which a condition is true."""

    def history(
        self,
        pattern: Knowledge | None = None,
        since: TimeLike | None = None,
        until: TimeLike | None = None,
        as_of: AsOf | None = None,
    ) -> Assertions:
        """Return the assertions that match a pattern."""

    def runs(
        self,
        pattern: str | None = None,
        since: TimeLike | None = None,
        until: TimeLike | None = None,
        as_of: AsOf | None = None,
    ) -> list[Run]:
        """Return the runs of actions."""

    def transactions(
        self, since: TimeLike | None = None, until: TimeLike | None = None, as_of: AsOf | None = None
    ) -> list[Transaction]:
        """Return the transactions of a span."""

    def changes(self, after: int | Change | Transaction = 0) -> Iterator[Change]:
        """Yield what each transaction after a number changed."""

    def baseline(self, since: TimeLike | None = None, *, most: int | None = None) -> Baseline:
        """Return what held at a time, before the changes after it."""
