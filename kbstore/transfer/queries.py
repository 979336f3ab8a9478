"""The SQL statements that carry a whole knowledge base from one store to another, and that delete what was archived.

They are made from `kbstore.storage.tables`, so that no column can be forgotten. A row has the same key in every store;
only the number of the knowledge base, and columns that are derived from others, are not copied.
"""

from typing import Any, Final, NamedTuple

import sqlalchemy as sa
from sqlalchemy import BigInteger, Boolean, Double, Integer, SmallInteger, Table, and_, or_, select

from kbstore.storage import tables
from kbstore.storage.assertion_queries import HEAD_COLUMNS
from kbstore.storage.statements import KB, BulkStatement, Statement, among, constant, insert, parameter, vacuum

_DERIVED: Final = ("level", "node")
"""Columns for the place of a row in an interval tree."""


class TransferColumn(NamedTuple):
    """A column that is copied."""

    name: str
    type: type
    nullable: bool
    largest: int


class TableQueries:
    """The statements for one table."""

    def __init__(self, table: Table, *chosen: Any, replacing: tuple[str, ...] = ()) -> None:
        """Make the statements; `chosen` are conditions for the rows to read.

        A row whose key is there already is updated in the columns `replacing`. Rows are read in the order of the key,
        so that nothing is sorted. `rows` selects all rows of the knowledge base; `upto` counts those up to a key.
        """
        self.table = table.name
        self.columns = tuple(
            TransferColumn(column.name, _python_type(column.type), bool(column.nullable), _largest(column.type))
            for column in table.columns
            if column.name not in ("kb_id", *_DERIVED)
        )
        keys = [column for column in table.primary_key.columns if column.name != "kb_id"]
        own = select(*(table.c[column.name] for column in self.columns)).where(table.c.kb_id == KB)
        self.rows = own.order_by(*keys)
        self.chosen = self.rows.where(*chosen)
        self.read = Statement(self.chosen)
        self.count = Statement(select(sa.func.count()).select_from(table).where(table.c.kb_id == KB, *chosen))
        self.key = tuple(column.name for column in keys)
        key = sa.tuple_(*(parameter(f"key{place}") for place in range(len(keys))))
        self.upto = Statement(
            select(sa.func.count()).select_from(table).where(table.c.kb_id == KB, sa.tuple_(*keys) <= key)
        )

        def add(dialect: str) -> Any:
            added = insert(dialect, table)
            if not replacing:
                return added.on_conflict_do_nothing()
            return added.on_conflict_do_update(
                index_elements=list(table.primary_key.columns),
                set_={name: added.excluded[name] for name in replacing},
            )

        self.add = BulkStatement(add, *table.columns.keys())


def _python_type(kind: object) -> type:
    if isinstance(kind, Boolean):
        return bool
    if isinstance(kind, Integer):
        return int
    return float if isinstance(kind, Double) else str


def _largest(kind: object) -> int:
    """Return the largest number that a column holds on PostgreSQL."""
    return 2**15 - 1 if isinstance(kind, SmallInteger) else 2**63 - 1 if isinstance(kind, BigInteger) else 2**31 - 1


def _changing(table: Table) -> tuple[str, ...]:
    """Return the columns of a table that are not part of its key."""
    return tuple(column.name for column in table.columns if not column.primary_key)


def _until(column: Any) -> Any:
    return column <= parameter("upto")


def _unarchived(table: Table) -> Any:
    """Return the condition that an archive up to the time :since and the transaction :gone lacks a row as it is now."""
    known = or_(table.c.end_time >= parameter("since"), table.c.recorded_tx > parameter("gone"))
    if table is tables.runs:
        return known
    return or_(known, and_(table.c.retired_tx > parameter("gone"), _until(table.c.retired_tx)))


_transactions, _revisions, _schedules = tables.transactions.c, tables.revisions.c, tables.schedules.c
_runs, _domains = tables.runs.c, tables.domains.c

_chosen_runs = and_(_until(_runs.recorded_tx), _unarchived(tables.runs))

assertions: dict[str, TableQueries] = {
    table.name: TableQueries(table, _until(table.c.recorded_tx), _unarchived(table), replacing=_changing(table))
    for table in tables.assertion_tables.values()
}

by_table: dict[str, TableQueries] = {
    "timelines": TableQueries(tables.timelines, tables.timelines.c.id <= parameter("timelines")),
    "mentions": TableQueries(tables.mentions, tables.mentions.c.timeline_id <= parameter("timelines")),
    "transactions": TableQueries(
        tables.transactions, _transactions.number > parameter("after"), _until(_transactions.number)
    ),
    "domains": TableQueries(tables.domains, _until(_domains.recorded_tx)),
    "symbols": TableQueries(tables.symbols, replacing=("labels",)),
    **assertions,
    "schedules": TableQueries(
        tables.schedules,
        _until(_schedules.recorded_tx),
        or_(_schedules.until_time >= parameter("since"), _schedules.recorded_tx > parameter("gone")),
        replacing=_changing(tables.schedules),
    ),
    "revisions": TableQueries(tables.revisions, _revisions.tx > parameter("gone"), _until(_revisions.tx)),
    "runs": TableQueries(tables.runs, _chosen_runs, replacing=_changing(tables.runs)),
}
"""The tables in the order in which they are written: each row after those that it refers to."""

COPIED_HEAD: Final = tuple(name for name in HEAD_COLUMNS if name != "source")
"""The columns of the head that a copy has, too."""

last_transaction = Statement(
    select(_transactions.token, _transactions.last_timeline)
    .where(_transactions.kb_id == KB, _until(_transactions.number))
    .order_by(_transactions.number.desc())
    .limit(constant(1))
)
"""The token of the last transaction up to :upto, and the last timeline then."""

revisions_after = Statement(
    select(_revisions.recorded_tx, _revisions.seq, _revisions.tx, _revisions.what, _revisions.end_before)
    .where(_revisions.kb_id == KB, _revisions.tx > parameter("upto"), _revisions.recorded_tx <= parameter("upto"))
    .order_by(_revisions.tx)
)
"""The changes of later transactions to the rows recorded by the transaction :upto."""

# -- archiving ------------------------------------------------------------------------------------------------

_heads = tables.heads.c

archive_history = Statement(
    tables.heads.update()
    .where(_heads.kb_id == KB, _heads.history_from < parameter("t"))
    .values(history_from=parameter("t"))
)

_ended_runs = and_(_runs.kb_id == KB, _runs.end_time < parameter("t"), _until(_runs.recorded_tx))

delete_ended_runs = Statement(tables.runs.delete().where(_ended_runs))


def _ended(table: Table) -> Any:
    """Return the condition that a row ended before :t, and was not changed by a transaction after :upto."""
    columns = table.c
    return and_(
        columns.kb_id == KB,
        columns.recorded_tx <= parameter("upto"),
        columns.end_time < parameter("t"),
        or_(columns.retired_tx.is_(None), _until(columns.retired_tx)),
    )


def _delete_ended(table: Table) -> Statement:
    key = (table.c.recorded_tx, table.c.seq)
    window = and_(table.c.recorded_tx > parameter("after"), table.c.recorded_tx <= parameter("last"))
    found = select(*key).where(_ended(table), window).limit(parameter("most"))
    return Statement(table.delete().where(table.c.kb_id == KB, sa.tuple_(*key).in_(found)))


delete_ended = tuple(_delete_ended(table) for table in tables.assertion_tables.values())
"""Deletes at most :most ended rows of each table that the transactions after :after and up to :last recorded."""

count_ended = (
    *(
        Statement(select(sa.func.count()).select_from(table).where(_ended(table)))
        for table in tables.assertion_tables.values()
    ),
    Statement(select(sa.func.count()).select_from(tables.runs).where(_ended_runs)),
)

delete_side_rows = (
    Statement(
        tables.schedules.delete().where(
            _schedules.kb_id == KB, _schedules.until_time < parameter("t"), _until(_schedules.recorded_tx)
        )
    ),
    Statement(tables.revisions.delete().where(_revisions.kb_id == KB, _until(_revisions.tx))),
)


def _referred(table: Table) -> Any:
    """Select the transactions up to :upto to which rows refer, other than those that recorded them."""
    columns = table.c
    late = select(columns.told_tx).select_from(
        tables.transactions.join(
            table, and_(columns.kb_id == KB, columns.recorded_tx == _transactions.number, _until(columns.told_tx))
        )
    )
    retired = (columns.kb_id == KB, columns.retired_tx.is_not(None))
    return (
        late.where(_transactions.kb_id == KB, _transactions.late_from.is_not(None)),
        select(columns.retired_tx).where(*retired, _until(columns.retired_tx)),
        select(columns.ended_tx).where(*retired, _until(columns.ended_tx)),
    )


referred = Statement(
    sa.union(
        *(part for table in tables.assertion_tables.values() for part in _referred(table)),
        select(_runs.recorded_tx).where(_runs.kb_id == KB, _until(_runs.recorded_tx)),
    )
)


def _delete_transactions() -> Any:
    recording = [
        select(constant(1)).where(columns.kb_id == KB, columns.recorded_tx == _transactions.number)
        for columns in (_domains, *(table.c for table in tables.assertion_tables.values()))
    ]
    return tables.transactions.delete().where(
        _transactions.kb_id == KB,
        _transactions.number > parameter("after"),
        _transactions.number <= parameter("last"),
        _transactions.recorded_time < parameter("t"),
        sa.not_(among(_transactions.number, "referred")),
        *(sa.not_(found.correlate(tables.transactions).exists()) for found in recording),
    )


delete_transactions = Statement(_delete_transactions())
"""Deletes the transactions after :after and up to :last that nothing refers to any more."""

_vacuumed = (*tables.assertion_tables.values(), tables.transactions, tables.schedules, tables.revisions, tables.runs)

reclaim = {
    "sqlite": (Statement(sa.text("VACUUM")), Statement(sa.text("PRAGMA wal_checkpoint(TRUNCATE)"))),
    "postgresql": (Statement(vacuum(*_vacuumed)),),
}
"""Frees the space of deleted rows: for the file system on SQLite, for the tables on PostgreSQL."""

quick_check = Statement(sa.text("PRAGMA quick_check"))
