"""The page of figures: its tables are made from results, or stay as they are."""

import re

import pytest

from benchmarks.page import PEERS, TABLES, filled
from benchmarks.report import Result
from tests.project.conftest import ROOT

PAGE = "## Writing\n\nIn short:\n\n| old |\n| --- |\n| row |\n\nText.\n\n| kept |\n\n## Growth\n\n| kept, too |\n"

WRITES = [
    Result("single durable add", "raw, the same writes", 285e-6, 159e-6),
    Result('single add, durability="normal"', "raw, the same writes", 130e-6, 52e-6),
    Result("replace 200 values in a transaction, 1,000,000", "raw, the same writes", 4.8e-3, 3.2e-3),
    Result("replace 1,000 values in a transaction, 1,000,000", "raw, the same writes", 27e-3, 18e-3),
    Result("bulk update, 50,000 new facts as items", "raw, the same rows", 1.3, 0.1),
    Result("bulk update, 50,000 new facts as items", "raw, one table, one index", 1.3, 0.1),
    Result("bulk update, 50,000 new facts as texts", "raw, the same rows", 1.3, 0.1),
    Result("load, 100,000 init facts", "raw, the same rows", 2.7, 0.3),
]


def test_a_table_is_replaced_and_the_rest_stays():
    """The first table below a heading is made of the results; text, other tables and other headings stay."""
    page, missing = filled(PAGE, {"Writing": WRITES})
    beginning, _, rest = page.partition(
        "| loading a problem of 100,000 facts | `executemany` of the same rows | 2.7 s | 9.0 |\n"
    )
    assert beginning.startswith(
        "## Writing\n\nIn short:\n\n| what | beside | kbstore | ratio |\n| --- | --- | ---: | ---: |\n"
    )
    assert '| the same, `durability="normal"` | the same | 130 us | 2.5 |' in beginning
    assert rest == "\nText.\n\n| kept |\n\n## Growth\n\n| kept, too |\n"
    assert "Growth: memory while 10^6 facts are ingested" in missing


def test_a_table_that_lacks_a_row_stays():
    """A table without a measured result for a row is left as it is, and the row is named."""
    page, missing = filled(PAGE, {"Writing": WRITES[1:]})
    assert page == PAGE
    assert "Writing: single durable add" in missing


def test_a_row_sums_up_several_results():
    """Several results give the least and the greatest figure and ratio; a unit that they share is written once."""
    growth = [
        Result("growth of state at t, uniform, 100,000", "the same with 10,000", 951e-6, 898e-6),
        Result("growth of state at t, skewed, 100,000", "the same with 10,000", 1.11e-3, 1.11e-3),
        Result("growth of state at t, uniform, 1,000,000", "the same with 100,000", 1.2e-3, 1.1e-3),
        Result(
            "growth of replacing 200 values, 100,000 to 1,000,000", "that of the raw writes", 1.05, 1.18, 1, "times"
        ),
        Result("memory when 1,000,000 facts are ingested", "when half of them were", 197, 197, 1, "MB"),
        Result("bytes an assertion, uniform, 1 step", "160 bytes", 164, 160, 1, "bytes"),
        Result("bytes an assertion, skewed, 10 steps", "160 bytes", 137, 160, 1, "bytes"),
        Result("bytes an assertion, passing objects, 1 step", "160 bytes", 199, 160, 1, "bytes"),
    ]
    page, _ = filled(PAGE, {"Growth": growth})
    assert "| 951 us to 1.11 ms | 1.00 to 1.06 |" in page
    assert "| 137 to 164 bytes | 0.86 to 1.02 |" in page


def test_peers_have_a_column_for_each_comparison():
    """The worst ratio of each comparison is in its column; a dash marks a comparison that was not made."""
    found = [Result("state at t and one question, uniform, 100,000", name, 3.0, 4.0) for name in PEERS]
    found.append(Result("10,000 new facts at once", "DuckDB", 257e-3, 24e-3))
    page, _ = filled("## Peers\n\n| old |\n", {"Peers": found})
    assert "| DuckDB, a table of intervals | 0.75 | - | - | 11 |" in page
    assert "| eventsourcing, snapshots every 500 events | 0.75 | - | - | - |" in page


@pytest.mark.parametrize("title", [*TABLES, "Peers"])
def test_the_page_has_each_table(title):
    """The document has each heading, with a table below it, so filling it reaches all of them."""
    page = (ROOT / "docs" / "performance.md").read_text()
    assert re.search(rf"^## {title}\n(?:(?!\||## ).*\n)*\|", page, re.MULTILINE)
