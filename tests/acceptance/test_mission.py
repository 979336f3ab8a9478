"""A mission replayed from its plan, and each of its states as a table written by hand (O1 to O3, Q2, T5).

Every action moves the rover's battery: driving costs 2 at once and 0.5 a second, surveying 0.25 a second, and its panel
gives 1.5 a second as long as it is day, which it is from 10 to 70 s.
"""

import pytest

from kbstore import NotApplicable, seconds
from tests.acceptance.conftest import BEGIN

ROVER = """
(define (domain rover)
  (:requirements :typing :fluents :durative-actions :duration-inequalities :continuous-effects :timed-initial-literals)
  (:types place)
  (:predicates (rover_at ?p - place) (day) (surveyed))
  (:functions (battery) (odometer) (lasted) (distance ?a ?b - place))
  (:durative-action drive :parameters (?a ?b - place)
    :duration (= ?duration (/ (distance ?a ?b) 2))
    :condition (and (at start (rover_at ?a)) (over all (> (battery) 10)))
    :effect (and (at start (not (rover_at ?a))) (at end (rover_at ?b)) (at start (decrease (battery) 2))
                 (decrease (battery) (* #t 0.5)) (at end (increase (odometer) (distance ?a ?b)))))
  (:durative-action survey :parameters ()
    :duration (and (>= ?duration 5) (<= ?duration 60))
    :effect (and (decrease (battery) (* #t 0.25)) (at end (surveyed)) (at end (assign (lasted) ?duration))))
  (:durative-action sun :parameters ()
    :duration (<= ?duration 100)
    :condition (over all (day))
    :effect (increase (battery) (* #t 1.5))))
"""
PROBLEM = """
(define (problem p) (:domain rover)
  (:objects base ridge - place)
  (:init (rover_at base) (= (battery) 50) (= (odometer) 0) (= (distance base ridge) 40) (= (distance ridge base) 40)
         (at 10 (day)) (at 70 (not (day))))
  (:goal (and)))
"""

# the steps and their times; ends and aborts find their runs in the state
PLAN = """
  5   start drive base ridge
  12  start sun 30
  15  start survey 20
  25  end drive
  30  restart
  38  end survey
  40  correct the battery to 60
  46  abort sun
  50  start drive ridge base
  56  abort drive
  57  found at ridge
  60  force sun 20
  72  abort sun
"""

# the state from a time on, until the next event or question
TABLE = """
  t    battery  odometer  lasted  running           facts
  0    50       0         -       -                 base
  5    48       0         -       drive             -
  10   45.5     0         -       drive             day
  12   44.5     0         -       drive,sun         day
  13   45.5     0         -       drive,sun         day
  15   47.5     0         -       drive,sun,survey  day
  17   49       0         -       drive,sun,survey  day
  25   55       40        -       sun,survey        ridge,day
  30   61.25    40        -       sun,survey        ridge,day
  35   67.5     40        -       sun,survey        ridge,day
  38   71.25    40        20      sun               ridge,day,surveyed
  39   72.75    40        20      sun               ridge,day,surveyed
  40   60       40        20      sun               ridge,day,surveyed
  42   63       40        20      sun               ridge,day,surveyed
  46   69       40        20      -                 ridge,day,surveyed
  49   69       40        20      -                 ridge,day,surveyed
  50   67       40        20      drive             day,surveyed
  56   64       40        20      -                 day,surveyed
  57   64       40        20      -                 ridge,day,surveyed
  60   64       40        20      sun               ridge,day,surveyed
  70   79       40        20      sun               ridge,surveyed
  72   82       40        20      -                 ridge,surveyed
  90   82       40        20      -                 ridge,surveyed
"""

# expectations at some times: of times that are past, late, or after an abort
BELIEFS = """
  as_of  t    battery  odometer  lasted  running           facts
  4      50   50       0         -       -                 base,day
  4      70   50       0         -       -                 base
  6      25   38       40        -       -                 ridge,day
  6      80   38       40        -       -                 ridge
  16     24   54.25    0         -       drive,sun,survey  day
  16     25   55       40        -       sun,survey        ridge,day
  16     35   67.5     40        20      sun               ridge,day,surveyed
  16     42   78       40        20      -                 ridge,day,surveyed
  16     75   78       40        20      -                 ridge,surveyed
  36     42   76.25    40        -       survey            ridge,day
  36     50   74.25    40        -       survey            ridge,day
  45     60   90       40        20      sun               ridge,day,surveyed
  52     70   57       80        20      -                 base,surveyed
  61     80   94       40        20      -                 ridge,surveyed
"""


def rows(table):
    """The rows of a table, each as a mapping from its headings."""
    headings, *lines = (line.split() for line in table.strip().splitlines())
    return [dict(zip(headings, line, strict=True)) for line in lines]


def seen(state):
    """A state as a row of the table."""
    places = [f.values[0].value for f in state.facts if f.attribute_name == "rover_at"]
    flags = [f.attribute_name for f in state.facts if f.attribute_name in ("day", "surveyed") and not f.is_negative]
    numbers = {f.attribute_name: f"{f.function_value:g}" for f in state.functions}
    return {
        "battery": numbers["battery"],
        "odometer": numbers["odometer"],
        "lasted": numbers.get("lasted", "-"),
        "running": ",".join(run.operator for run in state.running) or "-",
        "facts": ",".join(places + sorted(flags)) or "-",
    }


def without(row, *headings):
    return {heading: cell for heading, cell in row.items() if heading not in headings}


class Replay:
    """Carries out the plan, line by line; a store that outlives the process is reopened in the middle."""

    def __init__(self, open_kb, clock, *, can_reopen):
        self._open = open_kb
        self._clock = clock
        self._can_reopen = can_reopen
        self._left = PLAN.strip().splitlines()
        self.kb = open_kb()
        self.kb.load(ROVER, PROBLEM)

    def until(self, t):
        """Carry out everything up to a time, which is now then."""
        while self._left and float(self._left[0].split()[0]) <= t:
            self._do(*self._left.pop(0).split())
        self._clock.set(BEGIN + seconds(t))

    def _do(self, at, *what):
        self._clock.set(BEGIN + seconds(at))
        match what:
            case "start", "drive", origin, target:
                self.kb.start("drive", origin, target)
            case "start", operator, lasts:
                self.kb.start(operator, duration=seconds(lasts))
            case "force", operator, lasts:
                # it will be night before its end (O6)
                with pytest.raises(NotApplicable, match=r"\(day\) is false since 1970-01-01T00:17:50Z"):
                    self.kb.start(operator, duration=seconds(lasts))
                assert self.kb.start(operator, duration=seconds(lasts), force=True).forced == ("(day)",)
            case "end", operator:
                assert self.kb.end(self._running(operator))
            case "abort", operator:
                self.kb.abort(self._running(operator))
            case "correct", *_, value:
                self.kb.add(f"(= (battery) {value})")
            case "found", "at", place:
                self.kb.add(f"(rover_at {place})")
            case _:
                assert what == ("restart",)
                if self._can_reopen:
                    self.kb.close()
                    self.kb = self._open(self.kb.name)

    def _running(self, operator):
        """The run, found by a process that did not start it."""
        (run,) = [run for run in self.kb.state().running if run.operator == operator]
        return run


@pytest.fixture
def replay(open_kb, clock, store_url):
    return Replay(open_kb, clock, can_reopen=store_url != "sqlite://")


def test_each_state_is_that_of_the_table(replay):
    """O2, O3: right after each event, and at any time between two."""
    for row in rows(TABLE):
        replay.until(float(row["t"]))
        assert {"t": row["t"], **seen(replay.kb.state())} == row


def test_past_states_do_not_change(replay):
    """T5: at the end of the mission each past state is still that of the table, to the last nanosecond of its row."""
    replay.until(90)
    table = rows(TABLE)
    for row, following in zip(table, [*table[1:], None], strict=True):
        at = BEGIN + seconds(row["t"])
        assert {"t": row["t"], **seen(replay.kb.state(at=at))} == row
        if following is not None:
            last = seen(replay.kb.state(at=BEGIN + seconds(following["t"]) - 1))
            assert without(last, "battery") == without(row, "t", "battery")


def test_each_expectation_is_that_of_the_table(replay):
    """O3, Q2: asked when it was expected, and asked at the end."""
    expectations = rows(BELIEFS)
    for row in expectations:
        replay.until(float(row["as_of"]))
        assert {**row, **seen(replay.kb.state(at=BEGIN + seconds(row["t"])))} == row
    replay.until(90)
    for row in expectations:
        belief = replay.kb.state(at=BEGIN + seconds(row["t"]), as_of=BEGIN + seconds(row["as_of"]))
        assert {**row, **seen(belief)} == row


def test_an_over_all_condition_that_breaks_is_found_by_asking(replay):
    """O1, O6, Q4: the panel ran on for two seconds into the night, and cannot be started again in it."""
    replay.until(75)
    kb = replay.kb
    (run,) = kb.state(at=BEGIN + seconds(71)).running
    assert kb.when("(not (day))", run.started, BEGIN + seconds(72)) == [(BEGIN + seconds(70), BEGIN + seconds(72))]
    assert [(b.condition, b.since, b.until) for b in kb.broken(run)] == [
        ("(day)", BEGIN + seconds(70), BEGIN + seconds(72))
    ]
    with pytest.raises(NotApplicable, match=r"\(day\) is false since 1970-01-01T00:17:50Z"):
        kb.start("sun", duration=seconds(5))


def test_the_battery_crosses_a_level_when_the_table_says_so(replay):
    """Q4: 60 on the way up from 55 at 25 s by 1.25 a second; not on the way down, as 69, 67 and 64 are above it."""
    replay.until(90)
    above = replay.kb.when("(> (battery) 60)", BEGIN, BEGIN + seconds(90))
    # corrected to exactly 60 at 40 s, and above it a nanosecond later
    assert above == [
        (BEGIN + seconds(29) + 1, BEGIN + seconds(40)),
        (BEGIN + seconds(40) + 1, BEGIN + seconds(90)),
    ]
