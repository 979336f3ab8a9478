"""The tables of a store. Times are nanoseconds; `kbstore.clock.OPEN` (2**63 - 1) as an end time means open.

Five tables hold assertions, one for each type of knowledge; a row says that from `initial_time` until `end_time`
this stood on its timeline. Rows are never deleted (but by archiving) and change only where the future changes:
when they end, and when they are cancelled.
"""

from sqlalchemy import (
    BigInteger,
    Boolean,
    Column,
    Double,
    ForeignKeyConstraint,
    Index,
    Integer,
    MetaData,
    PrimaryKeyConstraint,
    SmallInteger,
    String,
    Table,
    Text,
    UniqueConstraint,
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

_Key = Text().with_variant(Text(collation="C"), "postgresql")
"""Text compared byte by byte on both engines, so that a prefix is a range."""

_Id = BigInteger().with_variant(Integer, "sqlite")
"""A row's number; on SQLite the rowid itself."""


knowledge_bases = Table(
    "knowledge_bases",
    metadata,
    Column("id", Integer, primary_key=True),
    Column("name", Text, nullable=False, unique=True),
    Column("use_unknowns", Boolean, nullable=False),
    # the row that a writer locks: numbers without gaps, in the order of commit
    Column("last_number", BigInteger, nullable=False),
    Column("last_time", BigInteger, nullable=False),
    Column("history_from", BigInteger, nullable=False),
    Column("domain_version", Integer, nullable=False),
    Column("last_run", BigInteger, nullable=False),
)

transactions = Table(
    "transactions",
    metadata,
    Column("kb_id", Integer, nullable=False),
    Column("number", BigInteger, nullable=False),
    Column("recorded_time", BigInteger, nullable=False),
    Column("changes", Integer, nullable=False),
    Column("client", Text),
    Column("note", Text),
    PrimaryKeyConstraint("kb_id", "number"),
    ForeignKeyConstraint(["kb_id"], ["knowledge_bases.id"]),
    sqlite_with_rowid=False,
)

domains = Table(
    "domains",
    metadata,
    Column("kb_id", Integer, nullable=False),
    Column("version", Integer, nullable=False),
    Column("initial_time", BigInteger, nullable=False),
    Column("recorded_tx", BigInteger, nullable=False),
    Column("name", Text, nullable=False),
    Column("source", Text, nullable=False),
    Column("sensed", Text, nullable=False),
    PrimaryKeyConstraint("kb_id", "version"),
    ForeignKeyConstraint(["kb_id"], ["knowledge_bases.id"]),
    sqlite_with_rowid=False,
)

symbols = Table(
    "symbols",
    metadata,
    Column("kb_id", Integer, nullable=False),
    Column("knowledge_type", SmallInteger, nullable=False),
    Column("key", _Key, nullable=False),
    Column("name", Text, nullable=False),
    Column("arity", Integer, nullable=False),
    Column("labels", Text, nullable=False),
    PrimaryKeyConstraint("kb_id", "knowledge_type", "key"),
    ForeignKeyConstraint(["kb_id"], ["knowledge_bases.id"]),
    sqlite_with_rowid=False,
)

timelines = Table(
    "timelines",
    metadata,
    Column("id", _Id, primary_key=True),
    Column("kb_id", Integer, nullable=False),
    Column("role", SmallInteger, nullable=False),
    Column("knowledge_type", SmallInteger, nullable=False),
    # what it is about, in lower case and without brackets: "robot_at kenny wp0", "kenny", "" (the metric)
    Column("key", _Key, nullable=False),
    # the same as first written, where that differs
    Column("spelling", Text),
    UniqueConstraint("kb_id", "role", "knowledge_type", "key"),
    ForeignKeyConstraint(["kb_id"], ["knowledge_bases.id"]),
)

mentions = Table(
    "mentions",
    metadata,
    Column("kb_id", Integer, nullable=False),
    Column("object_id", BigInteger, nullable=False),
    Column("timeline_id", BigInteger, nullable=False),
    PrimaryKeyConstraint("kb_id", "object_id", "timeline_id"),
    sqlite_with_rowid=False,
)


def _assertions(name: str, *own: Column[object]) -> Table:
    """A table of assertions: what all of them have, and its own columns."""
    table = Table(
        name,
        metadata,
        Column("id", _Id, primary_key=True),
        Column("kb_id", Integer, nullable=False),
        Column("timeline_id", BigInteger, nullable=False),
        Column("initial_time", BigInteger, nullable=False),
        Column("end_time", BigInteger, nullable=False),
        Column("is_negative", Boolean, nullable=False),
        Column("recorded_tx", BigInteger, nullable=False),
        # when it was recorded, where that was before its initial time (timed-initial knowledge)
        Column("recorded_time", BigInteger),
        # set only by a transaction that ended it at the transaction's own time
        Column("ended_tx", BigInteger),
        Column("end_cause", SmallInteger),
        Column("cancelled_tx", BigInteger),
        Column("cancelled_time", BigInteger),
        # where the interval tree keeps [initial_time, end_time), and the span in which it was pending
        Column("level", SmallInteger),
        Column("pending_node", BigInteger),
        *own,
        ForeignKeyConstraint(["timeline_id"], ["timelines.id"]),
        ForeignKeyConstraint(["kb_id"], ["knowledge_bases.id"]),
    )
    columns = table.c
    for suffix, on, where in (
        ("begin", (columns.level, columns.initial_time), "level IS NOT NULL"),
        ("end", (columns.level, columns.end_time), "level IS NOT NULL"),
        ("open", (columns.initial_time,), f"end_time = {OPEN}"),
        ("recorded", (columns.recorded_tx,), None),
        # what was replaced is found from what replaced it
        ("ended", (columns.ended_tx,), "end_cause <> 2"),
        ("cancelled", (columns.cancelled_tx,), "cancelled_tx IS NOT NULL"),
        ("pending", (columns.pending_node,), "pending_node IS NOT NULL"),
        ("scheduled", (columns.initial_time,), "recorded_time IS NOT NULL"),
        ("empty", (columns.timeline_id,), "end_time <= initial_time"),
    ):
        clause = None if where is None else text(where)
        # always so; but PostgreSQL, whatever it guesses, takes an index only where its condition is asked for
        chosen = text(f"{where} AND {on[-1].name} >= 0") if suffix in ("begin", "end") else clause
        Index(f"ix_{name}_{suffix}", columns.kb_id, *on, sqlite_where=clause, postgresql_where=chosen)
    standing = text("end_time > initial_time")
    Index(
        f"ux_{name}_timeline",
        columns.kb_id,
        columns.timeline_id,
        columns.initial_time,
        unique=True,
        sqlite_where=standing,
        postgresql_where=standing,
    )
    return table


instances = _assertions("instances", Column("instance_type", Text, nullable=False))
facts = _assertions("facts")
functions = _assertions(
    "functions",
    Column("function_value", Double, nullable=False),
    # per second, from initial_time on: the function's own, and with the contributions of what runs
    Column("own_rate", Double, nullable=False),
    Column("rate", Double, nullable=False),
)
# the metric; with the role of a goal, a goal that is a condition
expressions = _assertions(
    "expressions",
    Column("optimization", Text, nullable=False),
    Column("expr", Text, nullable=False),
)
inequalities = _assertions(
    "inequalities",
    Column("comparison_type", SmallInteger, nullable=False),
    Column("lhs", Text, nullable=False),
    Column("rhs", Text, nullable=False),
    Column("grounded", Boolean, nullable=False),
)

assertion_tables: dict[KnowledgeType, Table] = {
    KnowledgeType.INSTANCE: instances,
    KnowledgeType.FACT: facts,
    KnowledgeType.FUNCTION: functions,
    KnowledgeType.EXPRESSION: expressions,
    KnowledgeType.INEQUALITY: inequalities,
}

runs = Table(
    "runs",
    metadata,
    Column("kb_id", Integer, nullable=False),
    Column("number", BigInteger, nullable=False),
    Column("operator", Text, nullable=False),
    Column("arguments", Text, nullable=False),
    Column("initial_time", BigInteger, nullable=False),
    Column("duration", BigInteger, nullable=False),
    # what effects at its end depend on and was true at its start: conditions in PDDL, one a line
    Column("remembered", Text),
    Column("end_time", BigInteger, nullable=False),
    Column("outcome", String(7)),
    Column("recorded_tx", BigInteger, nullable=False),
    Column("ended_tx", BigInteger),
    Column("node", BigInteger),
    PrimaryKeyConstraint("kb_id", "number"),
    ForeignKeyConstraint(["kb_id"], ["knowledge_bases.id"]),
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

run_rates = Table(
    "run_rates",
    metadata,
    Column("kb_id", Integer, nullable=False),
    Column("run_number", BigInteger, nullable=False),
    Column("timeline_id", BigInteger, nullable=False),
    # per second, what the run adds to the function's rate
    Column("rate", Double, nullable=False),
    PrimaryKeyConstraint("kb_id", "run_number", "timeline_id"),
    sqlite_with_rowid=False,
)
