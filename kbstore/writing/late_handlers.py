"""Handlers for late knowledge: add and remove since a time in the past (rules L1 to L6)."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import TypeVar

from kbstore.clock import OPEN, TimeLike, isoformat, time
from kbstore.errors import InvalidTime, ScheduledRelativeChange
from kbstore.messages import AssignOp, Expression, Function, Goal, Inequality, Instance, KnowledgeItem, KnowledgeType
from kbstore.model.lifespans import Lifespan
from kbstore.model.symbols import SymbolTable
from kbstore.model.timelines import Role, Timeline, Value
from kbstore.names import key
from kbstore.storage.records import LogPosition
from kbstore.storage.repository import Repository
from kbstore.writing.change_set import ChangeSet
from kbstore.writing.handlers import Handlers
from kbstore.writing.object_handlers import ObjectHandlers, meeting
from kbstore.writing.past import Past
from kbstore.writing.past_rates import PastRates
from kbstore.writing.resolution import NameResolver, Violations
from kbstore.writing.timeline_state import TimelineState

Item = TypeVar("Item", KnowledgeItem, Goal)
Version = tuple[int, SymbolTable]
"""The time from which on a version of the domain is in force, in nanoseconds, and its symbols."""


def late_span(since: TimeLike | None, until: TimeLike | None, now: int) -> tuple[int, int | None] | None:
    """Return the span of late knowledge; None if `since` is not given, or is now.

    Raises `InvalidTime` for a `since` or `until` after now, or for an `until` alone or not after `since` (rule L1).
    """
    if since is None:
        if until is not None:
            raise InvalidTime("until belongs to since, a time that has passed; what ends later is scheduled to end")
        return None
    start, end = time(since, now), None if until is None else time(until, now)
    if start > now:
        raise InvalidTime(
            f"since ({isoformat(start)}) lies after now ({isoformat(now)}); schedule what is to hold from then on "
            "with initial_time"
        )
    if end is not None and end <= start:
        raise InvalidTime(f"until ({isoformat(end)}) is not after since ({isoformat(start)}); give them in order")
    if end is not None and end > now:
        raise InvalidTime(
            f"until ({isoformat(end)}) lies after now ({isoformat(now)}); leave it out, and schedule what is to hold "
            "from then on with initial_time"
        )
    return None if start == now else (start, end)


class LateHandlers:
    """Adds and removes items since a time in the past, until another time or the next change.

    An item is checked against each version of the domain that is in force while it holds (rule L5).
    """

    def __init__(
        self,
        change_set: ChangeSet,
        repository: Repository,
        versions: Sequence[Version],
        on_removed_object: Callable[[str], None],
        since: int,
        until: int | None,
        *,
        use_unknowns: bool,
    ) -> None:
        self._past = Past(change_set, repository)
        self._past_rates = PastRates(repository, versions, use_unknowns=use_unknowns)
        self._change_set = change_set
        self._repository = repository
        self._versions = versions
        self._on_removed_object = on_removed_object
        self._since = since
        self._until = until

    def add(self, item: KnowledgeItem, t: int) -> Violations:
        """Add an item to the state."""
        self._refuse(item, t)
        if isinstance(item, Expression | Inequality):
            what = "a metric" if isinstance(item, Expression) else "a recorded inequality"
            raise InvalidTime(f"{item}: {what} cannot be late knowledge; add it without since")
        if isinstance(item, Function) and item.assign_op is not AssignOp.ASSIGN:
            raise ScheduledRelativeChange(
                f"{item} changes a value relative to what it was at {isoformat(self._since)}, which cannot be "
                f"late knowledge; give the value, as: (= {item.atom} 80)"
            )
        if isinstance(item, Instance) and item.is_negative:
            return self.remove(item.changed(is_negative=False), t)
        return self._add(item, Handlers.add)

    def add_metric(self, item: KnowledgeItem, t: int) -> Violations:
        """Refuse a metric."""
        return self.add(item, t)

    def remove_metric(self, item: KnowledgeItem, t: int) -> Violations:
        """Refuse a metric."""
        return self.remove(item, t)

    def add_goal(self, goal: Goal, t: int) -> Violations:
        """Add a part of the goal."""
        self._refuse(goal, t)
        return self._add(goal, Handlers.add_goal)

    def remove(self, item: KnowledgeItem, t: int) -> Violations:
        """Remove what matched an item: from `since` to the next change, or to `until`."""
        self._refuse(item, t)
        if isinstance(item, Expression | Inequality):
            what = "a metric" if isinstance(item, Expression) else "a recorded inequality"
            raise InvalidTime(f"{item}: {what} cannot be removed late; remove it without since")
        return self._remove(item, Handlers.remove)

    def remove_goal(self, goal: Goal, t: int) -> Violations:
        """Remove a part of the goal."""
        self._refuse(goal, t)
        return self._remove(goal, Handlers.remove_goal)

    def _refuse(self, item: object, t: int) -> None:
        """Refuse an item with a time of its own that lies ahead (rule L1)."""
        if t > self._change_set.now:
            raise InvalidTime(
                f"{item} has the initial_time {isoformat(t)}, which lies ahead, but is given with since; schedule it "
                "without since"
            )

    # -- adding -----------------------------------------------------------------------------------------------

    def _add(self, item: Item, add: "Callable[[_Checks, Item, int], Violations]") -> Violations:
        first, *_ = self._in_force(self._since, self._since + 1)
        checks = self._checks(first)
        violations = list(add(checks, item, self._since))
        if violations:
            return violations
        ((state, value),) = checks.puts
        end = self._past.end_of(state, value, self._since) if self._until is None else self._until
        for symbols in self._in_force(self._since, end):
            checks = self._checks(symbols)
            violations += add(checks, item, self._since)
            violations += self._not_throughout(item, state, value, symbols)
        violations += self._meetings(state, value, end)
        if not violations:
            ((state, value),) = checks.puts
            self._past.put(state, value, self._since, self._until, self._past_rates)
        return tuple(dict.fromkeys(violations))

    def _checks(self, symbols: SymbolTable) -> "_Checks":
        return _Checks(self._change_set, self._repository, symbols, self._on_removed_object, self._until)

    def _in_force(self, start: int, end: int) -> Iterator[SymbolTable]:
        """Yield the symbols of the domain's versions that are in force somewhere in a span, in order."""
        ends = [since for since, _ in self._versions[1:]] + [OPEN]
        for (since, symbols), until in zip(self._versions, ends, strict=True):
            if max(since, start) < min(until, end):
                yield symbols

    def _not_throughout(self, item: object, state: TimelineState, value: Value, symbols: SymbolTable) -> Iterator[str]:
        """Yield a violation for each object that does not exist in all of the span (rule L5)."""
        domain = symbols.domain
        if self._until is None or domain is None:
            return
        for name in self._change_set.mentions(state.timeline, value):
            about = self._change_set.object(name)
            if about is None or domain.constant_spelling(name) is not None:
                continue
            if not self._past.exists_throughout(about, self._since, self._until):
                span = f"from {isoformat(self._since)} until {isoformat(self._until)}"
                yield f"{item}: {about.timeline.spelling} does not exist all the time {span}"

    def _meetings(self, state: TimelineState, value: Value, end: int) -> Iterator[str]:
        """Yield a violation for each existence of an object with another type that a new one would meet (C6, C8)."""
        if state.timeline.kind is not KnowledgeType.INSTANCE:
            return
        late = Lifespan(self._since, end, value[1])
        for other in self._change_set.existences(state):
            if key(other.type_name) != key(late.type_name) and other.start <= late.end and late.start <= other.end:
                yield meeting(state.timeline.spelling, *sorted((other, late)))

    # -- removing ---------------------------------------------------------------------------------------------

    def _remove(self, item: Item, remove: "Callable[[_Checks, Item, int], Violations]") -> Violations:
        """Remove an item under the latest version of the domain that knows its symbols."""
        end = self._since + 1 if self._until is None else self._until
        violations: Violations = ()
        for symbols in reversed(list(self._in_force(self._since, end))):
            violations = remove(self._checks(symbols), item, self._since)
            if not violations:
                return ()
        return violations


class _Checks(Handlers):
    """The handlers under one version of the domain; they collect what is to be added, and remove in the past."""

    def __init__(
        self,
        change_set: ChangeSet,
        repository: Repository,
        symbols: SymbolTable,
        on_removed_object: Callable[[str], None],
        until: int | None,
    ) -> None:
        super().__init__(change_set, repository, symbols, on_removed_object)
        self.puts: list[tuple[TimelineState, Value]] = []
        self._until = until
        self._put = self._collect
        self._past = Past(change_set, repository)
        self._objects = _Objects(change_set, repository, self.resolver, on_removed_object, until, self._collect)

    def _collect(self, state: TimelineState, value: Value, t: int) -> None:
        self.puts.append((state, value))

    def _candidates(self, role: Role, kind: KnowledgeType, pattern: Sequence[str], t: int) -> Iterable[Timeline]:
        if self._until is None:
            return [timeline for timeline, *_ in self._repository.state_at(kind, LogPosition(t))]
        if kind is KnowledgeType.INSTANCE:
            return self._repository.of_kind(role, kind)
        return self._repository.of_symbol(role, kind, pattern[0])

    def _remove_matching(self, states: Iterable[TimelineState], matches: Callable[[Value], bool], t: int) -> None:
        for state in list(states):
            self._past.blank(state, matches, t, self._until)


class _Objects(ObjectHandlers):
    """The same as `_Checks`, for objects."""

    def __init__(
        self,
        change_set: ChangeSet,
        repository: Repository,
        resolver: NameResolver,
        on_removed: Callable[[str], None],
        until: int | None,
        collect: Callable[[TimelineState, Value, int], None],
    ) -> None:
        super().__init__(change_set, repository, resolver, on_removed)
        self._until = until
        self._collect = collect

    def add(self, item: Instance, t: int) -> Violations:
        violations = self._instance_violations(item)
        if not violations:
            state = self._resolver.object(item.instance_name)
            self._collect(state, (False, self._type_spelling(state, item.instance_type or "object")), t)
        return violations

    def remove(self, item: Instance, states: Iterable[TimelineState], t: int) -> Violations:
        violations = self._removal_violations(item)
        if violations:
            return violations
        past = Past(self._change_set, self._repository)
        for state in list(states):
            before = self._change_set.existences(state)
            past.blank(state, lambda value: self._matches(item, value), t, self._until)
            past.lose(state, before, self._on_removed_object)
        return ()
