"""A store that goes back under a running process: a restored backup, a file copied back, a promoted standby.

Numbers of timelines, versions and transactions then mean something else. No answer and no write may use a cached
number; and a process that lost acknowledged transactions gets one error.
"""

import shutil
import sqlite3
import threading
import time
import uuid
from concurrent.futures import ThreadPoolExecutor

import psycopg
import pytest
import sqlalchemy as sa

import kbstore
from kbstore import StoreUnavailable, StoreWentBack
from kbstore.storage.memory import Mark, StoreMemory
from kbstore.storage.records import Head
from tests.conftest import create_database

DOMAIN = "(define (domain rooms) (:types room) (:predicates (clean ?p - room)) (:functions (dust ?p - room)))"
OTHER = "(define (domain rooms) (:types room) (:predicates (tidy ?p - room) (clean ?p - room)))"


class Restorable:
    """A store that can be saved, and restored under its users."""

    def __init__(self, url, save, restore):
        self.url = url
        self.save = save
        self.restore = restore


@pytest.fixture
def sqlite_store(tmp_path):
    """An SQLite file, restored by the backup API: the same file with other content."""

    def copy(source, target):
        first, second = sqlite3.connect(source), sqlite3.connect(target)
        first.backup(second)
        first.close()
        second.close()

    path, saved = tmp_path / "store.db", tmp_path / "saved.db"
    return Restorable(f"sqlite:///{path}", lambda: copy(path, saved), lambda: copy(saved, path))


@pytest.fixture
def postgresql_store(postgresql_url):
    """A database, dropped and created again from a copy, as by pg_restore and a fail-over."""
    server = sa.make_url(postgresql_url)
    name = f"back_{uuid.uuid4().hex[:8]}"
    saved = f"{name}_saved"
    conninfo = server.set(drivername="postgresql").render_as_string(hide_password=False)
    with psycopg.connect(conninfo, autocommit=True) as admin:

        def save():
            admin.execute("SELECT pg_terminate_backend(pid) FROM pg_stat_activity WHERE datname = %s", [name])
            create_database(admin, saved, template=name)

        def restore():
            admin.execute(f"DROP DATABASE {name} WITH (FORCE)")
            create_database(admin, name, template=saved)

        create_database(admin, name)
        yield Restorable(server.set(database=name).render_as_string(hide_password=False), save, restore)
        for each in (name, saved):
            admin.execute(f"DROP DATABASE IF EXISTS {each} WITH (FORCE)")


@pytest.fixture(params=["sqlite", "postgresql"])
def store(request):
    """A store that can be restored, on each engine."""
    return request.getfixturevalue(f"{request.param}_store")


@pytest.fixture
def opened():
    """Open knowledge bases, and close them after the test."""
    bases = []

    def opening(*arguments, **options):
        bases.append(kbstore.open(*arguments, **options))
        return bases[-1]

    yield opening
    for kb in bases:
        kb.close()


def until_connected(ask):
    """The answer after the error of a connection that a restore has cut."""
    try:
        return ask()
    except StoreUnavailable:
        return ask()


def rooms(letter):
    return [f"{letter}{n} - room" for n in range(20)], [f"(clean {letter}{n})" for n in range(20)]


@pytest.fixture
def lost(store, opened):
    """A process whose last two transactions are lost, and whose timeline numbers now mean other timelines."""
    kb = opened(store.url, "kenny")
    kb.load(DOMAIN)
    kb.add("hall - room")
    store.save()
    for items in rooms("r"):
        until_connected(lambda: kb.add(*items))  # noqa: B023 - called at once
    assert kb.holds("(clean r5)")
    assert kb.state().facts
    store.restore()
    other = opened(store.url, "kenny")
    for items in rooms("q"):
        other.add(*items)
    return kb, other


def test_lost_transactions_are_reported_once(lost):
    """The first question or transaction is `StoreWentBack`, with both numbers; the next uses the store as it is."""
    kb, other = lost
    with pytest.raises(StoreWentBack, match=r"kenny was at transaction 4, and has another transaction 4"):
        until_connected(lambda: kb.holds("(clean r5)"))
    assert not kb.holds("(clean r5)")
    assert kb.holds("(clean q5)")
    assert kb.add("(clean hall)").number == 5
    assert other.holds("(clean hall)")


def test_answers_cached_since_an_own_transaction_are_dropped(store, opened):
    """Back at the last transaction of others that a connection had seen, later cached answers are dropped, too."""
    kb, another = opened(store.url, "kenny"), opened(store.url, "lucy")
    kb.add("(clean hall)")
    assert kb.holds("(clean hall)")
    another.add("(clean hall)")
    assert kb.holds("(clean hall)")
    store.save()
    until_connected(lambda: kb.remove("(clean hall)"))
    assert not kb.holds("(clean hall)")
    store.restore()
    with pytest.raises(StoreWentBack):
        until_connected(lambda: kb.holds("(clean hall)"))
    assert kb.holds("(clean hall)")


def test_the_later_transaction_of_two_threads_is_checked():
    """A thread that committed first, and reports it late, does not hide the other's lost transaction."""
    memory = StoreMemory("kenny")
    tokens = {5: 105, 6: 106}
    for number in (6, 5):
        memory.acknowledge(Head(number, 0, tokens[number], 0, 0, 0, 0, 0, 0, None), ())
    with pytest.raises(StoreWentBack, match="kenny was at transaction 6, and is at transaction 5"):
        memory.look(memory.progress.seen, Mark(5, 105), tokens.get)


def test_nothing_is_written_by_a_cached_number(lost):
    """A removal ends the timeline that was meant, or nothing: not the one that has its number now."""
    kb, other = lost
    with pytest.raises(StoreWentBack):
        until_connected(lambda: kb.remove("(clean r5)"))
    kb.remove("(clean r5)", "(clean q7)")
    assert [n for n in range(20) if not other.holds(f"(clean q{n})")] == [7]


@pytest.mark.parametrize(
    "ask",
    [
        lambda kb: kb.holds("(clean r5)"),
        lambda kb: kb.holds("(exists (?r - room) (clean ?r))"),
        lambda kb: kb.state(),
        lambda kb: kb.history("(clean r5)"),
        lambda kb: list(kb.changes()),
        lambda kb: kb.when("(clean r5)", 0, kbstore.seconds(10)),
        lambda kb: kb.explain("(clean r5)"),
        lambda kb: kb.to_pddl(),
        lambda kb: kb.transaction(note="none").__enter__(),
    ],
    ids=["point", "condition", "state", "history", "changes", "when", "explain", "pddl", "transaction"],
)
def test_every_method_raises_store_went_back_first(lost, ask):
    """The first call of any method raises, before anything is answered or written."""
    kb, other = lost
    with pytest.raises(StoreWentBack):
        until_connected(lambda: ask(kb))
    assert len(other.state().facts) == 20
    assert {str(fact) for fact in kb.state().facts} == {f"(clean q{n})" for n in range(20)}


def test_a_reader_gets_right_answers_without_an_error(store, opened):
    """A process that lost nothing of its own works on, without any earlier cached answer."""
    writer, reader = opened(store.url, "kenny"), opened(store.url, "kenny")
    writer.load(DOMAIN)
    store.save()
    for items in rooms("r"):
        until_connected(lambda: writer.add(*items))  # noqa: B023 - called at once
    assert until_connected(lambda: reader.holds("(clean r5)"))
    assert not reader.holds("(clean r50)")
    store.restore()
    other = opened(store.url, "kenny")
    other.load(OTHER)
    for items in rooms("q"):
        other.add(*items)
    other.add("(tidy q1)")
    assert until_connected(lambda: reader.holds("(tidy q1)"))
    assert not reader.holds("(clean r5)")
    assert reader.holds("(clean q5)")
    assert [str(fact) for fact in reader.state().facts if "tidy" in str(fact)] == ["(tidy q1)"]
    reader.remove("(clean q5)")
    assert [n for n in range(20) if not other.holds(f"(clean q{n})")] == [5]


def test_a_loss_is_noticed_after_more_writes_than_were_lost(lost):
    """A number higher than before does not hide the loss: the token of the last seen transaction is compared."""
    kb, other = lost
    for n in range(5):
        other.add(f"(= (dust q{n}) 1)")
    with pytest.raises(StoreWentBack, match=r"kenny was at transaction 4, and is at transaction 9"):
        until_connected(lambda: kb.value("(dust q1)"))
    assert kb.value("(dust q1)") == 1


def test_a_store_with_new_transactions_did_not_go_back(store, opened):
    """Transactions of others drop no cached answer, raise no error, and lose nothing."""
    kb, other = opened(store.url, "kenny"), opened(store.url, "kenny")
    kb.load(DOMAIN)
    kb.add("hall - room", "(clean hall)")
    for n in range(5):
        other.add(f"(= (dust hall) {n})")
        assert kb.value("(dust hall)") == n
        assert kb.holds("(clean hall)")
    assert kb.remove("(clean hall)").number == 8
    assert not kb._reader.memory.progress.returns


def test_readers_and_writers_in_threads_raise_no_false_alarm(store, opened):
    """A snapshot that is older than another thread's write is not an earlier store."""
    kb = opened(store.url, "kenny")
    kb.load(DOMAIN)
    kb.add("hall - room")
    errors = []

    def work(change):
        try:
            for n in range(40):
                if change:
                    kb.add(f"(= (dust hall) {n})")
                else:
                    kb.state()
                    kb.holds("(clean hall)")
        except Exception as error:
            errors.append(error)

    threads = [threading.Thread(target=work, args=(n % 2 == 0,)) for n in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert not errors
    assert not kb._reader.memory.progress.returns


def test_a_follower_gets_the_error(lost):
    """Q6: a follower would miss changes that have reused numbers; the error has both numbers."""
    kb, other = lost
    with pytest.raises(StoreWentBack):
        until_connected(lambda: list(kb.watch(after=4, timeout=0)))
    with pytest.raises(StoreWentBack, match="was at transaction 9, and is at transaction 4"):
        list(other.changes(after=9))
    assert [change.number for change in other.changes(after=2)] == [3, 4]


def test_a_waiting_watch_gets_the_error(store, opened):
    """A waiting watch raises at its next poll, and does not continue with the earlier numbers."""
    kb, reader = opened(store.url, "kenny"), opened(store.url, "kenny")
    kb.load(DOMAIN)
    kb.add("hall - room")
    store.save()
    until_connected(lambda: kb.add("r1 - room"))
    watching = reader.watch(after=2, timeout=30)
    assert until_connected(lambda: next(watching)).number == 3
    store.restore()
    other = opened(store.url, "kenny")
    other.add("q1 - room")
    with pytest.raises((StoreWentBack, StoreUnavailable)):
        next(watching)


def test_a_listener_gets_the_error(postgresql_store, opened):
    """With notifications no cached answer outlives the store."""
    kb = opened(postgresql_store.url, "kenny", notifications=True)
    kb.load(DOMAIN)
    kb.add("hall - room")
    postgresql_store.save()
    until_connected(lambda: kb.add("(clean hall)"))
    assert [kb.holds("(clean hall)") for _ in range(3)] == [True] * 3
    postgresql_store.restore()

    def ask_again_and_again():
        # the end of the listening connection has to arrive
        deadline = time.monotonic() + 10
        while time.monotonic() < deadline:
            until_connected(lambda: kb.holds("(clean hall)"))

    with pytest.raises(StoreWentBack, match="kenny was at transaction 3, and is at transaction 2"):
        ask_again_and_again()
    assert not kb.holds("(clean hall)")


def test_a_knowledge_base_that_is_gone(store, opened):
    """Where the store goes back to before its creation, the error says so, and its number is not another's."""
    first = opened(store.url, "kenny")
    first.load(DOMAIN)
    store.save()
    second = until_connected(lambda: opened(store.url, "robin"))
    until_connected(lambda: second.load(DOMAIN))
    second.add("hall - room")
    store.restore()
    third = opened(store.url, "rita")
    third.load(DOMAIN)
    third.add("cellar - room")
    for ask in (second.state, lambda: second.add("attic - room")):
        with pytest.raises(StoreWentBack):
            until_connected(ask)
    assert [str(item) for item in third.instances()] == ["cellar - room"]


def test_a_file_copied_back_is_noticed(tmp_path, opened):
    """The same file with other bytes: a new connection compares them, too."""
    path, saved = tmp_path / "store.db", tmp_path / "saved.db"
    kb = opened(path, "kenny")

    def in_a_thread(act):
        found = []

        def run():
            try:
                found.append(act())
            except StoreWentBack as error:
                found.append(error)

        thread = threading.Thread(target=run)
        thread.start()
        thread.join()
        return found[0]

    kb.load(DOMAIN)
    kb.add("hall - room")
    kbstore.backup(path, saved)
    kb.add(*rooms("r")[0])
    kb.add(*rooms("r")[1])
    connections = kb._database._connections
    connections._drop(connections._local.connection)
    for suffix in ("-wal", "-shm"):
        path.with_name(path.name + suffix).unlink(missing_ok=True)
    shutil.copyfile(saved, path)
    with kbstore.open(path, "kenny") as other:
        other.add(*rooms("q")[0])
        other.add(*rooms("q")[1])
    assert isinstance(in_a_thread(lambda: kb.remove("(clean r5)")), StoreWentBack)
    in_a_thread(lambda: kb.remove("(clean r5)"))
    assert in_a_thread(lambda: len(kb.state().facts)) == 20


def test_readers_notice_a_recreated_file(tmp_path, opened):
    """No answer comes from a deleted file: the error says that another file is in its place."""
    path = tmp_path / "store.db"
    kb = opened(path, "kenny")
    kb.add("a - thing", "(p a)")
    assert kb.holds("(p a)")
    for suffix in ("", "-wal", "-shm"):
        path.with_name(path.name + suffix).unlink(missing_ok=True)
    opened(path, "kenny").add("b - thing")
    # looked for every 20 milliseconds at most
    time.sleep(0.05)
    for ask in (lambda: kb.holds("(p a)"), kb.state, lambda: kb.add("(p a)")):
        with pytest.raises(StoreUnavailable, match="moved, deleted or replaced"):
            ask()


def in_another_thread(work):
    """Run a function in another thread, to its end; return its result, or raise its error."""
    with ThreadPoolExecutor(1) as pool:
        return pool.submit(work).result()


def test_reads_from_before_a_restore_are_not_cached_after_it(sqlite_store, monkeypatch):
    """A past state read before a restore, and cached after another thread has noticed, is not used.

    The same holds for a domain, and for the number of a timeline: each belongs to the generation in which it was read.
    """
    clock = kbstore.ManualClock(100)
    with kbstore.open(sqlite_store.url, "kenny", clock=clock) as kb:
        kb.load(DOMAIN)
        kb.add("hall - room", "(clean hall)")
        sqlite_store.save()
        clock.set(200)
        kb.load(OTHER)
        kb.add("attic - room", "(tidy attic)")
    clock.set(300)
    with kbstore.open(sqlite_store.url, "kenny", clock=clock) as kb:
        kb.load(OTHER)
        clock.set(400)
        kb.add("(clean attic)")
        reader, read = kb._reader, type(kb._reader)._data
        turns = []

        def read_and_be_overtaken(self, *arguments):
            found = read(self, *arguments)
            if not turns:
                turns.append("restored")
                sqlite_store.restore()
                with pytest.raises(StoreWentBack):
                    in_another_thread(lambda: kb.state(at=250))
                clock.set(500)
                in_another_thread(lambda: kb.add("cellar - room"))
                turns.append([str(fact) for fact in in_another_thread(lambda: kb.state(at=250)).facts])
            return found

        monkeypatch.setattr(type(reader), "_data", read_and_be_overtaken)
        overtaken = kb.state(at=250)
        assert turns == ["restored", ["(clean hall)"]]
        assert sorted(map(str, overtaken.facts)) == ["(clean hall)", "(tidy attic)"]
        after = in_another_thread(lambda: kb.state(at=250))
        assert [str(fact) for fact in after.facts] == ["(clean hall)"]
        assert "tidy" not in after.domain.predicates


def test_a_domain_read_before_a_restore_is_not_shared(sqlite_store):
    """A thread that began before a restore reads its versions for itself; those that others have read since stay."""
    with kbstore.open(sqlite_store.url, "kenny", clock=kbstore.ManualClock(100)) as kb:
        kb.load(DOMAIN)
        sqlite_store.save()
    with kbstore.open(sqlite_store.url, "kenny", clock=kbstore.ManualClock(200)) as kb:
        kb.load(OTHER)
        reader = kb._reader
        reader.domains.forget(0)
        with reader.repository() as before:
            head = before.head()
            sqlite_store.restore()
            with pytest.raises(StoreWentBack):
                in_another_thread(kb.state)
            assert in_another_thread(lambda: "tidy" in kb.domain.predicates) is False
            assert [version.version for version in reader.domains.all(before, head)] == [1, 2]
        assert "tidy" not in kb.domain.predicates
        assert reader.domains.latest.version == 1
