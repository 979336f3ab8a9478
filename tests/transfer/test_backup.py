"""Backups: the state of a whole store at one time, in one file, while writers work."""

import os
import sqlite3

import pytest
import sqlalchemy as sa

import kbstore
from kbstore import InvalidKnowledge, ManualClock, StoreUnavailable
from kbstore.storage import schema
from kbstore.transfer import backup as backing_up
from kbstore.transfer import rows
from tests.transfer.random_histories import START, answers, live


@pytest.fixture(params=["sqlite", "postgresql"])
def url(request, tmp_path):
    """The URL of an empty store on each engine."""
    if request.param == "sqlite":
        yield f"sqlite:///{tmp_path / 'store.db'}"
        return
    server = request.getfixturevalue("postgresql_url")
    named = schema.in_schema(server, "backed_up")
    schema.upgrade(server, schema="backed_up")
    yield named.render_as_string(hide_password=False)
    schema.downgrade(server, "base", schema="backed_up")


@pytest.fixture
def in_steps(monkeypatch):
    """Make backups in small steps, between which others can write."""
    monkeypatch.setattr(backing_up, "_PAGES", 10)
    monkeypatch.setattr(rows, "BATCH", 3)


def test_a_backup_answers_as_the_store(url, tmp_path):
    """Every knowledge base of a store is in its backup, and gives the same answers."""
    expected = {}
    for seed in (21, 22):
        clock = ManualClock(START)
        with kbstore.open(url, f"kb{seed}", clock=clock, use_unknowns=seed == 22) as kb:
            for _ in live(kb, clock, seed, 20, late=True):
                pass
            expected[kb.name] = clock, answers(kb, 0, clock.now())
    assert kbstore.backup(url, tmp_path / "copy.db") == tmp_path / "copy.db"
    assert kbstore.knowledge_bases(tmp_path / "copy.db") == ["kb21", "kb22"]
    for name, (clock, known) in expected.items():
        with kbstore.open(tmp_path / "copy.db", name, clock=clock) as kb:
            assert answers(kb, 0, clock.now()) == known
            assert kb.use_unknowns is (name == "kb22")
            assert kb.add("new - robot").number == known["changes"][-1][0] + 1


def test_a_backup_is_restored_by_export_and_import(url, tmp_path):
    """A knowledge base is restored from a backup into any store, exactly as it was."""
    clock = ManualClock(START)
    with kbstore.open(url, "lost", clock=clock) as kb:
        for _ in live(kb, clock, 23, 15):
            pass
        known = answers(kb, 0, clock.now())
    kbstore.backup(url, tmp_path / "copy.db")
    kbstore.export_knowledge_base(tmp_path / "copy.db", "lost", tmp_path / "lost.jsonl")
    kbstore.import_knowledge_base(url, tmp_path / "lost.jsonl", "found")
    with kbstore.open(url, "found", clock=clock) as kb:
        assert answers(kb, 0, clock.now()) == known


def test_writers_do_not_wait_for_a_backup(url, tmp_path, in_steps):
    """A backup has the state of one time, with any writes between its steps; no writer waits, no restart."""
    clock = ManualClock(START)
    with kbstore.open(url, "busy", clock=clock) as kb:
        kb.add("(= (one) 1)", "(= (two) 1)")
        reported = []

        def write(done, total):
            reported.append((done, total))
            with kbstore.open(url, "busy", clock=clock) as writer:
                writer.add("(increase (one) 1)", "(increase (two) 1)")

        kbstore.backup(url, tmp_path / "copy.db", progress=write)
        assert kb.value("(one)") == kb.value("(two)") == 1 + len(reported)
    assert len(reported) > 3
    assert reported == sorted(reported)
    assert reported[-1][0] == reported[-1][1]
    with kbstore.open(tmp_path / "copy.db", "busy", clock=clock) as kb:
        assert [change.number for change in kb.changes()] == [1]
        assert kb.value("(one)") == kb.value("(two)") == 1


def test_a_store_in_memory(tmp_path):
    """A store in memory is backed up through its engine."""
    engine = sa.create_engine("sqlite://", poolclass=sa.StaticPool, connect_args={"check_same_thread": False})
    with kbstore.open(engine, "kenny", clock=ManualClock(5)) as kb:
        kb.add("(here)")
        kbstore.backup(engine, tmp_path / "copy.db")
        kb.add("(there)")
    with kbstore.open(tmp_path / "copy.db", "kenny", clock=ManualClock(6)) as kb:
        assert [str(fact) for fact in kb.state().facts] == ["(here)"]
    engine.dispose()


def test_a_backup_is_one_file_that_can_be_read_anywhere(url, tmp_path):
    """A backup is a single sound file, which opens read-only where nothing can be written beside it."""
    kbstore.open(url, "kenny").close()
    shelf = tmp_path / "shelf"
    shelf.mkdir()
    kbstore.backup(url, shelf / "copy.db")
    assert os.listdir(shelf) == ["copy.db"]
    connection = sqlite3.connect(f"file:{shelf / 'copy.db'}?immutable=1", uri=True)
    assert connection.execute("PRAGMA integrity_check").fetchone() == ("ok",)
    assert connection.execute("PRAGMA journal_mode").fetchone() == ("delete",)
    connection.close()
    with kbstore.open(shelf / "copy.db", "kenny", read_only=True) as kb:
        assert kb.state().facts == []
    assert os.listdir(shelf) == ["copy.db"]


def test_nothing_is_overwritten_and_no_partial_file_is_left(url, tmp_path, in_steps):
    """An existing file is refused, also the store's own; an interrupted backup leaves nothing."""
    with kbstore.open(url, "kenny", clock=ManualClock(5)) as kb:
        kb.add("(here)")
    there = tmp_path / "there.db"
    there.write_text("precious")
    with pytest.raises(InvalidKnowledge, match="exists, and is not overwritten"):
        kbstore.backup(url, there)
    assert there.read_text() == "precious"
    before = sorted(os.listdir(tmp_path))

    def interrupt(done, total):
        if done * 2 > total:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        kbstore.backup(url, tmp_path / "copy.db", progress=interrupt)
    assert sorted(os.listdir(tmp_path)) == before
    with pytest.raises(StoreUnavailable, match="No such file or directory"):
        kbstore.backup(url, tmp_path / "nowhere" / "copy.db")


def test_a_full_disk(tmp_path, monkeypatch):
    """Where there is no room for the copy, the error says so, and nothing is left of it."""
    kbstore.open(tmp_path / "store.db").close()
    connecting = sqlite3.connect

    def small(path, **options):
        connection = connecting(path, **options)
        if "partial" in str(path):
            connection.execute("PRAGMA max_page_count = 3")
        return connection

    monkeypatch.setattr(backing_up.sqlite3, "connect", small)
    with pytest.raises(StoreUnavailable, match=r"copy\.db: .*full; nothing has been written"):
        kbstore.backup(tmp_path / "store.db", tmp_path / "copy.db")
    assert os.listdir(tmp_path) == ["store.db"]


def test_a_backup_needs_a_store(tmp_path):
    """Backing up a store that does not exist does not create it."""
    with pytest.raises(StoreUnavailable, match="there is no store at"):
        kbstore.backup(tmp_path / "missing.db", tmp_path / "copy.db")
    assert not list(tmp_path.iterdir())
    with pytest.raises(kbstore.SchemaOutOfDate, match="has no schema yet"):
        kbstore.backup("sqlite://", tmp_path / "copy.db")
