"""The results of the mission, worked out by hand from its script.

Driving takes 2 s a metre and costs 0.25 percent a second; charging gives 0.5 percent a second.
"""

import pytest

from kbstore.cli.demo.mission import END, NAME, START, moment
from kbstore.clock import seconds
from kbstore.messages import Truth


@pytest.mark.parametrize(
    ("at", "expected"),
    [
        ("08:58:20", 62.0),  # as loaded
        ("08:58:30", 59.5),  # 10 s on the way: 62 - 2.5
        ("08:58:44", 56.0),  # 24 s for 12 m: 62 - 6
        ("09:00:30", 41.0),  # 60 s for 30 m: 56 - 15
        ("09:01:02", 35.5),  # 22 s until the abort: 41 - 5.5
        ("09:04:00", 35.5),  # waiting costs nothing
        ("09:04:50", 25.5),  # 40 s through the door: 35.5 - 10
        ("09:05:50", 15.5),  # 40 s back: 25.5 - 10
        ("09:06:48", 3.5),  # 48 s for 24 m: 15.5 - 12
        ("09:09:10", 63.5),  # 120 s of charging: 3.5 + 60
    ],
)
def test_the_battery_follows_the_mission(kenny, at, expected):
    """Continuous effects move a number at their rate while their action runs, and stop with it (O3)."""
    assert kenny.value("(battery kenny)", at=moment(at)) == expected


@pytest.mark.parametrize(
    ("at", "place"),
    [
        ("08:58:00", "home"),
        ("08:58:30", None),  # on the way
        ("08:58:44", "office"),
        ("09:00:35", "corridor"),
        ("09:00:50", None),  # in the doorway
        ("09:01:03", None),  # the action is aborted, and the robot's place is not yet reported
        ("09:01:05", "corridor"),
        ("09:05:00", "lab"),
        ("09:09:10", "home"),
    ],
)
def test_the_robot_is_at_the_recorded_places(kenny, at, place):
    """An action's at-start delete and its at-end add leave the robot nowhere in between."""
    state = kenny.state(moment(at))
    there = [fact.arguments[1] for fact in state.facts if fact.attribute_name == "robot_at"]
    assert there == ([] if place is None else [place])


def test_the_belief_before_the_alarm_expects_the_lab(kenny):
    """At 09:00:45 the run was to end at 09:01:20 in the lab, at 41 - 10 = 31 percent, with the door open (Q2)."""
    belief = kenny.state(at=moment("09:02:00"), as_of=moment("09:00:45"))
    came = kenny.state(at=moment("09:02:00"))
    for question, then, indeed in (
        ("(robot_at kenny lab)", Truth.TRUE, Truth.FALSE),
        ("(robot_at kenny corridor)", Truth.FALSE, Truth.TRUE),
        ("(open lab_door)", Truth.TRUE, Truth.FALSE),
    ):
        assert (belief.truth(question), came.truth(question)) == (then, indeed)
    assert (belief.value("(battery kenny)"), came.value("(battery kenny)")) == (31.0, 35.5)


def test_the_door_has_a_history(kenny):
    """Opened by the clock, closed by the alarm, opened again; a closing was cancelled for a later one (Q3)."""
    history = [
        (str(found.item), found.initial_time, found.recorded.client, found.cancelled and found.cancelled.client)
        for found in kenny.history("(open lab_door)")
    ]
    assert history == [
        ("(open lab_door)", moment("09:00:00"), "mission", None),
        ("(not (open lab_door))", moment("09:01:00"), "fire alarm", None),
        ("(open lab_door)", moment("09:04:00"), "facilities", None),
        ("(not (open lab_door))", moment("09:10:00"), "mission", "facilities"),
        ("(not (open lab_door))", moment("09:15:00"), "facilities", None),
    ]


def test_removing_the_parcel_ends_its_mentions(kenny):
    """Removing an object ends its facts and goals, at the same time (C9)."""
    withdrawn = moment("08:59:10")
    before, after = kenny.state(withdrawn - 1), kenny.state(withdrawn)
    assert before.holds("(parcel_at linen office)")
    assert "(delivered linen lab)" in map(str, before.goals)
    assert not [item for item in (*after.facts, *after.goals, *after.instances) if "linen" in str(item)]
    explanation = kenny.explain("(parcel_at linen office)")
    assert (explanation.reason, explanation.since) == ("expired with its instance", withdrawn)
    assert explanation.transaction.client == "ward"


def test_the_battery_is_low_for_131_seconds(kenny):
    """25.5 - 0.25 s falls below 20 just after 22 s of driving, 3.5 + 0.5 s reaches it after 33 s of charging (Q4)."""
    low = kenny.when("(< (battery kenny) 20)", START, END)
    assert low == [(moment("09:05:32") + 1, moment("09:07:43"))]


def test_the_door_bars_the_way_during_the_alarm(kenny):
    """The one failing condition is the door, false since the alarm (O1)."""
    answer = kenny.applicable("pass_door", "kenny", "lab_door", "corridor", "lab", at=moment("09:02:00"))
    assert [(failing.condition, failing.since) for failing in answer.failing] == [
        ("(open lab_door)", moment("09:01:00"))
    ]


def test_the_schedule_is_known_beforehand(kenny):
    """At the end the door is open, and scheduled to close at 09:15 (Q1)."""
    assert kenny.name == NAME
    assert kenny.now() == END
    assert [str(item) for item in kenny.timed_knowledge()] == ["(not (open lab_door))"]
    assert kenny.when("(open lab_door)", END, END + seconds(3600)) == [(END, moment("09:15:00"))]


def test_the_difference_over_seven_minutes(kenny):
    """From 08:59 to 09:06: a parcel withdrawn, one delivered, the door open, the robot gone, 40.5 percent used (Q5)."""
    diff = kenny.diff(moment("08:59:00"), moment("09:06:00"))
    assert sorted(map(str, diff.became_true)) == ["(delivered blood lab)", "(open lab_door)"]
    assert sorted(map(str, diff.withdrawn)) == [
        "(carries kenny blood)",
        "(parcel_at linen office)",
        "(robot_at kenny office)",
        "linen - parcel",
    ]
    assert [(function.atom, before, after) for function, before, after in diff.numbers] == [
        ("(battery kenny)", 56.0, 15.5)
    ]
    assert [str(goal) for goal in diff.goals_removed] == ["(delivered linen lab)"]
