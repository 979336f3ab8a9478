"""The SQL statements for the five tables of assertions: the same for each, with the table's own columns."""

from functools import cached_property
from typing import Any

import sqlalchemy as sa
from sqlalchemy import and_, select

from kbstore.clock import OPEN
from kbstore.messages import KnowledgeType
from kbstore.storage import tables
from kbstore.storage.interval_tree import EMPTY_LEVEL
from kbstore.storage.statements import (
    KB,
    BulkStatement,
    Lookup,
    Statement,
    among,
    between,
    constant,
    each,
    each_pair,
    parameter,
)

ROW = {"kb_id": "kb", "recorded_tx": "row_tx", "seq": "row_seq"}
"""The columns of an assertion's key, and the names of their values in statements that change a row."""

HEAD_COLUMNS = (
    "last_number",
    "last_time",
    "last_token",
    "last_late",
    "last_timeline",
    "last_run",
    "domain_version",
    "history_from",
    "present",
    "source",
)
"""The columns of a knowledge base's head, in the order in which they are read."""

_heads, _schedules, _timelines = tables.heads.c, tables.schedules.c, tables.timelines.c


def _with_symbol() -> Any:
    """Return the condition for timelines of a role and knowledge type whose keys lie in [:first_key, :last_key)."""
    return and_(
        _timelines.kb_id == KB,
        _timelines.role == parameter("role"),
        _timelines.knowledge_type == parameter("kind"),
        _timelines.key >= parameter("first_key"),
        _timelines.key < parameter("last_key"),
    )


class AssertionQueries:
    """The statements for one of the five tables of assertions."""

    def __init__(self, table: sa.Table) -> None:
        self.table = table.name
        self._table = table
        self._columns = table.c
        own = [table.c[name] for name in table.info[tables.OWN]]
        self._value = [table.c.is_negative, *own]
        self._state = [table.c.timeline_id, table.c.initial_time, *self._value]
        names = ("timeline_id", "initial_time", "end_time", "recorded_tx", "seq", "ended_tx", "retired_tx", "told_tx")
        self._recorded = [*(table.c[name] for name in names), table.c.level, table.c.end_cause, *self._value]

    # -- a state ------------------------------------------------------------------------------------------------

    @cached_property
    def holding(self) -> Statement:
        """The assertions that hold at :t, as known now."""
        return Statement(lambda dialect: sa.union_all(*self._in_tree(dialect)))

    @cached_property
    def holding_as_of(self) -> Statement:
        """The assertions that held at :t, as of the transaction :number, whose time is :t or later."""
        columns = self._columns
        known = columns.recorded_tx <= parameter("number")
        since = columns.retired_tx > parameter("number")
        return Statement(
            lambda dialect: sa.union_all(
                *self._in_tree(dialect, known), *self._in_tree(dialect, known, since, superseded=True)
            )
        )

    @cached_property
    def ended_since(self) -> Statement:
        """The assertions until :t, the time of the transaction :number, that were ended at :t by a later one.

        :levels are all levels of rows with an end.
        """
        columns, number = self._columns, parameter("number")
        was_known = and_(
            columns.recorded_tx <= number,
            columns.ended_tx > number,
            sa.or_(columns.retired_tx.is_(None), columns.retired_tx > number),
        )
        empty = self._select(self._state, "begin").where(
            columns.kb_id == KB,
            columns.level == constant(EMPTY_LEVEL),
            columns.initial_time == parameter("t"),
            columns.ended_tx > number,
            columns.recorded_tx <= number,
        )

        def union(dialect: str) -> Any:
            levels, level, _ = each(dialect, "levels")
            closed = self._for_each(
                dialect,
                levels,
                self._state,
                "end",
                columns.level == level,
                columns.end_time == parameter("t"),
                columns.end_time < constant(OPEN),
                was_known,
            )
            return sa.union_all(closed, empty)

        return Statement(union)

    def _in_tree(self, dialect: str, *conditions: Any, superseded: bool = False) -> tuple[Any, Any]:
        """Return the assertions that hold at :t: on each level, one range of beginnings or of ends."""
        columns, t = self._columns, parameter("t")

        def on_levels(index: str, bounds: str, within: Any) -> Any:
            values, bound, place = each(dialect, bounds)
            level = constant(-1) - place if superseded else place
            return self._for_each(
                dialect, values, self._state, index, columns.level == level, within(bound), *conditions
            )

        return (
            on_levels("begin", "begins", lambda bound: and_(columns.initial_time >= bound, columns.initial_time <= t)),
            on_levels(
                "end",
                "ends",
                lambda bound: and_(columns.end_time > t, columns.end_time < bound, columns.end_time < constant(OPEN)),
            ),
        )

    # -- a part of a state --------------------------------------------------------------------------------------

    @cached_property
    def of_symbol(self) -> Statement:
        """The assertions that hold at :t on the timelines of a role whose keys lie in [:first_key, :last_key)."""
        return Statement(lambda dialect: self._on_timelines(dialect, tables.timelines, _with_symbol()))

    @cached_property
    def mentioning(self) -> Statement:
        """The rows of `of_symbol` on timelines that mention an :object, which is the number of an INSTANCE timeline."""
        mentions = tables.mentions.c
        named = tables.mentions.join(
            tables.timelines, and_(_timelines.kb_id == KB, _timelines.id == mentions.timeline_id)
        )
        about = and_(mentions.kb_id == KB, mentions.object_id == parameter("object"), _with_symbol())
        return Statement(lambda dialect: self._on_timelines(dialect, named, about))

    def _on_timelines(self, dialect: str, source: Any, which: Any) -> Any:
        """Return the assertions that hold at :t on some timelines: for each the latest row that begins by :t."""
        columns, t = self._columns, parameter("t")
        if dialect == "sqlite":
            other = self._table.alias("latest").c
            latest = self._on_timeline(other, other.timeline_id == _timelines.id).where(other.initial_time <= t)
            start = latest.with_only_columns(sa.func.max(other.initial_time)).correlate(tables.timelines)
            on = and_(
                columns.kb_id == KB,
                columns.timeline_id == _timelines.id,
                columns.retired_tx.is_(None),
                columns.initial_time == start.scalar_subquery(),
            )
            found = select(*self._state).select_from(source.join(self._table, on))
            if source is tables.timelines:
                found = found.with_hint(tables.timelines, "INDEXED BY ux_timelines_key", "sqlite")
            return found.where(which, columns.end_time > t)
        latest = self._on_timeline(columns, columns.timeline_id == _timelines.id).where(columns.initial_time <= t)
        row = (
            latest.with_only_columns(columns.end_time, *self._state)
            .order_by(columns.initial_time.desc())
            .limit(constant(1))
            .lateral("found")
        )
        shown = [row.c[column.name] for column in self._state]
        return select(*shown).select_from(source.join(row, sa.true())).where(which, row.c.end_time > t)

    # -- one timeline -------------------------------------------------------------------------------------------

    @cached_property
    def point(self) -> Lookup:
        """The head's columns for a question, and the latest row of one timeline that begins by :t."""
        columns = self._columns
        # only the columns that every question needs: each takes a thirtieth of the look-up
        names = ("last_token", "last_time", "history_from", "domain_version", "last_run")
        head = [_heads[name] for name in names]
        found = [columns.end_time, columns.initial_time, *self._value]
        on_timeline = and_(
            columns.kb_id == KB,
            columns.timeline_id == parameter("timeline"),
            columns.retired_tx.is_(None),
            columns.initial_time <= parameter("t"),
        )

        def rows(dialect: str) -> Any:
            if dialect == "sqlite":
                # there is one head, so the index gives the right order; SQLite would materialise a subquery
                both = select(*head, *found).select_from(tables.heads.outerjoin(self._table, on_timeline))
                return both.where(_heads.kb_id == KB).order_by(columns.initial_time.desc()).limit(constant(1))
            latest = select(*found).where(on_timeline).order_by(columns.initial_time.desc()).limit(constant(1))
            row = latest.subquery("found")
            return select(*head, *row.c).select_from(tables.heads.outerjoin(row, sa.true())).where(_heads.kb_id == KB)

        return Lookup(rows, "kb", "timeline", "t", "kb")

    @cached_property
    def next_start(self) -> Statement:
        """The initial time of the next assertion on a timeline."""
        columns = self._columns
        on_timeline = self._on_timeline(columns, columns.timeline_id == parameter("timeline"))
        after = on_timeline.where(columns.initial_time > parameter("t"))
        return Statement(after.order_by(columns.initial_time).limit(constant(1)))

    @cached_property
    def live(self) -> Statement:
        """For each timeline the latest row that begins no later than :t, ended or not, and all rows ahead of :t.

        The rows ahead have the time at which they were recorded, and whether they are derived.
        """
        columns, other = self._columns, self._table.alias("latest").c
        stored = [columns[name] for name in ("timeline_id", "recorded_tx", "seq", "initial_time", "end_time")]
        ahead = columns.initial_time > parameter("t")
        scheduled = [
            sa.case((ahead, self._scheduled(column))).label(column.name)
            for column in (_schedules.recorded_time, _schedules.is_derived)
        ]

        def rows(dialect: str) -> Any:
            ids, id, _ = each(dialect, "ids")
            latest = self._on_timeline(other, other.timeline_id == id).where(other.initial_time <= parameter("t"))
            first = latest.with_only_columns(_greatest(other.initial_time)).correlate(ids).scalar_subquery()
            return self._for_each(
                dialect,
                ids,
                [*stored, *scheduled, *self._value],
                None,
                columns.timeline_id == id,
                columns.retired_tx.is_(None),
                columns.initial_time >= first,
            )

        return Statement(rows)

    def _scheduled(self, column: Any) -> Any:
        """Return a column of a row's row in `schedules`."""
        columns = self._columns
        return (
            select(column)
            .where(
                _schedules.kb_id == KB,
                _schedules.recorded_tx == columns.recorded_tx,
                _schedules.seq == columns.seq,
            )
            .correlate(self._table)
            .scalar_subquery()
        )

    @cached_property
    def known(self) -> Statement:
        """The rows of a timeline that are known now, from the latest that begins by :first, to :last, in order."""
        columns, other = self._columns, self._table.alias("latest").c
        names = ("recorded_tx", "seq", "initial_time", "end_time", "ended_tx", "end_cause", "told_tx")
        latest = self._on_timeline(other, other.timeline_id == parameter("timeline"))
        latest = latest.where(other.initial_time <= parameter("first"))
        rows = select(*(columns[name] for name in names), *self._value).where(
            columns.kb_id == KB,
            columns.timeline_id == parameter("timeline"),
            columns.retired_tx.is_(None),
            columns.initial_time >= latest.with_only_columns(_greatest(other.initial_time)).scalar_subquery(),
            columns.initial_time <= parameter("last"),
        )
        return Statement(rows.order_by(columns.initial_time))

    @cached_property
    def history(self) -> Statement:
        """The rows of some timelines from the latest that begins no later than :first on, up to :until.

        With all retired rows that begin before :until: cancelled and superseded ones, and those that ended at the time
        at which they began.
        """
        columns, other = self._columns, self._table.alias("latest").c

        def rows(dialect: str) -> Any:
            ids, id, _ = each(dialect, "ids")
            latest = self._on_timeline(other, other.timeline_id == id).where(other.initial_time <= parameter("first"))
            first = latest.with_only_columns(_greatest(other.initial_time)).correlate(ids).scalar_subquery()
            known = self._for_each(
                dialect,
                ids,
                self._recorded,
                None,
                columns.timeline_id == id,
                columns.retired_tx.is_(None),
                columns.initial_time >= first,
                columns.initial_time < parameter("until"),
            )
            retired = select(*self._recorded).where(
                columns.kb_id == KB,
                among(columns.timeline_id, "ids"),
                columns.retired_tx.is_not(None),
                columns.initial_time < parameter("until"),
            )
            return sa.union_all(known, retired)

        return Statement(rows)

    @cached_property
    def beginning(self) -> Statement:
        """The rows that begin on a timeline at a time, for each pair of these."""
        columns = self._columns

        def rows(dialect: str) -> Any:
            pairs, id, t = each_pair(dialect, "pairs")
            on = (columns.timeline_id == id, columns.initial_time == t)
            return sa.union_all(
                self._for_each(dialect, pairs, self._recorded, None, *on, columns.retired_tx.is_(None)),
                self._for_each(dialect, pairs, self._recorded, None, *on, columns.retired_tx.is_not(None)),
            )

        return Statement(rows)

    @cached_property
    def latest_before(self) -> Statement:
        """The latest row known now that begins on a timeline before a time, for each pair of these."""
        columns, other = self._columns, self._table.alias("latest").c

        def rows(dialect: str) -> Any:
            pairs, id, t = each_pair(dialect, "pairs")
            latest = self._on_timeline(other, other.timeline_id == id).where(other.initial_time < t)
            start = latest.with_only_columns(sa.func.max(other.initial_time)).correlate(pairs).scalar_subquery()
            return self._for_each(
                dialect,
                pairs,
                self._recorded,
                None,
                columns.timeline_id == id,
                columns.retired_tx.is_(None),
                columns.initial_time == start,
            )

        return Statement(rows)

    # -- the record ---------------------------------------------------------------------------------------------

    @cached_property
    def recorded_since(self) -> Statement:
        """A row, if a transaction after :number recorded any."""
        rows = select(constant(1)).where(self._columns.kb_id == KB, self._columns.recorded_tx > parameter("number"))
        # sorted: otherwise PostgreSQL reads a large table from its beginning until it finds one
        return Statement(rows.order_by(self._columns.recorded_tx).limit(constant(1)))

    @cached_property
    def recorded(self) -> Statement:
        """The rows that the transactions after :after and up to :upto recorded, in their order."""
        columns = self._columns
        rows = select(*self._recorded).where(columns.kb_id == KB, between(columns.recorded_tx))
        if self._table is tables.functions:
            # without derived rows, which come by the clock
            rows = rows.where(sa.func.coalesce(self._scheduled(_schedules.is_derived), sa.false()).is_(False))
        return Statement(rows.order_by(columns.recorded_tx, columns.seq))

    @cached_property
    def ended(self) -> Statement:
        """The rows that the transactions after :after and up to :upto ended, at times from :first to :last.

        Without rows of no length. :levels are all levels of rows with an end.
        """
        columns = self._columns

        def rows(dialect: str) -> Any:
            levels, level, _ = each(dialect, "levels")
            return self._for_each(
                dialect,
                levels,
                self._recorded,
                "end",
                columns.level == level,
                columns.end_time >= parameter("first"),
                columns.end_time <= parameter("last"),
                columns.end_time < constant(OPEN),
                between(columns.ended_tx),
                # rows recorded by late knowledge have ended with its transaction, or inherited their end
                columns.recorded_tx < columns.ended_tx,
            )

        return Statement(rows)

    @cached_property
    def by_key(self) -> Statement:
        """The rows with some keys, in the order of the keys."""
        columns = self._columns

        def rows(dialect: str) -> Any:
            keys, number, seq = each_pair(dialect, "keys")
            return self._for_each(
                dialect,
                keys,
                self._recorded,
                None,
                columns.recorded_tx == number,
                columns.seq == seq,
            )

        return Statement(rows)

    # -- writing ------------------------------------------------------------------------------------------------

    @cached_property
    def add(self) -> BulkStatement:
        """Add rows."""
        columns = ("kb_id", "seq", "recorded_tx", "timeline_id", "initial_time", "end_time", "level")
        return BulkStatement.adding(self._table, *columns, *(column.name for column in self._value))

    @cached_property
    def add_late(self) -> BulkStatement:
        """Add rows about the past, which may have ended."""
        columns = ("kb_id", "seq", "recorded_tx", "timeline_id", "initial_time", "end_time", "ended_tx", "told_tx")
        own = (column.name for column in self._value)
        return BulkStatement.adding(self._table, *columns, "level", "end_cause", *own)

    @cached_property
    def end(self) -> BulkStatement:
        """End a row at a transaction's own time."""
        return self._update("end_time", "level", "ended_tx", "end_cause")

    @cached_property
    def empty(self) -> BulkStatement:
        """End a row at the time at which it began."""
        return self._update("end_time", "level", "ended_tx", "end_cause", "retired_tx")

    @cached_property
    def delete(self) -> BulkStatement:
        """Delete a derived row that lies ahead."""
        return BulkStatement.deleting(self._table, key=ROW)

    @cached_property
    def cancel(self) -> BulkStatement:
        """Cancel a row: it never takes effect."""
        return self._update("end_time", "level", "retired_tx")

    @cached_property
    def supersede(self) -> BulkStatement:
        """Supersede a row: it stays as it was, but is not known any more."""
        return self._update("level", "retired_tx")

    @cached_property
    def settle(self) -> BulkStatement:
        """Set the derived end of a row."""
        return self._update("end_time", "level")

    # -- parts of statements ------------------------------------------------------------------------------------

    def _select(self, columns: Any, index: str | None) -> Any:
        found = select(*columns)
        if index is None:
            return found
        return found.with_hint(self._table, f"INDEXED BY ix_{self.table}_{index}", "sqlite")

    def _for_each(self, dialect: str, values: Any, columns: Any, index: str | None, *conditions: Any) -> Any:
        """Select the rows of the table that fulfil conditions, for each value of an array."""
        conditions = (self._columns.kb_id == KB, *conditions)
        if dialect == "sqlite":
            return self._select(columns, index).select_from(values.join(self._table, and_(*conditions)))
        # OFFSET 0 forces one index scan for each value: for a small table PostgreSQL would plan to read all of it, and
        # keep that plan when the table has grown
        found: Any = select(*columns).where(*conditions).offset(constant(0))
        if index is not None:
            # in a knowledge base that its statistics do not know yet, all indexes look alike, except by their order
            found = found.order_by(self._columns.initial_time if index == "begin" else self._columns.end_time)
        found = found.lateral("found")
        return select(found).select_from(values.join(found, sa.true()))

    @staticmethod
    def _on_timeline(columns: Any, which: Any) -> Any:
        """Return the initial times of the rows of a timeline that are known now."""
        return select(columns.initial_time).where(columns.kb_id == KB, which, columns.retired_tx.is_(None))

    def _update(self, *names: str) -> BulkStatement:
        return BulkStatement.changing(self._table, *names, key=ROW)


def _greatest(column: Any) -> Any:
    return sa.func.coalesce(sa.func.max(column), constant(0))


for_kind: dict[KnowledgeType, AssertionQueries] = {
    kind: AssertionQueries(table) for kind, table in tables.assertion_tables.items()
}
