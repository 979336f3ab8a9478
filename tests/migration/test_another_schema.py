"""A store that has kbstore's revision, and was made or changed by another program, is refused in one sentence."""

import pytest
import sqlalchemy as sa

import kbstore
from kbstore.errors import SchemaUnknown
from kbstore.storage import schema, schema_objects
from kbstore.storage.engine import make_engine

BOTH = {
    "CREATE INDEX ix_more ON facts (kb_id, end_cause)": "it has index ix_more",
    "DROP INDEX ix_facts_begin": "it lacks index ix_facts_begin",
    "ALTER TABLE facts ADD COLUMN weather TEXT": "it has column facts.weather",
    "ALTER TABLE transactions RENAME COLUMN note TO remark": "lacks column transactions.note .*has column .*remark",
    "DROP VIEW current_facts": "it lacks view current_facts",
    "DROP TABLE revisions": "it lacks .*revisions",
}
"""Changes of a store that both engines allow, and the words of the refusal."""

SQLITE = {
    "CREATE TRIGGER t AFTER INSERT ON transactions BEGIN DELETE FROM facts; END": "it has trigger t on transactions",
    "CREATE TRIGGER t INSTEAD OF INSERT ON fact_history BEGIN SELECT 1; END": "it has trigger t on fact_history",
    "DROP VIEW current_goals; CREATE VIEW current_goals AS SELECT 1": "lacks view current_goals, and it has view",
    "DROP INDEX ix_facts_end; CREATE INDEX ix_facts_end ON facts (kb_id, level, end_time)": "index ix_facts_end",
}

POSTGRESQL = {
    "CREATE FUNCTION f() RETURNS trigger LANGUAGE plpgsql AS 'BEGIN RETURN NEW; END';"
    "CREATE TRIGGER t BEFORE INSERT ON facts FOR EACH ROW EXECUTE FUNCTION f()": "it has trigger t on facts",
    "CREATE RULE r AS ON DELETE TO facts DO INSTEAD NOTHING": "it has rule r on facts",
    "ALTER TABLE functions ALTER COLUMN rate TYPE real": "functions.rate real",
    'ALTER TABLE symbols ALTER COLUMN key TYPE text COLLATE "POSIX"': 'it has column symbols.key text COLLATE "POSIX"',
    "ALTER TABLE revisions SET UNLOGGED": "it has unlogged table revisions",
    "ALTER TABLE facts ADD CHECK (seq < 5)": "it has constraint facts_seq_check of facts",
    "ALTER TABLE facts DROP CONSTRAINT fk_facts_timelines": "it lacks foreign key fk_facts_timelines of facts",
    "ALTER TABLE facts DROP CONSTRAINT fk_facts_timelines, ADD CONSTRAINT fk_facts_timelines FOREIGN KEY"
    " (kb_id, timeline_id) REFERENCES timelines (kb_id, id) ON DELETE CASCADE": "facts to timelines that deletes",
    "ALTER TABLE runs DROP CONSTRAINT pk_runs, ADD CONSTRAINT pk_runs PRIMARY KEY (kb_id, number)"
    " DEFERRABLE": "it has index pk_runs",
}


@pytest.fixture(params=["sqlite", "postgresql"])
def engine(request):
    """An engine for a store of this kbstore."""
    url = f"sqlite:///{request.getfixturevalue('sqlite_file')}"
    engine = make_engine(url if request.param == "sqlite" else request.getfixturevalue("empty_schema"))
    kbstore.open(engine.url).close()
    yield engine
    engine.dispose()


def change(engine, statements):
    with engine.begin() as connection:
        for statement in statements.split("; " if "BEGIN" not in statements else "\0"):
            connection.exec_driver_sql(statement)


@pytest.mark.parametrize("statements", BOTH)
def test_another_schema_is_refused(engine, statements):
    """Tables, columns, indexes and views are compared, on both engines; the sentence names the differences."""
    change(engine, statements)
    for opening in (lambda: kbstore.open(engine.url), lambda: kbstore.open(engine), lambda: schema.check(engine.url)):
        with pytest.raises(
            SchemaUnknown, match=f"the revision {schema.HEAD}, and not the schema of it.*{BOTH[statements]}"
        ):
            opening()


@pytest.mark.parametrize("statements", SQLITE)
def test_foreign_code_on_sqlite_is_refused(sqlite_file, statements):
    """A trigger that is not kbstore's, and another statement under the name of a view or an index."""
    engine = make_engine(sqlite_file)
    kbstore.open(sqlite_file).close()
    change(engine, statements)
    with pytest.raises(SchemaUnknown, match=SQLITE[statements]):
        kbstore.open(sqlite_file, read_only=True)
    engine.dispose()


@pytest.mark.parametrize("statements", POSTGRESQL)
def test_foreign_code_on_a_server_is_refused(empty_schema, statements):
    """A trigger, a rule or a constraint that is not kbstore's, and a column of another type or order."""
    engine = make_engine(empty_schema)
    kbstore.open(empty_schema).close()
    # a view keeps the type of its columns
    change(engine, "DROP VIEW current_functions; DROP VIEW function_history; " * ("TYPE" in statements) + statements)
    with pytest.raises(SchemaUnknown, match=POSTGRESQL[statements]):
        kbstore.open(empty_schema)
    engine.dispose()


def test_an_index_may_be_built_again_meanwhile(empty_schema):
    """An index that REINDEX CONCURRENTLY has half built, or left after a failure, does not prevent opening."""
    engine = make_engine(empty_schema)
    kbstore.open(empty_schema).close()
    change(engine, "CREATE INDEX ix_facts_begin_ccnew1 ON facts (kb_id, level, initial_time)")
    with pytest.raises(SchemaUnknown, match="it has index ix_facts_begin_ccnew1"):
        kbstore.open(empty_schema)
    change(engine, "UPDATE pg_index SET indisvalid = false WHERE indexrelid = 'ix_facts_begin_ccnew1'::regclass")
    kbstore.open(empty_schema).close()
    change(engine, "UPDATE pg_index SET indisvalid = false WHERE indexrelid = 'ix_facts_begin'::regclass")
    with pytest.raises(SchemaUnknown, match="it lacks index ix_facts_begin, and it has index ix_facts_begin"):
        kbstore.open(empty_schema)
    engine.dispose()


def test_a_view_that_calls_a_function_is_refused(empty_schema):
    """A view runs with the rights of its reader: on a server it may read kbstore's tables, and call no functions."""
    engine = make_engine(empty_schema)
    kbstore.open(empty_schema).close()
    change(engine, "CREATE FUNCTION g() RETURNS int LANGUAGE sql AS 'SELECT 1'")
    change(engine, "DROP VIEW current_goals; CREATE VIEW current_goals AS SELECT g() AS goal")
    with pytest.raises(SchemaUnknown, match="it has view current_goals"):
        kbstore.open(empty_schema)
    engine.dispose()


def test_tables_of_others_are_ignored(engine):
    """A service's own tables, indexes, views and triggers may exist beside kbstore's."""
    change(engine, "CREATE TABLE orders (id INTEGER, item TEXT); CREATE INDEX ix_orders ON orders (item)")
    change(engine, "CREATE VIEW facts_and_orders AS SELECT item FROM orders")
    if engine.dialect.name == "sqlite":
        change(engine, "CREATE TRIGGER o AFTER INSERT ON orders BEGIN DELETE FROM orders; END")
    with kbstore.open(engine.url, "beside") as kb:
        kb.add("(here)")


def test_the_hash_is_that_of_the_migrations(sqlite_file):
    """The stored hash is that of the schema which the migrations make, in any number of steps."""
    schema.upgrade(sqlite_file, "0001")
    schema.upgrade(sqlite_file)
    engine = make_engine(sqlite_file)
    with engine.connect() as connection:
        assert schema_objects.is_as_migrated(connection)
    engine.dispose()


def test_white_space_does_not_matter(sqlite_file):
    """Where only white space in the statements differs, columns, indexes and views are compared one by one."""
    kbstore.open(sqlite_file).close()
    engine = make_engine(sqlite_file)
    with engine.connect() as connection:
        connection.exec_driver_sql("PRAGMA writable_schema = ON")
        connection.exec_driver_sql("UPDATE sqlite_master SET sql = replace(sql, 'CREATE TABLE', 'create table')")
        connection.commit()
    with engine.connect() as connection:
        assert not schema_objects.is_as_migrated(connection)
    kbstore.open(sqlite_file).close()
    engine.dispose()


def test_a_foreign_key_that_deletes_rows(sqlite_file):
    """In an SQLite file, too, foreign keys are compared with their actions."""
    kbstore.open(sqlite_file).close()
    engine = make_engine(sqlite_file)
    with engine.connect() as connection:
        connection.exec_driver_sql("PRAGMA writable_schema = ON")
        connection.exec_driver_sql(
            "UPDATE sqlite_master SET sql = replace(sql, 'timelines (kb_id, id)', 'timelines (kb_id, id) ON DELETE"
            " CASCADE') WHERE name = 'facts'"
        )
        connection.commit()
    with pytest.raises(SchemaUnknown, match=r"it has foreign key facts.* to timelines.* ON DELETE CASCADE"):
        kbstore.open(sqlite_file)
    engine.dispose()


def test_the_schema_is_checked_once_for_a_pool(empty_schema):
    """On a server the catalogue is read once for each engine."""
    engine = sa.create_engine(empty_schema)
    for _ in range(2):
        # the first one sets the schema up
        kbstore.open(engine).close()
    asked = []
    sa.event.listen(engine, "before_cursor_execute", lambda _c, _cursor, text, *_: asked.append("pg_index" in text))
    kbstore.open(engine).close()
    assert asked
    assert not any(asked)
    engine.dispose()
