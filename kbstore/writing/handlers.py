"""What each kind of update does to a transaction's draft (rules C2 to C12), checked before it is done.

Every method returns the violations that it found; if there are any, it has changed nothing.
"""

import math
from collections.abc import Callable, Iterable, Sequence

from kbstore.clock import isoformat
from kbstore.conversion import from_composite
from kbstore.errors import DivisionByZero, InvalidKnowledge, KbStoreError, ScheduledRelativeChange, UndefinedFunction
from kbstore.evaluation.wellformed import check
from kbstore.messages import (
    AssignOp,
    Condition,
    Expression,
    Fact,
    Function,
    Goal,
    Inequality,
    Instance,
    KnowledgeItem,
    KnowledgeType,
)
from kbstore.model.formulas import Atom, Comparison, Formula
from kbstore.model.symbols import SymbolTable
from kbstore.model.timelines import METRIC_KEY, EndCause, Identity, Role, Value, atom_key
from kbstore.names import is_wildcard, key
from kbstore.pddl.parse import condition_of, parse_condition
from kbstore.pddl.printer import condition_text, expression_text
from kbstore.storage.repository import LogPosition, Repository
from kbstore.writing.atom_resolution import AtomResolver
from kbstore.writing.canonical import Canonicalizer
from kbstore.writing.change_set import ChangeSet, TimelineState
from kbstore.writing.object_handlers import ObjectHandlers
from kbstore.writing.validation import Validator, naming, violations_of

Violations = Sequence[str]
_NONE: Violations = ()


class Handlers:
    """Applies updates to a draft, one after another, at one now."""

    def __init__(
        self,
        draft: ChangeSet,
        repository: Repository,
        symbol_table: SymbolTable,
        on_removed_object: Callable[[str], None],
    ) -> None:
        self._change_set = draft
        self._repository = repository
        self._symbols = symbol_table
        self._validator = Validator(draft, symbol_table)
        self.spelling = Canonicalizer(symbol_table, self._validator)
        self._atoms = AtomResolver(draft, self._validator, symbol_table)
        self._objects = ObjectHandlers(draft, repository, self._validator, symbol_table, on_removed_object)
        self._now = draft.now

    # -- adding -----------------------------------------------------------------------------------------------

    def add(self, item: KnowledgeItem, t: int) -> Violations:
        """Add an item to the state, from `t` on; a time that is not after now is now (rule T4)."""
        t = max(t, self._now)
        match item:
            case Fact():
                return self._add_fact(item, t)
            case Function():
                return self._add_function(item, t)
            case Instance():
                return self._objects.add(item, t)
            case Inequality():
                return self._add_inequality(item, Role.STATE, t)
            case Expression():
                return self.add_metric(item, t)

    def add_goal(self, goal: Goal, t: int) -> Violations:
        """Add a part of the goal (rule C10)."""
        t = max(t, self._now)
        match goal:
            case Fact():
                return self._put_fact(goal, Role.GOAL, t)
            case Inequality():
                return self._add_inequality(goal, Role.GOAL, t)
            case Condition():
                return self._add_condition(goal.text, Role.GOAL, t)

    def add_constraint(self, text: str) -> Violations:
        """Keep a problem's trajectory constraints, which no message carries."""
        track = self._change_set.track(Identity(Role.CONSTRAINT, KnowledgeType.EXPRESSION, key(text)), text)
        self._put(track, (False, "", text), self._now)
        return _NONE

    def add_metric(self, item: KnowledgeItem, t: int) -> Violations:
        """Set the metric; it replaces the one that stands (rule C11)."""
        t = max(t, self._now)
        if not isinstance(item, Expression) or not item.optimization or not item.expr.tokens:
            return [f"{item} is not a metric; write one like: minimize (total-time)"]
        if item.is_negative:
            return [f"{item}: a metric cannot be negative; remove_metric() ends it"]
        expression = from_composite(item.expr)
        violations = naming(item, self._validator.expression(expression, t))
        if not violations:
            track = self._change_set.track(Identity(Role.STATE, KnowledgeType.EXPRESSION, METRIC_KEY), METRIC_KEY)
            text = expression_text(self.spelling.expression(expression))
            self._put(track, (False, item.optimization, text), t)
        return violations

    def _add_fact(self, item: Fact, t: int) -> Violations:
        domain = self._symbols.domain
        if domain is not None and domain.is_derived(item.attribute_name):
            return [f"{item}: {item.attribute_name} is derived by the domain's rules; add what it is derived from"]
        return self._put_fact(item, Role.STATE, t)

    def _put_fact(self, item: Fact, role: Role, t: int) -> Violations:
        track = self._atoms.of(item, KnowledgeType.FACT, role, t)
        if not isinstance(track, TimelineState):
            return track
        self._put(track, (item.is_negative,), t)
        return _NONE

    def _add_function(self, item: Function, t: int) -> Violations:
        if item.function_value is None:
            return [f"{item}: a value is expected, as: (= {item.atom} 80)"]
        if not (math.isfinite(item.function_value) and math.isfinite(item.rate)):
            wrong = item.rate if math.isfinite(item.function_value) else item.function_value
            return [f"{item.atom}: {wrong!r} is not a value for a numeric function; give a finite number"]
        if item.is_negative:
            return [f"{item}: a function's value cannot be negated; remove it, or assign another value"]
        track = self._atoms.of(item, KnowledgeType.FUNCTION, Role.STATE, t)
        if not isinstance(track, TimelineState):
            return track
        if item.assign_op is AssignOp.ASSIGN:
            self._put(track, (False, item.function_value, item.rate, item.rate), t)
            return _NONE
        if t > self._now:
            raise ScheduledRelativeChange(
                f"{item} changes a value relative to what it will be at {isoformat(t)}, which cannot be scheduled; "
                f"schedule an absolute value, as: (= {item.atom} 80)"
            )
        self.change_number(track, item.assign_op, item.function_value)
        return _NONE

    def change_number(self, track: TimelineState, operation: AssignOp, operand: float) -> None:
        """Change a function relative to its value now (rule C7)."""
        atom = f"({track.timeline.spelling})"
        if track.value is None:
            raise UndefinedFunction(
                f"({operation.pddl} {atom} ...): {atom} has no value to change; assign one first, as: (= {atom} 80)"
            )
        _, number, own_rate, _ = track.value
        match operation:
            case AssignOp.INCREASE:
                number = number + operand
            case AssignOp.DECREASE:
                number = number - operand
            case AssignOp.SCALE_UP:
                number = number * operand
            case AssignOp.SCALE_DOWN:
                if operand == 0:
                    raise DivisionByZero(f"(scale-down {atom} 0) divides by zero; scale down by another number")
                number = number / operand
            case AssignOp.ASSIGN_CTS:
                own_rate = operand
        if not math.isfinite(number):
            raise InvalidKnowledge(f"({operation.pddl} {atom} {operand!r}) exceeds what a double can hold")
        self._change_set.set(track, (False, number, own_rate, own_rate))

    def _add_inequality(self, item: Inequality, role: Role, t: int) -> Violations:
        try:
            formula = condition_of(item.changed(is_negative=False), self._symbols.domain)
        except KbStoreError as error:
            return violations_of(error, item)
        violations = naming(condition_text(formula), self._validator.condition(formula, t))
        if violations:
            return violations
        spelled = self.spelling.condition(formula)
        assert isinstance(spelled, Comparison)
        left, right = expression_text(spelled.left), expression_text(spelled.right)
        track = self._formula_track(spelled, role, KnowledgeType.INEQUALITY)
        self._put(track, (item.is_negative, int(item.ineq.comparison_type), left, right, True), t)
        return _NONE

    def _add_condition(self, text: str, role: Role, t: int) -> Violations:
        try:
            formula = parse_condition(text, self._symbols.domain)
        except KbStoreError as error:
            return violations_of(error, text)
        violations = naming(condition_text(formula), self._validator.condition(formula, t))
        if violations:
            return violations
        track = self._formula_track(self.spelling.condition(formula), role, KnowledgeType.EXPRESSION)
        # variables, too, are spelled as when the condition was first told
        self._put(track, (False, "", track.timeline.spelling), t)
        return _NONE

    def _formula_track(self, formula: Formula, role: Role, kind: KnowledgeType) -> TimelineState:
        text = condition_text(formula)
        return self._change_set.track(Identity(role, kind, key(text)), text)

    def track_of(self, kind: KnowledgeType, atom: Atom) -> TimelineState:
        """The track of a ground atom that an operator's effect names. Raises `InvalidKnowledge` if it does not fit."""
        return self._atoms.of_effect(kind, atom)

    def _put(self, track: TimelineState, value: Value, t: int) -> None:
        if t > self._now:
            self._change_set.schedule(track, t, value)
        else:
            self._change_set.set(track, value)

    # -- removing ---------------------------------------------------------------------------------------------

    def remove(self, item: KnowledgeItem, t: int | None) -> Violations:
        """Remove what matches an item from the state; with a time after now, cancel what is scheduled for it."""
        match item:
            case Fact():
                return self._remove_atoms(item, KnowledgeType.FACT, Role.STATE, t)
            case Function():
                return self._remove_atoms(item, KnowledgeType.FUNCTION, Role.STATE, t)
            case Instance():
                return self._objects.remove(
                    item, self._matching(Role.STATE, KnowledgeType.INSTANCE, (key(item.instance_name),), t), t
                )
            case Inequality():
                return self._remove_inequality(item, Role.STATE, t)
            case Expression():
                return self.remove_metric(item, t)

    def remove_goal(self, goal: Goal, t: int | None) -> Violations:
        """Remove a part of the goal."""
        match goal:
            case Fact():
                return self._remove_atoms(goal, KnowledgeType.FACT, Role.GOAL, t)
            case Inequality():
                return self._remove_inequality(goal, Role.GOAL, t)
            case Condition():
                return self._remove_condition(goal.text, t)

    def remove_metric(self, item: KnowledgeItem | None, t: int | None) -> Violations:
        """Remove the metric, if it is the one that is given."""
        if item is not None and not isinstance(item, Expression):
            return [f"{item} is not a metric; write one like: minimize (total-time)"]
        if item is not None and item.expr.tokens:
            violations = naming(item, self._validator.symbols(from_composite(item.expr)))
            if violations:
                return violations
        track = self._change_set.known(Identity(Role.STATE, KnowledgeType.EXPRESSION, METRIC_KEY))
        if track is None:
            return _NONE

        def matches(value: Value) -> bool:
            if item is None:
                return True
            text = key(expression_text(from_composite(item.expr))) if item.expr.tokens else ""
            return item.optimization in ("", value[1]) and text in ("", key(value[2]))

        self._take_away([track], matches, t)
        return _NONE

    def _remove_atoms(self, item: Fact | Function, kind: KnowledgeType, role: Role, t: int | None) -> Violations:
        if is_wildcard(item.attribute_name):
            return [f"{item}: a removal names its predicate or function; clear() removes everything"]
        try:
            name, arguments = self._symbols.ordered(kind, item.attribute_name, item.arguments, item.labels)
        except KbStoreError as error:
            return violations_of(error, item)
        wanted = (key(name), *map(key, arguments))
        domain = self._symbols.domain
        if role is Role.STATE and domain is not None and domain.is_derived(name):
            return [f"{item}: {name} is derived by the domain's rules; remove what it is derived from"]
        negative = item.is_negative
        self._take_away(
            self._matching(role, kind, wanted, t),
            (lambda value: bool(value[0]) == negative) if kind is KnowledgeType.FACT else (lambda value: True),
            t,
        )
        return _NONE

    def _matching(self, role: Role, kind: KnowledgeType, wanted: Sequence[str], t: int | None) -> list[TimelineState]:
        """The tracks that match a pattern, and on which something stands or is scheduled."""
        if not any(map(is_wildcard, wanted)):
            track = self._change_set.known(Identity(role, kind, atom_key(wanted)))
            return [] if track is None else [track]
        position = LogPosition(self._now)
        there = self._repository.scheduled_at(kind, position) if t else self._repository.state_at(kind, position)

        def matches(role_of: Role, keys: Sequence[str]) -> bool:
            return (
                role_of is role
                and len(keys) == len(wanted)
                and all(is_wildcard(pattern) or pattern == name for pattern, name in zip(wanted, keys, strict=True))
            )

        found = {timeline.id: timeline for timeline, *_ in there if matches(timeline.role, timeline.keys)}
        self._change_set.loaded(found.values())
        return [
            track
            for track in self._change_set.all_tracks()
            if track.timeline.kind is kind and matches(track.timeline.role, track.timeline.keys)
        ]

    def _remove_inequality(self, item: Inequality, role: Role, t: int | None) -> Violations:
        try:
            formula = condition_of(item.changed(is_negative=False), self._symbols.domain)
            check(formula, self._symbols.domain)
        except KbStoreError as error:
            return violations_of(error, item)
        track = self._change_set.known(Identity(role, KnowledgeType.INEQUALITY, key(condition_text(formula))))
        if track is not None:
            self._take_away([track], lambda value: bool(value[0]) == item.is_negative, t)
        return _NONE

    def _remove_condition(self, text: str, t: int | None) -> Violations:
        try:
            formula = parse_condition(text, self._symbols.domain)
        except KbStoreError as error:
            return violations_of(error, text)
        track = self._change_set.known(Identity(Role.GOAL, KnowledgeType.EXPRESSION, key(condition_text(formula))))
        if track is not None:
            self._take_away([track], lambda value: True, t)
        return _NONE

    def _take_away(self, tracks: Iterable[TimelineState], matches: Callable[[Value], bool], t: int | None) -> None:
        """End what stands, or cancel what is scheduled for `t`, where it matches (rules C4, C5)."""
        for track in tracks:
            value = track.value if t is None else track.ahead.get(t)
            if value is None or not matches(value):
                continue
            if t is None:
                self._change_set.end(track, EndCause.REMOVED)
            else:
                self._change_set.cancel(track, t)

    # -- everything -------------------------------------------------------------------------------------------

    def clear(self) -> None:
        """End everything that stands, and cancel everything scheduled (rule C12)."""
        for track in self.everything():
            if track.value is not None:
                self._change_set.end(track, EndCause.CLEARED)
            for t in list(track.ahead):
                self._change_set.cancel(track, t)

    def everything(self) -> list[TimelineState]:
        """The tracks of all that stands or is scheduled."""
        position = LogPosition(self._now)
        for kind in KnowledgeType:
            there = [*self._repository.state_at(kind, position), *self._repository.scheduled_at(kind, position)]
            self._change_set.loaded({timeline.id: timeline for timeline, *_ in there}.values())
        return list(self._change_set.all_tracks())
