"""Writes the row changes of one transaction, and computes the rest of the rows: levels, nodes, places, revisions."""

import secrets
from collections.abc import Sequence
from operator import itemgetter
from typing import Any

from kbstore.clock import OPEN
from kbstore.messages import KnowledgeType
from kbstore.model.timelines import Timeline, Value, stored_key
from kbstore.storage import queries
from kbstore.storage.assertion_queries import HEAD_COLUMNS, for_kind
from kbstore.storage.connection import StoreConnection
from kbstore.storage.interval_tree import EMPTY_LEVEL, level, node, superseded
from kbstore.storage.records import Head, LateAssertion, RowChanges, RunRow, StoredAssertion
from kbstore.storage.tables import PRESENT_SCHEDULES, RevisionKind

_TOKEN_BITS = 62

_in_order_of_table = itemgetter(*(HEAD_COLUMNS.index(name) for name in queries.put_head.columns[:-1]))
"""Returns the values of a head in the order in which the statement takes them."""

_DERIVED_ANEW = 1 << 30
"""The first place in a transaction of rows derived anew in a copy; no transaction records so many rows."""


class Recorder:
    """Writes one transaction of a knowledge base; its number follows that of the head, which is locked."""

    def __init__(self, connection: StoreConnection, kb: int, head: Head, now: int) -> None:
        self._connection = connection
        self._kb = kb
        self._head = head
        self._number = head.number + 1
        self._now = now
        self.opened: dict[int, StoredAssertion] = {}
        """The new open rows on timelines that are not new."""
        self._present = head.present
        self._revisions: list[tuple[Any, ...]] = []
        self._schedules: list[tuple[Any, ...]] = []

    def record(self, changes: RowChanges, client: str, note: str) -> Head:
        """Write all changes, advance the head, and return it."""
        connection, kb, before = self._connection, self._kb, self._head
        token = secrets.randbits(_TOKEN_BITS)
        with connection.together():
            if changes.timelines:
                self._add_timelines(changes.timelines)
            if changes.mentions:
                # in the order of their index, which halves the time of inserting them
                mentions = sorted([(kb, about.id, timeline.id) for about, timeline in changes.mentions])
                connection.many(queries.add_mention, mentions)
            last_timeline = before.timeline + len(changes.timelines)
            row = (kb, changes.changes, self._number, self._now, token, last_timeline, changes.late_from, client, note)
            connection.many(queries.add_transaction, [row])
            if changes.domain is not None:
                name, source, sensed = changes.domain
                version = before.domain_version + 1
                connection.many(queries.add_domain, [(kb, version, self._now, self._number, name, source, sensed)])
            for symbol in changes.symbols:
                connection.run(queries.put_symbol, {"kb_id": kb, **symbol._asdict()})
            self._change_assertions(changes)
            self._add_assertions(changes)
            connection.many(queries.add_revision, self._revisions)
            connection.many(queries.add_schedule, self._schedules)
            if changes.runs or changes.ended_runs:
                self._write_runs(changes)
            head = Head(
                self._number,
                self._now,
                token,
                late=before.late if changes.late_from is None else self._number,
                timeline=last_timeline,
                last_run=max(before.last_run, changes.last_run),
                domain_version=before.domain_version + (changes.domain is not None),
                history_from=before.history_from,
                present=self._present | (PRESENT_SCHEDULES if self._schedules else 0),
                source=before.source,
            )
            put_head(connection, kb, head)
        return head

    def record_derived(self, changes: RowChanges) -> None:
        """Write only the derived rates of numbers at later times: for a copy, which derives them itself."""
        connection = self._connection
        self._change_rates(changes)
        rows = [
            self._row(KnowledgeType.FUNCTION, _DERIVED_ANEW + place, True, *new)
            for place, new in enumerate(changes.derived)
        ]
        connection.many(for_kind[KnowledgeType.FUNCTION].add, rows)
        connection.many(queries.add_schedule, self._schedules)

    # -- assertions -------------------------------------------------------------------------------------------

    def _change_assertions(self, changes: RowChanges) -> None:
        """Write the changes to stored assertions; before new ones, which may take their places in unique indexes."""
        connection, kb, number, now = self._connection, self._kb, self._number, self._now
        for kind, ends in changes.ends.items():
            statements = for_kind[kind]
            ended, emptied = [], []
            for row, cause in ends:
                if row.initial_time < now:
                    ended.append((now, number, level(row.initial_time, now), int(cause), kb, row.recorded_tx, row.seq))
                    if row.end_time != OPEN:
                        self._revise(kind, row, RevisionKind.CUT_SHORT)
                else:
                    emptied.append((now, number, number, EMPTY_LEVEL, int(cause), kb, row.recorded_tx, row.seq))
                    self._revise(kind, row, RevisionKind.EMPTIED)
            connection.many(statements.end, ended)
            connection.many(statements.empty, emptied)
        for kind, cancels in changes.cancels.items():
            cancelled, unscheduled = [], []
            for row in cancels:
                assert row.recorded_time is not None
                cancelled.append((row.initial_time, number, EMPTY_LEVEL, kb, row.recorded_tx, row.seq))
                unscheduled.append((now, node(row.recorded_time, now), kb, row.recorded_tx, row.seq))
                self._revise(kind, row, RevisionKind.CANCELLED)
            connection.many(for_kind[kind].cancel, cancelled)
            connection.many(queries.cancel_schedule, unscheduled)
        for kind, supersedes in changes.supersedes.items():
            superseding = []
            for row in supersedes:
                was = level(row.initial_time, row.end_time)
                superseding.append((number, superseded(was), kb, row.recorded_tx, row.seq))
                self._revise(kind, row, RevisionKind.SUPERSEDED)
            connection.many(for_kind[kind].supersede, superseding)
        for kind, settles in changes.settles.items():
            settled = []
            for row, end in settles:
                settled.append((end, level(row.initial_time, end), kb, row.recorded_tx, row.seq))
                self._revise(kind, row, RevisionKind.SETTLED)
            connection.many(for_kind[kind].settle, settled)
        self._change_rates(changes)

    def _change_rates(self, changes: RowChanges) -> None:
        """Delete the derived assertions that are not derived any more, and write the new rates of scheduled values."""
        connection, kb = self._connection, self._kb
        if changes.underived:
            underived = [(kb, row.recorded_tx, row.seq) for row in changes.underived]
            connection.many(for_kind[KnowledgeType.FUNCTION].delete, underived)
            connection.many(queries.delete_schedule, underived)
        if changes.rates:
            rates = [(rate, kb, row.recorded_tx, row.seq) for row, rate in changes.rates]
            connection.many(queries.settle_rate, rates)

    def _add_assertions(self, changes: RowChanges) -> None:
        seq = 0
        for kind, late in changes.late.items():
            self._present |= 1 << kind
            rows = [self._late_row(seq + place, new) for place, new in enumerate(late)]
            seq += len(rows)
            self._connection.many(for_kind[kind].add_late, rows)
        # derived rows come last, so that deleting them leaves no gap in the places
        derived = {KnowledgeType.FUNCTION: changes.derived} if changes.derived else {}
        for is_derived, by_kind in ((False, changes.adds), (True, derived)):
            for kind, added in by_kind.items():
                self._present |= 1 << kind
                rows = [self._row(kind, seq + place, is_derived, *new) for place, new in enumerate(added)]
                seq += len(rows)
                self._connection.many(for_kind[kind].add, rows)

    def _row(
        self, kind: KnowledgeType, seq: int, is_derived: bool, timeline: Timeline, start: int, end: int, value: Value
    ) -> Sequence[Any]:
        kb, number, now = self._kb, self._number, self._now
        if start > now:
            row = (kb, seq, number, timeline.id, now, start, start, node(now, start), int(kind), is_derived)
            self._schedules.append(row)
        elif end == OPEN and timeline.id <= self._head.timeline:
            self.opened[timeline.id] = StoredAssertion(number, seq, start, end, None, None, value)
        return (kb, seq, number, timeline.id, start, end, level(start, end), *value)

    def _late_row(self, seq: int, new: LateAssertion) -> Sequence[Any]:
        start, end = new.initial_time, new.end_time
        ended_tx, cause = (None, None) if new.ended is None else (new.ended[0] or self._number, int(new.ended[1]))
        key = (self._kb, seq, self._number, new.timeline.id, start, end, ended_tx, new.first_recorded)
        return (*key, level(start, end), cause, *new.value)

    def _revise(self, kind: KnowledgeType, row: StoredAssertion, what: RevisionKind) -> None:
        key = (self._kb, row.seq, self._number, row.recorded_tx)
        self._revisions.append((*key, row.end_time, int(kind), int(what)))

    # -- the rest ---------------------------------------------------------------------------------------------

    def _add_timelines(self, timelines: Sequence[Timeline]) -> None:
        """Write new timelines, with the numbers that follow the last one."""
        rows: list[Sequence[Any]] = []
        for id, timeline in enumerate(timelines, self._head.timeline + 1):
            timeline.id = id
            key, spelling = stored_key(timeline.key), timeline.spelling
            where = self._kb, int(timeline.role), int(timeline.kind), id
            rows.append((*where, key, None if spelling == key else spelling))
        self._connection.many(queries.add_timeline, rows)

    def _write_runs(self, changes: RowChanges) -> None:
        connection, kb = self._connection, self._kb
        connection.many(queries.add_run, [self._run_row(run) for run in changes.runs])
        ended = [
            (self._now, self._number, node(started, self._now), outcome, kb, run)
            for run, started, outcome in changes.ended_runs
        ]
        connection.many(queries.end_run, ended)

    def _run_row(self, run: RunRow) -> Sequence[Any]:
        remembered, forced = "\n".join(sorted(run.remembered)) or None, "\n".join(run.forced) or None
        return (
            *(self._kb, run.number, self._number, run.started, run.duration, OPEN, run.duration_s, None, None),
            *(run.operator, " ".join(run.arguments), None, remembered, forced),
        )


def put_head(connection: StoreConnection, kb: int, head: Head) -> None:
    """Write the head of a knowledge base."""
    connection.many(queries.put_head, [(*_in_order_of_table(head), kb)])
    connection.announce(kb, head.number)
