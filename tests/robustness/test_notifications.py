"""Answers about now from memory while a server notifies: right after own writes, and after those of others."""

import os
import time

import psycopg
import pytest
import sqlalchemy as sa

import kbstore
from kbstore.errors import StoreUnavailable
from kbstore.storage import notifications
from kbstore.storage.notifications import Listener, Subscription
from kbstore.storage.postgresql_connection import PostgresqlConnection
from tests import processes
from tests.robustness.pooler import pooled
from tests.robustness.test_forks import Child
from tests.robustness.test_poolers import server_is_ours

OPEN, SHUT = "(open hall)", "(not (open hall))"


def until(condition):
    """Wait until a condition is true."""
    deadline = time.monotonic() + processes.TOO_LONG
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.002)


def asked(kb, monkeypatch, times=5):
    """The number of statements that repeating one question needs."""
    statements = []
    with monkeypatch.context() as patched:
        first = PostgresqlConnection.first
        patched.setattr(PostgresqlConnection, "first", lambda *given: statements.append(given[1]) or first(*given))
        for _ in range(times):
            kb.holds(OPEN)
    return len(statements)


@pytest.fixture
def raw(postgresql_url):
    """A connection beside kbstore."""
    url = sa.make_url(postgresql_url).set(drivername="postgresql").render_as_string(hide_password=False)
    with psycopg.connect(url, autocommit=True) as connection:
        yield connection


@pytest.fixture
def listening(postgresql_url, name):
    """A knowledge base with notifications, which have begun."""
    with kbstore.open(postgresql_url, name, notifications=True) as kb:
        kb.add(SHUT)
        until(lambda: remembers(kb))
        yield kb


def remembers(kb):
    """Whether answers are cached at this moment."""
    with kb._database.connect() as connection:
        return connection.memory(kb._reader.kb) is not None


def listeners(raw, kb):
    """The server processes of listeners to a knowledge base."""
    rows = raw.execute(
        "SELECT pid FROM pg_locks WHERE locktype = 'advisory' AND mode = 'ShareLock' AND objid = %s", (kb._reader.kb,)
    )
    return [row[0] for row in rows]


def test_an_answer_is_cached(listening, monkeypatch, postgresql_url, name):
    """The same question again needs no round trip; without the setting it needs one each time."""
    assert not listening.holds(OPEN)
    until(lambda: asked(listening, monkeypatch) == 0)
    assert not listening.is_quick(OPEN)
    with kbstore.open(postgresql_url, name) as plain:
        assert asked(plain, monkeypatch) >= 5


def flip(url, name, times, together):
    """Set a fact again and again, each time at a signal."""
    with kbstore.open(url, name) as kb:
        for number in range(times):
            together.wait()
            kb.add(SHUT if number % 2 else OPEN)
            together.wait()


def test_writes_of_others_are_seen_after_their_notification(postgresql_url, name, monkeypatch):
    """The other process does not use notifications; its commits are seen before any heartbeat."""
    monkeypatch.setattr(notifications, "HEARTBEAT", 10 * processes.TOO_LONG)
    monkeypatch.setattr(notifications, "TRUST", 20 * processes.TOO_LONG)
    together = processes.barrier(2)
    with kbstore.open(postgresql_url, name, notifications=True) as kb:
        kb.add(SHUT)
        until(lambda: remembers(kb))
        other = processes.start(flip, postgresql_url, name, 6, together)
        for number in range(6):
            assert kb.holds(OPEN) is bool(number % 2)
            together.wait()
            together.wait()
            until(lambda: kb.holds(OPEN) is not bool(number % 2))  # noqa: B023 - called at once
        processes.finish(other)


def test_own_writes_are_seen_at_once(listening, postgresql_url, name):
    """Through the same knowledge base, another of the process without the setting, and one of the process with it."""
    with (
        kbstore.open(postgresql_url, name) as plain,
        kbstore.open(f"{postgresql_url}&notifications=true", name) as second,
    ):
        for number in range(60):
            (listening, plain, second)[number % 3].add(SHUT if number % 2 else OPEN)
            assert listening.holds(OPEN) is second.holds(OPEN) is not bool(number % 2)
            if number % 7 == 0:
                until(lambda: remembers(listening) and remembers(second))
                assert listening.holds(OPEN) is second.holds(OPEN) is not bool(number % 2)


def test_commits_of_a_caller_are_seen_at_once(listening, postgresql_url):
    """In a caller's transaction no answer is cached between the write and the notification."""
    engine = sa.create_engine(postgresql_url)
    for number in range(6):
        with engine.begin() as connection:
            with listening.transaction(connection=connection) as tx:
                tx.add(SHUT if number % 2 else OPEN)
            assert listening.holds(OPEN) is bool(number % 2)
        assert listening.holds(OPEN) is not bool(number % 2)
        until(lambda: remembers(listening))
    with engine.connect() as connection:
        with listening.transaction(connection=connection) as tx:
            tx.add(OPEN)
        connection.rollback()
    assert not listening.holds(OPEN)
    engine.dispose()


def test_writers_notify_only_if_there_is_a_listener(raw, postgresql_url, name):
    """NOTIFY takes a lock of the whole database; a listener is known by an advisory lock."""
    with kbstore.open(postgresql_url, name) as kb:
        number = kb._reader.kb
        raw.execute(f"LISTEN {notifications.channel(number)}")
        kb.add(OPEN)
        assert not list(raw.notifies(timeout=0.1))
        raw.execute("SELECT pg_advisory_lock_shared(%s, %s)", (notifications._LOCK, number))
        last = kb.add(SHUT).number
        assert [found.payload for found in raw.notifies(timeout=5, stop_after=1)] == [str(last)]
        raw.execute("SELECT pg_advisory_unlock_all()")
        kb.add(OPEN)
        assert not list(raw.notifies(timeout=0.1))


def test_nothing_is_cached_while_a_writer_may_not_notify(postgresql_url, name):
    """A writer that wrote before there was a listener, and commits later, is waited for."""
    engine = sa.create_engine(postgresql_url)
    with kbstore.open(postgresql_url, name) as writer:
        writer.add(SHUT)
        with engine.connect() as connection:
            with writer.transaction(connection=connection) as tx:
                tx.add(OPEN)
            with kbstore.open(postgresql_url, name, notifications=True) as kb:
                deadline = time.monotonic() + 0.3
                while time.monotonic() < deadline:
                    assert not remembers(kb)
                    assert not kb.holds(OPEN)
                connection.commit()
                assert kb.holds(OPEN)
                until(lambda: remembers(kb))
                assert kb.holds(OPEN)
    engine.dispose()


def test_a_lost_listener(listening, raw, monkeypatch):
    """Its session is ended: no answer is cached until there is another listener."""
    assert not listening.holds(OPEN)
    monkeypatch.setattr(notifications, "_PAUSE", 0.2)
    (pid,) = listeners(raw, listening)
    raw.execute("SELECT pg_terminate_backend(%s, 5000)", (pid,))
    until(lambda: not remembers(listening))
    head = raw.execute("SELECT last_number FROM heads WHERE kb_id = %s", (listening._reader.kb,)).fetchone()
    # as by a writer that finds no listener
    raw.execute("UPDATE facts SET is_negative = false WHERE kb_id = %s", (listening._reader.kb,))
    assert listening.holds(OPEN)
    until(lambda: remembers(listening))
    assert listeners(raw, listening) not in ([], [pid])
    assert listening.add(SHUT).number == head[0] + 1
    assert not listening.holds(OPEN)


def test_nothing_is_cached_longer_than_a_heartbeat(raw, postgresql_url, name, monkeypatch):
    """A change without a notification, such as a restore within the tables, is seen after a heartbeat."""
    monkeypatch.setattr(notifications, "HEARTBEAT", 0.1)
    with kbstore.open(postgresql_url, name, notifications=True) as kb:
        kb.add(SHUT)
        until(lambda: remembers(kb))
        assert not kb.holds(OPEN)
        raw.execute("UPDATE facts SET is_negative = false WHERE kb_id = %s", (kb._reader.kb,))
        until(lambda: kb.holds(OPEN))


def test_nothing_is_cached_when_the_server_is_silent():
    """Some time after the server's last answer nothing is cached any more, even if the thread is blocked."""
    listener = Listener("a store", lambda: None, (OSError,))
    subscription = Subscription(listener, 1)
    subscription.renew()
    listener.trusted_until = time.monotonic() + 60
    assert subscription.answers() is not None
    listener.trusted_until = time.monotonic()
    assert subscription.answers() is None


def test_a_closed_knowledge_base_stops_listening(raw, postgresql_url, name):
    """Two of a process share one listener; with the last of them the lock and the connection are closed."""
    first = kbstore.open(postgresql_url, name, notifications=True)
    second = kbstore.open(postgresql_url, name, notifications=True)
    first.add(OPEN)
    until(lambda: remembers(first) and remembers(second))
    assert len(listeners(raw, first)) == 1
    first.close()
    assert second.holds(OPEN)
    assert len(listeners(raw, first)) == 1
    second.close()
    until(lambda: not listeners(raw, first))


@pytest.mark.skipif(not hasattr(os, "fork"), reason="this system has no fork")
@pytest.mark.filterwarnings("ignore:This process .* is multi-threaded:DeprecationWarning")
def test_a_forked_child_listens_by_itself(listening, raw):
    """The child has its own connection, and the parent keeps its own."""
    assert not listening.holds(OPEN)
    before = listeners(raw, listening)

    def act():
        assert not remembers(listening)
        assert not listening.holds(OPEN)
        until(lambda: remembers(listening))
        listening.add(OPEN)
        assert listening.holds(OPEN)
        listening.close()

    assert Child(act).done()
    until(lambda: listening.holds(OPEN))
    assert listeners(raw, listening) == before
    listening.add(SHUT)
    assert not listening.holds(OPEN)


def test_stores_without_notifications(postgresql_url, name):
    """A pooler and a caller's engine are refused with the reason; SQLite needs no notifications."""
    engine = sa.create_engine(postgresql_url)
    with pytest.raises(StoreUnavailable, match="by its URL"):
        kbstore.open(engine, name, notifications=True)
    engine.dispose()
    with pytest.raises(StoreUnavailable, match="it is true or false"):
        kbstore.open(f"{postgresql_url}&notifications=yes", name)
    with kbstore.open("sqlite://", name, notifications=True) as kb:
        kb.add(OPEN)
        assert kb.holds(OPEN)
    if server_is_ours(postgresql_url):
        with pooled(postgresql_url) as (url, _), pytest.raises(StoreUnavailable, match="there is a pooler between"):
            kbstore.open(url, name, notifications=True)
