"""Archiving while others work, and killed at any time; and the disk space that it frees."""

import io
import json
import os
import shutil
import signal
import sqlite3

import pytest

import kbstore
from kbstore import HistoryUnavailable, ManualClock, seconds
from kbstore.transfer import archive as moving
from kbstore.transfer import rows
from tests.transfer import processes
from tests.transfer.random_histories import START, answers, live, picture

KILLS = int(os.environ.get("KBSTORE_TEST_KILLS", "4"))

BEFORE = START + seconds(12)
"""The time before which history is archived."""


@pytest.fixture
def small_steps(monkeypatch):
    """Few rows at once, so that there are many steps in between."""
    monkeypatch.setattr(rows, "BATCH", 4)
    monkeypatch.setattr(moving, "WINDOW", 5)
    monkeypatch.setattr(moving, "MOST", 3)


@pytest.fixture(scope="module")
def life():
    """The export of a random story, with its answers about the time from `BEFORE` on, and about all of it."""
    clock = ManualClock(START)
    engine = kbstore.storage.engine.make_engine("sqlite://")
    with kbstore.open(engine, "life", clock=clock) as kb:
        for _ in live(kb, clock, 31, 30):
            pass
        output = io.BytesIO()
        kbstore.export_knowledge_base(engine, "life", output)
        last = max(change.number for change in kb.changes() if change.time < BEFORE)
        found = output.getvalue(), clock, last, answers(kb, BEFORE, clock.now(), last), answers(kb, 0, clock.now())
    engine.dispose()
    return found


@pytest.fixture(scope="module")
def stores(tmp_path_factory):
    """A folder with an empty store and an empty archive, to be copied: they are slow to create."""
    folder = tmp_path_factory.mktemp("stores")
    kbstore.open(folder / "store.db", "other", clock=(clock := ManualClock(5))).add("(here)")
    with kbstore.open(folder / "store.db", "other", clock=clock) as kb:
        clock.advance(5)
        kb.remove("(here)")
        kb.archive(10, folder / "archive.db")
    return folder


@pytest.fixture(params=["sqlite", "postgresql"])
def fresh(request, life, stores, tmp_path):
    """Import the story again, into a store on each engine: its URL, its name and the path for its archive."""
    made = []

    def making():
        number = len(made)
        made.append(name := f"life{number}")
        if request.param == "sqlite":
            url = f"sqlite:///{shutil.copy(stores / 'store.db', tmp_path / f'store{number}.db')}"
        else:
            url = request.getfixturevalue("postgresql_url")
        path = shutil.copy(stores / "archive.db", tmp_path / f"archive{number}.db")
        kbstore.import_knowledge_base(url, io.BytesIO(life[0]), f"{name} {tmp_path.name}")
        return url, f"{name} {tmp_path.name}", path

    return making


def test_killed_at_any_moment(fresh, life):
    """Q7: killed at any time, no answer is wrong afterwards, and archiving again finishes."""
    _, clock, last, since, everything = life
    url, name, path = fresh()
    calls = []
    with kbstore.open(url, name, clock=clock) as kb:
        restore = processes.calling(lambda: calls.append(1))
        kb.archive(BEFORE, path)
        restore()
        assert answers(kb, BEFORE, clock.now(), last) == since
    with kbstore.open(path, name) as archive:
        archived = answers(archive, 0, BEFORE - 1, expected=False)
    states = set()
    kills = KILLS if url.startswith("sqlite") else KILLS // 2
    for kill in range(1, kills + 1):
        url, name, path = fresh()
        assert (
            processes.killed(processes.archive, url, name, BEFORE, path, len(calls) * kill // kills) == -signal.SIGKILL
        )
        with kbstore.open(url, name, clock=clock) as kb:
            states.add(kb.history_from)
            if kb.history_from:
                assert answers(kb, BEFORE, clock.now(), last) == since
            else:
                assert answers(kb, 0, clock.now()) == everything
            kb.archive(BEFORE, path)
            assert kb.history_from == BEFORE
            assert answers(kb, BEFORE, clock.now(), last) == since
        with kbstore.open(path, name) as archive:
            assert answers(archive, 0, BEFORE - 1, expected=False) == archived
        assert ended_rows(url, name) == 0
    assert states == {0, BEFORE}


def ended_rows(url, name):
    """The number of stored assertions that ended before `BEFORE`."""
    with rows.opened(url) as database, database.read() as session:
        (kb,) = session.driver.execute(f"SELECT id FROM knowledge_bases WHERE name = '{name}'").fetchone()
        tables = ("instances", "facts", "functions", "expressions", "inequalities")
        ended = f"WHERE kb_id = {kb} AND end_time < {BEFORE}"
        return sum(session.driver.execute(f"SELECT count(*) FROM {table} {ended}").fetchone()[0] for table in tables)


def test_others_work_meanwhile(fresh, life, small_steps):
    """Readers and writers work all the time: no answer is wrong, and no write is lost."""
    _, clock, last, since, everything = life
    url, name, path = fresh()
    numbers, refused = [], []
    with kbstore.open(url, name, clock=clock) as kb, kbstore.open(url, name, clock=clock) as other:

        def work(*_):
            numbers.append(other.add(f"(> (cost) {len(numbers)})", client="other").number)
            state = picture(other.state(at=BEFORE))
            assert {**state, "timed": 0} == {**since[BEFORE], "timed": 0}
            try:
                assert picture(other.state(at=BEFORE - 1))["facts"] == known
                assert not refused
            except HistoryUnavailable:
                refused.append(len(numbers))

        known = picture(other.state(at=BEFORE - 1))["facts"]
        kb.archive(BEFORE, path, progress=work)
        assert len(numbers) > len(refused) > 3
        assert [change.number for change in kb.changes(numbers[0] - 1)] == numbers
        assert kb.state(at=BEFORE).facts == other.state(at=BEFORE).facts
    with kbstore.open(path, name) as archive:
        assert [change.number for change in archive.changes()] == list(range(1, last + 1))
        assert {t: state for t, state in everything.items() if isinstance(t, int) and t < BEFORE} == {
            t: picture(archive.state(at=t)) for t in everything if isinstance(t, int) and t < BEFORE
        }


def test_interrupted_and_not_done_again(fresh, life, small_steps, tmp_path):
    """Q7: what an interrupted archiving has left is not archived twice, nor exported; the next one deletes it."""
    _, clock, _, _, everything = life
    url, name, path = fresh()
    later = BEFORE + seconds(3)
    with kbstore.open(url, name, clock=clock) as kb:

        def interrupt(*_):
            if kb.history_from:
                raise KeyboardInterrupt

        with pytest.raises(KeyboardInterrupt):
            kb.archive(BEFORE, path, progress=interrupt)
        assert ended_rows(url, name) > 3
        output = io.BytesIO()
        kbstore.export_knowledge_base(url, name, output)
        ends = [row.get("end_time", BEFORE) for row in map(json.loads, output.getvalue().splitlines())]
        assert min(ends) >= BEFORE
        kb.archive(later, path)
        assert ended_rows(url, name) == 0
    with kbstore.open(path, name) as archive:
        for t in [t for t in everything if isinstance(t, int) and t < later]:
            assert picture(archive.state(at=t)) == everything[t]


def test_progress_is_reported(fresh, small_steps):
    """Progress rises to its end: rows copied, then rows deleted."""
    url, name, path = fresh()
    reported = []
    with kbstore.open(url, name) as kb:
        archived = kb.archive(BEFORE, path, progress=lambda *step: reported.append(step))
    assert reported == sorted(reported)
    assert reported[-1][0] == reported[-1][1] > archived.rows > 0


def test_disk_space_is_freed(tmp_path, stores):
    """Q7: the file of a store shrinks by the size of its history; the archive is about as large as that."""
    path, clock = tmp_path / "store.db", ManualClock(5)
    shutil.copy(stores / "store.db", path)
    shutil.copy(stores / "archive.db", tmp_path / "archive.db")
    with kbstore.open(path, "long", clock=clock) as kb:
        empty = pages(path)
        for _ in range(90):
            clock.advance(1)
            kb.update([(0, f"(= (level a{number}) {clock.now()})") for number in range(60)])
        full = pages(path)
        kb.archive(clock.now(), tmp_path / "archive.db")
        kept = pages(path)
        assert full > 2 * empty
        assert kept < (empty + full) / 2
        assert len(kb.state().functions) == 60
    assert path.stat().st_size == kept * 4096
    assert pages(tmp_path / "archive.db") > 0.8 * full


def pages(path):
    with sqlite3.connect(path) as connection:
        found = connection.execute("PRAGMA page_count").fetchone()[0]
    connection.close()
    return found
