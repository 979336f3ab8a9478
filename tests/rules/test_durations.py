"""Rule O7: a domain's constraints on the duration of an action."""

from datetime import timedelta

import pytest

import kbstore
from kbstore import Truth, seconds
from tests.conftest import START
from tests.rules.reading import picture

WORKSHOP = """
(define (domain workshop)
  (:predicates (idle) (done) (asked))
  (:functions (limit) (third) (log) (speed) (seen))
  (:durative-action fixed :parameters () :duration (= ?duration 3) :effect (at end (done)))
  (:durative-action upto :parameters () :duration (<= ?duration 30) :effect (at end (done)))
  (:durative-action between :parameters ()
    :duration (and (>= ?duration 2) (<= ?duration (limit)))
    :condition (and (at start (idle)) (over all (asked)))
    :effect (and (at start (asked)) (at start (assign (limit) 1)) (at end (done))))
  (:durative-action cut :parameters () :duration (= ?duration (/ 1 (third)))
    :effect (at end (increase (log) ?duration)))
  (:durative-action late :parameters ()
    :duration (and (at start (<= ?duration 20)) (at end (>= ?duration (limit))))
    :effect (at end (done)))
  (:durative-action blink :parameters () :duration (= ?duration 0) :effect (at end (done)))
  (:action look :parameters () :effect (done)))
"""


@pytest.fixture
def shop(open_kb):
    kb = open_kb()
    kb.load(WORKSHOP)
    kb.add("(idle)", "(= (limit) 5)", "(= (third) 3)", "(= (log) 0)")
    return kb


@pytest.mark.parametrize(
    ("operator", "duration", "constraint"),
    [
        ("fixed", seconds(9), "(= ?duration 3)"),
        ("fixed", seconds(2), "(= ?duration 3)"),
        ("upto", seconds(31), "(<= ?duration 30)"),
        ("between", seconds(1), "(>= ?duration 2)"),
        ("between", seconds(6), "(<= ?duration (limit))"),
    ],
)
def test_a_duration_that_the_domain_does_not_allow_is_not_applicable(shop, operator, duration, constraint):
    """O7: the constraint is named, and nothing is stored."""
    before = picture(shop)
    answer = shop.applicable(operator, duration=duration)
    assert [(f.condition, f.truth, f.since) for f in answer.failing] == [(constraint, Truth.FALSE, None)]
    with pytest.raises(kbstore.NotApplicable) as refused:
        shop.start(operator, duration=duration)
    assert constraint in str(refused.value)
    assert picture(shop) == before


def test_the_constraints_are_evaluated_before_the_at_start_effects(shop):
    """O7: `between` itself lowers the limit to 1, below its duration."""
    assert shop.applicable("between", duration=seconds(5))
    shop.start("between", duration=seconds(5))
    assert shop.value("(limit)") == 1


@pytest.mark.parametrize(
    ("given", "allowed"),
    [(333_333_332, False), (333_333_333, True), (333_333_334, True), (333_333_335, False), (None, True)],
)
def test_a_duration_may_be_off_by_a_nanosecond(shop, given, allowed):
    """O7: a third of a second is not a whole number of nanoseconds, yet ?duration is exactly a third."""
    if not allowed:
        with pytest.raises(kbstore.NotApplicable, match=r"\(= \?duration \(/ 1 \(third\)\)\)"):
            shop.start("cut", duration=given)
        return
    run = shop.start("cut", duration=given)
    assert (run.duration, run.seconds) == (333_333_333, 1 / 3)
    assert shop.state().running == [run]
    shop.end(run)
    assert shop.value("(log)") == 1 / 3


def test_a_constraint_that_is_unknown_is_not_applicable(shop):
    """O7: a constraint is unknown where it reads an undefined function or divides by zero."""
    shop.remove("(limit)")
    shop.add("(= (third) 0)")
    for operator, constraint in (("between", "(<= ?duration (limit))"), ("cut", "(= ?duration (/ 1 (third)))")):
        failing = shop.applicable(operator, duration=seconds(3)).failing
        assert (constraint, Truth.UNKNOWN) in [(f.condition, f.truth) for f in failing]
        with pytest.raises(kbstore.NotApplicable) as refused:
            shop.start(operator, duration=seconds(3))
        assert f"{constraint} is unknown" in str(refused.value)


def test_force_overrules_constraints_and_lists_them(shop, clock):
    """O7: `Run.forced` lists them, also later."""
    run = shop.start("fixed", duration=seconds(9), force=True)
    assert (run.duration, run.forced) == (seconds(9), ("(= ?duration 3)",))
    assert run.expected_end == START + seconds(9)
    assert shop.state().running == [run]
    assert shop.start("upto", duration=seconds(30), force=True).forced == ()
    shop.remove("(limit)")
    assert shop.start("between", duration=seconds(1), force=True).forced == (
        "(>= ?duration 2)",
        "(<= ?duration (limit))",
    )


def test_force_overrules_nothing_else(shop):
    """O7: at-start conditions, a second start and impossible effects are refused all the same."""
    shop.remove("(idle)")
    with pytest.raises(kbstore.NotApplicable) as refused:
        shop.start("between", duration=seconds(1), force=True)
    assert "(idle)" in str(refused.value)
    assert "?duration" not in str(refused.value)
    shop.start("fixed", force=True)
    with pytest.raises(kbstore.NotApplicable, match="runs already"):
        shop.start("fixed", force=True)


def test_constraints_at_end_are_reported_by_the_end(shop, clock):
    """O7: evaluated on the state at the end, with the ?duration of the start; the real duration is not checked."""
    assert shop.applicable("late", duration=seconds(4))
    run = shop.start("late", duration=seconds(4))
    clock.advance(seconds(9))
    ended = shop.end(run)
    assert [(f.condition, f.truth) for f in ended.failing] == [("(>= ?duration (limit))", Truth.FALSE)]
    assert shop.holds("(done)")
    run = shop.start("late", duration=seconds(4))
    shop.add("(= (limit) 4)")
    clock.advance(seconds(1))
    assert shop.end(run).failing == []


@pytest.mark.parametrize("given", [1, 20, 999_999])
def test_a_bare_number_below_a_millisecond_is_refused(shop, given):
    """O7, T2: it was probably meant as seconds."""
    for ask in (shop.start, shop.applicable):
        with pytest.raises(kbstore.InvalidTime, match=rf"write kbstore.seconds\({given}\)"):
            ask("upto", duration=given)


@pytest.mark.parametrize("given", [0, 1_000_000, timedelta(microseconds=20), {"sec": 0, "nanosec": 7}])
def test_a_short_duration_can_be_given(shop, given):
    """O7, T2: 0 is 0 in any unit, and a `timedelta` or a stamp has its own unit."""
    assert shop.start("upto", duration=given).duration == kbstore.clock.duration(given)


def test_a_duration_may_be_zero(shop):
    """O7: the duration of an action may be 0."""
    run = shop.start("blink")
    assert (run.duration, run.expected_end) == (0, START)
    assert shop.end(run).failing == []


def test_an_instantaneous_action_has_no_duration(shop):
    """O7: giving one is an error."""
    with pytest.raises(kbstore.InvalidKnowledge, match="takes no time"):
        shop.applicable("look", duration=seconds(1))


def test_applicability_without_a_duration_checks_the_start(shop):
    """O6, O7: where no duration is given or fixed, only the start is checked."""
    assert shop.applicable("between")
    shop.remove("(idle)")
    assert [f.condition for f in shop.applicable("between").failing] == ["(idle)"]
