"""The reference knowledge base: its transactions in order, and its answers about any time."""

from collections.abc import Iterable
from dataclasses import dataclass, replace

from tests.oracle.corrections import Refused, Update
from tests.oracle.items import WILDCARD, Fact, Item, Number, Object, matches, timeline
from tests.oracle.late import FOREVER
from tests.oracle.overlay import Overlay, expect
from tests.oracle.world import Assertion, World

TOLERANCE = 1_000_000_000

Placed = tuple[Item, int]
"""An item with the time from which on it holds."""


@dataclass(frozen=True)
class Event:
    """A transaction that was accepted: its number, its time, and its updates."""

    number: int
    time: int
    updates: tuple[Update, ...]


@dataclass(frozen=True)
class Answer:
    """The state at a time; every number has its value at that time."""

    domain: str | None
    instances: frozenset[Placed]
    facts: frozenset[Placed]
    functions: frozenset[Placed]
    inequalities: frozenset[Placed]
    metric: Placed | None
    goals: frozenset[Placed]
    timed_knowledge: frozenset[Placed]
    running: frozenset[tuple[str, tuple[str, ...], int, int]] = frozenset()


@dataclass(frozen=True)
class Difference:
    """The result of `diff`, in items of the reference."""

    became_true: frozenset[Item]
    became_false: frozenset[Item]
    withdrawn: frozenset[Item]
    numbers: frozenset[tuple[str, tuple[str, ...], float | None, float | None]]
    goals_added: frozenset[Item]
    goals_removed: frozenset[Item]
    metric: tuple[str | None, str | None] | None


Row = tuple[Item, int, int | None, int, int | None, int | None, int | None]
"""An assertion of a history: item, initial and end time; who first recorded, ended, cancelled and superseded it."""


@dataclass(frozen=True)
class Change:
    """One transaction of `changes`: what it asserted, ended at its own time, cancelled and superseded."""

    number: int
    asserted: frozenset[Placed]
    ended: frozenset[Placed]
    cancelled: frozenset[Placed]
    superseded: frozenset[Placed] = frozenset()


class Reference:
    """A knowledge base as a list of transactions, with the world after each, which never changes."""

    def __init__(self, use_unknowns: bool = False) -> None:
        self.events: list[Event] = []
        self.use_unknowns = use_unknowns
        self.worlds = [World(use_unknowns=use_unknowns)]

    def before(self, number: int) -> "Reference":
        """The knowledge base as it was before a transaction."""
        past = Reference(self.use_unknowns)
        past.events, past.worlds = self.events[: number - 1], self.worlds[:number]
        return past

    @property
    def latest(self) -> Event:
        """The latest transaction; before the first, one with the number 0."""
        return self.events[-1] if self.events else Event(0, 0, ())

    def now(self, clock: int) -> int:
        """Now in questions: the later of the clock and the latest recorded time (rule T3)."""
        return max(clock, self.latest.time)

    def write(self, clock: int, updates: Iterable[Update]) -> int:
        """Make a transaction; returns how much changed. Raises `Refused`, or `Unsettled` where no rule decides."""
        if clock < self.latest.time - TOLERANCE:
            raise Refused("ClockWentBackwards", f"the clock is at {clock}, and the latest time is {self.latest.time}")
        event = Event(self.latest.number + 1, self.now(clock), tuple(updates))
        overlay = self.tried(event)
        overlay.refuse()
        changes = overlay.finish(event.number)
        if overlay.world.reads_what_moves(event.time):
            raise Refused("NotLinear", str(event))
        if changes:
            self.events.append(event)
            self.worlds.append(overlay.world)
        return changes

    def tried(self, event: Event) -> Overlay:
        """Apply the updates of an event to a copy of the latest world."""
        overlay = Overlay(self.world(), event.time)
        for update in event.updates:
            overlay.apply(update)
        return overlay

    def world(self, until: int = FOREVER, number: int = FOREVER) -> World:
        """A copy of the world after the transactions up to a time and a number."""
        past = sum(event.time <= until and event.number <= number for event in self.events)
        return self.worlds[past].copy()

    # -- questions --------------------------------------------------------------------------------------------

    def state(self, at: int, as_of: int = FOREVER, number: int = FOREVER, clock: int = 0) -> Answer:
        """The state at a time, as believed at the time `as_of`, or after the transaction `number` (rules Q1, Q2).

        Schedule, runs and domain are those of the transactions up to then: late knowledge does not change them. A run
        is expected to end as planned, if its end is after the time of asking (rule O3).
        """
        asked = min(as_of, self.now(clock))
        if number <= self.latest.number:
            asked = self.events[number - 1].time
        then = self.world(min(at, as_of), number)
        expect(then, at, asked)
        latest = max((e.time for e in self.events if e.time <= as_of and e.number <= number), default=0)
        return answer(then, at, self.world(as_of, number) if at < latest else then)

    def history(self, number: int = FOREVER) -> list[Row]:
        """Every assertion about the state and the goals, in the order of its time, then of its recording (rule Q3)."""
        world = self.world(number=number)
        world.advance(FOREVER)
        return [
            _row(assertion)
            for assertion in sorted(world.assertions, key=lambda assertion: (assertion.start, assertion.recorded))
        ]

    def changes(self) -> list[Change]:
        """Each transaction with its changes (rule Q6)."""
        world = self.world()
        world.advance(FOREVER)
        return [
            Change(
                event.number,
                frozenset(
                    (assertion.item, assertion.start)
                    for assertion in world.assertions
                    if assertion.recorded == event.number
                ),
                frozenset(
                    (assertion.item, assertion.start)
                    for assertion in world.assertions
                    if assertion.ended_by == event.number
                    and assertion.end == event.time
                    and assertion.recorded < event.number
                ),
                frozenset(
                    (assertion.item, assertion.start)
                    for assertion in world.assertions
                    if assertion.cancelled_by == event.number
                ),
                frozenset(
                    (assertion.item, assertion.start)
                    for assertion in world.assertions
                    if assertion.superseded_by == event.number
                ),
            )
            for event in self.events
        ]

    def diff(self, t1: int, t2: int) -> Difference:
        """The differences between the states at t1 and at t2 (rule Q5)."""
        before, after = self.state(t1), self.state(t2)
        items_before, items_after = _items(before), _items(after)
        lines_after = {timeline("state", item): item for item in items_after}
        values_before = {(i.name, i.arguments): i.value for i, _ in before.functions if isinstance(i, Number)}
        values_after = {(i.name, i.arguments): i.value for i, _ in after.functions if isinstance(i, Number)}
        goals_before = frozenset(goal for goal, _ in before.goals)
        goals_after = frozenset(goal for goal, _ in after.goals)
        metrics = tuple(getattr(state.metric[0], "text", None) if state.metric else None for state in (before, after))
        return Difference(
            became_true=frozenset(item for item in items_after - items_before if _positive(item)),
            became_false=frozenset(item for item in items_after - items_before if not _positive(item)),
            withdrawn=frozenset(
                item
                for item in items_before - items_after
                if isinstance(item, Object) or timeline("state", item) not in lines_after
            ),
            numbers=frozenset(
                (*term, values_before.get(term), values_after.get(term))
                for term in values_before.keys() | values_after.keys()
                if values_before.get(term) != values_after.get(term)
            ),
            goals_added=goals_after - goals_before,
            goals_removed=goals_before - goals_after,
            metric=None if metrics[0] == metrics[1] else (metrics[0], metrics[1]),
        )

    def sign(self, fact: Fact, at: int) -> bool | None:
        """True where a fact is asserted, False where it is explicitly false, None where it is absent (rule V2)."""
        signs = [
            item.positive
            for item, _ in self.state(at).facts
            if isinstance(item, Fact) and (item.name, item.arguments) == (fact.name, fact.arguments)
        ]
        return signs[0] if signs else None

    def some_sign(self, pattern: Fact, at: int) -> list[Fact]:
        """All facts of either sign that a question's pattern matches at a time (rule V7)."""
        return [
            item
            for item, _ in self.state(at).facts
            if isinstance(item, Fact) and matches(replace(pattern, positive=item.positive), item)
        ]

    def reason(self, fact: Fact, at: int) -> tuple[str, int | None]:
        """Why a fact holds or not at a time, with the number of the transaction that made it so (rule V6)."""
        assert WILDCARD not in fact.arguments
        world = self.world()
        world.advance(at)
        line = timeline("state", fact)
        holding = [assertion for assertion in world.assertions if assertion.timeline == line and assertion.holds_at(at)]
        if holding:
            assert isinstance(holding[0].item, Fact)
            return ("asserted" if holding[0].item.positive else "explicitly false"), holding[0].first_recorded
        lines = [assertion for assertion in world.assertions if assertion.timeline == line]
        ended = [
            assertion
            for assertion in lines
            if not assertion.superseded_by and assertion.end is not None and assertion.end <= at
        ]
        superseded = [
            assertion.superseded_by for assertion in lines if assertion.superseded_by and assertion.start <= at
        ]
        if not ended:
            return ("removed", max(superseded)) if superseded else ("never told", None)
        last = max(ended, key=lambda assertion: (assertion.end or 0, assertion.start, assertion.recorded))
        return ("expired with its instance" if last.end_cause == "object" else "removed"), last.ended_by


def answer(then: World, at: int, known: World | None = None) -> Answer:
    """The state of a world at a time: what holds then, and what is scheduled after it.

    `known` is a later world, which may have late knowledge of this time; if given, it decides what holds.
    """
    then.advance(at)
    known = known or then
    holding = [assertion for assertion in known.assertions if assertion.holds_at(at)]

    def items(role: str, *kinds: str) -> frozenset[Placed]:
        return frozenset(
            (_valued(known, assertion, at), assertion.start)
            for assertion in holding
            if assertion.timeline[0] == role and (not kinds or assertion.timeline[1] in kinds)
        )

    metrics = items("state", "metric")
    return Answer(
        domain=then.domain.name if then.domain else None,
        instances=frozenset(
            (item, start) for item, start in items("state", "object") if isinstance(item, Object) and item.positive
        ),
        facts=items("state", "fact"),
        functions=items("state", "function"),
        inequalities=items("state", "inequality"),
        metric=next(iter(metrics), None),
        goals=items("goal"),
        timed_knowledge=frozenset(
            (assertion.item, start) for (line, start), assertion in then.pending.items() if line[0] == "state"
        ),
        running=frozenset(
            (run.start.action.name, run.start.arguments, run.started, run.start.duration) for run in then.running
        ),
    )


def _valued(world: World, assertion: Assertion, at: int) -> Item:
    if isinstance(assertion.item, Number):
        return replace(assertion.item, value=world.value(assertion.item, assertion.start, at))
    return assertion.item


def _row(assertion: Assertion) -> Row:
    if assertion.cancelled_by:
        return assertion.item, assertion.start, assertion.start, assertion.recorded, None, assertion.cancelled_by, None
    return (
        assertion.item,
        assertion.start,
        assertion.end,
        assertion.first_recorded,
        assertion.ended_by,
        None,
        assertion.superseded_by,
    )


def _positive(item: Item) -> bool:
    return getattr(item, "positive", True)


def _items(state: Answer) -> frozenset[Item]:
    return frozenset(item for item, _ in state.instances | state.facts | state.inequalities)
