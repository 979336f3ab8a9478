"""Connections: their settings, their owners, and the translation of driver errors."""

import re
import sqlite3
import threading
import time
from concurrent.futures import ThreadPoolExecutor

import psycopg
import pytest
import sqlalchemy as sa
from sqlalchemy.pool import SingletonThreadPool, StaticPool

import kbstore
from kbstore.errors import InvalidKnowledge, StoreUnavailable
from kbstore.storage.database import Database
from kbstore.storage.driver_errors import unavailable
from kbstore.storage.engine import make_engine
from kbstore.storage.statements import Statement

PRAGMAS = (
    *("journal_mode", "synchronous", "foreign_keys", "busy_timeout", "query_only"),
    *("trusted_schema", "journal_size_limit"),
)


@pytest.fixture
def path(tmp_path):
    """Where a store in a file is made."""
    return tmp_path / "store.db"


def pragmas(driver):
    return {name: driver.execute(f"PRAGMA {name}").fetchone()[0] for name in PRAGMAS}


def settings(driver):
    names = ("synchronous_commit", "lock_timeout", "default_transaction_read_only")
    return {name: driver.execute(f"SHOW {name}").fetchone()[0] for name in names}


# -- settings -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("durability", "synchronous"), [("full", 2), ("normal", 1)])
def test_durability_is_sqlites_synchronous(path, durability, synchronous):
    """A file is in WAL mode with foreign keys; "full" waits for the disk at each commit, "normal" at checkpoints."""
    with kbstore.open(path, durability=durability, busy_timeout=2.5) as kb, kb._database.connect() as session:
        assert pragmas(session.driver) == {
            "journal_mode": "wal",
            "synchronous": synchronous,
            "foreign_keys": 1,
            "busy_timeout": 2500,
            "query_only": 0,
            "trusted_schema": 0,
            "journal_size_limit": 64 * 2**20,
        }


@pytest.mark.parametrize(("durability", "synchronous"), [("full", "on"), ("normal", "off")])
def test_durability_is_postgresqls_synchronous_commit(postgresql_url, durability, synchronous):
    """On PostgreSQL the settings are synchronous_commit and lock_timeout, which last for one transaction."""
    database = Database(postgresql_url, durability=durability, busy_timeout=2.5)
    with database.connect() as connection:
        before = settings(connection.driver)
        with database.begin() as writing:
            assert settings(writing.driver) == {
                "synchronous_commit": synchronous,
                "lock_timeout": "2500ms",
                "default_transaction_read_only": "off",
            }
        assert settings(connection.driver) == before
    database.close()


def test_a_stricter_server_setting_stays(postgresql_url):
    """`remote_apply`, with which a standby has all acknowledged transactions, is stricter than "full", and stays."""
    for durability, synchronous in (("full", "remote_apply"), ("normal", "off")):
        url = f"{postgresql_url}&options=-csynchronous_commit%3Dremote_apply"
        database = Database(url, durability=durability)
        with database.begin() as writing:
            assert settings(writing.driver)["synchronous_commit"] == synchronous
        database.close()


def test_read_only_is_held_by_the_database_itself(path, postgresql_url):
    """A read-only connection refuses every change."""
    for url in (path, postgresql_url):
        kbstore.open(url).close()
    change = Statement(sa.text("UPDATE knowledge_bases SET name = 'other' RETURNING name"))
    for url, refusal in ((path, "readonly database"), (postgresql_url, "read-only transaction")):
        database = Database(url, read_only=True)
        for transaction in (database.read, database.begin):
            with pytest.raises(StoreUnavailable, match=refusal), transaction() as connection:
                connection.first(change, {})
        for use in (lambda connection: connection.run(change, {}), lambda connection: connection.many(change, [{}])):
            with pytest.raises(StoreUnavailable, match="read_only=True"), database.connect() as connection:
                use(connection)
        database.close()


@pytest.mark.parametrize("wrong", [{"durability": "none"}, {"busy_timeout": -1}, {"busy_timeout": float("nan")}])
def test_invalid_settings_are_refused(path, wrong):
    """Invalid settings are refused before anything is opened."""
    with pytest.raises(ValueError, match=next(iter(wrong))):
        kbstore.open(path, **wrong)
    assert not path.exists()


# -- engines of the caller's ----------------------------------------------------------------------------------------


def test_an_engine_of_the_callers_gets_its_connections_back_as_they_were(path):
    """Isolation level and settings are those of the host again, and its engine works after kbstore is closed."""
    engine = sa.create_engine(f"sqlite:///{path}", pool_size=1, max_overflow=0)

    @sa.event.listens_for(engine, "connect")
    def configure(connection, _):
        connection.execute("PRAGMA busy_timeout = 1234")
        connection.execute("PRAGMA cache_size = 77")

    with kbstore.open(engine, durability="normal") as kb:
        kb.add("(raining)")
    with engine.connect() as connection:
        driver = connection.connection.driver_connection
        assert driver.isolation_level == ""
        found = pragmas(driver)
        assert (found["busy_timeout"], found["foreign_keys"], found["synchronous"]) == (1234, 0, 2)
        assert driver.execute("PRAGMA cache_size").fetchone() == (77,)
        connection.exec_driver_sql("CREATE TABLE own (a)")
        connection.exec_driver_sql("INSERT INTO own VALUES (1)")
        connection.rollback()
        assert connection.exec_driver_sql("SELECT count(*) FROM own").scalar() == 0
    assert engine.pool.checkedin() == 1
    engine.dispose()


def test_an_engine_of_the_callers_on_postgresql(postgresql_url):
    """The same on PostgreSQL, with settings of the host."""
    options = {"options": "-c lock_timeout=7s -c synchronous_commit=local"}
    engine = sa.create_engine(postgresql_url, pool_size=1, max_overflow=0, connect_args=options)
    with kbstore.open(engine, "host", durability="normal") as kb:
        kb.add("(raining)")
    with kbstore.open(engine, "host", read_only=True) as kb:
        assert kb.holds("(raining)")
    with engine.connect() as connection:
        driver = connection.connection.driver_connection
        assert not driver.autocommit
        connection.exec_driver_sql("CREATE TABLE own (a int)")
        connection.rollback()
        assert settings(driver) == {
            "synchronous_commit": "local",
            "lock_timeout": "7s",
            "default_transaction_read_only": "off",
        }
        assert not sa.inspect(connection).has_table("own")
    assert engine.pool.checkedin() == 1
    engine.dispose()


def tell_and_ask(place, name):
    """Open a knowledge base, change it, and ask it; the answers are those that they are to be."""
    with kbstore.open(place, name) as kb:
        kb.load("(define (domain d) (:types room) (:predicates (open ?r - room)) (:functions (n)))")
        for number in range(8):
            kb.add("hall - room", "(open hall)", f"(= (n) {number})")
            kb.remove("(open hall)")
            with pytest.raises(InvalidKnowledge), kb.transaction() as transaction:
                transaction.add("(open nowhere)")
        assert kb.value("(n)") == 7
        assert not kb.holds("(open hall)")
        assert in_thread(lambda: kb.value("(n)")) == 7
        assert len(kb.history("(open hall)")) == 8
        assert [change.number for change in kb.changes()] == list(range(1, 18))
        if place != "sqlite://":
            with kbstore.open(place, kb.name, read_only=True) as reader:
                assert reader.state().value("(n)") == 7


ALL_KINDS = (
    "kbstore_alembic_version",
    "INSERT INTO facts",
    "UPDATE facts",
    "INSERT INTO transactions",
    "FROM facts",
    "FROM heads",
)
"""Parts of the statements of opening, writing and asking."""


@pytest.mark.parametrize("backend", ["file", "postgresql"])
@pytest.mark.parametrize("listener", ["before_cursor_execute", "after_cursor_execute", "echo"])
def test_listeners_of_an_engine_see_all_statements(backend, listener, path, request, caplog):
    """An engine's listeners and its `echo` see the statements of questions and changes; answers are the same."""
    url = f"sqlite:///{path}" if backend == "file" else request.getfixturevalue("postgresql_url")
    engine = sa.create_engine(url)
    seen = []
    if listener == "echo":
        caplog.set_level("INFO", logger="sqlalchemy.engine")
    else:

        @sa.event.listens_for(engine, listener)
        def see(_connection, _cursor, statement, *_):
            seen.append(statement)

    tell_and_ask(engine, f"watched by {listener}")
    text = "\n".join(seen or [record.getMessage() for record in caplog.records])
    for part in ALL_KINDS:
        assert part in text
    assert engine.pool.checkedout() == 0
    engine.dispose()


@pytest.mark.parametrize("backend", ["memory", "file", "postgresql"])
def test_listeners_of_all_engines_see_all_statements(backend, path, request):
    """A listener of the class `Engine`, as instrumentation has it, sees all statements of a store opened by its URL."""
    url = {"memory": "sqlite://", "file": f"sqlite:///{path}"}.get(backend) or request.getfixturevalue("empty_database")
    seen = []

    def see(_connection, _cursor, statement, *_):
        seen.append(statement)

    sa.event.listen(sa.Engine, "before_cursor_execute", see)
    try:
        tell_and_ask(url, "watched")
        with kbstore.open(url, "archived") as kb:
            kb.add("(open hall)")
            kb.remove("(open hall)")
            moment = kb.add("(open attic)").time
            kb.archive(moment, path.with_name("archive.db"))
            assert kb.history_from == moment
    finally:
        sa.event.remove(sa.Engine, "before_cursor_execute", see)
    for part in ALL_KINDS:
        assert part in "\n".join(seen)


def test_closing_one_knowledge_base_leaves_the_engine_to_others(path):
    """Closing the first of two knowledge bases on one engine does not affect the second."""
    engine = sa.create_engine(f"sqlite:///{path}")
    first, second = kbstore.open(engine, "first"), kbstore.open(engine, "second")
    first.close()
    second.add("(raining)")
    assert second.holds("(raining)")
    second.close()
    engine.dispose()


def in_thread(act):
    """Run a function in another thread, and raise its error."""
    with ThreadPoolExecutor(1) as thread:
        return thread.submit(act).result(30)


@pytest.mark.parametrize("backend", ["file", "postgresql"])
def test_a_connection_of_the_callers_is_checked_out_for_each_operation(backend, path, request):
    """A pool of one serves any number of threads in turn, and the caller itself between two operations."""
    url = f"sqlite:///{path}" if backend == "file" else request.getfixturevalue("postgresql_url")
    engine = sa.create_engine(url, pool_size=1, max_overflow=0, pool_timeout=20)
    with kbstore.open(engine, "in turn") as kb, kbstore.open(engine, "in turn") as other:
        kb.add("(= (counter) 0)")

        def increase(kb):
            for _ in range(10):
                kb.add("(increase (counter) 1)")
                assert kb.state().value("(counter)") > 0

        with ThreadPoolExecutor(6) as threads:
            for done in [threads.submit(increase, each) for each in (kb, other) * 3]:
                done.result(30)
        assert kb.value("(counter)") == 60
        assert engine.pool.checkedout() == 0
        with engine.connect() as connection:
            assert connection.exec_driver_sql("SELECT count(*) FROM functions").scalar()
    engine.dispose()


def test_the_error_of_an_exhausted_pool(path):
    """Where the caller's pool has no free connection, the error says so, and how to have more."""
    engine = sa.create_engine(f"sqlite:///{path}", pool_size=1, max_overflow=0, pool_timeout=0.05)
    with kbstore.open(engine) as kb:
        kb.add("(raining)")
        with (
            kb.transaction() as transaction,
            pytest.raises(StoreUnavailable, match=r"all connections of the pool are in use .* make the pool larger"),
        ):
            in_thread(lambda: kb.holds("(raining)"))
        assert transaction.result.changes == 0
        assert in_thread(lambda: kb.holds("(raining)"))
    engine.dispose()


def connections(url):
    """The number of connections to a database, without the one that asks."""
    with psycopg.connect(url.replace("+psycopg", ""), autocommit=True) as admin:
        # a connection closed just now may still be counted
        for _ in range(100):
            count = admin.execute(
                "SELECT count(*) FROM pg_stat_activity WHERE datname = current_database() AND pid <> pg_backend_pid()"
                " AND backend_type = 'client backend'"
            ).fetchone()[0]
            if not count:
                break
            time.sleep(0.01)
        return count


def test_knowledge_bases_of_a_server_share_a_pool(empty_database):
    """50 knowledge bases used by five threads hold at most `pool_size` connections; closed, none is left."""
    url = f"{empty_database}{'&' if '?' in empty_database else '?'}pool_size=3"
    kbs = [kbstore.open(url, f"kb{number}") for number in range(50)]
    together = threading.Barrier(5)

    def ask():
        together.wait(20)
        for kb in kbs:
            kb.add("(raining)")
            assert kb.state().holds("(raining)")

    with ThreadPoolExecutor(5) as threads:
        for done in [threads.submit(ask) for _ in range(5)]:
            done.result(60)
    assert 1 <= connections(empty_database) <= 3
    for kb in kbs:
        kb.close()
    assert connections(empty_database) == 0


def test_all_connections_to_a_server_are_in_use(empty_database):
    """Where `pool_size` connections are in use, the next operation waits for one, at most for the timeout."""
    url = f"{empty_database}{'&' if '?' in empty_database else '?'}pool_size=1"
    with kbstore.open(url, busy_timeout=0.2) as kb, kbstore.open(url, "other", busy_timeout=0.2) as other:
        with kb.transaction() as transaction:
            transaction.add("(raining)")
            assert not kb.holds("(raining)")
            with pytest.raises(StoreUnavailable, match=r"all 1 connections .* more than 0\.2 s; .* pool_size"):
                in_thread(lambda: other.holds("(raining)"))
        assert not in_thread(lambda: other.holds("(raining)"))
        assert kb.holds("(raining)")


@pytest.mark.parametrize(
    ("parameter", "expected"),
    [("pool_size=0", "from 1 on"), ("pool_size=many", "from 1 on"), ("prepare_threshold=off", "from 0 on, or none")],
)
def test_invalid_parameters_of_a_url_are_refused(parameter, expected):
    """An invalid parameter of kbstore's own in the URL of a server is refused before anything is connected."""
    with pytest.raises(StoreUnavailable, match=f"{parameter} in the URL of a store: .*{expected}"):
        kbstore.open(f"postgresql://127.0.0.1:9/none?{parameter}")


@pytest.mark.parametrize(("parameter", "prepared"), [("none", None), ("0", 0), ("7", 7)])
def test_prepared_statements_by_url(postgresql_url, parameter, prepared):
    """`prepare_threshold=none` in the URL turns prepared statements off; a number is psycopg's."""
    with kbstore.open(f"{postgresql_url}&prepare_threshold={parameter}", "prepared") as kb:
        kb.add("(raining)")
        assert kb.holds("(raining)")
        with kb._database.connect() as connection:
            assert connection.driver.prepare_threshold == prepared


def test_many_threads_need_no_larger_pool(path):
    """In an engine that kbstore makes itself, every thread has a connection at the same time."""
    kb = kbstore.open(path)
    kb.add("(raining)")
    together = threading.Barrier(40)
    answers = []

    def ask():
        answers.append(kb.holds("(raining)"))
        together.wait(20)

    threads = [threading.Thread(target=ask) for _ in range(40)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert answers == [True] * 40
    assert len(kb._database._connections._open) == 41
    ask_again = threading.Thread(target=kb.holds, args=("(raining)",))
    ask_again.start()
    ask_again.join()
    # those of ended threads were dropped when the next thread came
    assert len(kb._database._connections._open) == 2
    kb.close()


def test_a_thread_takes_over_the_connection_of_an_ended_one(path):
    """Opening a connection takes longer than most questions; one in the middle of an operation is not taken over."""
    with kbstore.open(path) as kb:
        kb.add("(raining)")
        used = []

        def ask():
            assert kb.holds("(raining)")
            used.append(kb._database._connections._local.connection)

        def break_off():
            used.append(kb._database._connections.checkout())

        for work in (ask, ask, break_off, ask):
            thread = threading.Thread(target=work)
            thread.start()
            thread.join()
    first, second, third, fourth = used
    assert first is second is third
    assert fourth is not third


def test_a_store_in_memory_may_be_the_callers(path):
    """A caller's engine on a database in memory works, also in other threads, if its one connection allows that."""
    del path
    arguments = {"poolclass": StaticPool, "connect_args": {"check_same_thread": False}}
    engine = sa.create_engine("sqlite://", **arguments)
    with kbstore.open(engine) as kb:
        adding = threading.Thread(target=kb.add, args=("(raining)",))
        adding.start()
        adding.join()
        assert kb.holds("(raining)")
    engine.dispose()


@pytest.mark.parametrize("pool", [StaticPool, SingletonThreadPool])
@pytest.mark.parametrize("where", ["memory", "file"])
def test_writes_of_others_on_the_callers_one_connection_are_seen(path, pool, where):
    """Where the caller's pool has one connection for all, commits of others on it are seen like any other."""
    arguments = {"poolclass": pool, "connect_args": {"check_same_thread": False}}
    engine = sa.create_engine("sqlite://" if where == "memory" else f"sqlite:///{path}", **arguments)
    with kbstore.open(engine) as kb, kbstore.open(engine) as other:
        kb.add("(open door)", "(= (level tank) 1)")
        assert [kb.holds("(open door)"), kb.holds("(open door)"), kb.value("(level tank)")] == [True, True, 1]
        other.remove("(open door)")
        other.add("(= (level tank) 2)")
        assert [kb.holds("(open door)"), kb.value("(level tank)")] == [False, 2]
        with engine.begin() as connection:
            connection.exec_driver_sql("UPDATE functions SET function_value = 3")
        assert kb.value("(level tank)") == 3
        with kb._database.connect() as session:
            assert pragmas(session.driver)["journal_mode"] == ("memory" if where == "memory" else "wal")
    engine.dispose()


def test_the_file_is_the_one_that_sqlite_has_open(tmp_path, monkeypatch):
    """Where the working directory has changed since, the file that SQLite opened is watched for being moved."""
    for name in ("here", "there"):
        (tmp_path / name).mkdir()
    monkeypatch.chdir(tmp_path / "here")
    engine = sa.create_engine("sqlite:///store.db")
    monkeypatch.chdir(tmp_path / "there")
    with kbstore.open("store.db") as another, kbstore.open(engine) as kb:
        another.add("(open door)")
        assert another.holds("(open door)")
        kb.add("(open door)")
        assert [kb.holds("(open door)"), kb.holds("(open door)")] == [True, True]
        with kbstore.open(tmp_path / "here" / "store.db") as writer:
            writer.remove("(open door)")
        assert not kb.holds("(open door)")
        (tmp_path / "there" / "store.db").rename(tmp_path / "there" / "moved.db")
        kb.add("(open door)")
        (tmp_path / "here" / "store.db").rename(tmp_path / "here" / "moved.db")
        with pytest.raises(StoreUnavailable, match="has been moved"):
            kb.add("(open window)")
    engine.dispose()


# -- errors ---------------------------------------------------------------------------------------------------------


def sqlite_error(code, text="reason"):
    error = sqlite3.OperationalError(text)
    error.sqlite_errorcode = code
    return error


@pytest.mark.parametrize(
    ("error", "expected"),
    [
        (sqlite_error(sqlite3.SQLITE_BUSY), r"store has been locked by others for more than 2\.5 s .* busy_timeout"),
        (sqlite_error(sqlite3.SQLITE_BUSY_SNAPSHOT), "has been locked"),
        (sqlite_error(sqlite3.SQLITE_LOCKED_SHAREDCACHE), "has been locked"),
        (sqlite_error(sqlite3.SQLITE_PROTOCOL), "has been locked"),
        (sqlite_error(sqlite3.SQLITE_CORRUPT), "store is damaged, or not an SQLite database .* backup"),
        (sqlite_error(sqlite3.SQLITE_NOTADB), "store is damaged, or not an SQLite database"),
        (sqlite_error(sqlite3.SQLITE_READONLY_DBMOVED), "reason; .* read_only=True"),
        (sqlite_error(sqlite3.SQLITE_FULL), "store: reason; what was committed before is intact"),
        (sqlite_error(sqlite3.SQLITE_IOERR_WRITE), "store: reason; what was committed before is intact"),
        (sqlite3.ProgrammingError("closed"), "store: closed; what was committed before is intact"),
        (sqlite3.OperationalError(), "store: OperationalError; what was"),
        (psycopg.errors.LockNotAvailable("waited"), r"locked by others for more than 2\.5 s \(waited\)"),
        (psycopg.errors.DiskFull("no space"), "store: no space; what was committed before is intact"),
        (psycopg.OperationalError("gone"), "store: gone; .* the next call goes on"),
    ],
)
def test_errors_of_drivers_say_what_to_do(error, expected):
    """Each error of a driver is `StoreUnavailable`: which store, what happened, and what to do about it."""
    found = unavailable(error, "store", 2.5)
    assert isinstance(found, StoreUnavailable)
    assert re.search(expected, str(found)), found


def test_an_error_of_the_callers_own_database_is_unchanged(kb):
    """Only kbstore's own errors are translated: an error of the caller's code in a block is raised unchanged."""

    def fail():
        with kb.transaction() as transaction:
            transaction.add("(raining)")
            raise sqlite3.OperationalError("own")

    with pytest.raises(sqlite3.OperationalError, match="own"):
        fail()
    assert not kb.holds("(raining)")


def test_an_error_within_a_block_is_typed_where_it_arises(tmp_path):
    """A statement that fails in a transaction raises `StoreUnavailable` there, so that the block can catch it."""
    kb = kbstore.open(tmp_path / "store.db")
    with kb.transaction() as transaction:
        session = transaction._repository._connection
        with pytest.raises(StoreUnavailable, match="no such table"):
            session.all(Statement(sa.text("SELECT * FROM nowhere")), {})
        transaction.add("(raining)")
    assert kb.holds("(raining)")
    kb.close()


def test_after_a_rollback_by_sqlite_every_statement_is_refused(tmp_path):
    """After an error that ended the transaction no statement takes effect on its own: all of them are refused."""
    kb = kbstore.open(tmp_path / "store.db")
    add = Statement(sa.text("INSERT INTO knowledge_bases VALUES (:id, :name, false)"))
    fail = Statement(sa.text("INSERT OR ROLLBACK INTO knowledge_bases SELECT * FROM knowledge_bases"))

    def go_on():
        with kb._database.begin() as session:
            session.run(add, {"id": 7, "name": "seven"})
            with pytest.raises(StoreUnavailable):
                session.run(fail, {})
            session.run(add, {"id": 8, "name": "eight"})

    with pytest.raises(StoreUnavailable, match="rolled back"):
        go_on()
    assert kbstore.knowledge_bases(tmp_path / "store.db") == ["default"]
    kb.add("(raining)")
    kb.close()


@pytest.mark.parametrize(
    ("url", "expected"),
    [
        ("/nowhere/at/all/store.db", "unable to open database file"),
        ("mysql://host/db", "mysql"),
        ("postgresql://127.0.0.1:9/none?connect_timeout=2", "127.0.0.1"),
        ("://", "neither a database URL nor a path"),
    ],
)
def test_a_store_that_cannot_be_reached(url, expected):
    """Opening a store that cannot be reached is one error, wherever it was expected."""
    with pytest.raises(StoreUnavailable, match=expected):
        kbstore.open(url)


def test_errors_have_no_password():
    """An error names the store without the password of its URL."""
    with pytest.raises(StoreUnavailable) as refusal:
        kbstore.open("postgresql://kenny:secret@127.0.0.1:9/none?connect_timeout=2")
    assert "secret" not in str(refusal.value)
    assert "kenny:***@127.0.0.1" in str(refusal.value)


def test_a_file_that_is_not_a_database_is_refused(tmp_path):
    """A file that is not an SQLite database is refused, and left as it is."""
    file = tmp_path / "notes.txt"
    file.write_text("buy milk " * 200)
    with pytest.raises(StoreUnavailable, match="not a database"):
        kbstore.open(file)
    assert file.read_text() == "buy milk " * 200


def test_engines_that_kbstore_makes():
    """A path is a file, :memory: and no path are memory, postgresql uses psycopg."""
    assert str(make_engine("a/b.db").url) == "sqlite:///a/b.db"
    assert isinstance(make_engine(":memory:").pool, StaticPool)
    assert isinstance(make_engine("sqlite://").pool, StaticPool)
    assert make_engine("postgresql://h/d").url.drivername == "postgresql+psycopg"


def test_a_file_is_opened_by_one_connection(tmp_path):
    """The connection that checks the schema is the one that the thread then uses."""
    made = []

    def count(driver, _):
        made.append(driver)

    sa.event.listen(sa.Engine, "connect", count)
    try:
        for _ in range(2):
            with kbstore.open(tmp_path / "store.db") as kb:
                kb.add("(here)")
                assert kb.holds("(here)")
    finally:
        sa.event.remove(sa.Engine, "connect", count)
    assert len(made) == 2
    for driver in made:
        with pytest.raises(sqlite3.ProgrammingError, match="closed"):
            driver.execute("SELECT 1")
