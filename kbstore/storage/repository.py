"""Rows to timelines and values, and back: one knowledge base on one session."""

from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from functools import cached_property
from typing import Any, NamedTuple

from kbstore.caches import LRU, TIMELINES
from kbstore.clock import OPEN
from kbstore.messages import KnowledgeType
from kbstore.model.timelines import Role, Timeline, Value, stored_key
from kbstore.storage import queries
from kbstore.storage.connection import SqlRow, StoreConnection
from kbstore.storage.interval_tree import path, ranges

StateRow = tuple[Timeline, int, Value]
"""An assertion that stands, or is pending: its timeline, since when (or from when), and what."""


class Head(NamedTuple):
    """The row of a knowledge base that a writer locks: where its record stands."""

    number: int
    time: int
    history_from: int
    domain_version: int
    last_run: int


class LogPosition(NamedTuple):
    """A place in the record: a time, or exactly after a transaction (`number`) of that time.

    `latest` is the last transaction of that time.
    """

    time: int
    number: int | None = None
    latest: int | None = None


class StoredAssertion(NamedTuple):
    """A stored assertion as a writer needs it."""

    id: int
    initial_time: int
    end_time: int
    recorded_time: int | None
    value: Value


class RecordedAssertion(NamedTuple):
    """A stored assertion as history needs it."""

    timeline: Timeline
    initial_time: int
    end_time: int
    recorded: int
    ended: int | None
    cancelled: int | None
    cause: int | None
    value: Value


class StoredPoint(NamedTuple):
    """What holds on one timeline at a time, and the head as it was then; `value` is None where nothing holds."""

    head: Head
    initial_time: int
    end_time: int
    value: Value | None


class Present(NamedTuple):
    """Whether a knowledge base has any assertions of a knowledge type, and any that were scheduled."""

    anything: bool
    scheduled: bool


class RunRow(NamedTuple):
    """A stored run of a durative action, with what it adds to which function's rate, and remembers of its start."""

    number: int
    operator: str
    arguments: tuple[str, ...]
    started: int
    duration: int
    rates: tuple[tuple[Timeline, float], ...]
    remembered: frozenset[str]


class TimelineCache:
    """The timelines that this process has seen: they never change, so a row needs only their number."""

    def __init__(self, bound: int = TIMELINES) -> None:
        self.by_id: LRU[int, Timeline] = LRU(bound)
        self.by_key: dict[tuple[Role, KnowledgeType], LRU[str, Timeline]] = defaultdict(lambda: LRU(bound))

    def put(self, timeline: Timeline) -> None:
        """Remember a timeline that is committed."""
        self.by_id.put(timeline.id, timeline)
        self.by_key[timeline.role, timeline.kind].put(timeline.key, timeline)


class Repository:
    """One knowledge base, read and written on one session."""

    def __init__(self, session: StoreConnection, kb: int, cache: TimelineCache) -> None:
        self._session = session
        self._kb = kb
        self._cache = cache
        self._places: dict[LogPosition, dict[str, Any]] = {}

    # -- the record -------------------------------------------------------------------------------------------

    def head(self, *, for_update: bool = False) -> Head:
        """Where the record stands; `for_update` makes other writers of this knowledge base wait."""
        row = self._session.first(queries.head_for_update if for_update else queries.head, {"kb": self._kb})
        assert row is not None
        return Head(*row)

    def transactions(self, numbers: Iterable[int]) -> list[SqlRow]:
        """The rows of some transactions: number, time, changes, client, note."""
        wanted = self._session.array(sorted(set(numbers)))
        return self._session.all(queries.transactions_numbered, {"kb": self._kb, "numbers": wanted})

    def transactions_between(self, after: int, upto: int) -> list[SqlRow]:
        """The rows of the transactions after a number and up to another, in order."""
        return self._session.all(queries.transactions_between, {"kb": self._kb, "after": after, "upto": upto})

    def first_transaction_from(self, time: int) -> int | None:
        """The number of the first transaction at a time or later; None if there is none."""
        row = self._session.first(queries.first_transaction_from, {"kb": self._kb, "time": time})
        return None if row is None else int(row[0])

    def after_transaction(self, number: int, time: int) -> LogPosition:
        """The place in the record exactly after a transaction."""
        row = self._session.first(queries.last_transaction_at, {"kb": self._kb, "number": number, "time": time})
        return LogPosition(time, number, number if row is None else row[0])

    def domain_versions(self, after: int = 0) -> list[SqlRow]:
        """Version, time, transaction, source and sensed names of the domain's versions after one."""
        return self._session.all(queries.domain_versions, {"kb": self._kb, "after": after})

    def symbols(self) -> list[SqlRow]:
        """The shapes that a knowledge base without a domain keeps: type, key, name, arity, labels."""
        return self._session.all(queries.symbols, {"kb": self._kb})

    # -- timelines --------------------------------------------------------------------------------------------

    def timelines(self, ids: Iterable[int]) -> Mapping[int, Timeline]:
        """Timelines by number; those that the cache has not are read at once."""
        wanted = {id: timeline for id in set(ids) if (timeline := self._cache.by_id.find(id)) is not None}
        missing = [id for id in set(ids) if id not in wanted]
        if not missing:
            return wanted
        parameters = {"kb": self._kb, "ids": self._session.array(missing)}
        rows = self._session.all(queries.timelines_by_id, parameters)
        for row in rows:
            wanted[row[0]] = self._remember(row)
        return wanted

    def timelines_of(self, ids: Iterable[int]) -> list[Timeline]:
        """Timelines by number, in that order."""
        ids = list(ids)
        timelines = self.timelines(ids)
        return [timelines[id] for id in ids]

    def find(self, role: Role, kind: KnowledgeType, keys: Sequence[str]) -> dict[str, Timeline]:
        """The timelines with some keys, as far as they exist."""
        by_key = self._cache.by_key[role, kind]
        found: dict[str, Timeline] = {}
        missing = []
        for key in keys:
            timeline = by_key.get(key) or by_key.find(key)
            if timeline is None:
                # no name that is stored has control characters, and no database takes all of them
                if key.isprintable():
                    missing.append(key)
            else:
                found[key] = timeline
        parameters = {"kb": self._kb, "role": int(role), "kind": int(kind)}
        rows: list[SqlRow] = []
        if len(missing) == 1:
            row = self._session.first(queries.timeline_by_key, parameters | {"key": stored_key(missing[0])})
            rows = [] if row is None else [row]
        elif missing:
            stored = self._session.array([stored_key(key) for key in missing])
            rows = self._session.all(queries.timelines_by_key, parameters | {"keys": stored})
        for row in rows:
            timeline = self._remember(row)
            found[timeline.key] = timeline
        return found

    def of_symbol(self, role: Role, kind: KnowledgeType, name: str) -> list[Timeline]:
        """All timelines of a predicate or function, by its key."""
        parameters = {
            "kb": self._kb,
            "role": int(role),
            "kind": int(kind),
            "name": name,
            "first": f"{name} ",
            "last": f"{name}!",
        }
        return [self._remember(row) for row in self._session.all(queries.timelines_of_symbol, parameters)]

    def of_kind(self, role: Role, kind: KnowledgeType) -> list[Timeline]:
        """All timelines of a knowledge type."""
        rows = self._session.all(queries.timelines_of_kind, {"kb": self._kb, "role": int(role), "kind": int(kind)})
        return [self._remember(row) for row in rows]

    def mentioning(self, objects: Sequence[int]) -> list[Timeline]:
        """The timelines that mention some objects, given by the numbers of their INSTANCE timelines."""
        parameters = {"kb": self._kb, "ids": self._session.array(objects)}
        unique = {row[0]: row for row in self._session.all(queries.timelines_mentioning, parameters)}
        return [self._remember(row) for row in unique.values()]

    def _remember(self, row: SqlRow) -> Timeline:
        timeline = self._cache.by_id.find(row[0])
        if timeline is None:
            id, role, kind, key, spelling = row
            timeline = Timeline(id, role, kind, key if spelling is None else spelling.lower(), spelling)
            self._cache.put(timeline)
        return timeline

    # -- what stands ------------------------------------------------------------------------------------------

    def state_at(self, kind: KnowledgeType, position: LogPosition) -> list[StateRow]:
        """The assertions of a knowledge type that stand at a place in the record."""
        if not self._present[kind].anything:
            return []
        statements = queries.for_kind[kind]
        statement = statements.standing if position.number is None else statements.standing_as_of
        return self._standing(kind, self._session.all(statement, self._place(position)))

    def value_at(self, kind: KnowledgeType, timeline: Timeline | None, t: int) -> StoredPoint:
        """What holds on one timeline at a time, with the head: one statement. No timeline says nothing."""
        row = self._session.look_up(queries.for_kind[kind].point, self._kb, 0 if timeline is None else timeline.id, t)
        assert row is not None
        head, end, initial_time = Head._make(row[:5]), row[5], row[6]
        if end is None or end <= t:
            return StoredPoint(head, 0, OPEN, None)
        return StoredPoint(head, initial_time, end, row[7:])

    def next_start(self, timeline: Timeline, t: int) -> int:
        """When the next assertion on a timeline begins after a time; `OPEN` if none is scheduled."""
        parameters = {"kb": self._kb, "timeline": timeline.id, "t": t}
        row = self._session.first(queries.for_kind[timeline.kind].next_start, parameters)
        return OPEN if row is None else int(row[0])

    def scheduled_at(self, kind: KnowledgeType, position: LogPosition) -> list[StateRow]:
        """What was scheduled at a place in the record, and takes effect after it."""
        if not self._present[kind].scheduled:
            return []
        statements = queries.for_kind[kind]
        statement = statements.pending if position.number is None else statements.pending_as_of
        return self._standing(kind, self._session.all(statement, self._path(position)))

    @cached_property
    def _present(self) -> dict[KnowledgeType, Present]:
        """What there is to be asked for; true as long as the repository's snapshot, as a writer adds rows last."""
        row = self._session.first(queries.present, {"kb": self._kb})
        assert row is not None
        flags = iter(row)
        return {kind: Present(next(flags), next(flags)) for kind in queries.for_kind}

    def _place(self, position: LogPosition) -> dict[str, Any]:
        """The parameters that say a place in the record; the same for each of the tables."""
        known = self._places.get(position)
        if known is not None:
            return known
        begins, ends = ranges(position.time)
        bounds = self._session.bounds
        place: dict[str, Any] = {
            "kb": self._kb,
            "t": position.time,
            "begins": bounds(begins),
            "ends": bounds(ends),
        }
        if position.number is not None:
            place |= {"number": position.number, "latest": position.latest}
        self._places[position] = place
        return place

    def _path(self, position: LogPosition) -> dict[str, Any]:
        """The same for what is kept by the nodes themselves."""
        place = self._place(position)
        if "path" not in place:
            place["path"] = self._session.bounds(path(position.time))
        return place

    def _standing(self, kind: KnowledgeType, rows: list[SqlRow]) -> list[StateRow]:
        try:
            return _with_timelines(kind, rows, self._cache.by_id)
        except KeyError:
            return _with_timelines(kind, rows, self.timelines([row[0] for row in rows]))

    def rows_for_update(self, kind: KnowledgeType, ids: Sequence[int], t: int) -> dict[int, list[StoredAssertion]]:
        """For each timeline the latest row that begins no later than `t`, and those ahead of it, in order."""
        parameters = {"kb": self._kb, "ids": self._session.array(ids), "t": t}
        found: dict[int, list[StoredAssertion]] = defaultdict(list)
        for row in self._session.all(queries.for_kind[kind].live, parameters):
            found[row[1]].append(StoredAssertion(row[0], row[2], row[3], row[4], row[5:]))
        for rows in found.values():
            rows.sort(key=lambda stored: stored.initial_time)
        return found

    def scheduled_objects(self, t: int) -> set[int]:
        """The INSTANCE timelines on which something lies ahead of `t`."""
        rows = self._session.all(queries.for_kind[KnowledgeType.INSTANCE].ahead, {"kb": self._kb, "t": t})
        return {row[0] for row in rows}

    def running(self, position: LogPosition) -> list[RunRow]:
        """The durative actions that run at a place in the record, in the order in which they were started."""
        statement = queries.running if position.number is None else queries.running_as_of
        rows = sorted(self._session.all(statement, self._path(position)))
        if not rows:
            return []
        parameters = {"kb": self._kb, "numbers": self._session.array([row[0] for row in rows])}
        rates: dict[int, list[tuple[int, float]]] = defaultdict(list)
        for number, timeline, rate in self._session.all(queries.run_rates, parameters):
            rates[number].append((timeline, rate))
        timelines = self.timelines([timeline for moved in rates.values() for timeline, _ in moved])
        return [
            RunRow(
                number,
                operator,
                tuple(arguments.split()),
                started,
                duration,
                tuple((timelines[timeline], rate) for timeline, rate in rates[number]),
                frozenset(remembered.split("\n") if remembered else ()),
            )
            for number, operator, arguments, started, duration, remembered in rows
        ]

    # -- history ----------------------------------------------------------------------------------------------

    def history(
        self, kind: KnowledgeType, timelines: Sequence[Timeline], first: int, until: int
    ) -> list[RecordedAssertion]:
        """The rows of some timelines that begin in ``[first, until)``, also cancelled ones and those of no length."""
        ids = self._session.array([timeline.id for timeline in timelines])
        parameters = {"kb": self._kb, "ids": ids, "first": first, "until": until}
        return self._recorded(self._session.all(queries.for_kind[kind].history, parameters))

    def latest_start(self, timeline: Timeline, t: int) -> int:
        """When the latest row of a timeline that begins no later than `t` begins; 0 if there is none."""
        parameters = {"kb": self._kb, "timeline": timeline.id, "t": t}
        row = self._session.first(queries.for_kind[timeline.kind].latest_start, parameters)
        return 0 if row is None else int(row[0])

    def changes_between(
        self, after: int, upto: int
    ) -> tuple[list[RecordedAssertion], list[RecordedAssertion], list[RecordedAssertion]]:
        """What the transactions after a number and up to another recorded, ended and cancelled."""
        parameters = {"kb": self._kb, "after": after, "upto": upto}
        recorded: list[RecordedAssertion] = []
        ended: list[RecordedAssertion] = []
        cancelled: list[RecordedAssertion] = []
        for statements in queries.for_kind.values():
            recorded += self._recorded(self._session.all(statements.recorded, parameters))
            ended += self._recorded(self._session.all(statements.ended, parameters))
            cancelled += self._recorded(self._session.all(statements.cancelled, parameters))
        return recorded, ended, cancelled

    def due_between(self, after: int, upto: int) -> list[RecordedAssertion]:
        """What was scheduled, and took effect by the clock alone after a time and up to another."""
        parameters = {"kb": self._kb, "after": after, "upto": upto}
        found: list[RecordedAssertion] = []
        for statements in queries.for_kind.values():
            found += self._recorded(self._session.all(statements.due, parameters))
        return found

    def _recorded(self, rows: list[SqlRow]) -> list[RecordedAssertion]:
        timelines = self.timelines([row[0] for row in rows])
        return [RecordedAssertion._make((timelines[row[0]], *row[1:7], row[7:])) for row in rows]


def _with_timelines(kind: KnowledgeType, rows: list[SqlRow], timelines: Mapping[int, Timeline]) -> list[StateRow]:
    if kind is KnowledgeType.FACT:
        # a state is made of facts, most of all
        return [(timelines[id], t, (sign,)) for id, t, sign in rows]
    return [(timelines[row[0]], row[1], row[2:]) for row in rows]
