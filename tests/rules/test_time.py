"""Rules T1 to T5: what a time is, what now is, and that the past never changes."""

from contextlib import nullcontext
from datetime import UTC, datetime, timedelta, timezone
from types import SimpleNamespace

import pytest

import kbstore
from kbstore import SystemClock, seconds
from tests.conftest import START
from tests.rules.reading import facts, picture, scheduled

LATEST = 2**62 - 1


class Ticking:
    """A clock that advances by a nanosecond at each reading."""

    def __init__(self, start):
        self.t = start

    def now(self):
        self.t += 1
        return self.t


# -- T1 -----------------------------------------------------------------------------------------------------------


def test_a_time_is_an_int_of_nanoseconds(kb, clock):
    """T1: an assertion made at t holds at t, and not one nanosecond before."""
    clock.set(START + 7)
    kb.add("(raining)")
    assert facts(kb, START + 7) == ["(raining)"]
    assert facts(kb, START + 6) == []


def test_a_simulated_clock_may_start_at_zero(open_kb):
    """T1: nothing assumes the wall clock; knowledge recorded at 0 holds at 0."""
    kb = open_kb(clock=kbstore.ManualClock(0))
    kb.add("(raining)")
    assert kb.now() == 0
    assert facts(kb, 0) == ["(raining)"]
    assert kb.history("(raining)")[0].initial_time == 0


def test_the_last_nanosecond_before_the_limit_can_be_used(open_kb):
    """T1: times go up to 2^62 - 1."""
    kb = open_kb(clock=kbstore.ManualClock(LATEST - 1))
    kb.add("(raining)")
    kb.add("(not (raining))", initial_time=LATEST)
    assert facts(kb, LATEST - 1) == ["(raining)"]
    assert facts(kb, LATEST) == ["(not (raining))"]


@pytest.mark.parametrize("t", [-1, 2**62, 2**63, 2**80, -(2**70)])
def test_times_outside_the_range_are_refused(kb, t):
    """T1, T2: 0 <= t < 2^62, in questions and in knowledge."""
    with pytest.raises(kbstore.InvalidTime):
        kb.state(at=t)
    with pytest.raises(kbstore.InvalidTime):
        kb.state(at=START, as_of=t)
    with pytest.raises(kbstore.InvalidTime):
        kb.add("(raining)", initial_time=t)
    assert facts(kb) == []


def test_the_initial_time_zero_means_now(kb, clock):
    """T1, T4: as the initial time of an item, 0 is "now"."""
    clock.set(START + 5)
    kb.add(kbstore.Fact(attribute_name="raining", initial_time=0))
    kb.add("(clean hall)", initial_time=0)
    assert {item.initial_time for item in kb.state().facts} == {START + 5}


# -- T2 -----------------------------------------------------------------------------------------------------------

MOMENT = 1_500_000_000_123_456_000


@pytest.mark.parametrize(
    "form",
    [
        MOMENT,
        datetime(2017, 7, 14, 2, 40, 0, 123456, tzinfo=UTC),
        datetime(2017, 7, 14, 4, 40, 0, 123456, tzinfo=timezone(timedelta(hours=2))),
        "2017-07-14T02:40:00.123456Z",
        "2017-07-14T04:40:00.123456+02:00",
        SimpleNamespace(sec=1_500_000_000, nanosec=123_456_000),
        SimpleNamespace(secs=1_500_000_000, nsecs=123_456_000),
        SimpleNamespace(nanoseconds=MOMENT),
    ],
    ids=["int", "utc", "aware", "text", "text-offset", "ros2", "ros1", "nanoseconds"],
)
def test_all_forms_of_a_time_mean_the_same(open_kb, form):
    """T2: an int, an aware datetime, ISO 8601 text with an offset, a stamp object."""
    kb = open_kb(clock=kbstore.ManualClock(MOMENT - seconds(10)))
    kb.add("(raining)", initial_time=form)
    assert scheduled(kb) == [(MOMENT, "(raining)")]
    assert kb.state(at=form).at == MOMENT
    assert kb.holds("(raining)", at=form)
    assert not kb.holds("(raining)", at=MOMENT - 1)
    assert kb.state(at=MOMENT, as_of=form).at == MOMENT


@pytest.mark.parametrize(
    ("form", "reason"),
    [
        (datetime(2017, 7, 14, 2, 40), "timezone"),
        ("2017-07-14T02:40:00", "offset"),
        ("yesterday", "ISO 8601"),
        (12.5, "kbstore.seconds"),
        (float("nan"), "kbstore.seconds"),
        (True, "kbstore.seconds"),
        (SimpleNamespace(sec=1.5, nanosec=0), "kbstore.seconds"),
        (object(), "kbstore.seconds"),
    ],
    ids=["naive", "no-offset", "word", "float", "nan", "bool", "float-stamp", "object"],
)
def test_other_forms_are_refused_with_advice(kb, form, reason):
    """T2: naive datetimes, floats and bools are refused with a message that says what to write instead."""
    with pytest.raises(kbstore.InvalidTime, match=reason):
        kb.state(at=form)
    with pytest.raises(kbstore.InvalidTime, match=reason):
        kb.add("(raining)", initial_time=form)
    with pytest.raises(kbstore.InvalidTime, match=reason):
        kbstore.time(form)
    assert facts(kb) == []


@pytest.mark.parametrize(
    "question", ["holds", "truth", "value", "explain", "instances", "propositions", "goals", "metric"]
)
def test_every_question_refuses_a_float_for_a_time(kb, question):
    """T2: all questions convert times in the same way."""
    about = {"instances": (), "propositions": (), "goals": (), "metric": (), "value": ("(battery kenny)",)}
    with pytest.raises(kbstore.InvalidTime):
        getattr(kb, question)(*about.get(question, ("(raining)",)), at=1000.0)


@pytest.mark.parametrize(
    ("form", "away"),
    [
        ("now", 0),
        ("-5m", -seconds(300)),
        ("+30s", seconds(30)),
        ("-1h30m", -seconds(5400)),
        ("+0.5us", 500),
        (" -250ms ", -250_000_000),
        ("+1ns", 1),
    ],
)
def test_text_with_a_sign_is_relative_to_now(open_kb, form, away):
    """T2: wherever a knowledge base takes a time, as on the command line."""
    now = START + seconds(7200)
    clock = kbstore.ManualClock(START)
    kb = open_kb(clock=clock)
    kb.add("(raining)")
    clock.set(now)
    t = now + away
    assert kb.state(form).at == t
    assert kb.state(at=now, as_of=form).at == now
    for _ in range(2):
        # the second time, the question has been prepared
        assert kb.truth("(raining)", at=form) is kbstore.Truth.of(t >= START)
        assert kb.value("(+ 1 2)", at=form) == 3
    assert kb.when("(raining)", form, "+1h") == [(max(t, START), now + seconds(3600))]
    assert [str(item) for item in kb.diff(START - 1, form).became_true] == (["(raining)"] if t >= START else [])
    assert len(kb.history("(raining)", since=form)) == 1
    assert len(kb.history("(raining)", until=form)) == (t > START)
    kb.add("(snowing)", initial_time=form)
    with kb.transaction() as tx:
        tx.add("(windy)", initial_time=form)
    taken = [found.initial_time for name in ("snowing", "windy") for found in kb.history(f"({name})")]
    assert taken == [max(t, now)] * 2


def test_relative_text_needs_a_now(kb):
    """T2: a time in an item, or converted alone, must be absolute; the error says so."""
    with pytest.raises(kbstore.InvalidTime, match="relative to now"):
        kbstore.time("-5m")
    with pytest.raises(kbstore.InvalidTime, match="relative to now"):
        kb.add({"knowledge_type": 1, "attribute_name": "raining", "initial_time": "+30s"})
    for wrong in ("-5", "- 5m", "5m", "-5 minutes", "soon"):
        with pytest.raises(kbstore.InvalidTime, match="like -5m"):
            kb.state(wrong)
    with pytest.raises(kbstore.InvalidTime, match="outside"):
        kb.state("-99999d")


def test_seconds_are_exact():
    """T2: `seconds` gives nanoseconds without the rounding of binary fractions."""
    assert seconds(12.5) == 12_500_000_000
    assert seconds(0.1) == 100_000_000
    assert seconds("1500000000.123456789") == 1_500_000_000_123_456_789


# -- T3 -----------------------------------------------------------------------------------------------------------


def test_now_is_read_once_for_a_transaction(open_kb):
    """T3: all updates of a transaction have the same time, although the clock advances."""
    kb = open_kb(clock=Ticking(START))
    transaction = kb.add("(a)", "(b)", "(c)", "(= (f) 1)")
    state = kb.state(transaction.time)
    assert {item.initial_time for item in state.facts} == {transaction.time}
    assert len(state.facts) == 3


def test_now_is_read_on_entry_of_a_transaction(kb, clock):
    """T3: inside a transaction the time does not advance."""
    with kb.transaction() as tx:
        tx.add("(raining)")
        clock.advance(50)
        tx.add("(open wp0)")
    assert tx.result.time == START
    assert {item.initial_time for item in kb.state(START).facts} == {START}


def test_a_clock_that_is_a_little_behind_is_read_as_the_latest_time(kb, clock):
    """T3: up to the tolerance of one second."""
    clock.set(START + seconds(5))
    kb.add("(raining)")
    clock.set(START + seconds(4))
    transaction = kb.add("(open wp0)")
    assert transaction.time == START + seconds(5)
    assert facts(kb, START + seconds(5)) == ["(open wp0)", "(raining)"]


def test_a_clock_that_is_far_behind_is_refused(kb, clock):
    """T3: behind by more than the tolerance, nothing is stored."""
    clock.set(START + seconds(5))
    before = kb.add("(raining)")
    clock.set(START + seconds(4) - 1)
    with pytest.raises(kbstore.ClockWentBackwards):
        kb.add("(open wp0)")
    with pytest.raises(kbstore.ClockWentBackwards), kb.transaction() as tx:
        tx.remove("(raining)")
    clock.set(START + seconds(5))
    assert facts(kb) == ["(raining)"]
    assert [change.number for change in kb.changes()][-1] == before.number


def test_a_question_sees_all_writes_at_any_clock_time(kb, clock):
    """T3: in questions now is the later of the clock and the latest recorded time."""
    clock.set(START + seconds(5))
    kb.add("(raining)")
    clock.set(START)
    assert kb.now() == START + seconds(5)
    assert kb.holds("(raining)")
    assert kb.state().at == START + seconds(5)
    clock.set(START + seconds(9))
    assert kb.now() == START + seconds(9)


def test_another_knowledge_base_has_a_time_of_its_own(open_kb):
    """T3: now never runs backwards in one knowledge base; each has its own."""
    open_kb(clock=kbstore.ManualClock(START)).add("(raining)")
    other = open_kb(clock=kbstore.ManualClock(3))
    assert other.add("(raining)").time == 3


# -- T4 -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("behind", [0, 1, seconds(500)])
def test_an_initial_time_that_is_not_after_now_is_now(kb, clock, behind):
    """T4: an initial time in the past means now."""
    clock.set(START + seconds(10))
    kb.add("(raining)", initial_time=clock.now() - behind)
    kb.add(kbstore.Fact(attribute_name="open", values=["wp0"], initial_time=clock.now() - behind))
    assert {item.initial_time for item in kb.state().facts} == {START + seconds(10)}
    assert facts(kb, START + seconds(10) - 1) == []


def test_an_initial_time_after_now_is_timed_initial_knowledge(kb, clock):
    """T4: recorded now, it takes effect at its time."""
    at = START + 1
    transaction = kb.add("(raining)", initial_time=at)
    assert transaction.time == START
    assert scheduled(kb) == [(at, "(raining)")]
    assert facts(kb, START) == []
    assert facts(kb, at) == ["(raining)"]
    assert scheduled(kb, at) == []
    (assertion,) = kb.history("(raining)")
    assert assertion.recorded.number == transaction.number
    assert assertion.recorded.time == START
    assert assertion.initial_time == at


def test_the_items_own_time_comes_before_that_of_the_call(kb):
    """T4: `initial_time=` of a call applies to the items without one of their own."""
    kb.add(kbstore.Fact(attribute_name="raining", initial_time=START + 10), "(open wp0)", initial_time=START + 20)
    assert scheduled(kb) == [(START + 10, "(raining)"), (START + 20, "(open wp0)")]


@pytest.mark.parametrize(
    ("item", "shown"),
    [
        ("box - item", "box - item"),
        ("(not (cup - item))", "(not (cup - item))"),
        ("(raining)", "(raining)"),
        ("(not (raining))", "(not (raining))"),
        ("(= (battery kenny) 3)", "(= (battery kenny) 3)"),
        ("(> (battery kenny) 3)", "(> (battery kenny) 3)"),
        ("minimize (cost)", "minimize (cost)"),
    ],
)
def test_every_type_of_knowledge_can_be_scheduled(kb, item, shown):
    """T4: objects, facts of both signs, functions, the metric and inequalities."""
    at = START + seconds(1)
    kb.add(item, initial_time=at)
    assert scheduled(kb) == [(at, shown)]
    before, after = picture(kb, at - 1), picture(kb, at)
    changed = [part for part in before if before[part] != after[part] and part != "timed_knowledge"]
    assert len(changed) == 1


# -- T5 -----------------------------------------------------------------------------------------------------------


def test_the_past_never_changes(kb, clock):
    """T5: later writes do not change the state at any time before the latest recorded one."""
    end = START + seconds(60)
    kb.add("(open wp0)", "(near kenny wp1)", "(= (battery kenny) 80)", "box - item", "minimize (cost)")
    kb.add("(not (open wp0))", "(tagged kenny)", "(not (box - item))", initial_time=START + seconds(30))
    kb.add_goal("(open wp1)")
    clock.set(START + seconds(10))
    kb.add("(increase (battery kenny) (* #t -0.5))")
    kb.remove("(tagged kenny)", initial_time=START + seconds(30))
    clock.set(START + seconds(20))
    kb.add("(raining)")
    times = [
        START,
        START + 1,
        START + seconds(5),
        START + seconds(10) - 1,
        START + seconds(10),
        START + seconds(20) - 1,
    ]
    seen = {t: picture(kb, t) for t in times}
    kb.remove("wp1", "kenny")
    kb.add("(open wp0)", initial_time=START + seconds(25))
    clock.set(START + seconds(40))
    kb.clear()
    clock.set(end)
    kb.add("kenny - robot", "(near kenny home)")
    assert {t: picture(kb, t) for t in times} == seen
    assert {t: picture(kb, t, as_of=end) for t in times} == seen


def test_nothing_takes_effect_before_it_was_recorded(kb, clock):
    """T5: no assertion has an initial time before the time of its recording."""
    clock.set(START + 10)
    kb.add("(raining)", initial_time=START + 3)
    kb.add("(open wp0)", initial_time=START + 30)
    for pattern in ("(raining)", "(open ?)"):
        assert all(a.initial_time >= a.recorded.time for a in kb.history(pattern))


@pytest.fixture
def machine(monkeypatch):
    """The machine's two clocks, which the test sets: `wall` and `measured`, in seconds."""
    clocks = SimpleNamespace(wall=1_800_000_000, measured=50)
    monkeypatch.setattr("time.time_ns", lambda: seconds(clocks.wall))
    monkeypatch.setattr(SystemClock, "elapsed", staticmethod(lambda: seconds(clocks.measured)))
    return clocks


def pass_time(machine, wall, measured):
    """Let time pass, by the wall clock and as the machine measures it."""
    machine.wall += wall
    machine.measured += measured


def test_a_clock_that_jumped_stores_nothing(open_kb, machine):
    """T6: nine years by the wall clock within ten seconds are refused, until the clock is corrected."""
    kb = open_kb(clock=SystemClock())
    number = kb.add("a - thing").number
    pass_time(machine, 9 * 365 * 86_400, 10)
    with pytest.raises(kbstore.ClockJumped, match="open the knowledge base anew"):
        kb.add("b - thing")
    machine.wall = 1_800_000_000 + 10
    assert kb.add("b - thing").number == number + 1


@pytest.mark.parametrize(("ahead", "jumps"), [(3600, False), (3601, True)])
def test_the_largest_step_is_an_hour(open_kb, machine, ahead, jumps):
    """T6: up to an hour more than measured since the last good reading is a correction; more is a jump."""
    kb = open_kb(clock=SystemClock())
    pass_time(machine, 100, 100)
    kb.add("a - thing")
    pass_time(machine, 7 + ahead, 7)
    with pytest.raises(kbstore.ClockJumped) if jumps else nullcontext():
        kb.add("b - thing")
    assert kb.holds("b - thing") is not jumps


def test_the_largest_step_can_be_set(open_kb, machine):
    """T6: `max_step` is a duration."""
    kb = open_kb(clock=SystemClock(), max_step=timedelta(seconds=5))
    pass_time(machine, 6, 0)
    with pytest.raises(kbstore.ClockJumped):
        kb.add("a - thing")


def test_a_suspended_machine_has_not_jumped(open_kb, machine):
    """T6: two hours of suspension are measured, and the transaction is stored."""
    kb = open_kb(clock=SystemClock())
    kb.add("a - thing")
    pass_time(machine, 7200, 7200)
    assert kb.add("b - thing").time == seconds(machine.wall)


def test_a_knowledge_base_that_is_opened_anew_takes_the_clock_as_it_is(open_kb, machine):
    """T6: a process compares only its own readings."""
    kb = open_kb("jumping", clock=SystemClock())
    pass_time(machine, 86_400, 1)
    with pytest.raises(kbstore.ClockJumped):
        kb.add("a - thing")
    assert open_kb("anew", clock=SystemClock()).add("a - thing").time == seconds(machine.wall)


def test_other_clocks_may_jump(open_kb, clock):
    """T6: manual and simulated clocks may jump by any amount."""
    kb = open_kb()
    kb.add("a - thing")
    clock.advance(seconds(10 * 365 * 86_400))
    assert kb.add("b - thing").changes == 1
