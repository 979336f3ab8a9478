"""Rules C9, C10 and C12: removing an object ends every assertion that mentions it; goals; clear."""

import pytest

import kbstore
from kbstore import seconds
from tests.conftest import START
from tests.rules.reading import facts, instances, intervals, picture, scheduled, texts

END = "(not (wp0 - place))"


# -- C9: removal now ----------------------------------------------------------------------------------------------


def test_removing_an_object_ends_everything_that_mentions_it(kb, clock):
    """C9: facts of both signs, functions, goals, inequalities and the metric, at the same time."""
    kb.add("(near kenny wp0)", "(not (near kenny wp1))", "(= (battery kenny) 5)", "(> (battery kenny) 1)", "(open wp0)")
    kb.add_goal("(near kenny wp1)", "(< (battery kenny) 9)", "(open wp0)")
    kb.add_metric("minimize (battery kenny)")
    clock.set(START + 10)
    removal = kb.remove("kenny")
    state = kb.state()
    assert texts(state.facts) == ["(open wp0)"]
    assert (state.functions, state.inequalities, state.metric) == ([], [], None)
    assert texts(state.goals) == ["(open wp0)"]
    (assertion,) = kb.history("(near kenny wp0)")
    assert (assertion.end_time, assertion.ended.number) == (START + 10, removal.number)
    assert picture(kb, START + 9)["functions"] == ["(= (battery kenny) 5)"]


def test_removing_an_object_cancels_what_is_scheduled_for_it(kb):
    """C9: the transaction that cancelled it is recorded."""
    kb.add("(near kenny wp0)", initial_time=START + 10)
    kb.add("(open wp0)", initial_time=START + 10)
    removal = kb.remove("kenny")
    assert scheduled(kb) == [(START + 10, "(open wp0)")]
    (assertion,) = kb.history("(near kenny wp0)")
    assert assertion.cancelled.number == removal.number


def test_facts_do_not_come_back_with_their_object(kb, clock):
    """C9: an object that is added again has none of its former facts."""
    kb.add("(open wp0)")
    clock.set(START + 10)
    kb.remove("wp0")
    clock.set(START + 20)
    kb.add("wp0 - place")
    assert facts(kb, START + 30) == []


def test_removal_leaves_the_objects_own_schedule_alone(kb, clock):
    """C9: assertions that mention the object are cancelled only up to its next start."""
    kb.add(END, initial_time=START + 20)
    kb.add("wp0 - place", initial_time=START + 30)
    kb.add("(open wp0)", initial_time=START + 15)
    kb.add("(open wp0)", initial_time=START + 40)
    clock.set(START + 10)
    kb.remove("wp0")
    assert scheduled(kb) == [(START + 20, END), (START + 30, "wp0 - place"), (START + 40, "(open wp0)")]
    exists = {at: "wp0 - place" in instances(kb, START + at) for at in (9, 10, 20, 29, 30)}
    assert exists == {9: True, 10: False, 20: False, 29: False, 30: True}
    assert facts(kb, START + 40) == ["(open wp0)"]


def test_a_negative_instance_for_now_is_a_removal(kb, clock):
    """C9: in text `(not (wp0 - place))`; only the end is recorded."""
    kb.add("(open wp0)")
    clock.set(START + 10)
    kb.add(END)
    assert facts(kb) == []
    assert intervals(kb, "wp0 - place") == [("wp0 - place", START, START + 10, False)]


def test_without_a_domain_a_removal_cancels_up_to_the_next_start(bare, clock):
    """C9: also assertions after an end that is still ahead; those after the next start stay."""
    bare.add("wp0 - place", "(near ghost wp1)")
    bare.add("(not (wp0 - place))", initial_time=START + 20)
    bare.add("wp0 - place", initial_time=START + 40)
    for later in (15, 20, 30, 39, 40):
        bare.add("(open wp0)", initial_time=START + later)
    clock.set(START + 10)
    bare.remove("wp0")
    timed = [(str(fact), fact.initial_time - START) for fact in bare.timed_knowledge("open")]
    assert timed == [("(open wp0)", 40)]


def test_without_a_domain_removing_an_object_still_ends_its_facts(bare, clock):
    """C9: existence is not checked, but removals end facts all the same."""
    bare.add("(open wp0)", "wp0 - place", "(near ghost wp0)", "(near ghost wp1)")
    clock.set(START + 10)
    bare.remove("wp0")
    assert facts(bare) == ["(near ghost wp1)"]


# -- C9: scheduled ends -------------------------------------------------------------------------------------------


def test_a_scheduled_end_ends_what_mentions_the_object_at_its_time(kb):
    """C9: up to the last nanosecond before it everything holds."""
    kb.add("(open wp0)", "(= (distance wp0 wp1) 5)", "(raining)")
    kb.add_goal("(open wp0)")
    ending = kb.add(END, initial_time=START + 10)
    assert picture(kb, START + 9)["facts"] == ["(open wp0)", "(raining)"]
    after = picture(kb, START + 10)
    assert (after["facts"], after["functions"], after["goals"]) == (["(raining)"], [], [])
    (assertion,) = kb.history("(open wp0)")
    assert (assertion.end_time, assertion.ended.number) == (START + 10, ending.number)


def test_a_scheduled_end_cancels_later_scheduled_mentions(kb):
    """C9: assertions scheduled before that time stay."""
    for at in (9, 10, 11):
        kb.add("(open wp0)", initial_time=START + at)
    kb.add(END, initial_time=START + 10)
    assert scheduled(kb) == [(START + 9, "(open wp0)"), (START + 10, END)]
    assert [facts(kb, START + at) for at in (8, 9, 10)] == [[], ["(open wp0)"], []]


def test_a_fact_added_later_does_not_outlive_a_scheduled_end(kb, clock):
    """C9: whether it is added for now, or scheduled before the end."""
    kb.add(END, initial_time=START + 10)
    clock.set(START + 5)
    kb.add("(open wp0)")
    kb.add("(near kenny wp0)", initial_time=START + 7)
    assert facts(kb, START + 9) == ["(near kenny wp0)", "(open wp0)"]
    assert facts(kb, START + 10) == []
    with pytest.raises(kbstore.InvalidKnowledge, match="wp0"):
        kb.add("(open wp0)", initial_time=START + 10)


def test_cancelling_a_scheduled_end_restores_what_it_cut_short(kb, clock):
    """C9: what the end cancelled stays cancelled."""
    kb.add("(open wp0)")
    kb.add("(near kenny wp0)", initial_time=START + 20)
    kb.add(END, initial_time=START + 10)
    clock.set(START + 5)
    kb.remove(END, initial_time=START + 10)
    assert facts(kb, START + 30) == ["(open wp0)"]
    assert intervals(kb, "(open wp0)") == [("(open wp0)", START, None, False)]
    assert kb.history("(near kenny wp0)")[0].cancelled is not None
    assert facts(kb, START + 30, as_of=START + 4) == []


def test_replacing_a_scheduled_end_by_a_start_restores_what_it_cut_short(kb):
    """C6, C9: the end is cancelled by what is scheduled for the same time."""
    kb.add("(open wp0)")
    kb.add(END, initial_time=START + 10)
    kb.add("wp0 - place", initial_time=START + 10)
    assert facts(kb, START + 30) == ["(open wp0)"]


def test_moving_a_scheduled_end_moves_what_it_cuts_short(kb):
    """C9: future ends are derived from the schedule."""
    kb.add("(open wp0)")
    kb.add(END, initial_time=START + 10)
    with kb.transaction() as tx:
        tx.remove(END, initial_time=START + 10)
        tx.add(END, initial_time=START + 15)
    assert [facts(kb, START + at) for at in (10, 14, 15)] == [["(open wp0)"], ["(open wp0)"], []]


def test_a_past_end_cannot_be_undone(kb, clock):
    """C9, T5: an object that is added again at the time of its end has lost its facts."""
    kb.add("(open wp0)")
    kb.add(END, initial_time=START + 10)
    clock.set(START + 10)
    kb.add("wp0 - place")
    assert "wp0 - place" in instances(kb, START + 10)
    assert facts(kb, START + 10) == facts(kb, START + 20) == []


def test_cancelling_a_scheduled_start_cancels_scheduled_mentions(kb):
    """C9: no assertion mentions an object that does not exist."""
    kb.add("box - item", "(tagged box)", initial_time=START + 10)
    kb.add("(not (tagged box))", initial_time=START + 20)
    kb.remove("box - item", initial_time=START + 10)
    assert scheduled(kb) == []
    assert [a.cancelled is not None for a in kb.history("(tagged box)")] == [True, True]


def test_an_object_may_exist_only_for_a_while(kb):
    """C9: scheduled start, scheduled end, and a fact in between."""
    kb.add("box - item", "(tagged box)", initial_time=START + 10)
    kb.add("(not (box - item))", initial_time=START + 20)
    assert [facts(kb, START + at) for at in (9, 10, 19, 20)] == [[], ["(tagged box)"], ["(tagged box)"], []]


# -- C10 ----------------------------------------------------------------------------------------------------------


def test_goals_are_asked_like_the_state(kb, clock):
    """C10: at any time; goals are not facts."""
    kb.add_goal("(open wp0)", "(not (raining))", "(> (battery kenny) 20)")
    clock.set(START + 10)
    kb.remove_goal("(open wp0)")
    assert texts(kb.goals()) == ["(> (battery kenny) 20)", "(not (raining))"]
    assert texts(kb.goals(at=START + 9)) == ["(> (battery kenny) 20)", "(not (raining))", "(open wp0)"]
    assert kb.goals(at=START - 1) == []
    assert facts(kb) == []


def test_adding_a_current_goal_again_changes_nothing(kb):
    """C10: as for the state (C2)."""
    kb.add_goal("(open wp0)")
    assert kb.add_goal("(open wp0)").changes == 0
    assert kb.add_goal("(not (open wp0))").changes == 1
    assert texts(kb.goals()) == ["(not (open wp0))"]


def test_a_fact_and_a_goal_of_the_same_text_are_independent(kb):
    """C10: they are on separate timelines."""
    kb.add("(open wp0)")
    kb.add_goal("(open wp0)")
    kb.remove("(open wp0)")
    assert texts(kb.goals()) == ["(open wp0)"]
    kb.add("(open wp0)")
    kb.remove_goal("(open ?)")
    assert (kb.goals(), facts(kb)) == ([], ["(open wp0)"])


def test_a_conjunction_is_split_into_its_parts(kb):
    """C10: nested conjunctions, too."""
    kb.add_goal("(and (open wp0) (and (not (raining)) (> (battery kenny) 20)))")
    assert texts(kb.goals()) == ["(> (battery kenny) 20)", "(not (raining))", "(open wp0)"]


def test_a_goal_of_another_form_is_kept_as_a_condition(kb):
    """C10: it is recorded as PDDL text, and listed with the others."""
    kb.add_goal("(and (open wp0) (or (open wp1) (raining)) (forall (?r - room) (clean ?r)))")
    assert texts(kb.goals()) == ["(forall (?r - room) (clean ?r))", "(open wp0)", "(or (open wp1) (raining))"]
    kb.remove("wp1")
    assert texts(kb.goals()) == ["(forall (?r - room) (clean ?r))", "(open wp0)"]


def test_a_goal_can_be_scheduled(kb):
    """C10, Q1: it is not in the timed knowledge."""
    kb.add_goal("(open wp0)", initial_time=START + 10)
    assert kb.goals() == []
    assert texts(kb.goals(at=START + 10)) == ["(open wp0)"]
    assert scheduled(kb) == []
    kb.remove_goal("(open wp0)", initial_time=START + 10)
    assert kb.goals(at=START + 10) == []


@pytest.mark.parametrize(
    "goal", ["(open nowhere)", "(open kenny)", "(flying kenny)", "(> (speed kenny) 1)", "(near kenny)"]
)
def test_goals_are_checked_against_the_domain(kb, goal):
    """C10, D1: as all knowledge is."""
    with pytest.raises(kbstore.InvalidKnowledge):
        kb.add_goal("(raining)", goal)
    assert kb.goals() == []


# -- C12 ----------------------------------------------------------------------------------------------------------


def test_clear_ends_and_cancels_everything_in_one_transaction(kb, clock):
    """C12: history remains."""
    kb.add("(open wp0)", "(not (raining))", "(= (battery kenny) 5)", "(> (cost) 1)", "minimize (cost)")
    latest = kb.add_goal("(open wp1)")
    kb.add("(raining)", "box - item", initial_time=START + seconds(10))
    clock.set(START + seconds(5))
    before = picture(kb)
    cleared = kb.clear()
    assert cleared.number == latest.number + 2
    for at in (cleared.time, START + seconds(20)):
        state = kb.state(at)
        parts = (state.instances, state.facts, state.functions, state.inequalities, state.goals, state.timed_knowledge)
        assert parts == ([], [], [], [], [], [])
        assert state.metric is None
    assert {**picture(kb, START + seconds(5) - 1), "timed_knowledge": None} == {**before, "timed_knowledge": None}
    assert intervals(kb, "(open wp0)") == [("(open wp0)", START, START + seconds(5), False)]
    assert kb.history("box - item")[0].cancelled.number == cleared.number


def test_clearing_twice_changes_nothing(kb):
    """C12, C1: a cleared state stays empty; the domain is kept."""
    cleared = kb.clear()
    assert (kb.clear().number, kb.clear().changes) == (cleared.number, 0)
    kb.add("kenny - robot")
    with pytest.raises(kbstore.InvalidKnowledge):
        kb.add("(flying kenny)")
