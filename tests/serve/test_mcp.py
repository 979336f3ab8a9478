"""Tools for agents, called by the SDK's own client: in this process, and in a separate process."""

import logging
import re
import shutil
import sys
from importlib.metadata import version
from pathlib import Path

import anyio
import pytest
from mcp import Client, StdioServerParameters
from mcp.types import Implementation
from typer.testing import CliRunner

import kbstore
from kbstore import seconds
from kbstore.cli.app import app
from kbstore.cli.demo.mission import END, moment, record
from kbstore.clock import ManualClock
from kbstore.serve import agent_text
from kbstore.serve.mcp import IN_PYTHON, agent_server

ASKING = ["state", "holds", "find", "explain", "history", "when", "diff", "runs", "applicable"]
MANY = " ".join(f"(open d{number})" for number in range(100))
ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def kenny():
    with record("sqlite://") as kb:
        yield kb


@pytest.fixture
def ken():
    """The mission, to be written to."""
    with record("sqlite://") as kb:
        yield kb


def calls(server, *asked, mode="auto", name="planner-bot"):
    """The answers of tools, each ``(tool, arguments)``: whether it is an error, and its text."""

    async def run():
        found = []
        info = Implementation(name=name, version="1")
        async with Client(server, client_info=info, mode=mode) as client:
            for tool, arguments in asked:
                answer = await client.call_tool(tool, arguments)
                (content,) = answer.content
                found.append((bool(answer.is_error), content.text))
        return found

    return anyio.run(run)


def asked(kb, tool, **arguments):
    """The text of an answer that is not an error."""
    ((failed, text),) = calls(agent_server(kb), (tool, arguments))
    assert not failed, text
    return text


def refused(kb, tool, **arguments):
    ((failed, text),) = calls(agent_server(kb, allow_writes=True), (tool, arguments))
    assert failed, text
    return text


def listed(server):
    async def run():
        async with Client(server) as client:
            assert client.server_info.version == version("kbstore")
            return (await client.list_tools()).tools, client.instructions

    return anyio.run(run)


def test_an_agent_learns_how_to_ask(kenny):
    """The server's instructions explain times and worlds, and list the domain's symbols with their types."""
    tools, instructions = listed(agent_server(kenny))
    assert [tool.name for tool in tools] == ASKING
    assert all(tool.annotations.read_only_hint and tool.description for tool in tools)
    assert "What is not asserted is false." in instructions
    assert "The tools only read." in instructions
    assert "(robot_at ?r - robot ?wp - waypoint)" in instructions
    assert "(pass_door ?r - robot ?d - door ?from - waypoint ?to - waypoint)" in instructions


def test_the_instructions_name_an_open_world():
    """V2: in an open world absent is unknown; without a domain there are no symbols to list."""
    with kbstore.open("sqlite://", "open", use_unknowns=True, clock=ManualClock()) as kb:
        _, instructions = listed(agent_server(kb))
        assert "What is not asserted is unknown." in instructions
        assert "No domain is loaded" in instructions
        assert asked(kb, "holds", condition="(p a)") == "unknown at 1970-01-01T00:00:00Z"
        assert asked(kb, "state") == "open at 1970-01-01T00:00:00Z\nnothing matches"


@pytest.mark.parametrize(
    ("tool", "arguments", "expected"),
    [
        ("holds", {"condition": "(open lab_door)"}, ["true at 2026-05-04T09:09:10Z"]),
        ("holds", {"condition": "(open lab_door)", "at": "-7m10s"}, ["false at 2026-05-04T09:02:00Z"]),
        (
            "holds",
            {"condition": "(robot_at kenny lab)", "at": "2026-05-04T09:02:00Z", "as_of": "tx10"},
            ["true at 2026-05-04T09:02:00Z, as believed at 2026-05-04T09:00:40Z"],
        ),
        (
            "state",
            {"patterns": ["(robot_at ? ?)", "(battery ?)"], "at": "2026-05-04T09:00:30Z"},
            [
                "kenny at 2026-05-04T09:00:30Z",
                "numbers (1):",
                "(= (battery kenny) 41) since 2026-05-04T09:00:30Z",
                "facts (1):",
                "(robot_at kenny corridor) since 2026-05-04T09:00:30Z",
            ],
        ),
        (
            "state",
            {"only": ["runs", "scheduled"], "at": "2026-05-04T09:04:20Z"},
            [
                "kenny at 2026-05-04T09:04:20Z",
                "running (1):",
                "(pass_door kenny lab_door corridor lab) running, started 2026-05-04T09:04:10Z, expected to end "
                "2026-05-04T09:04:50Z",
                "scheduled (1):",
                "(not (open lab_door)) at 2026-05-04T09:15:00Z",
            ],
        ),
        (
            "find",
            {"condition": "(and (path ?from lab) (path lab ?from))"},
            ["none"],
        ),
        ("find", {"condition": "(dock_at ?w)"}, ["?w = home"]),
        ("find", {"condition": "(docked kenny)"}, ["true, and it has no variables"]),
        (
            "explain",
            {"condition": "(parcel_at linen office)"},
            [
                "(parcel_at linen office) is false: expired with its instance since 2026-05-04T08:59:10Z, tx7 at "
                "2026-05-04T08:59:10Z by ward (the patient was moved; no linen today)"
            ],
        ),
        (
            "explain",
            {"condition": "(and (docked kenny) (not (open lab_door)))", "at": "2026-05-04T09:02:00Z"},
            [
                "(and (docked kenny) (not (open lab_door))) is false: removed since "
                "2026-05-04T08:58:10Z, tx2 at 2026-05-04T08:58:10Z by mission (start (undock kenny home))",
                "  (docked kenny) is false: removed since 2026-05-04T08:58:10Z, tx2 at 2026-05-04T08:58:10Z by "
                "mission (start (undock kenny home))",
            ],
        ),
        (
            "history",
            {"pattern": "(robot_at kenny lab)"},
            [
                "(robot_at kenny lab) from 2026-05-04T09:04:50Z until 2026-05-04T09:05:10Z; recorded by tx16 at "
                "2026-05-04T09:04:50Z by mission (end (pass_door kenny lab_door corridor lab)); ended by tx18 at "
                "2026-05-04T09:05:10Z by mission (start (pass_door kenny lab_door lab corridor))"
            ],
        ),
        (
            "history",
            {"pattern": "(robot_at kenny lab)", "until": "2026-05-04T09:00:00Z"},
            ["nothing is recorded of it"],
        ),
        (
            "when",
            {"condition": "(< (battery kenny) 20)"},
            [
                "2026-05-04T09:05:32.000000001Z until 2026-05-04T09:07:43Z (2 min 11 s)",
                "true for 2 min 11 s altogether, in 1 interval",
            ],
        ),
        ("when", {"condition": "(robot_at kenny lab)", "until": "2026-05-04T09:00:00Z"}, ["never true in that span"]),
        (
            "diff",
            {"before": "2026-05-04T09:06:00Z", "after": "2026-05-04T09:06:50Z"},
            [
                "became true (1):",
                "(robot_at kenny home)",
                "withdrawn (1):",
                "(undocked kenny)",
                "numbers changed (1):",
                "(battery kenny) 15.5 -> 3.5",
            ],
        ),
        ("diff", {"before": "-1s"}, ["numbers changed (1):", "(battery kenny) 63 -> 63.5"]),
        ("diff", {"before": "now"}, ["no difference"]),
        (
            "runs",
            {"pattern": "(pass_door kenny ? corridor ?)"},
            [
                "(pass_door kenny lab_door corridor lab) aborted, started 2026-05-04T09:00:40Z, aborted "
                "2026-05-04T09:01:02Z after 22 s; broken: (open lab_door) is false since 2026-05-04T09:01:00Z until "
                "2026-05-04T09:01:02Z",
                "(pass_door kenny lab_door corridor lab) ended, started 2026-05-04T09:04:10Z, ended "
                "2026-05-04T09:04:50Z after 40 s",
            ],
        ),
        ("runs", {"until": "2026-05-04T08:58:00Z"}, ["nothing ran in that span"]),
        (
            "applicable",
            {"operator": "hand_over", "arguments": ["kenny", "blood", "lab"], "at": "2026-05-04T09:04:55Z"},
            ["(hand_over kenny blood lab) is applicable"],
        ),
        (
            "applicable",
            {
                "operator": "pass_door",
                "arguments": ["kenny", "lab_door", "corridor", "lab"],
                "at": "2026-05-04T09:02:00Z",
            },
            [
                "(pass_door kenny lab_door corridor lab) is not applicable:",
                "(open lab_door) is false since 2026-05-04T09:01:00Z",
            ],
        ),
    ],
)
def test_each_tool_answers_in_lines(kenny, tool, arguments, expected):
    """PDDL and ISO times, worked out from the mission's script."""
    assert asked(kenny, tool, **arguments).split("\n") == expected


@pytest.mark.parametrize("mode", ["auto", "legacy"])
def test_an_agent_writes_under_its_own_name(ken, mode):
    """The client of a transaction is the name that the agent's program gives, on one line."""
    answers = calls(
        agent_server(ken, allow_writes=True),
        ("add", {"items": ["bob - robot", "(robot_at bob lab)"], "note": "seen by the camera"}),
        ("add", {"items": ["(robot_at bob lab)"]}),
        ("add", {"items": ["(not (open lab_door))"], "at": "+1m"}),
        ("add", {"items": ["(open lab_door)"], "since": "2026-05-04T09:01:30Z", "until": "2026-05-04T09:01:40Z"}),
        ("remove", {"items": ["(robot_at bob ?)"]}),
        ("remove", {"items": ["(robot_at bob ?)"]}),
        mode=mode,
        name="planner\nbot",
    )
    assert answers == [
        (False, "recorded as tx26 at 2026-05-04T09:09:10Z: 2 changes"),
        (False, "nothing changed: it is known already, or does not hold; the latest transaction is tx26"),
        (False, "recorded as tx27 at 2026-05-04T09:09:10Z: 1 change"),
        (False, "recorded as tx28 at 2026-05-04T09:09:10Z: 1 change"),
        (False, "recorded as tx29 at 2026-05-04T09:09:10Z: 1 change"),
        (False, "nothing changed: it is known already, or does not hold; the latest transaction is tx29"),
    ]
    written = [change.transaction for change in ken.changes(after=25)]
    assert {tx.client for tx in written} == {"planner bot"}
    assert written[0].note == "seen by the camera"
    assert ken.holds("(open lab_door)", at=moment("09:01:35"))
    assert not ken.holds("(open lab_door)", at=END + seconds(61))


def test_an_agent_without_a_name_is_mcp(ken):
    """A program that gives no name is recorded as ``mcp``."""
    calls(agent_server(ken, allow_writes=True), ("add", {"items": ["bob - robot"]}), name=" ")
    (change,) = ken.changes(after=25)
    assert change.transaction.client == "mcp"


def test_nothing_is_written_unless_it_is_allowed(kenny):
    """Without permission there are no tools that write."""
    ((failed, reason),) = calls(agent_server(kenny), ("add", {"items": ["bob - robot"]}))
    assert (failed, reason) == (True, "Unknown tool: add")
    tools, instructions = listed(agent_server(kenny, allow_writes=True))
    assert [tool.name for tool in tools] == [*ASKING, "add", "remove"]
    writing = {tool.name: tool.annotations for tool in tools[-2:]}
    assert not any(hints.read_only_hint for hints in writing.values())
    assert (writing["add"].destructive_hint, writing["remove"].destructive_hint) == (False, True)
    assert "The tools add and remove write, in your name" in instructions


@pytest.mark.parametrize(
    ("tool", "arguments", "reason"),
    [
        ("holds", {"condition": "(opn lab_door)"}, "has no predicate opn; it has robot_at, docked"),
        ("holds", {"condition": "open"}, "(open"),
        ("holds", {"condition": "(open lab_door"}, "a ')' is missing"),
        ("holds", {"condition": "(open lab_door)", "at": "yesterday"}, "write ISO 8601 with an offset, like 2026-"),
        ("holds", {"condition": "(open lab_door)", "as_of": "tx99"}, "kenny has no transaction 99; history names"),
        (
            "holds",
            {"condition": "(open lab_door)", "when": "now"},
            "holds has no argument when; it has condition, at, ",
        ),
        ("holds", {}, "condition: Field required; it takes condition (needed), at, as_of"),
        ("state", {"only": ["everything"]}, "'objects', 'facts', 'numbers'"),
        ("state", {"patterns": ["(flies ?)"]}, "flies"),
        ("find", {"condition": "(not (open ?d))"}, "?d"),
        ("when", {"condition": "(open lab_door)", "since": "+1h", "until": "-1h"}, "give them in order"),
        ("runs", {"pattern": "fly"}, "has no operator fly; it has undock"),
        ("applicable", {"operator": "drive", "arguments": ["kenny"]}, "takes 3"),
        ("add", {"items": ["bob - robt", "(open door9)"]}, "2 violations"),
        ("add", {"items": "(open lab_door)"}, "items: Input should be a valid list"),
        ("add", {"items": ["(open lab_door)"], "since": "+1h"}, "since"),
    ],
)
def test_an_error_says_what_to_write_instead(ken, tool, arguments, reason):
    """Each error is kbstore's sentence, without advice for programmers; nothing is stored."""
    before = ken.now(), len(list(ken.changes()))
    text = refused(ken, tool, **arguments)
    assert reason in text
    assert not re.search(r"kb\.|kbstore|Error executing|pydantic|Traceback", text)
    assert (ken.now(), len(list(ken.changes()))) == before


@pytest.mark.parametrize("advice", IN_PYTHON)
def test_replaced_advice_still_occurs(advice):
    """Each piece of advice that is replaced here occurs in some message."""
    sources = "".join(path.read_text() for path in (ROOT / "kbstore").rglob("*.py") if "serve" not in path.parts)
    assert advice.partition("(")[0] in sources


def test_logging_stays_as_the_host_has_it(kenny, monkeypatch):
    """A server inside another program adds no log handler, and changes no level."""
    monkeypatch.setattr(logging.root, "handlers", [])
    agent_server(kenny)
    assert (logging.root.handlers, logging.root.level) == ([], logging.WARNING)


def test_many_calls_at_once(kenny):
    """Calls run in threads; each gets its own answer."""

    async def run():
        answers = {}

        async def ask(client, percent):
            answer = await client.call_tool("holds", {"condition": f"(> (battery kenny) {percent})"})
            answers[percent] = answer.content[0].text.split()[0]

        async with Client(agent_server(kenny)) as client, anyio.create_task_group() as tasks:
            for percent in range(40):
                tasks.start_soon(ask, client, percent * 2.5)
        return answers

    # it is at 63.5
    assert anyio.run(run) == {n * 2.5: "true" if n * 2.5 < 63.5 else "false" for n in range(40)}


@pytest.fixture(scope="module")
def crowded():
    """Three hundred doors; seventy runs, and notes of many lines."""
    domain = """(define (domain d) (:types door)
      (:predicates (open ?d - door) (shut ?d - door))
      (:functions (width ?d - door))
      (:durative-action swing :parameters (?d - door) :duration (= ?duration 1)
        :condition (at start (open ?d)) :effect (at end (open ?d))))"""
    clock = ManualClock(seconds(1000))
    with kbstore.open("sqlite://", "crowded", clock=clock) as kb:
        kb.load(domain)
        doors = [f"d{number}" for number in range(300)]
        kb.add(*(f"{door} - door" for door in doors))
        kb.add(*(f"(open {door})" for door in doors), *(f"(= (width {door}) 2)" for door in doors))
        for turn in range(70):
            clock.advance(seconds(1))
            run = kb.start("swing", f"d{turn}")
            (kb.remove if turn % 2 else kb.add)("(shut d0)", client="x\nignore that", note="line\n" * 500)
            clock.advance(seconds(1))
            kb.end(run)
        yield kb


@pytest.mark.parametrize(
    ("tool", "arguments", "left_out"),
    [
        ("state", {}, r"261 more: to see them, ask with patterns, or about=\[an object\] \(\(open \?\) 261\)"),
        ("state", {"only": ["facts"]}, r"260 more: .* \(\(open \?\) 260\)"),
        ("state", {"only": ["objects"]}, r"300 of type door: d0 .* d19 and 280 more: find those"),
        ("find", {"condition": "(open ?d)"}, r"\.\.\. 260 more bindings: to see them, add to the condition"),
        ("history", {"pattern": "(open ?)"}, r"\.\.\. 260 earlier assertions: to see them, narrow the pattern"),
        ("runs", {}, r'\.\.\. 30 earlier runs: to see them, ask with until="1970-01-01T00:17:41Z"'),
        ("diff", {"before": "1970-01-01T00:00:00Z"}, r"\.\.\. 280 more: .* times that are closer together"),
        ("explain", {"condition": f"(and {MANY})"}, r"\.\.\. 61 more lines: .* explain a part"),
    ],
)
def test_an_answer_is_short_and_says_what_is_left_out(crowded, tool, arguments, left_out):
    """At most about 60 lines of at most about 400 characters, for any text of clients; its end says how to narrow."""
    text = asked(crowded, tool, **arguments)
    lines = text.split("\n")
    assert len(lines) <= agent_text.MOST_LINES + 20
    assert max(map(len, lines)) <= agent_text.LONGEST_LINE + 40
    assert len(text) < 16_000
    assert re.search(left_out, text), text
    assert not [line for line in lines if line.startswith(("ignore that", "line"))]


def test_nothing_is_left_out_of_a_short_answer(kenny):
    """A part of a state with more lines than its share gets the lines that the other parts do not need."""
    text = asked(kenny, "state")
    assert len(text.split("\n")) < agent_text.MOST_LINES
    assert "to see them" not in text


def test_the_rest_of_an_answer_can_be_asked_for(crowded):
    """The advice at the end of an answer leads to the runs before it, without a gap."""
    first = asked(crowded, "runs").split("\n")
    until = re.search(r'until="(.*)"', first[0])[1]
    before = asked(crowded, "runs", until=until).split("\n")
    assert len(before) + len(first[1:]) == 70
    assert "(swing d29)" in before[-1]
    assert "(swing d30)" in first[1]


def test_an_error_is_short(crowded):
    """An error with a thousand items is cut, and says so."""
    with kbstore.open("sqlite://", "other", clock=ManualClock()) as kb:
        kb.load("(define (domain d) (:types door) (:predicates (open ?d - door)))")
        text = refused(kb, "add", items=[f"(open d{number})" for number in range(1000)])
    assert text.startswith("1000 violations")
    assert text.endswith("more characters)")
    assert len(text) < agent_text.LONGEST_TEXT + 40


@pytest.mark.parametrize("writing", [False, True])
def test_a_process_of_its_own(tmp_path, writing):
    """`kbstore mcp` on standard input and output: permitted tools alone are there, and change the file."""
    file = tmp_path / "kenny.db"
    record(f"sqlite:///{file}").close()
    before = shutil.copy(file, tmp_path / "before.db")
    command = ["-c", "from kbstore.cli import main; main()", "mcp", "--url", str(file), "--now", "last"]
    parameters = StdioServerParameters(
        command=sys.executable,
        args=[*command, "--allow-writes"] if writing else command,
        env={"PYTHONPATH": str(ROOT)},
    )
    (held, added) = calls(
        parameters, ("holds", {"condition": "(open lab_door)"}), ("add", {"items": ["bob - robot"]}), name="desk"
    )
    assert held == (False, "true at 2026-05-04T09:09:10Z")
    assert added == (
        (False, "recorded as tx26 at 2026-05-04T09:09:10Z: 1 change") if writing else (True, "Unknown tool: add")
    )
    with kbstore.open(file, "kenny", clock=ManualClock(), read_only=True) as kb:
        assert [change.transaction.client for change in kb.changes(after=25)] == (["desk"] if writing else [])
    if not writing:
        assert file.read_bytes() == Path(before).read_bytes()


def test_a_library_that_is_missing_is_named(monkeypatch, tmp_path):
    """Without the extra, the command names it on one line, and exits with 2."""
    monkeypatch.delitem(sys.modules, "kbstore.serve.mcp", raising=False)
    monkeypatch.setitem(sys.modules, "mcp.server.mcpserver", None)
    done = CliRunner().invoke(app, ["mcp", "--url", str(tmp_path / "kenny.db")], prog_name="kbstore")
    assert (done.exit_code, done.stdout) == (2, "")
    assert done.stderr.startswith("kbstore: the tools for agents need the library mcp, which cannot be imported")
    assert done.stderr.endswith("install it with: pip install 'kbstore[mcp]'\n")
