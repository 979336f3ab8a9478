"""What is believed after some transactions, and what becomes of it as time passes."""

from dataclasses import dataclass, field
from typing import TypeVar

from tests.oracle.items import SECOND, Fact, Item, Number, Object, RefDomain, Start, Term, Timeline


class Unsettled(Exception):
    """The rules do not say what this transaction does, so that nothing can be expected of it."""


Mutable = TypeVar("Mutable", "Told", "Running")


def _twin(one: Mutable) -> Mutable:
    """A copy of one object, quicker than by the module `copy`."""
    twin = object.__new__(type(one))
    twin.__dict__.update(one.__dict__)
    return twin


@dataclass(eq=False)
class Told:
    """One assertion. `end` and its cause are None while nothing has ended it.

    `first_told` is the transaction that told it first, where this is what late knowledge has left of an assertion.
    """

    timeline: Timeline
    item: Item
    start: int
    recorded: int
    end: int | None = None
    ended_by: int | None = None
    end_cause: str = ""
    cancelled_by: int | None = None
    superseded_by: int | None = None
    first_told: int = 0

    def __post_init__(self) -> None:
        self.first_told = self.first_told or self.recorded

    @property
    def counts(self) -> bool:
        """Whether it is part of what is known now, of some time (rules V1, L8)."""
        return not self.cancelled_by and not self.superseded_by and self.end != self.start

    def stands_at(self, t: int) -> bool:
        """Whether it is what is known of a time that has come."""
        return self.counts and self.start <= t and (self.end is None or t < self.end)


@dataclass(eq=False)
class Running:
    """A durative action that runs, or ran until `ended`; `decided` are the effects that its start decided upon."""

    start: Start
    started: int
    decided: list[Fact]
    ended: int | None = None

    @property
    def expected_end(self) -> int:
        return self.started + self.start.duration

    def moved(self, term: Term, since: int, until: int) -> float:
        """What the action adds to a function from one time to another (rule O3)."""
        first = max(since, self.started)
        last = until if self.ended is None else min(until, self.ended)
        rates = [rate for (name, places), rate in self.start.action.rates if (name, self.start.ground(places)) == term]
        return sum(rates) * max(0, last - first) / SECOND


@dataclass
class World:
    """What stands and what is scheduled; `told` remembers every assertion in the order of recording.

    `runs` are the actions that run or ran; `expecting` is whether the time that passes lies ahead.
    """

    told: list[Told] = field(default_factory=list)
    standing: dict[Timeline, Told] = field(default_factory=dict)
    pending: dict[tuple[Timeline, int], Told] = field(default_factory=dict)
    runs: list[Running] = field(default_factory=list)
    domains: list[tuple[int, RefDomain | None]] = field(default_factory=lambda: [(0, None)])
    use_unknowns: bool = False
    expecting: bool = False

    def copy(self) -> "World":
        """An equal world, which may change without changing this one."""
        twins = {told: _twin(told) for told in self.told}
        return World(
            list(twins.values()),
            {line: twins[told] for line, told in self.standing.items()},
            {key: twins[told] for key, told in self.pending.items()},
            [_twin(run) for run in self.runs],
            list(self.domains),
            self.use_unknowns,
            self.expecting,
        )

    @property
    def domain(self) -> RefDomain | None:
        """The domain that was loaded last."""
        return self.domains[-1][1]

    @property
    def running(self) -> list[Running]:
        """The actions that run."""
        return [run for run in self.runs if run.ended is None]

    def value(self, number: Number, start: int, t: int) -> float:
        """The value at t of a function that was told at `start`, with what running actions add (rules C7, O3)."""
        return number.at(start, t) + sum(run.moved((number.name, number.arguments), start, t) for run in self.runs)

    def same(self, one: Item, one_start: int, other: Item, other_start: int, t: int) -> bool:
        """Whether two items of one timeline say the same at t (rule C2)."""
        if isinstance(one, Number) and isinstance(other, Number):
            values = self.value(one, one_start, t), self.value(other, other_start, t)
            return values[0] == values[1] and one.rate == other.rate
        return one == other

    def advance(self, t: int) -> None:
        """Let everything that is scheduled up to t take effect, in order of time."""
        for moment in sorted({start for _, start in self.pending if start <= t}):
            self._take_effect(moment)

    def _take_effect(self, moment: int) -> None:
        due = [told for (_, start), told in self.pending.items() if start == moment]
        for told in due:
            del self.pending[told.timeline, moment]
        for told in due:
            if self._ends_an_object(told):
                self._end_dependents(told)
        for told in due:
            before = self.standing.get(told.timeline)
            if before:
                before.end, before.ended_by, before.end_cause = moment, told.recorded, "replaced"
            self.standing[told.timeline] = told

    def _ends_an_object(self, told: Told) -> bool:
        before = self.standing.get(told.timeline)
        return (
            isinstance(told.item, Object)
            and not told.item.positive
            and before is not None
            and isinstance(before.item, Object)
            and before.item.positive
        )

    def _end_dependents(self, ending: Told) -> None:
        assert isinstance(ending.item, Object)
        for told in [told for told in self.standing.values() if ending.item.name in told.item.mentions]:
            del self.standing[told.timeline]
            told.end, told.ended_by, told.end_cause = ending.start, ending.recorded, "object"
        for run in self.running:
            if ending.item.name in run.start.arguments:
                if not self.expecting:
                    raise Unsettled("an object of what runs has ended by the clock")
                run.ended = ending.start
