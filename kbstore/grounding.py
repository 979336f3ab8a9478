"""Operators with objects for their parameters."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property

from kbstore import names
from kbstore.actions import Action
from kbstore.domain import Domain
from kbstore.errors import InvalidKnowledge
from kbstore.interpretation import Interpretation
from kbstore.logic import (
    And,
    Atom,
    Comparison,
    Condition,
    Defined,
    Exists,
    Expression,
    Forall,
    Imply,
    IsA,
    Moment,
    Not,
    Or,
    Parameter,
    Preference,
    Same,
    Truism,
)
from kbstore.names import key


@dataclass(frozen=True)
class GroundAction:
    """An operator and the objects that it is about.

    `arguments` are the objects' names as they were given; `bindings` maps each parameter's name, without the
    question mark, to the object, both as keys (`kbstore.names.key`).
    """

    action: Action
    arguments: tuple[str, ...]
    bindings: Mapping[str, str]

    def __str__(self) -> str:
        return f"({' '.join((self.action.name, *self.arguments))})"

    @cached_property
    def spellings(self) -> Mapping[str, str]:
        """The object of each parameter as it was given; parameters as keys."""
        return dict(zip(map(key, (p.name for p in self.action.parameters)), self.arguments, strict=True))

    def conditions(self, moment: Moment) -> list[Condition]:
        """The conditions of a moment with the objects in their places, conjunctions split into their parts.

        Quantified conditions stay as they are. A preference is left out: it never keeps an action from being
        applied (PDDL 3.0).
        """
        return [
            part
            for condition in self.action.conditions_at(moment)
            for part in _conjuncts(instantiate(condition, self.spellings))
        ]


def ground(domain: Domain, name: str, arguments: tuple[str, ...], world: Interpretation) -> GroundAction:
    """The operator of that name with objects that exist in the world and are of its parameters' types.

    Raises `UnknownSymbol` if the domain has no such operator, and `InvalidKnowledge` with everything that is wrong
    with the arguments.
    """
    action = domain.action(name)
    given = f"({' '.join((action.name, *arguments))})"
    violations = []
    if len(arguments) != len(action.parameters):
        expected = " ".join(f"?{p.name} - {p.type_text}" for p in action.parameters)
        violations.append(
            f"{given} has {len(arguments)} arguments; {action.name} takes {len(action.parameters)}"
            + (f": {expected}" if expected else "")
        )
    for argument, parameter in zip(arguments, action.parameters, strict=False):
        wrong = _mismatch(domain, argument, parameter, world)
        if wrong:
            violations.append(f"{given}: ?{parameter.name} is {wrong}")
    if violations:
        raise InvalidKnowledge(*violations)
    bindings = {key(p.name): key(argument) for p, argument in zip(action.parameters, arguments, strict=True)}
    return GroundAction(action, arguments, bindings)


def _mismatch(domain: Domain, argument: str, parameter: Parameter, world: Interpretation) -> str | None:
    """What is wrong with an argument, after "?wp is"."""
    expected = f"an object of the type {parameter.type_text} is expected"
    problem = names.problem(argument)
    if problem:
        return f"{argument!r:.80}, which {problem}; {expected}"
    type_name = world.type_of(key(argument))
    if type_name is None:
        return f"{argument}, which does not exist; {expected}"
    if not domain.is_subtype(type_name, parameter.types):
        spelling = domain.type_spelling(type_name) if domain.knows_type(type_name) else type_name
        return f"{argument}, which is of the type {spelling}; {expected}"
    return None


def instantiate(condition: Condition, objects: Mapping[str, str]) -> Condition:
    """The condition with objects for its free variables; preferences become true.

    `objects` maps the names of variables, as keys and without the question mark. What a quantifier binds itself is
    left alone. Conditions of any depth are fine.
    """
    done: list[Condition] = []
    todo: list[tuple[Condition, Mapping[str, str], bool]] = [(condition, objects, False)]
    while todo:
        node, known, parts_are_done = todo.pop()
        parts = _parts(node)
        if not parts:
            done.append(_leaf(node, known))
        elif parts_are_done:
            rebuilt = _rebuilt(node, tuple(done[-len(parts) :]))
            del done[-len(parts) :]
            done.append(rebuilt)
        else:
            todo.append((node, known, True))
            if isinstance(node, Exists | Forall):
                bound = {key(p.name) for p in node.parameters}
                known = {name: thing for name, thing in known.items() if name not in bound}
            todo.extend((part, known, False) for part in reversed(parts))
    return done.pop()


def _parts(node: Condition) -> tuple[Condition, ...]:
    match node:
        case And(parts) | Or(parts):
            return parts
        case Not(part) | Exists(_, part) | Forall(_, part):
            return (part,)
        case Imply(premise, conclusion):
            return (premise, conclusion)
        case _:
            return ()


def _rebuilt(node: Condition, parts: tuple[Condition, ...]) -> Condition:
    match node:
        case And():
            kept = tuple(part for part in parts if not isinstance(part, Truism))
            return And(kept) if kept else Truism()
        case Or():
            return Or(parts)
        case Not():
            return Not(*parts)
        case Imply():
            return Imply(*parts)
        case Exists(parameters) | Forall(parameters):
            return type(node)(parameters, *parts)
        case _:
            raise AssertionError(f"{type(node).__name__} has no parts")


def _leaf(node: Condition, objects: Mapping[str, str]) -> Condition:
    match node:
        case Atom():
            return _atom(node, objects)
        case Same(left, right):
            return Same(_term(left, objects), _term(right, objects))
        case Comparison(comparison, left, right):
            return Comparison(comparison, with_objects(left, objects), with_objects(right, objects))
        case Defined(function):
            return Defined(_atom(function, objects))
        case IsA(name, type_name):
            return IsA(_term(name, objects), type_name)
        case Preference():
            return Truism()
        case _:
            return node


def with_objects(expression: Expression, objects: Mapping[str, str]) -> Expression:
    """The numeric expression with objects for its variables."""
    return tuple(_atom(token, objects) if isinstance(token, Atom) else token for token in expression)


def _atom(atom: Atom, objects: Mapping[str, str]) -> Atom:
    return Atom(atom.name, tuple(_term(argument, objects) for argument in atom.arguments))


def _term(term: str, objects: Mapping[str, str]) -> str:
    return objects.get(key(term[1:]), term) if term.startswith("?") else term


def _conjuncts(condition: Condition) -> Iterator[Condition]:
    """The parts of a conjunction in their order, however deep it is nested; nothing of what is always true."""
    todo = [condition]
    while todo:
        node = todo.pop()
        if isinstance(node, And):
            todo.extend(reversed(node.parts))
        elif not isinstance(node, Truism):
            yield node
