"""Numeric expressions as the messages carry them: from flat tuples to ExprComposite, and back."""

import math
from collections.abc import Callable

from kbstore.errors import InvalidKnowledge
from kbstore.messages import DomainFormula, ExprBase, ExprComposite, ExprType, Operator, SpecialType, key_values
from kbstore.model.formulas import Atom, NumericExpression, Token

_NO_FUNCTION = DomainFormula()


def composite_of(expression: NumericExpression, formula_of: Callable[[Atom], DomainFormula]) -> ExprComposite:
    """The expression as a message; `formula_of` labels the arguments of its functions."""
    # the same few tokens make up the longest expressions; by type, as the enums' members equal numbers, and numbers as
    # they are written, as 0 equals -0
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
    """A function's term as a message, its arguments without labels."""
    values = key_values(("",) * len(atom.arguments), atom.arguments)
    return DomainFormula.trusted(name=atom.name, typed_parameters=values)


def from_composite(composite: ExprComposite) -> NumericExpression:
    """The expression that a message carries. Raises `InvalidKnowledge` for an empty one, and for NaN and infinities."""
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
