"""Random stories of actions whose rates change, whose invariants break and whose effects are sensed (O3, O5 to O8).

Everything happens at quarters of a second, and all numbers are small, so that sums are exact. The answers of kbstore
are compared with the naive reference at every event and one nanosecond to each side of it.
"""

from contextlib import suppress
from dataclasses import replace

from hypothesis import given, settings
from hypothesis import strategies as st

import kbstore
from kbstore import Truth
from tests.oracle import Fact, Flow, Limit, Number, Object, RefAction, RefDomain, Start, Unsettled, Update
from tests.oracle.overlay import expect
from tests.property import translation
from tests.property.acting import ActingAgreement
from tests.property.test_model import EXAMPLES, SETTINGS
from tests.property.universe import weighted

QUARTER = 250_000_000
BEGIN = 8 * QUARTER

LEVEL, INFLOW, AREA, DRIFT = ("level", ("0",)), ("inflow", ("0",)), ("area", ()), ("drift", ())
OPEN = Fact("open", ("0",))
DOMAIN = RefDomain(
    "tanks",
    types={"tank": "object"},
    predicates={"open": (("tank",),), "full": (("tank",),), "calm": ()},
    functions={"level": (("tank",),), "inflow": (("tank",),), "area": (), "drift": ()},
)
ACTIONS = (
    RefAction(
        "fill",
        ("tank",),
        invariants=(Limit("level", ("0",), "<=", 6.0),),
        at_end=(Fact("full", ("0",)),),
        flows=(Flow(LEVEL, factors=((1.0, INFLOW),)),),
    ),
    RefAction(
        "leak",
        ("tank",),
        at_start=(OPEN,),
        flows=(Flow(LEVEL, 0.5, factors=((-2.0, INFLOW),), condition=OPEN),),
    ),
    RefAction("share", ("tank",), flows=(Flow(LEVEL, factors=((2.0, INFLOW),), divisor=AREA),)),
    RefAction(
        "latch",
        ("tank",),
        at_start=(Fact("open", ("0",), positive=False),),
        flows=(Flow(LEVEL, 1.0, at_start=OPEN), Flow(DRIFT, 2.0)),
    ),
    RefAction(
        "boost",
        ("tank",),
        needs=(Fact("full", ("0",), positive=False),),
        invariants=(Fact("calm"),),
        numbers_at_start=(Number("inflow", ("0",), 4.0),),
        at_end=(OPEN,),
        numbers_at_end=(Number("inflow", ("0",), 1.0),),
        bounds=((">=", 0.5), ("<=", ("area", ()))),
    ),
    RefAction(
        "watch",
        ("tank",),
        invariants=(OPEN, Fact("full", ("0",), positive=False), Limit("level", ("0",), ">", -1.0)),
        at_start=(OPEN, Fact("calm", positive=False)),
        at_end=(Fact("open", ("0",), positive=False), Fact("calm")),
        decided_at_start=((OPEN, Fact("full", ("0",))),),
    ),
    RefAction("grow", (), flows=(Flow(AREA, 1.0, condition=Fact("calm", positive=False)), Flow(DRIFT, -1.0))),
    RefAction("widen", (), numbers_at_end=(Number("area", (), 2.0, operation="increase"),), invariants=(Fact("calm"),)),
)
CONDITIONS = (
    Limit("level", ("a",), ">", 2.0),
    Limit("level", ("b",), "<=", 1.0),
    Limit("drift", (), ">=", 0.0),
    Fact("open", ("a",)),
    Fact("full", ("a",), positive=False),
    Fact("calm"),
)

tanks = st.sampled_from(["a", "a", "b"])
facts = st.one_of(
    st.builds(Fact, st.just("open"), st.tuples(tanks), st.booleans()),
    st.builds(Fact, st.just("full"), st.tuples(tanks), st.booleans()),
    st.builds(Fact, st.just("calm"), st.just(()), st.booleans()),
)
values = st.sampled_from([0.0, 1.0, 2.0, 4.0, -2.0])
numbers = weighted(
    (3, st.builds(Number, st.just("inflow"), st.tuples(tanks), values)),
    (2, st.builds(Number, st.just("level"), st.tuples(tanks), values, st.sampled_from([0.0, 0.0, 1.0]))),
    (2, st.builds(Number, st.just("area"), st.just(()), values)),
    (1, st.builds(Number, st.just("inflow"), st.tuples(tanks), st.just(1.0), st.just(1.0))),
    (1, st.builds(Number, st.just("drift"), st.just(()), values, st.sampled_from([0.0, 1.0]))),
)
changes = st.builds(
    Number,
    st.sampled_from(["level", "inflow"]),
    st.tuples(tanks),
    st.sampled_from([1.0, 2.0]),
    st.just(0.0),
    st.sampled_from(["increase", "decrease", "assign_cts"]),
)
writes = weighted(
    (3, facts.map(lambda item: Update("add", item))),
    (1, facts.map(lambda item: Update("remove", item))),
    (5, numbers.map(lambda item: Update("add", item))),
    (1, changes.map(lambda item: Update("add", item))),
    (2, numbers.map(lambda item: Update("remove", item))),
)
names = st.sampled_from([action.name for action in ACTIONS])
lengths = st.integers(1, 12)
steps = weighted(
    (3, st.tuples(st.just("write"), writes)),
    (3, st.tuples(st.just("schedule"), writes, lengths)),
    (4, st.tuples(st.just("late"), writes, lengths, st.one_of(st.none(), st.integers(1, 6)))),
    (
        5,
        st.tuples(
            st.just("start"),
            st.sampled_from([act.name for act in ACTIONS]),
            tanks,
            lengths,
            st.sampled_from([False, False, True]),
        ),
    ),
    (3, st.tuples(st.sampled_from(["end", "end", "abort"]), st.integers(0, 4))),
)
stories = st.lists(st.tuples(st.sampled_from([0, 1, 2, 2, 3, 4, 6]), steps), min_size=8, max_size=14)
beginnings = st.tuples(st.booleans(), st.frozensets(st.sampled_from(["open", "calm", "level", "inflow"]), max_size=2))


class Acting(ActingAgreement):
    """A knowledge base and its reference, given the same updates."""

    def __init__(self, kb, clock, sensed):
        clock.set(BEGIN)
        super().__init__(kb, clock, DOMAIN, ACTIONS, sensed=sensed)
        for item in [
            *(Object("a", "tank"), Object("b", "tank"), Fact("calm"), Fact("open", ("a",))),
            *(Number("level", ("a",), 0.0), Number("level", ("b",), 2.0), Number("drift", (), 0.0)),
            *(Number("inflow", ("a",), 1.0), Number("inflow", ("b",), -1.0), Number("area", (), 2.0)),
            *(Fact("full", (tank,), positive=False) for tank in "ab"),
        ]:
            self.write(Update("add", item))

    # -- doing ------------------------------------------------------------------------------------------------

    def step(self, tick, what, *rest):
        self.clock.advance(tick * QUARTER)
        match what, rest:
            case "write", (update,):
                self.write(update)
            case "schedule", (update, ahead):
                self.write(replace(update, at=self.now + ahead * QUARTER))
            case "late", (update, ago, length):
                since = max(0, self.now - ago * QUARTER)
                until = None if length is None else min(self.now, since + length * QUARTER)
                self.write(replace(update, since=since, until=until))
            case "start", (name, tank, lasts, force):
                action = next(act for act in ACTIONS if act.name == name)
                start = Start(action, (tank,) if action.types else (), lasts * QUARTER, force)
                self.write(Update("start", start))
            case _, (which,):
                running = [start for start, run in self.runs.items() if run in self._running()]
                if running:
                    self.write(Update(what, running[which % len(running)]))

    def refused(self, update, error):
        """O6, O7: what cannot be started is not applicable, unless it runs already."""
        start = update.item
        if update.what != "start" or error != "NotApplicable" or start.force:
            return
        if (start.action.name, start.arguments) not in {(run.operator, run.arguments) for run in self._running()}:
            assert not self.kb.applicable(start.action.name, *start.arguments, duration=start.duration)

    def _running(self):
        return self.kb.state().running

    # -- comparing --------------------------------------------------------------------------------------------

    def moments(self):
        """Every time of a past or a scheduled event."""
        world = self.reference.world()
        found = {event.time for event in self.reference.events} | {self.now, self.now + 20 * QUARTER}
        for each in world.assertions:
            found |= {each.start, each.start if each.end is None else each.end}
        return sorted(found | {run.expected_end for run in world.runs})

    def times(self):
        return sorted({max(0, t + side) for t in self.moments() for side in (-1, 0, 1)})

    def compare_everything(self):
        times = self.times()
        self.compare_states(times, 2)
        self._compare_when(times)
        self._compare_runs(times)

    def _world(self, at):
        """The state known now of a time, or expected of it."""
        world = self.reference.world()
        if at > self.now:
            expect(world, at, self.now)
        else:
            world.advance(self.now)
        return world

    def _compare_when(self, times):
        """Q4: the spans contain the times at which a condition is true, and no nanosecond more."""
        begin, end = times[0], times[-1] + 1
        for wanted in CONDITIONS:
            spans = self.kb.when(translation.text(wanted), begin, end)
            edges = {t + side for span in spans for t in span for side in (-1, 0) if begin <= t + side < end}
            for t in sorted({*times, *edges}):
                with suppress(Unsettled):
                    expected = self._world(t).truth(wanted, t) is True
                    assert any(since <= t < until for since, until in spans) == expected, (wanted, t, spans)

    def _compare_runs(self, times):
        """Q8, O6, O7: all runs, how they ended, and when their invariants were not true."""
        given = self.kb.runs()
        world = self.reference.world()
        world.advance(self.now)
        expected = sorted(world.runs, key=lambda run: (run.started, run.started_by))
        assert [
            (
                run.operator,
                run.arguments,
                run.started,
                run.duration,
                run.ended,
                run.outcome,
                run.started_by,
                run.ended_by,
            )
            for run in given
        ] == [
            (
                *(run.start.action.name, run.start.arguments, run.started, run.start.duration),
                *(run.ended, run.outcome, run.started_by, run.ended_by),
            )
            for run in expected
        ]
        for run, other in zip(given, expected, strict=True):
            assert len(run.forced) == len(other.forced), (run, run.forced, other.forced)
            last = self.now + 1 if other.ended is None else other.ended
            for wanted in other.start.facts(other.start.action.invariants):
                broken = [found for found in run.broken if found.condition == translation.text(wanted)]
                spans = [(found.since, last if found.until is None else found.until, found.truth) for found in broken]
                edges = {t + side for since, until, _ in spans for t in (since, until) for side in (-1, 0)}
                for t in sorted(t for t in {*times, *edges} if run.started <= t < last):
                    truth = world.truth(wanted, t, other)
                    expected_truth = Truth.UNKNOWN if truth is None else Truth.of(truth)
                    found = [truth for since, until, truth in spans if since <= t < until] or [Truth.TRUE]
                    assert found == [expected_truth], (str(run), wanted, t, spans)
                assert all(found.until is not None or other.ended is None for found in broken)


def test_random_actions_agree_with_the_reference(open_kb):
    """O3, O5 to O8, L6, L7, Q4, Q8: at every event, and one nanosecond to each side."""

    @settings(SETTINGS, max_examples=EXAMPLES or 15)
    @given(beginning=beginnings, story=stories)
    def agree(beginning, story):
        clock = kbstore.ManualClock(BEGIN)
        kb = open_kb(clock=clock, use_unknowns=beginning[0])
        try:
            both = Acting(kb, clock, beginning[1])
            for tick, step in story:
                both.step(tick, *step)
            both.compare_everything()
        finally:
            kb.close()

    agree()
