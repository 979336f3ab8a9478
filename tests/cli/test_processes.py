"""The command line as real processes: exit codes, pipes, terminals, signals."""

import json
import os
import pty
import re
import signal
import subprocess
import sys
from pathlib import Path

import pytest

KBSTORE = [sys.executable, "-W", "error", "-c", "from kbstore.cli import main; main()"]
DOOR = "(open lab_door)"


@pytest.fixture
def environment(recorded):
    """An environment that names the recorded mission, and a terminal of a plain kind."""
    kept = {name: value for name, value in os.environ.items() if name not in ("NO_COLOR", "FORCE_COLOR", "COLUMNS")}
    root = str(Path(__file__).parents[2])
    return {**kept, "KBSTORE_URL": str(recorded), "TERM": "xterm-256color", "PYTHONPATH": root}


@pytest.mark.parametrize(
    ("arguments", "code"),
    [
        (["holds", "(opn lab_door)"], 2),
        (["holds", "(> (battery office_cart) 1)"], 3),
    ],
)
def test_exit_codes(environment, arguments, code):
    """2 is an error, in one line without a traceback; 3 is unknown. 0 and 1 are tested without a process."""
    done = subprocess.run([*KBSTORE, *arguments], env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == code
    assert done.stderr.count("\n") == (1 if code == 2 else 0)
    assert done.stdout.count("\n") == (0 if code == 2 else 1)


def test_a_terminal_gets_colours_and_folded_lines(environment):
    """On a terminal of 80 columns no line is longer, and nothing is cut off."""
    text = on_a_terminal("history", DOOR, environment=environment)
    assert "\x1b[" in text
    assert "…" not in text
    plain = re.sub(r"\x1b\[[0-9;]*m", "", text)
    assert max(map(len, plain.splitlines())) <= 80


def test_a_terminal_gets_no_parquet(environment):
    """Parquet is binary: a file has to be named."""
    text = on_a_terminal("export", "--format", "parquet", environment=environment, code=2)
    assert text.splitlines() == ["kbstore: parquet is not for a terminal to show; name a file with --output FILE"]


def on_a_terminal(*arguments, environment, rows=25, code=0):
    """The output of a command on a terminal of 80 columns."""
    leader, follower = pty.openpty()
    size = {"COLUMNS": "80", "LINES": str(rows)}
    call = [*KBSTORE, *arguments]
    with subprocess.Popen(
        call, env={**environment, **size}, stdin=follower, stdout=follower, stderr=follower
    ) as process:
        os.close(follower)
        shown = b""
        while True:
            try:
                shown += os.read(leader, 65536)
            except OSError:
                break
        assert process.wait() == code
    os.close(leader)
    return shown.decode()


def test_a_long_answer_goes_through_the_pager(environment):
    """On a terminal of ten rows the pager shows it; on a larger one it is printed."""
    environment["PAGER"] = "sed s/^/page:/"
    state = ("state", "--at", "2026-05-04T09:02:00Z")
    assert "page:" in on_a_terminal(*state, environment=environment, rows=10)
    assert "page:" not in on_a_terminal(*state, environment=environment, rows=100)


def test_a_closed_pipe_is_not_an_error(environment):
    """`kbstore changes | head -1` ends without an error."""
    call = f"{sys.executable} -W error -c 'from kbstore.cli import main; main()' changes | head -1"
    done = subprocess.run(["sh", "-c", call], env=environment, capture_output=True, text=True, check=False)
    assert done.stdout.startswith("#1 by mission at 2026-05-04T08:58:00Z")
    assert done.stderr == ""


def test_following_ends_with_ctrl_c(environment, store):
    """`changes --follow` prints past and new changes, line by line, and ends without an error."""
    environment = {**environment, "KBSTORE_URL": str(store)}
    # as in a terminal: a background process inherits that the signal is ignored
    attend = "import signal; signal.signal(signal.SIGINT, signal.default_int_handler)"
    *python, code = KBSTORE
    call = [*python, f"{attend}; {code}", "changes", "--after", "24", "--follow", "--json"]
    with subprocess.Popen(call, env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        try:
            assert json.loads(process.stdout.readline())["number"] == 25
            assert json.loads(process.stdout.readline())["by_clock"] is True
            addition = [*KBSTORE, "add", DOOR, "--client", "guard"]
            subprocess.run(addition, env=environment, capture_output=True, check=True)
            came = json.loads(process.stdout.readline())
            assert (came["number"], came["transaction"]["client"]) == (26, "guard")
            process.send_signal(signal.SIGINT)
            _, complaint = process.communicate(timeout=30)
        finally:
            process.kill()
    assert (process.returncode, complaint) == (130, "")


def test_importing_the_command_line_is_quick(environment):
    """Help does not load modules that only a few commands need: alembic, unified_planning."""
    code = "import sys, kbstore.cli; print(*(name for name in ('alembic', 'unified_planning') if name in sys.modules))"
    done = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=True)
    assert done.stdout.strip() == ""
