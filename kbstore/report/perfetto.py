"""Writes the record as a trace in the Trace Event Format (JSON), which Perfetto and ``chrome://tracing`` show.

A predicate is a process and each of its facts a thread in it, with a slice for each span in which it is true or
explicitly false; an operator is a process, too, with a slice for each run. A number is a counter, with its value at
each corner; viewers draw steps between corners. Transactions are instants. An open slice has no end. Cancelled and
superseded assertions are left out.

The format counts in microseconds, and viewers in doubles: times count from the trace's `origin`, with three decimals,
so that nanoseconds are exact within 104 days.
"""

import json
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

from kbstore.clock import TimeLike
from kbstore.messages import Fact, Function
from kbstore.model.results import AsOf, Assertion, Run, Transaction
from kbstore.names import key
from kbstore.report.relations import end_value, nine_decimals

if TYPE_CHECKING:
    from kbstore.report.source import RecordSource

Place = tuple[int, int]
"""A process and a thread."""


def trace_text(
    kb: "RecordSource",
    since: TimeLike | None = None,
    until: TimeLike | None = None,
    as_of: AsOf | None = None,
) -> str:
    """Return the trace of a span as JSON, an event on each line.

    Args:
        kb: the knowledge base.
        since: the beginning of the span; None: that of the history.
        until: its end; None: no end. A slice that overlaps the span is not cut.
        as_of: a time or a transaction: what was on record then.
    """
    since = kb.history_from if since is None else since
    known = [a for a in kb.history(None, since, until, as_of) if a.cancelled is None and a.superseded is None]
    runs = kb.runs(None, since, until, as_of)
    transactions = kb.transactions(since, until, as_of)
    begins = [a.initial_time for a in known if isinstance(a.item, Fact | Function)]
    begins += [run.started for run in runs] + [tx.time for tx in transactions]
    origin = min(begins, default=kb.now())
    trace = _Trace(origin)
    events = [*trace.transactions(transactions), *trace.runs(runs), *trace.assertions(known)]
    about = json.dumps({"knowledge_base": kb.name, "origin": nine_decimals(origin), "origin_ns": str(origin)})
    lines = ",\n".join([*trace.names(), *events])
    return f'{{"displayTimeUnit":"ns","otherData":{about},"traceEvents":[\n{lines}\n]}}\n'


class _Trace:
    """Makes the events of one trace, and numbers its processes and threads as they occur."""

    def __init__(self, origin: int) -> None:
        self._origin = origin
        self._processes: dict[tuple[str, str], tuple[int, str]] = {}
        self._threads: dict[tuple[int, str], tuple[int, str]] = {}

    def transactions(self, found: list[Transaction]) -> Iterator[str]:
        """Yield an instant for each transaction."""
        for tx in found:
            place = self._place("", "transactions", "transactions")
            by = f" by {tx.client}" if tx.client else ""
            args = {"number": tx.number, "client": tx.client, "note": tx.note, "changes": tx.changes}
            yield self._event("i", tx.time, place, name=f"#{tx.number}{by}", cat="transaction", s="t", args=args)

    def runs(self, found: list[Run]) -> Iterator[str]:
        """Yield a slice for each run, from its start to its end."""
        for run in found:
            place = self._place("action", run.operator, " ".join(run.arguments) or run.operator)
            args = {
                "outcome": run.outcome,
                "expected_end": nine_decimals(run.expected_end),
                "started_tx": run.started_by,
                "ended_tx": run.ended_by,
                "broken": [*map(str, run.broken)],
                "forced": [*run.forced],
            }
            yield self._slice(run.started, run.ended, place, name=run.action, cat="run", args=args)

    def assertions(self, found: list[Assertion]) -> Iterator[str]:
        """Yield a slice for each assertion of a fact, and the corners of numbers."""
        for each in found:
            item = each.item
            if isinstance(item, Fact) and each.end_time != each.initial_time:
                place = self._place("fact", item.attribute_name, " ".join(item.arguments) or item.attribute_name)
                yield self._slice(
                    each.initial_time, each.end_time, place, name=str(item), cat="fact", args=_recorded(each)
                )
            elif isinstance(item, Function) and each.end_time != each.initial_time:
                place = self._process("number", item.attribute_name), 0
                yield self._counter(each.initial_time, place, str(item.atom), item.function_value)
                if item.rate and each.end_time is not None:
                    yield self._counter(each.end_time, place, str(item.atom), end_value(each))

    def names(self) -> Iterator[str]:
        """Yield the names of processes and threads, in the order of their first events."""
        for pid, name in self._processes.values():
            yield self._named("process_name", (pid, 0), name=name)
            yield self._named("process_sort_index", (pid, 0), sort_index=pid)
        for (pid, _), (tid, name) in self._threads.items():
            yield self._named("thread_name", (pid, tid), name=name)
            yield self._named("thread_sort_index", (pid, tid), sort_index=tid)

    def _process(self, kind: str, name: str) -> int:
        """Return the number of a process; a predicate and an operator of one name are two processes."""
        shown = f"{name} ({kind})" if kind else name
        return self._processes.setdefault((kind, key(name)), (len(self._processes) + 1, shown))[0]

    def _place(self, kind: str, name: str, thread: str) -> Place:
        pid = self._process(kind, name)
        return pid, self._threads.setdefault((pid, key(thread)), (len(self._threads) + 1, thread))[0]

    def _slice(self, start: int, end: int | None, place: Place, **fields: Any) -> str:
        if end is None:
            # an open slice is a beginning without an end
            return self._event("B", start, place, **fields)
        return self._event("X", start, place, duration=end - start, **fields)

    def _counter(self, t: int, place: Place, name: str, value: float | None) -> str:
        return self._event("C", t, place, name=name, cat="number", args={"value": value})

    def _event(self, phase: str, t: int, place: Place, duration: int | None = None, **fields: Any) -> str:
        """Write an event as JSON; its times are written as text, as doubles would round them."""
        times = f'"ts":{_microseconds(t - self._origin)}'
        if duration is not None:
            times += f',"dur":{_microseconds(duration)}'
        rest = json.dumps({"ph": phase, "pid": place[0], "tid": place[1], **fields}, separators=(",", ":"))
        return f"{{{times},{rest[1:]}"

    def _named(self, what: str, place: Place, **args: Any) -> str:
        event = {"ph": "M", "ts": 0, "pid": place[0], "tid": place[1], "name": what, "args": args}
        return json.dumps(event, separators=(",", ":"))


def _microseconds(ns: int) -> str:
    """Write nanoseconds as microseconds, exactly, negative ones, too.

    >>> _microseconds(1_000_001), _microseconds(-1), _microseconds(2_000)
    ('1000.001', '-0.001', '2')
    """
    whole, rest = divmod(abs(ns), 1000)
    return f"{'-' if ns < 0 else ''}{whole}{f'.{rest:03d}' if rest else ''}"


def _recorded(found: Assertion) -> dict[str, Any]:
    by, ended = found.recorded, found.ended
    return {
        "recorded_tx": by.number,
        "recorded_client": by.client,
        "recorded_note": by.note,
        "ended_tx": None if ended is None else ended.number,
        "ended_client": None if ended is None else ended.client,
    }
