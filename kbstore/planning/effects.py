"""Effects of an operator at its start, at its end, or over all of it (rules O2, O3), and the world after them."""

import math
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass
from itertools import product
from typing import NamedTuple

from kbstore.errors import DivisionByZero, InvalidKnowledge, UndefinedFunction
from kbstore.evaluation import expressions
from kbstore.evaluation.evaluator import Evaluation
from kbstore.evaluation.interpretation import Arguments, Interpretation, Number
from kbstore.messages import AssignOp, ComparisonType, KnowledgeType, Operator, Truth
from kbstore.messages.base import format_number
from kbstore.model.domain import Domain
from kbstore.model.expressions import NumericExpression, atoms_of
from kbstore.model.formulas import (
    Add,
    Atom,
    Comparison,
    Defined,
    Delete,
    Effect,
    ForEach,
    Formula,
    Not,
    NumericEffect,
    Timing,
    When,
    WhenAtStart,
)
from kbstore.model.timelines import Value, fact_value
from kbstore.names import key
from kbstore.planning.grounding import GroundAction
from kbstore.planning.start_conditions import NOTHING, Remembered, premise


class NumericChange(NamedTuple):
    """A numeric effect whose right-hand side has been evaluated."""

    function: Atom
    operation: AssignOp
    operand: float

    def __str__(self) -> str:
        return f"({self.operation.pddl} {self.function} {format_number(self.operand)})"


class Rate(NamedTuple):
    """The rate that a continuous effect adds to a function, per second, while its action runs."""

    function: Atom
    per_second: float


@dataclass(frozen=True)
class Effects:
    """The effects of one part of an action. Names are keys; no atom is both deleted and added."""

    deletes: tuple[Atom, ...] = ()
    adds: tuple[Atom, ...] = ()
    changes: tuple[NumericChange, ...] = ()
    rates: tuple[Rate, ...] = ()

    def written(self, domain: Domain) -> "Effects":
        """Return the effects without those on sensed facts and functions, which are left to sensors (rule O8)."""
        sensed = domain.sensed
        return Effects(
            tuple(atom for atom in self.deletes if atom.name not in sensed),
            tuple(atom for atom in self.adds if atom.name not in sensed),
            tuple(change for change in self.changes if change.function.name not in sensed),
            self.rates,
        )


def evaluate(
    ground: GroundAction,
    timing: Timing,
    world: Interpretation,
    *,
    duration: float | None = None,
    remembered: Remembered = NOTHING,
) -> Effects:
    """Return the effects of a part of an action, with every condition and right-hand side evaluated on `world`.

    Atoms that are both deleted and added are added. Continuous effects are those of `Timing.OVER_ALL`; the rates of
    several on one function are summed. `duration`, in seconds, is the value of ``?duration``. `remembered` has the
    at-start conditions of later effects that were true (`kbstore.planning.start_conditions`).

    Raises `UndefinedFunction` and `DivisionByZero` where a number has no value, and `InvalidKnowledge` where two
    effects conflict or a number overflows; so what is returned can be carried out on `world`.
    """
    deletes: dict[Atom, None] = {}
    adds: dict[Atom, None] = {}
    changes: list[NumericChange] = []
    rates: dict[Atom, float] = {}
    for effect, bindings in _triggered(ground, timing, world, duration, remembered):
        match effect:
            case Delete(atom):
                deletes[grounded_atom(atom, bindings, ground)] = None
            case Add(atom):
                adds[grounded_atom(atom, bindings, ground)] = None
            case NumericEffect(operation, term, value):
                function = grounded_atom(term, bindings, ground)
                operand = expressions.evaluate(value, world, bindings, duration=duration)
                if operation is AssignOp.ASSIGN_CTS:
                    rates[function] = _finite(rates.get(function, 0.0) + operand, "rate", function, ground)
                else:
                    changes.append(NumericChange(function, operation, operand))
    _refuse_conflicts(changes, ground)
    for function, number in resulting(changes, _values(world)).items():
        _finite(number, "value", function, ground)
    return Effects(
        tuple(atom for atom in deletes if atom not in adds),
        tuple(adds),
        tuple(changes),
        tuple(Rate(function, rate) for function, rate in rates.items()),
    )


def resulting(changes: Iterable[NumericChange], number_at: Callable[[Atom], float | None]) -> dict[Atom, float]:
    """Return the value of each changed function after the changes, from the values before them.

    The changes are simultaneous: their operands are numbers already, so that none reads what another one wrote. Several
    increases and decreases of one function add up, several scalings multiply, in the order given. Raises
    `UndefinedFunction` for a change relative to a function without a value, and `DivisionByZero`.
    """
    values: dict[Atom, float] = {}
    for change in changes:
        function, operation, operand = change
        if operation is AssignOp.ASSIGN:
            values[function] = operand
            continue
        value = values[function] if function in values else number_at(function)
        if value is None:
            raise UndefinedFunction(f"{change}: {function} has no value; assign one first, like (= {function} 0)")
        values[function] = _changed(value, change)
    return values


def outcome(
    effects: Effects, world: Interpretation, own_rate: Callable[[Atom], float]
) -> Iterator[tuple[KnowledgeType, Atom, Value | None]]:
    """Yield the value that effects leave on each timeline, or None: deletes before adds, then numbers (rule O2).

    `world` is the state before. `own_rate` returns the rate of a function, per second, without the part that running
    actions add; a change relative to the function's value leaves it as it is (rule C7).
    """
    for atom, sign in _signs(effects, world):
        yield KnowledgeType.FACT, atom, None if sign is None else fact_value(is_negative=not sign)
    assigned = {change.function for change in effects.changes if change.operation is AssignOp.ASSIGN}
    for function, value in resulting(effects.changes, _values(world)).items():
        rate = 0.0 if function in assigned else own_rate(function)
        yield KnowledgeType.FUNCTION, function, (False, value, rate, rate)


def _signs(effects: Effects, world: Interpretation) -> Iterator[tuple[Atom, bool | None]]:
    """Yield the sign of each changed fact: a delete makes it false with `use_unknowns`, else absent (rule O2)."""
    for atom in effects.deletes:
        if world.use_unknowns:
            yield atom, False
        elif world.sign(atom.name, atom.arguments) is not False:
            # a delete does not remove an explicitly false fact (rule C4)
            yield atom, None
    for atom in effects.adds:
        yield atom, True


def lacking(
    ground: GroundAction,
    timing: Timing,
    world: Interpretation,
    *,
    duration: float | None = None,
    remembered: Remembered = NOTHING,
) -> list[Formula]:
    """Return what the numeric effects of a part of an action lack in `world`, as conditions that are not true there.

    A function that is changed relative to its value has to be defined, and each right-hand side needs a value.
    """
    needs: dict[Formula, None] = {}
    for effect, bindings in _triggered(ground, timing, world, duration, remembered):
        if not isinstance(effect, NumericEffect):
            continue
        value = tuple(grounded_atom(t, bindings, ground) if isinstance(t, Atom) else t for t in effect.value)
        missing = without_value(value, world, duration=duration)
        if effect.operation is AssignOp.SCALE_DOWN and not missing:
            missing = without_value((Operator.DIV, 1.0, *value), world, duration=duration)
        if effect.operation is not AssignOp.ASSIGN:
            function = grounded_atom(effect.function, bindings, ground)
            missing += without_value((function,), world)
        needs.update(dict.fromkeys(missing))
    return list(needs)


def without_value(
    expression: NumericExpression, world: Interpretation, *, duration: float | None = None
) -> list[Formula]:
    """Return why a ground expression has no value in the world: a function is not ``Defined``, or a divisor is 0.

    The reasons are conditions that are not true in the world; there is none if the expression has a value.
    """
    undefined: list[Formula] = [
        Defined(function)
        for function in atoms_of(expression)
        if world.number(key(function.name), tuple(map(key, function.arguments))) is None
    ]
    if undefined or Operator.DIV not in expression:
        return undefined
    divisor = _zero_divisor(expression, world, duration)
    return [] if divisor is None else [Not(Comparison(ComparisonType.EQUALS, divisor, (0.0,)))]


class StateAfter:
    """The world right after effects, without copying it (an `Interpretation`).

    A deleted fact is absent in a closed world, and explicitly false with `use_unknowns` (rule O2). Continuous effects
    have not moved anything yet.
    """

    def __init__(self, world: Interpretation, effects: Effects) -> None:
        self._world = world
        self._signs: dict[str, dict[Arguments, bool | None]] = {}
        for atom, sign in _signs(effects, world):
            self._signs.setdefault(atom.name, {})[atom.arguments] = sign
        self._numbers = {
            (function.name, function.arguments): Number(value, since=world.time)
            for function, value in resulting(effects.changes, _values(world)).items()
        }

    @property
    def time(self) -> int:
        """The time, in nanoseconds."""
        return self._world.time

    @property
    def domain(self) -> Domain | None:
        """The domain at that time."""
        return self._world.domain

    @property
    def use_unknowns(self) -> bool:
        """Whether absent reads as unknown."""
        return self._world.use_unknowns

    def sign(self, name: str, arguments: Arguments) -> bool | None:
        """True where the fact is asserted, False where it is explicitly false, None where neither is."""
        changed = self._signs.get(name, {})
        return changed[arguments] if arguments in changed else self._world.sign(name, arguments)

    def facts(self, name: str) -> Iterator[tuple[Arguments, bool]]:
        """The facts of a predicate, of both signs, each with its sign."""
        changed = self._signs.get(name, {})
        for arguments, sign in self._world.facts(name):
            if arguments not in changed:
                yield arguments, sign
        for arguments, new_sign in changed.items():
            if new_sign is not None:
                yield arguments, new_sign

    def number(self, name: str, arguments: Arguments) -> Number | None:
        """The value of a numeric function, None where it is undefined; a changed one has no rate."""
        changed = self._numbers.get((name, arguments))
        return changed if changed is not None else self._world.number(name, arguments)

    def objects(self, types: Iterable[str]) -> Collection[str]:
        """The objects that exist and are of one of the types or their subtypes."""
        return self._world.objects(types)

    def type_of(self, name: str) -> str | None:
        """The type of an object or constant, None where it does not exist."""
        return self._world.type_of(name)


def _triggered(
    ground: GroundAction, timing: Timing, world: Interpretation, duration: float | None, remembered: Remembered
) -> Iterator[tuple[Add | Delete | NumericEffect, Mapping[str, str]]]:
    """Yield the simple effects of a part of an action that take place, in order, each with its variables' objects.

    A conditional effect takes place if its condition is true, and not if it is unknown.
    """
    evaluation = Evaluation(world, duration=duration)
    todo: list[tuple[Effect, Mapping[str, str]]] = [
        (effect, ground.bindings) for effect in reversed(ground.action.effects_at(timing))
    ]
    while todo:
        effect, bindings = todo.pop()
        match effect:
            case When(condition, parts):
                if evaluation.truth(condition, bindings) is Truth.TRUE:
                    todo.extend((part, bindings) for part in reversed(parts))
            case WhenAtStart(condition, parts):
                if premise(condition, bindings) in remembered:
                    todo.extend((part, bindings) for part in reversed(parts))
            case ForEach(parameters, parts):
                variables = [key(p.name) for p in parameters]
                choices = product(*(sorted(world.objects(p.types)) for p in parameters))
                each = [{**bindings, **dict(zip(variables, chosen, strict=True))} for chosen in choices]
                todo.extend((part, inner) for inner in reversed(each) for part in reversed(parts))
            case Add() | Delete() | NumericEffect():
                is_continuous = isinstance(effect, NumericEffect) and effect.operation is AssignOp.ASSIGN_CTS
                if is_continuous != (timing is Timing.OVER_ALL):
                    raise InvalidKnowledge(
                        f"{ground.action.name} has an effect {timing.value} that cannot be there: continuous effects,"
                        " and no others, belong to the whole of a durative action"
                    )
                yield effect, bindings


def grounded_atom(atom: Atom, bindings: Mapping[str, str], ground: GroundAction) -> Atom:
    """Return an atom of an effect with objects for its variables; names are keys."""
    return Atom(key(atom.name), tuple(_object(argument, bindings, ground) for argument in atom.arguments))


def _object(term: str, bindings: Mapping[str, str], ground: GroundAction) -> str:
    if not term.startswith("?"):
        return key(term)
    found = bindings.get(key(term[1:]))
    if found is None:
        raise InvalidKnowledge(f"an effect of {ground.action.name} has the variable {term}, which nothing binds")
    return found


_KINDS = {
    AssignOp.ASSIGN: "assigned",
    AssignOp.INCREASE: "increased or decreased",
    AssignOp.DECREASE: "increased or decreased",
    AssignOp.SCALE_UP: "scaled",
    AssignOp.SCALE_DOWN: "scaled",
}


def _refuse_conflicts(changes: list[NumericChange], ground: GroundAction) -> None:
    """Refuse changes of one function whose order matters: PDDL 2.1 does not define them at one moment."""
    first: dict[Atom, NumericChange] = {}
    violations = []
    for change in changes:
        other = first.setdefault(change.function, change)
        same_kind = _KINDS[other.operation] == _KINDS[change.operation]
        if not same_kind or (change.operation is AssignOp.ASSIGN and change.operand != other.operand):
            violations.append(
                f"{ground} does {other} and {change} at the same moment, and they conflict: at one moment a function is"
                " assigned one value, or increased and decreased, or scaled"
            )
    if violations:
        raise InvalidKnowledge(*violations)


def _changed(value: float, change: NumericChange) -> float:
    match change.operation:
        case AssignOp.INCREASE:
            return value + change.operand
        case AssignOp.DECREASE:
            return value - change.operand
        case AssignOp.SCALE_UP:
            return value * change.operand
        case _:
            if not change.operand:
                raise DivisionByZero(f"{change} divides by zero")
            return value / change.operand


def _values(world: Interpretation) -> Callable[[Atom], float | None]:
    def value(function: Atom) -> float | None:
        number = world.number(function.name, function.arguments)
        return None if number is None else number.at(world.time)

    return value


def _finite(number: float, what: str, function: Atom, ground: GroundAction) -> float:
    if not math.isfinite(number):
        raise InvalidKnowledge(f"{ground} gives {function} the {what} {number}; a function has finite numbers only")
    return number


def _zero_divisor(
    expression: NumericExpression, world: Interpretation, duration: float | None
) -> NumericExpression | None:
    """Return the first divisor, from the right, that is 0 in an expression that reads no undefined function."""
    operands: list[tuple[float, int]] = []  # the values of what has been read, and where each one ends
    for start in reversed(range(len(expression))):
        token = expression[start]
        if not isinstance(token, Operator):
            operands.append((expressions.evaluate((token,), world, duration=duration), start + 1))
            continue
        own = [operands.pop() for _ in range(token.arity)]
        if token is Operator.DIV and own[1][0] == 0:
            return expression[own[0][1] : own[1][1]]
        number = expressions.evaluate((token, *(number for number, _ in own)), world)
        operands.append((number, own[-1][1]))
    return None
