"""Derived predicates at one time: the stratified least fixpoint of their rules (rule V9).

Two fixpoints are computed for each stratum: what can be derived for certain, and what can be derived where unknown is
read as true. Between them lies the unknown. They are reached semi-naively (F. Bancilhon, 1986): each round joins what
is new with what was there; or, where fewer rows are missing than are new, it tests the missing ones.
"""

from collections.abc import Callable, Collection, Iterator, Mapping
from itertools import product
from math import prod

from kbstore.evaluation.interpretation import Interpretation
from kbstore.evaluation.joins import Guard, Relation, assignments, guards, is_variable
from kbstore.evaluation.rules import Clause, program
from kbstore.evaluation.substitution import ArgumentPattern, Bindings, pattern
from kbstore.messages.enums import Truth
from kbstore.model.formulas import Atom, Formula, Types
from kbstore.names import is_wildcard, key


class Derived:
    """The derived predicates of a world, each computed when it is first asked for.

    Args:
        world: the world, which has a domain.
        evaluate: returns the truth of a condition in it, and calls back for derived predicates.
        asserted: returns the rows that are asserted of a predicate that is not derived.
        objects: returns the objects of some types, in a collection with a fast ``in``.
    """

    def __init__(
        self,
        world: Interpretation,
        evaluate: Callable[[Formula, Bindings], Truth],
        asserted: Callable[[str], Relation],
        objects: Callable[[Types], Collection[str]],
    ) -> None:
        if world.domain is None:
            raise ValueError("only a domain has derived predicates")
        self._world = world
        self._program = program(world.domain)
        self._evaluate = evaluate
        self._asserted = asserted
        self._objects = objects
        self._known: dict[str, tuple[Relation, Relation]] = {}
        self._running: dict[str, Relation] = {}

    def truth(self, name: str, wanted: ArgumentPattern) -> Truth:
        """Return the truth of a derived atom; it is absent if one of its objects does not exist (rule V8)."""
        certain, possible = self.relations(name)
        if any(True for _ in certain.matching(wanted)):
            return Truth.TRUE
        if any(True for _ in possible.matching(wanted)):
            return Truth.UNKNOWN
        if self._world.use_unknowns and not self.exist(wanted) and self._matches_some(name, wanted):
            return Truth.UNKNOWN
        return Truth.FALSE

    def relations(self, name: str) -> tuple[Relation, Relation]:
        """Return the rows for which a derived predicate is true, and those for which it is not false."""
        if name in self._running:
            return self._running[name], self._running[name]
        if name not in self._known:
            for stratum in self._program.needed(name):
                if not self._known.keys() >= stratum:
                    self._derive(stratum)
        return self._known[name]

    def exist(self, wanted: ArgumentPattern) -> bool:
        """Return whether the objects that a pattern names exist."""
        return all(self._world.type_of(name) is not None for name in wanted if name is not None)

    def _matches_some(self, name: str, wanted: ArgumentPattern) -> bool:
        """Return whether there are objects for all wildcards of a pattern."""
        ranges = self._program.ranges[name]
        return all(self._objects(types) for types, value in zip(ranges, wanted, strict=True) if value is None)

    def _derive(self, stratum: frozenset[str]) -> None:
        certain = self._fixpoint(stratum, certainly=True)
        below = frozenset[str]().union(*(self._program.dependencies[name] for name in stratum)) - stratum
        two_valued = not (self._world.use_unknowns or stratum & self._program.numeric) and all(
            self._known[name][0] is self._known[name][1] for name in below
        )
        possible = certain if two_valued else self._fixpoint(stratum, certainly=False)
        self._known |= {name: (certain[name], possible[name]) for name in stratum}

    def _fixpoint(self, stratum: frozenset[str], *, certainly: bool) -> Mapping[str, Relation]:
        """The least fixpoint of a stratum; unknown atoms count as false if `certainly`, else as true."""
        current = {name: Relation() for name in stratum}
        full = {name: prod(len(self._objects(types)) for types in self._program.ranges[name]) for name in stratum}
        recursive = any(self._program.dependencies[name] & stratum for name in stratum)
        # in an open world nearly every row may be true, and testing each is the fastest first round
        one_by_one = self._world.use_unknowns and not certainly
        self._running = current
        try:
            new: dict[str, Relation] | None = None
            while True:
                if new is not None:
                    missing = sum(full[name] - len(current[name]) for name in stratum)
                    one_by_one = missing <= sum(map(len, new.values()))
                if not one_by_one:
                    new = self._joined(stratum, new, certainly)
                    for name, relation in new.items():
                        for row in relation:
                            current[name].add(row)
                else:
                    new = self._tested(stratum, certainly)
                if not recursive or not any(map(len, new.values())):
                    return current
        finally:
            self._running = {}

    def _joined(
        self, stratum: frozenset[str], news: Mapping[str, Relation] | None, certainly: bool
    ) -> dict[str, Relation]:
        """Return the rows that follow from the news of the last round, or, in the first round, from everything."""
        found = {name: Relation() for name in stratum}
        for name in stratum:
            for rule in self._program.rules[name]:
                for clause in rule.clauses:
                    for guarded, tests in self._joins(clause, news, certainly):
                        for bindings in assignments(clause.variables, guarded, {}, self._objects):
                            row = tuple([bindings[variable] for variable in clause.head])
                            if row in self._running[name] or row in found[name]:
                                continue
                            if all(self._accepts(test, bindings, certainly) for test in tests):
                                found[name].add(row)
        return found

    def _joins(
        self, clause: Clause, news: Mapping[str, Relation] | None, certainly: bool
    ) -> Iterator[tuple[list[Guard], list[Formula]]]:
        """Yield the joins of a clause, each with the conditions that remain to be tested.

        With news there is one join for each atom that reads them; if any other condition reads them, everything is
        joined again.
        """
        readers: list[int | None] = [None]
        if news is not None:
            readers = [i for i, names in enumerate(clause.reads) if not names.isdisjoint(news)]
            if any(not isinstance(clause.conjuncts[i], Atom) for i in readers if i is not None):
                readers = [None]
        for reader in readers:
            guarded: list[Guard] = []
            tests: list[Formula] = []
            for i, conjunct in enumerate(clause.conjuncts):
                for atom in guards(conjunct):
                    rows = self._rows(atom, certainly)
                    if rows is not None:
                        guarded.append((atom, rows if i != reader or news is None else news[key(atom.name)]))
                        if atom is conjunct and not any(_is_loose(a, clause) for a in atom.arguments):
                            break  # its row is found by the join, and nothing remains to be tested
                else:
                    tests.append(conjunct)
            yield guarded, tests

    def _rows(self, atom: Atom, certainly: bool) -> Relation | None:
        """Return the rows without which an atom is not accepted; None if they cannot be listed."""
        is_derived, closed = key(atom.name) in self._program.rules, certainly or not self._world.use_unknowns
        if is_derived and (closed or self.exist(pattern(atom, {}))):
            return self.relations(key(atom.name))[0 if certainly else 1]
        return self._asserted(key(atom.name)) if closed and not is_derived else None

    def _tested(self, stratum: frozenset[str], certainly: bool) -> dict[str, Relation]:
        """Return the missing rows that follow; each is tested by itself, and added at once."""
        found = {name: Relation() for name in stratum}
        for name in stratum:
            for row in product(*(self._objects(types) for types in self._program.ranges[name])):
                if row in self._running[name]:
                    continue
                for rule in self._program.rules[name]:
                    bindings = rule.bindings(row)
                    if bindings is not None and self._accepts(rule.condition, bindings, certainly):
                        self._running[name].add(row)
                        found[name].add(row)
                        break
        return found

    def _accepts(self, condition: Formula, bindings: Bindings, certainly: bool) -> bool:
        truth = self._evaluate(condition, bindings)
        return truth is Truth.TRUE or (truth is Truth.UNKNOWN and not certainly)


def _is_loose(argument: str, clause: Clause) -> bool:
    """Return whether an argument of a clause matches any object."""
    return is_wildcard(argument) and not is_variable(argument, clause.variables)
