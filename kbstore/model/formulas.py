"""The abstract syntax of conditions and effects, and how to walk through them.

Names are kept as written, and compared by `kbstore.names.key`. Arguments that begin
with ``?`` are variables; a bare ``?`` (or a free variable in a question) matches any object (rule V7).
"""

import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from typing import NamedTuple, assert_never, overload

from kbstore.messages.enums import AssignOp, ComparisonType
from kbstore.model.expressions import Atom, NumericExpression, atoms_of
from kbstore.names import key

__all__ = [
    "Add",
    "And",
    "Atom",
    "Comparison",
    "Defined",
    "Delete",
    "Effect",
    "Exists",
    "ForEach",
    "Forall",
    "Formula",
    "Imply",
    "IsA",
    "Not",
    "NumericEffect",
    "Occurrence",
    "Or",
    "Parameter",
    "Preference",
    "Same",
    "Timing",
    "Truism",
    "Types",
    "Variables",
    "When",
    "WhenAtStart",
    "children",
    "map_children",
    "variables_of",
    "walk",
]


@dataclass(frozen=True, slots=True)
class Parameter:
    """A typed variable: ``?wp - waypoint`` is ``Parameter("wp", ("waypoint",))``; several types are an ``either``."""

    name: str
    types: tuple[str, ...] = ("object",)

    @property
    def type_text(self) -> str:
        """The type in PDDL: ``waypoint`` or ``(either robot truck)``."""
        return self.types[0] if len(self.types) == 1 else f"(either {' '.join(self.types)})"


@dataclass(frozen=True, slots=True)
class Truism:
    """The empty condition ``()`` or ``(and)``, which is always true."""


@dataclass(frozen=True, slots=True)
class Not:
    """Negation."""

    part: "Formula"


@dataclass(frozen=True, slots=True)
class And:
    """Conjunction; of no parts, true."""

    parts: tuple["Formula", ...]


@dataclass(frozen=True, slots=True)
class Or:
    """Disjunction; of no parts, false."""

    parts: tuple["Formula", ...]


@dataclass(frozen=True, slots=True)
class Imply:
    """Material implication."""

    premise: "Formula"
    conclusion: "Formula"


@dataclass(frozen=True, slots=True)
class Exists:
    """Some objects of the parameters' types make the part true."""

    parameters: tuple[Parameter, ...]
    part: "Formula"


@dataclass(frozen=True, slots=True)
class Forall:
    """All objects of the parameters' types make the part true."""

    parameters: tuple[Parameter, ...]
    part: "Formula"


@dataclass(frozen=True, slots=True)
class Same:
    """``(= a b)`` between two objects or variables."""

    left: str
    right: str


@dataclass(frozen=True, slots=True)
class Comparison:
    """A comparison of two numeric expressions."""

    comparison: ComparisonType
    left: NumericExpression
    right: NumericExpression


@dataclass(frozen=True, slots=True)
class Defined:
    """Whether a numeric function has a value (a FUNCTION item without one, rule V7)."""

    function: Atom


@dataclass(frozen=True, slots=True)
class IsA:
    """Whether an object exists and is of a type: ``wp7 - waypoint`` asked as a question; no type asks for existence."""

    name: str
    type_name: str = ""


@dataclass(frozen=True, slots=True)
class Preference:
    """``(preference name condition)``; as a condition it is its part."""

    name: str
    part: "Formula"


Formula = Atom | Truism | Not | And | Or | Imply | Exists | Forall | Same | Comparison | Defined | IsA | Preference


class Timing(Enum):
    """The part of a durative action that a condition or an effect belongs to."""

    AT_START = "at start"
    OVER_ALL = "over all"
    AT_END = "at end"


@dataclass(frozen=True, slots=True)
class Add:
    """The effect that a fact becomes true."""

    atom: Atom


@dataclass(frozen=True, slots=True)
class Delete:
    """The effect that a fact ceases to be true."""

    atom: Atom


@dataclass(frozen=True, slots=True)
class NumericEffect:
    """A numeric effect; a continuous one (`ASSIGN_CTS`) adds `value` per second to the function's rate."""

    operation: AssignOp
    function: Atom
    value: NumericExpression


@dataclass(frozen=True, slots=True)
class When:
    """A conditional effect."""

    condition: Formula
    effects: tuple["Effect", ...]


@dataclass(frozen=True, slots=True)
class WhenAtStart:
    """A conditional effect of a durative action's end, or a continuous one, whose condition is one of its start.

    The condition is evaluated at the start, in the state before the at-start effects, and counts as it was then.
    """

    condition: Formula
    effects: tuple["Effect", ...]


@dataclass(frozen=True, slots=True)
class ForEach:
    """A universal effect: ``forall`` among the effects."""

    parameters: tuple[Parameter, ...]
    effects: tuple["Effect", ...]


@dataclass(frozen=True, slots=True)
class AssignObject:
    """The effect that an object fluent takes another value; stored, but not computed (rule P4)."""

    function: Atom
    value: str


Effect = Add | Delete | NumericEffect | AssignObject | When | WhenAtStart | ForEach


@overload
def children(node: Formula) -> tuple[Formula, ...]: ...
@overload
def children(node: Effect) -> tuple[Formula | Effect, ...]: ...
def children(node: Formula | Effect) -> tuple[Formula | Effect, ...]:
    """Return the conditions and effects directly within a condition or an effect, in the order of the text."""
    match node:
        case Not(part) | Preference(_, part) | Exists(_, part) | Forall(_, part):
            return (part,)
        case And(parts) | Or(parts):
            return parts
        case Imply(premise, conclusion):
            return (premise, conclusion)
        case When(condition, effects) | WhenAtStart(condition, effects):
            return (condition, *effects)
        case ForEach(_, effects):
            return effects
        case (
            Atom()
            | Truism()
            | Same()
            | Comparison()
            | Defined()
            | IsA()
            | Add()
            | Delete()
            | NumericEffect()
            | AssignObject()
        ):
            return ()
        case _:
            assert_never(node)


def map_children(node: Formula, f: Callable[[Formula], Formula]) -> Formula:
    """Return the condition with `f` applied to each condition directly within it; an atom is returned as it is."""
    match node:
        case Not(part):
            return Not(f(part))
        case And(parts) | Or(parts):
            return type(node)(tuple([f(part) for part in parts]))
        case Imply(premise, conclusion):
            return Imply(f(premise), f(conclusion))
        case Exists(parameters, part) | Forall(parameters, part):
            return type(node)(parameters, f(part))
        case Preference(name, part):
            return Preference(name, f(part))
        case Atom() | Truism() | Same() | Comparison() | Defined() | IsA():
            return node
        case _:
            assert_never(node)


def object_terms(argument: str) -> list[str]:
    """Return the object fluents in an argument like ``(location ?r)``; a plain name has none.

    Such an argument remains text, as object fluents are not computed (rule P4).
    """
    return _TERM.findall(argument) if argument[:1] == "(" else []


def names_in(argument: str) -> list[str]:
    """Return the names of objects and variables in an argument: itself, or the arguments of an object fluent's term."""
    return _TERM_ARGUMENT.findall(argument) if argument[:1] == "(" else [argument]


def terms_in(condition: Formula) -> Iterator[str]:
    """Yield the arguments in a condition, which are names of objects, variables, and terms of object fluents."""
    for node, _, _ in walk(condition, {}):
        match node:
            case Atom(_, arguments) | Defined(Atom(_, arguments)):
                yield from arguments
            case Comparison(_, left, right):
                for atom in atoms_of((*left, *right)):
                    yield from atom.arguments
            case Same(left_term, right_term):
                yield from (left_term, right_term)
            case IsA(name):
                yield name


def symbols_in(node: Formula | Effect) -> set[str]:
    """Return the keys of the predicates, functions and object fluents in a condition or an effect."""
    found: set[str] = set()
    todo: list[Formula | Effect] = [node]
    while todo:
        node = todo.pop()
        todo.extend(children(node))
        atoms: tuple[Atom, ...] = ()
        arguments: tuple[str, ...] = ()
        match node:
            case Atom():
                atoms = (node,)
            case Defined(atom) | Add(atom) | Delete(atom):
                atoms = (atom,)
            case Comparison(_, left, right):
                atoms = (*atoms_of(left), *atoms_of(right))
            case NumericEffect(_, function, value):
                atoms = (function, *atoms_of(value))
            case AssignObject(function, term):
                atoms, arguments = (function,), (term,)
            case Same(left_term, right_term):
                arguments = (left_term, right_term)
        found.update(key(atom.name) for atom in atoms)
        for argument in (*arguments, *(argument for atom in atoms for argument in atom.arguments)):
            found.update(map(key, object_terms(argument)))
    return found


def changed_by(effects: Iterable[Effect]) -> set[str]:
    """Return the keys of the predicates, functions and object fluents that effects change."""
    found: set[str] = set()
    todo: list[Formula | Effect] = list(effects)
    while todo:
        node = todo.pop()
        match node:
            case Add(atom) | Delete(atom):
                found.add(key(atom.name))
            case NumericEffect(_, function) | AssignObject(function):
                found.add(key(function.name))
            case When() | WhenAtStart() | ForEach():
                todo.extend(node.effects)
    return found


_TERM_ARGUMENT = re.compile(r"(?<=\s)[^\s()]+")
_TERM = re.compile(r"\(([^\s()]+)")

Types = tuple[str, ...]
"""The types that a variable may be of, as keys: one, or those of an ``either``."""

Variables = Mapping[str, Types]
"""The types of variables, by the variables' keys."""


def variables_of(parameters: Sequence[Parameter]) -> dict[str, Types]:
    """Return the variables that parameters declare."""
    return {key(p.name): tuple([key(type_name) for type_name in p.types]) for p in parameters}


class Occurrence(NamedTuple):
    """A condition within a condition: whether under an even number of negations, and the variables in its scope."""

    node: Formula
    positive: bool
    scope: Variables


def walk(condition: Formula, scope: Variables, positive: bool = True) -> Iterator[Occurrence]:
    """Yield a condition and all conditions within it."""
    todo = [Occurrence(condition, positive, scope)]
    while todo:
        occurrence = todo.pop()
        yield occurrence
        node, positive, scope = occurrence
        match node:
            case Not(part):
                todo.append(Occurrence(part, not positive, scope))
            case Imply(premise, conclusion):
                todo += [Occurrence(premise, not positive, scope), Occurrence(conclusion, positive, scope)]
            case Exists(parameters, part) | Forall(parameters, part):
                todo.append(Occurrence(part, positive, {**scope, **variables_of(parameters)}))
            case _:
                todo.extend(Occurrence(part, positive, scope) for part in children(node))
