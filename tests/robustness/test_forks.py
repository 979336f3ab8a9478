"""Forks: a child opens its own connections, the parent keeps its own, and neither loses stored data."""

import multiprocessing
import os
import subprocess
import sys
import threading
import time
import traceback
from contextlib import contextmanager, suppress

import pytest
import sqlalchemy as sa

import kbstore
from kbstore.errors import StoreUnavailable
from kbstore.storage import forks

pytestmark = [
    pytest.mark.skipif(not hasattr(os, "fork"), reason="this system has no fork"),
    # the warning of newer versions of Python is about what is tested here
    pytest.mark.filterwarnings("ignore:This process .* is multi-threaded:DeprecationWarning"),
]


class Child:
    """A forked process that runs a function; `done` tells whether it succeeded."""

    def __init__(self, act, *arguments):
        self.pid = os.fork()
        if not self.pid:
            code = 1
            try:
                act(*arguments)
                code = 0
            except BaseException:
                traceback.print_exc()
            finally:
                os._exit(code)

    def done(self):
        return os.waitstatus_to_exitcode(os.waitpid(self.pid, 0)[1]) == 0


class Signal:
    """A signal that one process waits for and another sends."""

    def __init__(self):
        self._reading, self._writing = os.pipe()

    def send(self):
        os.write(self._writing, b".")

    def wait(self):
        assert os.read(self._reading, 1) == b"."


def texts(kb):
    return {str(fact) for fact in kb.state().facts}


@pytest.fixture
def kb(shared_url, name):
    """A knowledge base that parent and child share."""
    kb = kbstore.open(shared_url, name)
    kb.add("(by parent)")
    yield kb
    kb.close()


def test_parent_and_child_work_on(kb):
    """Both ask and write through the same object after the fork, and see each other's writes."""
    written, seen = Signal(), Signal()

    def act():
        assert texts(kb) == {"(by parent)"}
        kb.add("(by child)")
        written.send()
        seen.wait()
        assert kb.holds("(by parent_again)")

    child = Child(act)
    written.wait()
    assert kb.holds("(by child)")
    kb.add("(by parent_again)")
    seen.send()
    assert child.done()
    assert [change.number for change in kb.changes()] == [1, 2, 3]


def test_children_of_children(kb):
    """A child may fork in its turn; each process of the line can write."""

    def descend(depth):
        kb.add(f"(by child{depth})")
        if depth:
            assert Child(descend, depth - 1).done()
        assert kb.holds("(by child0)")

    assert Child(descend, 3).done()
    assert texts(kb) == {"(by parent)", *(f"(by child{depth})" for depth in range(4))}


@contextmanager
def outlived(kb):
    """A child that adds a fact before the block runs in the parent, and another one after it."""
    ready, closed = Signal(), Signal()

    def act():
        kb.add("(by child)")
        ready.send()
        closed.wait()
        kb.add("(by orphan)")

    child = Child(act)
    ready.wait()
    yield
    closed.send()
    assert child.done()


def test_a_child_that_outlives_the_parents_connection_loses_nothing(shared_url, name):
    """The writes of a child stay, also after the parent has closed the connection opened before the fork.

    SQLite would take the parent's connection for the file's last, and delete the log that the child writes to, if the
    child had left the inherited connection open beside its own.
    """
    kb = kbstore.open(shared_url, name)
    kb.add("(by parent)")
    unused = kbstore.open(shared_url, f"{name} unused")
    with outlived(kb):
        kb.close()
        unused.close()
    with kbstore.open(shared_url, name) as again:
        assert texts(again) == {"(by parent)", "(by child)", "(by orphan)"}


def test_connections_idle_in_a_pool_of_the_callers(path):
    """The same where the parent's connection was idle in the pool of a caller's engine."""
    engine = sa.create_engine(f"sqlite:///{path}")
    first = kbstore.open(engine)
    first.add("(by parent)")
    kb = kbstore.open(engine)
    first.close()
    with outlived(kb):
        kb.close()
        engine.dispose()
    with kbstore.open(path) as again:
        assert texts(again) == {"(by parent)", "(by child)", "(by orphan)"}


def test_the_one_connection_of_a_pool_of_the_callers(path):
    """The same where the engine has one connection for all threads, on a file: it stays with the parent."""
    arguments = {"poolclass": sa.StaticPool, "connect_args": {"check_same_thread": False}}
    engine = sa.create_engine(f"sqlite:///{path}", **arguments)
    kb = kbstore.open(engine)
    kb.add("(by parent)")
    with outlived(kb):
        assert texts(kb) == {"(by parent)", "(by child)"}
        kb.close()
        engine.dispose()
    with kbstore.open(path) as again:
        assert texts(again) == {"(by parent)", "(by child)", "(by orphan)"}


def test_multiprocessing_with_fork(kb):
    """Processes of multiprocessing, started by fork, are children like others."""
    context = multiprocessing.get_context("fork")
    processes = [context.Process(target=kb.add, args=(f"(by process{number})",)) for number in range(3)]
    for process in processes:
        process.start()
    for process in processes:
        process.join(30)
    assert [process.exitcode for process in processes] == [0, 0, 0]
    assert texts(kb) == {"(by parent)", "(by process0)", "(by process1)", "(by process2)"}


def test_a_store_in_memory_is_copied():
    """The child has its own copy, with the state at the fork."""
    kb = kbstore.open("sqlite://")
    kb.add("(by parent)")

    def act():
        assert kb.holds("(by parent)")
        kb.add("(by child)")
        assert texts(kb) == {"(by parent)", "(by child)"}

    assert Child(act).done()
    assert texts(kb) == {"(by parent)"}
    kb.close()


def test_a_transaction_stays_with_the_parent(kb):
    """A child forked within a transaction cannot use it, however it leaves the block; the parent can."""

    def act(transaction):
        with pytest.raises(StoreUnavailable, match="stays with the parent"):
            transaction.add("(by child)")

    with kb.transaction() as transaction:
        transaction.add("(within transaction)")
        assert Child(act, transaction).done()
        transaction.add("(after fork)")
    assert texts(kb) == {"(by parent)", "(within transaction)", "(after fork)"}

    def leave():
        with suppress(KeyboardInterrupt), kb.transaction() as transaction:
            transaction.add("(stored once)")
            pid = os.fork()
            if not pid:
                raise KeyboardInterrupt
            assert os.waitpid(pid, 0)[1] == 0

    assert Child(leave).done()
    assert kb.holds("(stored once)")
    assert [change.number for change in kb.changes()] == [1, 2, 3]


def test_a_child_forked_within_a_transaction_opens_the_store_anew(kb, shared_url):
    """It sees the committed state, waits for the parent's lock like any other process, and then writes."""
    ready = Signal()

    def act():
        with kbstore.open(shared_url, kb.name) as own:
            assert texts(own) == {"(by parent)"}
            ready.send()
            own.add("(by child)")

    with kb.transaction() as transaction:
        transaction.add("(within transaction)")
        child = Child(act)
        ready.wait()
        time.sleep(0.05)
    assert child.done()
    assert texts(kb) == {"(by parent)", "(within transaction)", "(by child)"}


def test_forking_while_threads_work(kb):
    """Forks wait until other threads have left the store: the child works, and no thread is disturbed."""
    stop = threading.Event()
    failures = []

    def work():
        try:
            while not stop.is_set():
                kb.add("(increase (counter) 1)" if kb.query("(counter)") else "(= (counter) 0)")
                kb.state()
        except BaseException as error:
            failures.append(error)

    threads = [threading.Thread(target=work) for _ in range(3)]
    for thread in threads:
        thread.start()
    children = [Child(kb.add, f"(by child{number})") for number in range(6)]
    assert all(child.done() for child in children)
    stop.set()
    for thread in threads:
        thread.join()
    assert not failures
    assert texts(kb) == {"(by parent)", *(f"(by child{number})" for number in range(6))}


def test_a_fork_does_not_wait_for_threads_outside_sqlite(kb):
    """Where no other thread is inside the store, neither the fork waits, nor the parent for the child's closing."""
    asked = Signal()

    class Slow:
        """Connections that a child has not closed until its parent has asked for more."""

        def hold(self, deadline):
            return deadline > 0

        def let_go(self):
            pass

        def forget_parent(self, *, is_quiet):
            asked.wait()
            return is_quiet

    slow = Slow()
    forks.register(slow)
    before = time.monotonic()
    child = Child(kb.add, "(by child)")
    try:
        assert time.monotonic() - before < 1
        kb.add("(by parent_again)")
        assert time.monotonic() - before < 1.5
    finally:
        asked.send()
    del slow
    assert child.done()
    assert texts(kb) == {"(by parent)", "(by parent_again)", "(by child)"}


def test_a_fork_in_the_middle_of_another_threads_transaction(path, monkeypatch):
    """Where another thread does not leave SQLite in time, the child gets an error for files of SQLite.

    It has no safe way to use them; the parent works on.
    """
    monkeypatch.setattr(forks, "PATIENCE", 0.1)
    kb = kbstore.open(path)
    kb.add("(by parent)")
    entered, leave = threading.Event(), threading.Event()

    def hold():
        with kb.transaction() as transaction:
            transaction.add("(by thread)")
            entered.set()
            leave.wait(20)

    def act():
        for ask in (kb.state, lambda: kbstore.open(path)):
            with pytest.raises(StoreUnavailable, match="forked while its parent was within an SQLite store"):
                ask()

    holder = threading.Thread(target=hold)
    holder.start()
    entered.wait(10)
    assert Child(act).done()
    leave.set()
    holder.join()
    assert texts(kb) == {"(by parent)", "(by thread)"}
    assert Child(kb.add, "(by child)").done()
    assert kb.holds("(by child)")
    kb.close()


LEAVING = """
import os, sys
import kbstore
kb = kbstore.open(sys.argv[1], sys.argv[2])
kb.add("(by parent)")
for uses in (False, True):
    pid = os.fork()
    if not pid:
        if uses:
            kb.add("(by child)")
        sys.exit(0)
    assert os.waitpid(pid, 0)[1] == 0
    assert kb.holds("(by parent)")
    with kb.transaction() as transaction:
        transaction.add(f"(after {str(uses).lower()})")
kb.close()
"""


def test_a_child_that_ends_like_any_program(shared_url, name):
    """A child that exits by itself, whether it has used the store or not, does not end its parent's connection."""
    done = subprocess.run(
        [sys.executable, "-c", LEAVING, shared_url, name], capture_output=True, text=True, check=False
    )
    assert (done.returncode, done.stderr) == (0, "")
    with kbstore.open(shared_url, name) as kb:
        assert texts(kb) == {"(by parent)", "(by child)", "(after false)", "(after true)"}
