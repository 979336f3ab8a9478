"""Questions over time, on the mission."""

import io
import json

from rich.console import Console

import kbstore
from kbstore.cli.demo.mission import moment
from kbstore.report import records


def test_history_lists_who_recorded_and_who_ended(run):
    """One line for each assertion; a cancelled one is marked (Q3). A common day is printed once."""
    words = run("history", "(open lab_door)").words
    assert words[0] == "Times of 2026-05-04, UTC"
    assert words[3:] == [
        "(open lab_door) 09:00:00 09:01:00 1 min #1 by mission at 08:58:00 #11 by fire alarm",
        "(not (open lab_door)) 09:01:00 09:04:00 3 min #11 by fire alarm #14 by facilities",
        "(open lab_door) 09:04:00 09:15:00 11 min #14 by facilities #14 by facilities at 09:04:00",
        "(not (open lab_door)) 09:10:00 cancelled #1 by mission at 08:58:00 #14 by facilities at 09:04:00",
        "(not (open lab_door)) 09:15:00 #14 by facilities at 09:04:00",
    ]


def test_history_of_several_days_has_whole_times(run, store):
    """Where times are on different days, each has its date."""
    run("add", "(open lab_door)", "--now", "2026-05-05T08:00:00Z", "--url", store)
    words = run("history", "(open lab_door)", "--url", store).words
    assert words[2].startswith("(open lab_door) 2026-05-04T09:00:00Z 2026-05-04T09:01:00Z 1 min #1 by mission at 2026-")
    assert words[-1].startswith("(open lab_door) 2026-05-05T08:00:00Z")


def test_history_fits_a_terminal_of_100_columns(recorded):
    """Q3: a row for each assertion; only the columns of transactions are folded."""
    with kbstore.open(recorded, "kenny", clock=kbstore.ManualClock(), read_only=True) as kb:
        console = Console(width=100, file=io.StringIO())
        console.print(records.history_view(kb.history("(open lab_door)")))
    lines = console.file.getvalue().splitlines()
    assert max(map(len, lines)) <= 100
    assert sum(line.startswith(("(open lab_door)  ", "(not (open lab_door))  ")) for line in lines) == 5


def test_history_in_a_span(run):
    """With --since and --until, the assertions that overlap the span."""
    span = ("--since", "2026-05-04T09:04:30Z", "--until", "2026-05-04T09:05:30Z")
    listed = run("history", "(robot_at kenny ?)", *span, "--json").json
    assert [(found["pddl"], found["initial_ns"], found["end_ns"]) for found in listed] == [
        ("(robot_at kenny lab)", moment("09:04:50"), moment("09:05:10"))
    ]
    assert listed[0]["recorded"]["number"] == 16
    assert run("history", "(delivered linen ?)").out == "nothing is recorded of it in that span\n"


def test_when_lists_intervals(run):
    """Intervals are exact to the nanosecond, with their total duration (Q4)."""
    assert run("when", "(< (battery kenny) 20)").words[2:] == [
        "2026-05-04T09:05:32.000000001Z 2026-05-04T09:07:43Z 2 min 11 s",
        "true for 2 min 11 s altogether, in 1 interval",
    ]
    future = ("--since", "now", "--until", "+1h", "--now", "2026-05-04T09:09:10Z", "--json")
    assert run("when", "(open lab_door)", *future).json == [
        {
            "start": "2026-05-04T09:09:10Z",
            "start_ns": moment("09:09:10"),
            "end": "2026-05-04T09:15:00Z",
            "end_ns": moment("09:15:00"),
        }
    ]
    assert run("when", "(delivered linen lab)").out == "never true in that span\n"


def test_diff_takes_times_as_arguments(run):
    """Facts that became true or were withdrawn, and changed numbers (Q5); a relative time is not an option."""
    done = run("diff", "2026-05-04T08:59:00Z", "2026-05-04T09:06:00Z")
    assert "changed (battery kenny) from 56 to 15.5" in done.words
    assert "withdrawn linen - parcel" in done.words
    assert "goal removed (delivered linen lab)" in done.words
    relative = run("diff", "-10m10s", "-3m10s", "--now", "last", "--json").json
    assert relative == run("diff", "2026-05-04T08:59:00Z", "2026-05-04T09:06:00Z", "--json").json
    assert relative["numbers"] == [{"function": "(battery kenny)", "before": 56.0, "after": 15.5}]
    assert run("diff", "-1s", "--now", "last").out != "no difference\n"
    assert run("diff", "now", "now").out == "no difference\n"


def test_changes_lists_the_changes_of_each_transaction(run):
    """With changes by the clock, in the order of time; goals are marked (Q6)."""
    words = run("changes").words
    start = words.index("#7 by ward at 2026-05-04T08:59:10Z the patient was moved; no linen today")
    assert words[start + 1 : start + 4] == [
        "- linen - parcel",
        "- (parcel_at linen office)",
        "- goal (delivered linen lab)",
    ]
    opening = words.index("2026-05-04T09:00:00Z by the clock")
    assert words[opening + 1] == "+ (open lab_door)"
    assert words.index(next(word for word in words if word.startswith("#9 "))) > opening


def test_changes_about_something(run):
    """With a pattern, only matching changes."""
    changes = [json.loads(line) for line in run("changes", "(open ?)", "--after", "10", "--json").out.splitlines()]
    assert [(change["number"], change["by_clock"]) for change in changes] == [(11, False), (14, False), (25, True)]
    assert [item["pddl"] for item in changes[1]["cancelled"]] == ["(not (open lab_door))"]


def test_timeline_writes_a_page(run, tmp_path):
    """A file that ends in .html gets the page; patterns, span and belief are passed on."""
    page = tmp_path / "Kenny.HTML"
    done = run("timeline", str(page), "battery", "--since", "2026-05-04T09:00:00Z", "--as-of", "2026-05-04T09:00:45Z")
    assert (done.code, done.err) == (0, "")
    assert f"{page} shows 8 lanes; open it in a browser" in done.out
    text = page.read_text("utf-8")
    assert text.startswith("<!doctype html>")
    assert '"as_of":10' in text
    done = run("timeline", str(page), "battery", "--json")
    assert done.json == {"file": str(page), "lanes": 9, "transactions": 25}
    assert run("timeline", str(tmp_path / "no" / "x.html")).err.endswith("x.html: No such file or directory\n")


def test_timeline_without_a_file_is_text(run):
    """Without a file the lanes are printed as text, and with --json as data."""
    done = run("timeline", "(open ?)", "--as-of", "2026-05-04T09:00:45Z")
    assert (done.code, done.err) == (0, "")
    assert any("lab_door" in line and "█" in line for line in done.words)
    assert "as of transaction 10" in done.words[0]
    assert run("timeline", "(open ?)", "--json").json["latest"] == 25
