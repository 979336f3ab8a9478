"""A knowledge base continued in another store: the copy equals the source, row by row, after any failure on the way."""

import os
import random
import re
import shutil
import signal
import sqlite3
import threading
import time
from contextlib import closing

import psycopg
import pytest
import sqlalchemy as sa

import kbstore
from kbstore import Conflict, HistoryUnavailable, InvalidKnowledge, ManualClock, StoreUnavailable, StoreWentBack
from kbstore.storage.engine import make_engine
from kbstore.storage.statements import Statement
from kbstore.transfer import delta_queries
from kbstore.transfer import push as pushing
from tests.robustness.servers import until
from tests.storage.test_plans import goes_through
from tests.transfer import processes
from tests.transfer.pushes import export, following, live_with_tanks, rows, same
from tests.transfer.random_histories import START, answers, live, picture

KILLS = int(os.environ.get("KBSTORE_TEST_KILLS", "30"))
LIVES = (
    ("sqlite to sqlite", "plain"),
    ("sqlite to sqlite", "late"),
    ("sqlite to sqlite", "rates"),
    ("sqlite to postgresql", "late"),
    ("sqlite to postgresql", "rates"),
    ("postgresql to sqlite", "late"),
    ("postgresql to postgresql", "rates"),
)


@pytest.fixture
def stores(request, tmp_path):
    """Make the URLs of a source and a target for a pair of engines; on PostgreSQL two databases of one server."""

    def making(pair):
        found = []
        for number, engine in enumerate(pair.split(" to ")):
            if engine == "sqlite":
                found.append(f"sqlite:///{tmp_path / f'store{number}.db'}")
            else:
                found.append(request.getfixturevalue("empty_database" if number else "postgresql_url"))
        return found

    return making


@pytest.fixture
def name(request):
    """A knowledge base's name that no other test uses."""
    return f"push {request.node.name}"


@pytest.fixture
def engines():
    """Two engines on stores in memory, which are created fast."""
    made = [make_engine("sqlite://") for _ in range(2)]
    yield made
    for engine in made:
        engine.dispose()


def lived(kb, clock, seed, kind, steps=40):
    """The steps of a random story: with late knowledge, without, or with numbers that follow what they read."""
    return (
        live_with_tanks(kb, clock, seed, steps)
        if kind == "rates"
        else live(kb, clock, seed, steps, late=kind == "late")
    )


# -- the copy is the source -----------------------------------------------------------------------------------------


@pytest.mark.parametrize(("pair", "kind"), LIVES)
def test_a_pushed_copy_is_equal(stores, name, pair, kind, monkeypatch):
    """A random story that is pushed in random portions has the same export, byte by byte, after each of them."""
    monkeypatch.setattr(pushing, "CHUNK", 8)
    source, target = stores(pair)
    chance, clock, pushes = random.Random(pair + kind), ManualClock(START), 0
    with kbstore.open(source, name, clock=clock) as kb:
        for _ in lived(kb, clock, 11, kind):
            if chance.random() < 0.05:
                kb.clear()
            if chance.random() < 0.15:
                pushes += bool(kbstore.push(kb, target).transactions)
                assert export(target, name) == export(source, name)
        done = kbstore.push(kb, target)
        assert pushes > 2
        assert (done.name, done.number) == (name, latest(kb))
        assert kbstore.push(kb, target) == kbstore.Pushed(name, done.number, 0, 0)
    assert export(target, name) == export(source, name)


@pytest.mark.parametrize("kind", ["plain", "late", "rates"])
@pytest.mark.parametrize("seed", [1, 2])
def test_a_partial_copy_is_an_earlier_state_of_the_source(engines, kind, seed, monkeypatch):
    """After each part of a push, the copy is the source after that transaction, with future rates (O5)."""
    source, target = engines
    clock, was = ManualClock(START), {}
    with kbstore.open(source, "kenny", clock=clock) as kb:
        for _ in lived(kb, clock, seed, kind):
            was[latest(kb)] = rows(export(source, "kenny"))
        monkeypatch.setattr(pushing, "CHUNK", 1)
        seen = []

        def compare(number, _):
            if number in was:
                seen.append(number)
                assert rows(export(target, "kenny")) == was[number]

        kbstore.push(kb, target, progress=compare)
    assert set(seen) == {number for number in was if number}
    assert export(target, "kenny") == export(source, "kenny")


def latest(kb):
    return max((change.number for change in kb.changes()), default=0)


def test_one_transaction_is_never_divided(engines, monkeypatch):
    """A part has about the wanted length, but at least one transaction; a reader never sees a part of one."""
    source, target = engines
    monkeypatch.setattr(pushing, "CHUNK", 3)
    with kbstore.open(source, "kenny") as kb:
        kb.add(*(f"(p a{number})" for number in range(10)))
        for number in range(6):
            kb.add(f"(q a{number})")
        reported = []
        kbstore.push(kb, target, progress=lambda *step: reported.append(step))
    assert reported == [(1, 7), (4, 7), (7, 7)]


WHOLE = ("recorded[symbols]", "open_runs")
"""Statements that may read all rows: the few arities, and the runs, by an index of their own."""


def test_a_push_reads_by_indexes(tmp_path):
    """A push reads from the source only the pushed rows, by SQLite's plans, and not all of its history."""
    kbstore.open(tmp_path / "store.db", "kenny").close()
    found = {name: value for name, value in vars(delta_queries).items() if isinstance(value, Statement)}
    for name in ("keyed", "recorded"):
        found |= {f"{name}[{table}]": value for table, value in getattr(delta_queries, name).items()}
    found["delete_derived[0]"], found["delete_derived[1]"] = delta_queries.delete_derived
    with closing(sqlite3.connect(tmp_path / "store.db")) as connection:
        for name, statement in found.items():
            parameters = dict.fromkeys(re.findall(r"(?<![:\w]):(\w+)", statement.sqlite), 1)
            plan = [row[3] for row in connection.execute(f"EXPLAIN QUERY PLAN {statement.sqlite}", parameters)]
            through = [step for step in plan if goes_through(step) and "SCAN value" not in step]
            assert not through or name in WHOLE, (name, through)


# -- interrupted ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("engine", ["sqlite", "postgresql"])
def test_killed_at_random_moments(stores, name, engine):
    """A process that pushes is killed 30 times, at different points; each transaction arrives exactly once."""
    source, target = stores(f"sqlite to {engine}")
    chance, clock = random.Random(7), ManualClock(START)
    with kbstore.open(source, name, clock=clock) as kb:
        for _ in live(kb, clock, 21, 60, late=True):
            pass
    kills = 0
    most = KILLS if engine == "sqlite" else KILLS // 3
    while kills < most:
        code = processes.killed(processes.push, source, name, target, chance.choice((1, 2, 4)), chance.randrange(1, 25))
        if code == 0:
            break
        assert code == -signal.SIGKILL
        kills += 1
    assert kills == most
    with kbstore.open(source, name, read_only=True) as kb:
        kbstore.push(kb, target)
    assert export(target, name) == export(source, name)


def test_a_push_over_a_connection_that_is_lost_repeatedly(stores, name):
    """A following push continues after the server has cut it off, again and again, while the source is written to."""
    source, target = stores("sqlite to postgresql")
    marked = sa.make_url(target).update_query_dict({"application_name": "pushing"})
    with kbstore.open(source, name) as kb:
        kb.add("(n a0)")
        with following(kb, marked), psycopg.connect(plain(target), autocommit=True) as admin:
            until(lambda: same(source, target, name))
            cut = 0
            for number in range(1, 2000):
                kb.add(f"(n a{number})")
                cut += len(
                    admin.execute(
                        "SELECT pg_terminate_backend(pid) FROM pg_stat_activity WHERE application_name = 'pushing'"
                    ).fetchall()
                )
                if cut > 2 and number > 60:
                    break
                time.sleep(0.01)
            assert cut > 2
            until(lambda: same(source, target, name))


def plain(url):
    return sa.make_url(url).set(drivername="postgresql").render_as_string(hide_password=False)


@pytest.mark.parametrize("pair", ["sqlite to postgresql", "postgresql to sqlite"])
def test_while_the_source_is_written_to(stores, name, pair):
    """The robot writes all the time, the copy follows: in the end it has everything, and the push ends with `close`."""
    source, target = stores(pair)
    kb, other = kbstore.open(source, name), kbstore.open(source, name)
    with following(kb, target):
        for number in range(150):
            other.add(f"(= (n a{number % 7}) {number})")
        until(lambda: same(source, target, name))
    other.close()


def test_two_robots_push_to_one_server_at_once(tmp_path, empty_database):
    """Both find an empty database, and set it up; the numbers of their knowledge bases do not clash."""
    robots, threads = ("kenny", "lenny"), []
    for robot in robots:
        with kbstore.open(tmp_path / f"{robot}.db", robot) as kb:
            for number in range(30):
                kb.add(f"(at {robot} p{number})")

    def work(robot):
        with kbstore.open(tmp_path / f"{robot}.db", robot) as kb:
            kbstore.push(kb, empty_database)

    for robot in robots:
        threads.append(threading.Thread(target=work, args=(robot,)))
        threads[-1].start()
    for thread in threads:
        thread.join()
    for robot in robots:
        assert export(empty_database, robot) == export(tmp_path / f"{robot}.db", robot)


def test_two_pushes_of_one_knowledge_base_at_once(stores, name, monkeypatch):
    """They take turns at the lock of the copy's head: each transaction arrives once."""
    monkeypatch.setattr(pushing, "CHUNK", 2)
    source, target = stores("sqlite to postgresql")
    with kbstore.open(source, name) as kb:
        for number in range(40):
            kb.add(f"(p a{number})")
        done = []
        threads = [threading.Thread(target=lambda: done.append(kbstore.push(kb, target))) for _ in range(3)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
    assert [pushed.number for pushed in done] == [40] * 3
    assert sum(pushed.transactions for pushed in done) == 40
    assert export(target, name) == export(source, name)


# -- who may write --------------------------------------------------------------------------------------------------


@pytest.fixture
def pushed(stores, name):
    """A source with two transactions, and its copy in another file; their URLs."""
    source, target = stores("sqlite to sqlite")
    with kbstore.open(source, name, clock=ManualClock(START)) as kb:
        kb.add("kenny - robot", "(charged kenny)")
        kb.add("(= (level) 3)")
        kbstore.push(kb, target)
    return source, target


@pytest.mark.parametrize(
    "write",
    [
        lambda kb: kb.add("(p)"),
        lambda kb: kb.remove("(charged kenny)"),
        lambda kb: kb.replace("kenny - robot"),
        lambda kb: kb.update([(0, "(p)")]),
        lambda kb: kb.add_goal("(p)"),
        lambda kb: kb.remove_goal("(p)"),
        lambda kb: kb.add_metric("minimize (total-time)"),
        lambda kb: kb.remove_metric(),
        lambda kb: kb.clear(),
        lambda kb: kb.load("(define (domain d))"),
        lambda kb: kb.ingest(["(p)"]),
        lambda kb: kb.transaction().__enter__(),
    ],
)
def test_a_copy_is_read_only(pushed, name, write):
    """From the first push on, every write is refused, naming its source; reading is not."""
    source, target = pushed
    with kbstore.open(target, name, clock=ManualClock(START)) as copy:
        with pytest.raises(StoreUnavailable, match=r"is a copy here.* in sqlite:////.*store0.db on .*db adopt"):
            write(copy)
        assert copy.holds("(charged kenny)")
    assert export(target, name) == export(source, name)


def test_an_empty_copy_is_read_only(stores, name):
    """An empty knowledge base is pushed, too: its name must not be written to in the meantime."""
    source, target = stores("sqlite to sqlite")
    with kbstore.open(source, name) as kb:
        assert kbstore.push(kb, target).number == 0
        with kbstore.open(target, name) as copy, pytest.raises(StoreUnavailable, match="is a copy here"):
            copy.add("(p)")
        kb.add("(p)")
        assert kbstore.push(kb, target).number == 1


def test_a_first_push_to_a_written_knowledge_base_is_refused(pushed, name, tmp_path):
    """The error has both numbers, and nothing is changed."""
    source, target = pushed
    with kbstore.open(target, "other", clock=ManualClock(START)) as other:
        for number in range(5):
            other.add(f"(p a{number})")
    before = export(target, "other")
    with kbstore.open(source, name) as kb, pytest.raises(Conflict, match=r"others: it is at transaction 5, .* at 2"):
        kbstore.push(kb, target, "other")
    assert export(target, "other") == before


def test_a_first_push_needs_no_import(pushed, name, tmp_path):
    """An imported knowledge base is an original, even with the same history; the error says what to do instead."""
    source, target = pushed
    kbstore.export_knowledge_base(source, name, tmp_path / "kenny.jsonl")
    kbstore.import_knowledge_base(target, tmp_path / "kenny.jsonl", "imported")
    message = r"imported, restored or adopted there.*: it is at transaction 2, .* at 2, with the same history so far"
    with kbstore.open(source, name) as kb:
        with pytest.raises(Conflict, match=message):
            kbstore.push(kb, target, "imported")
        assert kbstore.push(kb, target, "another name").number == 2


def test_a_copy_of_another_is_refused(pushed, name, tmp_path):
    """Of two robots with one name, the second gets an error with the source of the copy, and both numbers."""
    _, target = pushed
    with kbstore.open(tmp_path / "second.db", name) as kb:
        kb.add("(p)")
        with pytest.raises(Conflict, match=r"continues another .*store0.db.*: it is at transaction 2, .* at 1"):
            kbstore.push(kb, target)


def test_a_copy_that_was_written_to_by_sql_is_refused(pushed, name):
    """A write that circumvents the refusal is found by the tokens."""
    source, target = pushed
    engine = sa.create_engine(target)
    with engine.begin() as connection:
        connection.exec_driver_sql("UPDATE heads SET source = NULL")
    engine.dispose()
    with kbstore.open(target, name, clock=ManualClock(START)) as copy:
        copy.add("(p)")
    engine = sa.create_engine(target)
    with engine.begin() as connection:
        connection.exec_driver_sql("UPDATE heads SET source = 'kenny in a file'")
    engine.dispose()
    with kbstore.open(source, name, clock=ManualClock(START)) as kb:
        with pytest.raises(Conflict, match=r"transaction 3, .* at 2, with another history"):
            kbstore.push(kb, target)
        kb.add("(q)")
        with pytest.raises(Conflict, match=r"transaction 3, .* at 3, with another history"):
            kbstore.push(kb, target)


def test_another_world_and_archives_are_refused(pushed, name, tmp_path):
    """An open world does not continue a closed one; an archive is neither pushed nor pushed to."""
    source, target = pushed
    with kbstore.open(tmp_path / "open.db", "open", use_unknowns=True) as kb:
        kb.add("(p)")
        with pytest.raises(InvalidKnowledge, match="use_unknowns=False"):
            kbstore.push(kb, target, name)
    with kbstore.open(source, name, clock=ManualClock(START + 10)) as kb:
        kb.add("(p)")
        kb.archive(START + 5, tmp_path / "archive.db")
        with pytest.raises(InvalidKnowledge, match="is an archive, which nobody writes to"):
            kbstore.push(kb, tmp_path / "archive.db")
    refused = pytest.raises(InvalidKnowledge, match="is an archive here, and not continued elsewhere")
    with kbstore.open(tmp_path / "archive.db", name) as archive, refused:
        kbstore.push(archive, target, "other")


def test_a_copy_is_adopted(pushed, name):
    """A former copy continues as an original, and a push to it is refused from then on, with both numbers."""
    source, target = pushed
    assert pushing.adopt(target, name).startswith(f"{name} in sqlite:////")
    with kbstore.open(target, name, clock=ManualClock(START)) as copy, kbstore.open(source, name) as kb:
        with pytest.raises(Conflict, match=r"it is at transaction 2, .* at 2"):
            kbstore.push(kb, target)
        assert copy.add("(p)").number == 3
        with pytest.raises(Conflict, match=r"it is at transaction 3, .* at 2"):
            kbstore.push(kb, target)
    with pytest.raises(Conflict, match="not a copy"):
        pushing.adopt(target, name)
    with pytest.raises(StoreUnavailable, match="no knowledge base 'nobody'"):
        pushing.adopt(target, "nobody")


def test_a_copy_is_pushed_on(pushed, name, tmp_path):
    """From the robot to the site, and from the site to the fleet."""
    source, target = pushed
    with kbstore.open(target, name, read_only=True) as copy:
        kbstore.push(copy, tmp_path / "third.db")
    assert export(tmp_path / "third.db", name) == export(source, name)


# -- stores that go back, and archives ------------------------------------------------------------------------------


def test_a_source_that_went_back(pushed, name, tmp_path):
    """The error says so: with fewer transactions than the copy, and with others of the same numbers."""
    source, target = pushed
    file = tmp_path / "store0.db"
    shutil.copy(file, tmp_path / "saved.db")
    with kbstore.open(source, name, clock=ManualClock(START)) as kb:
        kb.add("(p)")
        kbstore.push(kb, target)
    shutil.copy(tmp_path / "saved.db", file)
    before = export(target, name)
    with kbstore.open(source, name, clock=ManualClock(START)) as kb:
        with pytest.raises(StoreWentBack, match=r"has lost transactions .* at transaction 3, .* at 2\."):
            kbstore.push(kb, target)
        kb.add("(q)")
        kb.add("(r)")
        with pytest.raises(StoreWentBack, match=r"at transaction 3, .* at 4, with another history"):
            kbstore.push(kb, target)
    assert export(target, name) == before


def test_a_target_that_went_back_is_continued(pushed, name, tmp_path):
    """The transactions that the target lost are pushed again."""
    source, target = pushed
    file = tmp_path / "store1.db"
    shutil.copy(file, tmp_path / "saved.db")
    with kbstore.open(source, name, clock=ManualClock(START)) as kb:
        kb.add("(p)")
        kbstore.push(kb, target)
        shutil.copy(tmp_path / "saved.db", file)
        kb.remove("(charged kenny)")
        assert kbstore.push(kb, target).transactions == 2
    assert export(target, name) == export(source, name)


@pytest.mark.parametrize("kind", ["plain", "late", "rates"])
def test_the_source_archives_and_the_copy_has_everything(stores, name, kind, tmp_path):
    """Q7: pushed history may be archived at the source; the copy still has it, and can archive the same."""
    source, target = stores("sqlite to sqlite")
    clock = ManualClock(START)
    with kbstore.open(source, name, clock=clock) as kb:
        steps = lived(kb, clock, 31, kind)
        for _ in range(20):
            next(steps)
        kbstore.push(kb, target)
        before = list(kb.changes())[-1].time
        known = answers(kb, 0, before - 1, expected=False) if kind == "plain" else {}
        kb.archive(before, tmp_path / "archive.db")
        for _ in steps:
            pass
        kbstore.push(kb, target)
        with kbstore.open(target, name, clock=clock) as copy:
            assert copy.history_from == 0
            found = {t: picture(copy.state(t)) for t in known if isinstance(t, int)}
            assert found == {t: known[t] for t in found}
            copy.archive(before, tmp_path / "second.db")
    assert export(target, name) == export(source, name)


def test_the_copy_archives_and_is_continued(stores, name, tmp_path):
    """Q7: history may be archived at the copy; later transactions that change older rows bring these along."""
    source, target = stores("sqlite to sqlite")
    clock = ManualClock(START)
    with kbstore.open(source, name, clock=clock) as kb:
        for number in range(4):
            kb.add(f"(= (level) {number})", "(p)")
            kb.remove("(p)")
            clock.advance(10)
        kbstore.push(kb, target)
        with kbstore.open(target, name, clock=clock) as copy:
            copy.archive(START + 30, tmp_path / "archive.db")
        kb.add("(= (level) 9)", since=START + 5, until=START + 25)
        kbstore.push(kb, target)
        with kbstore.open(target, name, clock=clock) as copy:
            now = clock.now()
            assert copy.state(now).functions == kb.state(now).functions
            assert copy.history("(level)", START + 30) == kb.history("(level)", START + 30)
            changes, expected = list(copy.changes(8)), list(kb.changes(8))
            assert changes == expected
            copy.archive(now, tmp_path / "archive.db")
            kb.archive(now, tmp_path / "source.db")
    assert export(target, name) == export(source, name)


def test_pushing_after_archiving(stores, name, tmp_path):
    """Q7: a copy without the archived transactions is refused with both numbers; a new one begins with the rest."""
    source, target = stores("sqlite to sqlite")
    clock = ManualClock(START)
    with kbstore.open(source, name, clock=clock) as kb:
        for number in range(3):
            kb.add(f"(= (level) {number})")
            clock.advance(10)
        kbstore.push(kb, target)
        for number in range(3, 9):
            kb.add(f"(= (level) {number})")
            clock.advance(10)
        kb.archive(START + 45, tmp_path / "archive.db")
        with pytest.raises(HistoryUnavailable, match=r"ends with transaction 3, .* at transaction 9, keeps"):
            kbstore.push(kb, target)
        kbstore.push(kb, target, "rest")
        with kbstore.open(target, "rest", clock=clock) as rest:
            assert rest.history_from == START + 45
            assert answers(rest, START + 45, clock.now(), 5) == answers(kb, START + 45, clock.now(), 5)


# -- those who read the copy ----------------------------------------------------------------------------------------


def test_a_copy_is_watched(stores, name):
    """Q6: a watch of the copy gets each transaction once, in order, as it arrives."""
    source, target = stores("sqlite to sqlite")
    with kbstore.open(source, name) as kb:
        kb.add("(p a0)")
        kbstore.push(kb, target)
        with kbstore.open(target, name, read_only=True) as copy:
            watch, found = copy.watch(after=0, poll=0.01, timeout=30), []
            for number in range(1, 6):
                kb.add(f"(p a{number})")
                if number % 2:
                    kbstore.push(kb, target)
            found = [(change.number, str(change.asserted[0].item)) for _, change in zip(range(6), watch, strict=False)]
    assert found == [(number + 1, f"(p a{number})") for number in range(6)]


def test_closed_and_unreachable_stores_are_refused(stores, name):
    """A closed source is refused as usual; so is a target that cannot be reached at first."""
    source, _ = stores("sqlite to sqlite")
    kb = kbstore.open(source, name)
    with pytest.raises(StoreUnavailable):
        kbstore.push(kb, "postgresql+psycopg://nobody@127.0.0.1:1/none?connect_timeout=2", follow=True)
    kb.close()
    with pytest.raises(StoreUnavailable, match="closed"):
        kbstore.push(kb, "sqlite://")
