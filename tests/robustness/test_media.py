"""File systems that are full, or mounted read-only: real ones, which root can mount."""

import os
import re
import shutil
import subprocess
from pathlib import Path

import pytest

import kbstore
from kbstore.errors import StoreUnavailable
from tests.robustness.test_faults import many, sound


class Medium:
    """A small file system in memory."""

    def __init__(self, folder):
        self.folder = folder
        folder.mkdir()
        self._mount("-t", "tmpfs", "-o", "size=1m", "tmpfs", folder)

    def become(self, options):
        """Mount it with other options."""
        self._mount("-o", f"remount,{options}", self.folder)

    def content(self):
        return {file.name: file.read_bytes() for file in self.folder.iterdir()}

    @staticmethod
    def _mount(*arguments):
        subprocess.run(["mount", *arguments], check=True, capture_output=True)


@pytest.fixture
def medium(tmp_path):
    """An empty one of 1 MB."""
    if os.geteuid() != 0 or shutil.which("mount") is None:
        pytest.skip("only root can mount a file system")
    try:
        made = Medium(tmp_path / "medium")
    except subprocess.CalledProcessError as refusal:
        pytest.skip(f"root cannot mount a file system here: {refusal.stderr.decode().strip()}")
    yield made
    subprocess.run(["umount", made.folder], check=True)


def fill(kb, acknowledged):
    for number in range(1000):
        acknowledged.append(kb.add(*many(number * 100, 100), "(increase (counter) 1)"))


def test_a_full_medium(medium, tmp_path):
    """Acknowledged transactions can be read, no more are stored, no copy is left half; with more room it works."""
    with kbstore.open(medium.folder / "store.db", "kenny") as kb:
        kb.add("(= (counter) 0)")
        acknowledged = []
        with pytest.raises(StoreUnavailable, match=r"full|disk I/O error"):
            fill(kb, acknowledged)
        counted = len(acknowledged)
        assert 0 < counted < 1000
        for _ in range(2):
            assert (kb.value("(counter)"), len(kb.state().facts)) == (counted, counted * 100)
            with pytest.raises(StoreUnavailable, match="what was committed before is intact"):
                kb.add(*many(10**6))
        files = set(medium.content())
        with pytest.raises(StoreUnavailable):
            kbstore.backup(medium.folder / "store.db", medium.folder / "copy.db")
        with pytest.raises(StoreUnavailable):
            kbstore.export_knowledge_base(medium.folder / "store.db", "kenny", medium.folder / "kenny.jsonl")
        assert set(medium.content()) == files
        with kbstore.open(kbstore.backup(medium.folder / "store.db", tmp_path / "copy.db"), "kenny") as copy:
            assert copy.value("(counter)") == counted
        medium.become("size=8m")
        assert kb.add("(increase (counter) 1)").number == counted + 2
        assert sound(kb)


def test_creating_a_store_on_a_full_medium(medium):
    """It is refused in one sentence, and created once there is room."""
    (medium.folder / "ballast").write_bytes(bytes(1_000_000))
    with pytest.raises(StoreUnavailable, match=r"store.db: .*(full|disk I/O error)"):
        kbstore.open(medium.folder / "store.db")
    (medium.folder / "ballast").unlink()
    with kbstore.open(medium.folder / "store.db") as kb:
        assert kb.add("(raining)").number == 1


def test_a_medium_that_is_mounted_read_only(medium):
    """A backup opens there; for a file in WAL mode the error says how, and its advice works. Nothing is written."""
    store, copy = medium.folder / "store.db", medium.folder / "copy.db"
    with kbstore.open(store) as kb:
        kb.add("(raining)")
    kbstore.backup(store, copy)
    medium.become("ro")
    before = medium.content()
    with pytest.raises(StoreUnavailable, match="immutable=1") as refusal:
        kbstore.open(store, read_only=True)
    for url in (copy, re.search(r"sqlite:///file\S+immutable\S+", str(refusal.value))[0]):
        with kbstore.open(url, read_only=True) as kb:
            assert kb.holds("(raining)")
            assert len(kb.history("(raining)")) == 1
            with pytest.raises(StoreUnavailable, match="read_only=True"):
                kb.add("(open hall)")
    for path in (store, copy):
        with pytest.raises(StoreUnavailable, match="read_only=True"), kbstore.open(path) as kb:
            kb.add("(open hall)")
    assert medium.content() == before
    medium.become("rw")
    with kbstore.open(store) as kb:
        assert kb.add("(open hall)").number == 2


def test_a_medium_with_a_log_that_is_not_in_the_file(medium, tmp_path):
    """A log left by a crash, or in a copy of a live file, is read, or the file is refused: never read without it."""
    path = medium.folder / "store.db"
    with kbstore.open(tmp_path / "live.db") as kb:
        kb.add("(raining)")
        for suffix in ("", "-wal", "-shm"):
            shutil.copy(tmp_path / f"live.db{suffix}", f"{path}{suffix}")
    medium.become("ro")
    with kbstore.open(path, read_only=True) as kb:
        assert kb.holds("(raining)")
    medium.become("rw")
    Path(f"{path}-shm").unlink()
    medium.become("ro")
    with pytest.raises(StoreUnavailable, match=r"are in store.db-wal: copy both files"):
        kbstore.open(path, read_only=True)
    with pytest.raises(StoreUnavailable, match=r"in store.db-wal, which SQLite does not read with immutable=1"):
        kbstore.open(f"sqlite:///file:{path}?immutable=1&uri=true", read_only=True)
