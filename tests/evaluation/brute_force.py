"""An independent evaluator: truth values are numbers (0 false, 1/2 unknown, 1 true), and everything is tried.

It shares no code with kbstore's evaluators: `min` and `max` instead of cases, all objects instead of joins, a recursion
over nested expressions instead of a stack, one table of all ground atoms instead of relations.
"""

import math
from fractions import Fraction
from itertools import product
from typing import Any

from kbstore.evaluation.interpretation import Number
from kbstore.messages import ComparisonType, Operator, Truth
from kbstore.model.domain import Domain
from kbstore.model.expressions import NumericExpression
from kbstore.model.formulas import (
    And,
    Atom,
    Comparison,
    Defined,
    Exists,
    Forall,
    Formula,
    Imply,
    IsA,
    Not,
    Or,
    Preference,
    Same,
    Truism,
)
from tests.evaluation.interpretations import World

FALSE, UNKNOWN, TRUE = 0.0, 0.5, 1.0
TRUTHS = {FALSE: Truth.FALSE, UNKNOWN: Truth.UNKNOWN, TRUE: Truth.TRUE}

Table = dict[tuple[str, tuple[str, ...]], float]


class NoValueError(Exception):
    """An expression has no value."""


def truth(condition: Formula, world: World, bindings: dict[str, str] | None = None) -> Truth:
    """The truth of a condition."""
    rules = world.domain.rules if world.domain else {}
    table = derived_table(world) if any(name in rules for name, _ in reads(condition, False)) else {}
    return TRUTHS[value(condition, world, bindings or {}, table)]


def value(condition: Formula, world: World, known: dict[str, str], table: Table) -> float:
    """The truth of a condition as a number, derived atoms from a table."""

    def inner(part: Formula) -> float:
        return value(part, world, known, table)

    match condition:
        case Atom(name, arguments):
            choices = [wild_or(a, known, world, name, i) for i, a in enumerate(arguments)]
            atoms = [atom_value(name, row, world, table) for row in product(*choices)]
            loose = any(a.startswith("?") and a[1:] not in known for a in arguments)
            if loose and world.domain is None and world.use_unknowns:
                atoms.append(UNKNOWN)  # there may be objects that no fact mentions
            return max(atoms, default=FALSE)
        case Truism():
            return TRUE
        case Not(part):
            return 1 - inner(part)
        case And(parts):
            return min(map(inner, parts), default=TRUE)
        case Or(parts):
            return max(map(inner, parts), default=FALSE)
        case Imply(premise, conclusion):
            return max(1 - inner(premise), inner(conclusion))
        case Exists(parameters, part) | Forall(parameters, part):
            ranges = [world.objects(p.types) for p in parameters]
            found = [
                value(part, world, {**known, **{p.name: o for p, o in zip(parameters, row, strict=True)}}, table)
                for row in product(*ranges)
            ]
            return max(found, default=FALSE) if isinstance(condition, Exists) else min(found, default=TRUE)
        case Same(left, right):
            return float(lookup(left, known) == lookup(right, known))
        case Comparison(comparison, left, right):
            return compared(comparison, left, right, world, known)
        case Defined(Atom(name, arguments)):
            choices = [wild_or(a, known, world, name, i) for i, a in enumerate(arguments)]
            return float(any(world.number(name, row) is not None for row in product(*choices)))
        case IsA(name, type_name):
            names = world.objects([type_name or "object"])
            return float(lookup(name, known) in names if not name.startswith("?") or name[1:] in known else bool(names))
        case Preference(_, part):
            return inner(part)
    raise AssertionError(condition)


def lookup(argument: str, known: dict[str, str]) -> str:
    return known[argument[1:]] if argument.startswith("?") else argument


def wild_or(argument: str, known: dict[str, str], world: World, name: str, position: int) -> list[str]:
    """The objects that a wildcard argument of an atom may be."""
    if not argument.startswith("?"):
        return [argument]
    if argument[1:] in known:
        return [known[argument[1:]]]
    if world.domain is None:
        mentioned = {a for n, row in [*world.signs, *world.values] if n == name for a in row[position : position + 1]}
        return sorted(mentioned)
    signatures = {**world.domain.predicate_signatures, **world.domain.function_signatures}
    return list(world.objects(signatures[name].parameters[position].types))


def atom_value(name: str, row: tuple[str, ...], world: World, table: Table) -> float:
    if world.domain and name in world.domain.rules:
        if any(world.type_of(argument) is None for argument in row):
            return UNKNOWN if world.use_unknowns else FALSE
        return table.get((name, row), FALSE)
    sign = world.sign(name, row)
    return float(sign) if sign is not None else UNKNOWN if world.use_unknowns else FALSE


def derived_table(world: World) -> Table:
    """All derived atoms: strata by counting negations, and in each the two fixpoints by trying every row."""
    domain = world.domain
    assert domain is not None
    level = levels(domain)
    table: Table = {}
    for number in sorted(set(level.values())):
        names = [name for name in domain.rules if level[name] == number]
        certain = fixpoint(names, world, table, accepted=(TRUE,))
        possible = fixpoint(names, world, table, accepted=(TRUE, UNKNOWN))
        table |= dict.fromkeys(possible, UNKNOWN) | dict.fromkeys(certain, TRUE)
    return table


def fixpoint(names: list[str], world: World, below: Table, accepted: tuple[float, ...]) -> Table:
    table = dict(below)
    found: Table = {}
    while True:
        before = len(found)
        for name in names:
            for rule in world.domain.rules[name]:  # type: ignore[union-attr]
                ranges = [world.objects(p.types) for p in rule.head.parameters]
                for row in product(*ranges):
                    known = {p.name: o for p, o in zip(rule.head.parameters, row, strict=True)}
                    if value(rule.condition, world, known, table) in accepted:
                        found[name, row] = table[name, row] = TRUE
        if len(found) == before:
            return found


def levels(domain: Domain) -> dict[str, int]:
    """For each derived predicate one more than what it negates, and no less than what it reads."""
    level = dict.fromkeys(domain.rules, 0)
    for _ in range(len(level) ** 2 + 1):
        for name, rules in domain.rules.items():
            for rule in rules:
                for read, negated in reads(rule.condition, False):
                    if read in level:
                        level[name] = max(level[name], level[read] + negated)
    return level


def reads(condition: Formula, negated: bool) -> list[tuple[str, bool]]:
    match condition:
        case Atom(name):
            return [(name, negated)]
        case Not(part):
            return reads(part, not negated)
        case Imply(premise, conclusion):
            return reads(premise, not negated) + reads(conclusion, negated)
        case And(parts) | Or(parts):
            return [pair for part in parts for pair in reads(part, negated)]
        case Exists(_, part) | Forall(_, part) | Preference(_, part):
            return reads(part, negated)
    return []


def compared(
    comparison: ComparisonType, left: NumericExpression, right: NumericExpression, world: World, known: dict[str, str]
) -> float:
    """A comparison: in exact numbers if anything that it reads moves."""
    try:
        numbers = [n for side in (left, right) for t in side if isinstance(t, Atom) for n in [read(t, world, known)]]
        exact = any(n.rate for n in numbers)
        a, b = (result(nested(list(side)), world, known, exact) for side in (left, right))
    except (NoValueError, ZeroDivisionError):
        return UNKNOWN
    return float({"<": a < b, "<=": a <= b, ">": a > b, ">=": a >= b, "=": a == b}[comparison.pddl])


def read(function: Atom, world: World, known: dict[str, str]) -> Number:
    number = world.number(function.name, tuple(lookup(a, known) for a in function.arguments))
    if number is None:
        raise NoValueError(str(function))
    return number


def nested(tokens: list[Any]) -> Any:
    """Prefix tokens, which are consumed, as nested tuples."""
    token = tokens.pop(0)
    return (token, *(nested(tokens) for _ in range(token.arity))) if isinstance(token, Operator) else token


def result(tree: Any, world: World, known: dict[str, str], exact: bool) -> Any:
    """The value of a nested expression, in rationals or in doubles."""
    match tree:
        case (Operator.UMINUS, operand):
            return -result(operand, world, known, exact)
        case (operator, left, right):
            a, b = result(left, world, known, exact), result(right, world, known, exact)
            if operator is Operator.DIV:
                found = a / b
            else:
                found = {Operator.ADD: a + b, Operator.SUB: a - b, Operator.MUL: a * b}[operator]
            if not exact and not math.isfinite(found):
                raise NoValueError("overflow")
            return found
        case Atom():
            n = read(tree, world, known)
            if not exact:
                return n.value
            return Fraction(n.value) + Fraction(n.rate) * (world.time - n.since) / 1_000_000_000
        case number:
            return Fraction(number) if exact else float(number)
