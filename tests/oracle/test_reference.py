"""The reference itself, on scenarios worked out by hand."""

import pytest

from tests.oracle import (
    Comparison,
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
    Update,
)
from tests.oracle.rooms import DOMAIN, LIT, NEAR, OPEN, A, R, S, add, remove


@pytest.fixture
def kb():
    """A reference with the domain at 10, the objects a and r, and two facts about a, all recorded by 20."""
    kb = Reference()
    kb.write(10, [Update("domain", DOMAIN)])
    kb.write(20, [add(A), add(R), add(OPEN), add(NEAR)])
    return kb


def facts(kb, at, **belief):
    return {item for item, _ in kb.state(at, **belief).facts}


def test_a_scheduled_fact_takes_effect_at_its_time(kb):
    """T4, V1: it holds from its time on, and not one nanosecond before."""
    kb.write(30, [add(LIT, at=50), add(Fact("lit", positive=False), at=60)])
    assert LIT not in facts(kb, 49)
    assert LIT in facts(kb, 50)
    assert facts(kb, 60) == {OPEN, NEAR, Fact("lit", positive=False)}
    assert kb.state(30).timed_knowledge == {(LIT, 50), (Fact("lit", positive=False), 60)}


def test_belief_uses_only_what_was_recorded(kb):
    """Q2: as of 35 the lamp was expected to be lit at 50; it was cancelled at 40."""
    kb.write(30, [add(LIT, at=50)])
    kb.write(40, [remove(LIT, at=50)])
    assert LIT in facts(kb, 55, as_of=35)
    assert LIT not in facts(kb, 55)
    assert (LIT, 50, 50, 3, None, 4, None) in kb.history()


def test_removing_an_object_ends_its_facts(kb):
    """C9, C4: facts end at the same time, and do not come back with the object."""
    kb.write(30, [remove(A)])
    kb.write(40, [add(A)])
    assert facts(kb, 29) == {OPEN, NEAR}
    assert facts(kb, 30) == set()
    assert facts(kb, 50) == set()
    assert kb.reason(OPEN, 35) == ("expired with its instance", 3)


def test_removing_and_adding_an_object_in_one_transaction_ends_its_facts(kb):
    """C1: removing and adding it is no change of the object, but its facts end, unless added again."""
    assert kb.write(30, [remove(A), add(A), add(OPEN)]) == 1
    assert facts(kb, 30) == {OPEN}
    assert (OPEN, 20, None, 2, None, None, None) in kb.history()
    assert (NEAR, 20, 30, 2, 3, None, None) in kb.history()
    assert [row for row in kb.history() if row[0] == A] == [(A, 20, None, 2, None, None, None)]


def test_cancelling_a_scheduled_end_restores_what_it_cut_short(kb):
    """C9: facts that the end cut short are restored; what it cancelled stays cancelled."""
    kb.write(30, [add(Fact("open", ("a",), positive=False), at=80)])
    kb.write(40, [add(Object("a", "place", positive=False), at=60)])
    assert facts(kb, 59) == {OPEN, NEAR}
    assert facts(kb, 60) == set()
    assert kb.state(40).timed_knowledge == {(Object("a", "place", positive=False), 60)}
    kb.write(50, [remove(Object("a", "place", positive=False), at=60)])
    assert facts(kb, 90) == {OPEN, NEAR}
    assert facts(kb, 90, as_of=49) == set()


def test_a_past_end_cannot_be_undone(kb):
    """T5, C9: an object that is added again at the time of its end has lost its facts."""
    kb.write(30, [add(Object("a", "place", positive=False), at=40)])
    assert kb.write(40, [add(A)]) == 1
    assert facts(kb, 45) == set()
    assert kb.write(40, [add(OPEN)]) == 1
    assert facts(kb, 45) == {OPEN}


def test_removal_cancels_only_up_to_the_next_start(kb):
    """C9: the object's own schedule is left alone, and so are mentions after its next start."""
    kb.write(30, [add(Object("a", "place", positive=False), at=50), add(A, at=70), add(LIT, at=55)])
    kb.write(31, [add(OPEN, at=45), add(OPEN, at=75)])
    kb.write(40, [remove(A)])
    assert facts(kb, 45) == set()
    assert facts(kb, 75) == {OPEN, LIT}


def test_types_may_not_meet(kb):
    """C6: another type needs an end strictly before; cancelling that end is refused."""
    with pytest.raises(Refused, match="InvalidKnowledge"):
        kb.write(30, [add(Object("a", "robot"), at=50)])
    end = Object("a", "place", positive=False)
    with pytest.raises(Refused, match="InvalidKnowledge"):
        kb.write(30, [add(end, at=50), add(Object("a", "robot"), at=50)])
    kb.write(30, [add(end, at=49), add(Object("a", "robot"), at=50)])
    with pytest.raises(Refused, match="InvalidKnowledge"):
        kb.write(31, [remove(end, at=49)])
    with pytest.raises(Refused, match="InvalidKnowledge"):
        kb.write(31, [remove(A), add(Object("a", "robot"))])
    kb.write(32, [remove(A)])
    with pytest.raises(Refused, match="InvalidKnowledge"):
        kb.write(32, [add(Object("a", "robot"))])
    kb.write(33, [add(Object("a", "robot"))])
    with pytest.raises(Refused, match="InvalidKnowledge"):
        kb.write(40, [add(Object("b", "place")), add(Object("b", "robot"))])
    kb.write(40, [add(Object("b", "place")), remove(Object("b")), add(Object("b", "robot"))])


def test_rates_and_relative_changes(kb):
    """C7: relative to the value at now; the rate is kept, and a rate starts from the value at now."""
    load = Number("load", ("r",), 8.0)
    kb.write(1 * S, [add(load)])
    kb.write(2 * S, [add(Number("load", ("r",), 2.0, operation="assign_cts"))])
    kb.write(4 * S, [add(Number("load", ("r",), 3.0, operation="increase"))])
    values = {t: [item.value for item, _ in kb.state(t * S).functions] for t in (1, 2, 3, 4, 6)}
    assert values == {1: [8.0], 2: [8.0], 3: [10.0], 4: [15.0], 6: [19.0]}
    assert kb.write(5 * S, [add(Number("load", ("r",), 17.0, rate=2.0))]) == 0
    assert kb.write(5 * S, [add(Number("load", ("r",), 17.0))]) == 1
    with pytest.raises(Refused, match="ScheduledRelativeChange"):
        kb.write(6 * S, [add(Number("load", ("r",), 1.0, operation="increase"), at=7 * S)])
    with pytest.raises(Refused, match="UndefinedFunction"):
        kb.write(6 * S, [add(Number("cost", (), 1.0, operation="increase"))])


def test_the_last_update_of_a_timeline_counts(kb):
    """C1, C2: adding and removing again is no change and takes no number."""
    assert kb.write(30, [add(LIT), remove(LIT)]) == 0
    assert kb.write(30, [remove(OPEN), add(OPEN)]) == 0
    assert kb.write(30, [add(LIT, at=50), remove(LIT, at=50)]) == 0
    assert kb.latest.number == 2
    kb.write(30, [add(LIT, at=50)])
    assert kb.write(31, [add(LIT, at=50)]) == 0
    assert kb.write(31, [add(Fact("lit", positive=False), at=50)]) == 1
    assert [row[5] for row in kb.history() if row[0].name == "lit"] == [4, None]


def test_a_wildcard_removes_each_match_of_its_sign(kb):
    """C4, V7: a positive pattern leaves explicit negatives alone."""
    kb.write(30, [add(Fact("open", ("home",), positive=False))])
    assert kb.write(31, [remove(Fact("open", ("?",)))]) == 1
    assert facts(kb, 31) == {NEAR, Fact("open", ("home",), positive=False)}
    with pytest.raises(Refused, match="InvalidKnowledge"):
        kb.write(32, [remove(Fact("open", ("?", "?")))])


def test_clear_ends_and_cancels_everything(kb):
    """C12: in one transaction; history remains."""
    kb.write(30, [add(LIT, at=50), Update("add_metric", Metric("minimize (cost)", (("cost", ()),)))])
    kb.write(40, [Update("clear")])
    empty = kb.state(60)
    assert not empty.instances | empty.facts | empty.timed_knowledge
    assert empty.metric is None
    assert facts(kb, 39) == {OPEN, NEAR}
    assert kb.write(41, [Update("clear")]) == 0


def test_goals_have_separate_timelines(kb):
    """C10, C9: a goal is not a fact, and ends with its objects."""
    kb.write(30, [Update("add_goal", Fact("open", ("a",), positive=False)), Update("add_goal", LIT)])
    kb.write(40, [remove(A)])
    assert {item for item, _ in kb.state(35).goals} == {Fact("open", ("a",), positive=False), LIT}
    assert {item for item, _ in kb.state(40).goals} == {LIT}
    assert kb.diff(35, 40).goals_removed == {Fact("open", ("a",), positive=False)}


def test_validation_is_at_the_time_of_the_item(kb):
    """D1: each argument exists at the item's time with a type that fits; a later item may use an earlier one."""
    with pytest.raises(Refused, match="InvalidKnowledge"):
        kb.write(30, [add(Fact("open", ("b",)), at=50)])
    kb.write(30, [add(Object("b", "room"), at=40), add(Fact("open", ("b",)), at=40)])
    with pytest.raises(Refused, match="InvalidKnowledge"):
        kb.write(30, [add(Fact("open", ("b",)), at=39)])
    with pytest.raises(Refused, match="InvalidKnowledge"):
        kb.write(30, [add(Fact("open", ("r",)))])
    assert kb.latest.number == 3


def test_a_domain_that_does_not_fit_is_refused(kb):
    """D4: a current fact needs its predicate, and an object may not become a constant."""
    with pytest.raises(Refused, match="InvalidKnowledge"):
        kb.write(30, [Update("domain", RefDomain("less", types=DOMAIN.types, predicates={"lit": ()}))])
    with pytest.raises(Refused, match="InvalidKnowledge"):
        kb.write(30, [Update("domain", RefDomain("more", DOMAIN.types, {"a": "place"}, DOMAIN.predicates))])
    assert kb.state(30).domain == "rooms"
    assert kb.state(9).domain is None


def test_differences(kb):
    """Q5: assertions are compared; an object of another type was withdrawn and became true."""
    kb.write(30, [remove(A), add(Fact("open", ("home",), positive=False)), add(Comparison("(> (cost) 1)"))])
    kb.write(40, [add(Object("a", "robot")), add(Number("cost", (), 4.0))])
    difference = kb.diff(25, 40)
    assert difference.became_true == {Object("a", "robot"), Comparison("(> (cost) 1)")}
    assert difference.became_false == {Fact("open", ("home",), positive=False)}
    assert difference.withdrawn == {A, OPEN, NEAR}
    assert difference.numbers == {("cost", (), None, 4.0)}


def test_a_clock_far_behind_is_refused(kb):
    """T3: within the tolerance the latest time is taken."""
    kb.write(2 * S, [add(LIT)])
    kb.write(1 * S, [remove(LIT)])
    assert kb.latest.time == 2 * S
    with pytest.raises(Refused, match="ClockWentBackwards"):
        kb.write(1 * S - 1, [add(LIT)])


def test_without_a_domain_a_removal_cancels_up_to_the_next_start():
    """C9: up to the next start, whether the object would have existed then or not."""
    kb = Reference()
    kb.write(10, [add(A), add(Object("a", "place", positive=False), at=20), add(OPEN, at=30)])
    assert kb.write(15, [remove(A)]) == 2


def test_the_end_of_an_absent_object_changes_nothing_else(kb):
    """C9, C4: it is recorded; with another type than the object has, not even that."""
    assert kb.write(30, [add(Object("b", "place", positive=False), at=50)]) == 1
    assert kb.write(30, [add(Object("a", "robot", positive=False), at=50)]) == 0


DRIVE = RefAction(
    "drive",
    ("robot",),
    needs=(LIT,),
    at_start=(Fact("lit", positive=False),),
    at_end=(LIT,),
    numbers_at_end=(Number("cost", (), 1.0, operation="increase"),),
    flows=(Flow(("load", ("0",)), -2.0),),
)
START = Start(DRIVE, ("r",), 10 * S)


def test_a_run_moves_its_functions_until_it_ends(kb):
    """O3: contributions begin and end with the action; the expected end is computed, and never becomes the past."""
    kb.write(1 * S, [add(LIT), add(Number("load", ("r",), 80.0)), add(Number("cost", (), 0.0))])
    kb.write(2 * S, [Update("start", START)])

    def load(at, clock=2 * S):
        return [item.value for item, _ in kb.state(at * S, clock=clock).functions if item.name == "load"]

    assert [load(at) for at in (1, 2, 3, 12, 20)] == [[80.0], [80.0], [78.0], [60.0], [60.0]]
    assert LIT in {item for item, _ in kb.state(12 * S).facts}
    assert load(20, clock=15 * S) == [44.0]
    assert LIT not in {item for item, _ in kb.state(15 * S, clock=15 * S).facts}
    kb.write(16 * S, [Update("end", START)])
    assert load(20, clock=20 * S) == [52.0]
    assert load(20, clock=20 * S) == [item.value for item, _ in kb.state(17 * S).functions if item.name == "load"]
    with pytest.raises(Refused, match="NotApplicable"):
        kb.write(17 * S, [Update("end", START)])


def test_effects_decided_at_the_start_happen_at_the_end(kb):
    """O2, O3: by the facts before the at-start effects, not by those at the end."""
    dark = Fact("lit", positive=False)
    act = RefAction(
        "watch",
        ("robot", "place"),
        at_start=(dark,),
        decided_at_start=((LIT, Fact("near", ("0", "1"), positive=False)), (dark, LIT)),
    )
    first, second = (Start(act, ("r", "a"), seconds * S) for seconds in (10, 20))
    kb.write(1 * S, [add(LIT)])
    kb.write(2 * S, [Update("start", first)])
    assert facts(kb, 2 * S) == {OPEN, NEAR}
    assert facts(kb, 12 * S) == {OPEN}
    kb.write(3 * S, [Update("end", first)])
    assert facts(kb, 3 * S) == {OPEN}
    kb.write(4 * S, [Update("start", second), add(NEAR)])
    kb.write(5 * S, [Update("end", second)])
    assert facts(kb, 5 * S) == {OPEN, NEAR, LIT}


def test_a_run_is_aborted_with_its_object(kb):
    """O3, C12: when the object ends, by the schedule or by a removal."""
    kb.write(1 * S, [add(LIT), add(Number("load", ("r",), 80.0)), add(Number("cost", (), 0.0))])
    kb.write(2 * S, [Update("start", START)])
    kb.write(3 * S, [add(Object("r", "robot", positive=False), at=5 * S)])
    assert kb.state(5 * S - 1).running == {("drive", ("r",), 2 * S, 10 * S)}
    assert kb.state(20 * S).running == set()
    assert LIT not in {item for item, _ in kb.state(20 * S).facts}
    assert kb.state(20 * S, as_of=2 * S).running == set()
    assert LIT in {item for item, _ in kb.state(20 * S, as_of=2 * S).facts}
    kb.write(4 * S, [remove(R)])
    assert kb.state(4 * S).running == set()
