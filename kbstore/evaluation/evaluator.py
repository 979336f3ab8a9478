"""Evaluates conditions at one time, in three-valued logic (rules V2 to V5, V7 to V9)."""

from collections.abc import Collection, Container, Iterator, Mapping
from itertools import product
from math import prod
from typing import cast

from kbstore.evaluation import comparisons
from kbstore.evaluation.derived import Derived
from kbstore.evaluation.interpretation import Arguments, IndexedInterpretation, Interpretation
from kbstore.evaluation.joins import Guard, IndexedRelation, ObjectsOfTypes, Relation, assignments, guards
from kbstore.evaluation.substitution import ArgumentPattern, Bindings, keyed, pattern, term
from kbstore.evaluation.wellformed import check
from kbstore.messages.enums import Truth
from kbstore.model.domain import Signature
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
    Types,
    variables_of,
)
from kbstore.names import key


class Evaluation:
    """Evaluates conditions in one world, and caches what it has read and derived.

    The world must not change meanwhile. `duration`, in seconds, is the value of ``?duration``.
    """

    def __init__(self, world: Interpretation, *, duration: float | None = None) -> None:
        self.world = world
        self.duration = duration
        self._absent = Truth.UNKNOWN if world.use_unknowns else Truth.FALSE
        self._asserted: dict[str, Relation] = {}
        self._denied: dict[str, Relation] = {}
        self._objects: dict[Types, Collection[str]] = {}
        self._indexed = cast("IndexedInterpretation", world) if hasattr(world, "matching") else None
        domain = world.domain
        self._derived_names: Container[str] = domain.rules if domain else ()
        self._derived: Derived | None = None

    def truth(self, condition: Formula, bindings: Mapping[str, str] = {}) -> Truth:
        """Return the truth of a condition, with objects for its free variables.

        Raises `UnknownSymbol` and `InvalidKnowledge` as `kbstore.evaluation.wellformed.check` does, and
        `InvalidKnowledge` for a comparison that would need numbers of absurd size.
        """
        check(condition, self.world.domain, bindings, duration=self.duration)
        return self.evaluate(condition, keyed(bindings))

    def evaluate(self, condition: Formula, bindings: Bindings) -> Truth:
        """Return the truth of a condition that has been checked; symbols unknown to the domain are absent (rule D4)."""
        match condition:
            case Atom():
                return self._atom(condition, bindings)
            case Not(part):
                return ~self.evaluate(part, bindings)
            case And(parts):
                return self._first(Truth.FALSE, parts, bindings)
            case Or(parts):
                return self._first(Truth.TRUE, parts, bindings)
            case Comparison():
                return comparisons.at_moment(condition, self.world, bindings, self.duration)
            case Exists():
                return self.instance(condition, bindings)[0]
            case Forall():
                return ~self.instance(condition, bindings)[0]
            case Imply(premise, conclusion):
                return self._first(Truth.TRUE, (Not(premise), conclusion), bindings)
            case Same(left, right):
                return Truth.of(term(left, bindings) == term(right, bindings))
            case Defined(function):
                return Truth.of(any(True for _ in self.defined(function, bindings)))
            case IsA(name, type_name):
                return self._is_a(term(name, bindings), (key(type_name or "object"),))
            case Preference(_, part):
                return self.evaluate(part, bindings)
            case Truism():
                return Truth.TRUE

    def instance(self, quantified: Exists | Forall, bindings: Bindings) -> tuple[Truth, Bindings]:
        """Return whether a quantifier has a decisive instance: a witness of `Exists`, a counterexample to `Forall`.

        If it is TRUE, the bindings are those of the first one.
        """
        variables, part = variables_of(quantified.parameters), quantified.part
        witness = isinstance(quantified, Exists)
        decisive = Truth.TRUE if witness else Truth.FALSE
        atoms = list(guards(part, witness))
        result = Truth.FALSE
        certain = [(atom, self._rows(key(atom.name))[0]) for atom in atoms]
        for found in assignments(variables, certain, bindings, self.objects):
            truth = self.evaluate(part, found)
            if truth is decisive:
                return Truth.TRUE, found
            if truth is Truth.UNKNOWN:
                result = Truth.UNKNOWN
        possible = [guard for atom in atoms for guard in self._possible(atom, bindings)]
        if result is Truth.UNKNOWN or [rows for _, rows in certain] == [rows for _, rows in possible]:
            return result, bindings
        for found in assignments(variables, possible, bindings, self.objects):
            if self.evaluate(part, found) is Truth.UNKNOWN:
                return Truth.UNKNOWN, bindings
        return Truth.FALSE, bindings

    def matches(self, atom: Atom, bindings: Bindings) -> Iterator[Arguments]:
        """The arguments with which an atom is true."""
        wanted = pattern(atom, bindings)
        if key(atom.name) in self._derived_names:
            return self.derived.relations(key(atom.name))[0].matching(wanted)
        return (row for row in self._signed(key(atom.name), True).matching(wanted) if self._fits(atom, wanted, row))

    def rows(self, atom: Atom) -> Relation:
        """The rows for which an atom's predicate is true."""
        return self._rows(key(atom.name))[0]

    def defined(self, function: Atom, bindings: Bindings) -> Iterator[Arguments]:
        """The arguments with which a function is defined."""
        name, wanted = key(function.name), pattern(function, bindings)
        domain = self.world.domain
        signature = domain.function_signatures.get(name) if domain else None
        ranges = [self.objects(types) for types in wild_types(wanted, signature)]
        for chosen in product(*ranges):
            filler = iter(chosen)
            arguments = tuple([next(filler) if value is None else value for value in wanted])
            if self.world.number(name, arguments) is not None:
                yield arguments

    def objects(self, types: Types) -> Collection[str]:
        """The objects that exist and are of one of the types."""
        found = self._objects.get(types)
        if found is None:
            if self._indexed is not None:
                found = ObjectsOfTypes(self._indexed, types)
            else:
                found = dict.fromkeys(self.world.objects(types)).keys()
            self._objects[types] = found
        return found

    @property
    def derived(self) -> Derived:
        """The derived predicates."""
        if self._derived is None:
            self._derived = Derived(self.world, self.evaluate, lambda name: self._signed(name, True), self.objects)
        return self._derived

    def _first(self, decisive: Truth, parts: tuple[Formula, ...], bindings: Bindings) -> Truth:
        """Return the truth of a disjunction, where TRUE is decisive, or of a conjunction, where FALSE is."""
        result = ~decisive
        for part in parts:
            truth = self.evaluate(part, bindings)
            if truth is decisive:
                return truth
            if truth is Truth.UNKNOWN:
                result = truth
        return result

    def _atom(self, atom: Atom, bindings: Bindings) -> Truth:
        name, wanted = key(atom.name), pattern(atom, bindings)
        if name in self._derived_names:
            return self.derived.truth(name, wanted)
        if None not in wanted:
            sign = self.world.sign(name, wanted)  # type: ignore[arg-type]
            return Truth.TRUE if sign else self._absent if sign is None else Truth.FALSE
        if any(True for _ in self.matches(atom, bindings)):
            return Truth.TRUE
        if not self.world.use_unknowns:
            return Truth.FALSE
        return Truth.FALSE if self._all_denied(atom, wanted) else Truth.UNKNOWN

    def _all_denied(self, atom: Atom, wanted: ArgumentPattern) -> bool:
        """Return whether a pattern is explicitly false for all objects that it matches.

        Without a domain it never is, as further objects may exist.
        """
        if self.world.domain is None:
            return False
        signature = self.world.domain.predicate_signatures.get(key(atom.name))
        combinations = prod(len(self.objects(types)) for types in wild_types(wanted, signature))
        denied = self._signed(key(atom.name), False).matching(wanted)
        return combinations == sum(self._fits(atom, wanted, row) for row in denied)

    def _fits(self, atom: Atom, wanted: ArgumentPattern, row: Arguments) -> bool:
        """Return whether the objects of a row for wildcards exist and are of the parameters' types."""
        domain = self.world.domain
        if domain is None:
            return True
        wild = [name for name, value in zip(row, wanted, strict=True) if value is None]
        types_of_wild = wild_types(wanted, domain.predicate_signatures.get(key(atom.name)))
        return all(self._is_a(name, types) is Truth.TRUE for name, types in zip(wild, types_of_wild, strict=True))

    def _is_a(self, name: str | None, types: Types) -> Truth:
        """Return whether an object, or some object, exists and is of one of the types."""
        if name is None:
            return Truth.of(bool(self.objects(types)))
        if self.world.domain is None and types != ("object",):
            return Truth.of(name in self.objects(types))
        type_name = self.world.type_of(name)
        return Truth.of(
            type_name is not None and (self.world.domain is None or self.world.domain.is_subtype(type_name, types))
        )

    def _signed(self, name: str, sign: bool) -> Relation:
        """Return the rows for which a predicate is asserted (`sign` True), or explicitly false."""
        known = self._asserted if sign else self._denied
        if name not in known:
            if self._indexed is not None:
                known[name] = IndexedRelation(self._indexed, name, sign)
            else:
                known[name] = Relation(row for row, its_sign in self.world.facts(name) if its_sign is sign)
        return known[name]

    def _rows(self, name: str) -> tuple[Relation, Relation | None]:
        """Return the rows for which a predicate is true, and those for which it is not false, if they can be listed."""
        if name in self._derived_names:
            return self.derived.relations(name)
        asserted = self._signed(name, True)
        return asserted, None if self.world.use_unknowns else asserted

    def _possible(self, atom: Atom, bindings: Bindings) -> Iterator[Guard]:
        rows = self._rows(key(atom.name))[1]
        if rows is None:
            return
        # in an open world a derived predicate is unknown for objects that do not exist, and has no row for them
        if not self.world.use_unknowns or self.derived.exist(pattern(atom, bindings)):
            yield atom, rows


def wild_types(wanted: ArgumentPattern, signature: Signature | None) -> list[Types]:
    """Return the types of the parameters for which a pattern has wildcards; ``object`` where none is declared."""
    declared = [tuple(map(key, p.types)) for p in signature.parameters] if signature else []
    declared += [("object",)] * (len(wanted) - len(declared))
    return [types for types, value in zip(declared, wanted, strict=False) if value is None]
