"""Command handlers: apply each kind of update to a transaction's change set (rules C2 to C12).

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
from kbstore.model.formulas import Comparison, Formula
from kbstore.model.symbols import SymbolTable
from kbstore.model.timelines import METRIC_KEY, EndCause, Identity, Role, Value, atom_key, fact_value
from kbstore.names import is_wildcard, key, matches
from kbstore.pddl.parse import condition_of, parse_condition, uncertain_atoms
from kbstore.pddl.printer import condition_text, expression_text
from kbstore.storage.records import LogPosition
from kbstore.storage.repository import Repository
from kbstore.writing.change_set import ChangeSet
from kbstore.writing.edits import Edits, PresentEdits
from kbstore.writing.formulas import (
    canonical_condition,
    canonical_expression,
    condition_violations,
    expression_violations,
    symbol_violations,
)
from kbstore.writing.object_handlers import ObjectHandlers
from kbstore.writing.resolution import NameResolver, Violations, naming, violations_of
from kbstore.writing.timeline_state import TimelineState

_NONE: Violations = ()


class Handlers:
    """Checks updates, and applies them to a change set, one after another, all at the same now.

    Each update has a time `t` in nanoseconds: now, or later (rule T4). At a later time, adding means to schedule, and
    removing to cancel. Late knowledge is checked in the same way, but its `edits` are in the past.
    """

    def __init__(
        self,
        change_set: ChangeSet,
        repository: Repository,
        symbols: SymbolTable,
        on_removed_object: Callable[[str], None],
        edits: Edits | None = None,
    ) -> None:
        self._change_set = change_set
        self._repository = repository
        self._symbols = symbols
        self.resolver = NameResolver(change_set, symbols)
        self.objects = ObjectHandlers(change_set, repository, self.resolver, on_removed_object)
        self._now = change_set.now
        self.edits = edits or PresentEdits(change_set, repository)
        self._put = self.edits.put
        self._derived = frozenset() if symbols.domain is None else symbols.domain.rules.keys()

    # -- adding -----------------------------------------------------------------------------------------------

    def add(self, item: KnowledgeItem, t: int) -> Violations:
        """Add an item to the state, from `t` on."""
        match item:
            case Fact():
                return self._put_fact(item, Role.STATE, t)
            case Function():
                return self._add_function(item, t)
            case Instance():
                return self.objects.add(item, t)
            case Inequality():
                return self._add_inequality(item, Role.STATE, t)
            case Expression():
                return self.add_metric(item, t)

    def add_goal(self, goal: Goal, t: int) -> Violations:
        """Add a part of the goal (rule C10)."""
        match goal:
            case Fact():
                return self._put_fact(goal, Role.GOAL, t)
            case Inequality():
                return self._add_inequality(goal, Role.GOAL, t)
            case Condition():
                return self._add_condition(goal.text, Role.GOAL, t)

    def add_constraint(self, text: str, about: str = "", t: int = 0) -> Violations:
        """Assert a part of a problem that no item can carry, from `t` on; it replaces another with the same `about`."""
        state = self._formula_state(about or text, Role.CONSTRAINT, KnowledgeType.EXPRESSION)
        self._put(state, (False, "", text), max(t, self._now))
        return _NONE

    def end_uncertain(self) -> None:
        """End constraints on unknown atoms, such as ``(oneof (p) (q))``, if one of the atoms is asserted (rule P4)."""
        facts = self._change_set.group(Role.STATE, KnowledgeType.FACT)
        asserted = {name for name, state in facts.items() if state.value is not None}
        if not asserted:
            return
        kept = self._repository.of_kind(Role.CONSTRAINT, KnowledgeType.EXPRESSION)
        self._change_set.loaded(kept)
        for state in list(self._change_set.group(Role.CONSTRAINT, KnowledgeType.EXPRESSION).values()):
            if state.value is not None and not asserted.isdisjoint(uncertain_atoms(state.value[2])):
                self._change_set.take(state, self._now, EndCause.REPLACED)

    def add_metric(self, item: KnowledgeItem, t: int) -> Violations:
        """Set the metric; it replaces the current one (rule C11)."""
        if not isinstance(item, Expression) or not item.optimization or not item.expr.tokens:
            return [f"{item} is not a metric; write one like: minimize (total-time)"]
        if item.is_negative:
            return [f"{item}: a metric cannot be negative; remove_metric() ends it"]
        expression = from_composite(item.expr)
        violations = naming(item, expression_violations(self.resolver, expression, t))
        if not violations:
            state = self._change_set.state(Identity(Role.STATE, KnowledgeType.EXPRESSION, METRIC_KEY), METRIC_KEY)
            text = expression_text(canonical_expression(self.resolver, expression))
            self._put(state, (False, item.optimization, text), t)
        return violations

    def _put_fact(self, item: Fact, role: Role, t: int) -> Violations:
        if item.key[0] in self._derived and role is Role.STATE:
            return [f"{item}: {item.attribute_name} is derived by the domain's rules; add what it is derived from"]
        state = self.resolver.atom(item, KnowledgeType.FACT, role, t)
        if not isinstance(state, TimelineState):
            return state
        self._put(state, fact_value(item.is_negative), t)
        return _NONE

    def _add_function(self, item: Function, t: int) -> Violations:
        if item.function_value is None:
            return [f"{item}: a value is expected, as: (= {item.atom} 80)"]
        if not (math.isfinite(item.function_value) and math.isfinite(item.rate)):
            wrong = item.rate if math.isfinite(item.function_value) else item.function_value
            return [f"{item.atom}: {wrong!r} is not a value for a numeric function; give a finite number"]
        if item.is_negative:
            return [f"{item}: a function's value cannot be negated; remove it, or assign another value"]
        state = self.resolver.atom(item, KnowledgeType.FUNCTION, Role.STATE, t)
        if not isinstance(state, TimelineState):
            return state
        if item.assign_op is AssignOp.ASSIGN:
            self._put(state, (False, item.function_value, item.rate, item.rate), t)
            return _NONE
        if t > self._now:
            raise ScheduledRelativeChange(
                f"{item} changes a value relative to what it will be at {isoformat(t)}, which cannot be scheduled; "
                f"schedule an absolute value, as: (= {item.atom} 80)"
            )
        self.change_number(state, item.assign_op, item.function_value)
        return _NONE

    def change_number(self, state: TimelineState, operation: AssignOp, operand: float) -> None:
        """Change a function relative to its value now (rule C7)."""
        atom = f"({state.timeline.spelling})"
        if state.value is None:
            raise UndefinedFunction(
                f"({operation.pddl} {atom} ...): {atom} has no value to change; assign one first, as: (= {atom} 80)"
            )
        _, number, own_rate, _ = state.value
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
        self._put(state, (False, number, own_rate, own_rate), self._now)

    def _add_inequality(self, item: Inequality, role: Role, t: int) -> Violations:
        try:
            formula = self._inequality(item)
        except KbStoreError as error:
            return violations_of(error, item)
        violations = naming(condition_text(formula), condition_violations(self.resolver, formula, t))
        if violations:
            return violations
        spelled = canonical_condition(self.resolver, formula)
        assert isinstance(spelled, Comparison)
        left, right = expression_text(spelled.left), expression_text(spelled.right)
        state = self._formula_state(condition_text(spelled), role, KnowledgeType.INEQUALITY)
        self._put(state, (item.is_negative, int(item.ineq.comparison_type), left, right, True), t)
        return _NONE

    def _add_condition(self, text: str, role: Role, t: int) -> Violations:
        try:
            formula = parse_condition(text, self._symbols.domain)
        except KbStoreError as error:
            return violations_of(error, text)
        violations = naming(condition_text(formula), condition_violations(self.resolver, formula, t))
        if violations:
            return violations
        spelled = condition_text(canonical_condition(self.resolver, formula))
        state = self._formula_state(spelled, role, KnowledgeType.EXPRESSION)
        # as first recorded: spellings that differ only in case, also of variables, share a timeline
        self._put(state, (False, "", state.timeline.spelling), t)
        return _NONE

    def _inequality(self, item: Inequality) -> Formula:
        """Return the comparison that an inequality records, without its sign."""
        return condition_of(item.changed(is_negative=False), self._symbols.domain)

    def _formula_state(self, text: str, role: Role, kind: KnowledgeType) -> TimelineState:
        return self._change_set.state(Identity(role, kind, key(text)), text)

    # -- removing ---------------------------------------------------------------------------------------------

    def remove(self, item: KnowledgeItem, t: int) -> Violations:
        """Remove what matches an item from the state; at a time after now, cancel what is scheduled for that time."""
        match item:
            case Fact():
                return self._remove_atoms(item, KnowledgeType.FACT, Role.STATE, t)
            case Function():
                return self._remove_atoms(item, KnowledgeType.FUNCTION, Role.STATE, t)
            case Instance():
                matching = self.matching(Role.STATE, item.knowledge_type, (key(item.instance_name),), t)
                return self.objects.remove(item, matching, t)
            case Inequality():
                return self._remove_inequality(item, Role.STATE, t)
            case Expression():
                return self.remove_metric(item, t)

    def remove_goal(self, goal: Goal, t: int) -> Violations:
        """Remove a part of the goal."""
        match goal:
            case Fact():
                return self._remove_atoms(goal, KnowledgeType.FACT, Role.GOAL, t)
            case Inequality():
                return self._remove_inequality(goal, Role.GOAL, t)
            case Condition():
                return self._remove_condition(goal.text, t)

    def remove_metric(self, item: KnowledgeItem | None, t: int) -> Violations:
        """Remove the metric, if it is the one that is given."""
        if item is not None and not isinstance(item, Expression):
            return [f"{item} is not a metric; write one like: minimize (total-time)"]
        if item is not None and item.expr.tokens:
            violations = naming(item, symbol_violations(self.resolver, from_composite(item.expr)))
            if violations:
                return violations
        state = self._change_set.find(Identity(Role.STATE, KnowledgeType.EXPRESSION, METRIC_KEY))
        if state is None:
            return _NONE

        def matches(value: Value) -> bool:
            if item is None:
                return True
            text = key(expression_text(from_composite(item.expr))) if item.expr.tokens else ""
            return item.optimization in ("", value[1]) and text in ("", key(value[2]))

        self.edits.remove([state], matches, t)
        return _NONE

    def _remove_atoms(self, item: Fact | Function, kind: KnowledgeType, role: Role, t: int) -> Violations:
        if is_wildcard(item.attribute_name):
            return [f"{item}: a removal names its predicate or function; clear() removes everything"]
        try:
            name, arguments = self._symbols.ordered(kind, item.attribute_name, item.arguments, item.labels)
        except KbStoreError as error:
            return violations_of(error, item)
        pattern = (key(name), *map(key, arguments))
        domain = self._symbols.domain
        if role is Role.STATE and domain is not None and domain.is_derived(name):
            return [f"{item}: {name} is derived by the domain's rules; remove what it is derived from"]
        negative = item.is_negative
        self.edits.remove(
            self.matching(role, kind, pattern, t),
            (lambda value: bool(value[0]) == negative) if kind is KnowledgeType.FACT else (lambda value: True),
            t,
        )
        return _NONE

    def matching(self, role: Role, kind: KnowledgeType, pattern: Sequence[str], t: int) -> list[TimelineState]:
        """Return the timelines that match a pattern: all that may have something to remove at `t`."""
        if not any(map(is_wildcard, pattern)):
            state = self._change_set.find(Identity(role, kind, atom_key(pattern)))
            return [] if state is None else [state]
        stored = {
            timeline.id: timeline
            for timeline in self.edits.candidates(role, kind, pattern, t)
            if timeline.role is role and matches(pattern, timeline.keys)
        }
        self._change_set.loaded(stored.values())
        return [
            state
            for state in self._change_set.states()
            if (timeline := state.timeline).kind is kind and timeline.role is role and matches(pattern, timeline.keys)
        ]

    def _remove_inequality(self, item: Inequality, role: Role, t: int) -> Violations:
        try:
            formula = self._inequality(item)
            check(formula, self._symbols.domain)
        except KbStoreError as error:
            return violations_of(error, item)
        state = self._change_set.find(Identity(role, KnowledgeType.INEQUALITY, key(condition_text(formula))))
        if state is not None:
            self.edits.remove([state], lambda value: bool(value[0]) == item.is_negative, t)
        return _NONE

    def _remove_condition(self, text: str, t: int) -> Violations:
        try:
            formula = parse_condition(text, self._symbols.domain)
        except KbStoreError as error:
            return violations_of(error, text)
        state = self._change_set.find(Identity(Role.GOAL, KnowledgeType.EXPRESSION, key(condition_text(formula))))
        if state is not None:
            self.edits.remove([state], lambda value: True, t)
        return _NONE

    # -- replacing --------------------------------------------------------------------------------------------

    def assert_now(self, item: KnowledgeItem, t: int) -> Violations:
        """Add an item of the state that `replace` asks for (rule C13)."""
        if t > self._now:
            return [f"{item} is for {isoformat(t)}; replace() makes the state of now, schedule it with add()"]
        if isinstance(item, Expression):
            return [f"{item} is a metric, which replace() leaves alone; set it with add_metric()"]
        if isinstance(item, Function) and item.assign_op is not AssignOp.ASSIGN:
            return [f"{item} changes a value relative to what it is; replace() takes values, as: (= {item.atom} 80)"]
        return self.add(item, t)

    def remove_others(self, items: Iterable[KnowledgeItem | Condition]) -> Violations:
        """Remove the objects, facts, functions and inequalities that hold and are not among some items (rule C13)."""
        kept = set(map(self._identity, items))
        position = LogPosition(self._now)
        kinds = (KnowledgeType.INSTANCE, KnowledgeType.FACT, KnowledgeType.FUNCTION, KnowledgeType.INEQUALITY)
        for kind in kinds:  # objects first: what mentions a removed one ends with it
            self._change_set.loaded(timeline for timeline, *_ in self._repository.state_at(kind, position))
            for state in list(self._change_set.group(Role.STATE, kind).values()):
                if state.value is None or state.timeline.identity in kept:
                    continue
                if kind is not KnowledgeType.INSTANCE:
                    self._change_set.take(state, self._now, EndCause.REMOVED)
                elif not state.value[0]:
                    self.objects.end(state, self._now)
        return _NONE

    def _identity(self, item: KnowledgeItem | Condition) -> Identity | None:
        """Return the timeline that an item is about; None if the item is wrong, or ends an object."""
        match item:
            case Fact() | Function():
                kind = item.knowledge_type
                try:
                    name, arguments = self._symbols.ordered(kind, item.attribute_name, item.arguments, item.labels)
                except KbStoreError:
                    return None
                return Identity(Role.STATE, kind, atom_key((key(name), *map(key, arguments))))
            case Instance(is_negative=False):
                return Identity(Role.STATE, KnowledgeType.INSTANCE, key(item.instance_name))
            case Inequality():
                return Identity(Role.STATE, KnowledgeType.INEQUALITY, key(condition_text(self._inequality(item))))
        return None

    # -- everything -------------------------------------------------------------------------------------------

    def clear(self) -> None:
        """End everything that holds, and cancel everything scheduled (rule C12)."""
        for state in self.everything():
            if state.value is not None:
                self._change_set.take(state, self._now, EndCause.CLEARED)
            for t in list(state.ahead):
                self._change_set.take(state, t, EndCause.CLEARED)

    def everything(self) -> list[TimelineState]:
        """Return the timelines of everything that holds or is scheduled."""
        position = LogPosition(self._now)
        for kind in KnowledgeType:
            rows = [*self._repository.state_at(kind, position), *self._repository.scheduled_at(kind, position)]
            self._change_set.loaded({timeline.id: timeline for timeline, *_ in rows}.values())
        return self._change_set.states()
