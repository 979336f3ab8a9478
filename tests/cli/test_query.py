"""Questions about one time of the mission; `tests/demo/test_mission.py` works out the expected values."""

import pytest

from kbstore.cli.demo.mission import moment
from kbstore.knowledge_base import KnowledgeBase

ALARM = "2026-05-04T09:02:00Z"
BEFORE = "2026-05-04T09:00:45Z"


@pytest.mark.parametrize(
    ("condition", "at", "code", "expected"),
    [
        ("(open lab_door)", "2026-05-04T09:00:30Z", 0, "true"),
        ("(open lab_door)", ALARM, 1, "false"),
        ("(and (carries kenny ?) (not (open lab_door)))", ALARM, 0, "true"),
        ("(> (battery linen_cart) 5)", ALARM, 3, "unknown"),
    ],
)
def test_holds_answers_by_its_exit_code(run, condition, at, code, expected):
    """Exit 0 is true, 1 false, 3 unknown (V6)."""
    done = run("holds", condition, "--at", at)
    assert (done.code, done.out, done.err) == (code, f"{expected}\n", "")
    answer = run("holds", condition, "--at", at, "--json")
    assert (answer.code, answer.json["truth"], answer.json["at"]) == (code, expected, at)


def test_value_is_a_number_alone(run):
    """The value is printed as in PDDL, for use in a script."""
    assert run("value", "(battery kenny)", "--at", ALARM).out == "35.5\n"
    assert run("value", "(- 100 (battery kenny))", "--at", ALARM).out == "64.5\n"
    assert run("value", "(battery kenny)", "--at", ALARM, "--as-of", BEFORE, "--json").json["value"] == 31.0


@pytest.mark.parametrize("as_of", [None, BEFORE, "tx12", "2099-01-01T00:00:00Z"])
def test_a_question_reads_no_state(run, monkeypatch, as_of):
    """What is asked, and shown to have been asked, is the same as of the state, which may be large, at that time."""
    belief = () if as_of is None else ("--as-of", as_of)
    about = ("--at", ALARM, *belief, "--now", "last", "--json")
    state = run("state", "(battery kenny)", *about).json
    (battery,) = state["functions"]

    def refused(*_):
        raise AssertionError("the state was read")

    monkeypatch.setattr(KnowledgeBase, "state", refused)
    value, truth = run("value", "(battery kenny)", *about).json, run("holds", "(> (battery kenny) 0)", *about).json
    assert (value["value"], truth["truth"]) == (battery["item"]["function_value"], "true")
    for shown in (value, truth):
        assert all(shown[name] == state[name] for name in ("at", "at_ns", "as_of", "as_of_ns"))


def test_state_shows_everything_that_holds(run):
    """Facts of both signs, numbers, schedule, goals and metric, each with its initial time."""
    done = run("state", "--at", ALARM)
    assert done.code == 0
    assert done.words[0].startswith("kenny at 2026-05-04T09:02:00Z (")
    for line in (
        "waypoint home office corridor lab",
        "(not (open lab_door)) 2026-05-04T09:01:00Z 1 min ago",
        "(robot_at kenny corridor) 2026-05-04T09:01:05Z 55 s ago",
        "(battery kenny) 35.5 2026-05-04T09:01:02Z 58 s ago",
        "(not (open lab_door)) 2026-05-04T09:10:00Z in 8 min",
        "(delivered blood lab) no 2026-05-04T08:58:00Z",
        "Metric: minimize (total-time)",
    ):
        assert line in done.words
    assert not [line for line in done.out.splitlines() if line != line.rstrip()]


def test_state_shows_runs(run):
    """A run, its progress, and its expected end; the rate of the number that it moves."""
    words = run("state", "--at", "2026-05-04T09:00:50Z").words
    assert "(pass_door kenny lab_door corridor lab) 2026-05-04T09:00:40Z 10 s of 40 s 2026-05-04T09:01:20Z" in words
    assert "(battery kenny) 38.5 -0.25 per s 2026-05-04T09:00:40Z 10 s ago" in words


def test_state_as_of_is_what_was_believed(run):
    """Before the alarm kenny was expected in the lab (Q2)."""
    done = run("state", "--at", ALARM, "--as-of", BEFORE)
    assert "as believed at 2026-05-04T09:00:45Z" in done.words[0]
    assert "(robot_at kenny lab) 2026-05-04T09:01:20Z 40 s ago" in done.words


def test_state_in_json_has_times_twice_and_items_as_messages(run):
    """Each time as ISO text and in nanoseconds; each item in PDDL and in the form of the message."""
    state = run("state", "--at", ALARM, "--json").json
    assert (state["at"], state["at_ns"], state["knowledge_base"]) == (ALARM, moment("09:02:00"), "kenny")
    assert [item["pddl"] for item in state["timed_knowledge"]] == ["(not (open lab_door))"]
    (door,) = [fact["item"] for fact in state["facts"] if "open" in fact["pddl"]]
    assert door == {
        "knowledge_type": 1,
        "initial_time": moment("09:01:00"),
        "is_negative": True,
        "attribute_name": "open",
        "values": [{"key": "d", "value": "lab_door"}],
    }


def test_explain_names_reason_time_and_client(run):
    """The linen is absent because its object was removed (V6, C9)."""
    done = run("explain", "(parcel_at linen office)", "--now", "2026-05-04T09:09:10Z")
    assert done.words == [
        "(parcel_at linen office) is false: expired with its instance since 2026-05-04T08:59:10Z (10 min ago),"
        " #7 by ward (the patient was moved; no linen today)"
    ]
    answer = run("explain", "(parcel_at linen office)", "--json").json
    assert (answer["reason"], answer["since_ns"]) == ("expired with its instance", moment("08:59:10"))
    assert answer["transaction"]["client"] == "ward"


def test_explain_shows_the_parts_that_decide(run):
    """Of a false conjunction, only the false part."""
    done = run("explain", "(and (carries kenny blood) (open lab_door))", "--at", ALARM)
    assert done.words[0].endswith("is false: because")
    assert done.words[1].startswith("└── (open lab_door) is false: explicitly false since 2026-05-04T09:01:00Z")
    assert len(done.words) == 2


def test_applicable_exits_1_and_names_the_failing_condition(run):
    """The failing condition and since when (O1)."""
    action = ("applicable", "pass_door", "kenny", "lab_door", "corridor", "lab")
    done = run(*action, "--at", ALARM)
    assert done.code == 1
    assert done.words[1].startswith("(open lab_door) is false since 2026-05-04T09:01:00Z")
    assert run(*action, "--at", "2026-05-04T09:04:05Z").code == 0
    answer = run(*action, "--at", ALARM, "--json").json
    assert answer["applicable"] is False
    assert [failing["condition"] for failing in answer["failing"]] == ["(open lab_door)"]


def test_explain_shows_the_numbers_that_were_compared(run):
    """Thirty seconds into the doorway the battery is at 35.5 - 7.5, by the transaction that started the action (V6)."""
    words = run("explain", "(> (battery kenny) 20)", "--at", "2026-05-04T09:04:40Z").words
    assert words[0].startswith("(> (battery kenny) 20) is true: by the values of its functions since")
    assert words[1].startswith("└── (= (battery kenny) 28) is true: asserted since 2026-05-04T09:04:10Z")


def test_state_shows_matches_of_a_pattern(run):
    """V7: of any of several patterns; `?` matches any object. Nothing else is shown, nor in JSON."""
    words = run("state", "(robot_at ? ?)", "(battery ?)", "linen - parcel", "--at", "2026-05-04T08:59:00Z").words
    assert [line.split(" 2026")[0] for line in words[1:] if line.startswith(("(", "parcel", "Goals"))] == [
        "parcel linen",
        "(robot_at kenny office)",
        "(battery kenny) 56",
    ]
    answer = run("state", "(not (open ?))", "--at", ALARM, "--json").json
    assert [fact["pddl"] for fact in answer["facts"]] == ["(not (open lab_door))"]
    assert [item["pddl"] for item in answer["timed_knowledge"]] == ["(not (open lab_door))"]
    assert (answer["instances"], answer["goals"], answer["metric"]) == ([], [], None)


def test_state_shows_mentions_of_an_object(run):
    """Facts, numbers, goals and runs, in any case of the name; nothing for an unknown object."""
    words = run("state", "--about", "LAB", "--at", "2026-05-04T09:00:50Z").words
    assert "(pass_door kenny lab_door corridor lab)" in " ".join(words)
    assert "(delivered blood lab) no 2026-05-04T08:58:00Z" in words
    assert "(distance corridor lab) 20 2026-05-04T08:58:00Z 2 min 50 s ago" in words
    assert "(docked kenny) no 2026-05-04T08:58:00Z" not in words
    assert run("state", "--about", "nobody", "--at", ALARM).words[1:] == ["", "nothing"]


def test_state_shows_some_parts(run):
    """--only names a part, and may be repeated; --about restricts it further."""
    words = run("state", "--only", "goals", "--only", "metric", "--at", ALARM).words
    assert [line for line in words if line in ("Objects", "Facts", "Numbers", "Scheduled", "Goals")] == ["Goals"]
    assert "Metric: minimize (total-time)" in words
    words = run("state", "--only", "facts", "--about", "blood", "--at", ALARM).words
    assert words[-1] == "(carries kenny blood) 2026-05-04T08:58:44Z 3 min 16 s ago"
    assert "Goals" not in words


def test_state_folds_facts_that_no_action_changes(run):
    """Six paths and eight distances are counted; --all, a pattern or JSON lists them."""
    folded = "Not shown, as no action changes them: distance (8), path (6); --all shows them"
    assert folded in run("state", "--at", ALARM).words
    for shown in (
        run("state", "--all", "--at", ALARM),
        run("state", "(path ? ?)", "--at", ALARM),
        run("state", "--json", "--at", ALARM),
    ):
        assert "(path home office)" in shown.out
        assert "Not shown" not in shown.out


def test_find_lists_bindings(run):
    """V11: a column for each variable, joined and ordered; exit 1 where there is none."""
    done = run("find", "(and (carries ?r ?p) (robot_at ?r ?w))", "--at", ALARM)
    assert (done.code, done.words[0], done.words[2:]) == (0, "?r ?p ?w", ["kenny blood corridor"])
    assert run("find", "(path home ?to)", "--at", ALARM, "--json").json == [{"to": "corridor"}, {"to": "office"}]
    assert run("find", "(robot_at ?r lab)", "--at", ALARM, "--as-of", BEFORE).code == 0
    done = run("find", "(robot_at ?r lab)", "--at", ALARM)
    assert (done.code, done.out) == (1, "none\n")
    assert run("find", "(open lab_door)", "--at", BEFORE).out == "true, without variables\n"


def test_wait_ends_when_it_is_true_or_after_the_timeout(run):
    """Q9: it prints the time since when, or exits with 1."""
    done = run("wait", "(docked kenny)", "--now", "last", "--json")
    assert (done.code, done.json["time_ns"]) == (0, moment("09:09:10"))
    late = run("wait", "(docked kenny lab)", "--timeout", "1s")
    assert (late.code, "docked" in late.err) == (2, True)
    assert "with units" in run("wait", "(docked kenny)", "--timeout", "1").err
    done = run("wait", "(robot_at kenny lab)", "--timeout", "50ms", "--now", "last")
    assert (done.code, done.out) == (1, "timed out\n")
