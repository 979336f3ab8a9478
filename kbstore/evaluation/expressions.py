"""Numeric expressions: evaluated in IEEE doubles, of any length and depth (rule V5)."""

import math
from collections.abc import Callable, Mapping, Sequence
from typing import TypeVar

from kbstore.clock import isoformat
from kbstore.errors import DivisionByZero, InvalidKnowledge, UndefinedFunction
from kbstore.evaluation.interpretation import Interpretation
from kbstore.evaluation.substitution import instantiated_atom, keyed, term
from kbstore.messages.base import format_number
from kbstore.messages.enums import Operator, SpecialType
from kbstore.model.expressions import NumericExpression, Token
from kbstore.model.formulas import Atom
from kbstore.names import key

_Value = TypeVar("_Value")

_NO_VALUE = {
    SpecialType.HASHT: "#t has a value only in a continuous effect, like (increase (f) (* #t 2))",
    SpecialType.TOTAL_TIME: "(total-time) has a value only in the metric of a plan; it cannot be asked of a state",
    SpecialType.DURATION: "?duration has a value only in an action that is given one",
}


def evaluate(
    expression: NumericExpression,
    world: Interpretation,
    bindings: Mapping[str, str] = {},
    *,
    duration: float | None = None,
    total_time: float | None = None,
) -> float:
    """Return the value of an expression in a world.

    Args:
        expression: tokens in prefix order.
        world: where its functions are read, at the world's time.
        bindings: the object of each variable.
        duration: the value of ``?duration``, in seconds.
        total_time: the value of ``total-time``, in seconds.

    Raises:
        UndefinedFunction: it reads a function that has no value there.
        DivisionByZero: it divides by zero.
        InvalidKnowledge: it overflows, is not an expression, or has a variable or special number without a value.
    """
    known = keyed(bindings)

    def read(token: Token) -> float:
        if isinstance(token, Atom):
            return _read(token, known, world)
        if isinstance(token, SpecialType):
            return special(token, duration=duration, total_time=total_time)
        return number(token)

    try:
        return fold(expression, read, doubles)
    except OverflowError:
        raise InvalidKnowledge(
            "the expression overflows: it goes beyond the numbers that an IEEE double can hold (1.8e308)"
        ) from None


def fold(
    expression: NumericExpression,
    value: Callable[[Token], _Value],
    operate: Callable[[Operator, Sequence[_Value]], _Value],
) -> _Value:
    """Return the value of an expression in any arithmetic, from the values of its leaves; never recursive.

    `operate` signals a division by zero by `ZeroDivisionError`, which becomes a `DivisionByZero` that names the
    divisor. Raises `InvalidKnowledge` if the tokens are not one expression in prefix order.
    """
    operands: list[_Value] = []
    for index in range(len(expression) - 1, -1, -1):
        token = expression[index]
        if not isinstance(token, Operator):
            operands.append(value(token))
            continue
        if len(operands) < token.arity:
            raise InvalidKnowledge(f"the operator {token.pddl} lacks an operand; expressions are in prefix order")
        own = [operands.pop() for _ in range(token.arity)]
        try:
            operands.append(operate(token, own))
        except ZeroDivisionError:
            raise DivisionByZero(f"the expression divides by {_divisor(expression, index)}, which is zero") from None
    if len(operands) != 1:
        raise InvalidKnowledge(
            f"the expression consists of {len(operands)} expressions; expected is one, in prefix order"
            if operands
            else "the expression is empty; write a number, a function like (battery kenny), or (+ (f) 1)"
        )
    return operands[0]


def doubles(operator: Operator, operands: Sequence[float]) -> float:
    """Apply an operator to IEEE doubles. Raises `ZeroDivisionError`, and `OverflowError` for non-finite results."""
    if operator is Operator.UMINUS:
        return -operands[0]
    left, right = operands
    if operator is Operator.ADD:
        result = left + right
    elif operator is Operator.SUB:
        result = left - right
    elif operator is Operator.MUL:
        result = left * right
    else:
        result = left / right
    if not math.isfinite(result):
        raise OverflowError(f"{operator.pddl} of {left} and {right}")
    return result


def number(token: Token) -> float:
    """Return a number in an expression as a double. Raises `InvalidKnowledge` for anything else, and if not finite."""
    if not isinstance(token, float | int) or not math.isfinite(token):
        raise InvalidKnowledge(f"{token!r:.80} cannot stand in an expression; write a finite number or a function")
    return float(token)


def special(token: SpecialType, *, duration: float | None = None, total_time: float | None = None) -> float:
    """Return the value of a special number, in seconds. Raises `InvalidKnowledge` if it has none."""
    value = {SpecialType.DURATION: duration, SpecialType.TOTAL_TIME: total_time}.get(token)
    if value is None:
        raise InvalidKnowledge(_NO_VALUE[token])
    return number(value)


def ground(function: Atom, bindings: Mapping[str, str]) -> Atom:
    """Return a function's term with keys for its name and its arguments.

    Raises `InvalidKnowledge` for an argument that matches any object, as no number can be read then (rule V7).
    """
    arguments = [term(argument, bindings) for argument in function.arguments]
    if None in arguments:
        wild = function.arguments[arguments.index(None)] or "?"
        variable = wild if len(wild) > 1 else "?x"
        raise InvalidKnowledge(
            f"{wild} in {function} stands for no definite object, and a number is read of one; "
            f"say exists: (exists ({variable} - object) ...) with {variable} in its place"
        )
    return Atom(key(function.name), tuple(argument for argument in arguments if argument is not None))


def _read(function: Atom, bindings: Mapping[str, str], world: Interpretation) -> float:
    term_read = ground(function, bindings)
    found = world.number(term_read.name, term_read.arguments)
    if found is None:
        raise UndefinedFunction(
            f"{instantiated_atom(function, bindings)} has no value at {isoformat(world.time)} ({world.time} ns)"
        )
    value = found.at(world.time)
    if not math.isfinite(value):
        raise OverflowError(f"{function} at {world.time}")
    return value


def _divisor(expression: NumericExpression, index: int) -> str:
    """Return the divisor of the division at an index, in PDDL if it is a function or a number."""
    start, wanted = index + 1, 1
    while wanted:
        token = expression[start]
        wanted += token.arity - 1 if isinstance(token, Operator) else -1
        start += 1
    match expression[start]:
        case Operator():
            return "an expression"
        case SpecialType() as token:
            return token.pddl
        case Atom() as function:
            return str(function)
        case value:
            return format_number(value)
