"""The record as Arrow tables: their exact content, and how pandas and polars read it."""

import re
import sqlite3
import sys
from contextlib import closing

import pandas as pd
import polars as pl
import pyarrow as pa
import pytest

import kbstore
from kbstore.cli.demo.mission import moment, record
from kbstore.clock import ManualClock, seconds
from kbstore.report.relations import COLUMNS
from tests.timeline.worlds import world

NASTY = '</script>"\';\u2028 =cmd, "x"\nß机器人 \\'
ODD = 1_777_885_080_123_456_789
"""A time with nine decimals: 2026-05-04T08:58:00.123456789Z."""


@pytest.fixture(scope="module")
def kenny():
    with record("sqlite://") as kb:
        yield kb


def columns(table, *names):
    """Some columns as a list of rows; times as integers."""
    cells = [[getattr(cell, "value", cell.as_py()) for cell in table[name]] for name in names]
    return list(zip(*cells, strict=True))


def test_facts(kenny):
    """Who opened and closed the door, in order; open ends, and events that did not happen, are null."""
    table = kenny.frame("(open lab_door)")
    names = ("is_negative", "initial_time", "end_time", "recorded_client", "ended_tx", "cancelled_client")
    assert columns(table, *names) == [
        (False, moment("09:00:00"), moment("09:01:00"), "mission", 11, None),
        (True, moment("09:01:00"), moment("09:04:00"), "fire alarm", 14, None),
        (False, moment("09:04:00"), moment("09:15:00"), "facilities", 14, None),
        (True, moment("09:10:00"), moment("09:10:00"), "mission", None, "facilities"),
        (True, moment("09:15:00"), None, "facilities", None, None),
    ]
    assert table["fact"][1].as_py() == "(not (open lab_door))"
    assert (table["name"][1].as_py(), table["arguments"][1].as_py()) == ("open", "lab_door")


def test_numbers(kenny):
    """C7: a number has its value at both ends of each span with one rate; an open span has one end."""
    table = kenny.frame("(battery kenny)", of="numbers", since="2026-05-04T09:06:00Z")
    assert columns(table, "value", "rate", "end_value", "initial_time", "end_time") == [
        (15.5, -0.25, 3.5, moment("09:06:00"), moment("09:06:48")),  # 48 s
        (3.5, 0.0, 3.5, moment("09:06:48"), moment("09:07:10")),
        (3.5, 0.5, 63.5, moment("09:07:10"), moment("09:09:10")),  # 120 s
        (63.5, 0.0, None, moment("09:09:10"), None),
    ]


def test_runs(kenny):
    """Q8: runs, their outcomes, and broken invariants."""
    table = kenny.frame("pass_door", of="runs")
    names = ("action", "started", "expected_end", "ended", "outcome", "duration_s", "started_tx", "ended_tx")
    assert columns(table, *names)[:2] == [
        (
            "(pass_door kenny lab_door corridor lab)",
            moment("09:00:40"),
            moment("09:01:20"),
            moment("09:01:02"),
            "aborted",
            40.0,
            10,
            12,
        ),
        (
            "(pass_door kenny lab_door corridor lab)",
            moment("09:04:10"),
            moment("09:04:50"),
            moment("09:04:50"),
            "ended",
            40.0,
            15,
            16,
        ),
    ]
    assert table["broken"].to_pylist() == [
        "(open lab_door) is false since 2026-05-04T09:01:00Z until 2026-05-04T09:01:02Z",
        None,
        None,
    ]
    (running,) = columns(kenny.frame(of="runs", as_of=moment("09:00:45")).slice(3), "outcome", "ended", "ended_tx")
    assert running == ("running", None, None)


def test_transactions(kenny):
    """Each transaction of the span; with `as_of` those up to it."""
    table = kenny.frame(of="transactions", since="2026-05-04T08:59:00Z", until="2026-05-04T09:00:30Z")
    assert columns(table, "number", "recorded_time", "client") == [
        (7, moment("08:59:10"), "ward"),
        (8, moment("08:59:30"), "mission"),
    ]
    assert table["changes"][0].as_py() == 3  # the parcel, where it was, and the goal to deliver it
    assert table["note"][0].as_py() == "the patient was moved; no linen today"
    fifth = kenny.transactions()[4]
    assert fifth.number == 5
    assert kenny.frame(of="transactions", as_of=fifth)["number"].to_pylist() == [1, 2, 3, 4, 5]


@pytest.mark.parametrize("of", COLUMNS)
def test_types(of):
    """Times are ``timestamp[ns, UTC]``, and an empty knowledge base has the same columns and types as a full one."""
    with kbstore.open("sqlite://", "empty", clock=ManualClock()) as empty, record("sqlite://") as full:
        schema = full.frame(of=of).schema
        assert empty.frame(of=of).num_rows == 0
        assert empty.frame(of=of).schema == schema
    for name in schema.names:
        if re.search("time|started$|expected_end|ended$", name):
            assert schema.field(name).type == pa.timestamp("ns", tz="UTC"), name


def test_nanoseconds_are_exact():
    """A time with nine decimals, and times near 0, are unchanged in pandas and polars."""
    clock = ManualClock(1)
    with kbstore.open("sqlite://", "odd", clock=clock) as kb:
        kb.add("(p a)")
        clock.set(ODD)
        kb.remove("(p a)")
        table = kb.frame("(p a)")
    pandas, polars = table.to_pandas(), pl.from_arrow(table)
    assert pandas["initial_time"][0].value == 1
    assert pandas["end_time"][0].value == ODD
    assert pandas["end_time"][0] == pd.Timestamp("2026-05-04T08:58:00.123456789Z")
    assert polars.schema["end_time"] == pl.Datetime("ns", "UTC")
    assert polars["end_time"].dt.timestamp("ns").to_list() == [ODD]


def test_an_open_end_is_null(kenny):
    """The end of an open assertion is null, in each library."""
    table = kenny.frame("(docked kenny)", since="2026-05-04T09:08:00Z")
    assert table["end_time"].null_count == table.num_rows == 1
    assert table.to_pandas()["end_time"].isna().all()
    assert pl.from_arrow(table)["end_time"].null_count() == 1


def test_free_text_is_unchanged():
    """Free text is unchanged."""
    with kbstore.open("sqlite://", "nasty", clock=ManualClock(5)) as kb:
        kb.add("(p <b>a</b>)", client=NASTY, note=NASTY)
        assert kb.frame()["recorded_client"].to_pylist() == [NASTY]
        assert kb.frame()["arguments"].to_pylist() == ["<b>a</b>"]
        assert kb.frame(of="transactions")["note"].to_pylist() == [NASTY]


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_the_same_as_the_views(tmp_path, seed):
    """Random stories with late knowledge: rows and columns are those of the SQL views."""
    file = tmp_path / "depot.db"
    with world(seed, url=f"sqlite:///{file}") as kb:
        tables = {of: kb.frame(of=of) for of in COLUMNS}
    views = {
        "facts": "fact_history",
        "numbers": "function_history",
        "runs": "run_history",
        "transactions": "transaction_log",
    }
    with closing(sqlite3.connect(file)) as connection:
        connection.row_factory = sqlite3.Row
        for of, view in views.items():
            table = tables[of]
            rows = [dict(row) for row in connection.execute(f"SELECT * FROM {view}")]
            both = [name for name in table.schema.names if name in rows[0]]
            assert len(both) >= 5
            # the view names who ended it by the row's column, the frame also by the schedule
            both = [name for name in both if name not in ("ended_tx", "ended_client")]
            times = [name for name in both if pa.types.is_timestamp(table.schema.field(name).type)]
            found = pl.from_arrow(table).with_columns(
                pl.col(name).dt.strftime("%Y-%m-%dT%H:%M:%S.%9fZ") for name in times
            )
            expected = [tuple(_same(row[name]) for name in both) for row in rows]
            assert sorted(map(repr, (tuple(map(_same, row)) for row in found.select(both).rows()))) == sorted(
                map(repr, expected)
            ), of


def _same(cell):
    """A cell in the form of both: no text, and no number, is None; a flag is 0 or 1."""
    return None if cell == "" else int(cell) if isinstance(cell, bool) else cell


def test_wrong_patterns_are_refused_with_advice(kenny):
    """A pattern of another kind, or an unknown relation, is refused with what to write."""
    with pytest.raises(kbstore.InvalidKnowledge, match="not among the facts; ask with of='numbers'"):
        kenny.frame("(battery kenny)")
    with pytest.raises(kbstore.InvalidKnowledge, match="not among the numbers; ask with of='facts'"):
        kenny.frame("(open ?)", of="numbers")
    with pytest.raises(kbstore.InvalidKnowledge, match=r"ask with kb\.history"):
        kenny.frame("? - parcel")
    with pytest.raises(kbstore.InvalidKnowledge, match="give one of facts, numbers, runs, transactions"):
        kenny.frame(of="goals")
    with pytest.raises(kbstore.InvalidKnowledge, match="transactions have no pattern"):
        kenny.frame("(open ?)", of="transactions")
    with pytest.raises(kbstore.UnknownSymbol):
        kenny.frame("(flies ?)")


def test_a_library_that_is_missing_is_named(kenny, monkeypatch):
    """Without the extra, the error names it."""
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    with pytest.raises(ImportError, match=r"pip install 'kbstore\[frames\]'"):
        kenny.frame()


def test_a_history_of_everything(kenny):
    """Q3: without a pattern, the rows of all patterns, in order of time."""
    everything = kenny.history()
    assert [found.initial_time for found in everything] == sorted(found.initial_time for found in everything)
    for pattern in ("(open ?)", "(battery ?)", "? - parcel", "(robot_at ? ?)"):
        listed = kenny.history(pattern)
        assert listed == [found for found in everything if found in listed]
    assert len(everything) == len(kenny.frame()) + len(kenny.frame(of="numbers")) + len(kenny.history("?")) + 1
    assert not any(found.is_goal for found in everything)


def test_after_archiving(tmp_path):
    """Q7: without a span, the kept history; a span that needs archived history is refused."""
    clock = ManualClock(seconds(10))
    with kbstore.open(f"sqlite:///{tmp_path / 'kept.db'}", "kept", clock=clock) as kb:
        kb.add("(p a)")
        clock.set(seconds(20))
        kb.remove("(p a)")
        clock.set(seconds(30))
        kb.add("(p b)")
        kb.archive(seconds(25), tmp_path / "old.db")
        assert kb.frame()["fact"].to_pylist() == ["(p b)"]
        assert kb.frame(of="transactions")["number"].to_pylist() == [3]
        with pytest.raises(kbstore.HistoryUnavailable):
            kb.frame(since=seconds(15))
        with pytest.raises(kbstore.HistoryUnavailable):
            kb.transactions(since=seconds(15))
