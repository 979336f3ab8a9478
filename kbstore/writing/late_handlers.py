"""Handlers for late knowledge: add and remove since a time in the past (rules L1 to L6)."""

from collections.abc import Callable, Iterator, Sequence
from typing import TypeVar

from kbstore.clock import OPEN, TimeLike, isoformat, time
from kbstore.errors import InvalidTime, ScheduledRelativeChange
from kbstore.messages import AssignOp, Expression, Function, Goal, Inequality, Instance, KnowledgeItem, KnowledgeType
from kbstore.model.lifespans import Lifespan
from kbstore.model.symbols import SymbolTable
from kbstore.model.timelines import Role, Value
from kbstore.names import key
from kbstore.storage.repository import Repository
from kbstore.writing.change_set import ChangeSet
from kbstore.writing.edits import LateEdits
from kbstore.writing.handlers import Handlers
from kbstore.writing.object_handlers import meeting
from kbstore.writing.past import Past
from kbstore.writing.past_rates import PastRates
from kbstore.writing.resolution import Violations
from kbstore.writing.timeline_state import TimelineState

Item = TypeVar("Item", KnowledgeItem, Instance, Goal)
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
        if not isinstance(item, Instance):
            return self._add(item, Handlers.add)
        if item.is_negative:
            return self.remove(item.changed(is_negative=False), t)
        return self._add(item, self._add_object)

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
        if isinstance(item, Instance):
            return self._remove(item, self._remove_object)
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

    def _add(self, item: Item, add: Callable[[Handlers, Item, int], Violations]) -> Violations:
        """Check an item under each version of the domain in which it would hold, and put it into the past."""
        first, *_ = self._in_force(self._since, self._since + 1)
        violations, puts = self._checked(first, item, add)
        if violations:
            return violations
        ((state, value),) = puts
        end = self._past.end_of(state, value, self._since) if self._until is None else self._until
        found: list[str] = []
        for symbols in self._in_force(self._since, end):
            violations, puts = self._checked(symbols, item, add)
            found += violations
            found += self._not_throughout(item, state, value, symbols)
        found += self._meetings(state, value, end)
        if not found:
            ((state, value),) = puts
            self._past.put(state, value, self._since, self._until, self._past_rates)
        return tuple(dict.fromkeys(found))

    def _checked(
        self, symbols: SymbolTable, item: Item, add: Callable[[Handlers, Item, int], Violations]
    ) -> tuple[Violations, list[tuple[TimelineState, Value]]]:
        """Return the violations of an item under a version of the domain, and the value that it adds."""
        handlers, edits = self._under(symbols)
        return add(handlers, item, self._since), edits.puts

    def _under(self, symbols: SymbolTable) -> tuple[Handlers, LateEdits]:
        """Return the handlers of updates under a version of the domain, and the edits that they collect."""
        edits = LateEdits(self._repository, self._past, self._until)
        return Handlers(self._change_set, self._repository, symbols, self._on_removed_object, edits), edits

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

    def _remove(self, item: Item, remove: Callable[[Handlers, Item, int], Violations]) -> Violations:
        """Remove an item under the latest version of the domain that knows its symbols."""
        end = self._since + 1 if self._until is None else self._until
        violations: Violations = ()
        for symbols in reversed(list(self._in_force(self._since, end))):
            handlers, _ = self._under(symbols)
            violations = remove(handlers, item, self._since)
            if not violations:
                return ()
        return violations

    # -- objects ----------------------------------------------------------------------------------------------

    def _add_object(self, handlers: Handlers, item: Instance, t: int) -> Violations:
        violations = handlers.objects.adding_violations(item)
        if not violations:
            state = handlers.resolver.object(item.instance_name)
            type_name = handlers.objects.type_spelling(state, item.instance_type or "object")
            handlers.edits.put(state, (False, type_name), t)
        return violations

    def _remove_object(self, handlers: Handlers, item: Instance, t: int) -> Violations:
        """Remove an object, and what mentions it, from the times at which it does not exist any more (rule L5)."""
        objects = handlers.objects
        violations = objects.removing_violations(item)
        if violations:
            return violations
        for state in handlers.matching(Role.STATE, item.knowledge_type, (key(item.instance_name),), t):
            before = self._change_set.existences(state)
            handlers.edits.remove([state], lambda value: objects.matches(item, value), t)
            self._past.lose(state, before, self._on_removed_object)
        return ()
