"""`kbstore export` for other tools, read back by independent readers."""

import csv
import io
import json
from decimal import Decimal

import pytest
from pyarrow import parquet
from typer.testing import CliRunner

import kbstore
from kbstore.cli.app import app
from kbstore.cli.demo.mission import moment, record
from kbstore.clock import ManualClock, seconds
from kbstore.messages import Function
from kbstore.report.perfetto import trace_text
from kbstore.report.relations import COLUMNS, csv_text, relation
from tests.exports.test_frames import NASTY, ODD
from tests.timeline.worlds import world


@pytest.fixture(scope="module")
def file(tmp_path_factory):
    path = tmp_path_factory.mktemp("exports") / "kenny.db"
    record(f"sqlite:///{path}").close()
    return path


def export(file, *arguments):
    done = CliRunner().invoke(app, ["export", "--url", str(file), *map(str, arguments)], prog_name="kbstore")
    assert done.exit_code == 0, done.stderr
    return done.stdout_bytes


def refused(file, *arguments):
    done = CliRunner().invoke(app, ["export", "--url", str(file), *arguments], prog_name="kbstore")
    assert (done.exit_code, done.stdout) == (2, "")
    return done.stderr


# -- tables ---------------------------------------------------------------------------------------------------


def test_csv(file):
    """Headings, times that sort as text, empty cells for open ends; only matching rows."""
    rows = list(csv.DictReader(io.StringIO(export(file, "--format", "csv", "(open lab_door)").decode(), newline="")))
    assert [(row["fact"], row["is_negative"], row["initial_time"], row["end_time"]) for row in rows[-2:]] == [
        ("(not (open lab_door))", "true", "2026-05-04T09:10:00.000000000Z", "2026-05-04T09:10:00.000000000Z"),
        ("(not (open lab_door))", "true", "2026-05-04T09:15:00.000000000Z", ""),
    ]
    assert [(row["ended_tx"], row["cancelled_client"]) for row in rows] == [
        ("11", ""),
        ("14", ""),
        ("14", ""),
        ("", "facilities"),
        ("", ""),
    ]


@pytest.mark.parametrize("of", COLUMNS)
def test_csv_and_parquet_have_the_same_cells(file, of, tmp_path):
    """Cell by cell; Parquet has each time in nanoseconds and UTC, and each number as a double."""
    path = tmp_path / "table.parquet"
    assert export(file, "--format", "parquet", "--of", of, "--output", path).decode().startswith(str(path))
    table = parquet.read_table(path)
    lines = list(csv.reader(io.StringIO(export(file, "--format", "csv", "--of", of).decode(), newline="")))
    assert lines[0] == table.schema.names == [name for name, _ in COLUMNS[of]]
    assert len(lines) - 1 == table.num_rows > 5
    for name, *cells in zip(*lines, strict=True):
        for text, cell in zip(cells, table[name], strict=True):
            value = cell.as_py() if not hasattr(cell, "value") else cell.value
            if value is None:
                assert text == ""
            elif isinstance(value, bool):
                assert text == str(value).lower()
            elif hasattr(cell, "value"):
                assert kbstore.time(text) == value
            else:
                assert type(value)(text) == value


def test_csv_of_hostile_text():
    """Quotes, commas, line breaks, markup and other scripts come back as they were written."""
    with kbstore.open("sqlite://", "nasty", clock=ManualClock(ODD)) as kb:
        kb.add("(p <b>a</b>)", client=NASTY, note=NASTY)
        text = csv_text(relation(kb, "transactions"))
    ((number, when, client, note, changes),) = list(csv.reader(io.StringIO(text, newline="")))[1:]
    assert (number, changes, client, note) == ("1", "1", NASTY, NASTY)
    assert when == "2026-05-04T08:58:00.123456789Z"


# -- traces ---------------------------------------------------------------------------------------------------


class Trace:
    """A trace as the Trace Event Format defines it: complete events, beginnings without ends, counters, instants.

    Numbers of microseconds are read by `number`: exactly, or as a double as JavaScript does.
    """

    def __init__(self, text, number=Decimal):
        whole = json.loads(text, parse_float=number, parse_int=number)
        self.about = whole["otherData"]
        self.origin = int(self.about["origin_ns"])
        self.processes, self.threads, self.slices, self.counters, self.instants = {}, {}, [], {}, []
        for event in whole["traceEvents"]:
            place = int(event["pid"]), int(event["tid"])
            t = self.origin + round(event["ts"] * 1000)
            match event["ph"]:
                case "M" if event["name"] == "process_name":
                    self.processes[place[0]] = event["args"]["name"]
                case "M" if event["name"] == "thread_name":
                    self.threads[place] = event["args"]["name"]
                case "X":
                    self.slices.append((place, t, t + round(event["dur"] * 1000), event))
                case "B":
                    self.slices.append((place, t, None, event))
                case "C":
                    self.counters.setdefault((place[0], event["name"]), []).append((t, float(event["args"]["value"])))
                case "i":
                    self.instants.append((t, event))

    def named(self, category):
        """The slices of a category: process, thread, name, begin and end."""
        return [
            (self.processes[place[0]], self.threads[place], event["name"], start, end)
            for place, start, end, event in self.slices
            if event["cat"] == category
        ]

    def facts(self, t):
        """The facts at a time."""
        return {name for *_, name, start, end in self.named("fact") if start <= t and (end is None or t < end)}


def test_a_trace_of_the_mission(file):
    """Facts, runs, numbers and transactions, with names, ends and their transactions."""
    trace = Trace(export(file, "--format", "perfetto"))
    assert trace.origin == moment("08:58:00")
    assert [entry for entry in trace.named("fact") if entry[0] == "open (fact)"] == [
        ("open (fact)", "lab_door", "(open lab_door)", moment("09:00:00"), moment("09:01:00")),
        ("open (fact)", "lab_door", "(not (open lab_door))", moment("09:01:00"), moment("09:04:00")),
        ("open (fact)", "lab_door", "(open lab_door)", moment("09:04:00"), moment("09:15:00")),
        ("open (fact)", "lab_door", "(not (open lab_door))", moment("09:15:00"), None),
    ]
    (aborted,) = [event for *_, event in trace.slices if event["args"].get("broken")]
    assert aborted["name"] == "(pass_door kenny lab_door corridor lab)"
    assert (aborted["args"]["outcome"], aborted["args"]["ended_tx"]) == ("aborted", 12)
    ((_, battery),) = [item for item in trace.counters.items() if item[0][1] == "(battery kenny)"]
    corners = sorted(set(battery))
    assert corners[:4] == [
        (moment("08:58:00"), 62.0),
        (moment("08:58:20"), 62.0),
        (moment("08:58:44"), 56.0),
        (moment("08:59:30"), 56.0),
    ]
    assert corners[-1] == (moment("09:09:10"), 63.5)
    assert [event["args"]["note"] for t, event in trace.instants if t == moment("09:01:00")] == ["all doors closed"]


def test_a_span_of_a_trace(file):
    """Only overlapping events, with their own ends; with `as_of` those on record then."""
    trace = Trace(export(file, "--format", "perfetto", "--since", "2026-05-04T09:08:00Z"))
    assert {name for *_, name, _, _ in trace.named("run")} == {"(charge kenny)"}
    trace = Trace(export(file, "--format", "perfetto", "--as-of", "tx10"))
    assert trace.named("run")[-1][3:] == (moment("09:00:40"), None)
    assert len(trace.instants) == 10


@pytest.mark.parametrize("seed", [1, 2, 3, 4])
def test_a_trace_shows_the_states(seed):
    """V1, C9, L4: in random stories, the slices at each time up to now are the state's facts, corners its numbers."""
    with world(seed) as kb:
        trace = Trace(trace_text(kb))
        known = [each for each in kb.history() if each.cancelled is None and each.superseded is None]
        times = {t for each in known for t in (each.initial_time, each.end_time) if t is not None and t <= kb.now()}
        for t in sorted({t + away for t in times for away in (-1, 0, 1)}):
            if trace.origin <= t <= kb.now():
                assert trace.facts(t) == set(map(str, kb.state(t).facts)), t
        counted = {(name, t): value for (_, name), corners in trace.counters.items() for t, value in corners}
        begins = [each for each in known if isinstance(each.item, Function) and each.end_time != each.initial_time]
        assert begins
        for each in begins:
            if each.initial_time <= kb.now():
                atom = str(each.item.atom)
                assert counted[atom, each.initial_time] == kb.value(atom, each.initial_time)
        assert [t for t, _ in trace.instants] == [change.transaction.time for change in kb.changes()]


@pytest.mark.parametrize("number", [Decimal, float])
def test_nanoseconds_of_a_trace_are_exact(number):
    """Also where a reader takes microseconds as doubles, within 104 days; beyond them, as decimals."""
    clock = ManualClock(ODD)
    ends = [ODD + 1, ODD + 2, ODD + 7, ODD + seconds(3600) + 1, ODD + seconds(103 * 86_400) + 333_333_333]
    ends += [ODD + seconds(20 * 365 * 86_400) + 123_456_789] if number is Decimal else []
    with kbstore.open("sqlite://", "odd", clock=clock) as kb:
        for end in ends:
            kb.add("(p a)")
            clock.set(end)
            kb.remove("(p a)")
        trace = Trace(trace_text(kb), number)
    assert [(start, end) for *_, start, end in trace.named("fact")] == list(zip([ODD, *ends], ends, strict=False))


def test_names_of_a_trace_may_be_anything():
    """Names of processes, threads, slices and counters are JSON texts, also where they look like markup or numbers."""
    with kbstore.open("sqlite://", "nasty", clock=ManualClock(5)) as kb:
        kb.add("(</script> <b>)", "(p)", "(1 2)", "(= (f/x 2) 3)", "(= (q) 4)", client=NASTY, note=NASTY)
        text = trace_text(kb)
    trace = Trace(text)
    assert {(process, thread, name) for process, thread, name, _, _ in trace.named("fact")} == {
        ("</script> (fact)", "<b>", "(</script> <b>)"),
        ("p (fact)", "p", "(p)"),
        ("1 (fact)", "2", "(1 2)"),
    }
    assert sorted(name for _, name in trace.counters) == ["(f/x 2)", "(q)"]
    ((_, event),) = trace.instants
    assert (event["name"], event["args"]["note"]) == (f"#1 by {NASTY}", NASTY)
    assert text.isascii()


def test_an_empty_trace():
    """The trace of an empty knowledge base has no events."""
    with kbstore.open("sqlite://", "empty", clock=ManualClock(5)) as kb:
        trace = Trace(trace_text(kb))
    assert (trace.slices, trace.counters, trace.instants, trace.origin) == ([], {}, [], 5)


# -- options --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        (["--of", "runs"], "--of is for --format csv or --format parquet, not for pddl"),
        (["--format", "perfetto", "(open ?)"], "a pattern is for --format csv or --format parquet, not for perfetto"),
        (["--format", "csv", "--at", "now"], "--at is for --format pddl or --format json, not for csv"),
        (["--format", "jsonl", "--since", "-1h"], "--since is for --format csv or --format parquet or"),
        (["--format", "jsonl", "--as-of", "-1h"], "--as-of is for --format pddl or"),
        (["--format", "parquet", "--domain"], "--domain is for --format pddl or --format json, not for parquet"),
        (["--format", "csv", "(battery kenny)"], "not among the facts"),
        (["--format", "csv", "--of", "transactions", "(open ?)"], "transactions have no pattern"),
    ],
)
def test_options_of_other_formats_are_refused(file, arguments, reason):
    """An option without a meaning for a format is an error, and nothing is written."""
    assert reason in refused(file, *arguments)


def test_jsonl_is_everything(file):
    """``--format jsonl`` writes the same as ``--format json`` without a time."""
    assert export(file, "--format", "jsonl") == export(file, "--format", "json")


def test_a_file_is_not_overwritten(file, tmp_path):
    """An existing file is refused, and stays as it was."""
    path = tmp_path / "there.csv"
    path.write_text("mine")
    assert "File exists" in refused(file, "--format", "csv", "--output", str(path))
    assert path.read_text() == "mine"
