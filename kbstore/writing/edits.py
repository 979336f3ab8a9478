"""What updates do to timelines: to those of the present and the schedule, and to the past by late knowledge."""

from collections.abc import Callable, Iterable, Sequence
from typing import Protocol

from kbstore.messages import KnowledgeType
from kbstore.model.timelines import EndCause, Role, Timeline, Value
from kbstore.storage.records import LogPosition
from kbstore.storage.repository import Repository
from kbstore.writing.change_set import ChangeSet
from kbstore.writing.past import Past
from kbstore.writing.timeline_state import TimelineState


class Edits(Protocol):
    """What an update does to the timelines that it is about, at its time `t`."""

    def put(self, state: TimelineState, value: Value, t: int) -> None:
        """Assert a value."""

    def candidates(self, role: Role, kind: KnowledgeType, pattern: Sequence[str], t: int) -> Iterable[Timeline]:
        """Return the stored timelines that may match a pattern with wildcards."""

    def remove(self, states: Iterable[TimelineState], matches: Callable[[Value], bool], t: int) -> None:
        """Remove the values that match."""


class PresentEdits:
    """Edits of current and scheduled assertions (an `Edits`)."""

    def __init__(self, change_set: ChangeSet, repository: Repository) -> None:
        self._change_set = change_set
        self._repository = repository
        self.put = change_set.put

    def candidates(self, role: Role, kind: KnowledgeType, pattern: Sequence[str], t: int) -> Iterable[Timeline]:
        """Return the timelines with a current assertion or, for a later time, a scheduled one."""
        del role, pattern
        now = self._change_set.now
        read = self._repository.scheduled_at if t > now else self._repository.state_at
        return [timeline for timeline, *_ in read(kind, LogPosition(now))]

    def remove(self, states: Iterable[TimelineState], matches: Callable[[Value], bool], t: int) -> None:
        """End what holds, or cancel what is scheduled for `t`, where it matches (rules C4, C5)."""
        for state in states:
            value = self._change_set.value_at(state, t)
            if value is not None and matches(value):
                self._change_set.take(state, t, EndCause.REMOVED)


class LateEdits:
    """Edits of the past since a time (an `Edits`): additions are collected, matches are removed."""

    def __init__(self, repository: Repository, past: Past, until: int | None) -> None:
        self._repository = repository
        self._past = past
        self._until = until
        self.puts: list[tuple[TimelineState, Value]] = []

    def put(self, state: TimelineState, value: Value, t: int) -> None:
        """Collect a value; it is not yet checked under the other versions of the domain."""
        del t
        self.puts.append((state, value))

    def candidates(self, role: Role, kind: KnowledgeType, pattern: Sequence[str], t: int) -> Iterable[Timeline]:
        """Return the timelines of what held then; with `until`, those that may have held later in the span, too."""
        if self._until is None:
            return [timeline for timeline, *_ in self._repository.state_at(kind, LogPosition(t))]
        if kind is KnowledgeType.INSTANCE:
            return self._repository.of_kind(role, kind)
        return self._repository.of_symbol(role, kind, pattern[0])

    def remove(self, states: Iterable[TimelineState], matches: Callable[[Value], bool], t: int) -> None:
        """Remove the values that match, up to the next change or to `until` (rule L3)."""
        for state in list(states):
            self._past.blank(state, matches, t, self._until)
