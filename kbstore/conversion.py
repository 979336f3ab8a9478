"""Conversion between the model and the messages: expressions, signatures, operators, and a domain with both.

The model does not know the wire format; the messages are made here.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, SupportsIndex, overload

from kbstore.errors import InvalidKnowledge
from kbstore.messages import (
    DomainAssignment,
    DomainFormula,
    DomainInequality,
    DomainOperator,
    ExprBase,
    ExprComposite,
    ExprType,
    KeyValue,
    Message,
    Operator,
    SpecialType,
    key_values,
)
from kbstore.model.actions import Action
from kbstore.model.domain import Domain, Signature
from kbstore.model.expressions import Atom, NumericExpression, Token
from kbstore.model.formulas import Add, And, Comparison, Delete, Effect, Formula, Not, NumericEffect, Timing
from kbstore.names import NameMapping, key

_NO_FUNCTION = DomainFormula()


def composite_of(expression: NumericExpression, formula_of: Callable[[Atom], DomainFormula]) -> ExprComposite:
    """Return an expression as a message; `formula_of` makes the messages of its functions."""
    # long expressions repeat a few tokens, so each is made once; the key has the type, as members of enums equal
    # numbers, and the repr of a number, as 0 equals -0
    bases: dict[tuple[type, Token | str], ExprBase] = {}
    found = []
    for token in expression:
        name = (type(token), repr(token) if isinstance(token, float) else token)
        base = bases.get(name)
        if base is None:
            base = bases[name] = _base(token, formula_of)
        found.append(base)
    return ExprComposite.trusted(tokens=tuple(found))


def unlabelled(atom: Atom) -> DomainFormula:
    """Return a function's term as a message, its arguments without labels."""
    values = key_values(("",) * len(atom.arguments), atom.arguments)
    return DomainFormula.trusted(name=atom.name, typed_parameters=values)


def from_composite(composite: ExprComposite) -> NumericExpression:
    """Return a message's expression. Raises `InvalidKnowledge` for an empty one, and for NaN and infinities."""
    if not composite.tokens:
        raise InvalidKnowledge("the expression is empty; give at least one token, a number or a function")
    return tuple(_token(base) for base in composite.tokens)


def _base(token: Token, formula_of: Callable[[Atom], DomainFormula]) -> ExprBase:
    kind, constant, function = ExprType.CONSTANT, 0.0, _NO_FUNCTION
    op, special = Operator.ADD, SpecialType.HASHT
    match token:
        case Operator():
            kind, op = ExprType.OPERATOR, token
        case SpecialType():
            kind, special = ExprType.SPECIAL, token
        case Atom():
            kind, function = ExprType.FUNCTION, formula_of(token)
        case _:
            constant = float(token)
    return ExprBase.trusted(expr_type=kind, constant=constant, function=function, op=op, special_type=special)


def _token(base: ExprBase) -> Token:
    match base.expr_type:
        case ExprType.OPERATOR:
            return base.op
        case ExprType.SPECIAL:
            return base.special_type
        case ExprType.FUNCTION:
            return Atom(base.function.name, tuple(value.value for value in base.function.typed_parameters))
        case ExprType.CONSTANT:
            if not math.isfinite(base.constant):
                raise InvalidKnowledge(f"{base.constant!r} is not a number for an expression; give a finite number")
            return base.constant


def formula_of(signature: Signature) -> DomainFormula:
    """Return a predicate or function as a message: its parameters map label to type."""
    parameters = tuple(KeyValue(parameter.name, parameter.type_text) for parameter in signature.parameters)
    return DomainFormula(name=signature.name, typed_parameters=parameters)


def operator_message(action: Action, constants: Mapping[str, str] | None = None) -> DomainOperator:
    """Return an operator as a message.

    Its lists have the conjuncts that are atoms, negated atoms or comparisons, and the effects that add, delete or
    assign; a continuous effect is listed at start, where it begins. An argument's label is the operator's variable or
    the name of a constant, and its value is the type of that; `constants` maps each constant to its type. Only the
    `Action` has the rest.
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
    """Return the list that a condition belongs to, and its message; None if the message cannot carry it."""
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
    """Return the list that an effect belongs to, and its message; None if the message cannot carry it."""
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


class DomainFormulas(tuple[DomainFormula, ...]):
    """Formulas in the order of the domain; also found by name in any case: ``predicates["robot_at"]``."""

    __slots__ = ()

    def __contains__(self, wanted: object) -> bool:
        if isinstance(wanted, str):
            return any(key(formula.name) == key(wanted) for formula in self)
        return super().__contains__(wanted)

    @overload
    def __getitem__(self, wanted: SupportsIndex) -> DomainFormula: ...
    @overload
    def __getitem__(self, wanted: slice) -> tuple[DomainFormula, ...]: ...
    @overload
    def __getitem__(self, wanted: str) -> DomainFormula: ...
    def __getitem__(self, wanted: SupportsIndex | slice | str) -> DomainFormula | tuple[DomainFormula, ...]:
        if not isinstance(wanted, str):
            return super().__getitem__(wanted)
        for formula in self:
            if key(formula.name) == key(wanted):
                return formula
        raise KeyError(wanted)


@dataclass(frozen=True, eq=False, repr=False)
class MessageDomain(Domain):
    """A domain that also has its predicates, functions and operators as messages. Public as `kbstore.Domain`."""

    @cached_property
    def predicates(self) -> DomainFormulas:
        """The predicates as messages, derived ones included."""
        return DomainFormulas(map(formula_of, self.predicate_signatures.values()))

    @cached_property
    def functions(self) -> DomainFormulas:
        """The numeric functions as messages."""
        return DomainFormulas(map(formula_of, self.function_signatures.values()))

    @cached_property
    def operators(self) -> Mapping[str, DomainOperator]:
        """The operators as messages, by name: listed as written, found in any case."""
        return NameMapping({a.name: operator_message(a, self.constants) for a in self.actions.values()})

    def predicate(self, name: str) -> DomainFormula:
        """The predicate of that name as a message. Raises `UnknownSymbol`."""
        return self.predicates[self.predicate_signature(name).name]

    def function(self, name: str) -> DomainFormula:
        """The numeric function of that name as a message. Raises `UnknownSymbol`."""
        return self.functions[self.function_signature(name).name]

    def operator(self, name: str) -> DomainOperator:
        """The operator of that name as a message. Raises `UnknownSymbol`."""
        return self.operators[self.action(name).name]
