"""Replaces the variables of formulas by objects."""

from collections.abc import Mapping

from kbstore.model.expressions import NumericExpression
from kbstore.model.formulas import Atom, Comparison, Defined, Exists, Forall, Formula, IsA, Same, map_children
from kbstore.names import is_wildcard, key

Bindings = Mapping[str, str]
"""The object of each variable, both as keys; variables without their question mark."""

ArgumentPattern = tuple[str | None, ...]
"""Arguments as keys; None matches any object (rule V7)."""


def keyed(bindings: Bindings) -> dict[str, str]:
    """Return a caller's bindings as keys."""
    return {key(variable.removeprefix("?")): key(name) for variable, name in bindings.items()}


def term(argument: str, bindings: Bindings) -> str | None:
    """Return the object of an argument, as a key; None if it is a wildcard or a variable without a binding."""
    return bindings.get(key(argument[1:])) if is_wildcard(argument) else key(argument)


def pattern(atom: Atom, bindings: Bindings) -> ArgumentPattern:
    """Return the arguments of an atom as keys, with None for those that match any object."""
    return tuple(term(argument, bindings) for argument in atom.arguments)


def instantiated(condition: Formula, bindings: Bindings) -> Formula:
    """Return a condition with objects for its free variables, but not for those that a quantifier in it binds."""
    if not bindings:
        return condition
    match condition:
        case Atom():
            return instantiated_atom(condition, bindings)
        case Same(left, right):
            return Same(_argument(left, bindings), _argument(right, bindings))
        case Comparison(comparison, left_side, right_side):
            sides = (instantiated_expression(side, bindings) for side in (left_side, right_side))
            return Comparison(comparison, *sides)
        case Defined(function):
            return Defined(instantiated_atom(function, bindings))
        case IsA(name, type_name):
            return IsA(_argument(name, bindings), type_name)
        case Exists(parameters) | Forall(parameters):
            own = {key(p.name) for p in parameters}
            bindings = {variable: name for variable, name in bindings.items() if variable not in own}
    return map_children(condition, lambda part: instantiated(part, bindings))


def _argument(argument: str, bindings: Bindings) -> str:
    return (term(argument, bindings) or argument) if is_wildcard(argument) else argument


def instantiated_atom(atom: Atom, bindings: Bindings) -> Atom:
    """Return an atom with objects for its variables; names stay as they are written."""
    return Atom(atom.name, tuple([_argument(argument, bindings) for argument in atom.arguments]))


def instantiated_expression(expression: NumericExpression, bindings: Bindings) -> NumericExpression:
    """Return an expression with objects for its variables; names stay as they are written."""
    return tuple([instantiated_atom(token, bindings) if isinstance(token, Atom) else token for token in expression])
