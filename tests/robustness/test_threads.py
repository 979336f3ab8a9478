"""Several threads on one knowledge base."""

import sqlite3
import threading
from concurrent.futures import ThreadPoolExecutor

import pytest

import kbstore
from kbstore.errors import StoreUnavailable
from kbstore.storage import queries

THREADS = 6
TIMES = 15


def together(*acts):
    """Run several functions at once, each in a thread of its own; raise what one of them raises."""
    with ThreadPoolExecutor(len(acts)) as threads:
        for done in [threads.submit(act) for act in acts]:
            done.result(60)


def test_no_increment_of_a_thread_is_lost(open_kb):
    """C7: threads that increase a counter through one knowledge base lose none."""
    kb = open_kb()
    kb.add("(= (counter) 0)")

    def increase():
        for _ in range(TIMES):
            kb.add("(increase (counter) 1)")

    together(*[increase] * THREADS)
    assert kb.value("(counter)") == THREADS * TIMES
    assert [change.number for change in kb.changes()] == list(range(1, THREADS * TIMES + 2))


def test_readers_see_whole_transactions(open_kb):
    """C1: the changes of a transaction appear at once, in the state and in history, during any read."""
    kb = open_kb()
    kb.add("(= (left) 50)", "(= (right) 50)")
    writing = threading.Event()

    def write():
        for _ in range(40):
            with kb.transaction() as transaction:
                transaction.add("(decrease (left) 1)")
                transaction.add("(increase (right) 1)")
        writing.set()

    def read():
        rounds = 0
        while not writing.is_set() or not rounds:
            state = kb.state()
            assert state.value("(left)") + state.value("(right)") == 100
            assert kb.value("(+ (left) (right))") == 100
            for change in kb.changes(after=1):
                assert len(change.asserted) == 2
            rounds += 1

    together(write, read, read)
    assert kb.value("(left)") == 10


def test_reading_while_another_thread_has_a_transaction_open(tmp_path, postgresql_url):
    """On a file and on PostgreSQL readers don't wait: they see the state without the open transaction."""
    for url in (tmp_path / "store.db", postgresql_url):
        kb = kbstore.open(url, "reading while writing")
        kb.add("(raining)")
        with kb.transaction() as transaction:
            transaction.add("(open hall)")
            found = []
            reader = threading.Thread(target=lambda found=found, kb=kb: found.append(kb.state().facts))
            reader.start()
            reader.join(10)
            assert [[str(fact) for fact in facts] for facts in found] == [["(raining)"]]
        assert kb.holds("(open hall)")
        kb.close()


def test_a_store_in_memory_has_one_connection_which_threads_use_in_turn():
    """In memory a reader waits for another thread's transaction, at most for the busy timeout."""
    kb = kbstore.open("sqlite://", busy_timeout=0.2)
    entered, leave = threading.Event(), threading.Event()

    def hold():
        with kb.transaction() as transaction:
            transaction.add("(raining)")
            entered.set()
            leave.wait(10)

    holder = threading.Thread(target=hold)
    holder.start()
    entered.wait(10)
    for ask in (kb.state, lambda: kb.holds("(raining)"), lambda: kb.add("(open hall)")):
        with pytest.raises(StoreUnavailable, match=r"used by another thread for more than 0\.2 s"):
            ask()
    leave.set()
    holder.join()
    assert kb.holds("(raining)")
    kb.close()


def test_a_transaction_belongs_to_its_thread(open_kb):
    """Two threads may each have a transaction open: the second waits, and sees the writes of the first."""
    kb = open_kb()
    kb.add("(= (counter) 0)")
    entered = threading.Event()
    order = []

    def first():
        with kb.transaction() as transaction:
            entered.set()
            transaction.add("(= (counter) 10)")
            order.append("first")

    def second():
        entered.wait(10)
        with kb.transaction() as transaction:
            order.append("second")
            assert transaction.value("(counter)") == 10
            transaction.add("(increase (counter) 1)")

    together(first, second)
    assert order == ["first", "second"]
    assert kb.value("(counter)") == 11


def test_questions_of_many_threads_about_the_same(open_kb):
    """Prepared questions and cached answers are right in every thread, while one thread changes them."""
    kb = open_kb()
    kb.load("(define (domain d) (:predicates (p) (q)) (:functions (n)))")
    kb.add("(p)", "(= (n) 0)")
    done = threading.Event()

    def write():
        for number in range(1, 41):
            with kb.transaction() as transaction:
                transaction.add(f"(= (n) {number})", "(not (p))" if number % 2 else "(p)")
        done.set()

    def ask():
        latest = 0
        while not done.is_set():
            number = kb.value("(n)")
            assert number >= latest
            latest = number
            assert kb.holds("(or (p) (not (p)))")
        assert kb.value("(n)") == 40
        assert kb.holds("(p)")

    together(write, ask, ask, ask)


# -- closing --------------------------------------------------------------------------------------------------------


def test_every_call_after_closing_is_refused(open_kb):
    """After `close` every question and change is `StoreUnavailable`, in every thread; closing again does nothing."""
    kb = open_kb()
    kb.add("(raining)")
    kb.close()
    kb.close()
    for ask in (kb.state, kb.now, lambda: kb.holds("(raining)"), lambda: kb.add("(p)"), lambda: list(kb.changes())):
        with pytest.raises(StoreUnavailable, match="closed"):
            ask()
        with pytest.raises(StoreUnavailable, match="closed"):
            together(ask)


def test_closing_while_another_thread_has_a_transaction_open(open_kb):
    """A transaction in progress when another thread closes is stored whole; the next is refused."""
    kb = open_kb()
    again = None
    entered, closed = threading.Event(), threading.Event()

    def write():
        with kb.transaction() as transaction:
            transaction.add("(raining)")
            entered.set()
            closed.wait(10)
            transaction.add("(open hall)")
        assert transaction.result.number == 1
        with pytest.raises(StoreUnavailable, match="closed"):
            kb.add("(too late)")

    def close():
        entered.wait(10)
        kb.close()
        closed.set()

    together(write, close)
    if kb._database.engine.url.database:
        again = open_kb(kb.name)
        assert {str(fact) for fact in again.state().facts} == {"(raining)", "(open hall)"}
        assert len(list(again.changes())) == 1


def test_closing_while_other_threads_ask(open_kb):
    """Threads that ask and write while another closes get answers, then `StoreUnavailable`, and nothing else."""
    for _ in range(5):
        kb = open_kb()
        kb.add("(raining)")
        ready = threading.Barrier(4)

        def for_ever(act):
            while True:
                act()

        def use(act, ready=ready, for_ever=for_ever):
            ready.wait(10)
            with pytest.raises(StoreUnavailable, match="closed"):
                for_ever(act)

        def close(ready=ready, kb=kb):
            ready.wait(10)
            kb.state()
            kb.close()

        together(
            lambda use=use, kb=kb: use(kb.state),
            lambda use=use, kb=kb: use(lambda: kb.holds("(raining)")),
            lambda use=use, kb=kb: use(lambda: kb.add("(increase (n) 1)" if kb.query("(n)") else "(= (n) 0)")),
            close,
        )


@pytest.mark.parametrize(
    "ask",
    [lambda kb: kb.holds("(raining)"), lambda kb: kb._database.first(queries.knowledge_base_names, {})],
    ids=["from memory", "of the store"],
)
def test_closing_while_another_thread_releases_its_connection(tmp_path, ask):
    """A connection that its thread is about to release, when another closes, is closed by one of them."""
    kb = kbstore.open(tmp_path / "store.db")
    kb.add("(raining)")
    assert kb.holds("(raining)")
    session = kb._database.checkout()
    kb._database.checkin(session)

    class Lock:
        """The session's lock, which is released only after another thread has closed."""

        def __init__(self, lock):
            self._lock = lock
            self.acquire = lock.acquire

        def release(self):
            session.lock = self._lock
            together(kb.close)
            self._lock.release()

    session.lock = Lock(session.lock)
    assert ask(kb)
    with pytest.raises(sqlite3.ProgrammingError, match="closed"):
        session.driver.execute("SELECT 1")


def test_leaving_a_transaction_in_which_the_knowledge_base_was_closed(open_kb):
    """Closing within one's own transaction lets it end normally, and then closes."""
    kb = open_kb()
    with kb.transaction() as transaction:
        transaction.add("(raining)")
        kb.close()
    assert transaction.result.changes == 1
    with pytest.raises(StoreUnavailable, match="closed"):
        kb.state()
