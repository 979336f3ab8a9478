"""The reference's late knowledge, on scenarios worked out by hand from the rules."""

import contextlib

import pytest
from hypothesis import Phase, given, settings
from hypothesis import strategies as st

from tests.oracle import (
    Fact,
    Flow,
    Metric,
    Number,
    Object,
    RefAction,
    RefDomain,
    Reference,
    Refused,
    Start,
    Unsettled,
    Update,
)
from tests.oracle.rooms import DARK, DOMAIN, LIT, OPEN, SHUT, A, R, S, add, remove
from tests.property import universe


def cost(value, rate=0.0):
    return Number("cost", (), value, rate)


@pytest.fixture
def kb():
    """A reference with the domain at 1 and the objects a and r at 2."""
    kb = Reference()
    kb.write(1, [Update("domain", DOMAIN)])
    kb.write(2, [add(A), add(R)])
    return kb


def spans(kb, wanted, until=120, **belief):
    """The spans in which facts hold, or numbers have their values, by the state at each nanosecond."""
    found = []
    for at in range(until):
        state = kb.state(at, **belief)
        items = [item for item, _ in state.facts | state.functions | state.goals if item == wanted]
        if items and found and found[-1][1] == at:
            found[-1] = (found[-1][0], at + 1)
        elif items:
            found.append((at, at + 1))
    return found


def test_late_values_overlap_as_in_the_example(kb):
    """L2: 1, 9 from 20, 2 from 80; then 7 since 60."""
    kb.write(10, [add(cost(1.0))])
    kb.write(50, [add(cost(2.0))])
    assert kb.write(100, [add(cost(9.0), 20, 80)]) == 1
    assert [spans(kb, cost(value)) for value in (1.0, 9.0, 2.0)] == [[(10, 20)], [(20, 80)], [(80, 120)]]
    kb.write(110, [add(cost(7.0), 60)])
    assert spans(kb, cost(9.0)) == [(20, 60)]
    assert spans(kb, cost(7.0)) == [(60, 80)]
    assert spans(kb, cost(2.0)) == [(80, 120)]
    assert spans(kb, cost(9.0), number=5) == [(20, 80)]
    assert [spans(kb, cost(value), as_of=99) for value in (1.0, 2.0, 9.0)] == [[(10, 50)], [(50, 120)], []]


def test_a_missed_event_holds_until_the_next(kb):
    """L2: until the next begin or end on its timeline, or the end of its object; cancelled ones do not count."""
    kb.write(10, [add(OPEN)])
    kb.write(30, [remove(OPEN)])
    kb.write(40, [add(OPEN, at=70), add(SHUT, at=60)])
    kb.write(41, [remove(SHUT, at=60)])
    kb.write(50, [add(SHUT, 20)])
    assert spans(kb, OPEN) == [(10, 20), (70, 120)]
    assert spans(kb, SHUT) == [(20, 30)]
    kb.write(51, [add(SHUT, 35)])
    assert spans(kb, SHUT) == [(20, 30), (35, 70)]
    kb.write(52, [add(Object("b", "place"), 5), add(Fact("open", ("b",)), 6)])
    kb.write(53, [remove(Object("b", "place"), 8)])
    assert spans(kb, Fact("open", ("b",))) == [(6, 8)]
    kb.write(54, [add(Object("b", "place"), 15, 25), add(Fact("open", ("b",)), 18)])
    assert spans(kb, Fact("open", ("b",))) == [(6, 8), (18, 25)]


def test_an_assertion_that_began_at_that_time_is_replaced(kb):
    """L2: an end at that time, too."""
    kb.write(10, [add(LIT)])
    kb.write(30, [remove(LIT)])
    kb.write(50, [add(DARK, 10)])
    assert spans(kb, LIT) == []
    assert spans(kb, DARK) == [(10, 30)]
    kb.write(51, [add(LIT, 30)])
    assert spans(kb, LIT) == [(30, 120)]


def test_a_moving_number_goes_on_from_its_value(kb):
    """L2, C7: 2 a second from 5 at 1 s is 11 at 4 s, and at 6 s 15."""
    kb.write(1 * S, [add(cost(5.0, 2.0))])
    kb.write(8 * S, [add(cost(0.0, 1.0), 2 * S, 4 * S)])
    assert {t: [n.value for n, _ in kb.state(t * S).functions] for t in (1, 2, 3, 4, 6)} == {
        1: [5.0],
        2: [0.0],
        3: [1.0],
        4: [11.0],
        6: [15.0],
    }
    assert (cost(11.0, 2.0), 4 * S, None, 3, None, None, None) in kb.history()
    with pytest.raises(Refused, match="ScheduledRelativeChange"):
        kb.write(9 * S, [add(Number("cost", (), 1.0, operation="increase"), 3 * S)])


def test_late_removals(kb):
    """L3: matches at `since`, up to the next begin; with `until` in the span alone; signs have to match."""
    kb.write(10, [add(LIT)])
    kb.write(20, [add(DARK)])
    kb.write(30, [add(LIT)])
    kb.write(50, [remove(LIT, 15)])
    assert spans(kb, LIT) == [(10, 15), (30, 120)]
    kb.write(51, [remove(LIT, 12, 40)])
    assert spans(kb, LIT) == [(10, 12), (40, 120)]
    assert spans(kb, DARK) == [(20, 30)]
    assert kb.write(52, [remove(LIT, 25)]) == 0
    kb.write(60, [remove(Fact("lit"), 45)])
    assert spans(kb, LIT) == [(10, 12), (40, 45)]
    assert spans(kb, LIT, number=7) == [(10, 12), (40, 120)]


def test_patterns_range_over_the_objects_of_that_time(kb):
    """L3, V7: wildcards match the objects of the past."""
    kb.write(10, [add(Object("b", "place")), add(OPEN), add(Fact("open", ("b",)))])
    kb.write(20, [remove(Object("b", "place"))])
    assert kb.write(30, [remove(Fact("open", ("?",)), 15, 18)]) == 2
    assert spans(kb, Fact("open", ("b",))) == [(10, 15), (18, 20)]
    assert spans(kb, OPEN) == [(10, 15), (18, 120)]


def test_facts_do_not_hold_while_their_object_is_removed_late(kb):
    """L5: its facts do not hold there, and hold again from `until` on; what is scheduled there is cancelled."""
    kb.write(10, [add(OPEN), Update("add_goal", OPEN), add(SHUT, at=90)])
    kb.write(50, [remove(A, 20, 30)])
    assert {start for item, start in kb.state(60).facts if item == OPEN} == {30}
    assert spans(kb, OPEN, until=90) == [(10, 20), (30, 90)]
    assert {start for _, start in kb.state(60).goals} == {30}
    assert kb.state(60).timed_knowledge == {(SHUT, 90)}
    kb.write(60, [remove(A, 40)])
    assert spans(kb, OPEN) == [(10, 20), (30, 40)]
    assert kb.state(60).timed_knowledge == frozenset()
    assert kb.state(59).timed_knowledge == {(SHUT, 90)}
    kb.write(70, [add(A, 45)])
    assert spans(kb, OPEN) == [(10, 20), (30, 40)]


def test_late_objects_are_checked(kb):
    """L5, C6, C8: objects exist at `since`, and with `until` throughout; types don't meet."""
    kb.write(10, [add(Object("b", "place"))])
    kb.write(20, [remove(Object("b"))])
    kb.write(30, [add(LIT)])
    b = Fact("open", ("b",))
    for wrong in (add(b, 9), add(b, 20), add(b, 12, 21), add(Object("b", "robot"), 20), add(Object("b", "robot"), 5)):
        with pytest.raises(Refused, match="InvalidKnowledge"):
            kb.write(40, [wrong])
    assert kb.write(40, [add(b, 12, 20), add(Object("b", "robot"), 21), add(Object("c", "robot"), 5, 8)]) == 3
    assert spans(kb, b) == [(12, 20)]


def test_late_items_are_checked_under_each_domain_in_force(kb):
    """L5: a fact that would hold under a domain without its predicate is refused."""
    kb.write(10, [Update("domain", RefDomain("dark", DOMAIN.types, predicates={"open": (("place",),)}))])
    kb.write(20, [Update("domain", DOMAIN)])
    for wrong in (add(LIT, 5), add(LIT, 12), add(LIT, 5, 11)):
        with pytest.raises(Refused, match="InvalidKnowledge"):
            kb.write(30, [wrong])
    assert kb.write(30, [add(LIT, 5, 10)]) == 1
    assert kb.write(30, [add(LIT, 20)]) == 1


def test_times_that_are_refused(kb):
    """L1: spans that are empty, or not in the past."""
    for wrong in (
        *(add(LIT, 41), add(LIT, 30, 30), add(LIT, 30, 41), add(LIT, 40, 41), add(LIT, None, 30), add(LIT, 30, at=41)),
        Update("add_metric", Metric("minimize (cost)", (("cost", ()),)), since=30),
    ):
        with pytest.raises(Refused, match="InvalidTime"):
            kb.write(40, [wrong])
    assert kb.write(40, [add(LIT, 40)]) == 1
    assert kb.write(40, [add(LIT, 40)]) == 0


def test_late_knowledge_that_is_known_changes_nothing(kb):
    """L8: begun at `since` with the same value, or holding throughout; any other repetition is recorded."""
    kb.write(10, [add(LIT)])
    kb.write(50, [remove(LIT)])
    assert kb.write(60, [add(LIT, 10)]) == 0
    assert kb.write(60, [add(LIT, 20, 50)]) == 0
    assert kb.write(60, [add(LIT, 20)]) == 1
    assert kb.write(61, [add(LIT, 15, 45)]) == 0
    assert kb.write(61, [add(LIT, 40, 51)]) == 1
    assert spans(kb, LIT) == [(10, 51)]
    assert [row[1:] for row in kb.history() if row[0] == LIT] == [
        (10, 50, 3, 4, None, 5),
        (10, 20, 3, 5, None, None),
        (20, 50, 5, 4, None, 6),
        (20, 40, 5, 6, None, None),
        (40, 51, 6, 6, None, None),
    ]


def test_changes_list_corrections(kb):
    """L8, Q6: superseded assertions, and their replacements; an old change stays as it was."""
    kb.write(10, [add(LIT)])
    kb.write(50, [remove(LIT)])
    before = kb.changes()
    kb.write(60, [add(DARK, 20, 30)])
    assert kb.changes()[:-1] == before
    change = kb.changes()[-1]
    assert change.superseded == {(LIT, 10)}
    assert change.asserted == {(LIT, 10), (DARK, 20), (LIT, 30)}
    assert change.ended == frozenset()


def test_the_present_and_the_past_in_one_transaction(kb):
    """L1, C1: updates apply in their order."""
    kb.write(10, [add(LIT)])
    assert kb.write(50, [add(DARK), remove(LIT, 20, 30), add(LIT, 40)]) == 1
    assert spans(kb, LIT) == [(10, 20), (30, 50)]
    assert spans(kb, DARK) == [(50, 120)]
    assert (LIT, 40, 50, 4, 4, None, None) in kb.history()
    kb.write(60, [add(LIT, 55, 58), remove(DARK)])
    assert spans(kb, DARK) == [(50, 55), (58, 60)]


def test_late_numbers_move_at_the_rates_of_past_runs(kb):
    """L6: 4 since 2 s, run from 3 s to 5 s at 10 a second; the increase at 6 s stays as it was."""
    work = RefAction("work", ("robot",), flows=(Flow(("cost", ()), 10.0),))
    kb.write(1 * S, [add(cost(1.0))])
    kb.write(3 * S, [Update("start", Start(work, ("r",), 9 * S))])
    kb.write(5 * S, [Update("end", Start(work, ("r",), 9 * S))])
    kb.write(6 * S, [add(Number("cost", (), 1.0, operation="increase"))])
    kb.write(8 * S, [add(cost(4.0, 1.0), 2 * S)])
    assert [[n.value for n, _ in kb.state(t * S).functions] for t in (1, 2, 3, 4, 5, 6)] == [
        *([1.0], [4.0], [5.0], [16.0], [27.0], [22.0]),
    ]


def test_a_run_is_aborted_if_its_object_does_not_exist_now(kb):
    """L5, L7: the object is removed late."""
    run = Start(RefAction("work", ("robot",)), ("r",), 90)
    kb.write(10, [Update("start", run)])
    kb.write(30, [remove(R, 15, 20)])
    assert kb.state(30).running
    kb.write(40, [remove(R, 25)])
    assert kb.state(39).running
    assert not kb.state(40).running


@settings(max_examples=40, deadline=None, derandomize=True, database=None, phases=[Phase.generate])
@given(st.lists(st.tuples(universe.ticks, universe.late_steps, st.booleans()), min_size=4, max_size=14))
def test_beliefs_never_change(story):
    """T5, V1: later transactions do not change them, and no timeline has two values at one time."""
    kb = Reference()
    kb.write(1, [Update("domain", universe.ROOMS)])
    kb.write(2, [add(item) for item in (A, R, Object("b", "room"))])
    clock, seen = 10, {}
    for tick, step, late in story:
        clock += tick
        world = kb.world()
        world.advance(kb.now(clock))
        update = universe.late_update(step, world, kb.now(clock)) if late else universe.update(step[0], world, clock)
        with contextlib.suppress(Refused, Unsettled):
            kb.write(clock, [update])
        seen[kb.latest.number] = [(t, kb.state(t, number=kb.latest.number)) for t in (*range(1, 40, 3), clock)]
        world = kb.world()
        world.advance(clock)
        lines = [assertion.timeline for assertion in world.assertions if assertion.holds_at(clock)]
        assert len(lines) == len(set(lines))
    for number, states in seen.items():
        for t, state in states:
            assert kb.state(t, number=number) == state
