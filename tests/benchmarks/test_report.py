"""The table: its words for a comparison, and for a peer that could not be measured."""

import io

import pytest
from rich.console import Console

from benchmarks.measuring import CPU, side_by_side
from benchmarks.report import Missing, Result, amount, show


@pytest.mark.parametrize(
    ("ratio", "bar", "verdict"), [(2.5, 2.5, "yes"), (2.51, 2.5, "NO"), (9.0, None, "")], ids=["at", "above", "none"]
)
def test_a_bar_is_met_up_to_itself(ratio, bar, verdict):
    """A ratio equal to the bar meets it; one above does not; without a bar nothing is printed."""
    assert Result("state", "raw", ratio, 1.0, bar).verdict == verdict


@pytest.mark.parametrize(
    ("figure", "unit", "text"),
    [(0.00042, "s", "420 us"), (1.5, "s", "1.5 s"), (4e-8, "s", "40 ns"), (163.2, "bytes", "163 bytes")],
)
def test_figures_have_units_that_suit_them(figure, unit, text):
    """Seconds are printed in the unit in which they are at least one."""
    assert amount(figure, unit) == text


def test_a_peer_that_is_not_installed_has_a_row():
    """The row says that it is not installed."""
    output = io.StringIO()
    show(
        [Result("state", "raw", 3.0, 2.0), Missing("DuckDB", "not installed")],
        Console(file=output, width=120),
        "Asking",
    )
    table = output.getvalue()
    assert "1.50" in table
    (row,) = (line for line in table.splitlines() if "DuckDB" in line)
    assert "not installed" in row


def test_each_way_is_done_in_each_round():
    """Ways take turns: as often as each other, at least the given number of times, and once more beforehand."""
    done = {"one": 0, "other": 0}

    def way(name):
        def run():
            done[name] += 1
            sum(range(200_000))

        return run

    found = side_by_side({name: way(name) for name in done}, clock=CPU, seconds=0, minimum=9)
    assert set(found) == set(done)
    assert all(duration > 0 for duration in found.values())
    # once to warm up, once to see how long it takes
    assert done == {"one": 11, "other": 11}
