"""Checking, and setting up, the schema of a database when it is opened."""

import inspect
import shutil
import sqlite3

import pytest
import sqlalchemy as sa

import kbstore
from kbstore.errors import SchemaOutOfDate, SchemaTooNew, SchemaUnknown, StoreUnavailable
from kbstore.storage import blank_store, schema, schema_objects, tables
from kbstore.storage.engine import make_engine
from tests.migration import rows_0001


def stamp(engine, revision):
    with engine.begin() as connection:
        connection.execute(sa.text(f"UPDATE {schema.VERSION_TABLE} SET version_num = :new"), {"new": revision})


def test_an_empty_database_is_set_up(engine):
    """An empty database gets the whole schema by the migrations, and is left alone the next time."""
    schema.ensure(engine, read_only=False)
    assert tables.metadata.tables.keys() | {"fact_history", "current_goals"} <= rows_0001.objects(engine)
    before = rows_0001.objects(engine)
    schema.ensure(engine, read_only=False)
    schema.ensure(engine, read_only=True)
    assert rows_0001.objects(engine) == before


@pytest.mark.parametrize("place", [(schema, "_taken"), (sa, "inspect")])
def test_a_database_that_another_process_sets_up_meanwhile(engine, monkeypatch, place):
    """At whichever query of the check the other process is done, the store is opened like an existing one."""
    owner, name = place
    look = getattr(owner, name)

    def looking(*arguments):
        monkeypatch.undo()
        schema.upgrade(engine.url)
        return look(*arguments)

    monkeypatch.setattr(owner, name, looking)
    schema.ensure(engine, read_only=False)
    assert getattr(owner, name) is look
    assert schema.current(engine.url) == schema.HEAD


@pytest.fixture(params=["memory", "file"])
def new_engine(request, tmp_path):
    """Makes engines on empty SQLite databases."""
    made = []

    def make():
        place = "sqlite://" if request.param == "memory" else tmp_path / f"{len(made)}.db"
        made.append(make_engine(place))
        return made[-1]

    yield make
    for engine in made:
        engine.dispose()


def test_each_sqlite_store_gets_the_same_schema(new_engine):
    """It has all tables, indexes and views of the migrations, also for a second store of the process."""
    found = []
    for _ in range(2):
        engine = new_engine()
        schema.ensure(engine, read_only=False)
        found.append(rows_0001.objects(engine))
        with engine.connect() as connection:
            assert schema_objects.is_as_migrated(connection)
            stamps = connection.exec_driver_sql(f"SELECT version_num FROM {schema.VERSION_TABLE}").scalars().all()
            assert stamps == [schema.HEAD]
    assert found[0] == found[1] >= tables.metadata.tables.keys()


def test_a_store_created_meanwhile_keeps_its_data(tmp_path, monkeypatch):
    """A store that another process creates right before the lock is taken keeps its data."""
    path, other = tmp_path / "store.db", tmp_path / "other.db"
    with kbstore.open(other, "first") as kb:
        kb.add("(here)")
    look = blank_store.is_empty

    def look_too_early(driver):
        was_empty = look(driver)
        if not driver.in_transaction:
            shutil.copyfile(other, path)
        return was_empty

    monkeypatch.setattr(blank_store, "is_empty", look_too_early)
    with kbstore.open(path, "first") as kb:
        assert kb.holds("(here)")


def test_a_file_without_room_for_the_schema_stays_empty(tmp_path):
    """A disk that becomes full while the schema is created leaves nothing of it."""
    kbstore.open("sqlite://").close()
    engine = make_engine(tmp_path / "store.db")
    sa.event.listen(engine, "connect", lambda driver, _: driver.execute("PRAGMA max_page_count = 20"))
    with pytest.raises(StoreUnavailable, match="disk is full; nothing has been changed"):
        schema.ensure(engine, read_only=False)
    assert not rows_0001.objects(engine)
    engine.dispose()


def test_a_services_own_tables_are_not_touched(new_engine):
    """A store beside a service's tables is created without touching them, and no other store gets them."""
    for _ in range(2):
        engine = new_engine()
        with engine.begin() as connection:
            connection.exec_driver_sql("CREATE TABLE missions (id INTEGER)")
            connection.exec_driver_sql("INSERT INTO missions VALUES (1)")
        schema.ensure(engine, read_only=False)
        with engine.connect() as connection:
            assert connection.exec_driver_sql("SELECT id FROM missions").scalars().all() == [1]
    empty = new_engine()
    schema.ensure(empty, read_only=False)
    assert "missions" not in rows_0001.objects(empty)


def test_opening_again_is_cheap():
    """Checking a current schema needs two queries: for its revision, and for its statements."""
    engine = make_engine("sqlite://")
    schema.ensure(engine, read_only=False)
    statements = []
    sa.event.listen(engine, "before_cursor_execute", lambda _c, _cursor, statement, *_: statements.append(statement))
    schema.ensure(engine, read_only=False)
    assert len(statements) == 2
    engine.dispose()


def test_an_older_schema_is_refused(engine):
    """An older schema is not upgraded by opening; the refusal names both revisions and the command."""
    schema.upgrade(engine.url, "0001")
    before = rows_0001.objects(engine)
    with pytest.raises(SchemaOutOfDate, match=rf"schema 0001.*{schema.HEAD}.*kbstore db upgrade --url"):
        schema.ensure(engine, read_only=False)
    assert rows_0001.objects(engine) == before


def test_a_newer_schema_is_refused(engine):
    """A number of four digits above this kbstore's revision is a newer schema, which is not written to."""
    schema.upgrade(engine.url)
    stamp(engine, "0999")
    with pytest.raises(SchemaTooNew, match=rf"0999.*{schema.HEAD}.*kbstore db downgrade {schema.HEAD}"):
        schema.ensure(engine, read_only=False)
    with pytest.raises(SchemaTooNew):
        schema.upgrade(engine.url)


@pytest.mark.parametrize("revision", ["0000", "a1b2c3d4e5f6", "12345", ""])
def test_an_unknown_schema_is_refused(engine, revision):
    """An unknown stamp is refused, naming it and this kbstore's revision."""
    schema.upgrade(engine.url)
    stamp(engine, revision)
    with pytest.raises(SchemaUnknown, match=rf"'{revision}'.*{schema.HEAD}.*kbstore db history"):
        schema.ensure(engine, read_only=False)
    with pytest.raises(SchemaUnknown):
        schema.upgrade(engine.url)


def test_two_stamps_are_refused(engine):
    """A version table with two rows was not written by kbstore."""
    schema.upgrade(engine.url)
    with engine.begin() as connection:
        connection.exec_driver_sql(f"INSERT INTO {schema.VERSION_TABLE} VALUES ('0001')")
    with pytest.raises(SchemaUnknown):
        schema.ensure(engine, read_only=False)
    with pytest.raises(SchemaUnknown):
        schema.current(engine.url)


def test_tables_of_another_program_under_our_names_are_refused(engine):
    """A table with one of kbstore's names, without kbstore's stamp, belongs to another program."""
    with engine.begin() as connection:
        connection.exec_driver_sql("CREATE TABLE transactions (amount INTEGER)")
    for refused in (
        lambda: schema.ensure(engine, read_only=False),
        lambda: schema.upgrade(engine.url),
        lambda: schema.current(engine.url),
        lambda: schema.check(engine.url),
    ):
        way_out = "schema='kbstore'" if engine.dialect.name == "postgresql" else "a file of its own"
        with pytest.raises(SchemaUnknown, match=f"somebody else .*: transactions; .*{way_out}"):
            refused()


def test_a_services_own_tables_stay(engine):
    """A database with a service's own tables and migrations counts as empty, and keeps them."""
    with engine.begin() as connection:
        connection.exec_driver_sql("CREATE TABLE alembic_version (version_num VARCHAR(32))")
        connection.exec_driver_sql("INSERT INTO alembic_version VALUES ('feedbeef')")
        connection.exec_driver_sql("CREATE TABLE missions (id INTEGER)")
    schema.ensure(engine, read_only=False)
    schema.downgrade(engine.url, "base")
    with engine.connect() as connection:
        assert connection.exec_driver_sql("SELECT version_num FROM alembic_version").all() == [("feedbeef",)]
        assert connection.exec_driver_sql("SELECT count(*) FROM missions").scalar() == 0
    schema.ensure(engine, read_only=False)


def test_an_empty_database_is_not_set_up_read_only(engine):
    """Opened read-only, an empty database stays empty; the refusal says how to set it up."""
    engine.connect().close()
    with pytest.raises(SchemaOutOfDate, match=r"no schema yet.*kbstore db upgrade"):
        schema.ensure(engine, read_only=True)
    assert not rows_0001.objects(engine)


def test_reading_does_not_create_a_file(sqlite_file):
    """Asking about a store that does not exist creates no file."""
    engine = make_engine(sqlite_file)
    with pytest.raises(StoreUnavailable, match="no store at"):
        schema.ensure(engine, read_only=True)
    with pytest.raises(StoreUnavailable, match="no store at"):
        schema.current(sqlite_file)
    assert not sqlite_file.exists()


def test_a_file_that_is_not_a_database_is_refused(sqlite_file):
    """A file of another kind is `StoreUnavailable`, and stays as it is."""
    sqlite_file.write_bytes(b"(define (domain d))" * 100)
    with pytest.raises(StoreUnavailable, match="not a database"):
        schema.ensure(make_engine(sqlite_file), read_only=False)
    assert sqlite_file.read_bytes() == b"(define (domain d))" * 100


def test_check_waits_for_the_upgrade_of_another_process(sqlite_file, monkeypatch):
    """`check` with a timeout returns as soon as the schema is current, and raises after the timeout."""
    sqlite3.connect(sqlite_file).close()
    with pytest.raises(SchemaOutOfDate):
        schema.check(sqlite_file, wait=0.01)
    schema.upgrade(sqlite_file)
    monkeypatch.setattr(schema.time, "sleep", lambda _: pytest.fail("it is current, there is nothing to wait for"))
    schema.check(sqlite_file, wait=60)


def test_a_schema_of_its_own_on_postgresql(postgresql_url):
    """With a schema name, kbstore uses that schema, created if missing; nothing else is touched."""
    name = "Fleet of robots"
    engine = make_engine(postgresql_url)
    with engine.connect() as connection:
        before = sa.inspect(connection).get_table_names(schema="public")
    done = schema.upgrade(postgresql_url, schema=name)
    assert (done.before, done.after) == (None, schema.HEAD)
    assert schema.current(postgresql_url, schema=name) == schema.HEAD
    schema.check(postgresql_url, schema=name)
    own = make_engine(schema.in_schema(postgresql_url, name))
    schema.ensure(own, read_only=False)
    with engine.begin() as connection:
        inspector = sa.inspect(connection)
        assert set(inspector.get_table_names(schema=name)) == {*tables.metadata.tables, schema.VERSION_TABLE}
        assert inspector.get_table_names(schema="public") == before
        connection.exec_driver_sql(f'DROP SCHEMA "{name}" CASCADE')
    own.dispose()
    engine.dispose()


def test_a_schema_is_postgresqls(sqlite_file):
    """SQLite has no schemas: asking for one is refused."""
    with pytest.raises(StoreUnavailable, match="PostgreSQL"):
        schema.upgrade(sqlite_file, schema="fleet")


@pytest.mark.parametrize("kind", ["url", "engine"])
def test_a_knowledge_base_in_a_schema(postgresql_url, kind, tmp_path):
    """`kbstore.open(..., schema=...)` creates the schema and uses it, also on a caller's engine.

    It sets no search path, so all of its statements name the schema; another schema is another store.
    """
    name = f'Fleet "100%" of {kind}'
    options = {"options": "-c search_path=pg_catalog"}
    engine = sa.create_engine(postgresql_url, connect_args=options)
    place = engine if kind == "engine" else engine.url.update_query_dict(options)
    with kbstore.open(place, "kenny", schema=name) as kb, kbstore.open(place, "kenny", schema=f"{name} 2") as other:
        kb.load(
            "(define (domain d) (:types room) (:predicates (open ?r - room)) (:functions (n))"
            " (:durative-action tidy :parameters (?r - room) :duration (= ?duration 10)"
            "  :condition (over all (open ?r)) :effect (and (at end (not (open ?r))) (increase (n) (* #t 1)))))"
        )
        kb.add("hall - room", "(open hall)", "(= (n) 1)", "(not (open hall))")
        kb.add("(open hall)", "(= (n) 2)")
        kb.add_goal("(open hall)")
        kb.add_metric("minimize (n)")
        kb.add("(not (open hall))", initial_time=kb.now() + kbstore.seconds(60))
        run = kb.start("tidy", "hall")
        kb.remove("(not (open hall))", initial_time=kb.now() + kbstore.seconds(60))
        kb.end(run)
        assert not kb.holds("(open hall)")
        assert kb.state().goals
        assert len(kb.history("(open ?)")) > 2
        assert len(list(kb.changes())) == 8
        assert kb.when("(open hall)", since=0, until=kb.now())
        assert kb.explain("(open hall)")
        assert kbstore.knowledge_bases(place, schema=name) == ["kenny"]
        assert other.state().facts == []
        other.add("(p)")
        assert "(p)" not in map(str, kb.state().facts)
        with kbstore.open(place, "kenny", schema=name, read_only=True) as reader:
            assert reader.value("(n)") >= 2
        assert kb.archive(kb.add("(open hall)").time, tmp_path / "archive.db").rows
    with engine.connect() as connection:
        assert connection.exec_driver_sql("SHOW search_path").scalar() == "pg_catalog"
        connection.rollback()
        for each in (name, f"{name} 2"):
            quoted = engine.dialect.identifier_preparer.quote_identifier(each)
            connection.exec_driver_sql(f"DROP SCHEMA {quoted} CASCADE")
        connection.commit()
    engine.dispose()


def test_a_schema_in_the_url(postgresql_url, tmp_path):
    """`?schema=...` equals `schema=`: every function that takes a URL uses it, and creates nothing elsewhere."""
    url = f"{postgresql_url}{'&' if '?' in postgresql_url else '?'}schema=in_the_url"
    with kbstore.open(url, "kenny") as kb:
        kb.add("(here)")
    assert schema.current(url) == schema.HEAD
    schema.check(url)
    assert kbstore.knowledge_bases(url) == ["kenny"] == kbstore.knowledge_bases(postgresql_url, schema="in_the_url")
    kbstore.export_knowledge_base(url, "kenny", tmp_path / "kenny.jsonl")
    assert kbstore.import_knowledge_base(url, tmp_path / "kenny.jsonl", "ken") == "ken"
    assert kbstore.knowledge_bases(kbstore.backup(url, tmp_path / "copy.db")) == ["ken", "kenny"]
    with kbstore.open(url, "ken", read_only=True) as kb:
        assert kb.holds("(here)")
    with kbstore.open("sqlite://", "robot") as robot:
        robot.add("(there)")
        assert kbstore.push(robot, url).number == 1
    assert kbstore.knowledge_bases(url) == ["ken", "kenny", "robot"]
    public = {name: getattr(kbstore, name) for name in kbstore.__all__}
    assert {
        name
        for name, function in public.items()
        if inspect.isfunction(function) and "url" in inspect.signature(function).parameters
    } == {"open", "knowledge_bases", "backup", "export_knowledge_base", "import_knowledge_base", "push"}
    with pytest.raises(StoreUnavailable, match="schemas are PostgreSQL's"):
        kbstore.open(f"sqlite:///{tmp_path / 'file.db'}?schema=fleet")
    engine = sa.create_engine(postgresql_url)
    with engine.begin() as connection:
        connection.exec_driver_sql("DROP SCHEMA in_the_url CASCADE")
    engine.dispose()


def test_a_database_that_rounds_numbers(empty_database):
    """A server that returns 0.3 where 0.1 + 0.2 is stored is refused, by a URL and on an engine, with what to do."""
    engine = sa.create_engine(empty_database)
    with kbstore.open(engine) as kb:
        kb.add(f"(= (f) {0.1 + 0.2!r})")
    with engine.begin() as connection:
        connection.exec_driver_sql(f'ALTER DATABASE "{engine.url.database}" SET extra_float_digits = 0')
    engine.dispose()
    for place in (empty_database, engine):
        with pytest.raises(StoreUnavailable, match=r"come back rounded; set it to 1: ALTER DATABASE"):
            kbstore.open(place)
    engine.dispose()


def test_a_connection_with_another_encoding(empty_database, monkeypatch):
    """Connections by a URL use UTF-8 in any environment; an engine with another encoding is refused."""
    monkeypatch.setenv("PGCLIENTENCODING", "LATIN1")
    with kbstore.open(empty_database) as kb:
        kb.add("(p)", note="雪")
        assert [change.transaction.note for change in kb.changes()] == ["雪"]
    engine = sa.create_engine(empty_database)
    with pytest.raises(StoreUnavailable, match=r"iso8859-1.*client_encoding=utf8"):
        kbstore.open(engine)
    engine.dispose()


def test_a_database_without_an_encoding(postgresql_url):
    """A database in SQL_ASCII, which returns text as bytes, is refused in one sentence."""
    admin = sa.create_engine(postgresql_url, isolation_level="AUTOCOMMIT")
    with admin.connect() as connection:
        connection.exec_driver_sql(
            "CREATE DATABASE bytes ENCODING 'SQL_ASCII' LC_COLLATE 'C' LC_CTYPE 'C' TEMPLATE template0"
        )
        try:
            with pytest.raises(StoreUnavailable, match=r"SQL_ASCII.*ENCODING 'UTF8'"):
                kbstore.open(admin.url.set(database="bytes"))
            own = sa.create_engine(admin.url.set(database="bytes"))
            with pytest.raises(StoreUnavailable, match=r"SQL_ASCII.*ENCODING 'UTF8'"):
                kbstore.open(own)
            own.dispose()
        finally:
            connection.exec_driver_sql("DROP DATABASE bytes WITH (FORCE)")
    admin.dispose()


def test_functions_of_a_file_from_elsewhere_are_not_run(sqlite_file):
    """A view that calls a function of the process is not evaluated in a store of unknown origin."""
    kbstore.open(sqlite_file).close()
    with kbstore.open(sqlite_file) as kb, kb._database.connect() as connection:
        connection.driver.create_function("harm", 0, lambda: 1)
        connection.driver.execute("CREATE VIEW trap AS SELECT harm()")
        with pytest.raises(sqlite3.OperationalError, match="unsafe use of harm"):
            connection.driver.execute("SELECT * FROM trap")


def test_no_schema_on_sqlite_when_opening(sqlite_file):
    """SQLite has no schemas: a schema is refused, and no file is created."""
    for place in (sqlite_file, sa.create_engine(f"sqlite:///{sqlite_file}")):
        with pytest.raises(StoreUnavailable, match="schemas are PostgreSQL's"):
            kbstore.open(place, schema="fleet")
    assert not sqlite_file.exists()


def test_the_names_of_views(engine):
    """The views of a new store are those whose names are looked for in other programs' databases."""
    schema.ensure(engine, read_only=False)
    with engine.connect() as connection:
        assert set(sa.inspect(connection).get_view_names()) == set(schema.VIEWS)


def test_a_store_beside_a_services_own_tables(engine):
    """A service and kbstore share a database: each has its tables, and continues to use them."""
    with engine.begin() as connection:
        connection.exec_driver_sql("CREATE TABLE orders (id INTEGER PRIMARY KEY, item TEXT)")
        connection.exec_driver_sql("INSERT INTO orders VALUES (1, 'cup')")
    with kbstore.open(engine, "beside") as kb:
        kb.add("(ordered cup)")
        assert kb.holds("(ordered cup)")
    with engine.begin() as connection:
        assert connection.exec_driver_sql("SELECT item FROM orders").scalars().all() == ["cup"]
        assert kbstore.knowledge_bases(engine.url) == ["beside"]
