"""The header of the WAL-index: others after each commit, and found only where it is certain."""

import sqlite3
import sys

import pytest

import kbstore
from kbstore import ManualClock
from kbstore.storage import wal_index
from kbstore.storage.wal_index import find_header
from tests.conftest import START

linux = pytest.mark.skipif(sys.platform != "linux", reason="only Linux says what a process has in memory")


@pytest.fixture
def path(tmp_path):
    """A file in WAL mode, with one table."""
    found = tmp_path / "of two words.db"
    with sqlite3.connect(found) as connection:
        connection.execute("PRAGMA journal_mode = WAL")
        connection.execute("CREATE TABLE t (x)")
    connection.close()
    return str(found)


@pytest.fixture
def connection(path):
    """A connection that has read from the file."""
    connection = sqlite3.connect(path, isolation_level=None)
    connection.execute("SELECT * FROM t").fetchall()
    yield connection
    connection.close()


@linux
def test_a_commit_changes_the_header_and_nothing_else_does(path, connection):
    """Commits of any connection change it, at once; reading and rolling back don't."""
    header = find_header(path)
    assert header is not None
    other = sqlite3.connect(path, isolation_level=None)
    seen = {header.raw}
    for writer in (other, connection, other):
        writer.execute("INSERT INTO t VALUES (1)")
        assert header.raw not in seen
        seen.add(header.raw)
        for reader in (other, connection):
            reader.execute("SELECT * FROM t").fetchall()
            reader.execute("BEGIN IMMEDIATE")
            reader.execute("INSERT INTO t VALUES (2)")
            reader.execute("ROLLBACK")
        assert header.raw in seen
    other.close()


@linux
def test_a_link_leads_to_the_same_header(path, connection, tmp_path):
    """The shared memory has the name of the file itself."""
    link = tmp_path / "link.db"
    link.symlink_to(path)
    assert find_header(str(link)).raw == find_header(path).raw


def test_no_header_is_taken_for_granted(path, connection, tmp_path, monkeypatch):
    """There is none in memory, for a file that is missing or not in WAL mode, and where the system says nothing."""
    assert find_header(None) is None
    assert find_header(str(tmp_path / "missing.db")) is None
    plain = tmp_path / "plain.db"
    with sqlite3.connect(plain) as other:
        other.execute("CREATE TABLE t (x)")
        assert find_header(str(plain)) is None
    other.close()
    monkeypatch.setattr(wal_index, "_MAPS", str(tmp_path / "missing"))
    assert find_header(path) is None


@linux
def test_two_headers_of_one_file_are_none(path, connection, tmp_path, monkeypatch):
    """Where another copy of SQLite has the file open, nothing says whose mapping is whose."""
    with open("/proc/self/maps") as file:
        lines = file.readlines()
    line = next(line for line in lines if line.endswith(".db-shm\n"))
    maps = tmp_path / "maps"
    monkeypatch.setattr(wal_index, "_MAPS", str(maps))
    maps.write_text("".join(lines))
    assert find_header(path) is not None
    maps.write_text("".join([*lines, line]))
    assert find_header(path) is None
    inode = line.split()[4]
    maps.write_text(line.replace(f" {inode} ", f" {int(inode) + 1} "))
    assert find_header(path) is None


@pytest.mark.parametrize("maps", ["/proc/self/maps", "missing"])
def test_answers_about_now_are_right_with_and_without_it(tmp_path, monkeypatch, maps):
    """An answer that is remembered is not given any more once somebody has committed, or the clock has gone on."""
    monkeypatch.setattr(wal_index, "_MAPS", maps)
    clock = ManualClock(START)
    store = tmp_path / "store.db"
    with kbstore.open(store, clock=clock) as kb, kbstore.open(store, clock=clock) as other:
        door = kbstore.item("(open door)")
        level = kbstore.Function(attribute_name="level", values=["tank"])
        kb.add(door, "(= (level tank) 1)")
        for number, writer in enumerate((kb, other, other, kb), 2):
            for _ in range(3):
                assert kb.holds(door) is kb.holds("(open door)") is other.holds(door) is (number % 2 == 0)
                assert kb.value(level) == kb.value("(level tank)") == other.value(level) == number - 1
            writer.update([(kbstore.UpdateType.ADD_KNOWLEDGE, f"(= (level tank) {number})")])
            (writer.remove if number % 2 == 0 else writer.add)(door)
        kb.add(door)
        kb.add("(not (open door))", initial_time=START + 10)
        kb.add("(increase (level tank) (* #t 2))")
        assert [kb.holds(door), kb.holds(door), kb.value(level), kb.value(level)] == [True, True, 5, 5]
        clock.advance(9)
        assert kb.holds(door)
        assert kb.value(level) == 5 + 2 * (9 / 1e9)
        clock.advance(1)
        assert not kb.holds(door)
        with kb.transaction() as transaction:
            transaction.add("(open door)")
            assert transaction.holds("(open door)")
        assert kb.holds(door)
        assert other.holds(door)
