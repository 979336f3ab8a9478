"""Reads numeric expressions, from their groups to flat tuples in prefix order, without recursion."""

import math
import re

from kbstore.errors import InvalidKnowledge
from kbstore.messages import Operator, SpecialType
from kbstore.model.expressions import NumericExpression, Token
from kbstore.model.formulas import Atom, Variables
from kbstore.names import is_wildcard
from kbstore.pddl.scope import NO_VARIABLES, Scope
from kbstore.pddl.sexpr import Group, Node, node_text

NUMBER = re.compile(r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?", re.ASCII)
"""A number as PDDL files write it."""

_OPERATORS = {"+": Operator.ADD, "-": Operator.SUB, "*": Operator.MUL, "/": Operator.DIV}
_SPECIALS = {"#t": SpecialType.HASHT, "total-time": SpecialType.TOTAL_TIME, "?duration": SpecialType.DURATION}
_NO_NUMBERS = ("nan", "inf", "infinity")

ANY_SPECIAL = frozenset(SpecialType)


def is_number(word: Node) -> bool:
    """Return whether a word is a number."""
    return isinstance(word, str) and NUMBER.fullmatch(word) is not None


def number_at(scope: Scope, group: Group, index: int) -> float | None:
    """Return the number at a place, also as ``(- 5)``; None if there is something else.

    Raises `PddlSyntaxError` for a number that a double cannot hold.
    """
    node, sign = group[index], 1.0
    if isinstance(node, Group) and len(node) == 2 and node[0] == "-":
        node, sign = node[1], -1.0
    if not isinstance(node, str) or not NUMBER.fullmatch(node):
        return None
    value = float(node)
    if math.isinf(value):
        raise scope.error(f"the number {node:.60} is too large for a double", group, index)
    return sign * value


def read_expression(
    scope: Scope,
    group: Group,
    index: int,
    variables: Variables = NO_VARIABLES,
    specials: frozenset[SpecialType] = ANY_SPECIAL,
) -> NumericExpression:
    """Read the expression at a place of a group.

    Sums and products of more than two operands become nested ones; `specials` are the special numbers that may occur.
    Raises `PddlSyntaxError`; reports symbols that do not fit.
    """
    tokens: list[Token] = []
    stack: list[tuple[Group, int]] = [(group, index)]
    while stack:
        parent, place = stack.pop()
        node = parent[place]
        if isinstance(node, str):
            tokens.append(_word(scope, parent, place, node, specials))
        elif node.word(0) in _OPERATORS:
            tokens.extend(_operators(scope, node))
            stack.extend((node, operand) for operand in range(len(node) - 1, 0, -1))
        elif node.word(0) == "total-time" and len(node) == 1 and not scope.is_function("total-time"):
            tokens.append(_special(scope, parent, place, SpecialType.TOTAL_TIME, specials))
        elif node.word(0) == "is-violated" and SpecialType.TOTAL_TIME in specials:
            # a metric counts a preference by its name, which is read like the argument of a function
            tokens.append(Atom(scope.name(node, 0, "function"), (scope.name(node, 1, "preference"),)))
        elif not node:
            raise scope.error("a numeric expression is expected here, not ()", node)
        else:
            tokens.append(read_function(scope, node, variables))
    return tuple(tokens)


def read_function(
    scope: Scope, group: Group, variables: Variables, *, wildcards: bool = False, asserted: bool = False
) -> Atom:
    """Read the term of a numeric function.

    `wildcards` is whether free variables may be patterns here (rule V7), `asserted` whether the value is set.
    """
    name = scope.name(group, 0, "numeric function")
    if is_number(name) or name == "?duration":
        raise scope.error(f"{name} is without brackets", group)
    atom = scope.atom(group, scope.function(name, group), variables, asserted=asserted)
    if scope.patterns and not wildcards:
        refuse_wildcards(scope, group, atom, variables)
    return atom


def refuse_wildcards(scope: Scope, group: Group, atom: Atom, variables: Variables) -> None:
    """Report free variables in a comparison (rule V7)."""
    for index, argument in enumerate(atom.arguments, 1):
        if is_wildcard(argument) and argument[1:].lower() not in variables:
            scope.diagnose(
                InvalidKnowledge,
                f"{argument} in {atom} matches nothing in a comparison; write (exists (?x - some-type) ...)",
                group,
                index,
            )


def _word(scope: Scope, group: Group, index: int, word: str, specials: frozenset[SpecialType]) -> Token:
    number = number_at(scope, group, index)
    if number is not None:
        return number
    special = _SPECIALS.get(word.lower())
    if special is not None and not scope.is_function(word):
        return _special(scope, group, index, special, specials)
    if word[0] == "?":
        raise scope.error(f"{word} is a variable for objects, and has no numeric value", group, index)
    if word.lower().lstrip("+-") in _NO_NUMBERS and not scope.is_bare_function(word):
        raise scope.error(f"{word} is not a number; write a finite one, like 12.5", group, index)
    if word.lower() in _OPERATORS:
        raise scope.error(f"an operation is in brackets, like ({word} 1 2)", group, index)
    signature = scope.function(word, group, index)
    if signature is not None and signature.parameters:
        scope.diagnose(InvalidKnowledge, f"{word} needs its arguments: {signature}", group, index)
    return Atom(word)


def _special(
    scope: Scope, group: Group, index: int, special: SpecialType, specials: frozenset[SpecialType]
) -> SpecialType:
    if special not in specials:
        where = {
            SpecialType.HASHT: "the continuous effects of durative actions",
            SpecialType.TOTAL_TIME: "the metric",
            SpecialType.DURATION: "durative actions",
        }
        raise scope.error(f"{special.pddl} has a meaning only in {where[special]}", group, index)
    return special


def _operators(scope: Scope, group: Group) -> list[Token]:
    """Return the operators of a group: one; in a longer sum or product, one fewer than operands."""
    operator = _OPERATORS[group.word(0)]
    operands = len(group) - 1
    if operands == 1 and operator is Operator.SUB:
        return [Operator.UMINUS]
    if operands == 0 or (operator in (Operator.SUB, Operator.DIV) and operands != 2):
        takes = {"-": "one or two operands", "/": "two operands"}.get(group.word(0), "at least one operand")
        raise scope.error(f"({group.word(0)} ...) takes {takes}, not {operands}: {node_text(group, 60)}", group)
    return [operator] * (operands - 1)
