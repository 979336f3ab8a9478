"""The sum of all migrations is the schema that the program reads and writes."""

import re

import sqlalchemy as sa
from alembic.autogenerate import compare_metadata
from alembic.migration import MigrationContext

from kbstore.storage import schema, tables
from tests.conftest import fresh_schema


def statements(engine):
    """The statements that SQLite stores for its tables and indexes."""
    with engine.connect() as connection:
        rows = connection.exec_driver_sql(
            "SELECT name, sql FROM sqlite_master WHERE sql IS NOT NULL AND type <> 'view' AND name <> ?",
            (schema.VERSION_TABLE,),
        )
        return {name: re.sub(r"\s+", " ", sql) for name, sql in rows}


def catalogue(engine):
    """The columns, indexes and constraints of the current schema in PostgreSQL's catalogue."""
    questions = (
        "SELECT table_name, column_name, data_type, is_nullable, collation_name, column_default"
        " FROM information_schema.columns c JOIN information_schema.tables t USING (table_schema, table_name)"
        " WHERE table_schema = current_schema() AND table_type = 'BASE TABLE' AND table_name <> :version",
        "SELECT tablename, indexname, indexdef FROM pg_indexes"
        " WHERE schemaname = current_schema() AND tablename <> :version",
        "SELECT conrelid::regclass::text, conname, pg_get_constraintdef(oid) FROM pg_constraint"
        " WHERE connamespace = to_regnamespace(current_schema()) AND conrelid::regclass::text <> :version",
    )
    with engine.connect() as connection:
        name = connection.exec_driver_sql("SELECT current_schema()").scalar_one()
        found = set()
        for question in questions:
            for row in connection.execute(sa.text(question), {"version": schema.VERSION_TABLE}):
                found.add(tuple(str(value).replace(f"{name}.", "") for value in row))
        return found


def test_migrations_make_the_tables_of_the_metadata_on_sqlite(sqlite_file):
    """Every table and index that the migrations make is, to the letter, the one that the metadata declares."""
    schema.upgrade(sqlite_file)
    migrated = sa.create_engine(f"sqlite:///{sqlite_file}")
    declared = sa.create_engine("sqlite://")
    tables.metadata.create_all(declared)
    assert statements(migrated) == statements(declared)
    migrated.dispose()
    declared.dispose()


def test_migrations_make_the_tables_of_the_metadata_on_postgresql(postgresql_url, empty_schema):
    """PostgreSQL's catalogue is the same for the migrated schema as for the declared one."""
    schema.upgrade(empty_schema)
    migrated = sa.create_engine(empty_schema)
    with fresh_schema(postgresql_url, "declared") as url:
        declared = sa.create_engine(url)
        tables.metadata.create_all(declared)
        assert catalogue(migrated) == catalogue(declared)
        declared.dispose()
    migrated.dispose()


def test_alembic_finds_nothing_to_change(engine):
    """Alembic's own comparison agrees, on both engines."""
    schema.upgrade(engine.url)
    with engine.connect() as connection:
        options = {"version_table": schema.VERSION_TABLE}
        assert compare_metadata(MigrationContext.configure(connection, opts=options), tables.metadata) == []


def test_revisions_are_numbered():
    """Revisions are four digits in sequence, and the last one is the schema that the program needs."""
    numbers = [revision.number for revision in schema.history()]
    assert numbers == [f"{n:04d}" for n in range(1, len(numbers) + 1)]
    assert numbers[-1] == schema.HEAD
