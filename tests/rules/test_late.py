"""Rules L1 to L9: knowledge about the past that is recorded now."""

import pytest

import kbstore
from kbstore import Truth, seconds
from tests.conftest import START
from tests.rules.reading import facts

S = seconds(1)


@pytest.fixture
def world(kb, clock):
    """The knowledge base, 100 s after `START`; since 10 s the door of wp0 is open, since 50 s the cost is 2."""
    clock.set(START + 10 * S)
    kb.add("(open wp0)", "(= (cost) 1)")
    clock.set(START + 50 * S)
    kb.add("(= (cost) 2)")
    clock.set(START + 100 * S)
    return kb


def at(offset):
    return START + offset * S


def spans(kb, condition, as_of=None):
    return [((a - START) // S, (b - START) // S) for a, b in kb.when(condition, START, at(120), as_of)]


# -- L1 -----------------------------------------------------------------------------------------------------------


def test_since_is_recorded_now_and_holds_from_the_past(world):
    """L1: the transaction has the time of now."""
    done = world.add("(not (open wp0))", since=at(20), client="porter")
    assert done.time == at(100)
    assert spans(world, "(open wp0)") == [(10, 20)]
    assert world.truth("(open wp0)", at=at(30)) is Truth.FALSE
    assert world.holds("(open wp0)", at=at(30), as_of=at(99))


def test_since_may_be_zero(world):
    """L1: 0 is the time 0, not now."""
    world.add("(raining)", since=0)
    assert world.holds("(raining)", at=1)


def test_since_now_is_the_same_as_no_since(world, clock):
    """L1: scheduled knowledge may be given so, too."""
    world.add("(raining)", since=clock.now())
    assert world.history("(raining)")[0].initial_time == clock.now()
    assert world.add("(raining)", since=clock.now()).changes == 0


@pytest.mark.parametrize(
    ("since", "until", "words"),
    [
        (at(101), None, "lies after now"),
        (at(30), at(30), "is not after since"),
        (at(30), at(20), "is not after since"),
        (at(30), at(101), "until .* lies after now"),
        (None, at(30), "until belongs to since"),
    ],
)
def test_times_that_are_not_a_span_of_the_past(world, since, until, words):
    """L1: they are refused, and nothing is stored."""
    number = world.changes().__next__().number and [change.number for change in world.changes()][-1]
    with pytest.raises(kbstore.InvalidTime, match=words):
        world.add("(raining)", since=since, until=until)
    assert [change.number for change in world.changes()][-1] == number


def test_an_item_that_is_to_hold_later_is_refused(world):
    """L1: an initial_time in the past is ignored, one after now is refused."""
    later = kbstore.Fact(attribute_name="raining", initial_time=at(130))
    with pytest.raises(kbstore.InvalidTime, match="lies ahead"):
        world.add(later, since=at(20))
    world.add(later.model_copy(update={"initial_time": at(5)}), since=at(20))
    assert spans(world, "(raining)") == [(20, 120)]


@pytest.mark.parametrize("item", ["minimize (cost)", "(> (cost) 1)"])
def test_a_metric_and_a_recorded_inequality_take_no_since(world, item):
    """L1: late knowledge does not include them."""
    item = kbstore.item(item)
    for change in (world.add, world.remove):
        with pytest.raises(kbstore.InvalidTime, match="without since"):
            change(item, since=at(20))


def test_goals_take_since(world):
    """L1: for goals of each form."""
    world.add_goal("(and (open hall) (> (cost) 1) (or (raining) (open hall)))", since=at(20), until=at(40))
    assert [len(world.goals(at=at(t))) for t in (19, 20, 39, 40)] == [0, 3, 3, 0]
    world.add_goal("(open wp1)", since=at(60))
    world.remove_goal("(open ?)", since=at(70))
    assert [len(world.goals(at=at(t))) for t in (59, 60, 69, 70)] == [0, 1, 1, 0]


# -- L2 -----------------------------------------------------------------------------------------------------------


def test_late_values_overlap_as_in_the_example(world, clock):
    """L2: 1 from 10, 9 from 20, 2 from 80; then 7 from 60."""
    world.add("(= (cost) 9)", since=at(20), until=at(80))
    assert [world.value("(cost)", at=at(t)) for t in (10, 19, 20, 79, 80, 100)] == [1, 1, 9, 9, 2, 2]
    world.add("(= (cost) 7)", since=at(60))
    assert [world.value("(cost)", at=at(t)) for t in (59, 60, 79, 80)] == [9, 7, 7, 2]


def test_an_event_ends_at_the_next_scheduled_assertion(world, clock):
    """L2: scheduled assertions count, cancelled ones do not."""
    world.add("(open wp1)", initial_time=at(110))
    world.add("(not (open wp1))", initial_time=at(105))
    world.remove("(not (open wp1))", initial_time=at(105))
    world.add("(not (open wp1))", since=at(30))
    assert spans(world, "(open wp1)") == [(110, 120)]
    assert world.history("(open wp1)")[0].end_time == at(110)


def test_an_event_ends_with_an_object(world, clock):
    """L2: a late fact does not outlive an object that has ended since."""
    world.remove("wp1")
    clock.advance(S)
    world.add("(open wp1)", since=at(30))
    assert spans(world, "(open wp1)") == [(30, 100)]
    assert world.history("(open wp1)")[0].ended.number == world.history("wp1")[0].ended.number


def test_a_moving_number_goes_on_from_its_value(kb, clock):
    """L2: 80, falling by 2 a second, is 60 after 10 s; corrected for 5 s in between."""
    clock.set(at(10))
    kb.add(kbstore.Function(attribute_name="battery", values=["kenny"], function_value=80, rate=-2))
    clock.set(at(30))
    kb.add("(= (battery kenny) 99)", since=at(12), until=at(17))
    assert [kb.value("(battery kenny)", at=at(t)) for t in (11, 12, 16, 17, 20)] == [78, 99, 99, 66, 60]


# -- L3 -----------------------------------------------------------------------------------------------------------


def test_a_late_removal_ends_at_the_next_assertion(world, clock):
    """L3: signs have to match; where nothing matches, nothing changes."""
    world.add("(not (open wp0))", since=at(60))
    assert world.remove("(open wp0)", since=at(70)).changes == 0
    world.remove("(open wp0)", since=at(30))
    assert spans(world, "(open wp0)") == [(10, 30)]
    assert world.history("(open wp0)")[-1].item.is_negative


def test_a_removal_in_a_span(world, clock):
    """L3: it removes all matches within the span, and nothing outside it."""
    clock.set(at(101))
    world.add("(open wp1)", "(open hall)", since=at(40))
    world.remove("(open ?)", since=at(30), until=at(50))
    assert spans(world, "(open wp0)") == [(10, 30), (50, 120)]
    assert spans(world, "(open wp1)") == [(50, 120)]
    assert world.remove("(open ?)", since=at(30), until=at(50)).changes == 0


# -- L4 -----------------------------------------------------------------------------------------------------------


def test_every_question_takes_as_of(world, clock):
    """L4: as of a time or of a transaction."""
    before = world.add("(raining)")
    clock.set(at(101))
    world.add("(not (open wp0))", "(= (cost) 7)", since=at(20))
    for as_of in (at(100), before):
        assert world.truth("(open wp0)", at=at(30), as_of=as_of) is Truth.TRUE
        assert world.value("(cost)", at=at(30), as_of=as_of) == 1
        assert spans(world, "(open wp0)", as_of) == [(10, 120)]
        assert spans(world, "(> (cost) 5)", as_of) == []
        assert [found.superseded for found in world.history("(open wp0)", as_of=as_of)] == [None]
        assert not world.diff(at(19), at(20), as_of=as_of)
        assert "(open wp0)" in world.to_pddl(at(30), as_of)
        assert world.explain("(open wp0)", at(30), as_of).reason == "asserted"
    assert str(world.diff(at(19), at(20))) == "! (not (open wp0))\n~ (cost) 1 -> 7"
    assert spans(world, "(> (cost) 5)") == [(20, 50)]


def test_late_knowledge_does_not_change_old_forecasts(world, clock):
    """L4, Q2: as of 40 and as of 90, a forecast does not include what was recorded at 101 about 30."""
    clock.set(at(101))
    world.add("(not (open wp0))", since=at(30))
    assert world.holds("(open wp0)", at=at(90), as_of=at(40))
    assert not world.holds("(open wp0)", at=at(90), as_of=at(101))
    assert world.state(at(90), at(40)).facts[0].initial_time == at(10)


def test_cached_states_are_read_again_in_every_process(open_kb, store_url, clock):
    """L4: also a past state that was cached before late knowledge changed it."""
    if store_url == "sqlite://":
        pytest.skip("a store in memory has one process")
    one = open_kb()
    one.add("(raining)")
    other = open_kb(one.name)
    clock.set(at(50))
    one.add("(cold)")
    for kb in (one, other):
        assert facts(kb, at(20)) == ["(raining)"]
        assert facts(kb, at(40)) == ["(raining)"]
    one.add("(not (raining))", since=at(30))
    for kb in (one, other):
        assert facts(kb, at(20)) == ["(raining)"]
        assert facts(kb, at(40)) == ["(not (raining))"]
        assert facts(kb, at(40), as_of=at(49)) == ["(raining)"]


# -- L5 -----------------------------------------------------------------------------------------------------------


def test_objects_have_to_exist(world, clock):
    """L5: at `since`, and with `until` throughout; the refusal names them."""
    clock.set(at(110))
    world.add("wp9 - place", since=at(30), until=at(60))
    world.add("(open wp9)", since=at(40))
    assert spans(world, "(open wp9)") == [(40, 60)]
    with pytest.raises(kbstore.InvalidKnowledge, match="wp9 does not exist at"):
        world.add("(open wp9)", since=at(20))
    with pytest.raises(kbstore.InvalidKnowledge, match="wp9 does not exist all the time"):
        world.add("(open wp9)", since=at(40), until=at(70))


def test_types_do_not_meet(world, clock):
    """L5, C6, C8: the update is refused, and nothing is stored."""
    world.add("wp9 - place", since=at(30), until=at(60))
    for span in ({"since": at(20), "until": at(30)}, {"since": at(60)}, {"since": at(40)}):
        with pytest.raises(kbstore.InvalidKnowledge, match="changes its type only after an end strictly before"):
            world.add("wp9 - room", **span)
    world.add("wp9 - room", since=at(20), until=at(29))
    assert [spans(world, f"(exists (?x - {name}) (= ?x wp9))") for name in ("room", "place")] == [
        [(20, 29)],
        [(20, 29), (30, 60)],
    ]


def test_facts_do_not_hold_while_their_object_is_removed_late(world, clock):
    """L5: its facts do not hold there, and hold again from `until` on; what is scheduled there is cancelled."""
    world.add("(not (open wp0))", initial_time=at(110))
    world.remove("wp0", since=at(20), until=at(30))
    assert spans(world, "(open wp0)") == [(10, 20), (30, 110)]
    world.remove("wp0", since=at(40))
    assert spans(world, "(open wp0)") == [(10, 20), (30, 40)]
    assert world.timed_knowledge() == []
    assert world.timed_knowledge(at=at(100)) == []
    assert world.explain("(open wp0)", at=at(45)).reason == "expired with its instance"


# -- L6 -----------------------------------------------------------------------------------------------------------


def test_relative_changes_are_refused(world):
    """L6: a relative change with `since` is an error."""
    with pytest.raises(kbstore.ScheduledRelativeChange, match="cannot be late knowledge"):
        world.add("(increase (cost) 2)", since=at(20))


# -- L8 -----------------------------------------------------------------------------------------------------------


def test_superseded_assertions_stay_in_the_history(world, clock):
    """L8: history lists superseded assertions, and what remains with the transaction that first recorded it."""
    first = world.history("(open wp0)")[0].recorded
    done = world.add("(not (open wp0))", since=at(20), until=at(30))
    listed = [
        (str(found.item), found.initial_time, found.end_time, found.recorded.number, found.superseded)
        for found in world.history("(open wp0)")
    ]
    assert listed == [
        ("(open wp0)", at(10), None, first.number, done),
        ("(open wp0)", at(10), at(20), first.number, None),
        ("(not (open wp0))", at(20), at(30), done.number, None),
        ("(open wp0)", at(30), None, first.number, None),
    ]


def test_changes_list_corrections(world, clock):
    """L8: what held before, less the superseded and with the asserted, is what holds now; watch returns the same."""
    last = [change.number for change in world.changes()][-1]
    world.add("(not (open wp0))", since=at(20))
    (change,) = world.changes(after=last)
    assert [(str(found.item), found.initial_time) for found in change.superseded] == [("(open wp0)", at(10))]
    assert [(str(found.item), found.initial_time) for found in change.asserted] == [
        ("(open wp0)", at(10)),
        ("(not (open wp0))", at(20)),
    ]
    assert list(world.watch("(open ?)", after=last, timeout=0)) == [change]


def test_late_knowledge_that_is_known_changes_nothing(world):
    """L8: begun at `since` with the same value, or holding throughout; any other repetition is recorded."""
    assert world.add("(open wp0)", since=at(10)).changes == 0
    assert world.add("(open wp0)", since=at(10), until=at(100)).changes == 0
    assert world.add("(open wp0)", since=at(20)).changes == 1


# -- L9 -----------------------------------------------------------------------------------------------------------


def test_late_knowledge_about_archived_times_is_refused(world, tmp_path):
    """L9: `since` before the archived time is refused."""
    world.archive(at(30), tmp_path / "past.db")
    with pytest.raises(kbstore.HistoryUnavailable, match="keeps its history from"):
        world.add("(raining)", since=at(29))
    assert world.add("(raining)", since=at(30)).changes == 1
