"""What is expected to come: the state at one moment, played forward through what is scheduled and what runs.

This is how a question about a time after now, or after the moment of a belief, is answered (rules Q2, O3): what was
pending takes effect in order, objects take with them what mentions them, and each action that runs has its at-end
effects at its expected end. Nothing of it is stored.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import NamedTuple

from kbstore.errors import KbStoreError
from kbstore.evaluation.snapshot import Snapshot, StateRow
from kbstore.messages import KnowledgeType
from kbstore.model.domain import Domain
from kbstore.model.formulas import Atom, Timing
from kbstore.model.results import Run
from kbstore.model.timelines import Identity, Role, Timeline, Value, number_at
from kbstore.names import key
from kbstore.planning import effects
from kbstore.planning.grounding import ground
from kbstore.planning.start_conditions import NOTHING, Remembered

Mentions = Callable[[Timeline, Value], Sequence[str]]


class RunningAction(NamedTuple):
    """A run, what it adds to the rates of functions, per second, and what its at-end effects remember of its start."""

    run: Run
    rates: tuple[tuple[Timeline, float], ...]
    remembered: Remembered = NOTHING


class Event(NamedTuple):
    """What changes on a timeline at a time: the value from then on, None where nothing stands any more.

    `run` is the action whose expected end it is an effect of.
    """

    time: int
    timeline: Timeline
    value: Value | None
    run: Run | None = None


class Simulator:
    """Plays a state forward. `start` is the moment of the belief; what was expected to end by then is late."""

    def __init__(
        self,
        start: int,
        standing: Iterable[StateRow],
        pending: Iterable[StateRow],
        running: Iterable[RunningAction],
        *,
        domain: Domain | None,
        use_unknowns: bool,
        mentions: Mentions,
    ) -> None:
        self.running = list(running)
        self._start = start
        self._standing: dict[Identity, StateRow] = {row[0].identity: row for row in standing}
        # of one time, ends of objects come first
        self._pending = sorted(pending, key=lambda row: (row[1], not _is_end(row), row[0].id))
        self._domain = domain
        self._use_unknowns = use_unknowns
        self._mentions = mentions
        self._now = start

    @property
    def rows(self) -> list[StateRow]:
        """What stands at the time up to which the projection was played."""
        return list(self._standing.values())

    def advance(self, until: int) -> Iterator[Event]:
        """Play forward to a time, inclusive; yields what changes, in order."""
        while True:
            due = [row[1] for row in self._pending[:1]]
            due += [entry.run.expected_end for entry in self.running if entry.run.expected_end > self._start]
            if not due or min(due) > until:
                return
            self._now = min(due)
            while self._pending and self._pending[0][1] == self._now:
                yield from self._take_effect(*self._pending.pop(0))
            for entry in [entry for entry in self.running if entry.run.expected_end == self._now]:
                if entry in self.running:
                    yield from self._end(entry)

    def _take_effect(self, timeline: Timeline, initial_time: int, value: Value) -> Iterator[Event]:
        if timeline.kind is KnowledgeType.FUNCTION:
            value = self._with_rate(timeline, value)
        before = self._standing.get(timeline.identity)
        yield self._put(timeline, value)
        existed = before is not None and not before[2][0]
        if timeline.kind is KnowledgeType.INSTANCE and value[0] and existed:
            name = timeline.key
            for mentioning, _, stands in self.rows:
                if name in self._mentions(mentioning, stands):
                    del self._standing[mentioning.identity]
                    yield Event(self._now, mentioning, None)
            for entry in [entry for entry in self.running if name in map(key, entry.run.arguments)]:
                yield from self._stop(entry)

    def _put(self, timeline: Timeline, value: Value, run: Run | None = None) -> Event:
        self._standing[timeline.identity] = (timeline, self._now, value)
        return Event(self._now, timeline, value, run)

    # -- runs -------------------------------------------------------------------------------------------------

    def _end(self, entry: RunningAction) -> Iterator[Event]:
        """The at-end effects of a run at its expected end, on the state expected then."""
        run = entry.run
        try:
            changes = list(self._end_effects(entry))
        except KbStoreError:
            # what cannot be carried out then is not expected to be; the action is expected to be aborted
            changes = []
        yield from self._stop(entry)
        for timeline, value in changes:
            row = self._standing.get(timeline.identity)
            if timeline.kind is KnowledgeType.FACT and row is not None and value == row[2]:
                # what holds already does not change (rule C2)
                continue
            if value is not None:
                if timeline.kind is KnowledgeType.FUNCTION:
                    value = self._with_rate(timeline, value)  # noqa: PLW2901 - with what still runs
                yield self._put(timeline, value, run)
            elif self._standing.pop(timeline.identity, None) is not None:
                yield Event(self._now, timeline, None, run)

    def _end_effects(self, entry: RunningAction) -> Iterator[tuple[Timeline, Value | None]]:
        assert self._domain is not None
        run = entry.run
        world = Snapshot(self._now, self.rows, self._domain, self._use_unknowns)
        action = ground(self._domain, run.operator, run.arguments, world)
        at_end = effects.evaluate(action, Timing.AT_END, world, duration=run.seconds, remembered=entry.remembered)

        def own_rate(function: Atom) -> float:
            row = self._standing.get(self._timeline(KnowledgeType.FUNCTION, function).identity)
            return 0.0 if row is None else row[2][2]

        for kind, atom, value in effects.outcome(at_end, world, own_rate):
            yield self._timeline(kind, atom), value

    def _timeline(self, kind: KnowledgeType, atom: Atom) -> Timeline:
        keys = [key(name) for name in (atom.name, *atom.arguments)]
        row = self._standing.get(Identity(Role.STATE, kind, " ".join(keys)))
        if row is not None:
            return row[0]
        assert self._domain is not None
        spelled = [self._domain.constant_spelling(name) or self._spelling(name) for name in keys[1:]]
        declared = (
            self._domain.predicate_signature(atom.name)
            if kind is KnowledgeType.FACT
            else self._domain.function_signature(atom.name)
        )
        return Timeline(0, Role.STATE, kind, " ".join(keys), " ".join((declared.name, *spelled)))

    def _spelling(self, name: str) -> str:
        """The name of an object that exists, as first written."""
        return self._standing[Identity(Role.STATE, KnowledgeType.INSTANCE, name)][0].spelling

    def _stop(self, entry: RunningAction) -> Iterator[Event]:
        """A run's contributions to rates end; the functions that it moved move on without them."""
        self.running.remove(entry)
        for timeline, _ in entry.rates:
            row = self._standing.get(timeline.identity)
            if row is not None:
                number = number_at(row[2], row[1], self._now)
                value = self._with_rate(timeline, (False, number, row[2][2], 0.0))
                yield self._put(timeline, value, entry.run)

    def _with_rate(self, timeline: Timeline, value: Value) -> Value:
        rate = value[2]
        for entry in self.running:
            rate += sum(added for moved, added in entry.rates if moved.identity == timeline.identity)
        return (*value[:3], rate)


def _is_end(row: StateRow) -> bool:
    return row[0].kind is KnowledgeType.INSTANCE and bool(row[2][0])
