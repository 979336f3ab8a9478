"""Errors on the command line: one line on standard error, exit 2, nothing else."""

import json
import unicodedata
from pathlib import Path

import pytest

import kbstore
from kbstore.cli.errors import IN_PYTHON

NESTED = "(not " * 20_000 + "(open lab_door)" + ")" * 20_000


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        (["nonsense"], "No such command 'nonsense'"),
        (["state", "--nonsense"], "No such option: --nonsense"),
        (["state", "kenny"], "write (kenny), or --about kenny for an object"),
        (["state", "(flies ?)"], "flies"),
        (["kbs", "superfluous"], "unexpected extra argument"),
        (["holds"], "Missing argument 'CONDITION'"),
        (["holds", "(open lab_door)", "--at"], "--at"),
        (["holds", "(open lab_door)", "--at", "yesterday"], "'yesterday' is not a time; write ISO 8601"),
        (["holds", "(open lab_door)", "--at", "2026-05-04T09:02:00"], "is not a time with an offset"),
        (["holds", "(open lab_door)", "--now", "never"], "'never' is not a time"),
        (["holds", "(open lab_door"], "a ')' is missing"),
        (["holds", "(opn lab_door)"], "has no predicate opn"),
        (["holds", ""], "kbstore: "),
        (["value", "(battery lab)"], "(battery lab)"),
        (["value", "(battery bob)"], "(battery bob) has no value"),
        (["value", "(/ 1 0)"], "divides by 0"),
        (["explain", "(open ? ?)"], "open"),
        (["applicable", "fly", "kenny"], "has no operator fly"),
        (["applicable", "drive", "kenny"], "takes 3"),
        (["history", "(nonsense ?)"], "nonsense"),
        (["when", "(open lab_door)", "--since", "+1h", "--until", "-1h"], "is before since"),
        (["diff"], "Missing argument"),
        (["diff", "--jsno"], "'--jsno' is not a time"),
        (["changes", "--after", "-1"], "--after"),
        (["changes", "--after", "x"], "--after"),
        (["state", "--kb", "nobody"], "there is no knowledge base 'nobody'"),
        (["state", "--url", "no/such/file.db"], "there is no store at no/such/file.db"),
        (["state", "--url", ""], "which store?"),
        (["state", "--url", "mysql://localhost/robots"], "PostgreSQL"),
        (["state", "--url", "://"], "://"),
        (["kbs", "--url", "no/such/file.db"], "no/such/file.db"),
        (["load", "no-such-file.pddl"], "no-such-file.pddl"),
        (["load"], "Missing argument"),
        (["add"], "Missing argument"),
        (["metric", "minimise (total-time)", "--url", "metric.db"], "minimize"),
        (["export", "--format", "xml"], "xml"),
        (["export", "--output", "no/such/problem.pddl"], "no/such/problem.pddl: No such file or directory"),
        (["export", "--output", "."], "."),
        (["import", "no-such-file.jsonl"], "no-such-file.jsonl"),
        (["backup", "no/such/copy.db"], "no/such/copy.db"),
        (["archive", "old.db"], "Missing option '--before'"),
        (["archive", "old.db", "--before", "+1h"], "cannot be archived"),
        (["db", "nonsense"], "No such command 'nonsense'"),
        (["db", "downgrade"], "Missing argument"),
        (["db", "upgrade", "0001", "--schema", "s"], "PostgreSQL"),
        (["goal", "add"], "Missing argument"),
    ],
)
def test_an_error_is_one_line(run, arguments, reason, tmp_path, monkeypatch):
    """The reason on one line of standard error; nothing on standard output; exit 2."""
    monkeypatch.chdir(tmp_path)
    done = run(*arguments)
    assert (done.code, done.out) == (2, "")
    assert done.err.startswith("kbstore: ")
    assert done.err.endswith("\n")
    assert done.err.count("\n") == 1
    assert reason in done.err


def test_all_violations_are_on_the_line(run, store):
    """All violations of a transaction are reported together (D1), each with its item."""
    done = run("add", "x - robt", "(open door9)", "(docked kenny home)", "--url", store)
    assert (done.code, done.err.count("\n")) == (2, 1)
    assert done.err.startswith("kbstore: 3 violations: x - robt: ")
    assert "; (open door9): " in done.err
    assert "; (docked kenny home) has 2 arguments, but " in done.err


def test_a_file_is_refused_with_line_and_column(run, tmp_path, store):
    """The refusal of a PDDL file has the position; the quoted line is left out."""
    problem = tmp_path / "problem.pddl"
    problem.write_text("(define (problem p) (:domain deliveries)\n  (:objects bob - robt)\n  (:init) (:goal (and)))\n")
    done = run("load", problem, "--url", store)
    assert (done.code, done.err.count("\n")) == (2, 1)
    assert f"{problem}:2:" in done.err
    assert "robt" in done.err


def test_deep_nesting_is_an_answer(run):
    """Text as deeply nested as a command line can be is read, not refused with a traceback."""
    assert run("holds", NESTED, "--at", "2026-05-04T09:02:00Z").code == 1


def test_nothing_is_stored_after_an_error(run, store):
    """One invalid item at the end refuses the valid ones, too (C1)."""
    before = run("changes", "--url", store).out
    assert run("add", "(open lab_door)", "x - robt", "--url", store).code == 2
    assert run("changes", "--url", store).out == before


@pytest.mark.parametrize(
    "text", ["(\x1b[31m kenny)", "(\x07 kenny)", "(\u202e kenny)", "(opn\u2028 \r\n kenny)", "(((("]
)
def test_control_characters_of_arguments_are_escaped(run, text):
    """Control characters of a bad argument are printed visibly, on the one line."""
    done = run("holds", text)
    assert (done.code, done.out) == (2, "")
    assert len(done.err.splitlines()) == 1
    assert done.err.removesuffix("\n").isprintable()


def test_control_characters_of_notes_are_escaped(run, store):
    """Clients and notes are free text; control characters in them are printed visibly."""
    run("add", "(open lab_door)", "--client", "a\x1b[31mb", "--note", "two\nlines \x07", "--url", store)
    for command in (["changes", "--after", "25"], ["explain", "(open lab_door)"], ["history", "(open lab_door)"]):
        shown = run(*command, "--url", store)
        assert "a\\x1b[31mb" in shown.out
        assert shown.out.replace("\n", "").isprintable()


def test_json_is_harmless_too(run, store):
    """Control characters are escaped; letters of other scripts stay, and programs read the original text."""
    note = "\x1b[31m \x9b1m \u202e \u2028 \x7f \U000e0041 \U0001f916 Röntgen 机器人"
    run("add", "(open lab_door)", "--note", note, "--url", store)
    for command in (["changes", "--after", "25", "--json"], ["explain", "(open lab_door)", "--json"]):
        shown = run(*command, "--url", store).out
        assert not [char for char in shown if char != "\n" and unicodedata.category(char).startswith(("C", "Zl", "Zp"))]
        assert "Röntgen 机器人" in shown
    assert json.loads(shown)["transaction"]["note"] == note


@pytest.mark.parametrize("advice", IN_PYTHON)
def test_replaced_advice_still_occurs(advice):
    """Each piece of advice that is turned into a command occurs in some message, word by word."""
    sources = "".join(
        path.read_text() for path in Path(kbstore.__file__).parent.rglob("*.py") if "cli" not in path.parts
    )
    assert advice.partition("(")[0] in sources


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        (["value", "(battery"], "a ')' is missing"),
        (["start", "pick_up", "kenny", "blood", "office"], "; kbstore apply does all of it"),
        (["apply", "drive", "kenny", "home", "office"], "; kbstore start it, and kbstore end it when it is done"),
        (["start", "charge", "kenny"], "; give one, for instance --duration 30s"),
        (["export", "--domain", "--url", "empty.db"], "; load one: kbstore load domain.pddl"),
    ],
)
def test_advice_is_given_in_commands(run, arguments, reason, tmp_path, monkeypatch):
    """Errors on the command line name commands, not Python."""
    monkeypatch.chdir(tmp_path)
    run("add", "a - place", "--url", "empty.db")
    done = run(*arguments)
    assert done.code == 2
    assert reason in done.err
    assert not [word for word in ("kb.", "()", "kbstore.") if word in done.err]
