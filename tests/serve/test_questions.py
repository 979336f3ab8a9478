"""The paths of the JSON interface answer like the methods of the same names."""

import json

import pytest

import kbstore
from kbstore import seconds
from kbstore.clock import ManualClock, isoformat

FIRE, AFTER = "2026-05-04T09:02:00Z", "2026-05-04T09:05:00Z"


def pddl(items):
    return [item["pddl"] for item in items]


def test_the_knowledge_bases_are_listed(serve, tmp_path):
    """One store with all of its knowledge bases, each with the address of its page."""
    for name in ("kenny", "a/b & c"):
        kbstore.open(tmp_path / "k.db", name).close()
    client = serve(tmp_path / "k.db")
    assert client.get("/api/knowledge-bases").json() == [
        {"name": "a/b & c", "page": "/?kb=a%2Fb+%26+c"},
        {"name": "kenny", "page": "/?kb=kenny"},
    ]


def test_a_knowledge_base_is_named_where_there_are_several(serve, tmp_path):
    """As on the command line: the only one needs no name; otherwise the error lists them."""
    for name, fact in (("kenny", "(p)"), ("lenny", "(q)")):
        with kbstore.open(tmp_path / "k.db", name) as kb:
            kb.add(fact)
    client = serve(tmp_path / "k.db")
    assert client.get("/api/holds", params={"kb": "lenny", "condition": "(q)"}).json()["holds"]
    for name, status in ((None, 422), ("benny", 404)):
        answer = client.get("/api/state", params={} if name is None else {"kb": name})
        assert answer.status_code == status
        assert "kenny, lenny" in answer.json()["detail"]


def test_a_knowledge_base_created_later_is_served(serve, tmp_path):
    """The store is read again whenever a name is given that is not open."""
    kbstore.open(tmp_path / "k.db", "kenny").close()
    client = serve(tmp_path / "k.db")
    assert client.get("/api/state", params={"kb": "lenny"}).status_code == 404
    assert client.get("/api/state").json()["knowledge_base"] == "kenny"
    kbstore.open(tmp_path / "k.db", "lenny").close()
    assert client.get("/api/state", params={"kb": "lenny"}).json()["facts"] == []
    assert client.get("/api/state").json()["knowledge_base"] == "kenny"


def test_a_state(mission, kb):
    """Everything that holds: each item as PDDL and in its parts, times as text."""
    found, state = mission("state", at=FIRE), kb.state(FIRE)
    assert pddl(found["facts"]) == [str(fact) for fact in state.facts]
    assert pddl(found["goals"]) == [str(goal) for goal in state.goals]
    assert pddl(found["timed_knowledge"]) == [str(item) for item in state.timed_knowledge]
    assert (found["knowledge_base"], found["domain"], found["at"], found["as_of"]) == (
        "kenny",
        "deliveries",
        FIRE,
        None,
    )
    by_text = {item["pddl"]: item for kind in ("facts", "functions", "instances") for item in found[kind]}
    assert by_text["(not (open lab_door))"] | {"since": None} == {
        "pddl": "(not (open lab_door))",
        "kind": "fact",
        "name": "open",
        "arguments": ["lab_door"],
        "type": None,
        "is_negative": True,
        "value": None,
        "rate": None,
        "since": None,
    }
    assert by_text["(not (open lab_door))"]["since"] == "2026-05-04T09:01:00Z"
    assert by_text["kenny - robot"]["type"] == "robot"
    assert by_text["(= (battery kenny) 35.5)"]["value"] == 35.5


def test_a_belief_of_the_past(mission):
    """Q2: the expectation before the alarm, by a time or by a transaction."""
    for as_of in ("2026-05-04T09:00:45Z", "tx10", "#10"):
        found = mission("state", at=FIRE, as_of=as_of)
        assert "(robot_at kenny lab)" in pddl(found["facts"])
    assert "(robot_at kenny corridor)" in pddl(mission("state", at=FIRE)["facts"])


def test_single_questions(mission):
    """V6, V11: the truth, the value, the bindings, the reason."""
    assert mission("holds", condition="(open lab_door)", at=AFTER) == {
        "condition": "(open lab_door)",
        "holds": True,
        "truth": "true",
    }
    assert mission("holds", condition="(open lab_door)", at=FIRE)["truth"] == "false"
    assert mission("value", expression="(+ (battery kenny) 1)", at=FIRE)["value"] == 36.5
    assert mission("find", condition="(robot_at ?r ?w)", at=FIRE) == [{"r": "kenny", "w": "corridor"}]
    reason = mission("explain", condition="(and (open lab_door) (robot_at kenny corridor))", at=FIRE)
    (part,) = reason["parts"]
    assert (reason["truth"], part["subject"], part["reason"]) == ("false", "(open lab_door)", "explicitly false")
    assert part["transaction"] == {
        "number": 11,
        "time": "2026-05-04T09:01:00Z",
        "client": "fire alarm",
        "note": "all doors closed",
        "changes": 1,
    }


def test_a_question_is_answered_anew_after_each_transaction(serve, tmp_path):
    """An answer given at once, without a thread, is never an old one."""
    with kbstore.open(tmp_path / "k.db") as kb:
        kb.add("(p)", "(= (f) 0)")
        client = serve(tmp_path / "k.db")
        for number in range(6):
            (kb.add if number % 2 else kb.remove)("(p)")
            kb.add(f"(= (f) {number})")
            assert client.get("/api/holds", params={"condition": "(p)"}).json()["holds"] is bool(number % 2)
            assert client.get("/api/value", params={"expression": "(f)"}).json()["value"] == number


def test_questions_over_time(mission, kb):
    """Q3, Q4, Q5, Q8: the history, the intervals, the difference, the actions."""
    history = mission("history", pattern="(open lab_door)")
    assert [(each["item"]["pddl"], each["initial_time"], each["recorded"]["number"]) for each in history] == [
        (str(each.item), isoformat(each.initial_time), each.recorded.number) for each in kb.history("(open lab_door)")
    ]
    assert any(each["cancelled"] for each in history)
    assert mission("when", condition="(open lab_door)", since="2026-05-04T09:00:30Z", until=AFTER) == [
        {"start": "2026-05-04T09:00:30Z", "end": "2026-05-04T09:01:00Z"},
        {"start": "2026-05-04T09:04:00Z", "end": AFTER},
    ]
    assert mission("when", condition="(open lab_door)", since="0", until="0") == []
    differs = mission("diff", before=FIRE, after=AFTER)
    assert "(open lab_door)" in pddl(differs["became_true"])
    assert differs["metric"] is None
    (number,) = [each for each in differs["numbers"] if each["function"] == "(battery kenny)"]
    assert (number["before"], number["after"]) == (35.5, kb.value("(battery kenny)", AFTER))
    (aborted,) = [run for run in mission("runs", pattern="pass_door") if run["outcome"] == "aborted"]
    assert (aborted["arguments"], aborted["seconds"], aborted["ended"]) == (
        ["kenny", "lab_door", "corridor", "lab"],
        40,
        "2026-05-04T09:01:02Z",
    )
    assert aborted["broken"][0]["condition"] == "(open lab_door)"


def test_a_metric_that_changes(serve, tmp_path):
    """Q5: null where there was none."""
    clock = ManualClock(seconds(10))
    with kbstore.open(tmp_path / "k.db", clock=clock) as kb:
        kb.add("(p)")
        clock.set(seconds(20))
        kb.add_metric("minimize (total-time)")
    client = serve(tmp_path / "k.db", clock=clock)
    before, after = isoformat(seconds(15)), isoformat(seconds(25))
    assert client.get("/api/diff", params={"before": before, "after": after}).json()["metric"]["before"] is None


def test_changes_by_pages(mission):
    """Q6: the transactions after a number, up to a limit."""
    assert [change["number"] for change in mission("changes", after=2, limit=3)] == [3, 4, 5]
    everything = mission("changes")
    assert [change["number"] for change in everything] == list(range(1, 26))
    assert everything[13]["transaction"]["client"] == "facilities"
    assert {each["item"]["pddl"] for each in everything[13]["cancelled"]} == {"(not (open lab_door))"}


def test_the_problem_for_a_planner(serve, recorded, kb):
    """P2: as text, at any time."""
    answer = serve(recorded).get("/api/problem.pddl", params={"at": FIRE})
    assert answer.headers["content-type"] == "text/plain; charset=utf-8"
    assert answer.text == kb.to_pddl(FIRE)


def test_times_are_exact(serve, tmp_path):
    """T1: times are text with nine decimals, since JavaScript would round numbers."""
    t = 1_777_885_200_000_000_001
    with kbstore.open(tmp_path / "k.db", clock=ManualClock(t)) as kb:
        kb.add("(p)")
    text = serve(tmp_path / "k.db", clock=ManualClock(t)).get("/api/history", params={"pattern": "(p)"}).text
    assert "2026-05-04T09:00:00.000000001Z" in text
    assert json.loads(text)[0]["initial_time"] == isoformat(t)
    assert str(t)[:12] not in text


@pytest.mark.parametrize(
    ("written", "seconds_later"),
    [
        (str(seconds(1010)), 10),
        ("1970-01-01T00:16:50Z", 10),
        ("1970-01-01T01:16:50+01:00", 10),
        ("1970-01-01T01:16:50 01:00", 10),
        ("+10s", 10),
        (" 10s", 10),
        ("-10s", -10),
        ("now", 0),
    ],
)
def test_times_are_given_in_any_form(serve, tmp_path, written, seconds_later):
    """T2: as text, or nanoseconds; a plus sign that is not escaped arrives as a space."""
    clock = ManualClock(seconds(980))
    with kbstore.open(tmp_path / "k.db", clock=clock) as kb:
        kb.add("(p)")
    clock.set(seconds(1000))
    found = serve(tmp_path / "k.db", clock=clock).get("/api/state", params={"at": written}).json()
    assert found["at"] == isoformat(seconds(1000 + seconds_later))


def test_a_store_on_postgresql(serve, empty_database):
    """The same from a server's store: each question in a thread, also one about a fact now."""
    with kbstore.open(empty_database, "kenny") as kb:
        kb.add("(p)")
        client = serve(empty_database, allow_writes=True)
        for _ in range(3):
            assert client.get("/api/holds", params={"condition": "(p)"}).json()["holds"]
        assert client.post("/api/remove", json={"items": ["(p)"]}).json()["number"] == 2
        assert not client.get("/api/holds", params={"condition": "(p)"}).json()["holds"]
        assert [change["number"] for change in client.get("/api/changes").json()] == [1, 2]
        assert client.get("/").text.startswith("<!doctype html>")
