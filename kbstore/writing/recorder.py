"""Writing one transaction: what a draft comes to, as rows."""

from collections.abc import Sequence
from typing import Any

from kbstore.model.timelines import Timeline, Value, stored_key
from kbstore.storage import queries
from kbstore.storage.connection import StoreConnection
from kbstore.storage.interval_tree import level, node
from kbstore.storage.repository import Head
from kbstore.writing.change_set import RowChanges
from kbstore.writing.timeline_state import TimelineState


class Recorder:
    """One transaction of a knowledge base, on a session with a write transaction."""

    def __init__(self, session: StoreConnection, kb: int, number: int, now: int) -> None:
        self._session = session
        self._kb = kb
        self._number = number
        self._now = now

    def transaction(self, head: Head, changes: int, client: str, note: str) -> None:
        """Advance the record: its head, and the transaction's own row."""
        at = {"kb": self._kb, "number": self._number, "time": self._now}
        self._session.run(queries.add_transaction, at | {"changes": changes, "client": client, "note": note})
        self._session.run(queries.advance_head, at | {"domain_version": head.domain_version, "last_run": head.last_run})

    def domain(self, version: int, name: str, source: str, sensed: str) -> None:
        """A new version of the domain."""
        at = {"kb": self._kb, "number": self._number, "time": self._now}
        self._session.run(
            queries.add_domain, at | {"version": version, "name": name, "source": source, "sensed": sensed}
        )

    def symbol(self, kind: int, key: str, name: str, labels: Sequence[str], arity: int) -> None:
        """The shape of a symbol in a knowledge base without a domain (rule D2)."""
        self._session.run(
            queries.put_symbol,
            {"kb": self._kb, "kind": kind, "key": key, "name": name, "arity": arity, "labels": " ".join(labels)},
        )

    def write(self, writes: RowChanges) -> list[Timeline]:
        """Write the rows of a draft: first what ends, then what begins. Returns the timelines that are new."""
        self._number_timelines(writes)
        session, own = self._session, {"kb": self._kb}
        session.many(queries.add_timeline, [(self._kb, *_timeline_row(track.timeline)) for track in writes.timelines])
        # in the order of their index, which is built in half the time
        mentions = sorted((about.timeline.id, track.timeline.id) for track, about in writes.mentions)
        session.many(queries.add_mention, [(self._kb, about, timeline) for about, timeline in mentions])
        for kind, rows in writes.ends.items():
            session.many(queries.for_kind[kind].end, [own | _with_level(row) for row in rows])
        for kind, rows in writes.cancels.items():
            session.many(queries.for_kind[kind].cancel, [own | _with_pending_node(row) for row in rows])
        for kind, rows in writes.settles.items():
            session.many(queries.for_kind[kind].settle, [own | _with_level(row) for row in rows])
        session.many(queries.settle_rate, [own | row for row in writes.rates])
        for kind, added in writes.adds.items():
            session.many(queries.for_kind[kind].add, [self._row(*row) for row in added])
        return [track.timeline for track in writes.timelines]

    def _row(self, track: TimelineState, start: int, end: int, value: Value) -> Sequence[Any]:
        """A new row, in the order of the statement that adds it."""
        own = (self._kb, self._number, track.timeline.id, start, end)
        if start <= self._now:
            return (*own, None, level(start, end), None, *value)
        return (*own, self._now, level(start, end), node(self._now, start), *value)

    def _number_timelines(self, writes: RowChanges) -> None:
        count = len(writes.timelines)
        if not count:
            return
        ids = self._session.timeline_ids(count)
        for track, id in zip(writes.timelines, ids, strict=True):
            track.timeline.id = id

    def start_run(
        self, run: int, operator: str, arguments: Sequence[str], duration: int, remembered: Sequence[str]
    ) -> None:
        """A durative action that runs from now on; `remembered` is what its end depends on and is true now."""
        self._session.run(
            queries.add_run,
            {
                "kb": self._kb,
                "run": run,
                "operator": operator,
                "arguments": " ".join(arguments),
                "time": self._now,
                "duration": duration,
                "remembered": "\n".join(remembered) or None,
                "number": self._number,
            },
        )

    def run_rate(self, run: int, timeline: Timeline, rate: float) -> None:
        """What a run adds to a function's rate."""
        self._session.run(queries.add_run_rate, {"kb": self._kb, "run": run, "timeline": timeline.id, "rate": rate})

    def end_run(self, run: int, started: int, outcome: str) -> None:
        """A run that ends now: "ended" or "aborted"."""
        self._session.run(
            queries.end_run,
            {
                "kb": self._kb,
                "run": run,
                "time": self._now,
                "node": node(started, self._now),
                "outcome": outcome,
                "number": self._number,
            },
        )


def _timeline_row(timeline: Timeline) -> tuple[Any, ...]:
    stored = stored_key(timeline.key)
    spelling = None if timeline.spelling == stored else timeline.spelling
    return timeline.id, int(timeline.role), int(timeline.kind), stored, spelling


def _with_level(row: dict[str, Any]) -> dict[str, Any]:
    return row | {"level": level(row["start"], row["end_time"])}


def _with_pending_node(row: dict[str, Any]) -> dict[str, Any]:
    return row | {"pending_node": node(row["recorded_time"], row["time"])}
