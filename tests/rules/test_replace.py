"""Rule C13: replacing the state, and what stays as it is."""

import pytest

import kbstore
from kbstore import seconds
from tests.conftest import START
from tests.rules.reading import facts, instances, intervals, picture

ROOMS = """
(define (domain rooms)
  (:types robot place)
  (:predicates (open ?p - place) (near ?r - robot ?p - place) (wet) (seen ?p - place))
  (:functions (level ?p - place) (cost))
  (:derived (seen ?p - place) (exists (?r - robot) (near ?r ?p)))
  (:durative-action mop :parameters (?r - robot ?p - place) :duration (= ?duration 9)
    :effect (and (at start (wet)) (decrease (level ?p) (* #t 1)))))
"""
OBJECTS = ("kenny - robot", "wp0 - place", "wp1 - place")


@pytest.fixture
def rooms(open_kb):
    kb = open_kb()
    kb.load(ROOMS)
    kb.add(*OBJECTS)
    return kb


def changed(kb, done):
    """What one transaction asserted and ended."""
    (change,) = kb.changes(after=done.number - 1)
    return [sorted(str(a.item) for a in assertions) for assertions in (change.asserted, change.ended)]


def test_replacing_records_the_difference_alone(rooms, clock):
    """C13, C2: items that hold already stay as they are; assertions that are not among the items are removed."""
    rooms.add("(open wp0)", "(not (open wp1))", "(= (level wp0) 5)", "(= (level wp1) 1)", "(> (level wp0) 2)", "(wet)")
    clock.advance(10)
    done = rooms.replace(*OBJECTS, "(open wp0)", "(open wp1)", "(= (level wp0) 6)", "(> (level wp1) 0)")
    assert changed(rooms, done) == [
        ["(= (level wp0) 6)", "(> (level wp1) 0)", "(open wp1)"],
        ["(= (level wp0) 5)", "(= (level wp1) 1)", "(> (level wp0) 2)", "(not (open wp1))", "(wet)"],
    ]
    assert facts(rooms) == ["(open wp0)", "(open wp1)"]
    assert intervals(rooms, "(open wp0)") == [("(open wp0)", START, None, False)]


def test_replacing_a_state_by_itself_changes_nothing(rooms):
    """C13, C1, C2: no transaction is recorded; a number with a rate is given by its value at now and its rate."""
    moving = kbstore.Function(attribute_name="cost", function_value=3, rate=2)
    last = rooms.add("(open wp0)", "(not (wet))", moving)
    state = rooms.state()
    done = rooms.replace(*state.instances, *state.facts, *state.functions)
    assert (done.number, done.changes) == (last.number, 0)


def test_a_missing_object_ends_with_its_mentions_and_runs(rooms, clock):
    """C13, C9, C12: a fact among the items may not mention it."""
    rooms.add("(near kenny wp0)", "(= (level wp0) 5)", "(= (level wp1) 5)")
    rooms.add_goal("(open wp1)")
    rooms.start("mop", "kenny", "wp1")
    with pytest.raises(kbstore.InvalidKnowledge, match="wp1 does not exist"):
        rooms.replace("kenny - robot", "wp0 - place", "(= (level wp1) 5)")
    assert len(rooms.state().running) == 1
    clock.advance(10)
    rooms.replace("kenny - robot", "wp0 - place", "(near kenny wp0)")
    assert instances(rooms) == ["kenny - robot", "wp0 - place"]
    assert (facts(rooms), rooms.state().functions, rooms.goals(), rooms.state().running) == (
        ["(near kenny wp0)"],
        [],
        [],
        [],
    )
    explained = rooms.explain("(= (level wp1) 5)")
    assert "expired with its instance" in str(explained)


def test_goals_metric_runs_and_schedule_are_left_alone(rooms):
    """C13: `replace` is about the state at now alone."""
    rooms.add("(= (level wp0) 5)")
    rooms.add_goal("(open wp0)")
    rooms.add_metric("minimize (cost)")
    rooms.add("(open wp1)", "(= (cost) 8)", initial_time=START + seconds(5))
    run = rooms.start("mop", "kenny", "wp0")
    before = rooms.state()
    rooms.replace(*OBJECTS, "(= (level wp0) 7)")
    after = rooms.state()
    assert facts(rooms) == []
    for name in ("goals", "metric", "timed_knowledge", "running"):
        assert getattr(after, name) == getattr(before, name)
    assert after.running == [run]
    # runs still move it
    assert rooms.value("(level wp0)", at=START + seconds(2)) == 5


@pytest.mark.parametrize(
    ("wrong", "reason"),
    [
        (kbstore.Fact(attribute_name="wet", initial_time=START + 1), "schedule it with add"),
        ("(increase (cost) 1)", "relative"),
        ("(increase (cost) (* #t 1))", "relative"),
        ("minimize (cost)", "metric"),
        ("(flying kenny)", "flying"),
        ("(seen wp0)", "derived"),
    ],
)
def test_items_that_are_not_part_of_a_state_are_refused(rooms, wrong, reason):
    """C13, D1: all violations are reported together, and nothing is stored."""
    rooms.add("(wet)", "(= (cost) 2)")
    before = picture(rooms)
    with pytest.raises(kbstore.InvalidKnowledge, match=reason) as refused:
        rooms.replace(*OBJECTS, wrong, "(open wp9)")
    assert "wp9" in str(refused.value)
    assert picture(rooms) == before


def test_a_type_changes_only_after_an_end(rooms):
    """C13, C6, C8: an object of another type among the items is refused, as in `add`."""
    before = picture(rooms)
    with pytest.raises(kbstore.InvalidKnowledge, match="wp1 exists with the type place"):
        rooms.replace("kenny - robot", "wp0 - place", "wp1 - robot")
    assert picture(rooms) == before


def test_replacing_by_no_items_clears_the_state(rooms):
    """C13: every object ends."""
    rooms.add("(wet)", "(open wp0)")
    rooms.replace()
    assert (instances(rooms), facts(rooms)) == ([], [])


def test_replacing_within_a_transaction(rooms):
    """C13, C1: of several updates of a timeline the last is recorded."""
    rooms.add("(wet)")
    with rooms.transaction() as tx:
        tx.add("(open wp1)")
        tx.replace(*OBJECTS, "(wet)", "(open wp0)")
        assert tx.holds("(and (wet) (open wp0) (not (open wp1)))")
    assert changed(rooms, tx.result) == [["(open wp0)"], []]


def test_replacing_without_a_domain(open_kb):
    """C13: labels, case and inequalities are matched."""
    kb = open_kb()
    kb.add("(At Kenny wp0)", "(> (level wp0) 2)", "(= (level wp0) 1)")
    assert kb.replace("(at kenny WP0)", "(> (LEVEL wp0) 2)", "(= (Level wp0) 1)").changes == 0
    assert kb.replace("(at kenny wp0)").changes == 2


def test_rolling_back_a_removal_rolls_back_its_aborts(rooms):
    """C1, C12: an update that fails leaves the runs as they were, also where the block continues."""
    rooms.add("(= (level wp0) 5)")
    run = rooms.start("mop", "kenny", "wp0")
    with rooms.transaction() as tx:
        with pytest.raises(kbstore.InvalidKnowledge):
            tx.remove("kenny - robot", "(flying)")
        tx.add("(wet)")
    assert rooms.state().running == [run]
