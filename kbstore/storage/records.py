"""Rows that the repository reads and writes, as plain values."""

from collections import defaultdict
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from typing import Any, NamedTuple

from kbstore.clock import OPEN
from kbstore.messages import KnowledgeType
from kbstore.model.timelines import EndCause, Timeline, Value


class Head(NamedTuple):
    """The row of a knowledge base that a writer locks: the end of its log.

    Attributes:
        number: the number of the last transaction.
        time: its time, in nanoseconds.
        token: its random token.
        late: the last transaction that recorded late knowledge; 0 if there is none.
        timeline: the number of the last timeline.
        last_run: the number of the last run; 0 if there was none.
        domain_version: the latest version of the domain; 0 if there is none.
        history_from: the time from which on there is history; what was before has been archived.
        present: which kinds of rows there are: one bit for each knowledge type, and one for schedules.
        source: the original that this knowledge base is a copy of; None if it is not a copy.
    """

    number: int
    time: int
    token: int
    late: int
    timeline: int
    last_run: int
    domain_version: int
    history_from: int
    present: int
    source: str | None


class LogPosition(NamedTuple):
    """A position in the log: a time in nanoseconds, or exactly after a transaction (`number`) of that time.

    `latest` is the last transaction of that time.
    """

    time: int
    number: int | None = None
    latest: int | None = None


class StoredAssertion(NamedTuple):
    """A stored assertion as a writer needs it; the first two fields are its key.

    Only scheduled assertions have `recorded_time` and `is_derived`; for others they are None or False.
    """

    recorded_tx: int
    seq: int
    initial_time: int
    end_time: int
    recorded_time: int | None
    is_derived: bool | None
    value: Value


StoredPoint = tuple[Any, ...]
"""The row that answers a question about one timeline at one time; a plain tuple, because each question reads one.

It has `token`, `time`, `history_from`, `domain_version` and `last_run` of the head, then `end_time`, `initial_time` and
the columns of the value of the latest assertion that begins by then. That assertion holds if `end_time` is after the
time that is asked about. If there is none, `end_time` is None.
"""


class KnownAssertion(NamedTuple):
    """A stored assertion that is known now, as late knowledge needs it.

    Attributes:
        ended, cause: the transaction that ended it at its own time, and why.
        first_recorded: the transaction that first recorded it.
    """

    stored: StoredAssertion
    ended: int | None
    cause: int | None
    first_recorded: int


class LateAssertion(NamedTuple):
    """A new assertion about the past: late knowledge, or a part that it has left of another assertion.

    Attributes:
        first_recorded: the transaction that first recorded it; None if that is the one being written.
        ended: the transaction that ended it (None for the one being written) and why; None if it ends by the clock, or
            by the next assertion.
    """

    timeline: Timeline
    initial_time: int
    end_time: int
    value: Value
    first_recorded: int | None
    ended: tuple[int | None, EndCause] | None


class RecordedAssertion(NamedTuple):
    """A stored assertion as history needs it.

    Attributes:
        first_recorded: for a part that late knowledge left of another assertion, the transaction that recorded that
            one; otherwise None.
    """

    timeline: Timeline
    initial_time: int
    end_time: int
    recorded: int
    seq: int
    ended: int | None
    cancelled: int | None
    superseded: int | None
    first_recorded: int | None
    cause: int | None
    value: Value

    @property
    def is_known(self) -> bool:
        """Whether it is neither cancelled nor superseded."""
        return self.cancelled is None and self.superseded is None

    def followed(self, row: "RecordedAssertion") -> bool:
        """Return whether it followed a row when that was recorded; late knowledge may have superseded it since."""
        retired = self.superseded if self.end_time > self.initial_time else self.ended
        return self.cancelled is None and (retired is None or retired > row.recorded)


class RevisionRow(NamedTuple):
    """A change, by the transaction `number`, to a row that was not simply open, and the end that the row had before."""

    number: int
    recorded: int
    seq: int
    end_before: int


class TransactionRows(NamedTuple):
    """The assertions that some transactions recorded, ended, cancelled and superseded."""

    recorded: list[RecordedAssertion]
    ended: list[RecordedAssertion]
    cancelled: list[RecordedAssertion]
    superseded: list[RecordedAssertion]


class RunRow(NamedTuple):
    """A stored run of a durative action.

    Attributes:
        started, duration, end_time: in nanoseconds.
        duration_s: its exact duration in seconds, which `duration` rounds to nanoseconds.
        remembered: the at-start conditions of its later effects that were true.
        forced: the conditions that were overruled at its start.
        outcome: "ended" or "aborted"; None while it runs.
        recorded, ended: the transactions that started and ended it.
    """

    number: int
    operator: str
    arguments: tuple[str, ...]
    started: int
    duration: int
    duration_s: float
    remembered: frozenset[str]
    forced: tuple[str, ...] = ()
    end_time: int = OPEN
    outcome: str | None = None
    recorded: int = 0
    ended: int | None = None


class DomainRow(NamedTuple):
    """A version of the domain: its name, its PDDL text, and its sensed symbols as JSON."""

    name: str
    source: str
    sensed: str


class SymbolRow(NamedTuple):
    """The inferred signature of a symbol in a knowledge base without a domain (rule D2)."""

    knowledge_type: int
    key: str
    name: str
    arity: int
    labels: str


_by_kind: Callable[[], Any] = partial(defaultdict, list)


@dataclass(slots=True)
class RowChanges:
    """The changes of one transaction to the rows of the store.

    Attributes:
        timelines: new timelines; they get their numbers when they are stored.
        touched: stored timelines on which something may change.
        mentions: pairs of an object's timeline and a timeline that mentions the object.
        ends: assertions that end now, each with the cause.
        cancels: scheduled assertions that will not take effect.
        supersedes: assertions that late knowledge replaces; they stay on record as they were.
        settles: assertions whose end, which lies ahead, was derived anew, each with that end.
        rates: scheduled values of functions, each with its new rate by what runs.
        adds: new assertions: timeline, start, end, value.
        derived: new derived assertions: functions that move at another rate from a later time on (rule O5).
        underived: stored derived assertions that are to be deleted.
        late: new assertions about the past.
        late_from: the earliest time about which late knowledge is recorded, in nanoseconds.
        runs: runs that start now.
        ended_runs: runs that end now: number, start and outcome ("ended" or "aborted").
        domain: a new version of the domain.
        symbols: new or changed inferred signatures of symbols.
        last_run: the number of the last run that was started.
        changes: the number of changes that is stored with the transaction.
    """

    timelines: list[Timeline] = field(default_factory=list)
    touched: list[Timeline] = field(default_factory=list)
    mentions: list[tuple[Timeline, Timeline]] = field(default_factory=list)
    ends: dict[KnowledgeType, list[tuple[StoredAssertion, EndCause]]] = field(default_factory=_by_kind)
    cancels: dict[KnowledgeType, list[StoredAssertion]] = field(default_factory=_by_kind)
    supersedes: dict[KnowledgeType, list[StoredAssertion]] = field(default_factory=_by_kind)
    settles: dict[KnowledgeType, list[tuple[StoredAssertion, int]]] = field(default_factory=_by_kind)
    rates: list[tuple[StoredAssertion, float]] = field(default_factory=list)
    adds: dict[KnowledgeType, list[tuple[Timeline, int, int, Value]]] = field(default_factory=_by_kind)
    derived: list[tuple[Timeline, int, int, Value]] = field(default_factory=list)
    underived: list[StoredAssertion] = field(default_factory=list)
    late: dict[KnowledgeType, list[LateAssertion]] = field(default_factory=_by_kind)
    late_from: int | None = None
    runs: list[RunRow] = field(default_factory=list)
    ended_runs: list[tuple[int, int, str]] = field(default_factory=list)
    domain: DomainRow | None = None
    symbols: list[SymbolRow] = field(default_factory=list)
    last_run: int = 0
    changes: int = 0
