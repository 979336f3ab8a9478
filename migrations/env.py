"""Runs kbstore's migrations, all steps of a call in one transaction, on SQLite and on PostgreSQL.

By default, alembic on SQLite keeps half of a migration that failed, lets two processes migrate at once, and loses the
children of a table that is created again under foreign keys. So the driver is in autocommit mode, and the transaction
is begun here, by hand and under the write lock; foreign keys are off meanwhile and checked before the end, and the rows
are counted before and after. A process killed at any moment leaves the database as it was.
"""

import os
from contextlib import suppress
from typing import Any

import sqlalchemy as sa
from alembic import context
from alembic.util import CommandError
from sqlalchemy.exc import DBAPIError

from kbstore.storage import tables
from kbstore.storage.engine import make_engine
from kbstore.storage.schema import connecting
from kbstore.storage.schema_objects import VERSION_TABLE, version_table

LOCK = 0x6B6273746F7265
"""The advisory lock of a migration on PostgreSQL: "kbstore" in ASCII."""


def main() -> None:
    """Run the command of alembic on the connection that was passed to it, or on the database that is named."""
    handed: sa.Connection | None = context.config.attributes.get("connection")
    if handed is not None:
        migrate(handed, context.config.attributes.get("schema"))
        return
    named = context.get_x_argument(as_dictionary=True)
    url = named.get("url") or os.environ.get("KBSTORE_URL")
    schema = named.get("schema") or os.environ.get("KBSTORE_SCHEMA")
    if not url:
        raise CommandError("name the database: alembic -x url=sqlite:///kenny.db ..., or set KBSTORE_URL")
    engine = make_engine(url)
    if context.is_offline_mode():
        write_script(engine, schema)
        return
    try:
        with connecting(engine) as connection:
            migrate(connection, schema)
    finally:
        engine.dispose()


def migrate(connection: sa.Connection, schema: str | None) -> None:
    """Run the steps in one transaction, on a connection in autocommit mode; without a step, roll it back."""
    sqlite = connection.dialect.name == "sqlite"
    steps: list[Any] = []
    enforced = sqlite and connection.exec_driver_sql("PRAGMA foreign_keys").scalar()
    if sqlite:
        # within a transaction this setting has no effect
        connection.exec_driver_sql("PRAGMA foreign_keys = OFF")
    try:
        begin(connection, schema)
        configure(connection.dialect, connection=connection, on_version_apply=lambda step, **_: steps.append(step))
        before = count_rows(connection)
        context.run_migrations()
        if steps:
            refuse_losses(connection, before)
        connection.exec_driver_sql("COMMIT" if steps else "ROLLBACK")
    except BaseException:
        # the driver may have rolled back by itself, or have lost the connection
        with suppress(DBAPIError):
            connection.exec_driver_sql("ROLLBACK")
        raise
    finally:
        if enforced:
            connection.exec_driver_sql("PRAGMA foreign_keys = ON")


def begin(connection: sa.Connection, schema: str | None) -> None:
    """Begin the transaction after any other migration; from here on names refer to the schema, if given."""
    if connection.dialect.name == "sqlite":
        connection.exec_driver_sql("BEGIN IMMEDIATE")
        return
    connection.exec_driver_sql("BEGIN")
    connection.execute(sa.text("SELECT pg_advisory_xact_lock(:key)"), {"key": LOCK})
    if schema is None:
        return
    quoted = connection.dialect.identifier_preparer.quote_identifier(schema)
    # looked up first, as IF NOT EXISTS would need the right to create schemas even if it exists
    if not connection.execute(sa.text("SELECT 1 FROM pg_namespace WHERE nspname = :name"), {"name": schema}).scalar():
        connection.exec_driver_sql(f"CREATE SCHEMA {quoted}")
    connection.exec_driver_sql(f"SET LOCAL search_path TO {quoted}")


def count_rows(connection: sa.Connection) -> dict[str, int]:
    """Count the rows of each of kbstore's tables that exist."""
    existing = set(sa.inspect(connection).get_table_names()) & tables.metadata.tables.keys()
    count = sa.select(sa.func.count())
    return {name: connection.execute(count.select_from(sa.table(name))).scalar_one() for name in sorted(existing)}


def refuse_losses(connection: sa.Connection, before: dict[str, int]) -> None:
    """Raise `CommandError` if a table that is still there has fewer rows than before, or a row refers to none."""
    after = count_rows(connection)
    lost = [f"{name}: {before[name] - after[name]}" for name in before if after.get(name, before[name]) < before[name]]
    if lost:
        raise CommandError(f"undone, because rows would have been lost ({', '.join(lost)})")
    if connection.dialect.name == "sqlite":
        broken = connection.exec_driver_sql("PRAGMA foreign_key_check").all()
        if broken:
            found = sorted({f"{table} to {referred}" for table, _, referred, _ in broken})
            raise CommandError(f"undone, because rows refer to none: {', '.join(found)}")


def write_script(engine: sa.Engine, schema: str | None) -> None:
    """Write the SQL (`--sql`) of the steps, to be run by the database's own client."""
    configure(engine.dialect, dialect_name=engine.dialect.name, literal_binds=True)
    with context.begin_transaction():
        if engine.dialect.name != "sqlite":
            context.execute(f"SELECT pg_advisory_xact_lock({LOCK})")
        if schema is not None:
            quoted = engine.dialect.identifier_preparer.quote_identifier(schema)
            context.execute(f"CREATE SCHEMA IF NOT EXISTS {quoted}")
            context.execute(f"SET LOCAL search_path TO {quoted}")
        context.run_migrations()


def configure(dialect: sa.Dialect, **mode: Any) -> None:
    """Configure alembic, with its options for a mode and those for every mode."""
    context.configure(
        target_metadata=tables.metadata,
        version_table=VERSION_TABLE,
        transactional_ddl=True,
        # a service's own tables in the same database are left alone
        include_name=lambda name, kind, _: kind != "table" or name in tables.metadata.tables,
        process_revision_directives=number_revision,
        # SQLite alters a table by creating it again
        render_as_batch=dialect.name == "sqlite",
        **mode,
    )
    # alembic's own has a column of a generic type, for which the host may have a compile rule
    context.get_context()._version = version_table


def number_revision(_context: Any, _revision: Any, directives: list[Any]) -> None:
    """Give a new revision the next number of four digits."""
    directives[0].rev_id = f"{int(context.script.get_current_head() or 0) + 1:04d}"


main()
