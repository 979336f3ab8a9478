"""The data of a timeline: a reader who knows the rules can compute each state from them, as of each transaction."""

import json

import pytest

import kbstore
from kbstore import seconds
from kbstore.cli.demo.mission import moment, record
from kbstore.clock import ManualClock
from kbstore.report.timeline.data import timeline_data
from kbstore.report.timeline.text import TextTimeline
from tests.timeline.worlds import START, pairs, values_of, world


@pytest.fixture(scope="module")
def kenny():
    with record("sqlite://") as kb:
        yield kb


def read(data, number, t):
    """The facts and numbers at a time, by the pieces of each lane as of a transaction."""
    view = TextTimeline({**data, "as_of": None if number > data["latest"] else number})
    facts, numbers = [], []
    for lane, (group, label, _) in enumerate(data["lanes"]):
        kind, name = data["groups"][group]
        atom = f"({' '.join(filter(None, (name, label)))})"
        for start, end, row in view.pieces(lane):
            if kind == "fact" and start <= t < end:
                facts.append(atom if row[7] else f"(not {atom})")
            if kind == "number" and start <= t < end:
                numbers.append((atom, row[7] + row[8] * ((t - row[1]) / 1e9) if row[8] else row[7]))
    return sorted(facts), sorted(numbers)


@pytest.mark.parametrize("seed", range(16))
def test_every_state_follows_from_the_rows(seed):
    """Q2, O3, O5: at random times as of random transactions, facts and numbers are those of the state."""
    with world(seed) as kb:
        data = timeline_data(kb, expectations=10**6)
        for t, tx in pairs(kb, data, 60, seed):
            number = data["latest"] + 1 if tx is None else tx.number
            assert read(data, number, t - int(data["origin"])) == values_of(kb.state(t, as_of=tx)), (t, number)


@pytest.mark.parametrize("seed", range(8))
def test_the_states_of_a_span_follow_from_its_rows(seed):
    """The same from a later time on: assertions on record then count, and the time before is not needed."""
    with world(seed) as kb:
        changes = list(kb.changes())
        since = changes[len(changes) // 2].time
        data = timeline_data(kb, since=since, expectations=10**6)
        assert (int(data["origin"]), data["base"]) == (since, max(c.number for c in changes if c.time <= since))
        for t, tx in pairs(kb, data, 60, seed):
            number = data["latest"] + 1 if tx is None else tx.number
            assert read(data, number, t - since) == values_of(kb.state(t, as_of=tx)), (t, number)


@pytest.mark.parametrize("seed", range(8))
def test_an_archived_beginning_is_not_shown(seed, tmp_path):
    """Q7: the timeline begins where the kept history does, and is right from there on."""
    with world(seed, url=f"sqlite:///{tmp_path / 'k.db'}") as kb:
        changes = list(kb.changes())
        before = changes[len(changes) // 2].time
        kb.archive(before, tmp_path / "archive.db")
        for since in (None, 0):
            data = timeline_data(kb, since=since, expectations=10**6)
            assert int(data["origin"]) == before
        for t, tx in pairs(kb, data, 60, seed):
            number = data["latest"] + 1 if tx is None else tx.number
            assert read(data, number, t - before) == values_of(kb.state(t, as_of=tx)), (t, number)
        # the transactions of what is shown are known, also where they were before
        known = {tx[0] for tx in data["transactions"]}
        assert {row[3] for row in data["rows"]} <= known
        assert str(before) in kb.timeline()


def test_the_latest_transactions_are_shown():
    """With `most`, a long timeline begins where that many transactions are left."""
    clock = ManualClock(START)
    with kbstore.open("sqlite://", "long", clock=clock) as kb:
        for number in range(20):
            clock.advance(seconds(1))
            kb.add(f"(= (f) {number})")
        data = timeline_data(kb, most=5)
        assert (data["base"], data["latest"], int(data["origin"])) == (15, 20, START + seconds(15))
        assert [row[7] for row in data["rows"]] == [14, 15, 16, 17, 18, 19]
        assert timeline_data(kb, most=20)["base"] == 0


def test_rows_say_who_recorded_ended_and_cancelled(kenny):
    """The lab door: scheduled by 1, closed by 11, opened by 14, which also moved its scheduled closing."""
    data = timeline_data(kenny, ["(open ?)"])
    lanes = [data["groups"][group] + (label,) for group, label, _ in data["lanes"]]
    door = lanes.index(("fact", "open", "lab_door"))
    second = 10**9
    assert [row[1:8] for row in data["rows"] if row[0] == door] == [
        [120 * second, 180 * second, 1, 0, 11, 0, 1],
        [720 * second, 720 * second, 1, 14, 0, 1, 0],
        [180 * second, 360 * second, 11, 0, 14, 0, 0],
        [360 * second, 1020 * second, 14, 0, 14, 0, 1],
        [1020 * second, None, 14, 0, 0, 0, 0],
    ]
    assert data["origin"] == str(moment("08:58:00"))


def test_late_knowledge_supersedes():
    """L8: p held from 0 on; that it was false from 10 s to 20 s is recorded at 30 s, and replaces the row by three."""
    clock, second = ManualClock(START), 10**9
    with kbstore.open("sqlite://", "late", clock=clock) as kb:
        kb.add("(p)")
        clock.set(START + seconds(30))
        kb.add("(not (p))", since=START + seconds(10), until=START + seconds(20))
        data = timeline_data(kb)
    assert [row[1:5] + row[6:8] for row in data["rows"]] == [
        [0, None, 1, 2, 2, 1],
        [0, 10 * second, 2, 0, 0, 1],
        [10 * second, 20 * second, 2, 0, 0, 0],
        [20 * second, None, 2, 0, 0, 1],
    ]


def test_runs_have_their_invariants(kenny):
    """The passage of the door was started by 10, aborted by 12, and its invariant broken two seconds before."""
    data = timeline_data(kenny, ["pass_door"])
    assert data["runs"][0][1:] == [
        160 * 10**9, 200 * 10**9, 182 * 10**9, "aborted", 10, 12, [["(open lab_door)", 180 * 10**9, 182 * 10**9]]
    ]  # fmt: skip


def test_goals_have_the_spans_in_which_they_were_reached(kenny):
    """The blood was delivered at 09:05, and stays so; the linen never was."""
    data = timeline_data(kenny, ["delivered"])
    labels = [label for _, label, _ in data["lanes"]]
    reached = {labels[lane]: spans for lane, spans in data["reached"]}
    assert reached["(delivered blood lab)"] == [[420 * 10**9, None]]
    assert reached["(delivered linen lab)"] == []


def test_patterns_choose_lanes(kenny):
    """A word matches a symbol or an object, several words the whole atom; objects are included, for their ends."""

    def chosen(*patterns):
        data = timeline_data(kenny, patterns)
        return {f"{data['groups'][g][1]} {label}" for g, label, _ in data["lanes"] if data["groups"][g][0] != "object"}

    assert chosen("(Robot_at kenny ?)") == {f"robot_at kenny {p}" for p in ("home", "office", "corridor", "lab")}
    assert chosen("linen") == {"parcel_at linen office", "goals (delivered linen lab)"}
    assert chosen("BATTERY") == {"battery kenny"}
    assert chosen("(nothing)") == set()


def test_a_span_leaves_out_other_times(kenny):
    """Assertions that ended before `since` or begin after `until` are left out, and the first beliefs with them."""
    since, until = moment("09:04:00"), moment("09:05:00")
    data = timeline_data(kenny, since=since, until=until)
    origin = int(data["origin"])
    assert (origin, data["until"], data["base"]) == (since, until - since, 14)
    labels = {f"{data['groups'][group][1]} {label}" for group, label, _ in data["lanes"]}
    assert "robot_at kenny office" not in labels
    assert "robot_at kenny lab" in labels
    for tx in [change.transaction for change in kenny.changes(14)]:
        for t in range(since, until, seconds(7)):
            assert read(data, tx.number, t - origin)[0] == values_of(kenny.state(t, as_of=tx))[0]


def test_the_span_ends_where_the_history_does():
    """It includes now if that is within as much time again; last year's recording still fills the page."""
    clock = ManualClock(START)
    with kbstore.open("sqlite://", "old", clock=clock) as kb:
        kb.add("(p)")
        kb.add("(q)", initial_time=START + seconds(100))
        for now, until in ((60, 100), (200, 200), (201, 100)):
            clock.set(START + seconds(now))
            assert timeline_data(kb)["until"] == seconds(until)


def test_as_of_is_the_number_of_a_transaction(kenny):
    """A time means the last transaction until then; a time from now on means the latest knowledge."""
    assert timeline_data(kenny, as_of=moment("09:00:45"))["as_of"] == 10
    assert timeline_data(kenny, as_of=moment("08:00:00"))["as_of"] == 0
    assert timeline_data(kenny, as_of=kenny.now())["as_of"] is None
    assert timeline_data(kenny, as_of=list(kenny.changes())[4].transaction)["as_of"] == 5


def test_expectations_are_for_the_latest_transactions(kenny):
    """Older ones have none, and the data have the first number that has them."""
    data = timeline_data(kenny, expectations=5)
    assert data["known_from"] == 21
    assert {row[3] for row in data["expected"]} == {22, 24}


def test_an_empty_knowledge_base_has_an_empty_timeline():
    """There are no transactions and no lanes, and the span is now."""
    with kbstore.open("sqlite://", "empty", clock=ManualClock(START)) as kb:
        data = timeline_data(kb)
        assert (data["latest"], data["lanes"], data["origin"], data["until"]) == (0, [], str(START), 0)
        assert json.loads(json.dumps(data))["rows"] == []
        assert "<canvas" in kb.timeline()
