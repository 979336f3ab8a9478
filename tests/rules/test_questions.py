"""Rules Q1 to Q3, Q5 to Q7: questions over time."""

import threading

import pytest

import kbstore
from kbstore import seconds
from tests.conftest import START
from tests.rules.reading import facts, intervals, picture, scheduled, texts

# -- Q1 -----------------------------------------------------------------------------------------------------------


def test_a_state_has_everything_that_holds(kb):
    """Q1: objects, facts of both signs, functions, inequalities, metric, goals, and timed knowledge."""
    kb.add("(open wp0)", "(not (raining))", "(= (battery kenny) 80)", "(> (cost) 3)", "maximize (cost)")
    kb.add_goal("(open wp1)")
    kb.add("(raining)", initial_time=START + 10)
    state = kb.state()
    assert state.at == START
    assert texts(state.instances) == [
        "cup - item",
        "galley - kitchen",
        "hall - room",
        "kenny - robot",
        "wp0 - place",
        "wp1 - place",
    ]
    assert texts(state.facts) == ["(not (raining))", "(open wp0)"]
    assert texts(state.functions) == ["(= (battery kenny) 80)"]
    assert texts(state.inequalities) == ["(> (cost) 3)"]
    assert str(state.metric) == "maximize (cost)"
    assert texts(state.goals) == ["(open wp1)"]
    assert [(item.initial_time, str(item)) for item in state.timed_knowledge] == [(START + 10, "(raining)")]
    assert state.domain.name == "rooms"


def test_before_the_first_transaction_the_state_is_empty(kb):
    """Q1: nothing holds and nothing is scheduled."""
    nothing = kb.state(START - 1)
    assert (nothing.instances, nothing.facts, nothing.functions, nothing.timed_knowledge) == ([], [], [], [])
    assert nothing.metric is None
    assert nothing.domain is None


def test_timed_knowledge_is_recorded_and_not_cancelled_at_the_time(kb, clock):
    """Q1, T5: later recordings and cancellations do not change it."""
    kb.add("(raining)", initial_time=START + 100)
    clock.set(START + 10)
    kb.add("(open wp0)", initial_time=START + 90)
    clock.set(START + 20)
    kb.remove("(raining)", initial_time=START + 100)
    seen = {at: scheduled(kb, START + at) for at in (0, 9, 10, 19, 20, 89, 90, 100)}
    rain, door = (START + 100, "(raining)"), (START + 90, "(open wp0)")
    assert seen == {0: [rain], 9: [rain], 10: [door, rain], 19: [door, rain], 20: [door], 89: [door], 90: [], 100: []}


def test_the_narrower_questions_agree_with_the_state(kb, clock):
    """Q1: instances, propositions, functions, timed knowledge, goals and metric, at any time."""
    kb.add("(open wp0)", "(near kenny wp0)", "(= (battery kenny) 80)", "(= (cost) 1)", "minimize (cost)")
    kb.add("(open wp1)", "(= (cost) 7)", initial_time=START + 10)
    kb.add_goal("(open wp1)")
    clock.set(START + 20)
    kb.clear()
    for at in (START - 1, START, START + 9, START + 10, START + 20):
        state = kb.state(at)
        assert texts(kb.instances(at=at)) == texts(state.instances)
        assert texts(kb.propositions(at=at)) == texts(state.facts)
        assert texts(kb.functions(at=at)) == texts(state.functions)
        assert texts(kb.timed_knowledge(at=at)) == texts(state.timed_knowledge)
        assert texts(kb.goals(at=at)) == texts(state.goals)
        assert str(kb.metric(at=at)) == str(state.metric)
    assert texts(kb.propositions("open", at=START + 10)) == ["(open wp0)", "(open wp1)"]
    assert texts(kb.functions("cost", at=START + 10)) == ["(= (cost) 7)"]
    assert texts(kb.timed_knowledge("open", at=START)) == ["(open wp1)"]


@pytest.mark.parametrize(
    ("ask", "unknown"),
    [("propositions", "battery"), ("functions", "open"), ("timed_knowledge", "flying"), ("instances", "dragon")],
)
def test_listing_an_unknown_symbol_is_refused(kb, ask, unknown):
    """V8: whether or not there is anything to list."""
    with pytest.raises(kbstore.UnknownSymbol, match=unknown):
        getattr(kb, ask)(unknown)


def test_instances_of_a_type(kb):
    """C8: of exactly the type, or with its subtypes; constants where asked for."""
    assert texts(kb.instances("place")) == ["wp0 - place", "wp1 - place"]
    assert texts(kb.instances("room", include_subtypes=True)) == ["galley - kitchen", "hall - room"]
    assert texts(kb.instances("place", include_constants=True)) == ["home - place", "wp0 - place", "wp1 - place"]
    with pytest.raises(kbstore.UnknownSymbol):
        kb.instances("dragon")


# -- Q2 -----------------------------------------------------------------------------------------------------------


def test_a_belief_uses_only_what_was_known_then(kb, clock):
    """Q2: recorded by T, and not cancelled by T."""
    kb.add("(raining)", initial_time=START + 100)
    clock.set(START + 10)
    kb.remove("(raining)", initial_time=START + 100)
    kb.add("(open wp0)", initial_time=START + 50)
    assert facts(kb, START + 100, as_of=START + 9) == ["(raining)"]
    assert facts(kb, START + 100, as_of=START + 10) == ["(open wp0)"]
    assert facts(kb, START + 100) == ["(open wp0)"]


def test_a_belief_expects_the_state_to_continue(kb, clock):
    """Q2: later removals, changes of sign, of numbers and of objects were not known then."""
    kb.add("(open wp0)", "(= (battery kenny) 80)", "(near kenny wp0)")
    clock.set(START + 10)
    kb.remove("(open wp0)")
    kb.add("(= (battery kenny) 20)", "box - item", "(not (near kenny wp0))")
    before = picture(kb, START + 5)
    assert picture(kb, START + 500, as_of=START + 9) == before
    assert facts(kb, START + 500) == ["(not (near kenny wp0))"]


def test_a_belief_includes_scheduled_ends(kb, clock):
    """Q2, C9: except those that were cancelled by then."""
    kb.add("(open wp0)")
    kb.add("(not (wp0 - place))", initial_time=START + 100)
    clock.set(START + 10)
    kb.remove("(not (wp0 - place))", initial_time=START + 100)
    assert facts(kb, START + 200, as_of=START + 5) == []
    assert facts(kb, START + 200, as_of=START + 10) == ["(open wp0)"]
    assert facts(kb, START + 200) == ["(open wp0)"]


def test_a_belief_about_the_past_equals_the_state(kb, clock):
    """Q2: for t < T it equals state(t)."""
    kb.add("(open wp0)")
    kb.add("(raining)", initial_time=START + 30)
    clock.set(START + 20)
    kb.remove("(open wp0)")
    kb.remove("(raining)", initial_time=START + 30)
    for at in (START - 1, START, START + 10, START + 19):
        assert picture(kb, at, as_of=START + 20) == picture(kb, at)
        assert picture(kb, at, as_of=at + 1) == picture(kb, at)


def test_timed_knowledge_of_a_belief_is_that_of_the_earlier_time(kb, clock):
    """Q2: recorded by the earlier of t and T, taking effect after t."""
    kb.add("(raining)", initial_time=START + 100)
    clock.set(START + 10)
    kb.add("(open wp0)", initial_time=START + 90)
    assert scheduled(kb, START + 50, as_of=START + 9) == [(START + 100, "(raining)")]
    assert scheduled(kb, START + 5, as_of=START + 50) == [(START + 100, "(raining)")]
    assert scheduled(kb, START + 95, as_of=START + 50) == [(START + 100, "(raining)")]
    assert scheduled(kb, START + 50, as_of=START + 50) == [(START + 90, "(open wp0)"), (START + 100, "(raining)")]


def test_a_belief_after_a_transaction_leaves_out_later_ones_of_the_same_time(kb):
    """Q2: `as_of` takes a `Transaction`."""
    first = kb.add("(open wp0)")
    second = kb.add("(open wp1)", "(not (open wp0))")
    kb.add("(raining)", initial_time=START + 10)
    assert facts(kb, START, as_of=first) == ["(open wp0)"]
    assert facts(kb, START, as_of=second) == ["(not (open wp0))", "(open wp1)"]
    assert facts(kb, START + 10, as_of=first) == ["(open wp0)"]
    assert scheduled(kb, START, as_of=second) == []
    assert facts(kb, START, as_of=START) == ["(not (open wp0))", "(open wp1)"]


def test_every_question_takes_as_of(kb, clock):
    """Q2: holds, truth, value and explain agree with the state."""
    added = kb.add("(open wp0)", "(= (cost) 1)")
    clock.set(START + 10)
    kb.remove("(open wp0)", "(cost)")
    at, then = START + 20, START + 5
    assert kb.holds("(open wp0)", at=at, as_of=then)
    assert kb.truth("(open wp0)", at=at, as_of=added) is kbstore.Truth.TRUE
    assert kb.value("(cost)", at=at, as_of=then) == 1
    assert kb.explain("(open wp0)", at=at, as_of=then).transaction.number == added.number
    with pytest.raises(kbstore.UndefinedFunction):
        kb.value("(cost)", at=at)


# -- Q3 -----------------------------------------------------------------------------------------------------------


def test_a_history_lists_every_assertion_with_its_interval(kb, clock):
    """Q3: in order of time, with the transactions that recorded and ended it."""
    first = kb.add("(near kenny wp0)", client="drive")
    clock.set(START + 10)
    with kb.transaction(client="drive") as tx:
        tx.remove("(near kenny wp0)")
        tx.add("(near kenny wp1)")
    clock.set(START + 20)
    kb.add("(not (near kenny wp0))")
    assert intervals(kb, "(near kenny ?)") == [
        ("(near kenny wp0)", START, START + 10, False),
        ("(near kenny wp1)", START + 10, None, False),
        ("(not (near kenny wp0))", START + 20, None, False),
    ]
    one, two, three = kb.history("(near kenny ?)")
    assert (one.recorded.number, one.ended.number) == (first.number, tx.result.number)
    assert (two.recorded.number, two.ended, two.cancelled) == (tx.result.number, None, None)
    assert (three.item.is_negative, three.ended) == (True, None)


def test_a_history_of_numbers_has_their_values(kb, clock):
    """Q3: the value at the start of the interval, and the rate."""
    kb.add("(= (battery kenny) 80)")
    clock.set(START + seconds(10))
    kb.add("(increase (battery kenny) (* #t -2))")
    clock.set(START + seconds(20))
    kb.add("(increase (battery kenny) 5)")
    numbers = [(a.item.function_value, a.item.rate) for a in kb.history("(battery kenny)")]
    assert numbers == [(80, 0), (80, -2), (65, -2)]


def test_cancelled_assertions_are_listed_and_marked(kb):
    """Q3: they have no length."""
    kb.add("(raining)", initial_time=START + 10)
    kb.remove("(raining)", initial_time=START + 10)
    kb.add("(raining)", initial_time=START + 20)
    assert intervals(kb, "(raining)") == [
        ("(raining)", START + 10, START + 10, True),
        ("(raining)", START + 20, None, False),
    ]


def test_assertions_of_no_length_are_listed_in_order_of_recording(kb):
    """Q3: of several transactions at one time."""
    for value in (3, 1, 2):
        kb.add(f"(= (cost) {value})")
    assert intervals(kb, "(cost)") == [
        ("(= (cost) 3)", START, START, False),
        ("(= (cost) 1)", START, START, False),
        ("(= (cost) 2)", START, None, False),
    ]


def test_a_history_can_be_limited_to_a_span(kb, clock):
    """Q3: it lists the assertions that overlap the span."""
    for step, value in enumerate((0, 1, 2, 3)):
        clock.set(START + 10 * step)
        kb.add(f"(= (cost) {value})")
    values = [a.item.function_value for a in kb.history("(cost)", since=START + 12, until=START + 28)]
    assert values == [1, 2]


def test_a_history_of_objects(kb, clock):
    """Q3: an object's existences; scheduled ends are assertions of their own."""
    kb.add("(not (wp0 - place))", initial_time=START + 10)
    kb.add("wp0 - place", initial_time=START + 20)
    assert intervals(kb, "wp0 - place") == [
        ("wp0 - place", START, START + 10, False),
        ("(not (wp0 - place))", START + 10, START + 20, False),
        ("wp0 - place", START + 20, None, False),
    ]


def test_a_future_end_names_the_transaction_that_scheduled_it(kb):
    """Q3: also where the next assertion or the end of an object causes it."""
    kb.add("(raining)", "(open wp0)")
    later = kb.add("(not (raining))", "(not (wp0 - place))", initial_time=START + 10)
    for pattern in ("(raining)", "(open wp0)"):
        first = kb.history(pattern)[0]
        assert (first.end_time, first.ended.number, first.cancelled) == (START + 10, later.number, None)


def test_a_history_of_everything(kb, clock):
    """Q3: without a pattern it lists all kinds of items of the state by time, without goals; also with `as_of`."""
    kb.add_goal("(open wp1)")
    first = kb.add("(open wp0)", "(= (battery kenny) 80)", "(> (cost) 3)", "maximize (cost)")
    clock.advance(seconds(1))
    kb.remove("(open wp0)")
    kb.add("(raining)", initial_time="+1s")
    listed = [(str(found.item), found.initial_time - START, found.end_time) for found in kb.history()]
    assert sorted(listed[:-1], key=str) == [
        ("(= (battery kenny) 80)", 0, None),
        ("(> (cost) 3)", 0, None),
        ("(open wp0)", 0, START + seconds(1)),
        *((item, 0, None) for item in ("cup - item", "galley - kitchen", "hall - room", "kenny - robot")),
        ("maximize (cost)", 0, None),
        *((item, 0, None) for item in ("wp0 - place", "wp1 - place")),
    ]
    assert listed[-1] == ("(raining)", seconds(2), None)
    assert ("(open wp0)", None) in [(str(found.item), found.end_time) for found in kb.history(as_of=first)]
    assert [str(found.item) for found in kb.history(since=START + seconds(2))].count("(open wp0)") == 0


def test_the_transactions_of_a_span(kb, clock):
    """Q6: those of ``[since, until)`` in order; with `as_of`, those that were committed by then."""
    for number in range(3, 6):
        clock.advance(seconds(1))
        added = kb.add(f"wp{number} - place", client="mapper", note=f"room {number}")
        assert added.number == number
    assert [tx.number for tx in kb.transactions()] == [1, 2, 3, 4, 5]
    assert kb.transactions()[-1] == added
    assert [tx.number for tx in kb.transactions(START + seconds(1), START + seconds(3))] == [3, 4]
    assert [tx.number for tx in kb.transactions(as_of=START + seconds(2))] == [1, 2, 3, 4]
    assert [tx.number for tx in kb.transactions(START, as_of=kb.transactions()[1])] == [1, 2]
    assert kb.transactions("+1s") == []


def test_a_history_of_an_unknown_symbol_is_refused(kb):
    """Q3, V8: an unknown symbol is an error; an unknown object has an empty history."""
    with pytest.raises(kbstore.UnknownSymbol, match="flying"):
        kb.history("(flying ?)")
    assert kb.history("(near nobody ?)") == []


# -- Q5 -----------------------------------------------------------------------------------------------------------


def test_a_difference_lists_what_became_true_false_and_was_withdrawn(kb, clock):
    """Q5: facts and objects, compared by what was asserted."""
    kb.add("(open wp0)", "(not (raining))", "(near kenny wp0)")
    clock.set(START + 10)
    kb.remove("(not (raining))", "cup")
    kb.add("(not (open wp0))", "(not (open wp1))", "(near kenny wp1)", "box - item")
    kb.remove("(near kenny wp0)")
    difference = kb.diff(START, START + 10)
    assert texts(difference.became_true) == ["(near kenny wp1)", "box - item"]
    assert texts(difference.became_false) == ["(not (open wp0))", "(not (open wp1))"]
    assert texts(difference.withdrawn) == ["(near kenny wp0)", "(not (raining))", "cup - item"]


def test_a_difference_of_numbers_metric_and_goals(kb, clock):
    """Q5: old and new value, None where undefined; numbers with a rate have changed, too."""
    kb.add(
        "(= (battery kenny) 80)",
        "(= (distance wp0 wp1) 5)",
        kbstore.Function(attribute_name="cost", function_value=1, rate=2),
    )
    kb.add_goal("(open wp0)")
    clock.set(START + seconds(10))
    kb.remove("(battery kenny)")
    kb.add("(= (distance wp1 wp0) 6)", "minimize (cost)")
    kb.remove_goal("(open wp0)")
    kb.add_goal("(open wp1)")
    difference = kb.diff(START, START + seconds(10))
    numbers = sorted((function.key, before, after) for function, before, after in difference.numbers)
    assert numbers == [
        (("battery", "kenny"), 80, None),
        (("cost",), 1, 21),
        (("distance", "wp1", "wp0"), None, 6),
    ]
    assert texts(difference.goals_added) == ["(open wp1)"]
    assert texts(difference.goals_removed) == ["(open wp0)"]
    assert [difference.metric[0], str(difference.metric[1])] == [None, "minimize (cost)"]


def test_an_object_with_another_type_was_withdrawn_and_became_true(kb, clock):
    """Q5: comparing names alone would miss it."""
    clock.set(START + 10)
    kb.remove("wp0")
    clock.set(START + 20)
    kb.add("wp0 - robot")
    difference = kb.diff(START, START + 20)
    assert texts(difference.became_true) == ["wp0 - robot"]
    assert texts(difference.withdrawn) == ["wp0 - place"]


def test_a_time_does_not_differ_from_itself(kb):
    """Q5: nor do two times where something began and ended in between."""
    kb.add("(open wp0)")
    empty = kb.diff(START, START)
    assert (empty.became_true, empty.became_false, empty.withdrawn, empty.numbers) == ([], [], [], [])
    assert empty.metric is None


# -- Q6 -----------------------------------------------------------------------------------------------------------


def test_changes_gives_each_transaction_once_in_order(kb, clock):
    """Q6: numbers begin at 1 without gaps; refused and empty transactions have none."""
    kb.add("(raining)")
    kb.add("(raining)")
    with pytest.raises(kbstore.InvalidKnowledge):
        kb.add("(flying kenny)")
    clock.set(START + 10)
    last = kb.remove("(raining)")
    changes = list(kb.changes())
    assert [change.number for change in changes] == [1, 2, 3, 4]
    assert [change.transaction.time for change in changes] == [START, START, START, START + 10]
    assert last.number == 4
    assert [change.number for change in kb.changes(after=2)] == [3, 4]
    assert list(kb.changes(after=4)) == []


def test_a_change_has_everything_it_asserted_ended_and_cancelled(kb, clock):
    """Q6: objects, facts, functions and goals."""
    kb.add("(open wp0)", "(= (cost) 1)")
    kb.add("(near kenny wp0)", initial_time=START + 50)
    clock.set(START + 10)
    with kb.transaction() as tx:
        tx.remove("wp0")
        tx.add("(= (cost) 2)", "(raining)")
        tx.add_goal("(open wp1)")
        tx.add("(open wp1)", initial_time=START + 90)
    (change,) = kb.changes(after=tx.result.number - 1)
    assert texts(a.item for a in change.asserted) == ["(= (cost) 2)", "(open wp1)", "(open wp1)", "(raining)"]
    assert texts(a.item for a in change.ended) == ["(= (cost) 1)", "(open wp0)", "wp0 - place"]
    assert texts(a.item for a in change.cancelled) == ["(near kenny wp0)"]
    assert tx.result.changes == 7


def test_changes_of_many_writers(open_kb, store_url, clock, tmp_path):
    """Q6: each transaction once, in commit order, with any number of writers."""
    if store_url == "sqlite://":
        store_url = f"sqlite:///{tmp_path / 'writers.db'}"
    name = f"writers-{tmp_path.name}"

    def write(writer):
        with kbstore.open(store_url, name, clock=clock) as kb:
            for step in range(5):
                kb.add(f"(p{writer} x{step})", client=f"writer {writer}")

    with kbstore.open(store_url, name, clock=clock) as kb:
        threads = [threading.Thread(target=write, args=(writer,)) for writer in range(3)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        changes = list(kb.changes())
    assert [change.number for change in changes] == list(range(1, 16))
    asserted = [(change.transaction.client, texts(a.item for a in change.asserted)) for change in changes]
    assert sorted(asserted) == sorted(
        (f"writer {writer}", [f"(p{writer} x{step})"]) for writer in range(3) for step in range(5)
    )


# -- a store that is closed ---------------------------------------------------------------------------------------


def test_a_closed_knowledge_base_refuses_every_call(kb):
    """Q1: after `close`, every question and update is an error."""
    kb.close()
    for use in (
        kb.state,
        lambda: kb.add("(raining)"),
        lambda: kb.holds("(raining)"),
        lambda: kb.history("(raining)"),
    ):
        with pytest.raises(kbstore.StoreUnavailable, match="closed"):
            use()


def test_writes_are_there_after_reopening(open_kb, store_url, clock, tmp_path):
    """Q1: a second opening gives the same answers."""
    if store_url == "sqlite://":
        store_url = f"sqlite:///{tmp_path / 'again.db'}"
    name = f"again-{tmp_path.name}"
    with kbstore.open(store_url, name, clock=clock) as kb:
        kb.add("kenny - robot", "(near kenny wp0)", "(= (battery kenny) 0.1)")
        kb.add("(raining)", initial_time=START + 10)
        before = picture(kb)
    with kbstore.open(store_url, name, clock=clock) as kb:
        assert picture(kb) == before
        assert kb.value("(battery kenny)") == 0.1
        assert name in kbstore.knowledge_bases(store_url)


def test_a_baseline_and_the_changes_after_it_are_the_history(open_kb, clock):
    """Q6: what is over by then is in neither."""
    kb = open_kb()
    kb.add("(open hall)", "(open lab)")
    clock.advance(seconds(10))
    kb.remove("(open lab)")
    clock.advance(seconds(10))
    kb.add("(open den)")
    base = kb.baseline(clock.now() - seconds(5))
    assert (base.number, base.time) == (2, clock.now() - seconds(5))
    assert [str(found.item) for found in base.assertions] == ["(open hall)"]
    later = [found for change in kb.changes(base.number) for found in change.asserted]
    assert [str(found.item) for found in later] == ["(open den)"]
    assert kb.baseline().assertions == []
    assert kb.baseline(most=1).number == 2
