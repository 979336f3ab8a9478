"""Reads effects of one part of an action, from their groups to the formulas of `kbstore.model.formulas`."""

from collections.abc import Iterator
from dataclasses import dataclass

from kbstore.errors import InvalidKnowledge
from kbstore.messages import AssignOp, Operator, SpecialType
from kbstore.model.expressions import NumericExpression
from kbstore.model.formulas import (
    Add,
    AssignObject,
    Atom,
    Delete,
    Effect,
    ForEach,
    NumericEffect,
    Parameter,
    Variables,
    When,
)
from kbstore.names import key
from kbstore.pddl.conditions import MAX_DEPTH, ConditionReader
from kbstore.pddl.expressions import read_expression, read_function
from kbstore.pddl.scope import Scope
from kbstore.pddl.sexpr import Group, node_text
from kbstore.pddl.typed_lists import bound

ASSIGNMENTS = {
    "assign": AssignOp.ASSIGN,
    "increase": AssignOp.INCREASE,
    "decrease": AssignOp.DECREASE,
    "scale-up": AssignOp.SCALE_UP,
    "scale-down": AssignOp.SCALE_DOWN,
}
_WORDS = frozenset(("and", "not", "forall", "when", *ASSIGNMENTS))


@dataclass
class EffectReader:
    """Reads effects; `specials` are the special numbers that may occur in the values of numeric ones."""

    scope: Scope
    conditions: ConditionReader
    specials: frozenset[SpecialType]

    def read(self, group: Group, variables: Variables, depth: int = 0) -> Iterator[Effect]:
        """Read the effects that a group lists. Raises `PddlSyntaxError`; reports symbols that do not fit."""
        self.check_depth(group, depth)
        if not group:
            return
        word = group.word(0)
        if self._is_atom(group):
            yield Add(self._changed_atom(group, variables))
        elif word == "and":
            for part in self.conditions.groups_of(group):
                yield from self.read(part, variables, depth + 1)
        elif word == "not":
            deleted = group[1] if len(group) == 2 else None
            if not isinstance(deleted, Group) or not deleted or not self._is_atom(deleted):
                raise self.scope.error(f"the effect (not ...) takes one fact: {node_text(group, 60)}", group)
            yield Delete(self._changed_atom(deleted, variables))
        elif word == "forall":
            parameters, part = self.conditions.quantified(group)
            effects = tuple(self.read(part, bound(variables, parameters), depth + 1))
            if effects:
                yield ForEach(parameters, effects)
        elif word == "when":
            premise, part = self.when(group)
            condition = self.conditions.read(premise, variables, depth + 1)
            effects = tuple(self.read(part, variables, depth + 1))
            if effects:
                yield When(condition, effects)
        elif word in ASSIGNMENTS:
            yield self._change(group, variables)
        else:
            known = ", ".join(("and", "not", "forall", "when", *ASSIGNMENTS))
            raise self.scope.error(
                f"{node_text(group, 60)} is not an effect here; an effect is a fact, or begins with {known}", group
            )

    def continuous(self, group: Group, variables: Variables) -> NumericEffect:
        """Read a continuous effect, ``(increase (battery ?r) (* #t (rate ?r)))``."""
        function, value = self._target_and_value(group, variables, self.specials | {SpecialType.HASHT})
        rate = rate_of(value)
        if rate is None:
            raise self.scope.error(
                "this effect has neither a time (at start, at end) nor a rate, as in (increase (f) (* #t (rate)))",
                group,
            )
        operation = ASSIGNMENTS[group.word(0)]
        return NumericEffect(AssignOp.ASSIGN_CTS, function, negated(rate) if operation is AssignOp.DECREASE else rate)

    def when(self, group: Group) -> tuple[Group, Group]:
        """Return the groups of the condition and the effect of a conditional effect."""
        if len(group) != 3 or not isinstance(group[1], Group) or not isinstance(group[2], Group):
            raise self.scope.error(f"(when ...) takes a condition and an effect: {node_text(group, 60)}", group)
        return group[1], group[2]

    def check_depth(self, group: Group, depth: int) -> None:
        """Raise `PddlSyntaxError` for effects nested deeper than `MAX_DEPTH`."""
        if depth > MAX_DEPTH:
            raise self.scope.error(f"effects nested deeper than {MAX_DEPTH} levels cannot be read", group)

    def _is_atom(self, group: Group) -> bool:
        """Return whether a group is an atom: names and terms, the first of which is not used as a keyword."""
        word = group.word(0)
        is_flat = all(isinstance(node, str) or self.scope.is_object_term(node) for node in group)
        return is_flat and (word not in _WORDS or self.conditions.is_atom(group))

    def _change(self, group: Group, variables: Variables) -> NumericEffect | AssignObject:
        if group.word(0) == "assign" and len(group) == 3 and self.scope.is_object_term(group[1]):
            return self.object_assignment(group, variables)
        function, value = self._target_and_value(group, variables, self.specials)
        return NumericEffect(ASSIGNMENTS[group.word(0)], function, value)

    def object_assignment(self, group: Group, variables: Variables) -> AssignObject:
        """Read ``(assign (location ?r) ?to)``, in an initial state with ``=``; stored but not computed (rule P4)."""
        scope, term, value = self.scope, group[1], group[2]
        assert isinstance(term, Group)
        name = scope.name(term, 0, "function")
        fluent = scope.domain.object_fluents[key(name)] if scope.domain else None
        function = scope.atom(term, fluent.signature if fluent else None, variables, asserted=True)
        if isinstance(value, Group):
            if not scope.is_object_term(value):
                raise scope.error(f"an object is expected here, not {node_text(value, 60)}", group, 2)
            return AssignObject(function, scope.object_term(value, variables))
        wanted = Parameter(name, fluent.types) if fluent else None
        problem = None if key(value) == "undefined" else scope.misfit(value, variables, wanted, asserted=True)
        if problem:
            scope.diagnose(InvalidKnowledge, f"{node_text(group, 80)}: {problem}", group, 2)
        return AssignObject(function, value)

    def _target_and_value(
        self, group: Group, variables: Variables, specials: frozenset[SpecialType]
    ) -> tuple[Atom, NumericExpression]:
        scope = self.scope
        if len(group) != 3:
            raise scope.error(
                f"({group.word(0)} (f) value) takes a function and a value: {node_text(group, 60)}", group
            )
        function = read_function(scope, function_group(scope, group, 1), variables, asserted=True)
        return function, read_expression(scope, group, 2, variables, specials)

    def _changed_atom(self, group: Group, variables: Variables) -> Atom:
        scope = self.scope
        group = scope.unglued(group)
        name = scope.name(group, 0, "predicate")
        if scope.domain is not None and scope.domain.is_derived(name):
            scope.diagnose(InvalidKnowledge, f"{name} is derived by rules, and no action can change it", group)
        return scope.atom(group, scope.predicate(name, group), variables, asserted=True)


def function_group(scope: Scope, group: Group, index: int) -> Group:
    """Return the group of a function's term at a place; a term without brackets, as ``total-cost``, becomes a group."""
    node = group[index]
    if isinstance(node, Group):
        return node
    term = Group([node])
    term.start = scope.source.offset(group, index)
    return term


def rate_of(expression: NumericExpression) -> NumericExpression | None:
    """Return the rate of a continuous change: the expression without its ``#t``; None if not proportional to that."""
    degrees: list[int | None] = []  # for each operand: 1 proportional to #t, 0 independent of it, None neither
    for token in reversed(expression):
        if not isinstance(token, Operator):
            degrees.append(int(token is SpecialType.HASHT))
        elif token is not Operator.UMINUS:
            left, right = degrees.pop(), degrees.pop()
            match token:
                case _ if left is None or right is None:
                    degree = None
                case Operator.MUL:
                    degree = left + right if left + right < 2 else None
                case Operator.DIV:
                    degree = left if right == 0 else None
                case _:
                    degree = left if left == right else None
            degrees.append(degree)
    if degrees != [1]:
        return None
    if expression[0] is Operator.MUL and expression[1] is SpecialType.HASHT:
        return expression[2:]
    if expression[0] is Operator.MUL and expression[-1] is SpecialType.HASHT and _is_whole(expression[1:-1]):
        return expression[1:-1]
    return tuple(1.0 if token is SpecialType.HASHT else token for token in expression)


def _is_whole(tokens: NumericExpression) -> bool:
    """Return whether tokens are one expression, and not the beginning of a longer one."""
    wanted = 1
    for token in tokens:
        if not wanted:
            return False
        wanted += token.arity - 1 if isinstance(token, Operator) else -1
    return not wanted


def negated(expression: NumericExpression) -> NumericExpression:
    """Return the expression with the other sign."""
    if len(expression) == 1 and isinstance(expression[0], float):
        return (-expression[0],)
    return (Operator.UMINUS, *expression)
