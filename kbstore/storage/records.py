"""Rows that the repository reads and writes, as plain values."""

from collections import defaultdict
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from typing import Any, NamedTuple

from kbstore.clock import OPEN
from kbstore.messages import KnowledgeType
from kbstore.model.timelines import EndCause, Timeline, Value

StateRow = tuple[Timeline, int, Value]
"""An assertion that holds, or is scheduled: its timeline, since when (or from when), and its value."""


class Head(NamedTuple):
    """The row of a knowledge base that a writer locks: the end of its log.

    Attributes:
        token: the random number of the last transaction.
        late: the last transaction that recorded late knowledge; 0 if there is none.
        timeline: the number of the last timeline.
        present: which kinds of rows there are, one bit for each knowledge type, and one for schedules.
        source: the store that this one follows; None where this one is written to.
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
    """A position in the record: a time, or exactly after a transaction (`number`) of that time.

    `latest` is the last transaction of that time.
    """

    time: int
    number: int | None = None
    latest: int | None = None


class StoredAssertion(NamedTuple):
    """A stored assertion as a writer needs it. The first two are its key.

    `recorded_time` and `is_derived` are for what lies ahead.
    """

    recorded_tx: int
    seq: int
    initial_time: int
    end_time: int
    recorded_time: int | None
    is_derived: bool | None
    value: Value


StoredPoint = tuple[Any, ...]
"""The row that answers a question about one timeline at one time, as of one commit; plain, as each question reads one.

`token`, `time`, `history_from`, `domain_version` and `last_run` of the head; then of the latest assertion that begins
no later `end_time`, `initial_time`, and the columns of its value. It holds if `end_time` is after the time that is
asked about. Where there is none, `end_time` is None.
"""


class KnownAssertion(NamedTuple):
    """A stored assertion that is part of what is known now, as late knowledge needs it.

    Attributes:
        ended, cause: the transaction that ended it at its own time, and why.
        told: the transaction that first recorded it.
    """

    stored: StoredAssertion
    ended: int | None
    cause: int | None
    told: int


class LateAssertion(NamedTuple):
    """A new assertion about the past: late knowledge, or what it has left of another.

    Attributes:
        told: the transaction that first recorded it; None where that is this one.
        ended: the transaction that ended it, None for this one, and why; None where it ends by what follows.
    """

    timeline: Timeline
    initial_time: int
    end_time: int
    value: Value
    told: int | None
    ended: tuple[int | None, EndCause] | None


class RecordedAssertion(NamedTuple):
    """A stored assertion as history needs it.

    Attributes:
        told: of a part that late knowledge left of another assertion, the transaction that first recorded it.
    """

    timeline: Timeline
    initial_time: int
    end_time: int
    recorded: int
    seq: int
    ended: int | None
    cancelled: int | None
    superseded: int | None
    told: int | None
    cause: int | None
    value: Value

    @property
    def is_known(self) -> bool:
        """Whether it is neither cancelled nor superseded."""
        return self.cancelled is None and self.superseded is None

    def followed(self, row: "RecordedAssertion") -> bool:
        """Return whether it followed a row when that was recorded; late knowledge may have taken it away since then."""
        retired = self.superseded if self.end_time > self.initial_time else self.ended
        return self.cancelled is None and (retired is None or retired > row.recorded)


class RevisionRow(NamedTuple):
    """That a transaction has changed a row that was not simply open until then, and when the row had ended before."""

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
        duration_s: its exact duration in seconds, of which `duration` is the rounding to nanoseconds.
        remembered: the conditions at its start that its later effects depend on, and that were true.
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
    """A version of the domain: its name, its PDDL text, and what is sensed as JSON."""

    name: str
    source: str
    sensed: str


class SymbolRow(NamedTuple):
    """The shape of a symbol in a knowledge base without a domain (rule D2)."""

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
        timelines: those that are new; they get their numbers when they are stored.
        touched: those that are stored, and on which something may change.
        mentions: which timeline of an object is mentioned by which timeline.
        ends: what ends now, and why.
        cancels: what was scheduled and will not take effect.
        supersedes: what late knowledge has changed; it stays on record as it was.
        settles: what gets another end that lies ahead.
        rates: scheduled values of functions whose rates change by what runs.
        adds: new assertions, each with its timeline, when it begins and ends, and its value.
        derived: functions that move at another rate from a later time on, by what their rates read (rule O5).
        underived: what had been derived for later times, and is not any more.
        late: new assertions about the past.
        late_from: the earliest time about which late knowledge is recorded.
        runs: those that start now.
        ended_runs: those that end now: number, start and outcome ("ended" or "aborted").
        domain: a new version of the domain.
        symbols: new shapes of symbols.
        last_run: the number of the last run that was started.
        changes: how many changes the transaction is said to have.
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
