"""A transaction's working copy of the timelines that it touches (an identity map), and its flush to rows.

Updates apply to the change set one after another. Only at the end is each timeline compared with what is stored, so
that of several updates of one timeline at one time only the last is recorded (rule C1).

Ends that lie ahead are always derived: a row that no transaction ends at its own time ends at the earlier of the next
assertion on its timeline and the end of the existence of any object that it mentions (rules V1, C6, C9).
`ChangeSet.finish` derives them anew for everything that the transaction touched.
"""

from collections import defaultdict
from collections.abc import Callable, Iterable, Sequence
from itertools import chain

from kbstore.clock import OPEN
from kbstore.messages import Condition, Fact, Function, Instance, KnowledgeItem, KnowledgeType
from kbstore.model.formulas import Atom
from kbstore.model.timelines import EndCause, Identity, Role, Timeline, Value, number_at
from kbstore.names import key
from kbstore.planning.simulator import Event
from kbstore.storage.records import RowChanges, StateRow, StoredAssertion
from kbstore.storage.repository import Repository
from kbstore.writing.lifespans import Lifespan, lifespans_of, lost_time
from kbstore.writing.timeline_state import TimelineState

Mentions = Callable[[Timeline, Value], Sequence[str]]

_GROUPS = tuple((role, kind) for role in Role for kind in KnowledgeType)


class ChangeSet:
    """The timelines that one transaction touches, as it leaves them."""

    def __init__(self, repository: Repository, now: int, mentions: Mentions) -> None:
        self.now = now
        self._repository = repository
        self._mentions = mentions
        self._groups: dict[tuple[Role, KnowledgeType], dict[str, TimelineState]] = {group: {} for group in _GROUPS}
        self._by_id: dict[int, TimelineState] = {}
        self._absent: dict[tuple[Role, KnowledgeType], set[str]] = {group: set() for group in _GROUPS}
        self._new: list[TimelineState] = []
        self.objects_changed = 0
        """How often the existence of an object has changed here."""
        self._mentioning: dict[str, list[TimelineState]] = {}
        self._journal: dict[TimelineState, tuple[Value | None, dict[int, Value], EndCause]] = {}

    # -- timelines --------------------------------------------------------------------------------------------

    def group(self, role: Role, kind: KnowledgeType) -> dict[str, TimelineState]:
        """The timelines of one role and knowledge type that have been touched, by key."""
        return self._groups[role, kind]

    def state(self, identity: Identity, spelling: str) -> TimelineState:
        """A timeline, made if there is none; `spelling` counts where it is new."""
        role, kind, name = identity
        group = self._groups[role, kind]
        state = group.get(name)
        if state is None and name not in self._absent[role, kind]:
            state = self.find(identity)
        if state is None:
            timeline = Timeline(0, role, kind, name, None if spelling == name else spelling)
            state = group[name] = TimelineState(timeline, (), self.now)
            self._new.append(state)
        return state

    def find(self, identity: Identity) -> TimelineState | None:
        """A timeline, None if there is none."""
        role, kind, name = identity
        group = self._groups[role, kind]
        state = group.get(name)
        if state is None and name not in self._absent[role, kind]:
            self.load(role, kind, [name])
            state = group.get(name)
        return state

    def load(self, role: Role, kind: KnowledgeType, keys: Iterable[str]) -> None:
        """Read timelines at once, as far as they are stored."""
        group, absent = self._groups[role, kind], self._absent[role, kind]
        missing = [name for name in keys if name not in group and name not in absent]
        if missing:
            absent.update(missing)
            self.loaded(self._repository.find(role, kind, missing).values())

    def prefetch(self, role: Role, items: Iterable[KnowledgeItem | Condition]) -> None:
        """Load at once the timelines that items will touch, as far as these can be told beforehand."""
        atoms: dict[KnowledgeType, dict[str, tuple[str, ...]]] = defaultdict(dict)
        objects: set[str] = set()
        for item in items:
            if isinstance(item, Fact | Function):
                atoms[item.knowledge_type][" ".join(item.key)] = item.key
            elif isinstance(item, Instance):
                objects.add(key(item.instance_name))
        for kind, keys in atoms.items():
            self.load(role, kind, keys)
            states = self.group(role, kind)
            for name, words in keys.items():
                state = states.get(name)
                # what holds mentions only objects that exist
                if state is None or state.value is None:
                    objects.update(words[1:])
        self.load(Role.STATE, KnowledgeType.INSTANCE, objects)

    def loaded(self, timelines: Iterable[Timeline]) -> list[TimelineState]:
        """Load stored timelines, and return their states."""
        timelines = list(timelines)
        by_kind: dict[KnowledgeType, list[Timeline]] = defaultdict(list)
        for timeline in timelines:
            if timeline.id not in self._by_id:
                by_kind[timeline.kind].append(timeline)
        for kind, missing in by_kind.items():
            rows = self._repository.rows_for_update(kind, [timeline.id for timeline in missing], self.now)
            for timeline in missing:
                state = TimelineState(timeline, rows.get(timeline.id, ()), self.now)
                self._groups[timeline.role, kind][timeline.key] = state
                self._by_id[timeline.id] = state
        return [self._by_id[timeline.id] for timeline in timelines]

    def states(self) -> Iterable[TimelineState]:
        """All timelines that have been touched."""
        return chain.from_iterable(group.values() for group in self._groups.values())

    # -- changes ----------------------------------------------------------------------------------------------

    def value_at(self, state: TimelineState, t: int) -> Value | None:
        """What holds on a timeline now, or, for a later time, what is scheduled for exactly that time."""
        return state.ahead.get(t) if t > self.now else state.value

    def put(self, state: TimelineState, value: Value, t: int) -> None:
        """Let a value hold from now on; from a later time, in place of what was scheduled for it (rule C6)."""
        self._touch(state)
        if t > self.now:
            state.ahead[t] = value
            return
        if state.value is not None:
            state.cause = EndCause.REPLACED
        state.value = value

    def take(self, state: TimelineState, t: int, cause: EndCause) -> None:
        """End what holds now; for a later time, cancel what is scheduled for it (rules C4, C5)."""
        self._touch(state)
        if t > self.now:
            del state.ahead[t]
            return
        state.value = None
        state.cause = cause

    def _touch(self, state: TimelineState) -> None:
        if state not in self._journal:
            self._journal[state] = state.copy()
        if state.timeline.kind is KnowledgeType.INSTANCE:
            self.objects_changed += 1

    def savepoint(self) -> None:
        """From here on, `roll_back` takes changes back."""
        self._journal.clear()

    def roll_back(self) -> None:
        """Take back every change since the savepoint."""
        for state, copy in self._journal.items():
            state.restore(copy)
        self._journal.clear()
        self.objects_changed += 1

    def is_set(self, function: Atom) -> bool:
        """Whether a function has been set in this transaction, to whatever value."""
        state = self._groups[Role.STATE, KnowledgeType.FUNCTION].get(" ".join((function.name, *function.arguments)))
        base = None if state is None else state.base(self.now)
        return state is not None and (base is None or state.value != self._value_now(state, base))

    def follow(self, events: Iterable[Event]) -> None:
        """Take over how numbers move by what runs (rule O5): now, and from later times on as derived assertions."""
        for state in self.loaded(self._repository.derived_ahead(self.now)):
            state.derived = {}
        for event in events:
            if event.timeline.kind is not KnowledgeType.FUNCTION:
                continue
            state = self.state(event.timeline.identity, event.timeline.spelling)
            if event.time == self.now:
                state.value = event.value
                state.cause = EndCause.RUN
            elif event.time in state.ahead and event.value is not None:
                state.ahead[event.time] = event.value
            else:
                state.derived[event.time] = event.value

    # -- objects ----------------------------------------------------------------------------------------------

    def lifespans(self, state: TimelineState) -> list[Lifespan]:
        """When the object of an INSTANCE timeline exists from now on, with the changes of this transaction."""
        return lifespans_of(state.value, state.ahead, self.now)

    def stored_lifespans(self, state: TimelineState) -> list[Lifespan]:
        """The same as stored."""
        base = state.base(self.now)
        ahead = {t: row.value for t, row in state.stored_ahead.items()}
        return lifespans_of(None if base is None else base.value, ahead, self.now)

    def drop_mentions(self, state: TimelineState, before: Sequence[Lifespan], cause: EndCause) -> None:
        """End and cancel what mentions an object, from when it does not exist any more to its next start (rule C9)."""
        after = self.lifespans(state)
        # without a domain something may have been scheduled even for a time in which it did not exist
        lost = [
            (start, min((lifespan.start for lifespan in after if lifespan.start > start), default=OPEN))
            for start, _ in lost_time(before, after)
        ]
        if not lost:
            return
        for mentioning in self.mentioning(state):
            if lost[0][0] == self.now and mentioning.value is not None and self._is_about(mentioning, None, state):
                self.take(mentioning, self.now, cause)
            for t in [t for t in mentioning.ahead if any(start <= t < end for start, end in lost)]:
                if self._is_about(mentioning, t, state):
                    self.take(mentioning, t, cause)

    def _is_about(self, state: TimelineState, t: int | None, about: TimelineState) -> bool:
        """Whether what stands (or is scheduled for `t`) mentions an object: the metric's timeline holds many things."""
        value = state.value if t is None else state.ahead[t]
        return value is not None and about.timeline.key in self._mentions(state.timeline, value)

    def mentioning(self, state: TimelineState) -> list[TimelineState]:
        """The timelines that mention the object of an INSTANCE timeline, stored and new."""
        name = state.timeline.key
        stored = self._mentioning.get(name)
        if stored is None:
            ids = [state.timeline.id] if state.timeline.id else []
            stored = self._mentioning[name] = self.loaded(self._repository.mentioning(ids)) if ids else []
        return [*stored, *(state for state in self._new_mentioning().get(name, ()) if state not in stored)]

    def _new_mentioning(self) -> dict[str, list[TimelineState]]:
        """By object, the timelines mentioning it that are new, or whose mentions vary by value (the metric)."""
        by_object: dict[str, list[TimelineState]] = defaultdict(list)
        metric = self._groups[Role.STATE, KnowledgeType.EXPRESSION].values()
        for state in dict.fromkeys((*self._new, *metric)):
            values = ([] if state.value is None else [state.value]) + list(state.ahead.values())
            for name in {name for value in values for name in self._mentions(state.timeline, value)}:
                by_object[name].append(state)
        return by_object

    def overlay(self, rows: dict[Identity, StateRow], pending: dict[tuple[Identity, int], StateRow]) -> None:
        """Replace stored rows, those that hold now and those pending, by what the transaction makes of them."""
        for state in list(self.states()):
            identity = state.timeline.identity
            base = state.base(self.now)
            if state.value is None:
                rows.pop(identity, None)
            elif base is None or state.value != self._value_now(state, base):
                rows[identity] = (state.timeline, self.now, state.value)
            for t in state.stored_ahead.keys() - state.ahead.keys():
                pending.pop((identity, t), None)
            for t, value in state.ahead.items():
                pending[identity, t] = (state.timeline, t, value)

    # -- what is written --------------------------------------------------------------------------------------

    def finish(self) -> RowChanges:
        """Compare with what is stored: what the transaction has to write."""
        writes = RowChanges()
        objects = self._groups[Role.STATE, KnowledgeType.INSTANCE]
        if self.objects_changed:
            for track in list(objects.values()):
                if self._ends(self.lifespans(track)) != self._ends(self.stored_lifespans(track)):
                    self.mentioning(track)
        # objects on which nothing is scheduled end nothing ahead
        ends = {track.timeline.key: self._ends(self.lifespans(track)) for track in self._all_scheduled_objects()}
        for track in list(self.states()):
            self._finish_track(track, ends, writes)
        self._note_new(writes)
        return writes

    def _note_new(self, writes: RowChanges) -> None:
        """The timelines that are new, and which objects they mention."""
        new: dict[Timeline, None] = {}
        objects = self._groups[Role.STATE, KnowledgeType.INSTANCE]
        for kind, added in writes.adds.items():
            for timeline, _, _, value in added:
                if not timeline.id:
                    new[timeline] = None
                elif kind is not KnowledgeType.EXPRESSION:
                    continue
                for name in self._mentions(timeline, value):
                    known = objects.get(name)
                    if known is None:
                        known = self.state(Identity(Role.STATE, KnowledgeType.INSTANCE, name), name)
                    about = known.timeline
                    if not about.id:
                        new[about] = None
                    writes.mentions.append((about, timeline))
        writes.timelines = list(new)

    def _all_scheduled_objects(self) -> list[TimelineState]:
        stored = self.loaded(self._repository.timelines_of(self._repository.scheduled_objects(self.now)))
        objects = self._groups[Role.STATE, KnowledgeType.INSTANCE].values()
        return list(dict.fromkeys((*stored, *(track for track in objects if track.ahead))))

    @staticmethod
    def _ends(existences: Sequence[Lifespan]) -> list[int]:
        return [lifespan.end for lifespan in existences if lifespan.end != OPEN]

    def _finish_track(self, track: TimelineState, ends: dict[str, list[int]], writes: RowChanges) -> None:
        kind = track.timeline.kind
        base = track.base(self.now)
        if base is None and track.value is None and not track.ahead and not track.stored_ahead:
            # what is derived follows from one of these
            return
        changed = False
        standing_again = base is not None and track.value == self._value_now(track, base)
        # (initial time, value, the stored row if it stays, whether it is derived)
        line: list[tuple[int, Value | None, StoredAssertion | None, bool]] = []
        if base is not None and standing_again:
            line.append((base.initial_time, base.value, base, False))
        else:
            if base is not None:
                changed = True
                cause = track.cause if track.value is None else EndCause.REPLACED
                writes.ends[kind].append((base, cause))
            if track.value is not None:
                line.append((self.now, track.value, None, False))
        for t in sorted({**track.derived, **track.ahead}):
            if t not in track.ahead:
                line.append((t, track.derived[t], track.stored_derived.get(t), True))
                continue
            stored = track.stored_ahead.get(t)
            value = track.ahead[t]
            if stored is not None and _same_but_rate(kind, stored.value, value):
                line.append((t, value, stored, False))
                if stored.value != value:
                    writes.rates.append((stored, value[3]))
            else:
                line.append((t, value, None, False))
        for t, stored in track.stored_ahead.items():
            if t not in track.ahead or not _same_but_rate(kind, stored.value, track.ahead[t]):
                changed = True
                writes.cancels[kind].append(stored)
        writes.underived += [row for t, row in track.stored_derived.items() if t not in track.derived]
        for index, (start, entry, stored, is_derived) in enumerate(line):
            if entry is None:
                if stored is not None:
                    writes.underived.append(stored)
                continue
            end = line[index + 1][0] if index + 1 < len(line) else OPEN
            if ends:
                for name in self._mentions(track.timeline, entry):
                    end = min(end, min((t for t in ends.get(name, ()) if t > start), default=OPEN))
            if is_derived:
                if stored is not None and (stored.value != entry or stored.end_time != end):
                    writes.underived.append(stored)
                    stored = None  # noqa: PLW2901 - it is derived anew
                if stored is None:
                    writes.derived.append((track.timeline, start, end, entry))
            elif stored is None:
                changed = True
                writes.adds[kind].append((track.timeline, start, end, entry))
            elif stored.end_time != end:
                writes.settles[kind].append((stored, end))
        writes.changes += changed

    def _value_now(self, track: TimelineState, base: StoredAssertion) -> Value:
        if track.timeline.kind is not KnowledgeType.FUNCTION:
            return base.value
        return (False, number_at(base.value, base.initial_time, self.now), *base.value[2:])


def _same_but_rate(kind: KnowledgeType, stored: Value, value: Value) -> bool:
    """Whether a scheduled value is the stored one; a function's rate besides its own is derived."""
    return stored[:3] == value[:3] if kind is KnowledgeType.FUNCTION else stored == value
