"""Collects the data of a timeline: lanes, rows, runs, and the transactions that made them.

A row is one assertion: ``[lane, initial, end, from, gone, ended, how, value, rate]``. Times are nanoseconds after the
data's `origin`. The row is known from the transaction `from` on, until the transaction `gone` cancelled it (`how` 1) or
superseded it (`how` 2); `gone` is 0 if none did. `ended` is the transaction that ended it, or scheduled its end; 0
while it is open. `value` is 1 or 0 for an asserted or an explicitly false fact, and the number at `initial` for a
function; `rate` is per second, or an object's type. A scheduled number may have a tenth place: the recorded rate, if an
action moves the number at another one when its time comes.

The state at any time, as of any transaction, follows from these rows by the rules V1, C9 and Q2. The expected effects
of running actions do not: they are rows of their own, `expected`, each for the one transaction after which it was
expected, in order.
"""

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any

from kbstore.clock import OPEN
from kbstore.errors import KbStoreError
from kbstore.messages import Function, Instance, KnowledgeType
from kbstore.model.results import Assertion, Change, Run, Transaction
from kbstore.model.timelines import Timeline, Value
from kbstore.names import bracketed, key
from kbstore.reading.state import State
from kbstore.report.timeline.lanes import Lanes

if TYPE_CHECKING:
    from kbstore.report.source import RecordSource

Row = list[Any]

EXPECTATIONS = 300
"""The number of transactions, the latest ones, for which the expected effects of running actions are computed."""

CANCELLED, SUPERSEDED = 1, 2


def timeline_data(
    kb: "RecordSource",
    patterns: Sequence[str] = (),
    *,
    since: int | None = None,
    until: int | None = None,
    as_of: Transaction | int | None = None,
    expectations: int = EXPECTATIONS,
    most: int | None = None,
) -> dict[str, Any]:
    """Collect a knowledge base's history for a timeline.

    Args:
        kb: the knowledge base.
        patterns: only the lanes that match one of these: ``(robot_at kenny ?)``, or a word for everything with that
            symbol or object, and the objects themselves; all lanes if there are none.
        since: the beginning of the span, in nanoseconds; None, or an earlier time: that of the history in the store.
        until: its end; None: the last time about which something is known, or now if that is soon after it.
        as_of: a transaction, or a time in nanoseconds, whose belief is shown first; None: what is known now.
        expectations: the number of transactions for which to compute the expected effects of running actions.
        most: the most transactions to show, the latest ones, if `since` is None; None: all.
    """
    return _Collector(kb, patterns, since, until, most).data(as_of, expectations)


class _Collector:
    """Collects the data of one timeline."""

    def __init__(
        self,
        kb: "RecordSource",
        patterns: Sequence[str],
        since: int | None,
        until: int | None,
        most: int | None,
    ) -> None:
        self._kb = kb
        self._lanes = Lanes(patterns)
        self._now = kb.now()
        # assertions that were over for good by then are not shown
        baseline = kb.baseline(since, most=most)
        self._base = baseline.number
        self._changes = list(kb.changes(self._base))
        self._asserted = [(found, found.recorded.number) for found in baseline.assertions]
        self._asserted += [(found, change.number) for change in self._changes for found in change.asserted]
        self._runs = kb.runs()
        self._transactions = self._known()
        self._latest = max((tx.number for tx in self._transactions), default=0)
        self._first = baseline.time or min([self._now, *map(_begin, self._changes)])
        self._last = self._until() if until is None else until
        self._scheduled_by: dict[int, dict[tuple[str, int], float]] = {}

    def _known(self) -> list[Transaction]:
        """Return the transactions of the span, and earlier ones to which its assertions refer."""
        found = {change.number: change.transaction for change in self._changes}
        for assertion, _ in self._asserted:
            for transaction in (assertion.recorded, assertion.ended, assertion.cancelled, assertion.superseded):
                if transaction is not None:
                    found.setdefault(transaction.number, transaction)
        return [found[number] for number in sorted(found)]

    def data(self, as_of: Transaction | int | None, expectations: int) -> dict[str, Any]:
        """Return all data, with the lanes in the order in which they occur."""
        runs = [row for run in self._runs if (row := self._run(run)) is not None]
        rows = [row for found, number in (*self._asserted, *self._derived()) if (row := self._row(found, number))]
        reached = list(self._reached())
        asked = self._latest_asked(expectations)
        expected = [row for number, state in asked for row in self._expected(number, state)]
        return {
            "name": self._kb.name,
            "closed": not self._kb.use_unknowns,
            "origin": str(self._first),
            "until": self._last - self._first,
            "now": self._now - self._first,
            "base": self._base,
            "latest": self._latest,
            "as_of": self._number(as_of),
            "known_from": max(1, self._latest + 1 - expectations),
            "transactions": [[tx.number, tx.time - self._first, tx.client, tx.note] for tx in self._transactions],
            "groups": self._lanes.groups,
            "lanes": self._lanes.described,
            "rows": rows,
            "runs": runs,
            "expected": expected,
            "reached": reached,
        }

    def _number(self, as_of: Transaction | int | None) -> int | None:
        """Return the number of the transaction whose belief is meant; None for now."""
        if as_of is None or isinstance(as_of, Transaction):
            return None if as_of is None else as_of.number
        if as_of >= self._now:
            return None
        return max((tx.number for tx in self._transactions if tx.time <= as_of), default=self._base)

    def _until(self) -> int:
        """Return the last time about which something is known, or now if that is soon after it."""
        last = max([self._first, *self._times()])
        return self._now if last < self._now <= last + (last - self._first) else last

    def _times(self) -> Iterator[int]:
        """Yield the times at which something happened, is scheduled, or is expected to end."""
        yield from (change.transaction.time for change in self._changes)
        yield from (found.initial_time for found, _ in self._asserted)
        yield from (run.expected_end for run in self._runs)

    # -- what is recorded -------------------------------------------------------------------------------------

    def _derived(self) -> Iterator[tuple[Assertion, int]]:
        """Yield the numbers that follow running actions by the clock (rule O5): no transaction's changes list them."""
        if not self._runs:
            return
        numbers = [found for found, _ in self._asserted if isinstance(found.item, Function) and not found.is_goal]
        known = set(map(_identity, numbers))
        patterns = {bracketed(key(f.attribute_name), *"?" * len(f.arguments)) for f in map(_function, numbers)}
        for pattern in sorted(patterns):
            found = self._kb.history(pattern, self._first if self._base else None)
            yield from ((f, f.recorded.number) for f in found if _identity(f) not in known)

    def _row(self, found: Assertion, number: int) -> Row | None:
        gone, how = (found.superseded, SUPERSEDED) if found.superseded is not None else (found.cancelled, CANCELLED)
        ended = 0 if found.ended is None or found.end_time is None else found.ended.number
        is_over = found.end_time is not None and found.end_time < self._first and ended <= self._base
        if found.initial_time > self._last or is_over or (gone is not None and gone.number < self._base):
            return None
        lane = self._lanes.of_assertion(found)
        if lane is None:
            return None
        item = found.item
        value: Any = int(not getattr(item, "is_negative", False))
        rate: Any = 0
        if isinstance(item, Function) and not found.is_goal:
            value, rate = item.function_value, item.rate
        elif isinstance(item, Instance):
            rate = item.instance_type
        end = None if found.end_time is None else found.end_time - self._first
        by = (number, 0 if gone is None else gone.number, ended, 0 if gone is None else how)
        return [lane, found.initial_time - self._first, end, *by, value, rate, *self._recorded_rate(found, number)]

    def _recorded_rate(self, found: Assertion, number: int) -> Iterator[float]:
        """Yield the rate that was scheduled for a number, if an action that ran at its time may have changed it."""
        t = found.initial_time
        if not isinstance(found.item, Function) or found.is_goal or t <= found.recorded.time:
            return
        if any(run.started <= t and (run.ended is None or run.ended >= found.recorded.time) for run in self._runs):
            if number not in self._scheduled_by:
                # a schedule from before the span is read at the span's beginning, as it was known then
                is_within = found.recorded.time >= self._first
                at, belief = (found.recorded.time, found.recorded) if is_within else (self._first, self._first)
                state = self._kb.state(at, as_of=belief)
                items = [item for item in state.timed_knowledge if isinstance(item, Function)]
                self._scheduled_by[number] = {(str(item.atom), item.initial_time): item.rate for item in items}
            rate = self._scheduled_by[number].get((str(found.item.atom), t))
            if rate is not None:
                yield rate

    def _run(self, run: Run) -> Row | None:
        if run.started > self._last or (run.ended is not None and run.ended < self._first):
            return None
        lane = self._lanes.of_run(run)
        if lane is None:
            return None
        broken = [
            [found.condition, found.since - self._first, None if found.until is None else found.until - self._first]
            for found in run.broken
        ]
        times = (run.started, run.expected_end, run.ended)
        relative = [None if t is None else t - self._first for t in times]
        return [lane, *relative, run.outcome, run.started_by, run.ended_by or 0, broken]

    def _reached(self) -> Iterator[Row]:
        """Yield the intervals in which each goal was true, as known now."""
        goals = {str(found.item): found for found, _ in self._asserted if found.is_goal}
        for text, found in goals.items():
            lane = self._lanes.of_assertion(found)
            if lane is None:
                continue
            try:
                spans = self._kb.when(text, self._first, max(self._first, min(self._last, self._now)))
            except KbStoreError:
                # the goal cannot be decided throughout the span: a moving product, a domain without its predicate
                continue
            yield [
                lane,
                [[start - self._first, None if end >= self._now else end - self._first] for start, end in spans],
            ]

    # -- what is expected -------------------------------------------------------------------------------------

    def _latest_asked(self, count: int) -> list[tuple[int, State]]:
        """Return now and the latest transactions during which an action ran, each with the state then."""
        asked = [(self._latest + 1, self._kb.state())]
        for transaction in self._transactions[::-1][:count]:
            number, t = transaction.number, transaction.time
            if t >= self._first and any(
                run.started_by <= number and (run.ended_by is None or run.ended_by > number) for run in self._runs
            ):
                asked.append((number, self._kb.state(t, as_of=transaction)))
        return asked

    def _expected(self, number: int, state: State) -> Iterator[Row]:
        """Yield what was expected after a transaction, from the first effect of a running action on.

        This includes later scheduled knowledge, which may take effect otherwise than recorded: at another rate, or not
        at all.
        """
        if not state.running:
            return
        events = list(state.projection().advance(min(self._last, OPEN - 1)))
        is_number = KnowledgeType.FUNCTION
        cut = min((e.time for e in events if e.run is not None or e.timeline.kind is is_number), default=OPEN)
        for event in events:
            lane = self._lanes.of_timeline(event.timeline) if event.time >= cut else None
            if lane is not None:
                value = _value(event.timeline, event.value)
                yield [lane, event.time - self._first, None, number, number + 1, 0, 0, *value]


def _begin(change: Change) -> int:
    """Return the first time that a transaction is about: its own, or that of late knowledge."""
    return min([change.transaction.time, *(found.initial_time for found in change.asserted)])


def _function(found: Assertion) -> Function:
    assert isinstance(found.item, Function)
    return found.item


def _identity(found: Assertion) -> tuple[str, int, int | None, int]:
    return str(_function(found).atom), found.initial_time, found.end_time, found.recorded.number


def _value(timeline: Timeline, value: Value | None) -> tuple[Any, Any]:
    """Return the value and rate of a row, from a timeline's value; the value is None if nothing holds any more."""
    if value is None:
        return None, 0
    if timeline.kind is KnowledgeType.FUNCTION:
        return value[1], value[3]
    return int(not value[0]), value[1] if timeline.kind is KnowledgeType.INSTANCE else 0
