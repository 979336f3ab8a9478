"""A PDDL domain: its types, constants, predicates, functions, actions and rules, and what follows from the types."""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from types import MappingProxyType
from typing import Self, TypeVar

from kbstore.errors import InvalidKnowledge, UnknownSymbol, one_line
from kbstore.model.actions import Action
from kbstore.model.formulas import Formula, Parameter, symbols_in
from kbstore.names import NameMapping, bracketed, check_is_text, key

_Symbol = TypeVar("_Symbol")

ROOT_TYPE = "object"
"""The type above all others."""


@dataclass(frozen=True)
class Signature:
    """A predicate or a numeric function with its parameters."""

    name: str
    parameters: tuple[Parameter, ...] = ()

    @cached_property
    def labels(self) -> tuple[str, ...]:
        """The parameters' names in order."""
        return tuple(parameter.name for parameter in self.parameters)

    def __str__(self) -> str:
        """Return the declaration in PDDL, for instance ``(robot_at ?r - robot ?wp - waypoint)``."""
        return bracketed(self.name, *(f"?{p.name} - {p.type_text}" for p in self.parameters))


@dataclass(frozen=True)
class DerivedRule:
    """A rule for a derived predicate: the head's parameters are the variables of its condition."""

    head: Signature
    condition: Formula


@dataclass(frozen=True)
class ObjectFluent:
    """A function whose value is an object of one of `types` (PDDL 3.1): stored, but not computed (rule P4)."""

    signature: Signature
    types: tuple[str, ...]


@dataclass(frozen=True)
class Event:
    """A process or an event (PDDL+): stored, but not computed (rule P4).

    `changes` are the keys of the predicates and functions in its effects.
    """

    kind: str
    name: str
    changes: frozenset[str]


@dataclass(frozen=True, eq=False, repr=False)
class Domain:
    """The declarations of a PDDL domain. Mappings are read-only, with keys of `kbstore.names.key` unless noted.

    `types` maps each type's name, as written, to its parent's (to ``(either a b)`` where it has several);
    `constants` maps each constant's name to its type. Both are found by name in any case.
    """

    name: str
    types: Mapping[str, str] = field(default_factory=dict)
    constants: Mapping[str, str] = field(default_factory=dict)
    predicate_signatures: Mapping[str, Signature] = field(default_factory=dict)
    function_signatures: Mapping[str, Signature] = field(default_factory=dict)
    actions: Mapping[str, Action] = field(default_factory=dict)
    rules: Mapping[str, tuple[DerivedRule, ...]] = field(default_factory=dict)
    object_fluents: Mapping[str, ObjectFluent] = field(default_factory=dict)
    events: tuple[Event, ...] = ()
    requirements: tuple[str, ...] = ()
    sensed: frozenset[str] = frozenset()
    source: str = ""
    is_forecast: bool = False

    def __post_init__(self) -> None:
        object.__setattr__(self, "types", NameMapping(self.types))
        object.__setattr__(self, "constants", NameMapping(self.constants))
        for name in ("predicate_signatures", "function_signatures", "actions", "rules", "object_fluents"):
            object.__setattr__(self, name, MappingProxyType(dict(getattr(self, name))))

    def __repr__(self) -> str:
        counts = (
            (len(self.types), "type"),
            (len(self.predicate_signatures), "predicate"),
            (len(self.function_signatures), "function"),
            (len(self.actions), "action"),
        )
        shown = ", ".join(f"{number} {noun}" + ("" if number == 1 else "s") for number, noun in counts if number)
        return f"Domain({self.name!r}: {shown or 'empty'})"

    # -- what is declared -------------------------------------------------------------------------------------

    def predicate_signature(self, name: str) -> Signature:
        """The predicate's signature. Raises `UnknownSymbol`, and `InvalidKnowledge` for an object fluent."""
        self._refuse_object_fluent(name)
        return _find(self.predicate_signatures, name, "predicate", self.name)

    def function_signature(self, name: str) -> Signature:
        """The numeric function's signature. Raises `UnknownSymbol`, and `InvalidKnowledge` for an object fluent."""
        self._refuse_object_fluent(name)
        return _find(self.function_signatures, name, "function", self.name)

    def symbol(self, name: str) -> Signature:
        """The signature of a predicate or numeric function. Raises `UnknownSymbol`."""
        symbols = {**self.function_signatures, **self.predicate_signatures}
        return _find(symbols, name, "predicate or function", self.name)

    def action(self, name: str) -> Action:
        """The operator with all of its conditions and effects. Raises `UnknownSymbol`."""
        return _find(self.actions, name, "operator", self.name)

    def is_derived(self, name: str) -> bool:
        """Return whether a predicate is derived by rules."""
        return key(name) in self.rules

    def is_sensed(self, name: str) -> bool:
        """Return whether a predicate (or function) is marked as sensed. Raises `UnknownSymbol`."""
        self.symbol(name)
        return key(name) in self.sensed

    def with_sensed(self, name: str, sensed: bool) -> Self:
        """Return the domain with a predicate or function marked as sensed, or not. Raises `UnknownSymbol`."""
        self.is_sensed(name)
        marks = self.sensed | {key(name)} if sensed else self.sensed - {key(name)}
        return replace(self, sensed=frozenset(marks))

    def marked(self, names: Iterable[str]) -> Self:
        """Return the domain with exactly these predicates and functions, given by their keys, marked as sensed."""
        return replace(self, sensed=frozenset(names))

    # -- what is not computed (rule P4) -----------------------------------------------------------------------

    @cached_property
    def forecast(self) -> Self:
        """The domain for questions about times after now, whose answers processes and events may change."""
        return replace(self, is_forecast=True) if self.events and not self.is_forecast else self

    @cached_property
    def uncomputed(self) -> Mapping[str, str]:
        """The reasons for which predicates and functions, by their keys, cannot be read by questions; mostly empty."""
        reasons = {
            name: f"{fluent.signature.name} is an object fluent, which is kept and written back, but not computed"
            for name, fluent in self.object_fluents.items()
        }
        for event in self.events if self.is_forecast else ():
            for name in event.changes:
                reasons.setdefault(
                    name,
                    f"after now, {self._spelling(name)} may be changed by the {event.kind} {event.name}, which is kept "
                    "and written back, but not computed; ask about now",
                )
        if reasons:
            reads = {
                name: set[str]().union(*(symbols_in(rule.condition) for rule in rules))
                for name, rules in self.rules.items()
            }
            while True:
                new = {
                    name: f"{self._spelling(name)} is derived from what is not computed: {reasons[min(found)]}"
                    for name, read in reads.items()
                    if name not in reasons and (found := read & reasons.keys())
                }
                if not new:
                    break
                reasons |= new
        return reasons

    def _refuse_object_fluent(self, name: str) -> None:
        if self.object_fluents and key(name) in self.object_fluents:
            raise InvalidKnowledge(self.uncomputed[key(name)])

    def _spelling(self, name: str) -> str:
        found = self.predicate_signatures.get(name) or self.function_signatures.get(name)
        return found.name if found else name

    # -- types ------------------------------------------------------------------------------------------------

    @cached_property
    def _parents(self) -> dict[str, tuple[str, ...]]:
        return {key(name): type_keys(parent) for name, parent in self.types.items()}

    @cached_property
    def constant_types(self) -> dict[str, str]:
        """The type of each constant, both as keys."""
        return {key(name): key(type_name) for name, type_name in self.constants.items()}

    @cached_property
    def _constant_spellings(self) -> dict[str, str]:
        return {key(name): name for name in self.constants}

    def constant_spelling(self, name: str) -> str | None:
        """A constant's name as the domain writes it; None if there is no such constant."""
        return self._constant_spellings.get(key(name))

    def knows_type(self, name: str) -> bool:
        """Return whether a type is declared; ``object`` always is."""
        return key(name) == ROOT_TYPE or key(name) in self._parents

    def type_spelling(self, name: str) -> str:
        """A type's name as the domain writes it. Raises `UnknownSymbol`."""
        check_is_text("type", name)
        if not self.knows_type(name):
            known = ", ".join(self.types) or ROOT_TYPE
            raise UnknownSymbol(f"the domain {self.name} has no type {one_line(name)}; it has {known}")
        return self._type_spellings.get(key(name), ROOT_TYPE)

    @cached_property
    def _type_spellings(self) -> dict[str, str]:
        return {key(name): name for name in self.types}

    def supertypes(self, name: str) -> Iterator[str]:
        """The keys of a type and of all types above it, up to ``object``."""
        waiting, seen = [key(name)], set[str]()
        for type_key in waiting:
            if type_key not in seen:
                seen.add(type_key)
                yield type_key
                waiting.extend(self._parents.get(type_key, (ROOT_TYPE,)))

    def is_subtype(self, name: str, of: Iterable[str]) -> bool:
        """Return whether a type is one of the types `of`, or below one."""
        wanted = {key(type_name) for type_name in of}
        return ROOT_TYPE in wanted or any(type_key in wanted for type_key in self.supertypes(name))

    def subtypes(self, of: tuple[str, ...]) -> frozenset[str]:
        """The keys of the types `of` and of all types below them."""
        found = self._subtypes.get(of)
        if found is None:
            known = [*self._type_spellings, ROOT_TYPE]
            found = self._subtypes[of] = frozenset(name for name in known if self.is_subtype(name, of))
        return found

    @cached_property
    def _subtypes(self) -> dict[tuple[str, ...], frozenset[str]]:
        return {}


def type_keys(type_text: str) -> tuple[str, ...]:
    """The keys of the types that a type's text names: one, or those of an ``either``."""
    return tuple(map(key, type_text.strip("()").split()[1:])) if type_text[:1] == "(" else (key(type_text),)


def _find(symbols: Mapping[str, _Symbol], name: str, what: str, domain: str) -> _Symbol:
    check_is_text(what, name)
    found = symbols.get(key(name))
    if found is None:
        known = ", ".join(getattr(symbol, "name", "?") for symbol in symbols.values())
        raise UnknownSymbol(
            f"the domain {domain} has no {what} {one_line(name)}; " + (f"it has {known}" if known else "it has none")
        )
    return found
