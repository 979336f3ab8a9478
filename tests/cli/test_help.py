"""Help, completion, and the common behaviour of all commands."""

import importlib
import json
import os

import pytest
import typer

from kbstore.cli import completion
from kbstore.cli.app import app
from kbstore.cli.commands import COMMANDS

EVERY = [tuple(command.name.split()) for command in COMMANDS]

ASKED = "2026-05-04T09:02:00Z"
EXAMPLES = {
    "load": None,
    "add": ["(open lab_door)"],
    "remove": ["(open lab_door)"],
    "metric": [],
    "apply": None,
    "start": ["undock", "kenny", "home"],
    "end": None,
    "abort": None,
    "state": ["--at", ASKED],
    "holds": ["(open lab_door)"],
    "find": ["(robot_at ?r ?w)"],
    "wait": ["(docked kenny)"],
    "value": ["(battery kenny)"],
    "explain": ["(open lab_door)"],
    "applicable": ["undock", "kenny", "home"],
    "history": ["(open ?)"],
    "when": ["(open lab_door)"],
    "runs": ["drive"],
    "diff": [ASKED],
    "changes": ["--after", "24"],
    "timeline": ["battery"],
    "mcp": None,
    "ros plansys2": None,
    "ros record": None,
    "ros rosplan": None,
    "bag import": None,
    "bag export": ["kenny.mcap"],
    "serve": None,
    "kbs": [],
    "export": ["--at", ASKED, "--format", "json"],
    "import": None,
    "backup": ["copy.db"],
    "archive": ["old.db", "--before", ASKED],
    "push": ["--to", "fleet.db"],
    "demo": ["demo.db"],
    "goal add": ["(docked kenny)"],
    "goal remove": ["(docked kenny)"],
    "db upgrade": [],
    "db downgrade": ["0001"],
    "db current": [],
    "db check": [],
    "db history": [],
    "db adopt": None,
}

SERVING = {"mcp", "ros plansys2", "ros record", "ros rosplan", "serve"}
"""Commands that serve until they are stopped, and print no answer."""


def test_the_commands_are_those_of_the_list():
    """Every command of the list exists, and no other."""
    assert {" ".join(name) for name in EVERY} == set(EXAMPLES)


@pytest.mark.parametrize("command", EVERY, ids=" ".join)
def test_help_shows_examples_and_json(run, command):
    """Each command's help has its purpose and examples that begin with the command; every question has --json."""
    done = run(*command, "--help")
    assert (done.code, done.err) == (0, "")
    assert ("--json" in done.out) is (" ".join(command) not in SERVING)
    examples = done.out.partition("Examples:")[2].partition("╭")[0]
    lines = [line.strip() for line in examples.splitlines() if line.strip()]
    assert lines
    assert all(line.startswith("kbstore ") and " ".join(command) in line for line in lines)


@pytest.mark.parametrize("command", COMMANDS, ids=lambda command: command.name)
def test_the_line_of_a_command_begins_its_help(command):
    """The line about a command in the help of its group is the first line of its own help."""
    module, _, function = command.function.partition(".")
    called = getattr(importlib.import_module(f"kbstore.cli.{module}"), function)
    assert command.line
    assert called.__doc__.startswith(command.line)


@pytest.mark.parametrize("command", sorted(name for name, arguments in EXAMPLES.items() if arguments is not None))
def test_every_command_answers_in_json(run, store, command, tmp_path, monkeypatch):
    """--json gives one JSON value, or one for each line, and nothing else, before or after the command."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("KBSTORE_URL", str(store))
    done = run(*command.split(), *EXAMPLES[command], "--json")
    assert done.code in (0, 1)
    assert done.err == ""
    if command == "changes":
        assert [json.loads(line)["number"] for line in done.out.splitlines()] == [25, 25]
    else:
        json.loads(done.out)


def test_json_is_accepted_before_the_command(run):
    """--json is accepted before the command, like the other shared options."""
    assert run("--json", "value", "(battery kenny)", "--at", ASKED).json["value"] == 35.5
    assert run("--json", "--now", ASKED, "db", "history").json


def test_without_a_command_help_is_shown(run):
    """`kbstore`, and each of its groups alone, list their commands, and succeed."""
    for group in ((), ("goal",), ("ros",), ("bag",), ("db",)):
        done = run(*group)
        assert (done.code, done.err) == (0, "")
        assert "Usage: kbstore" in done.out


def test_version(run):
    """The version of the installed package."""
    assert run("--version").out.startswith("kbstore 0.")


def test_completion(run, monkeypatch):
    """Commands, options, formats, knowledge bases, operators, and objects that fit are completed."""
    for words, expected in (
        ("kbstore sta", "state"),
        ("kbstore db up", "upgrade"),
        ("kbstore state --as", "--as-of"),
        ("kbstore export --format j", "json"),
        ("kbstore state --kb k", "kenny"),
        ("kbstore start pass", "pass_door"),
        ("kbstore applicable drive kenny c", "corridor"),
        ("kbstore state --about ke", "kenny"),
    ):
        monkeypatch.setenv("_KBSTORE_COMPLETE", "complete_bash")
        monkeypatch.setenv("COMP_WORDS", words)
        monkeypatch.setenv("COMP_CWORD", str(len(words.split()) - 1))
        assert expected in run().out.split()


def test_completion_of_conditions_and_arguments(run, monkeypatch):
    """A pattern for each predicate and function; objects of the parameter's type only; nothing without a store."""
    ctx = typer.Context(typer.main.get_command(app), info_name="kbstore")
    ctx.params = {"url": os.environ["KBSTORE_URL"], "operator": "DRIVE", "arguments": ["kenny"]}
    assert completion.arguments(ctx) == ["corridor", "home", "lab", "office"]
    assert {"(robot_at ? ?)", "(battery ?)"} < set(completion.patterns(ctx))
    ctx.params["url"] = "no/such/file.db"
    for complete in (completion.names, completion.operators, completion.arguments, completion.objects):
        assert complete(ctx) == []
