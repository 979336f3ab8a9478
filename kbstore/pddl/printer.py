"""Writes formulas as PDDL text with single spaces, without recursion; read again, it gives an equal formula."""

from collections.abc import Iterable

from kbstore.messages import AssignOp, Operator, SpecialType, format_number
from kbstore.messages.formulas import prefix_text
from kbstore.model.expressions import NumericExpression, Token
from kbstore.model.formulas import (
    Add,
    And,
    AssignObject,
    Atom,
    Comparison,
    Defined,
    Delete,
    Effect,
    Exists,
    Forall,
    ForEach,
    Formula,
    Imply,
    IsA,
    Not,
    NumericEffect,
    Or,
    Parameter,
    Preference,
    Same,
    Truism,
    When,
    WhenAtStart,
)

_Piece = str | Formula | Effect


def expression_text(expression: NumericExpression) -> str:
    """Write a numeric expression in PDDL, for instance ``(+ (battery kenny) 5)``."""
    return prefix_text(token if isinstance(token, Operator) else _token_text(token) for token in expression)


def condition_text(condition: Formula) -> str:
    """Write a condition in PDDL, for instance ``(and (robot_at kenny wp0) (> (battery kenny) 20))``.

    The existence of an object of any type is written with the type ``object``.
    """
    if isinstance(condition, IsA):
        return _is_a(condition)
    return _written(condition)


def effect_text(effect: Effect) -> str:
    """Write an effect in PDDL, for instance ``(not (docked ?r))`` or ``(increase (battery ?r) (* #t 2))``.

    The text does not name the part of the action that the effect belongs to, only that of a condition of another part:
    ``(when (at start (lit)) (seen))`` is an effect at end.
    """
    return _written(effect)


def parameters_text(parameters: Iterable[Parameter]) -> str:
    """Write typed variables in PDDL, for instance ``?r - robot ?wp - waypoint``."""
    return " ".join(f"?{parameter.name} - {parameter.type_text}" for parameter in parameters)


def _written(formula: Formula | Effect) -> str:
    written: list[str] = []
    stack: list[_Piece] = [formula]
    while stack:
        piece = stack.pop()
        if isinstance(piece, str):
            written.append(piece)
        else:
            stack.extend(reversed(_pieces(piece)))
    return "".join(written)


def _pieces(formula: Formula | Effect) -> list[_Piece]:
    match formula:
        case Atom() | Add() | Defined():
            return [str(formula if isinstance(formula, Atom) else _atom_of(formula))]
        case Delete(atom):
            return [f"(not {atom})"]
        case Truism():
            return ["(and)"]
        case Not(part):
            return ["(not ", part, ")"]
        case And(parts):
            return _listed("(and", parts)
        case Or(parts):
            return _listed("(or", parts)
        case Imply(premise, conclusion):
            return _listed("(imply", (premise, conclusion))
        case Exists(parameters, part):
            return [f"(exists ({parameters_text(parameters)}) ", part, ")"]
        case Forall(parameters, part):
            return [f"(forall ({parameters_text(parameters)}) ", part, ")"]
        case Same(left, right):
            return [f"(= {left} {right})"]
        case Comparison(comparison, left, right):
            return [f"({comparison.pddl} {expression_text(left)} {expression_text(right)})"]
        case IsA():
            return [f"({_is_a(formula)})"]
        case Preference(name, part):
            return [f"(preference {name} " if name else "(preference ", part, ")"]
        case NumericEffect(operation, function, value):
            text = expression_text(value)
            return [f"({operation.pddl} {function} {f'(* #t {text})' if operation is AssignOp.ASSIGN_CTS else text})"]
        case AssignObject(function, value):
            return [f"(assign {function} {value})"]
        case When(condition, effects):
            return ["(when ", condition, " ", *_together(effects), ")"]
        case WhenAtStart(condition, effects):
            return ["(when (at start ", condition, ") ", *_together(effects), ")"]
        case ForEach(parameters, effects):
            return [f"(forall ({parameters_text(parameters)}) ", *_together(effects), ")"]


def _listed(opening: str, parts: tuple[_Piece, ...]) -> list[_Piece]:
    pieces: list[_Piece] = [opening]
    for part in parts:
        pieces += (" ", part)
    return [*pieces, ")"]


def _together(effects: tuple[Effect, ...]) -> list[_Piece]:
    """Join several effects by one ``and``."""
    return [effects[0]] if len(effects) == 1 else _listed("(and", effects)


def _atom_of(formula: Add | Defined) -> Atom:
    return formula.atom if isinstance(formula, Add) else formula.function


def _is_a(condition: IsA) -> str:
    return f"{condition.name} - {condition.type_name or 'object'}"


def _token_text(token: Token) -> str:
    match token:
        case Atom():
            return str(token)
        case SpecialType():
            return token.pddl
        case _:
            return format_number(float(token))
