"""Random stories of numbers that follow what their rates read, against a sum over half seconds (O5, O3, Q2).

All times are half seconds and all numbers small integers, so that the sums are exact.
"""

from dataclasses import dataclass, field
from itertools import count

from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as st

import kbstore
from tests.property.test_model import EXAMPLES

HALF = 500_000_000
DOMAIN = """
(define (domain tanks)
  (:predicates (open))
  (:functions (level) (inflow))
  (:durative-action fill :parameters () :duration (>= ?duration 0) :effect (increase (level) (* #t (inflow))))
  (:durative-action leak :parameters () :duration (>= ?duration 0)
    :effect (when (over all (open)) (decrease (level) (* #t (* 2 (inflow))))))
  (:durative-action boost :parameters () :duration (>= ?duration 0)
    :effect (and (at start (assign (inflow) 5)) (at end (assign (inflow) 1)) (at end (open)))))
"""
ACTIONS = ("fill", "leak", "boost")


@dataclass
class Story:
    """The transactions of a story, at half seconds; answers by adding up from the beginning."""

    events: list[tuple[int, str, object]] = field(default_factory=list)

    def level(self, at: int, now: int, known: int) -> float:
        """The level at a half second, by the first `known` events, asked at `now`."""
        events = self.events[:known]
        level, inflow, is_open = 0.0, 0.0, False
        scheduled: dict[tuple[str, int], float] = {}
        running: dict[str, tuple[int, int]] = {}
        for t in range(at + 1):
            for key in [key for key in scheduled if key[1] == t]:
                name, value = key[0], scheduled.pop(key)
                level, inflow = (value, inflow) if name == "level" else (level, value)
            if t > now:
                for name, (_, end) in list(running.items()):
                    if end == t:
                        del running[name]
                        inflow, is_open = (1.0, True) if name == "boost" else (inflow, is_open)
            for time, what, given_ in events:
                if time != t:
                    continue
                if what in ("level", "inflow"):
                    level, inflow = (given_, inflow) if what == "level" else (level, given_)
                elif what == "open":
                    is_open = bool(given_)
                elif what.startswith("later"):
                    delay, value = given_
                    if value is None:
                        scheduled.pop((what[6:], t + delay), None)
                    else:
                        scheduled[what[6:], t + delay] = value
                elif what == "start":
                    name, lasts = given_
                    running[name] = (t, t + lasts)
                    inflow = 5.0 if name == "boost" else inflow
                else:
                    del running[given_]
                    inflow, is_open = (1.0, True) if (what, given_) == ("end", "boost") else (inflow, is_open)
            if t < at:
                rate = inflow * ("fill" in running) - 2 * inflow * ("leak" in running and is_open)
                level += rate / 2
        return level


numbers = st.integers(-3, 4).map(float)
ahead = st.integers(1, 6)
steps = st.one_of(
    st.tuples(st.just("inflow"), numbers),
    st.tuples(st.just("level"), numbers),
    st.tuples(st.just("open"), st.booleans()),
    st.tuples(st.just("later inflow"), st.tuples(ahead, st.one_of(numbers, numbers, st.none()))),
    st.tuples(st.just("later level"), st.tuples(ahead, st.one_of(numbers, st.none()))),
    st.tuples(st.just("start"), st.tuples(st.sampled_from(ACTIONS), st.integers(1, 8))),
    st.tuples(st.sampled_from(["end", "abort"]), st.sampled_from(ACTIONS)),
)
stories = st.lists(st.tuples(st.integers(0, 3), steps), min_size=3, max_size=14)
names = count()


@given(updates=stories)
@settings(
    max_examples=EXAMPLES or 60,
    derandomize=not EXAMPLES,
    deadline=None,
    database=None,
    phases=[Phase.generate, Phase.shrink] if EXAMPLES else [Phase.generate],
    suppress_health_check=list(HealthCheck),
)
def test_levels_follow_what_their_rates_read(open_kb, updates):
    """O5: at every half second, past and expected, as known now and as of every transaction."""
    clock = kbstore.ManualClock(0)
    kb = open_kb(f"rates-{next(names)}", clock=clock)
    story, runs, transactions, t = Story(), {}, [], 1
    clock.set(HALF)
    kb.load(DOMAIN)
    with kb.transaction() as tx:
        tx.add("(= (level) 0)", "(= (inflow) 0)")
    latest = tx.result.number
    story.events += [(1, "level", 0.0), (1, "inflow", 0.0)]
    for tick, (what, given_) in updates:
        t += tick
        clock.set(t * HALF)
        match what:
            case "inflow" | "level":
                kb.add(f"(= ({what}) {given_:g})")
            case "open":
                kb.add("(open)") if given_ else kb.remove("(open)")
            case "later inflow" | "later level":
                delay, value = given_
                name = what.split()[1]
                if value is None:
                    kb.remove(f"({name})", initial_time=(t + delay) * HALF)
                else:
                    kb.add(f"(= ({name}) {value:g})", initial_time=(t + delay) * HALF)
            case "start":
                name, lasts = given_
                if name in runs:
                    continue
                runs[name] = kb.start(name, duration=lasts * HALF)
            case _:
                if given_ not in runs:
                    continue
                getattr(kb, what)(runs.pop(given_))
        story.events.append((t, what, given_))
        for change in kb.changes(after=latest):
            latest = change.number
            transactions.append((change.transaction, len(story.events), t))
        for at in range(max(1, t - 4), t + 12):
            assert kb.value("(level)", at=at * HALF) == story.level(at, t, len(story.events)), (at, t)
    for transaction, known, then in transactions:
        for at in range(1, t + 12, 2):
            if at >= then:
                expected = story.level(at, then, known)
                assert kb.value("(level)", at=at * HALF, as_of=transaction) == expected, (at, transaction)
    kb.close()
