"""Exports the record as an MCAP file of JSON messages, for Foxglove and Lichtblick. Needs the extra `bags`.

The State Transitions panel shows ``/facts/robot_at/kenny.value``, ``/runs/drive/kenny.value`` and
``/objects/kenny.value``; the Plot panel ``/numbers/battery/kenny.value``. A topic is of a predicate, a function or an
operator and its first argument, and its value is what the other arguments are meanwhile: where kenny is. A number has
its value at each corner, twice where it jumps, so that the lines between them are exact. The panels draw a state up to
the next message, so the last one is repeated at the end. What was cancelled or superseded is left out.
"""

import json
import os
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from kbstore.clock import TimeLike, time
from kbstore.errors import MissingLibrary
from kbstore.knowledge_base import KnowledgeBase
from kbstore.messages import Fact, Function, Instance
from kbstore.model.plain import Data, Result, times
from kbstore.model.results import AsOf, Assertion, Run, Transaction
from kbstore.names import key
from kbstore.report.relations import end_value
from kbstore.transfer.rows import new_file

try:
    from mcap.writer import Writer
except ImportError as error:
    raise MissingLibrary(
        f"MCAP files need the library mcap, which cannot be imported ({error});"
        " install it with: pip install 'kbstore[bags]'"
    ) from None

TEXT, NUMBER, FLAG, INTEGER = ({"type": name} for name in ("string", "number", "boolean", "integer"))

SCHEMAS = {
    "Fact": {"value": TEXT, "facts": {"type": "array", "items": TEXT}},
    "Number": {"value": NUMBER, "defined": FLAG},
    "Run": {"value": TEXT, "action": TEXT, "outcome": TEXT, "started_by": INTEGER, "ended_by": INTEGER},
    "Object": {"value": TEXT, "exists": FLAG},
    "Transaction": {"value": INTEGER, "client": TEXT, "note": TEXT, "changes": INTEGER},
}
"""The fields of each kind of message."""


@dataclass(frozen=True, slots=True)
class McapMessage:
    """A message: its time in nanoseconds, its topic, the name of its schema, and its fields."""

    time: int
    topic: str
    schema: str
    fields: dict[str, Any]


@dataclass(frozen=True)
class Exported(Result):
    """The result of an export: the numbers of messages and topics, and their times; None where there are none."""

    messages: int
    topics: int
    since: int | None
    until: int | None

    def to_dict(self) -> Data:
        """Return it as plain data for JSON."""
        return {"messages": self.messages, "topics": self.topics, **times(since=self.since, until=self.until)}


def export_mcap(
    kb: KnowledgeBase,
    path: str | os.PathLike[str],
    since: TimeLike | None = None,
    until: TimeLike | None = None,
    as_of: AsOf | None = None,
) -> Exported:
    """Write the record of a span to a new file, completely or not at all.

    Args:
        kb: the knowledge base.
        path: the file, which is not there yet.
        since: the begin of the span; None: that of the history. What holds there already is written for that time.
        until: its end; None: the last time of which something is known.
        as_of: a time or a transaction: what was on record then.

    Raises:
        InvalidKnowledge: there is such a file.
        StoreUnavailable: it cannot be written.
        HistoryUnavailable: the begin of the span has been archived.
    """
    events = sorted(_Record(kb, since, until, as_of).events(), key=lambda event: event.time)
    with new_file(Path(path)) as partial, partial.open("wb") as file:
        writer: Any = Writer(file)
        writer.start(profile="", library="kbstore")
        schemas, channels = dict[str, int](), dict[str, int]()
        for number, event in enumerate(events):
            if event.topic not in channels:
                if event.schema not in schemas:
                    schemas[event.schema] = writer.register_schema(
                        f"kbstore.{event.schema}", "jsonschema", _schema(event)
                    )
                channels[event.topic] = writer.register_channel(event.topic, "json", schemas[event.schema])
            data = json.dumps(event.fields, ensure_ascii=False).encode()
            writer.add_message(channels[event.topic], event.time, data, event.time, number)
        writer.finish()
    span = (events[0].time, events[-1].time) if events else (None, None)
    return Exported(len(events), len(channels), *span)


def _schema(event: McapMessage) -> bytes:
    schema = {"title": f"kbstore.{event.schema}", "type": "object", "properties": SCHEMAS[event.schema]}
    return json.dumps(schema).encode()


class _Record:
    """The record of a span, as events in no order of time; those of one topic and time are in order."""

    def __init__(self, kb: KnowledgeBase, since: TimeLike | None, until: TimeLike | None, as_of: AsOf | None) -> None:
        now = kb.now()
        first = kb.history_from if since is None else time(since, now)
        last = None if until is None else time(until, now)
        self._known = [
            found
            for found in kb.history(None, first, last, as_of)
            if found.cancelled is None and found.superseded is None and found.end_time != found.initial_time
        ]
        self._runs = kb.runs(None, first, last, as_of)
        self._transactions = kb.transactions(first, last, as_of)
        times = [found.initial_time for found in self._known] + [found.end_time or 0 for found in self._known]
        times += [run.started for run in self._runs] + [run.ended or 0 for run in self._runs]
        times += [found.time for found in self._transactions]
        self._first = first
        self._last = max(times, default=first) if last is None else last

    def events(self) -> Iterator[McapMessage]:
        """Yield all events of the span."""
        yield from map(_transaction, self._transactions)
        yield from self._numbers([found for found in self._known if isinstance(found.item, Function)])
        spans = [*self._facts(), *self._objects(), *self._running()]
        by_topic: dict[str, list[_Span]] = {}
        for span in spans:
            by_topic.setdefault(key(span.topic), []).append(span)
        for found in by_topic.values():
            yield from self._states(found)

    def _facts(self) -> Iterator["_Span"]:
        for found in self._known:
            item = found.item
            if isinstance(item, Fact):
                yield _Span(_topic("facts", item.attribute_name, item.arguments), *self._within(found), "Fact", item)

    def _objects(self) -> Iterator["_Span"]:
        for found in self._known:
            item = found.item
            if isinstance(item, Instance) and not item.is_negative:
                yield _Span(f"/objects/{item.instance_name}", *self._within(found), "Object", item)

    def _running(self) -> Iterator["_Span"]:
        for run in self._runs:
            start = max(run.started, self._first)
            end = None if run.ended is None or run.ended > self._last else run.ended
            yield _Span(_topic("runs", run.operator, run.arguments), start, end, "Run", run)

    def _within(self, found: Assertion) -> tuple[int, int | None]:
        """Return the start of an assertion within the span, and its end; None if it is open, or after the span."""
        end = found.end_time
        return max(found.initial_time, self._first), None if end is None or end > self._last else end

    def _states(self, spans: Sequence["_Span"]) -> Iterator[McapMessage]:
        """A message at each change of a topic's value, and at the end of the record."""
        changes: dict[int, list[tuple[bool, _Span]]] = {}
        for span in spans:
            changes.setdefault(span.start, []).append((True, span))
            if span.end is not None:
                changes.setdefault(span.end, []).append((False, span))
        holding: list[_Span] = []
        for t, found in sorted(changes.items()):
            ended = [span for begins, span in found if not begins]
            holding = [span for span in holding if span not in ended]
            holding += [span for begins, span in found if begins and span not in ended]
            last = McapMessage(t, spans[0].topic, spans[0].schema, _FIELDS[spans[0].schema](holding, ended))
            yield last
        if last.time < self._last:
            yield replace(last, time=self._last)

    def _numbers(self, known: Iterable[Assertion]) -> Iterator[McapMessage]:
        """The corners of numbers: where an assertion begins, and where it ends."""
        by_topic: dict[str, list[Assertion]] = {}
        for found in known:
            item = found.item
            assert isinstance(item, Function)
            by_topic.setdefault(_number_topic(item), []).append(found)
        for topic, line in by_topic.items():
            for index, found in enumerate(line):
                start, end = self._within(found)
                yield _number(start, topic, _value(found, start))
                last = self._last if end is None else end
                if last > start:
                    yield _number(last, topic, _value(found, last))
                follows = index + 1 < len(line) and line[index + 1].initial_time == end
                if end is not None and not follows:
                    yield _number(end, topic, None)


@dataclass(frozen=True, slots=True, eq=False)
class _Span:
    """The value of a topic from `start` until `end`; None: to the end of the record."""

    topic: str
    start: int
    end: int | None
    schema: str
    what: Any


def _topic(kind: str, name: str, arguments: Sequence[str]) -> str:
    """Return the topic of a symbol and its first argument."""
    return "/".join(("", kind, name, *arguments[:1]))


def _number_topic(item: Function) -> str:
    return "/".join(("", "numbers", item.attribute_name, *item.arguments))


def _value(found: Assertion, t: int) -> float | None:
    return end_value(Assertion(found.item, found.initial_time, t, found.recorded))


def _number(t: int, topic: str, value: float | None) -> McapMessage:
    fields: dict[str, Any] = {"defined": False} if value is None else {"value": value, "defined": True}
    return McapMessage(t, topic, "Number", fields)


def _fact_fields(holding: Sequence[_Span], _ended: Sequence[_Span]) -> dict[str, Any]:
    facts: list[Fact] = [span.what for span in holding]
    rest = [" ".join(fact.arguments[1:]) for fact in facts]
    if any(rest):
        value = ", ".join(f"not {text}" if fact.is_negative else text for fact, text in zip(facts, rest, strict=True))
    else:
        value = ", ".join("false" if fact.is_negative else "true" for fact in facts)
    return {"value": value, "facts": [*map(str, facts)]}


def _object_fields(holding: Sequence[_Span], _ended: Sequence[_Span]) -> dict[str, Any]:
    return {"value": ", ".join(span.what.instance_type for span in holding), "exists": bool(holding)}


def _run_fields(holding: Sequence[_Span], ended: Sequence[_Span]) -> dict[str, Any]:
    runs: list[Run] = [span.what for span in holding]
    texts = [" ".join(run.arguments[1:]) or "running" for run in runs]
    latest: Run | None = runs[-1] if runs else ended[-1].what if ended else None
    assert latest is not None
    return {
        "value": ", ".join(texts),
        "action": latest.action,
        "outcome": "running" if runs else latest.outcome,
        "started_by": latest.started_by,
        **({} if runs or latest.ended_by is None else {"ended_by": latest.ended_by}),
    }


_FIELDS: dict[str, Callable[[Sequence[_Span], Sequence[_Span]], dict[str, Any]]] = {
    "Fact": _fact_fields,
    "Object": _object_fields,
    "Run": _run_fields,
}


def _transaction(found: Transaction) -> McapMessage:
    fields = {"value": found.number, "client": found.client, "note": found.note, "changes": found.changes}
    return McapMessage(found.time, "/transactions", "Transaction", fields)
