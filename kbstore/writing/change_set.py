"""A transaction's working copy of the timelines that it touches (an identity map).

Updates apply to the change set one after another. At the end each timeline is compared with its stored rows
(`kbstore.writing.flush`); so if a timeline was updated several times, only the last value is recorded (rule C1).
"""

from collections import defaultdict
from collections.abc import Collection, Iterable, Sequence

from kbstore.clock import OPEN
from kbstore.messages import Condition, Fact, Function, Instance, KnowledgeItem, KnowledgeType
from kbstore.model.formulas import Atom
from kbstore.model.lifespans import Lifespan, joined, lifespans_of, lost_time
from kbstore.model.timelines import EndCause, Identity, Mentions, Role, StateRow, Timeline, Value, atom_key
from kbstore.names import key
from kbstore.planning.simulator import TimelineEvent
from kbstore.storage.repository import Repository
from kbstore.writing.pieces import Piece, piece_of
from kbstore.writing.timeline_state import Copy, KnownPast, TimelineState, value_now

_Group = tuple[Role, KnowledgeType]

_ATOMS = (Fact, Function)


class ChangeSet:
    """The timelines that one transaction touches, as it leaves them."""

    def __init__(self, repository: Repository, now: int, mentions: Mentions) -> None:
        self.now = now
        self._repository = repository
        self.mentions = mentions
        """A function that returns the keys of the objects that an assertion mentions."""
        self._groups: dict[_Group, dict[str, TimelineState]] = defaultdict(dict)
        self._by_id: dict[int, TimelineState] = {}
        self._absent: dict[_Group, set[str]] = defaultdict(set)
        self._new: list[TimelineState] = []
        self.objects_changed = 0
        """A counter of changes to the existence of objects; caches of object types compare it."""
        self._mentioning: dict[str, list[TimelineState]] = {}
        self._journal: dict[TimelineState, Copy] = {}
        self.late_from = OPEN
        """The earliest time about which late knowledge changed something, in nanoseconds; `OPEN` if none did."""

    # -- timelines --------------------------------------------------------------------------------------------

    def group(self, role: Role, kind: KnowledgeType) -> dict[str, TimelineState]:
        """Return the timelines of one role and knowledge type that have been touched, by key."""
        return self._groups[role, kind]

    def state(self, identity: tuple[Role, KnowledgeType, str], spelling: str) -> TimelineState:
        """Return a timeline by its identity, created with `spelling` if there is none."""
        role, kind, name = identity
        group = self._groups[role, kind]
        state = group.get(name)
        if state is None and name not in self._absent[role, kind]:
            self.load(role, kind, (name,))
            state = group.get(name)
        if state is None:
            timeline = Timeline(0, role, kind, name, None if spelling == name else spelling)
            state = group[name] = TimelineState(timeline, (), self.now)
            self._new.append(state)
        return state

    def find(self, identity: Identity) -> TimelineState | None:
        """Return a timeline; None if there is none."""
        role, kind, name = identity
        group = self._groups[role, kind]
        state = group.get(name)
        if state is None and name not in self._absent[role, kind]:
            self.load(role, kind, [name])
            state = group.get(name)
        return state

    def load(self, role: Role, kind: KnowledgeType, keys: Iterable[str]) -> None:
        """Read the stored ones of some timelines, in one go."""
        group, absent = self._groups[role, kind], self._absent[role, kind]
        missing = [name for name in keys if name not in group and name not in absent]
        if missing:
            absent.update(missing)
            self._load(kind, self._repository.find(role, kind, missing).values())

    def prefetch(self, role: Role, items: Iterable[KnowledgeItem | Condition]) -> None:
        """Load the timelines that items will touch, as far as they can be known beforehand, in one go."""
        atoms: dict[KnowledgeType, dict[str, Fact | Function]] = defaultdict(dict)
        objects: set[str] = set()
        for item in items:
            if isinstance(item, _ATOMS):
                atoms[item.knowledge_type][item.timeline_key] = item
            elif isinstance(item, Instance):
                objects.add(key(item.instance_name))
        for kind, found in atoms.items():
            self.load(role, kind, found)
            states = self.group(role, kind)
            for name, atom in found.items():
                state = states.get(name)
                # an assertion that holds mentions only objects that exist, which need no check
                if state is None or state.value is None:
                    objects.update(atom.key[1:])
        if objects:
            self.load(Role.STATE, KnowledgeType.INSTANCE, objects)

    def object(self, name: str) -> TimelineState | None:
        """Return the INSTANCE timeline of an object by its key; None if there is none."""
        return self.find(Identity(Role.STATE, KnowledgeType.INSTANCE, name))

    def loaded(self, timelines: Iterable[Timeline]) -> list[TimelineState]:
        """Load stored timelines, and return their states."""
        timelines = list(timelines)
        by_kind: dict[KnowledgeType, list[Timeline]] = defaultdict(list)
        for timeline in timelines:
            if timeline.id not in self._by_id:
                by_kind[timeline.kind].append(timeline)
        for kind, missing in by_kind.items():
            self._load(kind, missing)
        return [self._by_id[timeline.id] for timeline in timelines]

    def _load(self, kind: KnowledgeType, timelines: Collection[Timeline]) -> None:
        if timelines:
            rows = self._repository.rows_for_update(kind, [timeline.id for timeline in timelines], self.now)
            for timeline in timelines:
                state = TimelineState(timeline, rows.get(timeline.id, ()), self.now)
                self._groups[timeline.role, kind][timeline.key] = self._by_id[timeline.id] = state

    def states(self) -> list[TimelineState]:
        """Return all timelines that have been touched."""
        return [state for group in sorted(self._groups) for state in self._groups[group].values()]

    # -- the past ---------------------------------------------------------------------------------------------

    def known(self, state: TimelineState, since: int) -> list[Piece]:
        """Return the pieces of a timeline from a time up to now, in order, read only as far as they are needed.

        The one that holds now ends at `OPEN`.
        """
        past = state.past = state.past or KnownPast()
        if since < past.since:
            rows = []
            if state.timeline.id:
                rows = self._repository.known_rows(state.timeline, since, min(self.now, past.since - 1))
            past.since = since if not rows else min(since, rows[0].stored.initial_time)
            past.rows = [*rows, *past.rows]
            read = [piece_of(row, self.now) for row in rows if row.stored.initial_time < self.now]
            past.pieces = (*read, *past.pieces)
        return state.pieces(self.now)

    def existences(self, state: TimelineState) -> list[Lifespan]:
        """Return the lifespans of the object of an INSTANCE timeline, from the first to the last."""
        pieces = [piece for piece in self.known(state, 0) if piece.start < self.now and not piece.value[0]]
        past = [Lifespan(piece.start, min(piece.end, self.now), piece.value[1]) for piece in pieces]
        return joined([*past, *self.lifespans(state)])

    # -- changes ----------------------------------------------------------------------------------------------

    def value_at(self, state: TimelineState, t: int) -> Value | None:
        """Return the value of a timeline now, or, for a later time, the one scheduled for exactly that time."""
        return state.ahead.get(t) if t > self.now else state.value

    def put(self, state: TimelineState, value: Value, t: int) -> None:
        """Assert a value from now on; or schedule it for a later time, instead of another for that time (rule C6)."""
        self.touch(state)
        if t > self.now:
            state.ahead[t] = value
            return
        if state.value is not None:
            state.cause = EndCause.REPLACED
        state.value = value

    def take(self, state: TimelineState, t: int, cause: EndCause) -> None:
        """End the current assertion; for a later time, cancel the one scheduled for it (rules C4, C5)."""
        self.touch(state)
        if t > self.now:
            del state.ahead[t]
            return
        state.value = None
        state.cause = cause
        if state.past is not None:
            state.past.begun_now = None
            state.past.is_ended_now = True

    def touch(self, state: TimelineState) -> None:
        """Note that a timeline is about to change, so that `roll_back` can restore it."""
        if state not in self._journal:
            self._journal[state] = state.copy()
        if state.timeline.kind is KnowledgeType.INSTANCE:
            self.objects_changed += 1

    def savepoint(self) -> None:
        """Set the point to which `roll_back` returns."""
        self._journal.clear()

    def roll_back(self) -> None:
        """Undo every change since the savepoint."""
        for state, copy in self._journal.items():
            state.restore(copy)
        self._journal.clear()
        self.objects_changed += 1

    def is_set(self, function: Atom) -> bool:
        """Return whether a function has been set in this transaction, also to the same value."""
        state = self._groups[Role.STATE, KnowledgeType.FUNCTION].get(atom_key((function.name, *function.arguments)))
        base = None if state is None else state.base(self.now)
        return state is not None and (base is None or state.value != value_now(KnowledgeType.FUNCTION, base, self.now))

    def follow(self, events: Iterable[TimelineEvent]) -> None:
        """Take over the values and rates that runs give to numbers: now, and later as derived assertions (rule O5)."""
        derived: dict[TimelineState, dict[int, Value | None]] = {
            state: {} for state in self.loaded(self._repository.derived_ahead(self.now))
        }
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
                derived.setdefault(state, {})[event.time] = event.value
        for state, values in derived.items():
            state.derived = values

    # -- objects ----------------------------------------------------------------------------------------------

    def lifespans(self, state: TimelineState) -> list[Lifespan]:
        """Return the lifespans of an INSTANCE timeline's object from now on, with the changes of this transaction."""
        return lifespans_of(state.value, state.ahead, self.now)

    def stored_lifespans(self, state: TimelineState) -> list[Lifespan]:
        """Return the lifespans of an INSTANCE timeline's object from now on as they are stored."""
        base = state.base(self.now)
        ahead = {t: row.value for t, row in state.stored_ahead.items()}
        return lifespans_of(None if base is None else base.value, ahead, self.now)

    def drop_mentions(self, state: TimelineState, before: Sequence[Lifespan], cause: EndCause) -> None:
        """End and cancel what mentions an object, from the end of its existence to its next start (rule C9).

        `before` are its lifespans before the change.
        """
        after = self.lifespans(state)
        # up to the next start: without a domain, assertions may be scheduled for times at which it does not exist
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
        """Return whether the value now, or at `t`, mentions an object: values of the metric mention different ones."""
        value = state.value if t is None else state.ahead[t]
        return value is not None and about.timeline.key in self.mentions(state.timeline, value)

    def mentioning(self, state: TimelineState) -> list[TimelineState]:
        """Return the timelines that mention the object of an INSTANCE timeline, stored and new."""
        name = state.timeline.key
        stored = self._mentioning.get(name)
        if stored is None:
            ids = [state.timeline.id] if state.timeline.id else []
            stored = self._mentioning[name] = self.loaded(self._repository.mentioning(ids)) if ids else []
        return [*stored, *(state for state in self._new_mentioning().get(name, ()) if state not in stored)]

    def _new_mentioning(self) -> dict[str, list[TimelineState]]:
        """Return, by object, the timelines mentioning it that are new, or whose mentions vary by value (the metric)."""
        by_object: dict[str, list[TimelineState]] = defaultdict(list)
        metric = self._groups[Role.STATE, KnowledgeType.EXPRESSION].values()
        for state in dict.fromkeys((*self._new, *metric)):
            values = ([] if state.value is None else [state.value]) + list(state.ahead.values())
            if state.past is not None:
                values += [piece.value for piece in state.past.pieces]
            for name in {name for value in values for name in self.mentions(state.timeline, value)}:
                by_object[name].append(state)
        return by_object

    def overlay(self, rows: dict[Identity, StateRow], pending: dict[tuple[Identity, int], StateRow]) -> None:
        """Apply the transaction's changes to stored rows: those that hold now, and the scheduled ones."""
        for state in self.states():
            identity = state.timeline.identity
            base = state.base(self.now)
            if state.value is None:
                rows.pop(identity, None)
            elif state.is_edited:
                piece = state.pieces(self.now)[-1]
                rows[identity] = (state.timeline, piece.start, piece.value)
            elif base is None or state.value != value_now(state.timeline.kind, base, self.now):
                rows[identity] = (state.timeline, self.now, state.value)
            for t in state.stored_ahead.keys() - state.ahead.keys():
                pending.pop((identity, t), None)
            for t, value in state.ahead.items():
                pending[identity, t] = (state.timeline, t, value)
