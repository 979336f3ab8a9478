"""The timeline on a terminal: lanes of text."""

import io

import pytest
from rich.console import Console

import kbstore
from kbstore.cli.demo.mission import moment, record
from kbstore.clock import ManualClock
from kbstore.report.timeline.data import timeline_data
from kbstore.report.timeline.text import TextTimeline, axis


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
    """From 40 columns on, with any names of lanes."""
    assert max(map(len, drawn(timeline_data(kenny), width)[1:-2])) <= width


def test_lanes_show_past_and_schedule(kenny):
    """The door as of 09:00:45: open, scheduled open until 09:10, and explicitly false from then on."""
    data = timeline_data(kenny, ["(open ?)"], as_of=moment("09:00:45"))
    door = lane(drawn(data, 85), "lab_door")
    # 17 minutes in 68 columns of 15 s; as of 09:00:40, in a column that shows the schedule
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


def test_a_line_shows_the_times(kenny):
    """Below the heading, each time begins at its column: the door opens at 09:00, in its column."""
    lines = drawn(timeline_data(kenny), 120)
    times = lines[1]
    assert times.split() == ["08:58", "09:00", "09:02", "09:04", "09:06", "09:08", "09:10", "09:12", "09:14"]
    door = next(line for line in lines if line.strip().startswith("lab_door"))
    assert door.index("█") == times.index("09:00")


@pytest.mark.parametrize(
    ("length", "expected"),
    [
        (20, ["08:58:00", "08:58:05", "08:58:10", "08:58:15"]),
        (3600, ["09:00", "09:10", "09:20", "09:30", "09:40", "09:50"]),
        (86_400, ["09:00", "12:00", "15:00", "18:00", "21:00", "00:00", "03:00", "06:00"]),
        (30 * 86_400, ["2026-05-07", "2026-05-14", "2026-05-21", "2026-05-28"]),
    ],
)
def test_the_times_are_round(length, expected):
    """Seconds, minutes, hours or dates, as dense as 60 columns allow."""
    assert axis(moment("08:58:00"), length * 10**9, 60).split() == expected
    assert len(axis(moment("08:58:00"), length * 10**9, 60)) <= 60


@pytest.mark.parametrize("length", [0, 1, 10**18])
def test_the_times_of_any_span_fit(length):
    """From an empty span to thirty years."""
    assert len(axis(moment("08:58:00"), length, 60)) <= 60


def test_long_labels_lose_their_middle(kenny):
    """On 60 columns two actions with a common beginning are distinguishable."""
    lines = drawn(timeline_data(kenny), 60)
    labels = [line[:30].strip() for line in lines if line.strip().startswith("(pass")]
    assert labels == ["(pass_door k…corridor lab)", "(pass_door k…lab corridor)"]


def test_a_number_shows_its_range(kenny):
    """From 3.5 to 63.5 percent (worked out in the mission's tests); a constant number has one value."""
    lines = drawn(timeline_data(kenny), 80)
    assert any(line.startswith("  kenny 3.5..63.5 ") for line in lines)
    with kbstore.open("sqlite://", "one", clock=(clock := ManualClock(5))) as kb:
        kb.add("(= (f a) 1)")
        clock.set(9)
        kb.add("(= (f b) 2)")
        assert any(line.startswith("  b 2 ") for line in drawn(timeline_data(kb), 80))
