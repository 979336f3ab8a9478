"""A server that stops answering is given up at a deadline that the client measures; a slow one is not."""

import os
import signal
import threading
import time
from contextlib import contextmanager

import psycopg
import pytest
import sqlalchemy as sa

import kbstore
from kbstore.errors import StoreUnavailable
from kbstore.storage import schema, server_engine
from kbstore.storage.engine import make_engine
from kbstore.storage.statements import Statement
from tests.robustness.pooler import pooled
from tests.robustness.test_poolers import driver_url, server_is_ours


def within(seconds, ask):
    """Ask; it is refused as unanswered within so many seconds."""
    started = time.monotonic()
    with pytest.raises(StoreUnavailable, match=r"has not answered for 1(\.5)? s"):
        ask()
    assert time.monotonic() - started < seconds


def test_a_silent_server_is_given_up(empty_database):
    """A question and a change are refused after `answer_timeout` without an answer; later calls work again."""
    if not server_is_ours(empty_database):
        pytest.skip("the server named by KBSTORE_TEST_POSTGRESQL_URL is not reached by a socket of the file system")
    with pooled(empty_database) as (url, pooler), kbstore.open(f"{url}&answer_timeout=1", busy_timeout=0.5) as kb:
        kb.add("(raining)")
        for ask in (kb.state, lambda: kb.holds("(raining)"), lambda: kb.add("(open hall)")):
            assert kb.holds("(raining)")
            with pooler.frozen():
                within(10, ask)
            assert kb.holds("(raining)")
        assert kb.add("(open hall)").number == 2


def test_a_silent_server_is_given_up_on_an_engine_of_the_callers(empty_database, monkeypatch):
    """The deadline is set for an operation; the engine gets its connection back without it."""
    if not server_is_ours(empty_database):
        pytest.skip("the server named by KBSTORE_TEST_POSTGRESQL_URL is not reached by a socket of the file system")
    monkeypatch.setattr(server_engine, "_LEAST_PATIENCE", 1.0)
    monkeypatch.setattr(schema, "BUSY_TIMEOUT", 1.0)
    with pooled(empty_database) as (url, pooler):
        engine = sa.create_engine(
            driver_url(url).replace("://", "+psycopg://"), connect_args={"prepare_threshold": None}
        )
        with kbstore.open(engine, busy_timeout=0.5) as kb:
            kb.add("(raining)")
            for ask in (kb.state, lambda: kb.add("(open hall)"), lambda: kbstore.open(engine)):
                with pooler.frozen():
                    within(10, ask)
                assert kb.holds("(raining)")
            with engine.connect() as connection:
                assert not {"wait", "answer_timeout"} & set(vars(connection.connection.driver_connection))
        engine.dispose()


@contextmanager
def stopped(url):
    """Stop the server's processes for a database inside the block."""
    with psycopg.connect(url.replace("+psycopg", ""), autocommit=True) as admin:
        pids = [
            row[0]
            for row in admin.execute(
                "SELECT pid FROM pg_stat_activity WHERE datname = current_database() AND pid <> pg_backend_pid()"
            )
        ]
        try:
            for pid in pids:
                os.kill(pid, signal.SIGSTOP)
            yield
        except PermissionError:
            pytest.skip("the server's processes belong to somebody else, and cannot be stopped here")
        finally:
            for pid in pids:
                os.kill(pid, signal.SIGCONT)


def test_a_process_of_the_server_that_is_stopped(empty_database):
    """With a real server: the host answers, and the process behind the connection does not."""
    if "host" not in sa.make_url(empty_database).query:
        pytest.skip("the server named by KBSTORE_TEST_POSTGRESQL_URL may be on another host")
    with kbstore.open(f"{empty_database}&answer_timeout=1") as kb:
        kb.add("(raining)")
        with stopped(empty_database):
            within(10, lambda: kb.holds("(raining)"))
        assert kb.holds("(raining)")


def test_waiting_for_a_lock_is_not_silence(postgresql_url, name):
    """A writer that waits for another longer than `answer_timeout` is not given up before `busy_timeout`."""
    url = f"{postgresql_url}&answer_timeout=1"
    with kbstore.open(url, name) as first, kbstore.open(url, name, busy_timeout=20) as second:
        with first.transaction() as transaction:
            transaction.add("(raining)")
            writer = threading.Thread(target=second.add, args=("(open hall)",))
            writer.start()
            writer.join(1.8)
            assert writer.is_alive()
        writer.join(10)
        assert [change.number for change in second.changes()] == [1, 2]


def test_maintenance_is_waited_for(postgresql_url, name):
    """Operations that take longer by nature have no deadline, for the one use that asked for it."""
    slow = Statement(sa.select(sa.func.pg_sleep(sa.text("1.4"))))
    with kbstore.open(f"{postgresql_url}&answer_timeout=1", name) as kb:
        with kb._database.connect() as connection:
            connection.be_patient()
            connection.first(slow, {})
        with kb._database.connect() as connection:
            within(5, lambda: connection.first(slow, {}))


@pytest.mark.parametrize(
    ("query", "busy_timeout", "patience"),
    [("", 30, 30), ("", 2, 5), ("answer_timeout=3", 30, 3), ("answer_timeout=none", 30, None)],
)
def test_the_timeouts_of_a_server(postgresql_url, query, busy_timeout, patience):
    """30 s, or the value of `busy_timeout` or the URL; the network stack gets the same."""
    engine = make_engine(f"{postgresql_url}&{query}" if query else postgresql_url, busy_timeout=busy_timeout)
    with engine.connect() as connection:
        driver = connection.connection.driver_connection
        assert driver.answer_timeout == patience
        timeout = driver.info.get_parameters().get("tcp_user_timeout", "0")
        assert timeout == ("0" if patience is None else str(patience * 1000))
    engine.dispose()
