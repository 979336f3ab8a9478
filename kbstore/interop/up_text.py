"""Writes expressions and effects of unified_planning as PDDL text."""

from collections.abc import Iterable, Iterator, Mapping
from fractions import Fraction
from typing import Any

from kbstore.errors import InvalidKnowledge
from kbstore.messages.base import format_number
from kbstore.names import bracketed, check

_WORDS = {
    "AND": "and",
    "OR": "or",
    "NOT": "not",
    "IMPLIES": "imply",
    "PLUS": "+",
    "MINUS": "-",
    "TIMES": "*",
    "DIV": "/",
    "LE": "<=",
    "LT": "<",
    "EQUALS": "=",
    "ALWAYS": "always",
    "SOMETIME": "sometime",
    "SOMETIME_BEFORE": "sometime-before",
    "SOMETIME_AFTER": "sometime-after",
    "AT_MOST_ONCE": "at-most-once",
}
"""The operators of unified_planning that PDDL has a word for."""


def expression_text(node: Any) -> str:
    """Write a condition or a numeric expression. Raises `InvalidKnowledge` for what PDDL cannot express."""
    kind = node.node_type.name
    match kind:
        case "BOOL_CONSTANT":
            return "(and)" if node.bool_constant_value() else "(or)"
        case "INT_CONSTANT" | "REAL_CONSTANT":
            return number_text(Fraction(node.constant_value()))
        case "FLUENT_EXP":
            return bracketed(name_of(node.fluent()), *map(expression_text, node.args))
        case "OBJECT_EXP":
            return name_of(node.object())
        case "PARAM_EXP":
            return f"?{name_of(node.parameter())}"
        case "VARIABLE_EXP":
            return f"?{name_of(node.variable())}"
        case "EXISTS" | "FORALL":
            return f"({kind.lower()} ({typed(node.variables(), '?')}) {expression_text(node.arg(0))})"
        case "IFF":
            left, right = map(expression_text, node.args)
            return f"(and (imply {left} {right}) (imply {right} {left}))"
        case "EQUALS" if node.arg(0).type.is_bool_type():
            raise InvalidKnowledge(f"{node}: PDDL has no = between conditions; use Iff")
    if kind not in _WORDS:
        raise InvalidKnowledge(f"{node}: PDDL has no words for {kind.lower().replace('_', ' ')}")
    return bracketed(_WORDS[kind], *map(expression_text, node.args))


def number_text(number: Fraction) -> str:
    """Write an exact number: as a decimal if that of the nearest double is exact, otherwise as a quotient."""
    value = float(number)
    if Fraction(format_number(value)) == number:
        return format_number(value)
    return f"(/ {number.numerator} {number.denominator})"


def decimal_text(node: Any) -> str:
    """Write a constant as a decimal, to the nearest double, as initial states need it."""
    return format_number(float(Fraction(node.constant_value())))


def effects_text(effects: Iterable[Any]) -> Iterator[str]:
    """Write effects of one part of an action."""
    for effect in effects:
        fluent, value = expression_text(effect.fluent), effect.value
        if effect.fluent.type.is_bool_type():
            text = _boolean_effect(fluent, value)
        elif effect.is_continuous_increase() or effect.is_continuous_decrease():
            word = "increase" if effect.is_continuous_increase() else "decrease"
            text = f"({word} {fluent} (* #t {expression_text(value)}))"
        else:
            word = "increase" if effect.is_increase() else "decrease" if effect.is_decrease() else "assign"
            text = f"({word} {fluent} {expression_text(value)})"
        if effect.is_conditional():
            text = f"(when {expression_text(effect.condition)} {text})"
        yield f"(forall ({typed(effect.forall, '?')}) {text})" if effect.is_forall() else text


def _boolean_effect(fluent: str, value: Any) -> str:
    if value.is_bool_constant():
        return fluent if value.bool_constant_value() else f"(not {fluent})"
    condition = expression_text(value)
    return f"(and (when {condition} {fluent}) (when (not {condition}) (not {fluent})))"


def typed(things: Iterable[Any], prefix: str = "") -> str:
    """Write objects, or with the prefix ``?`` parameters or variables, each with its type."""
    return " ".join(f"{prefix}{name_of(thing)} - {type_name(thing.type)}" for thing in things)


def type_name(of: Any) -> str:
    """Write a type of objects. Raises `InvalidKnowledge` for other types, of which PDDL has no parameters."""
    if not of.is_user_type():
        raise InvalidKnowledge(f"a parameter of the type {of} has no counterpart in PDDL, where they are objects")
    return name_of(of)


def name_of(thing: Any) -> str:
    """Return the name of an object of the library. Raises `InvalidKnowledge` if kbstore does not accept it."""
    check(thing.name, type(thing).__name__.strip("_").lower())
    return str(thing.name)


def objects_in(nodes: Iterable[Any]) -> Mapping[str, Any]:
    """Return the objects that expressions name."""
    found: dict[str, Any] = {}
    todo = list(nodes)
    while todo:
        node = todo.pop()
        if node.is_object_exp():
            found[node.object().name] = node.object()
        todo += node.args
    return found
