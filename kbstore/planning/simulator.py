"""Simulates the state at one time forward, through what is scheduled and what runs.

This is how a question about a time after now, or after `as_of`, is answered (rules Q2, O3): scheduled knowledge takes
effect in order, an object that ends takes with it what mentions it, each running action has its at-end effects at its
expected end, and numbers move at rates that follow what they read (O5). Nothing of it is stored. A writer simulates
scheduled knowledge alone (`recorded`), to store the rates that follow from it.
"""

from collections.abc import Iterable, Iterator, Mapping
from typing import NamedTuple

from kbstore.errors import KbStoreError
from kbstore.evaluation.snapshot import Snapshot, by_kind
from kbstore.messages import KnowledgeType
from kbstore.model.domain import Domain
from kbstore.model.formulas import Atom, Timing
from kbstore.model.results import Run
from kbstore.model.timelines import Identity, Mentions, Role, StateRow, Timeline, Value, atom_key, fact_value, number_at
from kbstore.names import key
from kbstore.planning import effects
from kbstore.planning.effects import Effects
from kbstore.planning.grounding import ground
from kbstore.planning.rates import RunningAction, is_moving, rates, value_at_end


class TimelineEvent(NamedTuple):
    """A change of a timeline at a time: the value from then on, None where nothing holds any more.

    `run` is the action whose expected end it is an effect of.
    """

    time: int
    timeline: Timeline
    value: Value | None
    run: Run | None = None


def moving_functions(rows: Iterable[StateRow]) -> set[Atom]:
    """Return the functions that have a rate of their own in some rows."""
    return {
        Atom(timeline.keys[0], timeline.keys[1:])
        for timeline, _, value in rows
        if timeline.kind is KnowledgeType.FUNCTION and value[2]
    }


class Simulator:
    """Plays a state forward from `start`; a run whose end was expected by then is overdue, and goes on.

    With `recorded` it plays what follows without another transaction: scheduled knowledge, but neither expected ends
    nor changes of what is sensed (rules O5, O8). `added` has the rates that runs had added until `start`, if known.
    """

    def __init__(
        self,
        start: int,
        holding: Iterable[StateRow],
        pending: Iterable[StateRow],
        running: Iterable[RunningAction],
        *,
        domain: Domain | None,
        use_unknowns: bool,
        mentions: Mentions,
        recorded: bool = False,
        added: Mapping[Atom, float | None] | None = None,
    ) -> None:
        self.running = list(running)
        self._start = start
        self._holding: dict[Identity, StateRow] = {row[0].identity: row for row in holding}
        # at one time, ends of objects come first
        self._pending = sorted(pending, key=lambda row: (row[1], not _is_end(row), row[0].id))
        self.domain = domain
        self.use_unknowns = use_unknowns
        self._mentions = mentions
        self._recorded = recorded
        self._now = start
        self._added = added
        """The rates that running actions add to functions; None before they are first computed."""
        self._is_first = True

    @property
    def rows(self) -> list[StateRow]:
        """The rows that hold at the time up to which was played."""
        return list(self._holding.values())

    def advance(self, until: int) -> Iterator[TimelineEvent]:
        """Play forward to a time, inclusive, and yield the changes in order."""
        if self._is_first:
            self._is_first = False
            yield from self._follow()
        while True:
            due = [row[1] for row in self._pending[:1]]
            if not self._recorded:
                due += [entry.run.expected_end for entry in self.running if entry.run.expected_end > self._start]
            if not due or min(due) > until:
                return
            self._now = min(due)
            while self._pending and self._pending[0][1] == self._now:
                yield from self._take_effect(*self._pending.pop(0))
            yield from self._follow()
            if not self._recorded:
                for entry in [entry for entry in self.running if entry.run.expected_end == self._now]:
                    if entry in self.running:
                        yield from self._end(entry)

    def _take_effect(self, timeline: Timeline, initial_time: int, value: Value) -> Iterator[TimelineEvent]:
        if timeline.kind is KnowledgeType.FUNCTION:
            value = self._with_rate(timeline, value)
        before = self._holding.get(timeline.identity)
        yield self._put(timeline, value)
        existed = before is not None and not before[2][0]
        if timeline.kind is KnowledgeType.INSTANCE and value[0] and existed:
            name = timeline.key
            for mentioning, _, value in self.rows:
                if name in self._mentions(mentioning, value):
                    del self._holding[mentioning.identity]
                    yield TimelineEvent(self._now, mentioning, None)
            if not self._recorded:
                for entry in [entry for entry in self.running if name in map(key, entry.run.arguments)]:
                    yield from self._stop(entry)

    def _put(self, timeline: Timeline, value: Value, run: Run | None = None) -> TimelineEvent:
        self._holding[timeline.identity] = (timeline, self._now, value)
        return TimelineEvent(self._now, timeline, value, run)

    # -- rates ------------------------------------------------------------------------------------------------

    def _follow(self, run: Run | None = None) -> Iterator[TimelineEvent]:
        """Compute the rates of running actions anew; a function with another rate than before goes on from its value.

        A function whose rate has no value any more becomes undefined until it is set (rule O5).
        """
        if not self._added and not any(is_moving(entry.run.operator, self.domain) for entry in self.running):
            return
        before, self._added = self._added, rates(self.running, self._snapshot(), self.moving())
        for function in {**(before or {}), **self._added}:
            row = self._row(function)
            if row is None or (self._recorded and self._is_sensed(function)):
                continue
            timeline, since, value = row
            added = self._added.get(function, 0.0)
            if added is None and before is not None and before.get(function, 0.0) is not None:
                del self._holding[timeline.identity]
                yield TimelineEvent(self._now, timeline, None, run)
            elif value[3] != value[2] + (added or 0.0):
                number = number_at(value, since, self._now)
                yield self._put(timeline, (False, number, value[2], value[2] + (added or 0.0)), run)

    def moving(self) -> set[Atom]:
        """The functions with a rate of their own, now or scheduled."""
        return moving_functions((*self._holding.values(), *self._pending))

    def _row(self, function: Atom) -> StateRow | None:
        """Return the row of a function, given by keys; None while it is undefined."""
        name = atom_key((function.name, *function.arguments))
        return self._holding.get(Identity(Role.STATE, KnowledgeType.FUNCTION, name))

    def _is_sensed(self, function: Atom) -> bool:
        return self.domain is not None and function.name in self.domain.sensed

    def _with_rate(self, timeline: Timeline, value: Value) -> Value:
        function = Atom(timeline.keys[0], timeline.keys[1:])
        if self._recorded and self._is_sensed(function):
            return (*value[:3], value[2])
        return (*value[:3], value[2] + ((self._added or {}).get(function) or 0.0))

    def _snapshot(self) -> Snapshot:
        return Snapshot(self._now, by_kind(self.rows), self.domain, self.use_unknowns)

    # -- runs -------------------------------------------------------------------------------------------------

    def _end(self, entry: RunningAction) -> Iterator[TimelineEvent]:
        """Carry out the at-end effects of a run at its expected end, on the state expected then.

        If they cannot be carried out, the action is expected to be aborted.
        """
        yield from self._stop(entry)
        before = dict(self._holding)
        try:
            events = [*self._put_changes(list(self._end_effects(entry)), entry.run), *self._follow(entry.run)]
        except KbStoreError:
            self._holding = before
            events = list(self._follow(entry.run))
        yield from events

    def begin(self, entry: RunningAction, at_start: Effects) -> list[StateRow]:
        """Start an action now, with its at-start effects.

        Effects on what is sensed are not carried out (rule O8); returned are the rows that they would leave.
        """
        sensed = frozenset[str]() if self.domain is None else self.domain.sensed
        changes = list(self._changes(at_start, self._snapshot()))
        self.running.append(entry)
        for _ in self._put_changes([change for change in changes if change[0].keys[0] not in sensed], entry.run):
            pass
        self._is_first = False
        for _ in self._follow():
            pass
        unwritten = [change for change in changes if change[0].keys[0] in sensed]
        return [(timeline, self._now, value or fact_value(is_negative=True)) for timeline, value in unwritten]

    def _put_changes(self, changes: Iterable[tuple[Timeline, Value | None]], run: Run) -> Iterator[TimelineEvent]:
        for timeline, value in changes:
            row = self._holding.get(timeline.identity)
            if timeline.kind is KnowledgeType.FACT and row is not None and value == row[2]:
                # a fact that holds already does not change (rule C2)
                continue
            if value is not None:
                if timeline.kind is KnowledgeType.FUNCTION:
                    value = self._with_rate(timeline, value)  # noqa: PLW2901 - other runs still move it
                yield self._put(timeline, value, run)
            elif self._holding.pop(timeline.identity, None) is not None:
                yield TimelineEvent(self._now, timeline, None, run)

    def _end_effects(self, entry: RunningAction) -> Iterator[tuple[Timeline, Value | None]]:
        assert self.domain is not None
        run = entry.run
        world = self._snapshot()
        action = ground(self.domain, run.operator, run.arguments, world)
        at_end = effects.evaluate(action, Timing.AT_END, world, duration=run.seconds, remembered=entry.remembered)
        yield from self._changes(at_end, world)

    def _changes(self, found: Effects, world: Snapshot) -> Iterator[tuple[Timeline, Value | None]]:
        def own_rate(function: Atom) -> float:
            row = self._row(function)
            return 0.0 if row is None else row[2][2]

        for kind, atom, value in effects.outcome(found, world, own_rate):
            yield self._timeline(kind, atom), value

    def _timeline(self, kind: KnowledgeType, atom: Atom) -> Timeline:
        keys = [key(name) for name in (atom.name, *atom.arguments)]
        timeline_key = atom_key(keys)
        row = self._holding.get(Identity(Role.STATE, kind, timeline_key))
        if row is not None:
            return row[0]
        assert self.domain is not None
        spelled = [self.domain.constant_spelling(name) or self._spelling(name) for name in keys[1:]]
        declared = (
            self.domain.predicate_signature(atom.name)
            if kind is KnowledgeType.FACT
            else self.domain.function_signature(atom.name)
        )
        return Timeline(0, Role.STATE, kind, timeline_key, " ".join((declared.name, *spelled)))

    def _spelling(self, name: str) -> str:
        """The name of an object that exists, as first written."""
        return self._holding[Identity(Role.STATE, KnowledgeType.INSTANCE, name)][0].spelling

    def _stop(self, entry: RunningAction) -> Iterator[TimelineEvent]:
        """End a run's contributions to rates; the functions that it moved go on without them."""
        last = rates([entry], self._snapshot()) if is_moving(entry.run.operator, self.domain) else {}
        self.running.remove(entry)
        if self._now == entry.run.expected_end:
            for function, added in last.items():
                row = self._row(function)
                if row is not None:
                    timeline, since, value = row
                    number = value_at_end(value, since, added or 0.0, entry.run)
                    self._holding[timeline.identity] = (timeline, self._now, (False, number, *value[2:]))
        yield from self._follow(entry.run)


def _is_end(row: StateRow) -> bool:
    return row[0].kind is KnowledgeType.INSTANCE and bool(row[2][0])
