"""Full disks, unwritable and damaged files: a typed error, and the old state."""

import os
import re
import resource
import shutil
import sqlite3
import tempfile
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from pathlib import Path

import pytest
import sqlalchemy as sa

import kbstore
from kbstore.errors import KbStoreError, StoreUnavailable
from kbstore.transfer.backup import backup
from tests.processes import finish, start
from tests.storage.invariants import violations

NOBODY = 65534


def many(start, count=700):
    """More items than fit on a page or two."""
    return [f"(seen thing{number} in room{number % 7})" for number in range(start, start + count)]


def sound(kb):
    """Whether the tables of a knowledge base satisfy the invariants."""
    with kb._database.connect() as session:

        def execute(sql):
            return session.driver.execute(sql).fetchall()

        assert execute("PRAGMA integrity_check") == [("ok",)]
        return not violations(execute, execute(f"SELECT id FROM knowledge_bases WHERE name = '{kb.name}'")[0][0])


# -- full disks -----------------------------------------------------------------------------------------------------


def limit_pages(kb, more):
    """Let the file grow by at most so many pages."""
    with kb._database.connect() as session:
        pages = session.driver.execute("PRAGMA page_count").fetchone()[0]
        session.driver.execute(f"PRAGMA max_page_count = {pages + more}")


@pytest.mark.parametrize("url", ["memory", "file"])
@pytest.mark.parametrize("more", [0, 1, 5, 40])
def test_a_full_database(url, more, path):
    """Where the database may not grow, a transaction is `StoreUnavailable` as a whole, and later it works."""
    with kbstore.open("sqlite://" if url == "memory" else path) as kb:
        kb.add("(raining)", "(= (battery kenny) 80)")
        before = kb.to_pddl()
        limit_pages(kb, more)
        for _ in range(2):
            with pytest.raises(StoreUnavailable, match="full; what was committed before is intact"):
                kb.add(*many(0))
            assert kb.to_pddl() == before
            assert [change.number for change in kb.changes()] == [1]
            assert sound(kb)
        limit_pages(kb, 10**6)
        assert kb.add(*many(0)).number == 2
        assert sound(kb)


def fill_up(path, room):
    """Write until the system refuses to let a file grow, then continue with a higher limit."""
    with kbstore.open(path) as kb:
        kb.add("(= (counter) 0)")
        log = Path(f"{path}-wal").stat().st_size
        resource.setrlimit(resource.RLIMIT_FSIZE, (log + room, resource.RLIM_INFINITY))
        counted = 0
        try:
            for _ in range(1000):
                kb.add(*many(counted * 10, 10), "(increase (counter) 1)")
                counted += 1
        except StoreUnavailable as refusal:
            assert "what was committed before is intact" in str(refusal)  # noqa: PT017
        assert counted < 1000
        assert kb.value("(counter)") == counted
        assert len(kb.state().facts) == counted * 10
        with pytest.raises(StoreUnavailable):
            kb.add(*many(10**6))
        resource.setrlimit(resource.RLIMIT_FSIZE, (resource.RLIM_INFINITY, resource.RLIM_INFINITY))
        assert kb.add("(increase (counter) 1)").number == counted + 2
        assert kb.value("(counter)") == counted + 1
        assert sound(kb)


@pytest.mark.parametrize("room", [0, 1, 5000, 100_000])
def test_writes_that_the_system_refuses(path, room):
    """Where writing fails in the middle of the log, acknowledged transactions are there, and the process works on."""
    finish(start(fill_up, path, room))
    with kbstore.open(path) as kb:
        assert sound(kb)


# -- files that cannot be written -----------------------------------------------------------------------------------


@pytest.fixture
def open_directory():
    """A directory that every user may enter."""
    directory = Path(tempfile.mkdtemp())
    directory.chmod(0o755)
    yield directory
    shutil.rmtree(directory)


def ask_without_rights(path, read_only, works):
    """Open and ask as a user who may not write; adding is refused in every case."""
    if os.geteuid() == 0:
        os.setuid(NOBODY)
    try:
        with kbstore.open(path, read_only=read_only) as kb:
            assert kb.holds("(raining)")
            with pytest.raises(StoreUnavailable):
                kb.add("(open hall)")
            assert not kb.holds("(open hall)")
    except StoreUnavailable:
        assert not works


@pytest.mark.parametrize("read_only", [True, False])
def test_a_file_without_the_right_to_write(open_directory, read_only):
    """A read-only file in a read-only directory is refused with a typed error, and left as it is.

    SQLite needs to write beside a file in WAL mode even to read it; a backup is a single file, and can be read.
    """
    path, copy = open_directory / "store.db", open_directory / "copy.db"
    with kbstore.open(path) as kb:
        kb.add("(raining)")
    backup(path, copy)
    for file in (path, copy):
        file.chmod(0o444)
    open_directory.chmod(0o555)
    before = {file.name: file.read_bytes() for file in open_directory.iterdir()}
    finish(start(ask_without_rights, path, read_only, False), start(ask_without_rights, copy, read_only, read_only))
    assert {file.name: file.read_bytes() for file in open_directory.iterdir()} == before
    open_directory.chmod(0o755)
    path.chmod(0o644)
    with kbstore.open(path) as kb:
        assert kb.add("(open hall)").number == 2


def ask_a_medium(path):
    """Open a file of a read-only medium: the error says how, and its advice works."""
    if os.geteuid() == 0:
        os.setuid(NOBODY)
    with pytest.raises(StoreUnavailable, match=r"read-only medium|immutable=1") as refusal:
        kbstore.open(path, read_only=True)
    url = re.search(r"sqlite:///file\S+immutable\S+", str(refusal.value))[0]
    with kbstore.open(url, read_only=True) as kb:
        assert kb.holds("(raining)")
        assert len(kb.history("(raining)")) == 1
        with pytest.raises(StoreUnavailable):
            kb.add("(open hall)")


def test_a_medium_that_is_read_only(open_directory):
    """A file in WAL mode on a read-only medium can be opened as immutable, and the error says so."""
    path = open_directory / "the store #1.db"
    with kbstore.open(path) as kb:
        kb.add("(raining)")
    before = path.read_bytes()
    open_directory.chmod(0o555)
    finish(start(ask_a_medium, path))
    assert [file.name for file in open_directory.iterdir()] == [path.name]
    assert path.read_bytes() == before


def test_a_read_only_server(postgresql_url, name):
    """A read-only PostgreSQL server, such as a standby, answers questions and refuses changes."""
    with kbstore.open(postgresql_url, name) as kb:
        kb.add("(raining)")
    engine = sa.create_engine(postgresql_url, connect_args={"options": "-c default_transaction_read_only=on"})
    with kbstore.open(engine, name) as kb:
        assert kb.holds("(raining)")
        with pytest.raises(StoreUnavailable, match="read-only transaction"):
            kb.add("(open hall)")
        assert [str(fact) for fact in kb.state().facts] == ["(raining)"]
        with pytest.raises(StoreUnavailable, match="read-only transaction"):
            kbstore.open(engine, f"{name} new")
    engine.dispose()


# -- files that are not what they were ------------------------------------------------------------------------------


def test_a_damaged_file(path):
    """The error reports the damage; with the file from a backup in its place the store works again."""
    with kbstore.open(path) as kb:
        kb.add(*many(0))
    good = path.read_bytes()
    path.write_bytes(good[:100] + b"\xff" * 4096 + good[4196:])
    with pytest.raises(StoreUnavailable, match="damaged"):
        kbstore.open(path).state()
    path.write_bytes(b"\xff" * len(good))
    with pytest.raises(StoreUnavailable, match="not a database"):
        kbstore.open(path)
    path.write_bytes(good)
    with kbstore.open(path) as kb:
        assert len(kb.state().facts) == 700


def test_damage_while_the_store_is_open(path):
    """A file that is damaged under an open knowledge base gives typed errors, and works once it is restored."""
    with kbstore.open(path) as kb:
        kb.add(*many(0))
    good = path.read_bytes()
    kb = kbstore.open(path)
    assert kb.holds("(seen thing5 in room5)")
    with open(path, "r+b") as file:
        file.write(b"\xff" * len(good))
    with closing(sqlite3.connect(path, isolation_level=None)):
        pass
    refused = 0
    for ask in (kb.state, lambda: kb.history("(seen ? in room3)"), lambda: kb.add("(open hall)")):
        try:
            ask()
        except StoreUnavailable:
            refused += 1
    assert refused
    with open(path, "r+b") as file:
        file.write(good)
    assert len(kb.state().facts) == 700
    kb.close()


def test_a_file_in_the_place_of_another_is_noticed(path):
    """Where another store's file has replaced the first, no thread reads or writes it with cached numbers.

    A number means another timeline there.
    """
    kb = kbstore.open(path)
    kb.add("(p x)", "(p y)")
    kb.remove("(p y)")
    other = path.with_name("other.db")
    with kbstore.open(other) as another:
        another.add("(p y)", "(p x)")
        another.remove("(p x)")
    kb.state()
    os.replace(other, path)
    for suffix in ("-wal", "-shm"):
        path.with_name(path.name + suffix).unlink()
    with ThreadPoolExecutor(1) as thread:
        for use in (kb.state, lambda: kb.holds("(p y)"), lambda: kb.add("(p x)")):
            with pytest.raises(StoreUnavailable, match="moved, deleted or replaced"):
                thread.submit(use).result(30)
    kb.close()
    with kbstore.open(path) as again:
        assert [str(fact) for fact in again.state().facts] == ["(p y)"]


def test_a_moved_or_deleted_file_is_noticed(path):
    """Where the file is moved or deleted while it is open, a change is refused, as it would be lost.

    So is a question, at the latest after the 20 milliseconds for which the file is not checked again.
    """
    kb = kbstore.open(path)
    kb.add("(raining)")
    path.rename(path.with_name("elsewhere.db"))
    with pytest.raises(StoreUnavailable, match="moved, deleted or replaced"):
        kb.add("(open hall)")
    path.touch()
    with pytest.raises(StoreUnavailable, match="moved, deleted or replaced"):
        kb.add("(open hall)")
    time.sleep(0.03)
    with pytest.raises(StoreUnavailable, match="moved, deleted or replaced"):
        kb.holds("(raining)")
    path.with_name("elsewhere.db").rename(path)
    assert kb.holds("(raining)")
    kb.add("(open hall)")
    assert kb.holds("(open hall)")
    kb.close()


@pytest.mark.parametrize("threads", [1, 2])
def test_a_recreated_file_is_noticed(path, threads):
    """Where a file was deleted and created again, reading fails within a moment, in every thread; also with `as_of`."""
    kb = kbstore.open(path)
    kb.add("a - thing", "(p a)")
    with ThreadPoolExecutor(1) as other:
        if threads == 2:
            assert other.submit(kb.holds, "(p a)").result(30)
        path.unlink()
        with kbstore.open(path) as anew:
            anew.add("b - thing")
        time.sleep(0.05)
        for ask in (lambda: kb.holds("(p a)"), lambda: kb.holds("(p a)", at=1), kb.state, lambda: list(kb.changes())):
            with pytest.raises(StoreUnavailable, match="moved, deleted or replaced"):
                other.submit(ask).result(30) if threads == 2 else ask()
            time.sleep(0.02)
    kb.close()


def test_every_error_is_of_kbstore(path, monkeypatch):
    """If any statement of a transaction fails, the caller gets an error of kbstore's, and the old state."""
    with kbstore.open(path) as kb:
        kb.add("wp0 - place", "(= (n wp0) 1)")
        before, step = kb.to_pddl(), 0

        class Failing:
            """The driver's connection, of which the n-th statement fails."""

            def __init__(self, driver):
                self._driver, self._left = driver, step

            def __getattr__(self, name):
                return getattr(self._driver, name)

            def execute(self, *arguments):
                self._left -= 1
                if not self._left and not arguments[0].startswith("ROLLBACK"):
                    raise sqlite3.OperationalError("disk I/O error")
                return self._driver.execute(*arguments)

        with kb._database.connect() as session:
            driver = session.driver
        for step in range(1, 40):  # noqa: B007 - counted by Failing
            failing = Failing(driver)
            monkeypatch.setattr(session, "driver", failing)
            monkeypatch.setattr(session, "_execute", failing.execute)
            try:
                kb.add("wp1 - place", "(open wp1)", "(increase (n wp0) 1)")
            except KbStoreError as error:
                assert isinstance(error, StoreUnavailable)  # noqa: PT017
            else:
                break
            finally:
                monkeypatch.undo()
                session._execute, session._cursor = driver.execute, driver.cursor
            assert kb.to_pddl() == before
        assert 5 < step < 39
        assert kb.value("(n wp0)") == 2
        assert sound(kb)
