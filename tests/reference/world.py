"""What is believed after some transactions, and what becomes of it as time passes."""

from dataclasses import dataclass, field

from tests.reference.items import Item, Object, RefDomain, Timeline


@dataclass(eq=False)
class Told:
    """One assertion. `end` and its cause are None while nothing has ended it."""

    timeline: Timeline
    item: Item
    start: int
    recorded: int
    end: int | None = None
    ended_by: int | None = None
    end_cause: str = ""
    cancelled_by: int | None = None


@dataclass
class World:
    """What stands and what is scheduled; `told` remembers every assertion in the order of recording."""

    told: list[Told] = field(default_factory=list)
    standing: dict[Timeline, Told] = field(default_factory=dict)
    pending: dict[tuple[Timeline, int], Told] = field(default_factory=dict)
    domain: RefDomain | None = None

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
