"""Translates operators to actions of unified_planning."""

from collections.abc import Iterator
from functools import partial
from typing import Any, NamedTuple

from kbstore.clock import SECOND, TIME_LIMIT
from kbstore.errors import InvalidKnowledge
from kbstore.interop.up_formulas import FormulaTranslator, UpVariables
from kbstore.interop.up_symbols import library
from kbstore.messages import AssignOp, ComparisonType, Operator
from kbstore.model.actions import Action
from kbstore.model.domain import Domain
from kbstore.model.expressions import NumericExpression, atoms_of
from kbstore.model.formulas import (
    Add,
    And,
    Delete,
    Effect,
    ForEach,
    Formula,
    NumericEffect,
    Timing,
    When,
    WhenAtStart,
    children,
)
from kbstore.names import key
from kbstore.pddl.printer import effect_text


class _Simple(NamedTuple):
    """An effect without its ``when`` and ``forall``, and their conditions and variables."""

    effect: Add | Delete | NumericEffect
    scope: UpVariables
    variables: tuple[Any, ...]
    conditions: tuple[Any, ...]


class ActionTranslator:
    """Translates operators; `changing` are the keys of the functions that something changes."""

    def __init__(self, formulas: FormulaTranslator, changing: frozenset[str]) -> None:
        self._formulas = formulas
        self._changing = changing
        self._up = library()
        self._environment = formulas.symbols.environment
        self._make = formulas.symbols.environment.expression_manager

    def action(self, action: Action) -> Any:
        """Translate an operator to an ``InstantaneousAction`` or a ``DurativeAction``."""
        kind = self._up.model.DurativeAction if action.durative else self._up.model.InstantaneousAction
        made = kind(action.name, self._formulas.symbols.parameters(action.parameters), self._environment)
        scope = {key(p.name): self._make.ParameterExp(made.parameter(p.name)) for p in action.parameters}
        if action.durative:
            made.set_duration_constraint(self._duration(action, scope))
        for parameter in action.parameters:
            if len(parameter.types) > 1:
                is_of = self._formulas.is_of(scope[key(parameter.name)], parameter.types, scope)
                self._add_condition(made, Timing.AT_START, is_of)
        for moment, condition in action.conditions:
            duration = self._duration_value(action, moment, scope)
            for part in _conjuncts(condition):
                self._add_condition(made, moment, self._formulas.condition(part, scope, duration))
        for moment, effect in action.effects:
            duration = self._duration_value(action, moment, scope)
            for simple in self._simple(effect, scope, duration):
                self._add_effect(made, moment, simple, duration)
        return made

    # -- durations --------------------------------------------------------------------------------------------

    def _duration(self, action: Action, scope: UpVariables) -> Any:
        """Return the interval of the duration; a missing bound is that of the range of durations."""
        lower: tuple[Any, bool] | None = None
        upper: tuple[Any, bool] | None = None
        for constraint in action.duration:
            if constraint.timing is not Timing.AT_START:
                raise InvalidKnowledge(f"a duration constraint {constraint.timing.value} has no counterpart")
            bound = self._formulas.expression(constraint.bound, scope)
            comparison = constraint.comparison
            is_open = comparison in (ComparisonType.GREATER, ComparisonType.LESS)
            from_below = comparison in (ComparisonType.GREATER, ComparisonType.GREATEREQ, ComparisonType.EQUALS)
            from_above = comparison in (ComparisonType.LESS, ComparisonType.LESSEQ, ComparisonType.EQUALS)
            if (from_below and lower) or (from_above and upper):
                raise InvalidKnowledge("a duration with several bounds on one side has no counterpart")
            lower = (bound, is_open) if from_below else lower
            upper = (bound, is_open) if from_above else upper
        least, least_open = lower or (self._make.Int(0), False)
        most, most_open = upper or (self._make.Int(TIME_LIMIT // SECOND), False)
        return self._up.model.timing.DurationInterval(least, most, least_open, most_open)

    def _duration_value(self, action: Action, moment: Timing, scope: UpVariables) -> Any:
        """Return the value of ``?duration`` at a part of the action; None if there is none.

        unified_planning has no ``?duration``; a duration that the domain fixes can be written out where it is the same
        as at the start.
        """
        fixed = [c.bound for c in action.duration if c.comparison is ComparisonType.EQUALS]
        if len(fixed) != 1 or not (moment is Timing.AT_START or self._is_constant(fixed[0])):
            return None
        return self._formulas.expression(fixed[0], scope)

    def _is_constant(self, expression: NumericExpression) -> bool:
        return not any(key(function.name) in self._changing for function in atoms_of(expression))

    # -- conditions -------------------------------------------------------------------------------------------

    def _add_condition(self, made: Any, moment: Timing, condition: Any) -> None:
        if isinstance(made, self._up.model.InstantaneousAction):
            made.add_precondition(condition)
            return
        model = self._up.model
        match moment:
            case Timing.AT_START:
                made.add_condition(model.StartTiming(), condition)
            case Timing.OVER_ALL:
                made.add_condition(model.OpenTimeInterval(model.StartTiming(), model.EndTiming()), condition)
            case Timing.AT_END:
                made.add_condition(model.EndTiming(), condition)

    # -- effects ----------------------------------------------------------------------------------------------

    def _simple(
        self,
        effect: Effect,
        scope: UpVariables,
        duration: Any,
        variables: tuple[Any, ...] = (),
        conditions: tuple[Any, ...] = (),
    ) -> Iterator[_Simple]:
        match effect:
            case When(condition, parts):
                triggers = (*conditions, self._formulas.condition(condition, scope, duration))
                for part in parts:
                    yield from self._simple(part, scope, duration, variables, triggers)
            case ForEach(parameters, parts):
                for own, inner in self._formulas.bound(parameters, scope):
                    for part in parts:
                        yield from self._simple(part, inner, duration, (*variables, *own), conditions)
            case WhenAtStart():
                raise InvalidKnowledge(
                    f"{effect_text(effect)} has no counterpart: the condition of an effect is one of the effect's own "
                    "moment there; record the condition as a fact at start, and make the effect depend on that fact"
                )
            case Add() | Delete() | NumericEffect():
                yield _Simple(effect, scope, variables, conditions)

    def _add_effect(self, made: Any, moment: Timing, simple: _Simple, duration: Any) -> None:
        effect, scope, variables, conditions = simple
        if isinstance(effect, NumericEffect) and effect.operation is AssignOp.ASSIGN_CTS:
            self._add_continuous(made, simple, duration)
            return
        instantaneous = isinstance(made, self._up.model.InstantaneousAction)
        timing = self._up.model.EndTiming() if moment is Timing.AT_END else self._up.model.StartTiming()
        place: tuple[Any, ...] = () if instantaneous else (timing,)
        trigger = self._make.And(*conditions)
        add, increase, decrease = (
            partial(method, *place) for method in (made.add_effect, made.add_increase_effect, made.add_decrease_effect)
        )
        if not isinstance(effect, NumericEffect):
            add(self._formulas.fact(effect.atom, scope), isinstance(effect, Add), trigger, variables)
            return
        function = self._formulas.function(effect.function, scope)
        value = self._formulas.expression(effect.value, scope, duration)
        match effect.operation:
            case AssignOp.INCREASE:
                increase(function, value, trigger, variables)
            case AssignOp.DECREASE:
                decrease(function, value, trigger, variables)
            case AssignOp.SCALE_UP:
                add(function, self._make.Times(function, value), trigger, variables)
            case AssignOp.SCALE_DOWN:
                add(function, self._make.Div(function, value), trigger, variables)
            case _:
                add(function, value, trigger, variables)

    def _add_continuous(self, made: Any, simple: _Simple, duration: Any) -> None:
        effect, scope, variables, conditions = simple
        assert isinstance(effect, NumericEffect)
        if variables or conditions:
            raise InvalidKnowledge(f"{effect_text(effect)} within when or forall has no counterpart")
        model = self._up.model
        interval = model.ClosedTimeInterval(model.StartTiming(), model.EndTiming())
        function = self._formulas.function(effect.function, scope)
        is_loss = effect.value[0] is Operator.UMINUS
        rate = self._formulas.expression(effect.value[1:] if is_loss else effect.value, scope, duration)
        add = made.add_decrease_continuous_effect if is_loss else made.add_increase_continuous_effect
        add(interval, function, rate)


def changed_functions(domain: Domain) -> Iterator[str]:
    """Yield the keys of the functions that some operator changes."""
    todo: list[Formula | Effect] = [effect for action in domain.actions.values() for _, effect in action.effects]
    while todo:
        node = todo.pop()
        if isinstance(node, NumericEffect):
            yield key(node.function.name)
        todo.extend(children(node))


def _conjuncts(condition: Formula) -> Iterator[Formula]:
    if isinstance(condition, And):
        for part in condition.parts:
            yield from _conjuncts(part)
    else:
        yield condition
