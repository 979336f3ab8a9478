"""Rules O6 and Q8: invariants are watched while their action runs, and runs are listed."""

import pytest

import kbstore
from kbstore import Truth, seconds
from tests.conftest import START

PLANT = """
(define (domain plant)
  (:types pump)
  (:predicates (fault) (ready ?p - pump) (hot) (sealed))
  (:functions (level) (limit))
  (:derived (hot) (> (level) 50))
  (:durative-action go :parameters (?p - pump) :duration (= ?duration 10)
    :condition (and (over all (not (fault))) (over all (ready ?p)) (over all (or (sealed) (not (hot)))))
    :effect (and (at start (ready ?p)) (at end (not (ready ?p)))))
  (:durative-action drain :parameters (?p - pump) :duration (= ?duration 10)
    :condition (over all (>= (level) (limit))) :effect (decrease (level) (* #t 2)))
  (:durative-action lean :parameters (?p - pump) :duration (= ?duration 8) :condition (over all (ready ?p)))
  (:durative-action loose :parameters (?p - pump) :duration (<= ?duration 10)
    :condition (over all (>= (level) (limit))))
  (:durative-action timed :parameters (?p - pump) :duration (<= ?duration 10)
    :condition (over all (>= (level) ?duration)))
  (:durative-action free :parameters (?p - pump) :duration (= ?duration 0)))
"""


@pytest.fixture
def plant(open_kb):
    kb = open_kb()
    kb.load(PLANT)
    kb.add("p - pump", "q - pump", "(= (level) 30)", "(= (limit) 4)")
    return kb


def at(clock, t):
    clock.set(START + seconds(t))


def spans(broken):
    """Condition, truth and span in seconds."""
    return [
        (b.condition, b.truth, (b.since - START) / 1e9, None if b.until is None else (b.until - START) / 1e9)
        for b in broken
    ]


def test_force_starts_a_run_that_cannot_be_forecast(open_kb):
    """O6: a product of two moving numbers is NotLinear; with force the action starts, and lists what was overruled."""
    kb = open_kb()
    kb.load("""
      (define (domain d) (:functions (x) (y))
        (:durative-action go :parameters () :duration (= ?duration 10) :condition (over all (<= (* (x) (y)) 100))))
    """)
    kb.add("(= (x) 1)", "(= (y) 1)", "(increase (x) (* #t 1))", "(increase (y) (* #t 1))")
    with pytest.raises(kbstore.NotLinear):
        kb.start("go")
    assert kb.start("go", force=True).forced == ("(<= (* (x) (y)) 100)",)


# -- O6 -----------------------------------------------------------------------------------------------------------


def test_a_broken_invariant_is_on_record_with_its_spans(plant, clock):
    """O6: while the action runs, in the result of `end`, and afterwards; `end` does not fail because of it."""
    run = plant.start("go", "p")
    assert plant.broken(run) == []
    at(clock, 2)
    plant.add("(fault)")
    at(clock, 3)
    assert spans(plant.broken(run)) == [("(not (fault))", Truth.FALSE, 2, None)]
    at(clock, 5)
    plant.remove("(fault)")
    at(clock, 8)
    plant.add("(fault)")
    at(clock, 10)
    ended = plant.end(run)
    assert ended.failing == []
    expected = [("(not (fault))", Truth.FALSE, 2, 5), ("(not (fault))", Truth.FALSE, 8, 10)]
    assert spans(ended.broken) == expected
    at(clock, 20)
    plant.remove("(fault)")
    assert spans(plant.broken(run)) == expected


def test_an_invariant_is_watched_after_the_start_and_before_the_end(plant, clock):
    """O6: an action may establish its invariant at its start, and delete it at its end."""
    run = plant.start("go", "q")
    at(clock, 10)
    assert plant.end(run).broken == []


def test_an_invariant_may_break_by_the_clock_alone(plant, clock):
    """O6: by the schedule, through derived predicates, and by a moving number, to the nanosecond."""
    run = plant.start("go", "p")
    drain = plant.start("drain", "p")
    plant.add("(= (level) 60)", initial_time=START + seconds(3))
    plant.add("(sealed)", initial_time=START + seconds(6))
    at(clock, 10)
    # 60 at 3 s, and 2 less each second
    assert spans(plant.broken(run)) == [("(or (sealed) (not (hot)))", Truth.FALSE, 3, 6)]
    assert plant.broken(drain) == []
    plant.add("(= (level) 6)")
    at(clock, 15)
    assert spans(plant.broken(drain)) == [("(>= (level) (limit))", Truth.FALSE, pytest.approx(11 + 1e-9), None)]
    assert plant.broken(drain)[0].since == START + seconds(11) + 1


def test_an_unknown_or_undefined_invariant_is_broken(open_kb, clock):
    """O6: an invariant is broken wherever it is not true."""
    kb = open_kb(use_unknowns=True)
    kb.load(PLANT)
    kb.add("p - pump", "(= (level) 30)", "(= (limit) 4)", "(not (fault))")
    run, drain = kb.start("go", "p"), kb.start("drain", "p")
    at(clock, 1)
    kb.remove("(not (fault))")
    kb.remove("(limit)")
    at(clock, 2)
    assert spans(kb.broken(run)) == [("(not (fault))", Truth.UNKNOWN, 1, None)]
    assert spans(kb.broken(drain)) == [("(>= (level) (limit))", Truth.UNKNOWN, 1, None)]


def test_an_invariant_may_read_the_duration(plant, clock):
    """O6, O3: the duration is that of the start."""
    run = plant.start("timed", "p", duration=seconds(5))
    at(clock, 1)
    plant.add("(= (level) 4)")
    at(clock, 2)
    assert spans(plant.broken(run)) == [("(>= (level) ?duration)", Truth.FALSE, 1, None)]


@pytest.mark.parametrize("wrong", ["go", None, kbstore.Run("go", ("p",), START, 1, 99)])
def test_broken_refuses_what_is_not_a_run(plant, wrong):
    """O6: a typed error says what to give."""
    with pytest.raises(kbstore.InvalidKnowledge, match="is not a run"):
        plant.broken(wrong)


def test_a_break_is_delivered_as_it_begins(plant, clock):
    """O6, Q6: once, by a transaction or by the clock alone; a reader that continues misses none."""
    run = plant.start("go", "p")
    last = list(plant.changes())[-1]
    plant.add("(= (level) 60)", initial_time=START + seconds(6))
    at(clock, 2)
    plant.add("(fault)")
    at(clock, 3)
    plant.remove("(fault)")
    at(clock, 8)
    plant.add("(sealed)")
    changes = list(plant.watch(after=last.number, timeout=0))
    assert [(c.time - START, [(b.condition, b.run) for b in c.broken]) for c in changes] == [
        (0, []),
        (seconds(2), [("(not (fault))", run.number)]),
        (seconds(3), []),
        (seconds(6), [("(or (sealed) (not (hot)))", run.number)]),
        (seconds(8), []),
    ]
    (change, *_) = [c for c in plant.watch(after=changes[1], timeout=0) if c.broken]
    assert change.time == START + seconds(6)
    assert not any(c.broken for c in plant.watch("(sealed)", after=last.number, timeout=0))


def test_a_number_that_crosses_breaks_by_the_clock(plant, clock):
    """O6: where nothing else happens at that time; the level is 30 - 2 a second, and has to be at least 4."""
    plant.start("drain", "p")
    watching = plant.watch(timeout=0)
    at(clock, 9)
    plant.add("(= (level) 8)")
    at(clock, 12)
    (change, crossed) = watching
    assert (change.broken, crossed.by_clock, crossed.time) == ([], True, START + seconds(11) + 1)
    assert [b.condition for b in crossed.broken] == ["(>= (level) (limit))"]
    assert list(plant.watch(after=crossed, timeout=0)) == []


# -- O6: what is expected -----------------------------------------------------------------------------------------


def test_a_scheduled_break_of_an_invariant_is_forecast(plant, clock):
    """O6: the action is not applicable, and the condition is named with its time; force starts it all the same."""
    plant.add("(fault)", initial_time=START + seconds(4))
    (failing,) = plant.applicable("go", "p").failing
    assert (failing.condition, failing.truth, failing.since) == ("(not (fault))", Truth.FALSE, START + seconds(4))
    with pytest.raises(kbstore.NotApplicable, match=r"\(not \(fault\)\) is false since .*16:44Z"):
        plant.start("go", "p")
    assert plant.state().running == []
    run = plant.start("go", "p", force=True)
    assert run.forced == ("(not (fault))",)
    at(clock, 10)
    assert spans(plant.end(run).broken) == [("(not (fault))", Truth.FALSE, 4, 10)]


@pytest.mark.parametrize(("t", "breaks"), [(9, True), (10, False)])
def test_a_break_at_the_expected_end_does_not_count(plant, t, breaks):
    """O6: invariants are watched in `[started, ended)`."""
    plant.add("(fault)", initial_time=START + seconds(t))
    assert bool(plant.applicable("go", "p")) is not breaks


def test_an_action_may_break_its_own_invariant_by_its_rate(plant, clock):
    """O6: to the nanosecond; the level is 30, falls by 2 a second, and has to be at least 14."""
    plant.add("(= (limit) 14)")
    (failing,) = plant.applicable("drain", "p").failing
    assert (failing.condition, failing.since) == ("(>= (level) (limit))", START + seconds(8) + 1)
    plant.add("(= (limit) 10)")
    assert plant.applicable("drain", "p")


def test_expected_ends_of_other_runs_count(plant, clock):
    """O6: the end of another run deletes an invariant of this one, or restores it in time."""
    plant.start("go", "q")
    at(clock, 5)
    # q is not ready any more from 10 on
    (failing,) = plant.applicable("lean", "q").failing
    assert (failing.condition, failing.since) == ("(ready q)", START + seconds(10))
    at(clock, 11)
    assert plant.applicable("lean", "q").failing == []  # it is overdue, and expected to run on


def test_without_a_duration_only_the_start_is_checked(plant, clock):
    """O6: where no duration is given or fixed."""
    plant.add("(= (level) 1)", initial_time=START + seconds(2))
    assert plant.applicable("loose", "p")
    assert not plant.applicable("loose", "p", duration=seconds(5))
    assert plant.applicable("loose", "p", duration=seconds(2))


# -- Q8 -----------------------------------------------------------------------------------------------------------


def test_runs_are_listed_with_their_outcome(plant, clock):
    """Q8: by start, with outcome, transactions, forced conditions, and broken ones."""
    first = plant.start("go", "p")
    at(clock, 1)
    second = plant.start("timed", "q", duration=seconds(20), force=True)
    at(clock, 2)
    plant.add("(fault)")
    at(clock, 3)
    plant.abort(first)
    at(clock, 4)
    free = plant.start("free", "p")
    done = plant.end(free)
    at(clock, 5)
    runs = plant.runs()
    assert runs == [first, second, free]
    assert [(r.outcome, r.ended, r.expected_end) for r in runs] == [
        ("aborted", START + seconds(3), START + seconds(10)),
        ("running", None, START + seconds(21)),
        ("ended", START + seconds(4), START + seconds(4)),
    ]
    assert spans(runs[0].broken) == [("(not (fault))", Truth.FALSE, 2, 3)]
    assert runs[1].forced == ("(<= ?duration 10)",)
    assert (runs[2].ended_by, runs[2].started_by) == (done.number, done.number - 1)


def test_runs_of_a_span(plant, clock):
    """Q8: `[started, ended)` overlaps the span, or the run has no length and starts in it."""
    run = plant.start("go", "p")
    at(clock, 2)
    plant.end(run)
    at(clock, 5)
    free = plant.start("free", "p")
    plant.end(free)

    def within(since, until):
        return plant.runs(since=START + since, until=START + until)

    assert within(0, 1) == [run]
    assert within(seconds(2) - 1, seconds(2)) == [run]
    assert within(seconds(2), seconds(5)) == []
    assert within(seconds(5), seconds(5) + 1) == [free]
    assert within(seconds(5) + 1, seconds(9)) == []


@pytest.mark.parametrize(
    ("pattern", "found"),
    [
        ("go", 2),
        ("GO", 2),
        ("(go p)", 1),
        ("(go ?)", 2),
        ("(go ?x)", 2),
        ("drain", 0),
        ("(free ?)", 0),
        (" ( go q ) ", 1),
    ],
)
def test_runs_by_pattern(plant, pattern, found):
    """Q8: an operator's name, or an action with ? for any object."""
    plant.start("go", "p")
    plant.start("go", "q")
    assert len(plant.runs(pattern)) == found


@pytest.mark.parametrize("pattern", ["fly", "(go)", "(go p q)", "(go p", ""])
def test_a_pattern_that_cannot_match_is_refused(plant, pattern):
    """Q8, V8: unknown operators and wrong numbers of arguments."""
    with pytest.raises(kbstore.KbStoreError):
        plant.runs(pattern)


def test_runs_as_of_an_earlier_time(plant, clock):
    """Q8: a run that ended later is running, and one that started later is not listed."""
    run = plant.start("go", "p")
    started = list(plant.changes())[-1].transaction
    plant.start("drain", "p")
    at(clock, 2)
    plant.end(run)
    plant.start("go", "q")
    assert [(r.outcome, r.ended) for r in plant.runs("go", as_of=START + seconds(1))] == [("running", None)]
    assert [r.outcome for r in plant.runs("go", as_of=START + seconds(2))] == ["ended", "running"]
    assert plant.runs(as_of=started) == [run]
    assert plant.runs(as_of=started)[0].ended_by is None


def test_an_end_does_not_fail_because_of_archived_history(kb, clock, tmp_path):
    """O6, Q7: `end` and `runs` use the history that is kept; `broken` needs all of it."""
    kb.load(
        "(define (domain shift) (:predicates (lit)) (:durative-action work :parameters ()"
        " :duration (= ?duration 30) :condition (over all (lit)) :effect (at end (lit))))",
        replace=True,
    )
    kb.add("(lit)")
    run = kb.start("work")
    for seconds_on, item in ((5, "(not (lit))"), (6, "(lit)"), (20, "(not (lit))"), (22, "(lit)")):
        clock.set(run.started + seconds(seconds_on))
        kb.add(item)
    kb.archive(run.started + seconds(10), tmp_path / "old.db")
    clock.set(run.started + seconds(30))
    expected = [(run.started + seconds(20), run.started + seconds(22))]
    assert [(broken.since, broken.until) for broken in kb.end(run).broken] == expected
    assert [(broken.since, broken.until) for broken in kb.runs()[0].broken] == expected
    with pytest.raises(kbstore.HistoryUnavailable):
        kb.broken(run)


def test_runs_of_random_spans_are_those_that_overlap(plant, clock):
    """Q8: `[started, ended)` overlaps the span, or it has no length and starts in it; among earlier and later runs."""
    for turn in range(30):
        at(clock, turn)
        for pump in ("p", "q"):
            running = [run for run in plant.state().running if run.arguments == (pump,)]
            if running and (turn + (pump == "q")) % 3:
                plant.abort(running[0])
            if not running:
                run = plant.start("free" if turn % 5 == 0 else "go", pump)
                if turn % 10 == 0:
                    plant.abort(run)
    every = plant.runs()
    assert len(every) > 20
    assert any(run.started == run.ended for run in every)
    for since in range(-1, 32, 3):
        for length in (0, 1, 2, 7, 40):
            first, last = START + seconds(since), START + seconds(since + length)
            expected = [
                run.number
                for run in every
                if run.started < last and (run.ended is None or run.ended > first or run.started == run.ended >= first)
            ]
            assert [run.number for run in plant.runs(since=first, until=last)] == expected, (since, length)
