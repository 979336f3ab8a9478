"""`kbstore bag`: its output, and its refusals."""

import json
import subprocess
import sys

from mcap.reader import make_reader

from tests.ros.bag_files import DOMAIN, write


def twice(messages):
    """Two snapshots of one time, of which the last counts."""
    yield 5, "/problem_expert/knowledge", messages.knowledge(["a"], ["(open a)"])
    yield 5, "/problem_expert/knowledge", messages.knowledge(["a", "b"], ["(open b)"])


def test_the_command(run, tmp_path):
    """`kbstore bag import` names the knowledge base after the bag; its last line and its JSON have the result."""
    bag, store = write(tmp_path / "monday", "mcap", twice), tmp_path / "robot.db"
    domain = tmp_path / "domain.pddl"
    domain.write_text(DOMAIN)
    done = run("bag", "import", next(bag.glob("*.mcap")), "--url", store, "--domain", domain, "--kb", "monday")
    assert (done.code, done.err) == (0, "")
    at = "1970-01-01T00:00:00.000000005Z"
    assert done.words == [f"monday: 2 new transactions from 1 message of {at} to {at}"]
    again = run("bag", "import", bag, "--url", store, "--json")
    assert json.loads(again.out) == {
        "knowledge_base": "monday",
        "messages": {"/problem_expert/knowledge": 1},
        "transactions": 0,
        "since": at,
        "since_ns": 5,
        "until": at,
        "until_ns": 5,
        "left_out": [],
    }
    missing = run("bag", "import", tmp_path / "none.bag", "--url", store)
    assert (missing.code, missing.err) == (2, f"kbstore: {tmp_path / 'none.bag'}: No such file or directory\n")


def test_export(run, tmp_path):
    """A new file of the mission, with the states of a span; an existing file is kept."""
    file = tmp_path / "kenny.mcap"
    span = "--since", "2026-05-04T09:00:00Z", "--until", "2026-05-04T09:02:00Z"
    done = run("bag", "export", file, *span, "--json")
    assert done.code == 0
    with file.open("rb") as opened:
        messages = [found for _, _, found in make_reader(opened).iter_messages()]
    assert done.json["messages"] == len(messages)
    assert (done.json["file"], done.json["since"]) == (str(file), "2026-05-04T09:00:00Z")
    assert done.json["since_ns"] == messages[0].log_time
    again = run("bag", "export", file)
    assert again.code == 2
    assert again.err == f"kbstore: {file} exists, and is not overwritten; remove it, or give another name\n"
    assert run("bag", "export", tmp_path / "all.mcap").out.startswith(f"{tmp_path / 'all.mcap'} has ")


_WITHOUT_ROSBAGS = """
import sys
sys.modules["rosbags"] = None
from kbstore.cli import main
sys.argv = ["kbstore", *sys.argv[1:]]
main()
"""


def test_without_rosbags_the_extra_is_named(tmp_path):
    """The error is one line that says what to install; in a process of its own, as others have it imported."""
    command = [sys.executable, "-c", _WITHOUT_ROSBAGS, "bag", "import", tmp_path / "x.bag", "--url", tmp_path / "r.db"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr.count("\n") == 1
    assert "pip install 'kbstore[bags]'" in done.stderr
