"""Watching a knowledge base or a condition as it changes (rules Q6, Q9), and samples of a past expression."""

import threading
import time
from datetime import timedelta

import pytest

import kbstore
from kbstore import InvalidKnowledge, InvalidTime, KbStoreError, Truth, UnknownSymbol, seconds
from tests.conftest import START


def test_a_watch_begins_when_it_is_called(kb):
    """Q6: a change between the call and the first poll is not missed."""
    watch = kb.watch(timeout=0.0)
    added = kb.add("(raining)")
    assert [change.number for change in watch] == [added.number]
    assert isinstance(added, kbstore.Transaction)


def test_a_watched_pattern_does_not_match_goals(kb):
    """Q6: a goal of the same form is not a change of the state."""
    watch = kb.watch("(open ?)", timeout=0.0)
    kb.add_goal("(open wp0)")
    added = kb.add("(open wp1)")
    assert [(change.number, [str(found.item) for found in change.asserted]) for change in watch] == [
        (added.number, ["(open wp1)"])
    ]


def test_a_watched_pattern_matches_what_is_superseded(kb, clock):
    """Q6, L8: late knowledge that only supersedes is a change, and superseded assertions are matched like others."""
    began = clock.now()
    kb.add("(open wp0)", "(clean hall)", "(clean galley)")
    clock.advance(seconds(10))
    kb.remove("(open wp0)", "(clean ?)")
    clock.advance(seconds(10))
    watch = kb.watch("(open ?)", timeout=0.0)
    kb.remove("(clean hall)", since=began, until=began + seconds(10))
    late = kb.remove("(open wp0)", since=began, until=began + seconds(10))
    with kb.transaction() as tx:
        tx.remove("(clean galley)", since=began + seconds(1))
        tx.add("(open wp0)", since=began + seconds(2), until=began + seconds(3))
    assert [(change.number, *map(texts, (change.asserted, change.superseded))) for change in watch] == [
        (late.number, [], ["(open wp0)"]),
        (tx.result.number, ["(open wp0)"], []),
    ]


def texts(assertions):
    return [str(found.item) for found in assertions]


@pytest.mark.parametrize(
    "pattern",
    [
        "(opne ?)",
        "(open ? ?)",
        "(and (open ?) (clean ?))",
        "(not (open))",
        "(< (battery ?) 20)",
        "(> (battry kenny) 20)",
        "? - palace",
        "(? wp0)",
        42,
    ],
)
def test_a_pattern_that_nothing_matches_is_refused_at_the_call(kb, pattern):
    """Q6: not when the first change comes, possibly hours later."""
    with pytest.raises((InvalidKnowledge, UnknownSymbol)):
        kb.watch(pattern)


def test_the_timeout_counts_what_matches(kb):
    """Q6: a watch of another pattern ends in time, however much is written meanwhile."""
    stop = threading.Event()

    def write():
        number = 0
        while not stop.wait(0.005):
            number += 1
            kb.add(f"(= (cost) {number})")

    thread = threading.Thread(target=write)
    thread.start()
    try:
        watch = kb.watch("(open ?)", timeout=0.4, poll=0.01)
        assert list(watch) == []
    finally:
        stop.set()
        thread.join()


def test_past_changes_come_before_the_timeout(kb):
    """Q6: also where it takes several polls to reach them."""
    with_many = [kb.add(f"(= (cost) {number})").number for number in range(300)]
    added = kb.add("(open wp0)")
    assert [change.number for change in kb.watch("(open ?)", after=0, timeout=0)] == [added.number]
    assert [change.number for change in kb.watch(after=2, timeout=0)] == [*with_many, added.number]


@pytest.mark.parametrize("way", ["watch", "condition", "knowledge base", "wait"])
def test_watching_is_ended_from_another_thread(open_kb, way):
    """Q6, Q9: by close() of the watch or of the knowledge base; without an error, and at once."""
    kb = open_kb()
    kb.load("(define (domain d) (:predicates (p)))")
    watch = kb.watch_condition("(p)") if way == "condition" else kb.watch("(p)")
    ended = []

    def follow():
        ended.append(kb.wait_for("(p)") if way == "wait" else list(watch))

    thread = threading.Thread(target=follow)
    thread.start()
    time.sleep(0.1)
    assert thread.is_alive()
    (kb if way in ("knowledge base", "wait") else watch).close()
    thread.join(timeout=5)
    assert not thread.is_alive()
    (found,) = ended
    assert found is None if way == "wait" else len(found) == (way == "condition")
    assert list(watch) == []


def test_closing_ends_a_watch_before_it_is_used(kb):
    """Q6: `close` may be called twice."""
    watch = kb.watch(after=0)
    assert next(watch).number == 1
    watch.close()
    watch.close()
    assert list(watch) == []


# -- conditions (rule Q9) -----------------------------------------------------------------------------------------


def test_a_condition_is_followed(kb, clock):
    """Q9: its truth now, and each change of it with time and transaction."""
    watch = kb.watch_condition("(and (raining) (open wp0))", timeout=0)
    clock.advance(seconds(1))
    kb.add("(raining)")
    clock.advance(seconds(1))
    opened = kb.add("(open wp0)")
    clock.advance(seconds(1))
    kb.add("(open wp1)")
    stopped = kb.remove("(raining)")
    assert list(watch) == [
        (START, Truth.FALSE, None),
        (START + seconds(2), Truth.TRUE, opened),
        (START + seconds(3), Truth.FALSE, stopped),
    ]


def test_a_change_by_the_clock_has_no_transaction(kb, clock):
    """Q9: schedules and ends of objects; also where something else is written at that time."""
    watch = kb.watch_condition("(exists (?p - place) (open ?p))", timeout=0)
    kb.add("(open wp0)", initial_time=START + seconds(5))
    kb.add("(not (wp0 - place))", initial_time=START + seconds(8))
    clock.advance(seconds(8))
    kb.add("(raining)")
    clock.advance(seconds(2))
    assert list(watch) == [
        (START, Truth.FALSE, None),
        (START + seconds(5), Truth.TRUE, None),
        (START + seconds(8), Truth.FALSE, None),
    ]


def test_a_crossing_is_exact(kb, clock):
    """Q9, Q4: a moving number crosses a limit at a nanosecond, at any times of polling."""
    kb.add("(= (battery kenny) 90)")
    kb.add("(decrease (battery kenny) (* #t 3))")
    watch = kb.watch_condition("(< (battery kenny) 20)", timeout=0)
    clock.advance(seconds(60))
    found = list(watch)
    # 90 - 3 t < 20 from t = 70/3 s on
    assert found == [(START, Truth.FALSE, None), (START + 23_333_333_334, Truth.TRUE, None)]


def test_several_changes_at_one_time_are_one(kb):
    """Q9: a value that was true only between two changes at one time is not reported."""
    watch = kb.watch_condition("(raining)", timeout=0)
    kb.add("(raining)")
    kb.remove("(raining)")
    last = kb.add("(raining)")
    assert list(watch) == [(START, Truth.FALSE, None), (START, Truth.TRUE, last)]


def test_a_change_at_the_time_of_the_last_poll(kb):
    """Q9: a later transaction at the same time is not missed, and the cause is the transaction that decided."""
    watch = kb.watch_condition("(raining)", timeout=5, poll=0.01)
    assert next(watch) == (START, Truth.FALSE, None)
    added = kb.add("(raining)")
    kb.add("(open wp1)")
    assert next(watch) == (START, Truth.TRUE, added)
    gone = kb.remove("(raining)")
    assert next(watch) == (START, Truth.FALSE, gone)


@pytest.mark.parametrize("often", [True, False])
def test_late_knowledge_is_seen_at_the_time_of_its_transaction(kb, clock, often):
    """L7, Q9: not earlier; at any time of polling, and with any number of transactions between two polls."""
    watch = kb.watch_condition("(raining)", timeout=0)

    def at(t):
        clock.set(START + seconds(t))
        return START + seconds(t)

    def look():
        if often:
            watch._look()  # as a reader that polls does

    at(5)
    added = kb.add("(raining)", since=START + seconds(2))
    look()
    at(8)
    gone = kb.remove("(raining)", since=START + seconds(3))
    look()
    at(11)
    kb.add("(raining)", since=START + seconds(1), until=START + seconds(9))
    look()
    kb.add("(raining)", initial_time=START + seconds(12))
    at(14)
    late = kb.add("(not (raining))", since=START + seconds(13))
    look()
    assert list(watch) == [
        (START, Truth.FALSE, None),
        (START + seconds(5), Truth.TRUE, added),
        (START + seconds(8), Truth.FALSE, gone),
        (START + seconds(12), Truth.TRUE, None),
        (START + seconds(14), Truth.FALSE, late),
    ]


def test_unknown_is_a_truth_value(open_kb):
    """Q9, V2: with unknowns there are three truth values."""
    kb = open_kb(use_unknowns=True)
    kb.load("(define (domain d) (:predicates (p)))")
    watch = kb.watch_condition("(p)", timeout=0)
    assert next(watch)[1] is Truth.UNKNOWN
    kb.add("(not (p))")
    assert next(watch)[1] is Truth.FALSE
    kb.add("(p)")
    assert next(watch)[1] is Truth.TRUE
    kb.remove("(p)")
    assert next(watch)[1] is Truth.UNKNOWN


def test_expected_ends_are_not_changes(open_kb, clock):
    """Q9: the effects of a run count when it ends."""
    kb = open_kb()
    kb.load(
        """(define (domain d) (:predicates (done))
        (:durative-action work :parameters () :duration (= ?duration 5) :condition () :effect (at end (done))))"""
    )
    run = kb.start("work")
    watch = kb.watch_condition("(done)", timeout=0)
    clock.advance(seconds(7))
    assert next(watch) == (START, Truth.FALSE, None)
    with pytest.raises(StopIteration):
        next(watch)
    watch = kb.watch_condition("(done)", timeout=0)
    next(watch)
    ended = kb.end(run)
    (time_, truth, transaction) = next(watch)
    assert (time_, truth, transaction.number) == (START + seconds(7), Truth.TRUE, ended.number)


def test_a_condition_is_checked_at_the_call(kb):
    """Q9, V8, V10: it is refused by the call itself."""
    for wrong in ("(rainign)", "(> (battery ?) 3)", "(= (battery kenny)", "(open wp0 wp1)"):
        with pytest.raises(KbStoreError):
            kb.watch_condition(wrong)
        with pytest.raises(KbStoreError):
            kb.wait_for(wrong, timeout=0)


def test_a_condition_that_becomes_invalid_is_an_error(open_kb, clock):
    """Q9: for example a domain without its predicate."""
    kb = open_kb()
    kb.load("(define (domain d) (:predicates (p) (q)))")
    watch = kb.watch_condition("(p)", timeout=1)
    next(watch)
    clock.advance(seconds(1))
    kb.load("(define (domain d) (:predicates (q)))")
    with pytest.raises(UnknownSymbol, match="no predicate p"):
        next(watch)


def test_waiting_for_a_condition(kb, clock):
    """Q9: it returns the first time at which the condition is true, or ends after the timeout."""
    assert kb.wait_for("(raining)", timeout=0) is None
    begin = time.monotonic()
    assert kb.wait_for("(raining)", timeout=0.2) is None
    assert 0.2 <= time.monotonic() - begin < 5
    clock.advance(seconds(3))
    kb.add("(raining)")
    assert kb.wait_for("(raining)", timeout=0) == START + seconds(3)
    kb.add("(open wp0)", initial_time=START + seconds(5))
    waiting = kb.watch_condition("(open wp0)", timeout=0)
    clock.advance(seconds(10))
    assert [found[0] for found in waiting if found[1] is Truth.TRUE] == [START + seconds(5)]
    assert kb.wait_for("(open wp0)", timeout=0) == START + seconds(13)


def test_waiting_for_a_write_of_another_thread(kb, clock):
    """Q9: the writer need not know of it."""
    found = []
    thread = threading.Thread(target=lambda: found.append(kb.wait_for("(raining)", timeout=20, poll=0.01)))
    thread.start()
    time.sleep(0.05)
    clock.advance(seconds(4))
    added = kb.add("(raining)")
    thread.join()
    assert found == [added.time]


# -- samples ------------------------------------------------------------------------------------------------------


def test_samples_of_an_expression(kb, clock):
    """C7, V5: the value at each step; None where it is undefined."""
    clock.advance(seconds(2))
    kb.add("(= (battery kenny) 90)")
    kb.add("(decrease (battery kenny) (* #t 3))")
    clock.advance(seconds(4))
    kb.add("(= (cost) 0)")
    found = kb.sample("(battery kenny)", START, START + seconds(6), seconds(1))
    assert found == [
        (START, None),
        (START + seconds(1), None),
        (START + seconds(2), 90),
        (START + seconds(3), 87),
        (START + seconds(4), 84),
        (START + seconds(5), 81),
    ]
    assert kb.sample("(/ (battery kenny) (cost))", START + seconds(5), START + seconds(8), timedelta(seconds=1)) == [
        (START + seconds(5), None),
        (START + seconds(6), None),
        (START + seconds(7), None),
    ]
    assert kb.sample("(+ (battery kenny) 1)", START + seconds(16), START + seconds(17), seconds(1)) == [
        (START + seconds(16), 49)
    ]
    assert kb.sample("(battery kenny)", START, START, 1) == []


def test_invalid_samples_are_refused(kb):
    """T2, V8: a step of 0, times in the wrong order, and unknown symbols."""
    for expression, since, until, step, kind in (
        ("(cost)", START, START + 5, 0, InvalidTime),
        ("(cost)", START + 5, START, 1, InvalidTime),
        ("(cots)", START, START, 1, UnknownSymbol),
        ("(raining)", START, START + 1, 1, KbStoreError),
    ):
        with pytest.raises(kind):
            kb.sample(expression, since, until, step)
