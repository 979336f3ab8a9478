"""Rules O5 and O7: continuous effects are differential equations, whose rates follow what they read."""

import random

import pytest

import kbstore
from kbstore import Function, KnowledgeType, seconds
from kbstore.storage.repository import Repository
from tests.conftest import START

TANKS = """
(define (domain tanks)
  (:types tank valve)
  (:predicates (on ?t - tank) (open ?v - valve) (paused) (high))
  (:functions (level ?t - tank) (inflow ?t - tank) (size ?v - valve) (pressure) (drift) (log) (other))
  (:derived (high) (> (pressure) 5))
  (:durative-action fill :parameters (?t - tank) :duration (= ?duration 100)
    :effect (and (increase (level ?t) (* #t (inflow ?t)))
                 (at end (assign (log) (level ?t)))))
  (:durative-action twice :parameters (?t - tank) :duration (= ?duration 100)
    :effect (increase (level ?t) (* #t (* 2 (inflow ?t)))))
  (:durative-action boost :parameters (?t - tank ?by - tank) :duration (<= ?duration 100)
    :effect (and (at start (assign (inflow ?t) 5)) (at end (assign (inflow ?t) 1))))
  (:durative-action drain :parameters (?t - tank) :duration (= ?duration 100)
    :effect (forall (?v - valve)
      (when (over all (and (open ?v) (not (paused)))) (decrease (level ?t) (* #t (size ?v))))))
  (:durative-action press :parameters (?t - tank) :duration (= ?duration 100)
    :effect (when (over all (high)) (increase (level ?t) (* #t 1))))
  (:durative-action latched :parameters (?t - tank) :duration (= ?duration 100)
    :effect (when (at start (on ?t)) (increase (level ?t) (* #t (inflow ?t)))))
  (:durative-action grow :parameters () :duration (= ?duration 100) :effect (increase (pressure) (* #t (drift))))
  (:durative-action spiral :parameters () :duration (= ?duration 100) :effect (increase (pressure) (* #t (pressure))))
  (:durative-action ratio :parameters (?t - tank) :duration (= ?duration 100)
    :effect (increase (level ?t) (* #t (/ 6 (other)))))
  (:durative-action charge :parameters (?t - tank) :duration (= ?duration (/ (- 100 (level ?t)) (inflow ?t)))
    :condition (at end (>= (level ?t) 100))
    :effect (and (increase (level ?t) (* #t (inflow ?t))) (at end (assign (log) (level ?t))))))
"""


@pytest.fixture
def tanks(open_kb):
    """Tank a has a level of 0 and an inflow of 1 a second."""
    kb = open_kb()
    kb.load(TANKS)
    kb.add("a - tank", "b - tank", "v - valve", "(= (level a) 0)", "(= (inflow a) 1)", "(= (drift) 0)")
    return kb


def level(kb, *times, **belief):
    return [kb.value("(level a)", at=START + seconds(t), **belief) for t in times]


def at(clock, t):
    clock.set(START + seconds(t))


# -- what a rate follows ------------------------------------------------------------------------------------------


def test_a_rate_follows_recorded_changes(tanks, clock):
    """O5: the number continues from its value at the change."""
    tanks.start("fill", "a")
    at(clock, 10)
    tanks.add("(= (inflow a) 3)")
    at(clock, 20)
    assert level(tanks, 0, 5, 10, 12, 20, 30) == [0, 5, 10, 16, 40, 70]
    assert tanks.when("(> (level a) 13)", START, START + seconds(50)) == [
        (START + seconds(11) + 1, START + seconds(50))
    ]


def test_a_rate_follows_effects_of_other_actions(tanks, clock):
    """O5: at their starts and ends, real and expected."""
    tanks.start("fill", "a")
    at(clock, 10)
    boost = tanks.start("boost", "a", "b", duration=seconds(10))
    # 10 at 10 s, 5 a second for 10 s, then 1 a second
    assert level(tanks, 10, 15, 20, 30) == [10, 35, 60, 70]
    at(clock, 15)
    tanks.abort(boost)
    assert level(tanks, 15, 20, 30) == [35, 60, 110]


def test_a_rate_follows_a_schedule_by_the_clock_alone(tanks, clock):
    """O5: future pieces are computed when the schedule is recorded; no process has to run when they come."""
    tanks.start("fill", "a")
    at(clock, 2)
    tanks.add("(= (inflow a) 4)", initial_time=START + seconds(5))
    tanks.add("(= (inflow a) 0)", initial_time=START + seconds(7))
    expected = [0, 5, 13, 13]
    assert level(tanks, 0, 5, 7, 50) == expected
    believed = START + seconds(2)
    at(clock, 60)
    assert level(tanks, 0, 5, 7, 50) == expected
    assert level(tanks, 5, 7, 50, as_of=believed) == expected[1:]
    assert [str(item) for item in tanks.state(believed).timed_knowledge] == ["(= (inflow a) 4)", "(= (inflow a) 0)"]
    assert tanks.when("(= (level a) 13)", START, START + seconds(50)) == [(START + seconds(7), START + seconds(50))]


def test_a_late_number_moves_at_the_rates_of_the_runs(tanks, clock):
    """L6, L7: also where it had no value: 1 a second from 3 s and 3 from 4 s, with later corrections."""
    run = tanks.start("fill", "a")
    tanks.add("(= (inflow a) 3)", initial_time=START + seconds(4))
    at(clock, 2)
    tanks.remove("(level a)")
    at(clock, 6)
    tanks.add("(= (inflow a) 5)")
    at(clock, 7)
    tanks.add("(= (inflow a) 100)", since=START + seconds(3), until=START + seconds(5))
    at(clock, 8)
    tanks.add("(= (level a) 10)", since=START + seconds(3))
    assert level(tanks, 1, 3, 4, 6, 8, 9) == [1, 10, 11, 17, 27, 32]
    at(clock, 9)
    tanks.abort(run)
    tanks.remove("(level a)")
    at(clock, 12)
    tanks.add("(= (level a) 0)", since=START + seconds(10))
    assert level(tanks, 8, 10, 12) == [27, 0, 0]


def test_a_late_number_does_not_move_while_a_rate_was_undefined(tanks, clock):
    """O5, L6: nothing was added to it there, and 2 a second once the rate was defined again."""
    tanks.start("fill", "a")
    at(clock, 2)
    tanks.remove("(inflow a)")
    at(clock, 6)
    tanks.add("(= (inflow a) 2)")
    at(clock, 8)
    tanks.add("(= (level a) 10)", since=START + seconds(3))
    assert level(tanks, 1, 3, 6, 8, 9) == [1, 10, 10, 14, 16]


@pytest.mark.parametrize("recorded", [20, 25], ids=["at its end", "after its end"])
def test_a_number_recorded_late_stops_with_the_run_that_moved_it(tanks, clock, recorded):
    """L6: what was superseded while a run moved it says nothing of the rate after that."""
    run = tanks.start("fill", "a")
    at(clock, 10)
    tanks.remove("(level a)", since=START + seconds(5))
    at(clock, 20)
    tanks.abort(run)
    at(clock, recorded)
    tanks.add("(= (level a) 7)", since=START + seconds(8))
    assert level(tanks, 4, 8, 10, 20, 25, 30) == [4, 7, 9, 19, 19, 19]


def test_a_rate_does_not_follow_a_cancelled_schedule(tanks, clock):
    """O5: the pieces that were derived from it are computed again."""
    tanks.start("fill", "a")
    tanks.add("(= (inflow a) 4)", initial_time=START + seconds(5))
    at(clock, 2)
    before = START + seconds(1)
    tanks.remove("(inflow a)", initial_time=START + seconds(5))
    assert level(tanks, 5, 10) == [5, 10]
    assert level(tanks, 10, as_of=before) == [25]
    tanks.add("(= (level a) 100)")
    at(clock, 10)
    assert level(tanks, 1, 2, 10) == [1, 100, 108]


def test_future_pieces_begin_by_the_clock(tanks, clock):
    """O5, Q6: they are in no transaction's change, and a watch delivers them when they begin."""
    tanks.start("fill", "a")
    done = tanks.add("(= (inflow a) 4)", initial_time=START + seconds(5))
    (change,) = tanks.changes(after=done.number - 1)
    assert [str(a.item) for a in change.asserted] == ["(= (inflow a) 4)"]
    at(clock, 6)
    (due,) = tanks.watch(after=done.number, timeout=0)
    assert due.time == START + seconds(5)
    assert sorted(str(a.item).split(")")[0] for a in due.asserted) == ["(= (inflow a", "(= (level a"]


def test_a_scheduled_function_moves_from_its_scheduled_value(tanks, clock):
    """O5, C7: with the rate that holds at that time."""
    tanks.start("fill", "a")
    tanks.add("(= (level a) 50)", initial_time=START + seconds(10))
    tanks.add("(= (inflow a) 2)", initial_time=START + seconds(5))
    tanks.add("(= (inflow a) 3)", initial_time=START + seconds(12))
    expected = [5, 15 - 2e-9, 50, 54, 57]
    assert level(tanks, 5, 10, 12, 13) == [5, 50, 54, 57]
    assert tanks.value("(level a)", at=START + seconds(10) - 1) == pytest.approx(expected[1])
    at(clock, 20)
    assert level(tanks, 5, 10, 12, 13) == [5, 50, 54, 57]


def test_contributions_add_up_and_end_independently(tanks, clock):
    """O3, O5: two runs move one function by the same number."""
    fill = tanks.start("fill", "a")
    tanks.start("twice", "a")
    at(clock, 10)
    tanks.add("(= (inflow a) 2)")
    at(clock, 20)
    tanks.end(fill)
    assert level(tanks, 10, 20, 30) == [30, 90, 130]


def test_conditions_and_quantifiers_are_evaluated_again(tanks, clock):
    """O5: a `when` that becomes true, an object that is added, and one that is removed."""
    tanks.add("(= (level a) 1000)", "(= (size v) 1)")
    tanks.start("drain", "a")
    at(clock, 10)
    tanks.add("(open v)")
    at(clock, 20)
    tanks.add("w - valve", "(= (size w) 2)", "(open w)")
    at(clock, 30)
    tanks.add("(paused)")
    at(clock, 40)
    tanks.remove("(paused)")
    at(clock, 50)
    tanks.remove("v - valve")
    at(clock, 60)
    assert level(tanks, 10, 20, 30, 40, 50, 60) == [1000, 990, 960, 960, 930, 910]


def test_a_rate_follows_derived_predicates(tanks, clock):
    """O5, V9: also where rules of the domain read a number."""
    tanks.add("(= (pressure) 1)")
    tanks.start("press", "a")
    at(clock, 10)
    tanks.add("(= (pressure) 9)")
    at(clock, 20)
    assert level(tanks, 10, 20) == [0, 10]


def test_at_start_conditions_of_a_rate_do_not_change(tanks, clock):
    """O2, O5: an at-start part keeps its value of the start; the rate itself follows."""
    tanks.add("(on a)")
    tanks.start("latched", "a")
    at(clock, 10)
    tanks.remove("(on a)")
    tanks.add("(= (inflow a) 2)")
    at(clock, 20)
    assert level(tanks, 10, 20) == [10, 30]


def test_rates_are_followed_after_a_restart(clock, tmp_path):
    """O5: with what their effects latched at the start."""
    with kbstore.open(tmp_path / "tanks.db", "tanks", clock=clock) as kb:
        kb.load(TANKS)
        kb.add("a - tank", "(= (level a) 0)", "(= (inflow a) 1)", "(on a)")
        kb.start("latched", "a")
        kb.remove("(on a)")
    at(clock, 10)
    with kbstore.open(tmp_path / "tanks.db", "tanks", clock=clock) as kb:
        kb.add("(= (inflow a) 3)")
        at(clock, 20)
        assert level(kb, 10, 20) == [10, 40]


def test_a_transaction_sees_the_rates_that_follow_from_it(tanks, clock):
    """O5: before the transaction is committed."""
    tanks.start("fill", "a")
    at(clock, 10)
    with tanks.transaction() as tx:
        tx.add("(= (inflow a) 3)")
        assert tx.state().value("(level a)") == 10
        assert [item.rate for item in tx.state().functions if str(item.atom) == "(level a)"] == [3]


# -- what is not linear -------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("prepared", "refused"),
    [
        # its own value
        ([], lambda kb: kb.start("spiral")),
        # a number with a rate, now or scheduled
        ([Function(attribute_name="inflow", values=["a"], function_value=1, rate=2)], lambda kb: kb.start("fill", "a")),
        (
            [Function(attribute_name="inflow", values=["a"], function_value=1, rate=2, initial_time=START + 10**12)],
            lambda kb: kb.start("fill", "a"),
        ),
        # the rule that a condition reads
        ([Function(attribute_name="pressure", function_value=1, rate=2)], lambda kb: kb.start("press", "a")),
    ],
    ids=["own", "now", "scheduled", "condition"],
)
def test_a_start_whose_rate_reads_a_moving_number_is_refused(tanks, prepared, refused):
    """O5: `NotLinear` names both, and nothing is stored."""
    tanks.add("(= (pressure) 1)", *prepared)
    with pytest.raises(kbstore.NotLinear) as error:
        refused(tanks)
    assert "moves itself" in str(error.value)
    assert tanks.state().running == []


@pytest.mark.parametrize(
    "change",
    [
        lambda kb: kb.add(Function(attribute_name="inflow", values=["a"], function_value=1, rate=2)),
        lambda kb: kb.add("(increase (inflow a) (* #t 1))"),
        lambda kb: kb.add(
            Function(attribute_name="inflow", values=["a"], function_value=1, rate=2), initial_time=START + 9
        ),
    ],
    ids=["rate", "continuous", "scheduled"],
)
def test_a_transaction_that_moves_a_number_read_by_a_rate_is_refused(tanks, change):
    """O5: also where the transaction only schedules the rate."""
    tanks.start("fill", "a")
    with pytest.raises(kbstore.NotLinear, match=r"\(level a\) by \(inflow a\)"):
        change(tanks)
    assert level(tanks, 10) == [10]


def test_a_rate_may_not_read_a_number_that_another_run_moves(tanks):
    """O5: `grow` moves the pressure by 0 a second, and `press` reads it."""
    tanks.add("(= (pressure) 1)")
    run = tanks.start("grow")
    with pytest.raises(kbstore.NotLinear):
        tanks.start("press", "a")
    tanks.abort(run)
    assert tanks.start("press", "a")
    with pytest.raises(kbstore.NotLinear):
        tanks.start("grow")


# -- what is undefined --------------------------------------------------------------------------------------------


def test_while_a_rate_is_undefined_the_number_is_undefined_until_set(tanks, clock):
    """O5: a rate is never frozen silently."""
    tanks.start("fill", "a")
    at(clock, 10)
    tanks.remove("(inflow a)")
    assert not tanks.holds("(>= (level a) 0)")
    at(clock, 20)
    tanks.add("(= (inflow a) 2)")
    with pytest.raises(kbstore.UndefinedFunction):
        tanks.value("(level a)")
    at(clock, 30)
    tanks.add("(= (level a) 5)")
    at(clock, 40)
    assert level(tanks, 9, 30, 40) == [9, 5, 25]


def test_a_value_set_while_the_rate_is_undefined_holds(tanks, clock):
    """O5: it keeps the assigned value, and does not move at that rate."""
    tanks.add("(= (other) 2)")
    tanks.start("ratio", "a")
    at(clock, 10)
    tanks.add("(= (other) 0)")
    with pytest.raises(kbstore.UndefinedFunction):
        tanks.value("(level a)")
    tanks.add("(= (level a) 7)")
    at(clock, 20)
    tanks.add("(= (other) 6)", "(paused)")
    at(clock, 30)
    assert level(tanks, 10, 20, 30) == [7, 7, 17]


def test_a_number_becomes_undefined_by_the_clock(tanks, clock):
    """O5: where a number read by its rate is scheduled to become undefined; a value scheduled later holds again."""
    tanks.add("(= (other) 2)")
    tanks.start("ratio", "a")
    tanks.add("(= (other) 0)", initial_time=START + seconds(5))
    tanks.add("(= (other) 3)", initial_time=START + seconds(8))
    tanks.add("(= (level a) 1)", initial_time=START + seconds(9))
    for now in (1, 30):
        at(clock, now)
        assert level(tanks, 4, 9, 10) == [12, 1, 3]
        for t in (5, 8):
            with pytest.raises(kbstore.UndefinedFunction):
                level(tanks, t)


# -- exactly as long as the domain fixes ---------------------------------------------------------------------------


def test_at_its_expected_end_an_action_has_taken_exactly_its_duration(tanks, clock):
    """O7: charging for the time until full gives full at any rate; its conditions and effects see that."""
    chance = random.Random(7)
    for _ in range(40):
        first, rate = chance.uniform(0, 99), chance.choice([3, 7, 0.3, 11.7, chance.uniform(0.01, 50)])
        tanks.add(f"(= (level a) {first!r})", f"(= (inflow a) {rate!r})")
        run = tanks.start("charge", "a")
        exact = first + rate * run.seconds
        assert tanks.value("(log)", at=run.expected_end) == pytest.approx(100, abs=1e-13)
        clock.set(run.expected_end)
        ended = tanks.end(run)
        assert tanks.value("(level a)") == tanks.value("(log)") == pytest.approx(exact, abs=3e-14)
        assert ended.failing == [] or tanks.value("(level a)") < 100


def test_at_any_other_end_the_real_duration_counts(tanks, clock):
    """O7: an end one second late adds one second of effect."""
    tanks.add("(= (inflow a) 3)")
    run = tanks.start("charge", "a")
    clock.set(run.expected_end + seconds(1))
    tanks.end(run)
    assert tanks.value("(level a)") == pytest.approx(103, abs=1e-8)


def test_an_unrelated_assertion_does_not_read_rates(tanks, clock, monkeypatch):
    """O5: while an action moves a number, an unrelated assertion causes no further reads."""
    tanks.start("fill", "a")
    read = []
    for name in ("state_at", "holding"):
        original = getattr(Repository, name)

        def noted(self, *arguments, original=original, **options):
            read.append((original.__name__, next(a for a in arguments if isinstance(a, KnowledgeType))))
            return original(self, *arguments, **options)

        monkeypatch.setattr(Repository, name, noted)
    at(clock, 1)
    tanks.add("(paused)", "(= (drift) 4)", "(on a)")
    assert read == []
    at(clock, 2)
    tanks.add("(= (inflow a) 3)")
    assert ("holding", KnowledgeType.FUNCTION) in read
    assert [kind for method, kind in read if method == "state_at"] == [KnowledgeType.INSTANCE]
    assert level(tanks, 1, 2, 4) == [1, 2, 8]
