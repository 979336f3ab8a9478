"""Continuous effects as differential equations: the rates that running actions add to functions (rule O5).

This is the one place in which rates are computed, recorded and expected ones. A rate is constant between two changes of
what its effect reads; the simulator asks for the rates again after each change.
"""

from collections.abc import Collection, Iterable, Iterator, Mapping
from itertools import product
from math import isfinite
from typing import NamedTuple

from kbstore.clock import SECOND
from kbstore.errors import DivisionByZero, InvalidKnowledge, NotLinear, UndefinedFunction, UnknownSymbol
from kbstore.evaluation import expressions
from kbstore.evaluation.evaluator import Evaluation
from kbstore.evaluation.interpretation import Interpretation
from kbstore.evaluation.substitution import instantiated
from kbstore.messages import Truth
from kbstore.model.domain import Domain
from kbstore.model.expressions import NumericExpression, atoms_of
from kbstore.model.formulas import (
    Atom,
    Comparison,
    Defined,
    Effect,
    ForEach,
    Formula,
    NumericEffect,
    Timing,
    When,
    WhenAtStart,
    walk,
)
from kbstore.model.results import Run
from kbstore.model.timelines import Value, number_at
from kbstore.names import key
from kbstore.planning.effects import grounded_atom
from kbstore.planning.grounding import ground
from kbstore.planning.start_conditions import NOTHING, Remembered, premise


class RunningAction(NamedTuple):
    """A run, and those at-start conditions of its later effects that were true."""

    run: Run
    remembered: Remembered = NOTHING


Reads = frozenset[tuple[str, tuple[str, ...] | None]]
"""Functions by name and arguments; the arguments are None if any may be read."""


class _Moved(NamedTuple):
    """A continuous effect on one function: whether its conditions are true, its rate (None: none), what it reads."""

    function: Atom
    is_active: bool
    rate: float | None
    reads: Reads


def rates(
    running: Iterable[RunningAction], world: Interpretation, moving: Collection[Atom] = ()
) -> dict[Atom, float | None]:
    """Return the rate that running actions add to each function, per second; None where a rate has no value.

    Names are keys. `moving` are the functions with a rate of their own, now or scheduled.

    Raises `NotLinear` where an effect reads one of these, or a function that an effect moves.
    """
    added: dict[Atom, float | None] = {}
    effects = [(entry.run, moved) for entry in running for moved in _continuous(entry, world)]
    for _, moved in effects:
        if moved.is_active:
            before = added.get(moved.function, 0.0)
            added[moved.function] = None if before is None or moved.rate is None else before + moved.rate
    for run, moved in effects:
        for name, arguments in sorted(moved.reads, key=str):
            for other in (*moving, *added):
                if other.name == name and arguments in (None, other.arguments):
                    raise NotLinear(
                        f"{run} moves {moved.function} by {other}, which moves itself: {moved.function} would not be "
                        f"linear in time; end what moves {other}, or abort the run"
                    )
    return {function: rate if rate is None or isfinite(rate) else None for function, rate in added.items()}


def is_moving(action_name: str, domain: Domain | None) -> bool:
    """Return whether an action has continuous effects."""
    return domain is not None and bool(domain.action(action_name).effects_at(Timing.OVER_ALL))


def symbols(action_name: str, domain: Domain) -> set[str]:
    """Return the predicates and functions that an action's continuous effects read or move, by their keys.

    Derived predicates are resolved to what their rules read.
    """
    found: set[str] = set()
    todo: list[Effect] = list(domain.action(action_name).effects_at(Timing.OVER_ALL))
    while todo:
        match todo.pop():
            case When(condition, parts):
                found |= _symbols_in(condition, domain)
                todo.extend(parts)
            case WhenAtStart(_, parts) | ForEach(_, parts):
                todo.extend(parts)
            case NumericEffect(_, function, expression):
                found |= {key(atom.name) for atom in (function, *atoms_of(expression))}
    return found


def value_at_end(value: Value, since: int, added: float, run: Run) -> float:
    """Return the value of a function at the expected end of a run that moves it, by `added` per second (rule O7).

    By then the run has moved it for exactly ``?duration``, which the expected end rounds to nanoseconds.
    """
    rounded = run.duration / SECOND
    if run.seconds == rounded:
        return number_at(value, since, run.expected_end)
    passed = (run.expected_end - since) / SECOND
    exact = run.seconds if since == run.started else passed + (run.seconds - rounded)
    number: float = value[1]
    others: float = value[3] - added
    return number + added * exact + (others * passed if others else 0.0)


def _continuous(entry: RunningAction, world: Interpretation) -> Iterator[_Moved]:
    """Yield the continuous effects of a run, for each function that they name; none if its objects are gone."""
    if not is_moving(entry.run.operator, world.domain):
        return
    assert world.domain is not None
    try:
        action = ground(world.domain, entry.run.operator, entry.run.arguments, world)
    except (InvalidKnowledge, UnknownSymbol):
        return
    evaluation = Evaluation(world, duration=entry.run.seconds)
    todo: list[tuple[Effect, Mapping[str, str], bool, Reads]] = [
        (effect, action.bindings, True, frozenset()) for effect in reversed(action.action.effects_at(Timing.OVER_ALL))
    ]
    while todo:
        effect, bindings, is_active, reads = todo.pop()
        match effect:
            case When(condition, parts):
                is_active = is_active and evaluation.truth(condition, bindings) is Truth.TRUE
                reads |= _read_by(instantiated(condition, bindings), world.domain)
                todo.extend((part, bindings, is_active, reads) for part in reversed(parts))
            case WhenAtStart(condition, parts):
                is_active = is_active and premise(condition, bindings) in entry.remembered
                todo.extend((part, bindings, is_active, reads) for part in reversed(parts))
            case ForEach(parameters, parts):
                variables = [key(p.name) for p in parameters]
                for chosen in reversed(list(product(*(sorted(world.objects(p.types)) for p in parameters)))):
                    inner = {**bindings, **dict(zip(variables, chosen, strict=True))}
                    todo.extend((part, inner, is_active, reads) for part in reversed(parts))
            case NumericEffect(_, function, expression):
                if is_active:
                    reads |= {
                        (atom.name, atom.arguments)
                        for atom in (grounded_atom(atom, bindings, action) for atom in atoms_of(expression))
                    }
                rate = _rate(expression, world, bindings, entry.run.seconds) if is_active else 0.0
                yield _Moved(grounded_atom(function, bindings, action), is_active, rate, reads)


def _rate(
    expression: NumericExpression, world: Interpretation, bindings: Mapping[str, str], duration: float
) -> float | None:
    try:
        return expressions.evaluate(expression, world, bindings, duration=duration)
    except (UndefinedFunction, DivisionByZero):
        return None


def _symbols_in(condition: Formula, domain: Domain) -> set[str]:
    """The predicates and functions that a condition reads."""
    found: set[str] = set()
    todo = [condition]
    while todo:
        for occurrence in walk(todo.pop(), {}):
            match occurrence.node:
                case Comparison(_, left, right):
                    found |= {key(atom.name) for atom in (*atoms_of(left), *atoms_of(right))}
                case Defined(function):
                    found.add(key(function.name))
                case Atom(name, _) if key(name) not in found:
                    found.add(key(name))
                    if domain.is_derived(name):
                        todo += [rule.condition for rule in domain.rules[key(name)]]
    return found


def _read_by(condition: Formula, domain: Domain) -> Reads:
    """Return the functions whose values a condition reads, also through the rules of derived predicates."""
    found: set[tuple[str, tuple[str, ...] | None]] = set()
    todo, seen = [(condition, True)], set()
    while todo:
        formula, is_ground = todo.pop()
        for occurrence in walk(formula, {}):
            node = occurrence.node
            if isinstance(node, Comparison):
                for atom in (*atoms_of(node.left), *atoms_of(node.right)):
                    names = tuple(map(key, atom.arguments))
                    definite = is_ground and not any(name.startswith("?") for name in names)
                    found.add((key(atom.name), names if definite else None))
            elif isinstance(node, Atom) and domain.is_derived(node.name) and key(node.name) not in seen:
                seen.add(key(node.name))
                todo += [(rule.condition, False) for rule in domain.rules[key(node.name)]]
    return frozenset(found)
