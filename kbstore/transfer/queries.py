"""The SQL statements that carry a whole knowledge base from one store to another, and that delete what was archived.

They are made from `kbstore.storage.tables`, so that no column can be forgotten. Numbers that only mean something
within one store (of a knowledge base, of a row) and what is derived from other columns do not travel.
"""

from typing import Final, NamedTuple

from sqlalchemy import Boolean, Double, Integer, Table

from kbstore.storage import tables
from kbstore.storage.statements import Statement

_DERIVED: Final = ("level", "node", "pending_node")
"""Columns that say where the interval trees keep a row."""

_LOCAL: Final = ("kb_id", *_DERIVED)
"""Columns that do not travel."""

_CHOSEN: Final = "recorded_tx <= :upto AND end_time >= :since"
"""Rows that were recorded up to a transaction, and had not ended before a time."""


class TransferColumn(NamedTuple):
    """A column that travels."""

    name: str
    type: type
    nullable: bool


class TableQueries:
    """The statements for one table."""

    def __init__(self, table: Table, chosen: str, order: str, *, conflict: str = "") -> None:
        self.table = table.name
        local = _LOCAL if table is tables.timelines else (*_LOCAL, "id")
        self.columns = tuple(
            TransferColumn(column.name, _python_type(column.type), bool(column.nullable))
            for column in table.columns
            if column.name not in local
        )
        names = [column.name for column in self.columns]
        rows = f"FROM {table.name} WHERE kb_id = :kb AND {chosen}"
        self.read = Statement(f"SELECT {', '.join(names)} {rows} ORDER BY {order}")
        """The rows in an order in which they can be written again."""
        self.count = Statement(f"SELECT count(*) {rows}")
        self.derived = tuple(name for name in _DERIVED if name in table.columns)
        added = ["kb_id", *names, *self.derived]
        values = [":kb", *(f":{name}" for name in added[1:])]
        self.add = Statement(
            f"INSERT INTO {table.name} ({', '.join(added)}) VALUES ({', '.join(values)})"
            + (conflict and f" ON CONFLICT {conflict}")
        )


def _python_type(kind: object) -> type:
    if isinstance(kind, Boolean):
        return bool
    if isinstance(kind, Integer):
        return int
    return float if isinstance(kind, Double) else str


_ALL: Final = "1 = 1"

assertions: dict[str, TableQueries] = {
    # in the order of an index, so that nothing is sorted; of one transaction, as they were written
    table.name: TableQueries(table, _CHOSEN, "recorded_tx, id")
    for table in tables.assertion_tables.values()
}

by_table: dict[str, TableQueries] = {
    "timelines": TableQueries(tables.timelines, _ALL, "id"),
    # what an archive that is continued has already is left as it is
    "mentions": TableQueries(tables.mentions, _ALL, "object_id, timeline_id", conflict="DO NOTHING"),
    "transactions": TableQueries(tables.transactions, "number > :after AND number <= :upto", "number"),
    "domains": TableQueries(tables.domains, "recorded_tx <= :upto", "version", conflict="DO NOTHING"),
    "symbols": TableQueries(
        tables.symbols,
        _ALL,
        "knowledge_type, key",
        conflict="(kb_id, knowledge_type, key) DO UPDATE SET labels = excluded.labels",
    ),
    **assertions,
    "runs": TableQueries(tables.runs, _CHOSEN, "number"),
    "run_rates": TableQueries(
        tables.run_rates,
        f"run_number IN (SELECT number FROM runs WHERE kb_id = :kb AND {_CHOSEN})",
        "run_number, timeline_id",
    ),
}
"""The tables in the order in which they are written: each row after those that it refers to."""

HEAD_COLUMNS: Final = ("last_number", "last_time", "history_from", "domain_version", "last_run")
"""Where the record of a knowledge base stands: columns of its own row."""

put_head = Statement(
    f"UPDATE knowledge_bases SET {', '.join(f'{name} = :{name}' for name in HEAD_COLUMNS)} WHERE id = :kb"
)

# -- archiving ------------------------------------------------------------------------------------------------

first_since = Statement(
    "SELECT number FROM transactions WHERE kb_id = :kb AND recorded_time >= :t ORDER BY number LIMIT 1"
)
"""The first transaction of a time or later."""

archive_history = Statement("UPDATE knowledge_bases SET history_from = :t WHERE id = :kb AND history_from < :t")

_RUNS_SINCE = "FROM runs WHERE kb_id = :kb AND end_time >= :since"

drop_unfinished = (
    Statement(f"DELETE FROM run_rates WHERE kb_id = :kb AND run_number IN (SELECT number {_RUNS_SINCE})"),
    *(Statement(f"DELETE FROM {name} WHERE kb_id = :kb AND end_time >= :since") for name in (*assertions, "runs")),
)
"""From an archive, what had not ended at a time: the store still has it, and knows more of it."""

_ENDED_RUNS = "FROM runs WHERE kb_id = :kb AND end_time < :t"

delete_ended_runs = (
    Statement(f"DELETE FROM run_rates WHERE kb_id = :kb AND run_number IN (SELECT number {_ENDED_RUNS})"),
    Statement(f"DELETE {_ENDED_RUNS}"),
)

_ENDED = "kb_id = :kb AND recorded_tx > :after AND recorded_tx <= :upto AND end_time < :t"

delete_ended = tuple(
    Statement(f"DELETE FROM {name} WHERE id IN (SELECT id FROM {name} WHERE {_ENDED} LIMIT :most)")
    for name in assertions
)
"""At most :most rows of each table that the transactions after :after and up to :upto recorded, and that ended."""

count_ended = tuple(
    Statement(f"SELECT count(*) FROM {name} WHERE kb_id = :kb AND recorded_tx <= :upto AND end_time < :t")
    for name in (*assertions, "runs")
)

runs_recorded = Statement("SELECT recorded_tx FROM runs WHERE kb_id = :kb AND recorded_tx <= :upto")

_UNUSED = " AND ".join(
    f"NOT EXISTS (SELECT 1 FROM {name} f WHERE f.kb_id = :kb AND f.{column} = transactions.number)"
    for name, column in (
        *((name, column) for name in assertions for column in ("recorded_tx", "cancelled_tx")),
        ("domains", "recorded_tx"),
    )
)

delete_transactions = Statement(
    "DELETE FROM transactions WHERE kb_id = :kb AND number > :after AND number <= :upto AND recorded_time < :t"
    f" AND number NOT IN (SELECT value FROM EACH(runs AS bigint)) AND {_UNUSED}"
)
"""The transactions after :after and up to :upto that nothing refers to any more."""

reclaim = {
    "sqlite": (Statement("VACUUM"), Statement("PRAGMA wal_checkpoint(TRUNCATE)")),
    "postgresql": (Statement(f"VACUUM ANALYZE {', '.join((*assertions, 'transactions', 'runs', 'run_rates'))}"),),
}
"""Gives the space of deleted rows back: to the file system on SQLite, to the tables on PostgreSQL."""

ARCHIVE: Final = int.from_bytes(b"kbar")
"""The number in an SQLite file's header that marks it as an archive."""

mark_archive = Statement(f"PRAGMA application_id = {ARCHIVE}")

application_id = Statement("PRAGMA application_id")

quick_check = Statement("PRAGMA quick_check")
