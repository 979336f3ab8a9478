"""Reads and writes one knowledge base on one connection: translates between rows, and timelines and values."""

import json
from collections import defaultdict
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import cached_property
from typing import Any

from kbstore.clock import OPEN
from kbstore.errors import StoreWentBack
from kbstore.messages import KnowledgeType
from kbstore.model.timelines import LONGEST_KEY, Identity, Role, StateRow, Timeline, stored_key
from kbstore.storage import directory, queries
from kbstore.storage.assertion_queries import AssertionQueries, for_kind
from kbstore.storage.connection import SqlRow, StoreConnection
from kbstore.storage.interval_tree import EMPTY_LEVEL, LEVELS, path, ranges, superseded
from kbstore.storage.memory import Mark, StoreMemory
from kbstore.storage.recorder import Recorder
from kbstore.storage.records import (
    Head,
    KnownAssertion,
    LogPosition,
    RecordedAssertion,
    RevisionRow,
    RowChanges,
    RunRow,
    StoredAssertion,
    StoredPoint,
    TransactionRows,
)
from kbstore.storage.statements import Statement
from kbstore.storage.tables import PRESENT_SCHEDULES
from kbstore.storage.whole_state import split, whole_state

_LAST_KEY = "\U0010ffff"
"""A string that sorts after all keys."""

_SIGNS = (False,), (True,)
"""The values of facts, by whether they are negative."""

_VALUE = 10
"""The index of the value in the rows that history reads."""


class Repository:
    """One knowledge base, read and written on one connection."""

    def __init__(self, connection: StoreConnection, kb: int, memory: StoreMemory) -> None:
        self._connection = connection
        self._kb = kb
        self._memory = memory
        if memory.progress.is_gone:
            raise memory.gone()
        # taken first, so that it is not newer than the rows read later
        self._seen = memory.progress.seen
        self._cache = memory.timelines
        # taken after `_seen`: if the store goes back in between, `_look` notices it, and takes the generation again
        self.generation = memory.progress.returns
        """How often the store has gone back; cached values are valid in one generation only."""
        self._positions: dict[LogPosition, dict[str, Any]] = {}
        self._head: Head | None = None
        self._saved: tuple[RowChanges, dict[int, StoredAssertion], Head] | None = None
        self._read_ahead: dict[tuple[Statement, LogPosition], list[SqlRow]] = {}

    # -- the record -------------------------------------------------------------------------------------------

    def head(self, *, for_update: bool = False) -> Head:
        """Return the head in this snapshot; `for_update` makes other writers of this knowledge base wait."""
        if self._head is None or for_update:
            read = self._connection.lock_head if for_update else self._connection.first
            return self._see(read(queries.head_for_update if for_update else queries.head, {"kb": self._kb}))
        return self._head

    def _see(self, row: SqlRow | None) -> Head:
        """Take a row as the head in this snapshot, and return the head. Raises `StoreWentBack` if there is none."""
        if row is None:
            raise self._memory.gone()
        head = self._head = Head(*row)
        self._look(Mark(head.number, head.token))
        self._memory.progress.present = head.present
        self._memory.progress.has_runs = bool(head.last_run)
        return head

    def _has_gone_back(self) -> bool:
        """Return whether the store has gone back since this was made, by its head as it is now."""
        row = self._connection.first(queries.head, {"kb": self._kb})
        if row is None:
            raise self._memory.gone()
        head = Head._make(row)
        return self._look(Mark(head.number, head.token))

    def _look(self, now: Mark) -> bool:
        """Return whether the store has gone back since this was made; if so, all caches are cleared."""
        if now == self._seen:
            return False
        try:
            has_gone_back = self._memory.look(self._seen, now, self._token)
        except StoreWentBack:
            self._refuse_another()
            raise
        if has_gone_back:
            self._refuse_another()
        self._seen = now
        self._cache = self._memory.timelines
        self.generation = self._memory.progress.returns
        return has_gone_back

    def _refuse_another(self) -> None:
        """Raise `StoreWentBack` if the knowledge base with this name has another number now, or is gone."""
        if self._memory.name:
            found = directory.find(self._connection, self._memory.name)
            if found is None or found.kb != self._kb:
                raise self._memory.gone()

    def _token(self, number: int) -> int | None:
        row = self._connection.first(queries.token, {"kb": self._kb, "number": number})
        return None if row is None else row[0]

    def save(self, changes: RowChanges, head: Head, now: int, *, client: str, note: str) -> Head:
        """Record a transaction after `head`, which is locked, and return the new head."""
        recorder = Recorder(self._connection, self._kb, head, now)
        self._saved = changes, recorder.opened, recorder.record(changes, client, note)
        return self._saved[2]

    def committed(self) -> None:
        """Remember the end of the log, and the saved rows; has to be called after the commit."""
        before = self.head()
        if self._saved is None:
            self._memory.acknowledge(before, ())
            return
        changes, opened, head = self._saved
        self._memory.acknowledge(head, changes.timelines)
        gone = (timeline.id for timeline in changes.touched if timeline.id not in opened)
        self._memory.open_rows.follow(before.token, head.token, gone, opened)

    def save_derived(self, changes: RowChanges, head: Head) -> None:
        """Write only the derived rates of numbers at later times, in a copy whose log ends with `head`."""
        Recorder(self._connection, self._kb, head._replace(number=head.number - 1), head.time).record_derived(changes)

    def transactions(self, numbers: Iterable[int]) -> list[SqlRow]:
        """Return the rows of some transactions: number, time, changes, client, note."""
        wanted = self._connection.array(sorted(set(numbers)))
        return self._connection.all(queries.transactions_numbered, {"kb": self._kb, "numbers": wanted})

    def transactions_between(self, after: int, upto: int) -> list[SqlRow]:
        """Return the rows of the transactions after a number and up to another, in order."""
        return self._connection.all(queries.transactions_between, {"kb": self._kb, "after": after, "upto": upto})

    def first_transaction_from(self, time: int) -> int | None:
        """Return the number of the first transaction at a time or later; None if there is none."""
        row = self._connection.first(queries.first_transaction_from, {"kb": self._kb, "time": time})
        return None if row is None else int(row[0])

    def last_number_at(self, t: int) -> int:
        """Return the number of the last transaction at a time or before; 0 if there is none."""
        following = self.first_transaction_from(t + 1)
        return self.head().number if following is None else following - 1

    def late_from(self, number: int) -> int:
        """Return the earliest time about which a later transaction recorded late knowledge; OPEN if none did."""
        row = self._connection.first(queries.late_from, {"kb": self._kb, "number": number})
        return OPEN if row is None or row[0] is None else int(row[0])

    def after_transaction(self, number: int, time: int) -> LogPosition:
        """Return the position in the log exactly after a transaction, which has the time `time`."""
        following = self.first_transaction_from(time + 1)
        return LogPosition(time, number, (self.head().number if following is None else following - 1))

    def domain_versions(self, after: int = 0) -> list[SqlRow]:
        """Return the rows of the domain's versions after one: version, time, transaction, source, sensed symbols."""
        return self._connection.all(queries.domain_versions, {"kb": self._kb, "after": after})

    def symbols(self) -> list[SqlRow]:
        """Return the rows of the signatures inferred without a domain: type, key, name, arity, labels."""
        return self._connection.all(queries.symbols, {"kb": self._kb})

    # -- timelines --------------------------------------------------------------------------------------------

    def timelines(self, ids: Iterable[int]) -> Mapping[int, Timeline]:
        """Return timelines by number; those that are not cached are read by one statement."""
        wanted = {id: timeline for id in set(ids) if (timeline := self._cache.by_id.find(id)) is not None}
        missing = [id for id in set(ids) if id not in wanted]
        if not missing:
            return wanted
        parameters = {"kb": self._kb, "ids": self._connection.array(missing)}
        rows = self._connection.all(queries.timelines_by_id, parameters)
        for row in rows:
            wanted[row[0]] = self._cached(row)
        return wanted

    def timelines_of(self, ids: Iterable[int]) -> list[Timeline]:
        """Return the timelines with some numbers, in the order of these."""
        ids = list(ids)
        timelines = self.timelines(ids)
        return [timelines[id] for id in ids]

    def find(self, role: Role, kind: KnowledgeType, keys: Sequence[str]) -> dict[str, Timeline]:
        """Return the timelines with some keys, as far as they exist, by key."""
        by_key = self._cache.by_key[role, kind]
        found: dict[str, Timeline] = {}
        missing = []
        for key in keys:
            timeline = by_key.get(key) or by_key.find(key)
            if timeline is None:
                # no stored key has control characters, and databases refuse some of them
                if key.isprintable():
                    missing.append(key)
            else:
                found[key] = timeline
        parameters = {"kb": self._kb, "role": int(role), "kind": int(kind)}
        rows: list[SqlRow] = []
        if len(missing) == 1:
            name, absent = Identity(role, kind, missing[0]), self._cache.absent
            # while the last timeline is the same, none has been added; in a transaction some may not be counted yet
            last = None if self._head is None or self._saved is not None else self._head.timeline
            if last is not None and absent.find(name) == last:
                return found
            row = self._connection.first(queries.timeline_by_key, parameters | {"key": stored_key(name.key)})
            if row is not None:
                rows.append(row)
            elif last is not None:
                absent.put(name, last)
        elif missing:
            stored = self._connection.array([stored_key(key) for key in missing])
            rows = self._connection.all(queries.timelines_by_key, parameters | {"keys": stored})
        for row in rows:
            timeline = self._cached(row)
            found[timeline.key] = timeline
        return found

    def of_symbol(self, role: Role, kind: KnowledgeType, name: str) -> list[Timeline]:
        """Return all timelines of a predicate or function, which is given by its key."""
        # the name ends the key, or a space follows it, which sorts before "!"
        parameters = {"kb": self._kb, "role": int(role), "kind": int(kind), "first": name, "last": f"{name}!"}
        return [self._cached(row) for row in self._connection.all(queries.timelines_of_symbol, parameters)]

    def of_kind(self, role: Role, kind: KnowledgeType) -> list[Timeline]:
        """Return all timelines of a role and knowledge type."""
        rows = self._connection.all(queries.timelines_of_kind, {"kb": self._kb, "role": int(role), "kind": int(kind)})
        return [self._cached(row) for row in rows]

    def mentioning(self, objects: Sequence[int]) -> list[Timeline]:
        """Return the timelines that mention some objects, given by the numbers of their INSTANCE timelines."""
        parameters = {"kb": self._kb, "ids": self._connection.array(objects)}
        unique = {row[0]: row for row in self._connection.all(queries.timelines_mentioning, parameters)}
        return [self._cached(row) for row in unique.values()]

    def _cached(self, row: SqlRow) -> Timeline:
        timeline = self._cache.by_id.find(row[0])
        if timeline is None:
            id, role, kind, key, spelling = row
            timeline = Timeline(id, role, kind, key if spelling is None else spelling.lower(), spelling)
            self._cache.put(timeline)
        return timeline

    # -- states -----------------------------------------------------------------------------------------------

    def read_state(self, t: int) -> None:
        """Read the head and what holds at a time in one trip to a server; `state_at` and the like then need none.

        A single statement has a snapshot of its own, and needs no transaction. If schedules or runs have to be read
        from the same snapshot as well, several statements in a transaction are sent together.
        """
        position, progress = LogPosition(t), self._memory.progress
        parameters = self._on_path(position)
        expected, found = None, (progress.present, progress.has_runs)
        while found != expected:
            # there is more, or less, than this process had seen
            expected = present, has_runs = found
            kinds = tuple(kind for kind in KnowledgeType if present >> kind & 1)
            more = [queries.pending] * bool(present & PRESENT_SCHEDULES) + [queries.running] * has_runs
            reads = [(statement, parameters) for statement in (whole_state(kinds), *more)]
            whole, *rest = self._connection.all_at_first(reads)
            row, by_kind = split(whole, kinds)
            head = self._see(row)
            found = head.present, bool(head.last_run)
        self._read_ahead = {(for_kind[kind].holding, position): rows for kind, rows in by_kind.items()}
        self._read_ahead |= {(statement, position): rows for statement, rows in zip(more, rest, strict=True)}

    def _at_position(self, statement: Statement, position: LogPosition, parameters: dict[str, Any]) -> list[SqlRow]:
        """Return the rows of a statement at a position in the log, which may have been read ahead."""
        known = self._read_ahead.get((statement, position))
        return self._connection.all(statement, parameters) if known is None else known

    def state_at(self, kind: KnowledgeType, position: LogPosition) -> list[StateRow]:
        """Return the assertions of a knowledge type that hold at a position in the log."""
        if not self._has(kind):
            return []
        statements, parameters = for_kind[kind], self._at(position)
        if position.number is None:
            return self._state_rows(kind, self._at_position(statements.holding, position, parameters))
        rows = self._connection.all(statements.holding_as_of, parameters)
        if position.latest is not None and position.latest > position.number:
            rows = rows + self._connection.all(statements.ended_since, parameters | {"levels": self._levels})
        return self._state_rows(kind, rows)

    def value_at(self, kind: KnowledgeType, timeline: Timeline | None, t: int) -> StoredPoint | None:
        """Return the head, and the assertion of one timeline at a time if a timeline is given, by one statement.

        None if the store has gone back since this was made, as the timeline may be another one now.
        """
        id = 0 if timeline is None else timeline.id
        row = self._connection.look_up(for_kind[kind].point, self._kb, id, t, self._kb)
        if row is None:
            raise self._memory.gone()
        return None if row[0] != self._seen.token and self._has_gone_back() else row

    def has_objects_since(self, number: int) -> bool:
        """Return whether a transaction after a number recorded the existence, or the end, of an object."""
        parameters = {"kb": self._kb, "number": number}
        return self._connection.first(for_kind[KnowledgeType.INSTANCE].recorded_since, parameters) is not None

    def next_start(self, timeline: Timeline, t: int) -> int:
        """Return the initial time of the next assertion on a timeline after a time; `OPEN` if none is scheduled."""
        if not self.head().present & PRESENT_SCHEDULES:
            return OPEN
        parameters = {"kb": self._kb, "timeline": timeline.id, "t": t}
        row = self._connection.first(for_kind[timeline.kind].next_start, parameters)
        return OPEN if row is None else int(row[0])

    def next_due(self, t: int) -> int:
        """Return the time after `t` before which nothing takes effect by the clock alone; `OPEN` if nothing is due."""
        if not self.head().present & PRESENT_SCHEDULES:
            return OPEN
        row = self._connection.first(queries.next_due, {"kb": self._kb, "t": t})
        return OPEN if row is None else int(row[0])

    def holding(
        self, role: Role, kind: KnowledgeType, t: int, words: str = "", *, mentioning: Timeline | None = None
    ) -> list[StateRow]:
        """Return the assertions of a role and knowledge type that hold at a time, without the rest of the state.

        Args:
            role: the role of their timelines.
            kind: the knowledge type of their timelines.
            t: the time, in nanoseconds.
            words: the words with which the keys of their timelines begin: a symbol, and objects; empty for all.
            mentioning: an INSTANCE timeline; only assertions that mention its object are returned.
        """
        if not self._has(kind):
            return []
        # long keys are stored shortened, and only their symbol is certain to be a prefix
        words = words if len(words) < LONGEST_KEY else words.partition(" ")[0]
        # the words end the key, or a space follows them, which sorts before "!"
        last = f"{words}!" if words else _LAST_KEY
        span = {"role": int(role), "kind": int(kind), "first_key": words, "last_key": last}
        parameters = {"kb": self._kb, "t": t, **span}
        if mentioning is None:
            rows = self._connection.all(for_kind[kind].of_symbol, parameters)
        else:
            rows = self._connection.all(for_kind[kind].mentioning, parameters | {"object": mentioning.id})
        return self._state_rows(kind, rows)

    def scheduled_at(self, kind: KnowledgeType, position: LogPosition) -> list[StateRow]:
        """Return the assertions that were scheduled at a position in the log, and take effect after it."""
        if not self.head().present & PRESENT_SCHEDULES:
            return []
        parameters = self._on_path(position)
        found: dict[KnowledgeType, list[SqlRow]] | None = parameters.get("scheduled")
        if found is None:
            statement = queries.pending if position.number is None else queries.pending_as_of
            found = parameters["scheduled"] = self._by_key(self._at_position(statement, position, parameters))
        return self._state_rows(kind, [(*row[:2], *row[_VALUE:]) for row in found.get(kind, ())])

    def _has(self, kind: KnowledgeType) -> bool:
        """Return whether the knowledge base has ever had an assertion of a knowledge type."""
        return bool(self.head().present >> kind & 1)

    @cached_property
    def _levels(self) -> Any:
        """All levels of rows with an end, known and superseded ones, as an array parameter."""
        closed = range(LEVELS)
        return self._connection.array([*closed, *map(superseded, closed)])

    def _at(self, position: LogPosition) -> dict[str, Any]:
        """Return the parameters for a position in the log, which are the same for each table of assertions."""
        known = self._positions.get(position)
        if known is not None:
            return known
        begins, ends = ranges(position.time)
        bounds = self._connection.bounds
        parameters: dict[str, Any] = {
            "kb": self._kb,
            "t": position.time,
            "begins": bounds(begins),
            "ends": bounds(ends),
        }
        if position.number is not None:
            parameters |= {"number": position.number, "latest": position.latest}
        self._positions[position] = parameters
        return parameters

    def _on_path(self, position: LogPosition) -> dict[str, Any]:
        """Return these parameters for tables that store nodes instead of levels."""
        parameters = self._at(position)
        if "path" not in parameters:
            parameters["path"] = self._connection.bounds(path(position.time))
        return parameters

    def _by_key(self, keys: Iterable[SqlRow]) -> dict[KnowledgeType, list[SqlRow]]:
        """Return the rows with some keys (knowledge type, transaction, place), by knowledge type."""
        wanted: dict[KnowledgeType, list[tuple[int, int]]] = defaultdict(list)
        for kind, number, seq in keys:
            wanted[KnowledgeType(kind)].append((number, seq))
        return {
            kind: self._connection.all(for_kind[kind].by_key, {"kb": self._kb, "keys": json.dumps(found)})
            for kind, found in wanted.items()
        }

    def _state_rows(self, kind: KnowledgeType, rows: list[SqlRow]) -> list[StateRow]:
        try:
            return _with_timelines(rows, self._cache.by_id)
        except KeyError:
            return _with_timelines(rows, self.timelines([row[0] for row in rows]))

    def rows_for_update(self, kind: KnowledgeType, ids: Sequence[int], t: int) -> dict[int, list[StoredAssertion]]:
        """Return for each timeline the latest row that begins no later than `t`, and those ahead of it, in order."""
        head, open_rows = self.head(), self._memory.open_rows
        known = open_rows.of(head.token, ids)
        read: dict[int, list[StoredAssertion]] = defaultdict(list)
        if len(known) < len(ids):
            missing = [id for id in ids if id not in known]
            parameters = {"kb": self._kb, "ids": self._connection.array(missing), "t": t}
            for row in self._connection.all(for_kind[kind].live, parameters):
                read[row[0]].append(StoredAssertion._make((*row[1:7], row[7:])))
            for rows in read.values():
                rows.sort(key=lambda stored: stored.initial_time)
            # a row that begins after the head may lie ahead of the next transaction, if that one's clock is behind
            found = ((id, rows[0]) for id, rows in read.items())
            open_rows.put(
                head.token, {id: row for id, row in found if row.end_time == OPEN and row.initial_time <= head.time}
            )
        return {id: [row] for id, row in known.items()} | read

    def scheduled_objects(self, t: int) -> set[int]:
        """Return the numbers of the INSTANCE timelines on which something lies ahead of `t`."""
        if not self.head().present & PRESENT_SCHEDULES:
            return set()
        parameters = {"kb": self._kb, "t": t, "kind": int(KnowledgeType.INSTANCE)}
        return {row[0] for row in self._connection.all(queries.ahead, parameters)}

    def derived_ahead(self, t: int) -> list[Timeline]:
        """Return the timelines of functions for which a rate has been derived from a time after `t` on."""
        if not self.head().present & PRESENT_SCHEDULES:
            return []
        rows = self._connection.all(queries.derived_ahead, {"kb": self._kb, "t": t})
        return self.timelines_of(dict.fromkeys(row[0] for row in rows))

    def running(self, position: LogPosition) -> list[RunRow]:
        """Return the durative actions that run at a position in the log, in the order of their starts."""
        statement = queries.running if position.number is None else queries.running_as_of
        return [_run(row) for row in sorted(self._at_position(statement, position, self._on_path(position)))]

    def runs_between(self, since: int, until: int) -> list[RunRow]:
        """Return the runs that meet ``[since, until)``, in the order of their starts."""
        before = [run for run in self.running(LogPosition(since)) if run.started < min(since, until)]
        span = {"kb": self._kb, "first": self._first_run_from(since), "end": self._first_run_from(until)}
        return before + [_run(row) for row in self._connection.all(queries.runs_numbered, span)]

    def _first_run_from(self, t: int) -> int:
        """Return the number of the first run that starts at `t` or later, by bisection: numbers rise with starts."""
        first, end = 1, self.head().last_run + 1
        while first < end:
            middle = (first + end) // 2
            found = self._connection.first(queries.run_from, {"kb": self._kb, "number": middle})
            if found is None or found[1] >= t:
                end = middle
            else:
                first = found[0] + 1
        return first

    def run(self, number: int) -> RunRow | None:
        """Return the run with a number; None if there is none."""
        row = self._connection.first(queries.run_numbered, {"kb": self._kb, "number": number})
        return None if row is None else _run(row)

    # -- history ----------------------------------------------------------------------------------------------

    def history(
        self, kind: KnowledgeType, timelines: Sequence[Timeline], first: int, until: int, upto: int | None = None
    ) -> list[RecordedAssertion]:
        """Return the rows of some timelines from the one that holds at `first` on, up to `until`.

        All retired rows that begin before `until` are among them: cancelled and superseded ones, and those that ended
        at the time at which they began. With `upto`, the rows from the very first on, as they were after that
        transaction.
        """
        if not timelines:
            return []
        ids = self._connection.array([timeline.id for timeline in timelines])
        parameters = {"kb": self._kb, "ids": ids, "first": first if upto is None else 0, "until": until}
        rows = self._recorded(self._connection.all(for_kind[kind].history, parameters))
        return rows if upto is None else self._as_after(kind, rows, upto)

    def _as_after(self, kind: KnowledgeType, rows: Iterable[RecordedAssertion], number: int) -> list[RecordedAssertion]:
        """Return rows as they were after a transaction: later changes are undone."""
        revised: dict[tuple[int, int], list[RevisionRow]] = defaultdict(list)
        for revision in self.revisions(kind, number, self.head().number):
            revised[revision.recorded, revision.seq].append(revision)
        found = []
        for row in rows:
            if row.recorded > number:
                continue
            ended = row.ended is not None and row.ended > number
            revisions = [
                revision
                for revision in revised[row.recorded, row.seq]
                # the end of a row that was open has no revision
                if not ended or (row.ended is not None and revision.number <= row.ended)
            ]
            found.append(
                row._replace(
                    end_time=revisions[0].end_before if revisions else OPEN if ended else row.end_time,
                    ended=None if ended else row.ended,
                    cause=None if ended else row.cause,
                    cancelled=_upto(row.cancelled, number),
                    superseded=_upto(row.superseded, number),
                )
            )
        return found

    def revisions(self, kind: KnowledgeType, after: int, upto: int) -> list[RevisionRow]:
        """Return how the transactions after a number and up to another changed rows, in their order."""
        parameters = {"kb": self._kb, "kind": int(kind), "after": after, "upto": upto}
        return [RevisionRow(*row) for row in self._connection.all(queries.revisions, parameters)]

    def known_rows(self, timeline: Timeline, first: int, last: int) -> list[KnownAssertion]:
        """Return the rows of a timeline that are known now, from the latest that begins by `first`, to `last`."""
        parameters = {"kb": self._kb, "timeline": timeline.id, "first": first, "last": last}
        found = []
        for row in self._connection.all(for_kind[timeline.kind].known, parameters):
            recorded, seq, start, end, ended, cause, first_recorded = row[:7]
            stored = StoredAssertion(recorded, seq, start, end, None, False, row[7:])
            found.append(KnownAssertion(stored, ended, cause, first_recorded or recorded))
        return found

    def beginning_at(self, points: Iterable[tuple[Timeline, int]], upto: int | None = None) -> list[RecordedAssertion]:
        """Return the rows that begin on a timeline at a time, for each pair; with `upto`, as after that transaction."""
        rows = self._of_pairs(points, lambda statements: statements.beginning)
        if upto is None:
            return rows
        kinds = {row.timeline.kind for row in rows}
        return [
            row
            for kind in kinds
            for row in self._as_after(kind, [row for row in rows if row.timeline.kind is kind], upto)
        ]

    def latest_before(self, points: Iterable[tuple[Timeline, int]]) -> list[RecordedAssertion]:
        """Return the latest row known now that begins on a timeline before a time, for each pair of these."""
        return self._of_pairs(points, lambda statements: statements.latest_before)

    def _of_pairs(
        self, points: Iterable[tuple[Timeline, int]], statement: Callable[[AssertionQueries], Statement]
    ) -> list[RecordedAssertion]:
        pairs: dict[KnowledgeType, list[tuple[int, int]]] = defaultdict(list)
        for timeline, t in points:
            pairs[timeline.kind].append((timeline.id, t))
        found: list[RecordedAssertion] = []
        for kind, wanted in pairs.items():
            parameters = {"kb": self._kb, "pairs": json.dumps(wanted)}
            found += self._recorded(self._connection.all(statement(for_kind[kind]), parameters))
        return found

    def changes_between(self, after: int, upto: int) -> TransactionRows:
        """Return what the transactions after a number and up to another recorded, ended, cancelled and superseded."""
        span = {"kb": self._kb, "after": after, "upto": upto}
        times = {row[0]: row[1] for row in self.transactions_between(after, upto)}
        found = TransactionRows([], [], [], [])
        if not times:
            return found
        ending = span | {"first": min(times.values()), "last": max(times.values()), "levels": self._levels}
        for kind, statements in for_kind.items():
            if self._has(kind):
                found.recorded.extend(self._recorded(self._connection.all(statements.recorded, span)))
                # without rows that late knowledge ended at an earlier time than its own
                ended = self._recorded(self._connection.all(statements.ended, ending))
                found.ended.extend(row for row in ended if row.ended in times and row.end_time == times[row.ended])
        for rows in self._by_key(self._connection.all(queries.revised, span)).values():
            for row in self._recorded(rows):
                group = found.cancelled if row.cancelled else found.superseded if row.superseded else found.ended
                group.append(row)
        return found

    def due_between(self, after: int, upto: int) -> list[RecordedAssertion]:
        """Return the scheduled assertions that took effect by the clock alone after a time and up to another."""
        if not self.head().present & PRESENT_SCHEDULES:
            return []
        keys = self._connection.all(queries.due, {"kb": self._kb, "after": after, "upto": upto})
        return [found for rows in self._by_key(keys).values() for found in self._recorded(rows)]

    def _recorded(self, rows: list[SqlRow]) -> list[RecordedAssertion]:
        timelines = self.timelines([row[0] for row in rows])
        found = []
        for id, start, end, recorded, seq, ended, retired, first_recorded, level, cause, *value in rows:
            is_cancelled = level == EMPTY_LEVEL and ended is None
            found.append(
                RecordedAssertion(
                    timelines[id],
                    start,
                    end,
                    recorded,
                    seq,
                    ended,
                    retired if is_cancelled else None,
                    retired if level != EMPTY_LEVEL else None,
                    first_recorded,
                    cause,
                    tuple(value),
                )
            )
        return found


def _run(row: SqlRow) -> RunRow:
    number, operator, arguments, started, duration, duration_s, remembered, forced, *ending = row
    return RunRow(
        number,
        operator,
        tuple(arguments.split()),
        started,
        duration,
        duration_s,
        frozenset(remembered.split("\n") if remembered else ()),
        tuple(forced.split("\n") if forced else ()),
        *ending,
    )


def _upto(number: int | None, last: int) -> int | None:
    return None if number is None or number > last else number


def _with_timelines(rows: list[SqlRow], timelines: Mapping[int, Timeline]) -> list[StateRow]:
    if rows and len(rows[0]) == 3:
        # facts, the most frequent kind; slicing would take 1.5 times as long
        return [(timelines[id], t, _SIGNS[sign]) for id, t, sign in rows]
    return [(timelines[row[0]], row[1], row[2:]) for row in rows]
