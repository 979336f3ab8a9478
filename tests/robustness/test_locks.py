"""Waiting for locks: below the busy timeout nothing is reported, above it the error says why."""

import sqlite3
import threading
import time
from contextlib import closing

import psycopg
import pytest
import sqlalchemy as sa

import kbstore
from kbstore.errors import StoreUnavailable


@pytest.fixture
def lock(path):
    """Hold SQLite's write lock on the file from outside, until it is closed."""
    kbstore.open(path).close()
    with closing(sqlite3.connect(path, isolation_level=None)) as connection:
        connection.execute("BEGIN IMMEDIATE")
        yield connection


def test_a_writer_waits_for_the_lock(path, lock):
    """A lock held for less than the timeout makes only writers wait; readers are not affected."""
    with kbstore.open(path, busy_timeout=20) as kb:
        assert kb.state().facts == []
        writer = threading.Thread(target=kb.add, args=("(raining)",))
        writer.start()
        time.sleep(0.3)
        assert not kb.holds("(raining)")
        lock.execute("ROLLBACK")
        writer.join(10)
        assert kb.holds("(raining)")


def test_above_the_time_out_it_is_store_unavailable(path, lock):
    """A lock held longer is `StoreUnavailable`, after the timeout; nothing is stored, and later it works."""
    with kbstore.open(path, busy_timeout=0.3) as kb:
        before = time.monotonic()
        with pytest.raises(StoreUnavailable, match=r"store\.db has been locked by others for more than 0\.3 s"):
            kb.add("(raining)")
        assert 0.25 < time.monotonic() - before < 5
        assert not kb.holds("(raining)")
        lock.execute("ROLLBACK")
        assert kb.add("(raining)").number == 1


def test_a_timeout_of_zero(path, lock):
    """A timeout of 0 tries once."""
    with kbstore.open(path, busy_timeout=0) as kb:
        with pytest.raises(StoreUnavailable, match="more than 0 s"):
            kb.add("(raining)")
        lock.execute("ROLLBACK")
        kb.add("(raining)")


def test_opening_waits_too(tmp_path):
    """A file that is locked while its schema is created, or the mode of its log changed, is waited for."""
    path = tmp_path / "locked.db"
    with closing(sqlite3.connect(path, isolation_level=None, check_same_thread=False)) as holder:
        holder.execute("BEGIN EXCLUSIVE")
        with pytest.raises(StoreUnavailable, match="locked"):
            kbstore.open(path, busy_timeout=0.2)
        threading.Timer(0.3, lambda: holder.execute("COMMIT")).start()
        with kbstore.open(path, busy_timeout=20) as kb:
            kb.add("(raining)")
    with closing(sqlite3.connect(path, isolation_level=None, check_same_thread=False)) as holder:
        assert holder.execute("PRAGMA journal_mode = DELETE").fetchone() == ("delete",)
        # SQLite does not wait for a reader to change the mode, and kbstore does
        holder.execute("BEGIN")
        holder.execute("SELECT * FROM heads").fetchall()
        with pytest.raises(StoreUnavailable, match="locked"):
            kbstore.open(path, busy_timeout=0.2)
        threading.Timer(0.3, lambda: holder.execute("COMMIT")).start()
        with kbstore.open(path, busy_timeout=20) as kb:
            assert kb.holds("(raining)")


def test_a_reader_blocks_no_writer(path):
    """A long read, as of a backup or an export, does not make writers wait, and sees none of their writes."""
    with kbstore.open(path, busy_timeout=0.2) as kb:
        kb.add("(raining)")
        with closing(sqlite3.connect(path, isolation_level=None)) as reader:
            reader.execute("BEGIN")
            assert reader.execute("SELECT last_number FROM heads").fetchone() == (1,)
            for number in range(5):
                kb.add(f"(open door{number})")
            assert reader.execute("SELECT last_number FROM heads").fetchone() == (1,)


def test_writers_of_one_knowledge_base_on_postgresql(postgresql_url, name):
    """A writer waits for another of the same knowledge base up to the timeout."""
    with (
        kbstore.open(postgresql_url, name) as first,
        kbstore.open(postgresql_url, name, busy_timeout=0.3) as second,
    ):
        with first.transaction() as transaction:
            transaction.add("(raining)")
            with pytest.raises(StoreUnavailable, match=r"locked by others for more than 0\.3 s"):
                second.add("(open hall)")
            assert not second.holds("(raining)")
        assert second.add("(open hall)").number == 2


def test_writers_of_different_knowledge_bases_on_postgresql(postgresql_url, name):
    """Writers of different knowledge bases in one database don't wait for each other, also with new ones."""
    with kbstore.open(postgresql_url, name) as first, first.transaction() as transaction:
        transaction.add("wp0 - waypoint", "(raining)")
        with kbstore.open(postgresql_url, f"{name} other", busy_timeout=0.3) as second:
            for number in range(5):
                second.add(f"wp{number} - waypoint", f"(open wp{number})")
            assert len(list(second.changes())) == 5


def test_the_host_of_postgresql_may_have_another_isolation(postgresql_url, name):
    """Also where a database's default is serializable, writers are ordered by the lock, and none is refused."""
    engine = sa.create_engine(postgresql_url, connect_args={"options": "-c default_transaction_isolation=serializable"})
    with kbstore.open(engine, name) as kb, kbstore.open(engine, name) as other:
        kb.add("(= (counter) 0)")

        def increase(kb):
            for _ in range(20):
                kb.add("(increase (counter) 1)")

        threads = [threading.Thread(target=increase, args=(each,)) for each in (kb, other)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        assert kb.value("(counter)") == 40
    engine.dispose()


def test_an_interrupt_while_a_writer_waits(shared_url, name):
    """Ctrl-C takes effect when the lock is acquired: the transaction that has begun is not left open."""
    with kbstore.open(shared_url, name) as kb, kbstore.open(shared_url, name, busy_timeout=0.5) as other:
        kb.add("(raining)")
        with kb._database.connect() as connection:
            execute = connection._execute

            def interrupted(*arguments, **options):
                execute(*arguments, **options)
                raise KeyboardInterrupt

            connection._execute = interrupted
        with pytest.raises(KeyboardInterrupt):
            kb.add("(open hall)")
        with kb._database.connect() as connection:
            driver = connection.driver
            assert not (driver.in_transaction if connection.is_local else driver.info.transaction_status)
        assert other.add("(open galley)").number == 2
        assert kb.add("(open hall)").number == 3


# -- lost connections to PostgreSQL ---------------------------------------------------------------------------------


@pytest.fixture
def cut(postgresql_url):
    """End the server's side of a knowledge base's connections, as a restart of the server does."""

    def cutting(kb):
        with kb._database.connect() as session:
            pid = session.driver.info.backend_pid
        with psycopg.connect(postgresql_url.replace("+psycopg", ""), autocommit=True) as admin:
            assert admin.execute("SELECT pg_terminate_backend(%s, 5000)", (pid,)).fetchone() == (True,)

    return cutting


def test_a_connection_that_was_lost_while_idle_is_made_anew(postgresql_url, name, cut):
    """Between two calls the connection may be lost: the next call connects again, and works."""
    with kbstore.open(postgresql_url, name) as kb:
        kb.add("(raining)")
        for ask in (lambda: kb.holds("(raining)"), lambda: kb.state().facts, lambda: kb.add("(raining)")):
            cut(kb)
            assert ask()
        cut(kb)
        with kb.transaction() as transaction:
            transaction.add("(open hall)")
        assert kb.holds("(open hall)")


def test_connections_that_an_engine_has_lost_while_idle(empty_database):
    """After a restart of the server a call replaces the lost connections of the engine's pool, also unused ones."""
    engine = sa.create_engine(empty_database)
    with kbstore.open(engine) as kb:
        kb.add("(raining)")
        with engine.connect(), engine.connect(), engine.connect():
            pass
        assert engine.pool.checkedin() == 3
        with psycopg.connect(empty_database.replace("+psycopg", ""), autocommit=True) as admin:
            admin.execute(
                "SELECT pg_terminate_backend(pid, 5000) FROM pg_stat_activity"
                " WHERE datname = current_database() AND pid <> pg_backend_pid()"
            )
        assert kb.holds("(raining)")
    engine.dispose()


def test_a_connection_that_is_lost_within_a_transaction(postgresql_url, name, cut):
    """Within a transaction the call is `StoreUnavailable`, all of it is rolled back, and the next call works."""

    def lose():
        with kb.transaction() as transaction:
            transaction.add("(open hall)")
            cut(kb)
            transaction.add("(open galley)")

    with kbstore.open(postgresql_url, name) as kb:
        kb.add("(raining)")
        with pytest.raises(StoreUnavailable, match="terminating connection"):
            lose()
        assert [str(fact) for fact in kb.state().facts] == ["(raining)"]
        assert kb.add("(open hall)").number == 2


def test_a_block_that_goes_on_after_its_connection_was_lost(postgresql_url, name, cut):
    """A block that catches the error cannot store half of its writes: leaving it is `StoreUnavailable`, too."""

    def go_on():
        with kb.transaction() as transaction:
            transaction.add("(open hall)")
            cut(kb)
            with pytest.raises(StoreUnavailable):
                transaction.add("(open galley)")
            transaction.add("(open cellar)")

    with kbstore.open(postgresql_url, name) as kb:
        with pytest.raises(StoreUnavailable, match="terminating connection"):
            go_on()
        assert kb.state().facts == []
        assert list(kb.changes()) == []


def test_a_connection_that_is_lost_at_the_end(postgresql_url, name, cut):
    """Lost before the end, the transaction is not stored; only for COMMIT itself does the error call that unknown."""

    def lose(at_commit):
        with kb.transaction() as transaction:
            transaction.add("(open hall)")
            if at_commit:
                session = transaction._repository._connection
                commit = session.commit

                def committing():
                    cut(kb)
                    commit()

                session.commit = committing
            else:
                cut(kb)

    with kbstore.open(postgresql_url, name) as kb:
        with pytest.raises(StoreUnavailable) as refusal:
            lose(at_commit=False)
        assert "not known" not in str(refusal.value)
        with pytest.raises(StoreUnavailable, match="whether the transaction was stored is not known"):
            lose(at_commit=True)
        assert list(kb.changes()) == []
        assert kb.add("(open hall)").number == 1


def test_a_watch_goes_on_after_a_lost_connection(postgresql_url, name, cut):
    """A follower whose connection is lost between two polls misses nothing."""
    with kbstore.open(postgresql_url, name) as kb, kbstore.open(postgresql_url, name) as writer:
        watching = kb.watch(after=0, poll=0.01, timeout=10)
        writer.add("(raining)")
        assert next(watching).number == 1
        cut(kb)
        writer.add("(open hall)")
        assert next(watching).number == 2
