"""The SQL statements that read what some transactions of one knowledge base did, as rows.

A row's key is the transaction that recorded it and its place in that. So the rows of a part of the record are a range
of keys, and the keys of the older rows that the part changed. The transactions are those after :after and up to :upto.
"""

from typing import Any, Final

import sqlalchemy as sa
from sqlalchemy import Table, and_, select

from kbstore.clock import OPEN
from kbstore.messages import KnowledgeType
from kbstore.model.timelines import Role
from kbstore.storage import tables
from kbstore.storage.statements import KB, Statement, among, between, constant, each_pair, parameter
from kbstore.transfer.queries import assertions, by_table

_transactions, _revisions, _schedules = tables.transactions.c, tables.revisions.c, tables.schedules.c
_runs, _timelines, _mentions = tables.runs.c, tables.timelines.c, tables.mentions.c


def _keyed(table: Table) -> Statement:
    """Select the rows with keys that are given as pairs of a transaction and a place in it."""
    shown = [table.c[column.name] for column in by_table[table.name].columns]

    def rows(dialect: str) -> Any:
        pairs, number, seq = each_pair(dialect, "pairs")
        on = (table.c.kb_id == KB, table.c.recorded_tx == number, table.c.seq == seq)
        if dialect == "sqlite":
            return select(*shown).select_from(pairs.join(table, and_(*on)))
        found = select(*shown).where(*on).offset(constant(0)).lateral("found")
        return select(found).select_from(pairs.join(found, sa.true()))

    return Statement(rows)


keyed: dict[str, Statement] = {name: _keyed(tables.metadata.tables[name]) for name in (*assertions, "schedules")}
"""By table, the rows with some keys, in the order in which these are given."""

recorded: dict[str, Statement] = {
    name: Statement(by_table[name].chosen.where(column > parameter(bound)))
    for name, column, bound in (
        ("timelines", _timelines.id, "known_timelines"),
        ("transactions", _transactions.number, "after"),
        ("domains", tables.domains.c.version, "known_version"),
        *((name, tables.metadata.tables[name].c.recorded_tx, "after") for name in (*assertions, "schedules")),
        ("revisions", _revisions.tx, "after"),
    )
}
"""By table, the rows that the transactions recorded."""

recorded["symbols"] = by_table["symbols"].read
recorded["runs"] = Statement(by_table["runs"].chosen.where(_runs.number > parameter("known_run")))

known_runs = Statement(by_table["runs"].chosen.where(among(_runs.number, "open_runs")))
"""The older runs with some numbers."""


def _mentions_of_objects() -> Any:
    """Select mentions by their objects, as the key of the table begins with the object."""
    objects = tables.timelines.join(tables.mentions, and_(_mentions.kb_id == KB, _mentions.object_id == _timelines.id))
    return (
        select(_mentions.object_id, _mentions.timeline_id)
        .select_from(objects)
        .with_hint(tables.timelines, "INDEXED BY ux_timelines_key", "sqlite")
        .where(
            _timelines.kb_id == KB,
            _timelines.role == constant(Role.STATE),
            _timelines.knowledge_type == constant(KnowledgeType.INSTANCE),
        )
    )


_is_new = and_(_mentions.timeline_id > parameter("known_timelines"), _mentions.timeline_id <= parameter("timelines"))

new_mentions = Statement(_mentions_of_objects().where(_is_new))
"""The objects that new timelines mention."""

other_mentions = Statement(_mentions_of_objects().where(among(_mentions.timeline_id, "ids")))
"""The objects that some timelines mention; those of the metric vary."""

revised = Statement(
    select(_revisions.knowledge_type, _revisions.recorded_tx, _revisions.seq).where(
        _revisions.kb_id == KB, between(_revisions.tx), _revisions.recorded_tx <= parameter("after")
    )
)
"""The older rows that the transactions changed, except open ones that they ended."""

ahead = Statement(
    select(_schedules.recorded_tx, _schedules.seq)
    .with_hint(tables.schedules, "INDEXED BY ix_schedules_initial_time", "sqlite")
    .where(
        _schedules.kb_id == KB,
        _schedules.initial_time > parameter("t"),
        _schedules.knowledge_type == constant(KnowledgeType.FUNCTION),
        _schedules.recorded_tx <= parameter("after"),
    )
)
"""The older rows of functions that lay ahead of :t: their rates change, and derived ones vanish, without a revision."""

sizes = Statement(
    select(_transactions.number, _transactions.recorded_time, _transactions.changes)
    .where(_transactions.kb_id == KB, _transactions.number > parameter("after"))
    .order_by(_transactions.number)
    .limit(parameter("most"))
)
"""At most :most transactions, with their times and how many timelines each changed."""

transactions_numbered = Statement(by_table["transactions"].rows.where(among(_transactions.number, "numbers")))

open_runs = Statement(
    select(_runs.number)
    .with_hint(tables.runs, "INDEXED BY ix_runs_open", "sqlite")
    .where(_runs.kb_id == KB, _runs.end_time == constant(OPEN))
)

_derived: Final = select(_schedules.recorded_tx, _schedules.seq).where(
    _schedules.kb_id == KB, _schedules.initial_time > parameter("t"), _schedules.is_derived.is_(True)
)

delete_derived = (
    Statement(
        tables.functions.delete().where(
            tables.functions.c.kb_id == KB,
            sa.tuple_(tables.functions.c.recorded_tx, tables.functions.c.seq).in_(_derived),
        )
    ),
    Statement(
        tables.schedules.delete().where(
            _schedules.kb_id == KB, _schedules.initial_time > parameter("t"), _schedules.is_derived.is_(True)
        )
    ),
)
"""Deletes the functions' rows that are derived, and ahead of :t."""
