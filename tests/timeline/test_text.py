"""The timeline on a terminal: lanes of text."""

import io

import pytest
from rich.console import Console

from kbstore.cli.demo.mission import moment, record
from kbstore.report.timeline.data import timeline_data
from kbstore.report.timeline.text import TextTimeline


@pytest.fixture(scope="module")
def kenny():
    with record("sqlite://") as kb:
        yield kb


def drawn(data, width):
    console = Console(width=width, file=io.StringIO())
    console.print(TextTimeline(data))
    return console.file.getvalue().splitlines()


def lane(lines, label):
    """A lane's signs, one for each column."""
    (found,) = [line for line in lines if line.strip().startswith(label)]
    return found[found.index(label) + len(label) :].lstrip(" ") if label == "lab_door" else found


@pytest.mark.parametrize("width", [40, 80, 200])
def test_no_line_is_wider_than_the_terminal(kenny, width):
    """From 40 columns on, whatever the lanes are called."""
    assert max(map(len, drawn(timeline_data(kenny), width)[1:-2])) <= width


def test_lanes_show_what_held_and_what_lies_ahead(kenny):
    """The door as of 09:00:45: open, ahead until 09:10, and explicitly false from then on."""
    data = timeline_data(kenny, ["(open ?)"], as_of=moment("09:00:45"))
    door = lane(drawn(data, 85), "lab_door")
    # 17 minutes in 68 columns of 15 s; as of 09:00:40, in a column that shows what lies ahead
    assert door == "█" * 2 + "▒" * 38 + "░" * 20
    assert "as of transaction 10" in drawn(data, 120)[0]


def test_the_signs_of_runs_goals_and_numbers(kenny):
    """A run's line ends with a cross where it was aborted; a number is between its lowest and its highest."""
    lines = drawn(timeline_data(kenny), 120)
    (charge,) = [line for line in lines if "(charge kenny)" in line]
    assert charge.rstrip().endswith("━×")
    (battery,) = [line for line in lines if "█▇" in line]
    assert set("▁▂▃▄▅▆▇█") <= set(battery)
    assert "═" in next(line for line in lines if "(delivered blood lab)" in line)
    assert any(line.startswith("unchanged: dock_at (1), path (6)") for line in lines)
