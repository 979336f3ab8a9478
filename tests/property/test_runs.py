"""Random durative actions in kbstore and in the naive reference: runs, moving numbers, and expectations."""

from dataclasses import replace

from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, rule, run_state_machine_as_test

import kbstore
from tests.oracle import Fact, Flow, Number, Object, RefAction, RefDomain, Start, Update
from tests.property.acting import ActingAgreement
from tests.property.test_model import SETTINGS
from tests.property.universe import weighted

HALF = 500_000_000

DOMAIN = RefDomain(
    "depot",
    types={"robot": "object", "place": "object"},
    predicates={"lit": (), "ready": (("robot",),), "near": (("robot",), ("place",)), "clean": (("place",),)},
    functions={"load": (("robot",),), "cost": ()},
)

DRIVE = RefAction(
    "drive",
    ("robot", "place"),
    needs=(Fact("ready", ("0",)),),
    invariants=(Fact("ready", ("0",), positive=False),),
    at_start=(Fact("ready", ("0",), positive=False),),
    at_end=(Fact("near", ("0", "1")), Fact("ready", ("0",)), Fact("clean", ("1",), positive=False)),
    numbers_at_end=(Number("cost", (), 1.0, operation="increase"),),
    flows=(Flow(("load", ("0",)), -2.0),),
)
CHARGE = RefAction(
    "charge",
    ("robot",),
    needs=(Fact("lit"),),
    flows=(Flow(("load", ("0",)), 3.0), Flow(("cost", ()), 0.5)),
    bounds=((">=", 1.0), ("<=", ("load", ("0",)))),
)
SWEEP = RefAction(
    "sweep",
    ("place",),
    needs=(Fact("clean", ("0",), positive=False),),
    at_start=(Fact("lit"),),
    at_end=(Fact("clean", ("0",)), Fact("lit", positive=False)),
    numbers_at_end=(Number("cost", (), 2.0),),
    bounds=(("=", 2.0),),
)
GUARD = RefAction(
    "guard",
    ("robot", "place"),
    at_start=(Fact("lit", positive=False), Fact("near", ("0", "1"))),
    at_end=(Fact("near", ("0", "1"), positive=False),),
    decided_at_start=(
        (Fact("lit"), Fact("clean", ("1",))),
        (Fact("near", ("0", "1"), positive=False), Fact("lit")),
        (Fact("ready", ("0",)), Fact("near", ("0", "1"))),
    ),
)
ACTIONS = (DRIVE, CHARGE, SWEEP, GUARD)

robots = st.sampled_from(["r", "r", "s"])
places = st.sampled_from(["a", "a", "b"])
starts = weighted(
    (3, st.builds(lambda *arguments: (DRIVE, arguments), robots, places)),
    (2, st.builds(lambda *arguments: (CHARGE, arguments), robots)),
    (2, st.builds(lambda *arguments: (SWEEP, arguments), places)),
    (3, st.builds(lambda *arguments: (GUARD, arguments), robots, places)),
)
objects = st.sampled_from([Object("r", "robot"), Object("s", "robot"), Object("a", "place")])
facts = st.one_of(
    st.builds(Fact, st.just("lit"), st.just(()), st.booleans()),
    st.builds(Fact, st.just("ready"), st.tuples(robots), st.booleans()),
    st.builds(Fact, st.just("clean"), st.tuples(places), st.booleans()),
)
numbers = st.builds(
    Number,
    st.just("load"),
    st.tuples(robots),
    st.sampled_from([10.0, 64.0]),
    st.sampled_from([0.0, 0.0, 1.0]),
    st.sampled_from(["assign", "assign", "increase", "decrease"]),
)
costs = st.builds(Number, st.just("cost"), st.just(()), st.sampled_from([0.0, 8.0]))
writes = weighted(
    (2, facts.map(lambda item: Update("add", item))),
    (1, facts.map(lambda item: Update("remove", item))),
    (2, numbers.map(lambda item: Update("add", item if item.operation == "assign" else replace(item, rate=0.0)))),
    (1, costs.map(lambda item: Update("add", item))),
    (1, objects.map(lambda item: Update("add", item))),
    (1, objects.map(lambda item: Update("remove", item))),
    (1, objects.map(lambda item: Update("add", replace(item, positive=False)))),
)
ticks = st.sampled_from([0, 1, 1, 2, 3, 4]).map(lambda halves: halves * HALF)


class Missions(RuleBasedStateMachine):
    """A knowledge base and its reference, given the same updates."""

    def __init__(self, open_kb):
        super().__init__()
        self.open_kb = open_kb
        self.clock = kbstore.ManualClock(4 * HALF)
        self.both = None
        self.sound = True

    @initialize(use_unknowns=st.booleans())
    def begin(self, use_unknowns):
        kb = self.open_kb(clock=self.clock, use_unknowns=use_unknowns)
        self.both = ActingAgreement(kb, self.clock, DOMAIN, ACTIONS)
        for item in [
            *(Object("r", "robot"), Object("s", "robot"), Object("a", "place"), Object("b", "place")),
            *(Fact("ready", ("r",)), Fact("ready", ("s",)), Fact("lit"), Fact("clean", ("b",))),
            *(Fact("clean", ("a",), positive=False), Number("load", ("r",), 64.0), Number("cost", (), 0.0)),
        ]:
            self._write(Update("add", item))

    def teardown(self):
        if self.both is None:
            return
        try:
            if self.sound:
                self.both.compare_states(self._times(), 1)
        finally:
            self.both.kb.close()

    @rule(tick=ticks, update=writes, ahead=st.sampled_from([0, 0, 1, 2, 3, 5]))
    def write(self, tick, update, ahead):
        self.clock.advance(tick)
        at = self.both.now + ahead * HALF if ahead else 0
        self._write(replace(update, at=at))

    @rule(
        tick=ticks,
        update=writes,
        ago=st.integers(1, 8),
        length=st.sampled_from([None, None, 1, 3]),
        aside=st.integers(0, 1),
    )
    def write_late(self, tick, update, ago, length, aside):
        self.clock.advance(tick)
        since = max(0, self.both.now - ago * HALF - aside)
        until = None if length is None else min(self.both.now, since + length * HALF)
        self._write(replace(update, since=since, until=until))

    @rule(tick=ticks, start=starts, duration=st.integers(1, 8), force=st.sampled_from([False, False, False, True]))
    def start(self, tick, start, duration, force):
        self.clock.advance(tick)
        self._write(Update("start", Start(*start, duration * HALF, force)))

    @rule(tick=ticks, which=st.integers(0, 5), how=st.sampled_from(["end", "end", "abort"]))
    def stop(self, tick, which, how):
        self.clock.advance(tick)
        if self.both.runs:
            self._write(Update(how, list(self.both.runs)[which % len(self.both.runs)]))

    @rule(tick=ticks)
    def clear(self, tick):
        self.clock.advance(tick)
        self._write(Update("clear"))

    def _write(self, update):
        self.sound = False
        self.both.write(update)
        self.sound = True

    def _times(self):
        """Every half second at which something can happen, a nanosecond before each, and the time after."""
        moments = {event.time for event in self.both.reference.events}
        moments |= {self.both.now + ahead * HALF for ahead in range(10)}
        return sorted({t - before for t in moments for before in (0, 1)})


def test_missions_in_the_store_and_in_the_reference_agree(open_kb):
    """O1 to O3, C7, C9, C12, L6, L7: starts, ends, aborts, contributions to rates, expectations, late knowledge."""
    run_state_machine_as_test(lambda: Missions(open_kb), settings=SETTINGS)
