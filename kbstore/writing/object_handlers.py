"""Command handlers for objects: apply their updates to a transaction's change set (rules C6, C8, C9)."""

from collections.abc import Callable, Iterable, Sequence
from itertools import pairwise

from kbstore import names
from kbstore.clock import isoformat
from kbstore.errors import one_line
from kbstore.messages import Instance
from kbstore.model.lifespans import Lifespan
from kbstore.model.timelines import EndCause, Value
from kbstore.names import is_wildcard, key
from kbstore.storage.repository import Repository
from kbstore.writing.change_set import ChangeSet
from kbstore.writing.resolution import NameResolver, Violations
from kbstore.writing.timeline_state import TimelineState


class ObjectHandlers:
    """Begins and ends the existence of objects; an end also ends everything that mentions the object."""

    def __init__(
        self,
        change_set: ChangeSet,
        repository: Repository,
        resolver: NameResolver,
        on_removed: Callable[[str], None],
    ) -> None:
        self._change_set = change_set
        self._repository = repository
        self._resolver = resolver
        self._domain = resolver.domain
        self._on_removed_object = on_removed
        self._now = change_set.now

    def add(self, item: Instance, t: int) -> Violations:
        """Add an object from `t`, now or later, on; a negative item ends it."""
        name, type_name = item.instance_name, item.instance_type or "object"
        violations = self.adding_violations(item)
        if violations:
            return violations
        state = self._resolver.object(name)
        if item.is_negative and t == self._now:
            return self.remove(item.changed(is_negative=False), [state], t)
        type_name = self.type_spelling(state, type_name)
        before = self._change_set.lifespans(state)
        if item.is_negative:
            existing = next((e.type_name for e in before if e.start < t <= e.end), None)
            if existing is not None and item.instance_type and key(existing) != key(type_name):
                return ()
            self._change_set.put(state, (True, existing or type_name), t)
        elif t == self._now:
            value = state.value
            if value is not None and not value[0]:
                if key(value[1]) == key(type_name):
                    return ()
                return [f"{item}: {name} exists with the type {value[1]}; remove it first, or use another name"]
            ended = self._ended_now(state)
            if ended is not None and key(ended) != key(type_name):
                return [meeting(name, Lifespan(0, t, ended), Lifespan(t, t, type_name))]
        if not item.is_negative:
            self._change_set.put(state, (False, type_name), t)
        return self._settled_object(state, before)

    def type_spelling(self, state: TimelineState, type_name: str) -> str:
        """Return a type as the domain spells it; without a domain, as it was first written for the object (rule D3)."""
        if self._domain is not None:
            return self._domain.type_spelling(type_name)
        stored = [row.value for row in (state.latest, *state.stored_ahead.values()) if row is not None]
        written = [value[1] for value in (*stored, state.value, *state.ahead.values()) if value is not None]
        return next((str(spelling) for spelling in written if key(spelling) == key(type_name)), type_name)

    def adding_violations(self, item: Instance) -> Violations:
        """Return the violations of an object that is to be added, by its name and its type."""
        name, domain = item.instance_name, self._domain
        violations = []
        wrong = names.problem(name)
        if wrong:
            violations.append(f"{item}: the name {name!r:.60} {wrong}")
        type_name = item.instance_type
        if domain is not None:
            if domain.constant_spelling(name) is not None:
                violations.append(f"{item}: {name} is a constant of the domain: it always exists")
            if not domain.knows_type(type_name or "object"):
                known = ", ".join(domain.types) or "object"
                violations.append(f"{item}: the domain {domain.name} has no type {one_line(type_name)}; it has {known}")
        elif type_name and (wrong := names.problem(type_name)):
            violations.append(f"{item}: the type name {type_name!r:.60} {wrong}")
        return violations

    def _ended_now(self, state: TimelineState) -> str | None:
        """Return the type with which an object existed until exactly now; None if it did not."""
        if state.is_edited:
            assert state.past is not None
            last = state.past.pieces[-1] if state.past.pieces else None
            return None if last is None or last.end != self._now or last.value[0] else str(last.value[1])
        latest = state.latest
        if latest is not None and latest.initial_time == self._now:
            before = self._repository.latest_before([(state.timeline, self._now)])
            kept = [row for row in before if row.end_time == self._now]
            return None if not kept or kept[0].value[0] else str(kept[0].value[1])
        if latest is None or latest.value[0]:
            return None
        ends_now = latest.end_time == self._now or (latest.end_time > self._now and state.value is None)
        return str(latest.value[1]) if ends_now else None

    def _settled_object(self, state: TimelineState, before: Sequence[Lifespan]) -> Violations:
        """Check an object's lifespans (rule C6), and end what mentions it if it does not exist any more (rule C9)."""
        after = self._change_set.lifespans(state)
        for earlier, later in pairwise(after):
            if earlier.end == later.start:
                return [meeting(state.timeline.spelling, earlier, later)]
        self._change_set.drop_mentions(state, before, EndCause.OBJECT)
        existed = bool(before) and before[0].start == self._now
        if existed and not (after and after[0].start == self._now):
            self._on_removed_object(state.timeline.key)
        return ()

    def removing_violations(self, item: Instance) -> Violations:
        """Return the violations of a pattern of objects that are to be removed."""
        domain = self._domain
        if domain is not None:
            if item.instance_type and not domain.knows_type(item.instance_type):
                known = ", ".join(domain.types) or "object"
                return [f"{item}: the domain {domain.name} has no type {one_line(item.instance_type)}; it has {known}"]
            if domain.constant_spelling(item.instance_name) is not None:
                return [f"{item}: {item.instance_name} is a constant of the domain, which cannot be removed"]
        if is_wildcard(item.instance_name) and not item.instance_type:
            return [f"{item}: a removal names its object or its type; clear() removes everything"]
        return ()

    def remove(self, item: Instance, states: Iterable[TimelineState], t: int) -> Violations:
        """Remove the objects that match an item; at a time after now, cancel what is scheduled for them."""
        violations = self.removing_violations(item)
        if violations:
            return violations
        for state in states:
            value = self._change_set.value_at(state, t)
            if value is None or not self.matches(item, value):
                continue
            violations = self.end(state, t)
            if violations:
                return violations
        return ()

    def end(self, state: TimelineState, t: int) -> Violations:
        """End the existence of an object now; at a later time, cancel what is scheduled for it."""
        before = self._change_set.lifespans(state)
        self._change_set.take(state, t, EndCause.REMOVED)
        return self._settled_object(state, before)

    def matches(self, item: Instance, value: Value) -> bool:
        """Return whether an object matches a removal's item: by the sign, and by the type if one is given."""
        is_negative, type_name = value
        if bool(is_negative) != item.is_negative:
            return False
        if is_wildcard(item.instance_name) and self._domain is not None:
            return self._domain.is_subtype(type_name, [item.instance_type])
        return not item.instance_type or key(item.instance_type) == key(type_name)


def meeting(name: str, earlier: Lifespan, later: Lifespan) -> str:
    """Return the violation for an object that would change its type without an end in between."""
    return (
        f"{name} - {later.type_name} from {isoformat(later.start)} on: until then {name} exists with the type "
        f"{earlier.type_name}; an object changes its type only after an end strictly before"
    )
