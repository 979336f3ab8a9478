"""The tables of a store. Times are nanoseconds; `kbstore.clock.OPEN` (2**63 - 1) as an end time means open.

Five tables hold assertions, one for each type of knowledge; a row says that from `initial_time` until `end_time` this
held on its timeline. A row's key is the transaction that recorded it and its place in that transaction (`seq`, counted
from 0 over all five tables), so that it is the same in every store, archive and export. Rows are deleted by archiving
only, except derived ones. They change when they end, and when they are retired: cancelled, superseded by late
knowledge, or ended at the very time at which they began. `schedules` and `revisions` have columns that few rows need.

Each key, each foreign key and each index begins with the knowledge base, so that a store can be distributed by it.

The types are SQL's own, in capitals: for the generic ones, such as `BigInteger`, the host may have compile rules.
"""

from enum import IntEnum

from sqlalchemy import (
    BIGINT,
    BOOLEAN,
    DOUBLE,
    DOUBLE_PRECISION,
    INTEGER,
    SMALLINT,
    TEXT,
    VARCHAR,
    Column,
    Double,
    ForeignKeyConstraint,
    Index,
    MetaData,
    PrimaryKeyConstraint,
    Table,
    text,
)

from kbstore.clock import OPEN
from kbstore.messages import KnowledgeType

metadata = MetaData(
    naming_convention={
        "ix": "ix_%(table_name)s_%(column_0_N_name)s",
        "uq": "uq_%(table_name)s_%(column_0_N_name)s",
        "fk": "fk_%(table_name)s_%(referred_table_name)s",
        "pk": "pk_%(table_name)s",
    }
)

_KEY = TEXT().with_variant(TEXT(collation="C"), "postgresql")
"""Text compared byte by byte on both engines, so that a prefix is a range."""

_DOUBLE: Double[float] = DOUBLE().with_variant(DOUBLE_PRECISION(), "postgresql")


class RevisionKind(IntEnum):
    """The kind of change to a row that was stored before; a row that was simply open until then has no revision."""

    CANCELLED = 1
    SUPERSEDED = 2
    EMPTIED = 3
    """Ended at the very time at which it began."""
    SETTLED = 4
    """Another end was derived for it, which lies ahead."""
    CUT_SHORT = 5
    """Ended before the end that had been derived for it."""


PRESENT_SCHEDULES = 1 << len(KnowledgeType)
"""The bit of `heads.present` that is set once anything was scheduled; below it, one for each knowledge type."""


def _knowledge_base() -> ForeignKeyConstraint:
    return ForeignKeyConstraint(["kb_id"], ["knowledge_bases.id"])


knowledge_bases = Table(
    "knowledge_bases",
    metadata,
    # 1, 2, 3 on SQLite; random on PostgreSQL, where knowledge bases of several servers may come together
    Column("id", INTEGER, primary_key=True, autoincrement=False),
    Column("name", TEXT, nullable=False, unique=True),
    Column("use_unknowns", BOOLEAN, nullable=False),
)

heads = Table(
    "heads",
    metadata,
    # the row that a writer locks: numbers without gaps, in the order of commit
    Column("kb_id", INTEGER, nullable=False),
    Column("domain_version", INTEGER, nullable=False),
    Column("present", INTEGER, nullable=False),
    Column("last_number", BIGINT, nullable=False),
    Column("last_time", BIGINT, nullable=False),
    Column("last_token", BIGINT, nullable=False),
    # the last transaction that recorded late knowledge; 0 if there is none
    Column("last_late", BIGINT, nullable=False),
    Column("last_timeline", BIGINT, nullable=False),
    Column("last_run", BIGINT, nullable=False),
    Column("history_from", BIGINT, nullable=False),
    # the store that this read-only copy follows; null where this knowledge base is written to
    Column("source", TEXT),
    PrimaryKeyConstraint("kb_id"),
    _knowledge_base(),
)

transactions = Table(
    "transactions",
    metadata,
    Column("kb_id", INTEGER, nullable=False),
    Column("changes", INTEGER, nullable=False),
    Column("number", BIGINT, nullable=False),
    Column("recorded_time", BIGINT, nullable=False),
    # random: histories that diverge have different tokens from there on
    Column("token", BIGINT, nullable=False),
    Column("last_timeline", BIGINT, nullable=False),
    # the earliest time about which it recorded late knowledge
    Column("late_from", BIGINT),
    Column("client", TEXT),
    Column("note", TEXT),
    PrimaryKeyConstraint("kb_id", "number"),
    _knowledge_base(),
    sqlite_with_rowid=False,
)

Index(
    "ix_transactions_late",
    transactions.c.kb_id,
    transactions.c.number,
    transactions.c.late_from,
    sqlite_where=text("late_from IS NOT NULL"),
    postgresql_where=text("late_from IS NOT NULL"),
)

domains = Table(
    "domains",
    metadata,
    Column("kb_id", INTEGER, nullable=False),
    Column("version", INTEGER, nullable=False),
    Column("initial_time", BIGINT, nullable=False),
    Column("recorded_tx", BIGINT, nullable=False),
    Column("name", TEXT, nullable=False),
    Column("source", TEXT, nullable=False),
    Column("sensed", TEXT, nullable=False),
    PrimaryKeyConstraint("kb_id", "version"),
    _knowledge_base(),
    sqlite_with_rowid=False,
)

symbols = Table(
    "symbols",
    metadata,
    Column("kb_id", INTEGER, nullable=False),
    Column("knowledge_type", SMALLINT, nullable=False),
    Column("key", _KEY, nullable=False),
    Column("name", TEXT, nullable=False),
    Column("arity", INTEGER, nullable=False),
    Column("labels", TEXT, nullable=False),
    PrimaryKeyConstraint("kb_id", "knowledge_type", "key"),
    _knowledge_base(),
    sqlite_with_rowid=False,
)

timelines = Table(
    "timelines",
    metadata,
    Column("kb_id", INTEGER, nullable=False),
    Column("role", SMALLINT, nullable=False),
    Column("knowledge_type", SMALLINT, nullable=False),
    Column("id", BIGINT, nullable=False),
    # the key of its subject, in lower case and without brackets: "robot_at kenny wp0", "kenny", "" (the metric)
    Column("key", _KEY, nullable=False),
    # the same as first written, where that differs
    Column("spelling", TEXT),
    PrimaryKeyConstraint("kb_id", "id"),
    _knowledge_base(),
    sqlite_with_rowid=False,
)
Index(
    "ux_timelines_key",
    timelines.c.kb_id,
    timelines.c.role,
    timelines.c.knowledge_type,
    timelines.c.key,
    unique=True,
)

mentions = Table(
    "mentions",
    metadata,
    Column("kb_id", INTEGER, nullable=False),
    Column("object_id", BIGINT, nullable=False),
    Column("timeline_id", BIGINT, nullable=False),
    PrimaryKeyConstraint("kb_id", "object_id", "timeline_id"),
    sqlite_with_rowid=False,
)


OWN = "own"
"""The key of a table's `info` under which its own columns are listed."""


def _assertions(name: str, *own: Column[object]) -> Table:
    """Return a table of assertions, with the common columns and its own.

    On SQLite it has row ids: if it were clustered by its key, reading the state at a time would take 1.3 times as long.
    """
    table = Table(
        name,
        metadata,
        Column("kb_id", INTEGER, nullable=False),
        Column("seq", INTEGER, nullable=False),
        Column("recorded_tx", BIGINT, nullable=False),
        Column("timeline_id", BIGINT, nullable=False),
        Column("initial_time", BIGINT, nullable=False),
        Column("end_time", BIGINT, nullable=False),
        # the transaction that ended it, if it did so at its own time
        Column("ended_tx", BIGINT),
        # the transaction since which it does not count: cancelled, superseded, or ended as it began
        Column("retired_tx", BIGINT),
        # for a part that late knowledge left of another row: the transaction that first recorded it
        Column("told_tx", BIGINT),
        # where the interval tree keeps it (`kbstore.storage.interval_tree`); negative once it is retired
        Column("level", SMALLINT, nullable=False),
        Column("end_cause", SMALLINT),
        Column("is_negative", BOOLEAN, nullable=False),
        *own,
        PrimaryKeyConstraint("kb_id", "recorded_tx", "seq"),
        ForeignKeyConstraint(["kb_id", "timeline_id"], ["timelines.kb_id", "timelines.id"]),
        info={OWN: tuple(column.name for column in own)},
    )
    columns = table.c
    by_timeline = (columns.kb_id, columns.timeline_id, columns.initial_time)
    for index, on, where, unique in (
        (f"ux_{name}_timeline", by_timeline, "retired_tx IS NULL", True),
        (f"ix_{name}_begin", (columns.kb_id, columns.level, columns.initial_time), None, False),
        (f"ix_{name}_end", (columns.kb_id, columns.level, columns.end_time), f"end_time < {OPEN}", False),
        (f"ix_{name}_retired", by_timeline, "retired_tx IS NOT NULL", False),
    ):
        clause = None if where is None else text(where)
        Index(index, *on, unique=unique, sqlite_where=clause, postgresql_where=clause)
    return table


instances = _assertions("instances", Column("instance_type", TEXT, nullable=False))
facts = _assertions("facts")
functions = _assertions(
    "functions",
    Column("function_value", _DOUBLE, nullable=False),
    # per second, from initial_time on: the function's own rate, and that with the contributions of runs
    Column("own_rate", _DOUBLE, nullable=False),
    Column("rate", _DOUBLE, nullable=False),
)
# the metric; with the role of a goal, a goal that is a condition
expressions = _assertions(
    "expressions",
    Column("optimization", TEXT, nullable=False),
    Column("expr", TEXT, nullable=False),
)
inequalities = _assertions(
    "inequalities",
    Column("comparison_type", SMALLINT, nullable=False),
    Column("lhs", TEXT, nullable=False),
    Column("rhs", TEXT, nullable=False),
    Column("grounded", BOOLEAN, nullable=False),
)

assertion_tables: dict[KnowledgeType, Table] = {
    KnowledgeType.INSTANCE: instances,
    KnowledgeType.FACT: facts,
    KnowledgeType.FUNCTION: functions,
    KnowledgeType.EXPRESSION: expressions,
    KnowledgeType.INEQUALITY: inequalities,
}

schedules = Table(
    "schedules",
    metadata,
    # one row for each assertion that was recorded before its initial time, cancelled or not
    Column("kb_id", INTEGER, nullable=False),
    Column("seq", INTEGER, nullable=False),
    Column("recorded_tx", BIGINT, nullable=False),
    Column("timeline_id", BIGINT, nullable=False),
    Column("recorded_time", BIGINT, nullable=False),
    Column("initial_time", BIGINT, nullable=False),
    # when it took effect, or was cancelled
    Column("until_time", BIGINT, nullable=False),
    # where the interval tree keeps the span in which it was pending
    Column("node", BIGINT),
    Column("knowledge_type", SMALLINT, nullable=False),
    # derived from other rows, not given by a caller
    Column("is_derived", BOOLEAN, nullable=False),
    PrimaryKeyConstraint("kb_id", "recorded_tx", "seq"),
    sqlite_with_rowid=False,
)
Index("ix_schedules_node", schedules.c.kb_id, schedules.c.node)
Index("ix_schedules_initial_time", schedules.c.kb_id, schedules.c.initial_time)

revisions = Table(
    "revisions",
    metadata,
    # one row for each change of a stored row that was not simply open until it ended: what undoes it
    Column("kb_id", INTEGER, nullable=False),
    Column("seq", INTEGER, nullable=False),
    Column("tx", BIGINT, nullable=False),
    Column("recorded_tx", BIGINT, nullable=False),
    Column("end_before", BIGINT, nullable=False),
    Column("knowledge_type", SMALLINT, nullable=False),
    # a `RevisionKind`
    Column("what", SMALLINT, nullable=False),
    PrimaryKeyConstraint("kb_id", "tx", "recorded_tx", "seq"),
    sqlite_with_rowid=False,
)

runs = Table(
    "runs",
    metadata,
    Column("kb_id", INTEGER, nullable=False),
    Column("number", BIGINT, nullable=False),
    Column("recorded_tx", BIGINT, nullable=False),
    Column("initial_time", BIGINT, nullable=False),
    Column("duration", BIGINT, nullable=False),
    Column("end_time", BIGINT, nullable=False),
    # its exact duration in seconds, of which `duration` is the rounding
    Column("duration_s", _DOUBLE, nullable=False),
    Column("ended_tx", BIGINT),
    Column("node", BIGINT),
    Column("operator", TEXT, nullable=False),
    Column("arguments", TEXT, nullable=False),
    Column("outcome", VARCHAR(7)),
    # the start conditions of its later effects that were true: in PDDL, one on each line
    Column("remembered", TEXT),
    # the conditions that did not hold and were overruled: in PDDL, one on each line
    Column("forced", TEXT),
    PrimaryKeyConstraint("kb_id", "number"),
    _knowledge_base(),
    sqlite_with_rowid=False,
)
Index("ix_runs_node", runs.c.kb_id, runs.c.node)
Index(
    "ix_runs_open",
    runs.c.kb_id,
    runs.c.initial_time,
    sqlite_where=text(f"end_time = {OPEN}"),
    postgresql_where=text(f"end_time = {OPEN}"),
)
