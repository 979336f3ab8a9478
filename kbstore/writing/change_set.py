"""A transaction's working copy of the timelines that it touches, and what is to be written of it.

Updates apply to the draft one after another; only at the end is each timeline compared with what is stored, so that
of what a transaction says about one timeline and one time only the last word is recorded (rule C1).

Ends that lie ahead are always derived, never remembered: whatever is not ended by a transaction at the
transaction's own time ends at the earlier of the next assertion on its timeline and the end of the existence of any
object that it mentions (rules V1, C6, C9). `Draft.finish` derives them anew for all that the transaction touched.
"""

from collections import defaultdict
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from itertools import chain
from typing import Any

from kbstore.clock import OPEN
from kbstore.messages import KnowledgeType
from kbstore.model.timelines import EndCause, Identity, Role, Timeline, Value, number_at
from kbstore.storage.repository import Repository, StoredAssertion
from kbstore.writing.lifespans import Lifespan, lifespans_of, lost_time

StateRow = tuple[Timeline, int, Value]
Mentions = Callable[[Timeline, Value], Sequence[str]]

_GROUPS = tuple((role, kind) for role in Role for kind in KnowledgeType)


class TimelineState:
    """One timeline in a transaction: what is stored from now on, and what the transaction makes of it."""

    __slots__ = ("ahead", "cause", "latest", "stored_ahead", "timeline", "value")

    def __init__(self, timeline: Timeline, rows: Sequence[StoredAssertion], now: int) -> None:
        self.timeline = timeline
        self.latest: StoredAssertion | None = None
        """The latest stored row that begins no later than now; it may have ended."""
        self.stored_ahead: dict[int, StoredAssertion] = {}
        for row in rows:
            if row.initial_time <= now:
                self.latest = row
            else:
                self.stored_ahead[row.initial_time] = row
        base = self.base(now)
        self.value: Value | None = None if base is None else base.value
        """What stands now; of a function, with its value at now."""
        if base is not None and timeline.kind is KnowledgeType.FUNCTION:
            self.value = (False, number_at(base.value, base.initial_time, now), *base.value[2:])
        self.ahead: dict[int, Value] = {t: row.value for t, row in self.stored_ahead.items()}
        """What is scheduled, by its time."""
        self.cause = EndCause.REPLACED
        """Why what stood at first does not stand any more."""

    def base(self, now: int) -> StoredAssertion | None:
        """The stored row that stands at now."""
        latest = self.latest
        return latest if latest is not None and latest.end_time > now else None

    def copy(self) -> tuple[Value | None, dict[int, Value], EndCause]:
        """What `restore` takes back."""
        return self.value, self.ahead.copy(), self.cause

    def restore(self, copy: tuple[Value | None, dict[int, Value], EndCause]) -> None:
        """Take back what was done since the copy."""
        self.value, self.ahead, self.cause = copy


@dataclass
class RowChanges:
    """What a transaction writes: parameters for the statements of `kbstore.storage.queries`."""

    timelines: list[TimelineState] = field(default_factory=list)
    mentions: list[tuple[TimelineState, TimelineState]] = field(default_factory=list)
    ends: dict[KnowledgeType, list[dict[str, Any]]] = field(default_factory=lambda: defaultdict(list))
    cancels: dict[KnowledgeType, list[dict[str, Any]]] = field(default_factory=lambda: defaultdict(list))
    settles: dict[KnowledgeType, list[dict[str, Any]]] = field(default_factory=lambda: defaultdict(list))
    rates: list[dict[str, Any]] = field(default_factory=list)
    adds: dict[KnowledgeType, list[tuple[TimelineState, int, int, Value]]] = field(
        default_factory=lambda: defaultdict(list)
    )
    changes: int = 0


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
        """How often the existence of an object has changed in the draft."""
        self._mentioning: dict[str, list[TimelineState]] = {}
        self._journal: dict[TimelineState, tuple[Value | None, dict[int, Value], EndCause]] = {}
        self.contributions: dict[Identity, float] = {}
        """What running actions add to the rates of functions, per second."""

    # -- tracks -----------------------------------------------------------------------------------------------

    def group(self, role: Role, kind: KnowledgeType) -> dict[str, TimelineState]:
        """The tracks of one role and knowledge type that the draft has, by key."""
        return self._groups[role, kind]

    def track(self, identity: Identity, spelling: str) -> TimelineState:
        """The track of a timeline; `spelling` counts where the timeline is new."""
        role, kind, name = identity
        group = self._groups[role, kind]
        track = group.get(name)
        if track is None and name not in self._absent[role, kind]:
            track = self.known(identity)
        if track is None:
            timeline = Timeline(0, role, kind, name, None if spelling == name else spelling)
            track = group[name] = TimelineState(timeline, (), self.now)
            self._new.append(track)
        return track

    def known(self, identity: Identity) -> TimelineState | None:
        """The track of a timeline, None if there is no such timeline."""
        role, kind, name = identity
        group = self._groups[role, kind]
        track = group.get(name)
        if track is None and name not in self._absent[role, kind]:
            self.load(role, kind, [name])
            track = group.get(name)
        return track

    def load(self, role: Role, kind: KnowledgeType, keys: Iterable[str]) -> None:
        """Read timelines at once, as far as they are stored."""
        group, absent = self._groups[role, kind], self._absent[role, kind]
        missing = [name for name in keys if name not in group and name not in absent]
        if missing:
            absent.update(missing)
            self._take_in(self._repository.find(role, kind, missing).values())

    def loaded(self, timelines: Iterable[Timeline]) -> list[TimelineState]:
        """The tracks of stored timelines."""
        timelines = list(timelines)
        self._take_in(timelines)
        return [self._by_id[timeline.id] for timeline in timelines]

    def all_tracks(self) -> Iterable[TimelineState]:
        """The tracks that the draft has."""
        return chain.from_iterable(group.values() for group in self._groups.values())

    def _take_in(self, timelines: Iterable[Timeline]) -> None:
        by_kind: dict[KnowledgeType, list[Timeline]] = defaultdict(list)
        for timeline in timelines:
            if timeline.id not in self._by_id:
                by_kind[timeline.kind].append(timeline)
        for kind, wanted in by_kind.items():
            rows = self._repository.rows_for_update(kind, [timeline.id for timeline in wanted], self.now)
            for timeline in wanted:
                track = TimelineState(timeline, rows.get(timeline.id, ()), self.now)
                self._groups[timeline.role, kind][timeline.key] = track
                self._by_id[timeline.id] = track

    # -- changes ----------------------------------------------------------------------------------------------

    def set(self, track: TimelineState, value: Value) -> None:
        """What stands now on a timeline."""
        self._touch(track)
        if track.value is not None:
            track.cause = EndCause.REPLACED
        track.value = value

    def schedule(self, track: TimelineState, t: int, value: Value) -> None:
        """What is to stand from a later time on; it replaces what was scheduled for that time (rule C6)."""
        self._touch(track)
        track.ahead[t] = value

    def end(self, track: TimelineState, cause: EndCause) -> None:
        """What stands now stands no longer."""
        self._touch(track)
        track.value = None
        track.cause = cause

    def cancel(self, track: TimelineState, t: int) -> None:
        """What was scheduled for `t` will not be."""
        self._touch(track)
        del track.ahead[t]

    def _touch(self, track: TimelineState) -> None:
        if track not in self._journal:
            self._journal[track] = track.copy()
        if track.timeline.kind is KnowledgeType.INSTANCE:
            self.objects_changed += 1

    def savepoint(self) -> None:
        """From here on, `roll_back` takes changes back."""
        self._journal.clear()

    def roll_back(self) -> None:
        """Take back every change since the savepoint."""
        for track, copy in self._journal.items():
            track.restore(copy)
        self._journal.clear()
        self.objects_changed += 1

    # -- objects ----------------------------------------------------------------------------------------------

    def lifespans(self, track: TimelineState) -> list[Lifespan]:
        """When the object of an INSTANCE timeline exists from now on, as the draft has it."""
        return lifespans_of(track.value, track.ahead, self.now)

    def stored_lifespans(self, track: TimelineState) -> list[Lifespan]:
        """The same as it is stored."""
        base = track.base(self.now)
        ahead = {t: row.value for t, row in track.stored_ahead.items()}
        return lifespans_of(None if base is None else base.value, ahead, self.now)

    def drop_mentions(self, track: TimelineState, before: Sequence[Lifespan], cause: EndCause) -> None:
        """End and cancel what mentions an object, from when it does not exist any more to its next start (rule C9)."""
        after = self.lifespans(track)
        # without a domain something may have been scheduled even for a time in which it did not exist
        lost = [
            (start, min((lifespan.start for lifespan in after if lifespan.start > start), default=OPEN))
            for start, _ in lost_time(before, after)
        ]
        if not lost:
            return
        for mentioning in self.mentioning(track):
            if lost[0][0] == self.now and mentioning.value is not None and self._speaks(mentioning, None, track):
                self.end(mentioning, cause)
            for t in [t for t in mentioning.ahead if any(start <= t < end for start, end in lost)]:
                if self._speaks(mentioning, t, track):
                    self.cancel(mentioning, t)

    def _speaks(self, track: TimelineState, t: int | None, about: TimelineState) -> bool:
        """Whether what stands (or is scheduled for `t`) mentions an object: the metric's timeline holds many things."""
        value = track.value if t is None else track.ahead[t]
        return value is not None and about.timeline.key in self._mentions(track.timeline, value)

    def mentioning(self, track: TimelineState) -> list[TimelineState]:
        """The tracks that mention the object of an INSTANCE timeline, in the store and in the draft."""
        name = track.timeline.key
        stored = self._mentioning.get(name)
        if stored is None:
            ids = [track.timeline.id] if track.timeline.id else []
            stored = self._mentioning[name] = self.loaded(self._repository.mentioning(ids)) if ids else []
        drafted = [found for found in self._new_mentioning().get(name, ()) if found not in stored]
        return [*stored, *drafted]

    def _new_mentioning(self) -> dict[str, list[TimelineState]]:
        """Which of the timelines that are new, or whose values mention what they like, mention an object."""
        found: dict[str, list[TimelineState]] = defaultdict(list)
        metric = self._groups[Role.STATE, KnowledgeType.EXPRESSION].values()
        for track in dict.fromkeys((*self._new, *metric)):
            values = ([] if track.value is None else [track.value]) + list(track.ahead.values())
            for name in {name for value in values for name in self._mentions(track.timeline, value)}:
                found[name].append(track)
        return found

    def overlay(self, rows: dict[Identity, StateRow], pending: dict[tuple[Identity, int], StateRow]) -> None:
        """Put what the draft has in the place of what is stored, standing and pending."""
        for track in list(self.all_tracks()):
            identity = track.timeline.identity
            if track.timeline.kind is KnowledgeType.FUNCTION:
                self._add_contributions(track)
            base = track.base(self.now)
            if track.value is None:
                rows.pop(identity, None)
            elif base is None or track.value != self._value_now(track, base):
                rows[identity] = (track.timeline, self.now, track.value)
            for t in track.stored_ahead.keys() - track.ahead.keys():
                pending.pop((identity, t), None)
            for t, value in track.ahead.items():
                pending[identity, t] = (track.timeline, t, value)

    # -- what is written --------------------------------------------------------------------------------------

    def finish(self, number: int) -> RowChanges:
        """Compare the draft with what is stored: what the transaction `number` has to write."""
        writes = RowChanges()
        objects = self._groups[Role.STATE, KnowledgeType.INSTANCE]
        if self.objects_changed:
            for track in list(objects.values()):
                if self._ends(self.lifespans(track)) != self._ends(self.stored_lifespans(track)):
                    self.mentioning(track)
        # what ends ahead because an object does; objects on which nothing is scheduled end nothing ahead
        ends = {track.timeline.key: self._ends(self.lifespans(track)) for track in self._all_scheduled_objects()}
        for track in list(self.all_tracks()):
            self._finish_track(track, number, ends, writes)
        self._note_new(writes)
        return writes

    def _note_new(self, writes: RowChanges) -> None:
        """The timelines that are new, and which objects they mention."""
        new: dict[TimelineState, None] = {}
        objects = self._groups[Role.STATE, KnowledgeType.INSTANCE]
        for kind, added in writes.adds.items():
            for track, _, _, value in added:
                if not track.timeline.id:
                    new[track] = None
                elif kind is not KnowledgeType.EXPRESSION:
                    continue
                for name in self._mentions(track.timeline, value):
                    about = objects.get(name)
                    if about is None:
                        about = self.track(Identity(Role.STATE, KnowledgeType.INSTANCE, name), name)
                    if not about.timeline.id:
                        new[about] = None
                    writes.mentions.append((track, about))
        writes.timelines = list(new)

    def _all_scheduled_objects(self) -> list[TimelineState]:
        stored = self.loaded(self._repository.timelines_of(self._repository.scheduled_objects(self.now)))
        objects = self._groups[Role.STATE, KnowledgeType.INSTANCE].values()
        return list(dict.fromkeys((*stored, *(track for track in objects if track.ahead))))

    @staticmethod
    def _ends(existences: Sequence[Lifespan]) -> list[int]:
        return [lifespan.end for lifespan in existences if lifespan.end != OPEN]

    def _finish_track(self, track: TimelineState, number: int, ends: dict[str, list[int]], writes: RowChanges) -> None:
        kind = track.timeline.kind
        base = track.base(self.now)
        if base is None and track.value is None and not track.ahead and not track.stored_ahead:
            return
        if kind is KnowledgeType.FUNCTION:
            self._add_contributions(track)
        changed = False
        standing_again = base is not None and track.value == self._value_now(track, base)
        # (initial time, value, the stored row if it stays)
        line: list[tuple[int, Value, StoredAssertion | None]] = []
        if base is not None and standing_again:
            line.append((base.initial_time, base.value, base))
        else:
            if base is not None:
                changed = True
                cause = track.cause if track.value is None else EndCause.REPLACED
                writes.ends[kind].append(_end(base, self.now, number, cause))
            if track.value is not None:
                line.append((self.now, track.value, None))
        for t in sorted(track.ahead):
            stored = track.stored_ahead.get(t)
            value = track.ahead[t]
            if stored is not None and _same_but_rate(kind, stored.value, value):
                line.append((t, value, stored))
                if stored.value != value:
                    writes.rates.append({"id": stored.id, "rate": value[3]})
            else:
                line.append((t, value, None))
        for t, stored in track.stored_ahead.items():
            if t not in track.ahead or not _same_but_rate(kind, stored.value, track.ahead[t]):
                changed = True
                writes.cancels[kind].append(_cancel(stored, self.now, number))
        for index, (start, value, stored) in enumerate(line):
            end = line[index + 1][0] if index + 1 < len(line) else OPEN
            if ends:
                for name in self._mentions(track.timeline, value):
                    end = min(end, min((t for t in ends.get(name, ()) if t > start), default=OPEN))
            if stored is None:
                changed = True
                writes.adds[kind].append((track, start, end, value))
            elif stored.end_time != end:
                writes.settles[kind].append(_settle(stored, end))
        writes.changes += changed

    def _add_contributions(self, track: TimelineState) -> None:
        """A function's rate is its own and what running actions add to it (rule O3)."""
        added = self.contributions.get(track.timeline.identity)

        def with_rate(value: Value) -> Value:
            return (*value[:3], value[2] if added is None else value[2] + added)

        if track.value is not None:
            track.value = with_rate(track.value)
        track.ahead = {t: with_rate(value) for t, value in track.ahead.items()}

    def _value_now(self, track: TimelineState, base: StoredAssertion) -> Value:
        if track.timeline.kind is not KnowledgeType.FUNCTION:
            return base.value
        return (False, number_at(base.value, base.initial_time, self.now), *base.value[2:])


def _same_but_rate(kind: KnowledgeType, stored: Value, value: Value) -> bool:
    """Whether a scheduled value is the stored one; a function's rate besides its own is derived."""
    return stored[:3] == value[:3] if kind is KnowledgeType.FUNCTION else stored == value


def _end(row: StoredAssertion, now: int, number: int, cause: EndCause) -> dict[str, Any]:
    return {"id": row.id, "start": row.initial_time, "end_time": now, "number": number, "cause": int(cause)}


def _cancel(row: StoredAssertion, now: int, number: int) -> dict[str, Any]:
    return {"id": row.id, "recorded_time": row.recorded_time, "time": now, "number": number}


def _settle(row: StoredAssertion, end: int) -> dict[str, Any]:
    return {"id": row.id, "start": row.initial_time, "end_time": end}
