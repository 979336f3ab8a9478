"""The reference's memory: the transactions in their order, and what they answer about any time."""

from collections.abc import Iterable
from dataclasses import dataclass, replace

from tests.oracle.corrections import Refused, Update
from tests.oracle.items import WILDCARD, Fact, Item, Number, Object, matches, timeline
from tests.oracle.late import FOREVER
from tests.oracle.overlay import Overlay, expect
from tests.oracle.world import Told, World

TOLERANCE = 1_000_000_000

Placed = tuple[Item, int]
"""An item with the time from which on it stands (or will stand)."""


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
    """What `diff` says, with items as the reference has them."""

    became_true: frozenset[Item]
    became_false: frozenset[Item]
    withdrawn: frozenset[Item]
    numbers: frozenset[tuple[str, tuple[str, ...], float | None, float | None]]
    goals_added: frozenset[Item]
    goals_removed: frozenset[Item]
    metric: tuple[str | None, str | None] | None


Row = tuple[Item, int, int | None, int, int | None, int | None, int | None]
"""One assertion of a history: item, initial and end time; who told it first, ended, cancelled and superseded it."""


@dataclass(frozen=True)
class Change:
    """One transaction of `changes`: what it asserted, ended at its own time, cancelled and superseded."""

    number: int
    asserted: frozenset[Placed]
    ended: frozenset[Placed]
    cancelled: frozenset[Placed]
    superseded: frozenset[Placed] = frozenset()


class Reference:
    """A knowledge base that remembers its transactions, and what is believed after each, which nobody changes."""

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
            raise Refused("ClockWentBackwards", f"the clock says {clock}, and the latest time is {self.latest.time}")
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
        """A transaction as it would be, on top of all that came before."""
        overlay = Overlay(self.world(), event.time)
        for update in event.updates:
            overlay.apply(update)
        return overlay

    def world(self, until: int = FOREVER, number: int = FOREVER) -> World:
        """What is believed after the transactions up to a time and a number: a world of the caller's own."""
        past = sum(event.time <= until and event.number <= number for event in self.events)
        return self.worlds[past].copy()

    # -- questions --------------------------------------------------------------------------------------------

    def state(self, at: int, as_of: int = FOREVER, number: int = FOREVER, clock: int = 0) -> Answer:
        """The state at a time, as believed at the time `as_of`, or after the transaction `number` (rules Q1, Q2).

        What is scheduled and what runs then, and the domain, is what the transactions up to then said: late knowledge
        does not bear on it. What runs is expected to end as it was meant to, if that lies after the time of asking
        (rule O3).
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
        return [_row(told) for told in sorted(world.told, key=lambda told: (told.start, told.recorded))]

    def changes(self) -> list[Change]:
        """Each transaction with what it did (rule Q6)."""
        world = self.world()
        world.advance(FOREVER)
        return [
            Change(
                event.number,
                frozenset((told.item, told.start) for told in world.told if told.recorded == event.number),
                frozenset(
                    (told.item, told.start)
                    for told in world.told
                    if told.ended_by == event.number and told.end == event.time and told.recorded < event.number
                ),
                frozenset((told.item, told.start) for told in world.told if told.cancelled_by == event.number),
                frozenset((told.item, told.start) for told in world.told if told.superseded_by == event.number),
            )
            for event in self.events
        ]

    def diff(self, t1: int, t2: int) -> Difference:
        """What is said at t2 and was not at t1, and the reverse (rule Q5)."""
        before, after = self.state(t1), self.state(t2)
        told_before, told_after = _said(before), _said(after)
        lines_after = {timeline("state", item): item for item in told_after}
        values_before = {(i.name, i.arguments): i.value for i, _ in before.functions if isinstance(i, Number)}
        values_after = {(i.name, i.arguments): i.value for i, _ in after.functions if isinstance(i, Number)}
        goals_before = frozenset(goal for goal, _ in before.goals)
        goals_after = frozenset(goal for goal, _ in after.goals)
        metrics = tuple(getattr(state.metric[0], "text", None) if state.metric else None for state in (before, after))
        return Difference(
            became_true=frozenset(item for item in told_after - told_before if _positive(item)),
            became_false=frozenset(item for item in told_after - told_before if not _positive(item)),
            withdrawn=frozenset(
                item
                for item in told_before - told_after
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
        stands = [told for told in world.told if told.timeline == line and told.stands_at(at)]
        if stands:
            assert isinstance(stands[0].item, Fact)
            return ("asserted" if stands[0].item.positive else "explicitly false"), stands[0].first_told
        lines = [told for told in world.told if told.timeline == line]
        ended = [told for told in lines if not told.superseded_by and told.end is not None and told.end <= at]
        superseded = [told.superseded_by for told in lines if told.superseded_by and told.start <= at]
        if not ended:
            return ("removed", max(superseded)) if superseded else ("never told", None)
        last = max(ended, key=lambda told: (told.end or 0, told.start, told.recorded))
        return ("expired with its instance" if last.end_cause == "object" else "removed"), last.ended_by


def answer(then: World, at: int, known: World | None = None) -> Answer:
    """What a world says at a time: what stands then, and what is scheduled after it.

    `known` is a later world, which may know of this time by late knowledge; then what stands is what it knows.
    """
    then.advance(at)
    known = known or then
    stands = [told for told in known.told if told.stands_at(at)]

    def standing(role: str, *kinds: str) -> frozenset[Placed]:
        return frozenset(
            (_valued(known, told, at), told.start)
            for told in stands
            if told.timeline[0] == role and (not kinds or told.timeline[1] in kinds)
        )

    metrics = standing("state", "metric")
    return Answer(
        domain=then.domain.name if then.domain else None,
        instances=frozenset(
            (item, start) for item, start in standing("state", "object") if isinstance(item, Object) and item.positive
        ),
        facts=standing("state", "fact"),
        functions=standing("state", "function"),
        inequalities=standing("state", "inequality"),
        metric=next(iter(metrics), None),
        goals=standing("goal"),
        timed_knowledge=frozenset(
            (told.item, start) for (line, start), told in then.pending.items() if line[0] == "state"
        ),
        running=frozenset(
            (run.start.action.name, run.start.arguments, run.started, run.start.duration) for run in then.running
        ),
    )


def _valued(world: World, told: Told, at: int) -> Item:
    if isinstance(told.item, Number):
        return replace(told.item, value=world.value(told.item, told.start, at))
    return told.item


def _row(told: Told) -> Row:
    if told.cancelled_by:
        return told.item, told.start, told.start, told.recorded, None, told.cancelled_by, None
    return told.item, told.start, told.end, told.first_told, told.ended_by, None, told.superseded_by


def _positive(item: Item) -> bool:
    return getattr(item, "positive", True)


def _said(state: Answer) -> frozenset[Item]:
    return frozenset(item for item, _ in state.instances | state.facts | state.inequalities)
