"""Turns a transaction's change set into row changes, by comparing each timeline with its stored rows.

Ends that lie ahead are always derived: a row ends at the next assertion on its timeline, or when an object that it
mentions ceases to exist, whichever is earlier (rules V1, C6, C9). They are derived anew for everything that the
transaction touched.
"""

from collections.abc import Sequence

from kbstore.clock import OPEN
from kbstore.messages import KnowledgeType
from kbstore.model.lifespans import Lifespan
from kbstore.model.timelines import EndCause, Role, Timeline, Value
from kbstore.storage.records import LateAssertion, RowChanges, StoredAssertion
from kbstore.storage.repository import Repository
from kbstore.writing.change_set import ChangeSet
from kbstore.writing.timeline_state import TimelineState, value_now

Line = list[tuple[int, Value | None, StoredAssertion | None, bool]]
"""The assertions on a timeline from now on: initial time, value (None: nothing), stored row if any, is derived."""


class Flush:
    """Compares the timelines that a transaction touched with their stored rows."""

    def __init__(self, change_set: ChangeSet, repository: Repository) -> None:
        self._set = change_set
        self._now = change_set.now
        self._repository = repository
        self._objects = change_set.group(Role.STATE, KnowledgeType.INSTANCE)
        self._writes = RowChanges()
        self._new: dict[Timeline, None] = {}

    def rows(self) -> RowChanges:
        """Return the row changes that the transaction has to write."""
        writes = self._writes
        if self._set.objects_changed:
            for state in list(self._objects.values()):
                if _ends(self._set.lifespans(state)) != _ends(self._set.stored_lifespans(state)):
                    self._set.mentioning(state)
        # only objects with a schedule can end assertions at later times
        ends = {state.timeline.key: _ends(self._set.lifespans(state)) for state in self._all_scheduled_objects()}
        for state in self._set.states():
            self._finish(state, ends)
        writes.timelines = list(self._new)
        if writes.late or writes.supersedes:
            writes.late_from = self._set.late_from
        return writes

    def _note_new(self, timeline: Timeline, value: Value) -> None:
        """Add what a new assertion needs to what is written: its timeline, and the objects that it mentions."""
        if not timeline.id:
            self._new[timeline] = None
        elif timeline.kind is not KnowledgeType.EXPRESSION:
            # another assertion on it has mentioned the same objects
            return
        for name in self._set.mentions(timeline, value):
            known = self._objects.get(name)
            if known is None:
                known = self._set.state((Role.STATE, KnowledgeType.INSTANCE, name), name)
            about = known.timeline
            if not about.id:
                self._new[about] = None
            self._writes.mentions.append((about, timeline))

    def _all_scheduled_objects(self) -> list[TimelineState]:
        found = [state for state in self._objects.values() if state.ahead]
        ids = self._repository.scheduled_objects(self._now)
        if not ids:
            return found
        stored = self._set.loaded(self._repository.timelines_of(ids))
        return list(dict.fromkeys((*stored, *found)))

    def _finish(self, state: TimelineState, ends: dict[str, list[int]]) -> None:
        writes = self._writes
        kind = state.timeline.kind
        line, changed = self._edited(state) if state.is_edited else self._present(state)
        is_touched = False
        if state.has_schedule:
            is_touched = True
            changed |= self._schedule(state, line)
        for index, (start, entry, stored, is_derived) in enumerate(line):
            if entry is None:
                if stored is not None:
                    writes.underived.append(stored)
                continue
            end = line[index + 1][0] if index + 1 < len(line) else OPEN
            if ends:
                for name in self._set.mentions(state.timeline, entry):
                    end = min(end, min((t for t in ends.get(name, ()) if t > start), default=OPEN))
            if is_derived:
                if stored is not None and (stored.value != entry or stored.end_time != end):
                    writes.underived.append(stored)
                    stored = None  # noqa: PLW2901 - it is derived anew
                if stored is None:
                    writes.derived.append((state.timeline, start, end, entry))
            elif stored is None:
                changed = True
                self._note_new(state.timeline, entry)
                if start < self._now:
                    first_recorded = state.pieces(self._now)[-1].first_recorded
                    writes.late[kind].append(LateAssertion(state.timeline, start, end, entry, first_recorded, None))
                else:
                    writes.adds[kind].append((state.timeline, start, end, entry))
            elif stored.end_time != end:
                is_touched = True
                writes.settles[kind].append((stored, end))
        writes.changes += changed
        if state.timeline.id and (is_touched or changed):
            writes.touched.append(state.timeline)

    def _present(self, state: TimelineState) -> tuple[Line, bool]:
        """Return the assertion that holds now on a timeline, if any, and whether that has changed."""
        writes = self._writes
        base = state.base(self._now)
        if base is not None and state.value == value_now(state.timeline.kind, base, self._now):
            return [(base.initial_time, base.value, base, False)], False
        if base is not None:
            cause = state.cause if state.value is None else EndCause.REPLACED
            writes.ends[state.timeline.kind].append((base, cause))
        return ([] if state.value is None else [(self._now, state.value, None, False)]), base is not None

    def _schedule(self, state: TimelineState, line: Line) -> bool:
        """Add the scheduled and the derived assertions to a line, and return whether something is cancelled."""
        writes = self._writes
        kind = state.timeline.kind
        for t in sorted({**state.derived, **state.ahead}):
            if t not in state.ahead:
                line.append((t, state.derived[t], state.stored_derived.get(t), True))
                continue
            stored = state.stored_ahead.get(t)
            value = state.ahead[t]
            if stored is not None and _same_but_rate(kind, stored.value, value):
                line.append((t, value, stored, False))
                if stored.value != value:
                    writes.rates.append((stored, value[3]))
            else:
                line.append((t, value, None, False))
        cancelled = [
            stored
            for t, stored in state.stored_ahead.items()
            if t not in state.ahead or not _same_but_rate(kind, stored.value, state.ahead[t])
        ]
        if cancelled:
            writes.cancels[kind] += cancelled
        writes.underived += [row for t, row in state.stored_derived.items() if t not in state.derived]
        return bool(cancelled)

    def _edited(self, state: TimelineState) -> tuple[Line, bool]:
        """Return the same as `_present` for a timeline whose past was changed by late knowledge (rule L8)."""
        writes = self._writes
        kind = state.timeline.kind
        assert state.past is not None
        pieces = {piece.start: piece for piece in state.pieces(self._now)}
        is_ended_now = state.is_ended_now(self._now)
        kept: dict[int, StoredAssertion] = {}
        changed = False
        for row in state.past.rows:
            stored, start = row.stored, row.stored.initial_time
            piece = pieces.get(start)
            end = piece.end if piece is not None and piece.value == stored.value else None
            if end == (OPEN if stored.end_time > self._now else stored.end_time):
                kept[start] = stored
                continue
            changed = True
            if stored.end_time > self._now and self._now in (start, end):
                writes.ends[kind].append((stored, state.cause if state.value is None else EndCause.REPLACED))
                if start < self._now:
                    kept[start] = stored
            else:
                writes.supersedes[kind].append(stored)
        line: Line = []
        for start, piece in pieces.items():
            if piece.end == OPEN:
                line.append((start, piece.value, kept.get(start), False))
            elif start not in kept:
                changed = True
                ended = None if piece.end in pieces else piece.ended
                if piece.end == self._now and ended is None and is_ended_now:
                    ended = (None, state.cause)
                self._note_new(state.timeline, piece.value)
                writes.late[kind].append(
                    LateAssertion(state.timeline, start, piece.end, piece.value, piece.first_recorded, ended)
                )
        return line, changed


def _ends(existences: Sequence[Lifespan]) -> list[int]:
    return [lifespan.end for lifespan in existences if lifespan.end != OPEN]


def _same_but_rate(kind: KnowledgeType, stored: Value, value: Value) -> bool:
    """Return whether a scheduled value is the stored one, apart from the derived rate of a function."""
    return stored[:3] == value[:3] if kind is KnowledgeType.FUNCTION else stored == value
