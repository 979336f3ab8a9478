"""Rules C1 to C8 and C11: the effect of each write on its timelines."""

from contextlib import suppress

import pytest

import kbstore
from kbstore import AssignOp, Fact, Function, Instance, UpdateType, seconds
from tests.conftest import START
from tests.rules.reading import facts, instances, intervals, picture, scheduled, texts

ADD, REMOVE = UpdateType.ADD_KNOWLEDGE, UpdateType.REMOVE_KNOWLEDGE


def item(text):
    return kbstore.item(text)


# -- C1 -----------------------------------------------------------------------------------------------------------


def test_a_transaction_is_all_or_nothing(kb):
    """C1: if one item is invalid, nothing of the transaction is stored."""
    before = picture(kb)
    with pytest.raises(kbstore.InvalidKnowledge):
        kb.update([(ADD, item("(raining)")), (REMOVE, item("wp0 - place")), (ADD, item("(open nowhere)"))])
    assert picture(kb) == before


def test_another_block_with_a_transaction_that_stored_nothing(bare):
    """C1: it sees and stores its own updates, and nothing of those that were rolled back."""
    tx = bare.transaction()
    text = "(define (domain d) (:predicates (p) (q)))"

    def begin_and_fail():
        with tx:
            tx.load(text, once=True)
            tx.add("(p)")
            tx.load("(define (domain e)")

    def load_half_of_a_domain():
        with tx:
            tx.add("(p)")
            assert tx.holds("(p)")
            with suppress(kbstore.PddlSyntaxError):
                tx.load("(define (domain e)")

    with pytest.raises(kbstore.PddlSyntaxError):
        begin_and_fail()
    with tx:
        tx.load(text, once=True)
        assert texts(tx.state().facts) == []
    assert tx.result.changes == 1
    assert bare.domain.name == "d"
    with pytest.raises(kbstore.InvalidKnowledge, match="half-way"):
        load_half_of_a_domain()
    assert not hasattr(tx, "result")
    with tx:
        assert texts(tx.state().facts) == []
        tx.add("(q)")
        assert texts(tx.state().facts) == ["(q)"]
    assert facts(bare) == ["(q)"]


def test_updates_apply_in_their_order(kb):
    """C1: later updates see earlier ones."""
    kb.update([(ADD, item("(= (cost) 2)")), (ADD, item("(increase (cost) 3)")), (ADD, item("(scale-up (cost) 4)"))])
    assert kb.value("(cost)") == 20
    kb.update([(REMOVE, item("(raining)")), (ADD, item("(raining)"))])
    assert facts(kb) == ["(raining)"]


def test_only_the_last_update_of_a_timeline_is_recorded(kb):
    """C1: of several updates of one timeline for one time, the last is recorded."""
    kb.update([(ADD, item(f"(= (cost) {value})")) for value in (1, 2, 3)])
    assert [str(a.item) for a in kb.history("(cost)")] == ["(= (cost) 3)"]


def test_the_last_update_for_each_scheduled_time_is_recorded(kb):
    """C1: of several updates that one transaction schedules for one time, the last is recorded."""
    with kb.transaction() as tx:
        tx.add("(raining)", initial_time=START + 10)
        tx.add("(not (raining))", initial_time=START + 10)
        tx.add("(raining)", initial_time=START + 20)
        tx.remove("(raining)", initial_time=START + 20)
    assert intervals(kb, "(raining)") == [("(not (raining))", START + 10, None, False)]


@pytest.mark.parametrize(
    "steps",
    [
        [("add", "(raining)"), ("remove", "(raining)")],
        [("remove", "(open wp0)"), ("add", "(open wp0)")],
        [("add", "(not (open wp0))"), ("add", "(open wp0)")],
        [("add", "(increase (battery kenny) 1)"), ("add", "(decrease (battery kenny) 1)")],
        [("add", "box - item"), ("remove", "box")],
        [("remove", "wp1"), ("add", "wp1 - place")],
        [("remove", "wp0"), ("add", "wp0 - place"), ("add", "(open wp0)")],
        [("remove", "(open wp1)"), ("remove", "(near kenny ?)")],
    ],
)
def test_a_transaction_that_changes_nothing_is_not_recorded(kb, steps):
    """C1: it takes no number, and returns the latest number and `changes` 0."""
    latest = kb.add("(open wp0)", "(= (battery kenny) 5)")
    with kb.transaction() as tx:
        for method, text in steps:
            getattr(tx, method)(text)
    assert tx.result.number == latest.number
    assert tx.result.changes == 0
    assert [change.number for change in kb.changes()] == list(range(1, latest.number + 1))
    assert [len(kb.history(pattern)) for pattern in ("(open ?)", "(battery ?)")] == [1, 1]


def test_an_object_removed_and_added_again_has_lost_its_facts(kb, clock):
    """C1: the object itself continues; its facts end, unless they are added again with the same value."""
    kb.add("(open wp0)", "(near kenny wp0)")
    clock.set(START + 10)
    with kb.transaction() as tx:
        tx.remove("wp0")
        tx.add("wp0 - place", "(open wp0)")
    assert tx.result.changes == 1
    assert facts(kb) == ["(open wp0)"]
    assert intervals(kb, "(open wp0)") == [("(open wp0)", START, None, False)]
    assert intervals(kb, "(near kenny wp0)") == [("(near kenny wp0)", START, START + 10, False)]
    assert intervals(kb, "wp0 - place") == [("wp0 - place", START, None, False)]


def test_changes_counts_the_timelines_that_changed(kb):
    """C1: `changes` is the number of timelines that changed; without a transaction the number is 0."""
    assert kb.add("(raining)", "(open wp0)", "(open wp1)").changes == 3
    assert kb.add("(raining)", "(not (open wp0))").changes == 1
    assert kb.remove("(open ?)").changes == 1


def test_an_empty_knowledge_base_returns_number_zero(bare):
    """C1: numbers begin at 1, so 0 means that nothing is recorded."""
    nothing = bare.remove("(p a)")
    assert (nothing.number, nothing.changes) == (0, 0)
    assert bare.add("(p a)").number == 1


def test_a_transaction_carries_its_client_and_note(kb):
    """C1: client and note are recorded with the transaction."""
    transaction = kb.add("(raining)", client="weather", note="hourly")
    assert (transaction.client, transaction.note, transaction.time) == ("weather", "hourly", START)
    (assertion,) = kb.history("(raining)")
    assert (assertion.recorded.client, assertion.recorded.note) == ("weather", "hourly")


def test_leaving_a_transaction_by_an_exception_stores_nothing(kb):
    """C1: the block sees its own writes; an exception rolls them back."""
    before = picture(kb)

    def changing_my_mind():
        with kb.transaction() as tx:
            tx.add("(raining)")
            assert tx.state().holds("(raining)")
            raise RuntimeError("changed my mind")

    with pytest.raises(RuntimeError, match="changed my mind"):
        changing_my_mind()
    assert picture(kb) == before
    kb.add("(open wp0)")
    assert facts(kb) == ["(open wp0)"]


def test_writing_through_the_knowledge_base_inside_a_transaction_is_an_error(kb):
    """C1: it would wait for the lock that its own thread holds."""
    with pytest.raises(Exception, match=r"transaction"), kb.transaction():
        kb.add("(raining)")
    assert facts(kb) == []


@pytest.mark.parametrize(
    "act",
    [
        lambda tx: tx.add("(open wp0)"),
        lambda tx: tx.remove("(open wp1)"),
        lambda tx: tx.update([]),
        lambda tx: tx.replace(),
        lambda tx: tx.remove_metric(),
        lambda tx: tx.apply("relight"),
        lambda tx: tx.clear(),
        lambda tx: tx.load(None),
        lambda tx: tx.set_sensed("open", True),
        lambda tx: tx.abort(None),
        lambda tx: tx.state(),
    ],
    ids=[
        "add",
        "remove",
        "update",
        "replace",
        "remove_metric",
        "apply",
        "clear",
        "load",
        "set_sensed",
        "abort",
        "state",
    ],
)
def test_a_transaction_refuses_updates_outside_its_block(kb, act):
    """C1: before and after the block an update would be lost silently."""
    kb.add("(open wp1)")
    before = facts(kb)
    with kb.transaction() as left:
        pass
    with pytest.raises(ZeroDivisionError), kb.transaction() as failed:
        failed.add(str(1 / 0))
    for tx in (kb.transaction(), left, failed):
        with pytest.raises(kbstore.Conflict, match=r"with kb.transaction\(\) as"):
            act(tx)
    assert facts(kb) == before
    assert not kb.domain.is_sensed("open")


def test_expect_refuses_if_another_transaction_came_between(kb):
    """C1: optimistic locking: the expected transaction must be the latest, or it is a `Conflict`."""
    seen = kb.add("(raining)")
    with kb.transaction(expect=seen.number) as tx:
        tx.add("(open wp0)")
    with pytest.raises(kbstore.Conflict), kb.transaction(expect=seen.number) as late:
        late.add("(open wp1)")
    assert facts(kb) == ["(open wp0)", "(raining)"]


# -- C2 -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "text",
    ["(open wp0)", "(not (open wp1))", "(= (battery kenny) 5)", "wp0 - place", "(> (cost) 3)", "minimize (cost)"],
)
def test_adding_the_current_value_changes_nothing(kb, clock, text):
    """C2: adding the same value for now keeps the assertion and its initial time."""
    first = kb.add("(open wp0)", "(not (open wp1))", "(= (battery kenny) 5)", "(> (cost) 3)", "minimize (cost)")
    clock.set(START + 10)
    again = kb.add(text)
    assert (again.number, again.changes) == (first.number, 0)


def test_assigning_the_value_that_a_moving_function_has_reached_changes_nothing(kb, clock):
    """C2: value at now and rate are equal."""
    kb.add(Function(attribute_name="battery", values=["kenny"], function_value=10, rate=2))
    clock.set(START + seconds(3))
    assert kb.add(Function(attribute_name="battery", values=["kenny"], function_value=16, rate=2)).changes == 0
    assert kb.add(Function(attribute_name="battery", values=["kenny"], function_value=10, rate=2)).changes == 1
    assert kb.add("(= (battery kenny) 10)").changes == 1
    assert kb.add("(= (battery kenny) 10)").changes == 0


def test_scheduling_an_assertion_again_changes_nothing(kb, clock):
    """C2: with the same value, for the same time."""
    first = kb.add("(raining)", "(= (cost) 3)", "box - item", initial_time=START + 10)
    clock.set(START + 5)
    again = kb.add("(raining)", "(= (cost) 3)", "box - item", initial_time=START + 10)
    assert (again.number, again.changes) == (first.number, 0)
    assert kb.add("(raining)", initial_time=START + 11).changes == 1


def test_scheduling_the_current_value_is_recorded(kb, clock):
    """C2: it takes effect if the current assertion is removed before that time."""
    kb.add("(raining)")
    assert kb.add("(raining)", initial_time=START + 10).changes == 1
    clock.set(START + 5)
    kb.remove("(raining)")
    assert [facts(kb, START + at) for at in (4, 5, 9, 10)] == [["(raining)"], [], [], ["(raining)"]]


# -- C3 -----------------------------------------------------------------------------------------------------------


def test_a_change_of_sign_is_a_new_assertion_at_now(kb, clock):
    """C3: the timeline is the same, and the time of the change is recorded."""
    kb.add("(raining)")
    clock.set(START + 10)
    kb.add("(not (raining))")
    clock.set(START + 20)
    kb.add("(raining)")
    assert intervals(kb, "(raining)") == [
        ("(raining)", START, START + 10, False),
        ("(not (raining))", START + 10, START + 20, False),
        ("(raining)", START + 20, None, False),
    ]


# -- C4 -----------------------------------------------------------------------------------------------------------


def test_removing_a_fact_ends_the_current_assertion(kb, clock):
    """C4: the fact is absent from then on, and the transaction that ended it is recorded."""
    kb.add("(raining)")
    clock.set(START + 10)
    removal = kb.remove("(raining)")
    (assertion,) = kb.history("(raining)")
    assert (assertion.end_time, assertion.ended.number, assertion.cancelled) == (START + 10, removal.number, None)


def test_removing_a_fact_does_not_touch_its_explicit_negative(kb):
    """C4: the sign must match."""
    kb.add("(not (raining))", "(open wp0)")
    assert kb.remove("(raining)").changes == 0
    assert kb.remove("(not (open wp0))").changes == 0
    assert facts(kb) == ["(not (raining))", "(open wp0)"]
    assert kb.remove("(not (raining))").changes == 1


def test_a_removed_fact_is_absent_until_its_next_scheduled_assertion(kb, clock):
    """C4: scheduled assertions are left alone."""
    kb.add("(raining)")
    kb.add("(raining)", initial_time=START + 20)
    clock.set(START + 10)
    kb.remove("(raining)")
    assert scheduled(kb) == [(START + 20, "(raining)")]
    assert [facts(kb, START + at) for at in (9, 10, 19, 20)] == [["(raining)"], [], [], ["(raining)"]]


@pytest.mark.parametrize(
    ("pattern", "left"),
    [
        ("(near ? ?)", ["(open hall)"]),
        ("(near kenny ?)", ["(near robby hall)", "(open hall)"]),
        ("(near ?any hall)", ["(near kenny wp0)", "(open hall)"]),
        ("(near robby wp0)", ["(near kenny hall)", "(near kenny wp0)", "(near robby hall)", "(open hall)"]),
    ],
)
def test_a_pattern_removes_every_match(kb, pattern, left):
    """C4, V7: each wildcard argument matches any object."""
    kb.add("robby - robot", "(near kenny wp0)", "(near kenny hall)", "(near robby hall)", "(open hall)")
    kb.remove(pattern)
    assert facts(kb) == left


def test_removing_an_absent_fact_changes_nothing(kb):
    """C4: removing a fact that does not hold is no error, even where its objects do not exist."""
    latest = kb.add("(raining)")
    nothing = kb.remove("(open wp0)", "(near nobody nowhere)", "nobody", "(battery kenny)", "(battery nobody)")
    assert (nothing.number, nothing.changes) == (latest.number, 0)


@pytest.mark.parametrize(
    "pattern",
    [
        "(flying kenny)",
        "(open wp0 wp1)",
        "(near ?)",
        "(speed kenny)",
        Fact(attribute_name="near", values={"who": "kenny", "where": "wp0"}),
    ],
)
def test_symbol_arity_and_labels_of_a_removal_are_checked(kb, pattern):
    """C4: a removal that can never match is refused."""
    with pytest.raises(kbstore.KbStoreError):
        kb.remove(pattern)


def test_the_value_of_a_function_is_ignored_in_a_removal(kb):
    """C4: a removal ends the function at any value."""
    kb.add("(= (battery kenny) 5)", "(= (cost) 1)")
    kb.remove("(= (battery kenny) 77)")
    kb.remove(Function(attribute_name="cost"))
    assert kb.state().functions == []


def test_the_type_of_an_object_must_match_if_it_is_given(kb):
    """C4: where it does not match, nothing changes."""
    assert kb.remove("wp0 - robot").changes == 0
    assert "wp0 - place" in instances(kb)
    assert kb.remove("wp0 - place").changes == 1
    assert kb.remove(Instance(instance_name="wp1")).changes == 1
    assert not {"wp0 - place", "wp1 - place"} & set(instances(kb))


def test_the_text_of_the_metric_must_match_if_it_is_given(kb):
    """C4: where it does not match, nothing changes."""
    kb.add_metric("minimize (cost)")
    assert kb.remove_metric("minimize (total-time)").changes == 0
    assert str(kb.metric()) == "minimize (cost)"
    assert kb.remove_metric("minimize (cost)").changes == 1
    assert kb.metric() is None


@pytest.mark.parametrize("pattern", [Fact(), Function(), Fact(values=["wp0"])])
def test_a_pattern_without_a_name_is_refused(kb, pattern):
    """C4: `clear` is the way to remove everything."""
    kb.add("(open wp0)")
    with pytest.raises(kbstore.InvalidKnowledge, match="clear"):
        kb.remove(pattern)
    assert facts(kb) == ["(open wp0)"]


# -- C5 -----------------------------------------------------------------------------------------------------------


def test_removing_with_a_future_time_cancels_the_scheduled_assertion(kb, clock):
    """C5: it never takes effect, and stays on record with the transaction that cancelled it."""
    kb.add("(raining)", initial_time=START + 10)
    kb.add("(raining)", initial_time=START + 20)
    clock.set(START + 5)
    cancelling = kb.remove("(raining)", initial_time=START + 10)
    assert scheduled(kb) == [(START + 20, "(raining)")]
    assert facts(kb, START + 15) == []
    first, second = kb.history("(raining)")
    assert (first.initial_time, first.cancelled.number) == (START + 10, cancelling.number)
    assert (second.initial_time, second.cancelled) == (START + 20, None)


@pytest.mark.parametrize("offset", [9, 11])
def test_cancelling_needs_the_exact_time(kb, offset):
    """C5: another time cancels nothing, and the current assertion is left alone."""
    kb.add("(raining)")
    kb.add("(raining)", initial_time=START + 10)
    assert kb.remove("(raining)", initial_time=START + offset).changes == 0
    assert facts(kb, START) == facts(kb, START + 10) == ["(raining)"]


def test_cancelling_matches_signs_and_patterns(kb):
    """C5, V7: positive patterns cancel positive assertions only."""
    at = START + 10
    kb.add("(open wp0)", "(open wp1)", "(not (open hall))", "(= (battery kenny) 3)", initial_time=at)
    kb.remove("(open ?)", "(battery ?)", initial_time=at)
    assert scheduled(kb) == [(at, "(not (open hall))")]
    kb.remove("(not (open ?))", initial_time=at)
    assert scheduled(kb) == []


def test_removing_at_the_time_of_a_scheduled_assertion_ends_it(kb, clock):
    """C4, C5: from its own time on a scheduled assertion is current, and is ended rather than cancelled."""
    kb.add("(raining)", initial_time=START + 10)
    clock.set(START + 10)
    kb.remove("(raining)", initial_time=START + 10)
    (assertion,) = kb.history("(raining)")
    assert assertion.cancelled is None
    assert (assertion.initial_time, assertion.end_time) == (START + 10, START + 10)


# -- C6 -----------------------------------------------------------------------------------------------------------


def test_scheduling_another_value_for_a_time_replaces_the_earlier(kb, clock):
    """C6: the earlier assertion is cancelled."""
    kb.add("(= (cost) 1)", "(raining)", initial_time=START + 10)
    clock.set(START + 1)
    second = kb.add("(= (cost) 2)", "(not (raining))", initial_time=START + 10)
    assert scheduled(kb) == [(START + 10, "(= (cost) 2)"), (START + 10, "(not (raining))")]
    for pattern in ("(cost)", "(raining)"):
        first = kb.history(pattern)[0]
        assert first.cancelled.number == second.number
    assert kb.value("(cost)", at=START + 10) == 2


def test_a_change_of_type_needs_an_end_strictly_before(kb):
    """C6: existences of different types may neither overlap nor touch."""
    with pytest.raises(kbstore.InvalidKnowledge):
        kb.add("wp0 - robot", initial_time=START + 10)
    kb.add("(not (wp0 - place))", initial_time=START + 9)
    kb.add("wp0 - robot", initial_time=START + 10)
    kinds = [instance for instance in instances(kb, START + 10) if instance.startswith("wp0")]
    assert kinds == ["wp0 - robot"]


def test_a_cancellation_that_makes_two_types_meet_is_refused(kb):
    """C6: the end between them stays scheduled."""
    kb.add("(not (wp0 - place))", initial_time=START + 9)
    kb.add("wp0 - robot", initial_time=START + 20)
    before = picture(kb)
    with pytest.raises(kbstore.InvalidKnowledge, match="wp0"):
        kb.remove("(not (wp0 - place))", initial_time=START + 9)
    assert picture(kb) == before


def test_a_removal_that_makes_two_types_meet_is_refused(kb, clock):
    """C6: an object removed and added with another type at one time would have both types at that time."""
    clock.set(START + 10)
    with pytest.raises(kbstore.InvalidKnowledge, match="wp0"):
        kb.update([(REMOVE, item("wp0 - place")), (ADD, item("wp0 - robot"))])
    kb.remove("wp0")
    with pytest.raises(kbstore.InvalidKnowledge, match="wp0"):
        kb.add("wp0 - robot")
    clock.set(START + 11)
    kb.add("wp0 - robot")
    assert "wp0 - robot" in instances(kb)


def test_an_existence_of_no_length_does_not_count(kb, clock):
    """C6: an object that is added and removed at one time never existed."""
    clock.set(START + 10)
    kb.add("box - item")
    kb.remove("box")
    kb.add("box - robot")
    assert "box - robot" in instances(kb)


def test_scheduling_an_existing_object_again_does_not_make_room_for_another_type(kb, clock):
    """C6: scheduling the current existence is not an end, so no end lies strictly before the other type."""
    kb.add("kenny - robot", initial_time=START + 10)
    clock.set(START + 10)
    with pytest.raises(kbstore.InvalidKnowledge, match="until then"):
        kb.update([(REMOVE, item("kenny - robot")), (ADD, item("kenny - place"))])
    assert "kenny - robot" in instances(kb)


def test_adjacent_existences_of_one_type_are_one(kb, clock):
    """C6: scheduling the current existence is not an end, so facts continue across it."""
    kb.add("(open wp0)")
    kb.add("wp0 - place", initial_time=START + 10)
    assert facts(kb, START + 9) == facts(kb, START + 10) == facts(kb, START + 11) == ["(open wp0)"]
    assert intervals(kb, "(open wp0)") == [("(open wp0)", START, None, False)]


# -- C7 -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("change", "value"),
    [
        ("(= (cost) 3)", 3),
        ("(assign (cost) 3)", 3),
        ("(increase (cost) 3)", 15),
        ("(decrease (cost) 3)", 9),
        ("(scale-up (cost) 3)", 36),
        ("(scale-down (cost) 3)", 4),
    ],
)
def test_each_operation_does_what_its_name_says(kb, change, value):
    """C7: scale-up multiplies, scale-down divides."""
    kb.add("(= (cost) 12)")
    kb.add(change)
    assert kb.value("(cost)") == value


@pytest.mark.parametrize(
    "operation", [AssignOp.INCREASE, AssignOp.DECREASE, AssignOp.SCALE_UP, AssignOp.SCALE_DOWN, AssignOp.ASSIGN_CTS]
)
def test_a_relative_change_of_an_undefined_function_is_an_error(kb, operation):
    """C7: an undefined function is not taken as 0."""
    with pytest.raises(kbstore.UndefinedFunction, match=r"battery kenny"):
        kb.add(Function(attribute_name="battery", values=["kenny"], function_value=2, assign_op=operation))
    assert kb.state().functions == []


@pytest.mark.parametrize(
    "operation", [AssignOp.INCREASE, AssignOp.DECREASE, AssignOp.SCALE_UP, AssignOp.SCALE_DOWN, AssignOp.ASSIGN_CTS]
)
def test_a_relative_change_cannot_be_scheduled(kb, operation):
    """C7: the value that it changes is not known yet."""
    kb.add("(= (cost) 12)")
    change = Function(attribute_name="cost", function_value=2, assign_op=operation, initial_time=START + 10)
    with pytest.raises(kbstore.ScheduledRelativeChange):
        kb.add(change)
    assert scheduled(kb) == []


def test_a_rate_moves_the_value_linearly(kb, clock):
    """C7: per second, from the value at now; in text `(increase (f a) (* #t 2))`."""
    kb.add("(= (battery kenny) 80)")
    clock.set(START + seconds(10))
    kb.add("(increase (battery kenny) (* #t -0.5))")
    values = [kb.value("(battery kenny)", at=START + seconds(at)) for at in (5, 10, 12, 30)]
    assert values == [80, 80, 79, 70]
    (function,) = kb.state(START + seconds(30)).functions
    assert (function.function_value, function.rate) == (70, -0.5)


def test_the_value_read_follows_the_rule_to_the_last_bit(kb, clock):
    """C7: value + rate * ((t - initial_time) / 1e9), in that order of operations."""
    kb.add(Function(attribute_name="cost", function_value=0.1, rate=0.3))
    for elapsed in (1, 7, 333_333_333, seconds(3) + 1):
        assert kb.value("(cost)", at=START + elapsed) == 0.1 + 0.3 * (elapsed / 1e9)
        (function,) = kb.state(START + elapsed).functions
        assert function.function_value == 0.1 + 0.3 * (elapsed / 1e9)


def test_relative_changes_keep_the_rate_and_use_the_value_at_now(kb, clock):
    """C7: for increase, decrease, scale-up and scale-down."""
    kb.add(Function(attribute_name="cost", function_value=10, rate=2))
    clock.set(START + seconds(5))
    kb.add("(increase (cost) 4)")
    assert kb.value("(cost)", at=START + seconds(5)) == 24
    assert kb.value("(cost)", at=START + seconds(6)) == 26
    clock.set(START + seconds(6))
    kb.add("(scale-up (cost) 2)")
    assert kb.value("(cost)", at=START + seconds(7)) == 54


def test_assign_sets_value_and_rate(kb, clock):
    """C7: the rate is that of the item, 0 if absent."""
    kb.add(Function(attribute_name="cost", function_value=10, rate=2))
    clock.set(START + seconds(5))
    kb.add("(= (cost) 20)")
    assert kb.value("(cost)", at=START + seconds(50)) == 20


def test_an_assignment_with_a_rate_can_be_scheduled(kb):
    """C7: the value moves from the scheduled time on."""
    kb.add(Function(attribute_name="cost", function_value=10, rate=2, initial_time=START + seconds(5)))
    assert kb.value("(cost)", at=START + seconds(5)) == 10
    assert kb.value("(cost)", at=START + seconds(7)) == 14


def test_dividing_by_zero_is_an_error(kb):
    """C7: the value does not change."""
    kb.add("(= (cost) 12)")
    with pytest.raises(kbstore.DivisionByZero):
        kb.add("(scale-down (cost) 0)")
    assert kb.value("(cost)") == 12


@pytest.mark.parametrize("value", [float("nan"), float("inf"), float("-inf")])
def test_values_that_are_not_finite_are_refused(kb, value):
    """C7: NaN and infinities are `InvalidKnowledge`, as value, as rate, as change."""
    with pytest.raises(kbstore.InvalidKnowledge):
        kb.add({"knowledge_type": 2, "attribute_name": "cost", "function_value": value})
    with pytest.raises(kbstore.InvalidKnowledge):
        kb.add(Function(attribute_name="cost", function_value=1, rate=value))
    assert kb.state().functions == []


def test_an_overflow_is_refused(kb):
    """C7: the stored value stays finite."""
    kb.add("(= (cost) 12)")
    kb.add(Function(attribute_name="cost", function_value=1e308))
    for change in ("(scale-up (cost) 10)", "(increase (cost) 1" + "0" * 308 + ")"):
        with pytest.raises(kbstore.InvalidKnowledge):
            kb.add(change)
    assert kb.value("(cost)") == 1e308


# -- C8 -----------------------------------------------------------------------------------------------------------


def test_an_object_has_one_type_while_it_exists(kb):
    """C8: the same name with another type is refused, even with a subtype."""
    for other in ("robot", "room", "object"):
        with pytest.raises(kbstore.InvalidKnowledge, match="wp0"):
            kb.add(f"wp0 - {other}")
    assert kb.add("wp0 - place").changes == 0


def test_objects_of_different_type_may_not_overlap_in_the_schedule(kb):
    """C8: two scheduled existences of different type may not overlap."""
    kb.add("box - item", initial_time=START + 10)
    with pytest.raises(kbstore.InvalidKnowledge, match="box"):
        kb.add("box - robot", initial_time=START + 5)
    with pytest.raises(kbstore.InvalidKnowledge, match="box"):
        kb.add("box - robot")
    with pytest.raises(kbstore.InvalidKnowledge, match="box"):
        kb.add("box - robot", initial_time=START + 20)
    kb.add("(not (box - item))", initial_time=START + 15)
    kb.add("box - robot", initial_time=START + 20)
    assert "box - item" in instances(kb, START + 10)
    assert "box - robot" in instances(kb, START + 20)


@pytest.mark.parametrize("method", ["add", "remove"])
def test_constants_cannot_be_added_or_removed(kb, method):
    """C8: they always exist."""
    with pytest.raises(kbstore.InvalidKnowledge, match="home"):
        getattr(kb, method)("home - place")
    kb.add("(open home)")
    assert kb.holds("(open home)")


def test_objects_has_the_constants_and_instances_has_not(kb):
    """C8: `objects` lists those of a type and its subtypes, constants included."""
    names = sorted(str(found).split()[0] for found in kb.state().objects("place"))
    assert names == ["galley", "hall", "home", "wp0", "wp1"]
    assert "home - place" not in instances(kb)
    assert "home - place" not in [str(found) for found in kb.instances("place")]
    assert "home - place" in [str(found) for found in kb.instances("place", include_constants=True)]


# -- C11 ----------------------------------------------------------------------------------------------------------


def test_adding_a_metric_replaces_it(kb, clock):
    """C11: the metric is one timeline."""
    kb.add_metric("minimize (cost)")
    clock.set(START + 10)
    kb.add_metric("maximize (battery kenny)")
    assert str(kb.metric()) == "maximize (battery kenny)"
    assert str(kb.metric(at=START + 9)) == "minimize (cost)"


def test_a_recorded_inequality_does_not_decide_a_question(kb):
    """C11: it is recorded with its times and sign, but a question is always evaluated."""
    kb.add("(= (cost) 1)")
    kb.add("(> (cost) 5)")
    assert [str(i) for i in kb.state().inequalities] == ["(> (cost) 5)"]
    assert not kb.holds("(> (cost) 5)")
    kb.add("(not (> (cost) 5))")
    assert [str(i) for i in kb.state().inequalities] == ["(not (> (cost) 5))"]
    kb.add("(= (cost) 6)")
    assert kb.holds("(> (cost) 5)")
    kb.remove("(not (> (cost) 5))")
    assert kb.state().inequalities == []
