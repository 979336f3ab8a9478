"""Log messages for operators: `logging.getLogger("kbstore")`."""

import logging
import sqlite3
import threading
import time
from contextlib import closing, suppress

import psycopg
import pytest

import kbstore
from kbstore.errors import StoreWentBack
from kbstore.storage import connection, schema


@pytest.fixture
def logged(caplog):
    """The messages logged so far: pairs of level and text."""
    caplog.set_level(logging.INFO, logger="kbstore")
    return lambda: [(record.levelname, record.getMessage()) for record in caplog.records if record.name == "kbstore"]


def test_a_long_wait_for_a_lock(shared_url, name, logged, monkeypatch):
    """A long wait of a writer for another is logged with its length; a short wait is not logged."""
    monkeypatch.setattr(connection, "LONG_WAIT", 0.2)
    with kbstore.open(shared_url, name) as first, kbstore.open(shared_url, name) as second:
        second.add("(raining)")
        assert not [text for _, text in logged() if "waited" in text]
        with first.transaction():
            writer = threading.Thread(target=second.add, args=("(open hall)",))
            writer.start()
            time.sleep(0.5)
        writer.join(10)
    found = [(level, text) for level, text in logged() if "waited" in text]
    assert len(found) == 1
    assert found[0][0] == "WARNING"
    assert "s for a lock that another writer held" in found[0][1]


def test_a_connection_that_was_lost(postgresql_url, name, logged):
    """Reconnecting to a server is logged, without the password."""
    with kbstore.open(postgresql_url, name) as kb:
        kb.add("(raining)")
        with kb._database.connect() as lost:
            pid = lost.driver.info.backend_pid
        with psycopg.connect(postgresql_url.replace("+psycopg", ""), autocommit=True) as admin:
            admin.execute("SELECT pg_terminate_backend(%s, 5000)", (pid,))
        assert kb.holds("(raining)")
    found = [(level, text) for level, text in logged() if "lost" in text]
    assert [level for level, _ in found] == ["WARNING"]
    assert "the connection was lost; connecting again" in found[0][1]


def test_a_schema_that_is_upgraded(path, logged):
    """An upgrade is logged with both revisions; one that has nothing to do is not."""
    schema.upgrade(path, "0001")
    schema.upgrade(path)
    schema.upgrade(path)
    texts = [text.partition("schema ")[2] for _, text in logged()]
    assert texts == ["changed from none to 0001", f"changed from 0001 to {schema.HEAD}"]


def test_archiving(path, logged):
    """The beginning and the result of archiving are logged."""
    with kbstore.open(path) as kb:
        kb.add("(raining)")
        kb.remove("(raining)")
        done = kb.archive(kb.add("(open hall)").time, path.with_name("archive.db"))
    texts = [text for _, text in logged() if text.startswith("archiv")]
    assert texts[0].startswith("archiving default before ")
    assert texts[1] == f"archived default: {done.rows} rows deleted from the store"
    assert len(texts) == 2


def test_a_store_that_went_back(path, logged):
    """A backup that is restored under a running process is logged, with both numbers."""
    with kbstore.open(path) as kb:
        kb.add("(raining)")
        kbstore.backup(path, path.with_name("backup.db"))
        kb.add("(open hall)")
        kb.add("(open galley)")
        with (
            closing(sqlite3.connect(path.with_name("backup.db"))) as source,
            closing(sqlite3.connect(path)) as target,
        ):
            source.backup(target)
        with suppress(StoreWentBack):
            kb.state()
    assert [entry for entry in logged() if "gone back" in entry[1]] == [
        ("WARNING", "default: the store has gone back from transaction 3 to 1")
    ]
