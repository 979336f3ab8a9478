"""The operators of a domain: instantaneous and durative actions with all that PDDL says of them."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from kbstore.messages import (
    ComparisonType,
    DomainAssignment,
    DomainFormula,
    DomainInequality,
    DomainOperator,
    KeyValue,
    Message,
)
from kbstore.model.expressions import composite_of
from kbstore.model.formulas import (
    Add,
    And,
    Atom,
    Comparison,
    Delete,
    Effect,
    Formula,
    Not,
    NumericEffect,
    NumericExpression,
    Parameter,
    Timing,
)
from kbstore.names import key


@dataclass(frozen=True)
class DurationConstraint:
    """One constraint on ``?duration``, for instance ``(<= ?duration 10)``."""

    comparison: ComparisonType
    bound: NumericExpression
    timing: Timing = Timing.AT_START


@dataclass(frozen=True)
class Action:
    """An operator with everything that PDDL says of it.

    An instantaneous action has its precondition and effects at `Moment.AT_START`. A continuous effect belongs to
    the whole of a durative action, and stands in `effects` with `Moment.OVER_ALL`.
    """

    name: str
    parameters: tuple[Parameter, ...] = ()
    durative: bool = False
    duration: tuple[DurationConstraint, ...] = ()
    conditions: tuple[tuple[Timing, Formula], ...] = ()
    effects: tuple[tuple[Timing, Effect], ...] = ()

    def conditions_at(self, timing: Timing) -> tuple[Formula, ...]:
        """The conditions that must hold at a moment."""
        return tuple(condition for when, condition in self.conditions if when is timing)

    def effects_at(self, timing: Timing) -> tuple[Effect, ...]:
        """The effects of a moment."""
        return tuple(effect for when, effect in self.effects if when is timing)


def operator_message(action: Action, constants: Mapping[str, str] | None = None) -> DomainOperator:
    """The operator as the message carries it.

    Its lists hold the conjuncts that are atoms, negated atoms or comparisons, and the effects that add, delete or
    assign; a continuous effect stands among those at start, where it begins. A formula's label is the operator's
    variable, or the name of a constant, and its value the type of that (of constants, as `constants` has it). What
    the message cannot carry is left to the `Action`.
    """
    types = {key(name): type_name for name, type_name in (constants or {}).items()}
    types.update({f"?{key(parameter.name)}": parameter.type_text for parameter in action.parameters})

    def formula(atom: Atom) -> DomainFormula:
        labelled = tuple(KeyValue(argument.lstrip("?"), types.get(key(argument), "")) for argument in atom.arguments)
        return DomainFormula(name=atom.name, typed_parameters=labelled)

    lists: dict[str, Any] = {}
    for timing, condition in action.conditions:
        for part in condition.parts if isinstance(condition, And) else (condition,):
            place, message = _condition_message(part, formula)
            if message:
                lists.setdefault(f"{_FIELD[timing]}_{place}", []).append(message)
    for timing, effect in action.effects:
        place, message = _effect_message(effect, formula)
        if message:
            start = Timing.AT_START if timing is Timing.OVER_ALL else timing
            lists.setdefault(f"{_FIELD[start]}_{place}", []).append(message)
    parameters = tuple(KeyValue(parameter.name, parameter.type_text) for parameter in action.parameters)
    return DomainOperator(formula=DomainFormula(name=action.name, typed_parameters=parameters), **lists)


_FIELD = {Timing.AT_START: "at_start", Timing.OVER_ALL: "over_all", Timing.AT_END: "at_end"}


def _condition_message(condition: Formula, formula: Callable[[Atom], DomainFormula]) -> tuple[str, Message | None]:
    """The list that a condition belongs to, and its message; None if the message cannot carry it."""
    match condition:
        case Atom():
            return "simple_condition", formula(condition)
        case Not(Atom() as atom):
            return "neg_condition", formula(atom)
        case Comparison(comparison, left, right):
            sides = {"LHS": composite_of(left, formula), "RHS": composite_of(right, formula)}
            return "comparison", DomainInequality(comparison_type=comparison, grounded=False, **sides)
        case _:
            return "", None


def _effect_message(effect: Effect, formula: Callable[[Atom], DomainFormula]) -> tuple[str, Message | None]:
    """The list that an effect belongs to, and its message; None if the message cannot carry it."""
    match effect:
        case Add(atom):
            return "add_effects", formula(atom)
        case Delete(atom):
            return "del_effects", formula(atom)
        case NumericEffect(operation, function, value):
            right = composite_of(value, formula)
            return "assign_effects", DomainAssignment(assign_type=operation, LHS=formula(function), RHS=right)
        case _:
            return "", None
