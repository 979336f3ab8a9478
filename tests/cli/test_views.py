"""Printing tables that fit, and times that are easy to read."""

import io

import pytest
from rich.console import Console

from kbstore.clock import SECOND, time
from kbstore.report.tables import plural, printable, show, table
from kbstore.report.time_format import TimeFormat, span

HEADINGS = ("fact", "since", "note")
ROWS = [("(open lab_door)", "2026-05-04T09:04:00Z", "all clear; the lab stays open until 09:15 instead"), ("p", "", "")]


def shown(width):
    """The table as it is printed on a terminal of a width."""
    out = io.StringIO()
    show(Console(file=out, width=width), table("Facts", HEADINGS, ROWS))
    return out.getvalue().splitlines()


def test_a_table_with_room_has_a_line_for_each_row():
    """Aligned columns, without blanks at the ends of lines."""
    lines = shown(200)
    assert lines[0] == "Facts"
    assert lines[3] == "(open lab_door)   2026-05-04T09:04:00Z   all clear; the lab stays open until 09:15 instead"
    assert lines[4] == "p"
    assert lines[1].index("since") == lines[3].index("2026")


def test_a_narrower_table_folds_its_widest_column():
    """The other columns stay whole."""
    lines = shown(70)
    assert max(map(len, lines)) <= 70
    assert lines[3].startswith("(open lab_door)   2026-05-04T09:04:00Z   all clear;")
    assert lines[4].startswith(" " * 41)


def test_a_very_narrow_table_writes_each_cell_on_its_own_line():
    """The first cell, then the others, each after its heading; empty cells are left out."""
    assert shown(44) == [
        "Facts",
        "(open lab_door)",
        "    since 2026-05-04T09:04:00Z, note all",
        "    clear; the lab stays open until 09:15",
        "    instead",
        "p",
    ]


@pytest.mark.parametrize(
    ("ns", "text"),
    [
        (0, "0 s"),
        (1, "0.000000001 s"),
        (59 * SECOND + 999_999_999, "59.999999999 s"),
        (60 * SECOND, "1 min"),
        (131 * SECOND - 1, "2 min 11 s"),
        (3600 * SECOND - 1, "1 h"),
        (3660 * SECOND, "1 h 1 min"),
        (86_400 * SECOND, "1 d"),
        (90_000 * SECOND, "1 d 1 h"),
    ],
)
def test_durations(ns, text):
    """Exact below a minute, then to the second, in two units at most."""
    assert span(ns) == text


@pytest.mark.parametrize(
    ("t", "text"),
    [
        ("2026-05-04T12:00:00Z", "now"),
        ("2026-05-04T11:59:59.75Z", "0.25 s ago"),
        ("2026-05-04T11:59:51.23Z", "8.7 s ago"),
        ("2026-05-04T11:59:01.5Z", "58 s ago"),
        ("2026-05-04T12:10:00Z", "in 10 min"),
        ("2026-05-01T12:00:00Z", "3 d ago"),
    ],
)
def test_relative_times(t, text):
    """Before and after, with a precision that depends on the distance."""
    assert TimeFormat(time("2026-05-04T12:00:00Z")).relative(time(t)) == text


def test_brief_times_leave_out_the_common_day():
    """A time on another day is written in full."""
    moments = TimeFormat(time("2026-05-04T12:00:00Z"), brief=True)
    assert moments.absolute(time("2026-05-04T09:02:00.5Z")) == "09:02:00.5"
    assert moments.absolute(time("2026-05-03T09:02:00Z")) == "2026-05-03T09:02:00Z"
    assert moments.absolute(None) == moments.relative(None) == ""


def test_counts_and_free_text():
    """One is singular; control characters are made visible."""
    assert (plural(1, "row"), plural(2000, "row"), plural(2, "entry", "entries")) == (
        "1 row",
        "2,000 rows",
        "2 entries",
    )
    assert printable("a\tb\n\x1b[0m") == r"a b \x1b[0m"
