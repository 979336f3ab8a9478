"""The demonstration as a user sees it at the first run."""

import io
import re
import subprocess
import sys
from pathlib import Path

import pytest
from rich.console import Console

import kbstore
from kbstore.cli.demo import tour


@pytest.fixture(scope="module")
def shown(tmp_path_factory):
    """A run in a separate process and an empty directory: its output and the directory."""
    directory = tmp_path_factory.mktemp("demo")
    call = [sys.executable, "-m", "kbstore.cli.demo"]
    done = subprocess.run(call, cwd=directory, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    return done.stdout, directory


def test_the_answers_are_on_the_page(shown):
    """Each question has its answer below it; the figures are those of the mission's tests."""
    text = re.sub(r" +", " ", shown[0])
    for line in (
        "(not (open lab_door)) 09:01:00 1 min ago",
        "(battery kenny) is 35.5; and 18 facts and numbers of the building, the same throughout",
        "(robot_at kenny lab) true false",
        "(battery kenny) 31 35.5",
        "(not (open lab_door)) 09:10:00 cancelled #1 by mission at 08:58:00 #14 by facilities at 09:04:00",
        "changed (battery kenny) from 56 to 15.5",
        "09:05:32.000000001 09:07:43 2 min 11 s",
        "(open lab_door) is false since 09:01:00 (1 min ago)",
        "(pass_door kenny lab_door corridor lab) 09:00:40 09:01:20 09:01:02 22 s aborted",
        "(pass_door kenny lab_door corridor lab): (open lab_door) was false from 09:01:00 until 09:01:02",
        "09:09:10 09:15:00 5 min 50 s",
        "(robot_at kenny corridor) 09:01:05 09:04:10 localisation",
    ):
        assert line in text


def test_without_a_terminal_there_are_no_colours_and_no_blanks_at_the_ends(shown):
    """Piped into a file, the output is plain text that fits a page."""
    assert "\x1b" not in shown[0]
    assert all(line == line.rstrip() and len(line) <= tour.WIDTH for line in shown[0].splitlines() if "--" not in line)


def test_the_file_is_there_to_explore(shown):
    """The last part names a file; it has the mission, and opens read-only."""
    text, directory = shown
    (file,) = directory.glob("*.db")
    assert str(file) in text.splitlines()
    with kbstore.open(file, "kenny", read_only=True) as kb:
        assert kb.value("(battery kenny)") == 63.5


def test_the_page_of_the_timeline_is_beside_the_file(shown, tmp_path):
    """The demonstration ends with its path; an existing page is left alone."""
    text, directory = shown
    (page,) = directory.glob("*.html")
    assert text.splitlines()[-1] == str(page)
    assert page.read_text("utf-8").startswith("<!doctype html>")
    (tmp_path / "kenny.html").touch()
    assert tour.page_beside(tmp_path / "kenny.db") == tmp_path / "kenny-2.html"


def test_a_second_run_leaves_the_first_file_alone(tmp_path, monkeypatch):
    """Without a file, a new one is made each time."""
    monkeypatch.chdir(tmp_path)
    quiet = Console(file=io.StringIO())
    first, second = tour.run(console=quiet), tour.run(console=quiet)
    assert first != second
    assert first.exists()
    assert second.exists()


def test_an_existing_file_is_refused_in_one_line(tmp_path):
    """An existing file is not touched: one line on standard error, exit 2."""
    file = tmp_path / "mine.db"
    file.write_text("mine")
    call = [sys.executable, "-m", "kbstore.cli.demo", str(file)]
    done = subprocess.run(call, capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert done.stdout == ""
    assert done.stderr.count("\n") == 1
    assert str(file) in done.stderr
    assert file.read_text() == "mine"


def test_a_terminal_gets_colours(tmp_path):
    """On a terminal, important parts are coloured."""
    out = io.StringIO()
    tour.run(tmp_path / "demo.db", Console(file=out, force_terminal=True, width=200, highlight=False))
    assert "\x1b[" in out.getvalue()
    assert Path(tmp_path / "demo.db").exists()
