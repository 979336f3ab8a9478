"""The tables of a store.

A copy of the tables as they were then: this file does not follow `kbstore.storage.tables`, whatever becomes of it.
"""

import sqlalchemy as sa
from alembic import op

revision = "0001"
down_revision = None
branch_labels = None
depends_on = None

OPEN = 9223372036854775807

KEY = sa.TEXT().with_variant(sa.TEXT(collation="C"), "postgresql")
DOUBLE: sa.Double[float] = sa.DOUBLE().with_variant(sa.DOUBLE_PRECISION(), "postgresql")


def upgrade() -> None:
    """Create the tables, then their indexes."""
    create_knowledge_bases()
    create_timelines()
    create_assertions("instances", sa.Column("instance_type", sa.TEXT, nullable=False))
    create_assertions("facts")
    create_assertions(
        "functions",
        sa.Column("function_value", DOUBLE, nullable=False),
        sa.Column("own_rate", DOUBLE, nullable=False),
        sa.Column("rate", DOUBLE, nullable=False),
    )
    create_assertions(
        "expressions",
        sa.Column("optimization", sa.TEXT, nullable=False),
        sa.Column("expr", sa.TEXT, nullable=False),
    )
    create_assertions(
        "inequalities",
        sa.Column("comparison_type", sa.SMALLINT, nullable=False),
        sa.Column("lhs", sa.TEXT, nullable=False),
        sa.Column("rhs", sa.TEXT, nullable=False),
        sa.Column("grounded", sa.BOOLEAN, nullable=False),
    )
    create_side_tables()
    create_runs()


def downgrade() -> None:
    """Drop the tables, and with them everything that they hold."""
    for table in (
        "runs",
        "revisions",
        "schedules",
        "inequalities",
        "expressions",
        "functions",
        "facts",
        "instances",
        "mentions",
        "timelines",
        "symbols",
        "domains",
        "transactions",
        "heads",
        "knowledge_bases",
    ):
        op.drop_table(table)


def create_knowledge_bases() -> None:
    """The directory and the heads, and what has one row for each change of a whole knowledge base."""
    op.create_table(
        "knowledge_bases",
        sa.Column("id", sa.INTEGER, nullable=False, autoincrement=False),
        sa.Column("name", sa.TEXT, nullable=False),
        sa.Column("use_unknowns", sa.BOOLEAN, nullable=False),
        sa.PrimaryKeyConstraint("id", name="pk_knowledge_bases"),
        sa.UniqueConstraint("name", name="uq_knowledge_bases_name"),
    )
    op.create_table(
        "heads",
        sa.Column("kb_id", sa.INTEGER, nullable=False),
        sa.Column("domain_version", sa.INTEGER, nullable=False),
        sa.Column("present", sa.INTEGER, nullable=False),
        sa.Column("last_number", sa.BIGINT, nullable=False),
        sa.Column("last_time", sa.BIGINT, nullable=False),
        sa.Column("last_token", sa.BIGINT, nullable=False),
        sa.Column("last_late", sa.BIGINT, nullable=False),
        sa.Column("last_timeline", sa.BIGINT, nullable=False),
        sa.Column("last_run", sa.BIGINT, nullable=False),
        sa.Column("history_from", sa.BIGINT, nullable=False),
        sa.Column("source", sa.TEXT),
        sa.PrimaryKeyConstraint("kb_id", name="pk_heads"),
        knowledge_base_of("heads"),
    )
    op.create_table(
        "transactions",
        sa.Column("kb_id", sa.INTEGER, nullable=False),
        sa.Column("changes", sa.INTEGER, nullable=False),
        sa.Column("number", sa.BIGINT, nullable=False),
        sa.Column("recorded_time", sa.BIGINT, nullable=False),
        sa.Column("token", sa.BIGINT, nullable=False),
        sa.Column("last_timeline", sa.BIGINT, nullable=False),
        sa.Column("late_from", sa.BIGINT),
        sa.Column("client", sa.TEXT),
        sa.Column("note", sa.TEXT),
        sa.PrimaryKeyConstraint("kb_id", "number", name="pk_transactions"),
        knowledge_base_of("transactions"),
        sqlite_with_rowid=False,
    )
    late = sa.text("late_from IS NOT NULL")
    op.create_index(
        "ix_transactions_late",
        "transactions",
        ["kb_id", "number", "late_from"],
        sqlite_where=late,
        postgresql_where=late,
    )
    op.create_table(
        "domains",
        sa.Column("kb_id", sa.INTEGER, nullable=False),
        sa.Column("version", sa.INTEGER, nullable=False),
        sa.Column("initial_time", sa.BIGINT, nullable=False),
        sa.Column("recorded_tx", sa.BIGINT, nullable=False),
        sa.Column("name", sa.TEXT, nullable=False),
        sa.Column("source", sa.TEXT, nullable=False),
        sa.Column("sensed", sa.TEXT, nullable=False),
        sa.PrimaryKeyConstraint("kb_id", "version", name="pk_domains"),
        knowledge_base_of("domains"),
        sqlite_with_rowid=False,
    )
    op.create_table(
        "symbols",
        sa.Column("kb_id", sa.INTEGER, nullable=False),
        sa.Column("knowledge_type", sa.SMALLINT, nullable=False),
        sa.Column("key", KEY, nullable=False),
        sa.Column("name", sa.TEXT, nullable=False),
        sa.Column("arity", sa.INTEGER, nullable=False),
        sa.Column("labels", sa.TEXT, nullable=False),
        sa.PrimaryKeyConstraint("kb_id", "knowledge_type", "key", name="pk_symbols"),
        knowledge_base_of("symbols"),
        sqlite_with_rowid=False,
    )


def create_timelines() -> None:
    """Timelines, and which objects they mention."""
    op.create_table(
        "timelines",
        sa.Column("kb_id", sa.INTEGER, nullable=False),
        sa.Column("role", sa.SMALLINT, nullable=False),
        sa.Column("knowledge_type", sa.SMALLINT, nullable=False),
        sa.Column("id", sa.BIGINT, nullable=False),
        sa.Column("key", KEY, nullable=False),
        sa.Column("spelling", sa.TEXT),
        sa.PrimaryKeyConstraint("kb_id", "id", name="pk_timelines"),
        knowledge_base_of("timelines"),
        sqlite_with_rowid=False,
    )
    create_index("ux_timelines_key", "timelines", ["kb_id", "role", "knowledge_type", "key"], unique=True)
    op.create_table(
        "mentions",
        sa.Column("kb_id", sa.INTEGER, nullable=False),
        sa.Column("object_id", sa.BIGINT, nullable=False),
        sa.Column("timeline_id", sa.BIGINT, nullable=False),
        sa.PrimaryKeyConstraint("kb_id", "object_id", "timeline_id", name="pk_mentions"),
        sqlite_with_rowid=False,
    )


def create_assertions(table: str, *own: sa.Column[object]) -> None:
    """One of the five tables of assertions, with its own columns and the indexes that all of them have."""
    op.create_table(
        table,
        sa.Column("kb_id", sa.INTEGER, nullable=False),
        sa.Column("seq", sa.INTEGER, nullable=False),
        sa.Column("recorded_tx", sa.BIGINT, nullable=False),
        sa.Column("timeline_id", sa.BIGINT, nullable=False),
        sa.Column("initial_time", sa.BIGINT, nullable=False),
        sa.Column("end_time", sa.BIGINT, nullable=False),
        sa.Column("ended_tx", sa.BIGINT),
        sa.Column("retired_tx", sa.BIGINT),
        sa.Column("told_tx", sa.BIGINT),
        sa.Column("level", sa.SMALLINT, nullable=False),
        sa.Column("end_cause", sa.SMALLINT),
        sa.Column("is_negative", sa.BOOLEAN, nullable=False),
        *own,
        sa.PrimaryKeyConstraint("kb_id", "recorded_tx", "seq", name=f"pk_{table}"),
        sa.ForeignKeyConstraint(
            ["kb_id", "timeline_id"], ["timelines.kb_id", "timelines.id"], name=f"fk_{table}_timelines"
        ),
    )
    by_timeline = ["kb_id", "timeline_id", "initial_time"]
    create_index(f"ux_{table}_timeline", table, by_timeline, "retired_tx IS NULL", unique=True)
    create_index(f"ix_{table}_begin", table, ["kb_id", "level", "initial_time"])
    create_index(f"ix_{table}_end", table, ["kb_id", "level", "end_time"], f"end_time < {OPEN}")
    create_index(f"ix_{table}_retired", table, by_timeline, "retired_tx IS NOT NULL")


def create_side_tables() -> None:
    """What was scheduled, and how stored rows were changed."""
    op.create_table(
        "schedules",
        sa.Column("kb_id", sa.INTEGER, nullable=False),
        sa.Column("seq", sa.INTEGER, nullable=False),
        sa.Column("recorded_tx", sa.BIGINT, nullable=False),
        sa.Column("timeline_id", sa.BIGINT, nullable=False),
        sa.Column("recorded_time", sa.BIGINT, nullable=False),
        sa.Column("initial_time", sa.BIGINT, nullable=False),
        sa.Column("until_time", sa.BIGINT, nullable=False),
        sa.Column("node", sa.BIGINT),
        sa.Column("knowledge_type", sa.SMALLINT, nullable=False),
        sa.Column("is_derived", sa.BOOLEAN, nullable=False),
        sa.PrimaryKeyConstraint("kb_id", "recorded_tx", "seq", name="pk_schedules"),
        sqlite_with_rowid=False,
    )
    create_index("ix_schedules_node", "schedules", ["kb_id", "node"])
    create_index("ix_schedules_initial_time", "schedules", ["kb_id", "initial_time"])
    op.create_table(
        "revisions",
        sa.Column("kb_id", sa.INTEGER, nullable=False),
        sa.Column("seq", sa.INTEGER, nullable=False),
        sa.Column("tx", sa.BIGINT, nullable=False),
        sa.Column("recorded_tx", sa.BIGINT, nullable=False),
        sa.Column("end_before", sa.BIGINT, nullable=False),
        sa.Column("knowledge_type", sa.SMALLINT, nullable=False),
        sa.Column("what", sa.SMALLINT, nullable=False),
        sa.PrimaryKeyConstraint("kb_id", "tx", "recorded_tx", "seq", name="pk_revisions"),
        sqlite_with_rowid=False,
    )


def create_runs() -> None:
    """What runs, and what it adds to the rates of functions."""
    op.create_table(
        "runs",
        sa.Column("kb_id", sa.INTEGER, nullable=False),
        sa.Column("number", sa.BIGINT, nullable=False),
        sa.Column("recorded_tx", sa.BIGINT, nullable=False),
        sa.Column("initial_time", sa.BIGINT, nullable=False),
        sa.Column("duration", sa.BIGINT, nullable=False),
        sa.Column("end_time", sa.BIGINT, nullable=False),
        sa.Column("duration_s", DOUBLE, nullable=False),
        sa.Column("ended_tx", sa.BIGINT),
        sa.Column("node", sa.BIGINT),
        sa.Column("operator", sa.TEXT, nullable=False),
        sa.Column("arguments", sa.TEXT, nullable=False),
        sa.Column("outcome", sa.VARCHAR(7)),
        sa.Column("remembered", sa.TEXT),
        sa.Column("forced", sa.TEXT),
        sa.PrimaryKeyConstraint("kb_id", "number", name="pk_runs"),
        knowledge_base_of("runs"),
        sqlite_with_rowid=False,
    )
    create_index("ix_runs_node", "runs", ["kb_id", "node"])
    create_index("ix_runs_open", "runs", ["kb_id", "initial_time"], f"end_time = {OPEN}")


def create_index(name: str, table: str, columns: list[str], where: str | None = None, *, unique: bool = False) -> None:
    """An index, partial where a condition is given."""
    clause = None if where is None else sa.text(where)
    op.create_index(name, table, columns, unique=unique, sqlite_where=clause, postgresql_where=clause)


def knowledge_base_of(table: str) -> sa.ForeignKeyConstraint:
    """The reference of a table's rows to their knowledge base."""
    return sa.ForeignKeyConstraint(["kb_id"], ["knowledge_bases.id"], name=f"fk_{table}_knowledge_bases")
