"""Killed processes, and truncated logs: the store has the first transactions up to some number, and is sound.

KBSTORE_TEST_KILLS sets how many processes are killed (else 50), KBSTORE_TEST_CUTS how often a log is cut (else 100).
"""

import os
import random
import shutil
import signal
import time

import pytest

from tests.processes import start
from tests.robustness import crashes

KILLS = int(os.environ.get("KBSTORE_TEST_KILLS", "50"))
CUTS = int(os.environ.get("KBSTORE_TEST_CUTS", "100"))
ENDLESS = 10**9


@pytest.mark.parametrize(("store", "durability"), [("file", "full"), ("file", "normal"), ("postgresql", "full")])
def test_processes_killed_at_random_moments(store, durability, tmp_path, request):
    """After kill -9 all acknowledged transactions are there, none partially, and the store works."""
    url = request.getfixturevalue("postgresql_url") if store == "postgresql" else f"sqlite:///{tmp_path / 'store.db'}"
    diary = tmp_path / "diary"
    diary.touch()
    chance = random.Random(f"{store} {durability}")
    done = 0
    for _ in range(KILLS * 3 // 5 if (store, durability) == ("file", "full") else max(1, KILLS // 5)):
        process = start(crashes.run, url, diary, durability, ENDLESS)
        # from the opening of the store up to some transactions later
        goal = done + chance.choice((0, 1, 1, 2, 4))
        deadline = time.monotonic() + 60
        while crashes.noted(diary) < goal:
            assert time.monotonic() < deadline
            time.sleep(0.0005)
        time.sleep(chance.random() * 0.02)
        os.kill(process.pid, signal.SIGKILL)
        process.join()
        assert process.exitcode == -signal.SIGKILL
        done = crashes.check(url, max(done, crashes.noted(diary)))
    assert done > KILLS // 5


@pytest.fixture(scope="module")
def crashed(tmp_path_factory):
    """A store of forty transactions whose process was killed: all of them are still in the log."""
    directory = tmp_path_factory.mktemp("crashed")
    diary = directory / "diary"
    url = f"sqlite:///{directory / 'store.db'}"
    crashes.check(url, 0)
    process = start(crashes.run, url, diary, "full", 40)
    process.join(60)
    assert crashes.noted(diary) == 40
    return directory


@pytest.mark.parametrize("behind", ["nothing", "zeros", "garbage"])
def test_logs_cut_at_random_bytes(crashed, tmp_path, behind):
    """A log cut anywhere, also with garbage behind the cut, has the first transactions up to some number.

    A loss of power leaves such a log where it was not yet on the disk; the longer it is, the more transactions it has.
    """
    log = (crashed / "store.db-wal").read_bytes()
    chance = random.Random(behind)
    before = 1
    for cut in sorted(chance.randrange(len(log)) for _ in range(CUTS // 3 + 1)):
        directory = tmp_path / str(cut)
        directory.mkdir()
        shutil.copy(crashed / "store.db", directory)
        rest = len(log) - cut
        tail = {"nothing": b"", "zeros": bytes(rest), "garbage": chance.randbytes(rest)}[behind]
        (directory / "store.db-wal").write_bytes(log[:cut] + tail)
        last = crashes.check(f"sqlite:///{directory / 'store.db'}", 1, in_flight=39)
        assert last >= before
        before = last
        shutil.rmtree(directory)
    assert before > 30
