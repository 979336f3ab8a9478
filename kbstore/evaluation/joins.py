"""Joins over facts, which find the objects that are worth trying for the variables of a quantifier or a rule.

A quantified formula is evaluated by trying objects for its variables. Trying all of many takes too long, but an atom
that must not be false for the formula to matter (a *guard*) narrows them down to its rows.
"""

from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from sys import maxsize

from kbstore.evaluation.interpretation import Arguments, IndexedInterpretation
from kbstore.evaluation.substitution import ArgumentPattern, Bindings, pattern
from kbstore.model.formulas import (
    And,
    Atom,
    Exists,
    Forall,
    Formula,
    Imply,
    Not,
    Or,
    Preference,
    Types,
    Variables,
)
from kbstore.names import is_wildcard, key


class Relation:
    """A growing set of rows of arguments, in order of arrival, found by the values at any of their positions."""

    def __init__(self, rows: Iterable[Arguments] = ()) -> None:
        self._rows = dict.fromkeys(rows)
        self._indexes: dict[tuple[int, ...], dict[Arguments, list[Arguments]]] = {}

    @property
    def cost(self) -> int:
        """The number of rows to read for all of it, as far as that is known."""
        return len(self)

    def __contains__(self, row: Arguments) -> bool:
        return row in self._rows

    def __iter__(self) -> Iterator[Arguments]:
        return iter(self._rows)

    def __len__(self) -> int:
        return len(self._rows)

    def add(self, row: Arguments) -> None:
        """Add a row, which must be new."""
        self._rows[row] = None
        for positions, index in self._indexes.items():
            if positions[-1] < len(row):
                index.setdefault(tuple([row[i] for i in positions]), []).append(row)

    def matching(self, wanted: ArgumentPattern) -> Iterator[Arguments]:
        """The rows that have the values of the pattern, where it has any."""
        positions = tuple([i for i, value in enumerate(wanted) if value is not None])
        if len(positions) == len(wanted):
            found: Iterable[Arguments] = [wanted] if wanted in self._rows else ()  # type: ignore[list-item]
        elif positions:
            found = self._index(positions).get(tuple([wanted[i] for i in positions]), ())  # type: ignore[misc]
        else:
            found = self._rows
        return (row for row in found if len(row) == len(wanted))

    def _index(self, positions: tuple[int, ...]) -> dict[Arguments, list[Arguments]]:
        index = self._indexes.get(positions)
        if index is None:
            index = {}
            for row in self._rows:
                if positions[-1] < len(row):
                    index.setdefault(tuple([row[i] for i in positions]), []).append(row)
            self._indexes[positions] = index
        return index


_READ_ALL = 16
"""After so many look-ups the whole predicate is read, as each look-up costs as much as reading some rows."""


class IndexedRelation(Relation):
    """The rows of a predicate with one sign, in a world that finds them by an object; only those asked for are read.

    Args:
        world: the world, which has `matching`.
        name: the predicate's key.
        sign: the sign of the rows.
    """

    def __init__(self, world: IndexedInterpretation, name: str, sign: bool) -> None:
        super().__init__()
        self._world = world
        self._name = name
        self._sign = sign
        self._found: dict[ArgumentPattern, list[Arguments]] = {}
        self._is_read = False

    def __contains__(self, row: Arguments) -> bool:
        return any(True for _ in self.matching(row))

    def __iter__(self) -> Iterator[Arguments]:
        self._read()
        return super().__iter__()

    def __len__(self) -> int:
        self._read()
        return super().__len__()

    @property
    def cost(self) -> int:
        """The number of rows; as large as can be while they have not been read."""
        return len(self._rows) if self._is_read else maxsize

    def matching(self, wanted: ArgumentPattern) -> Iterator[Arguments]:
        """The rows that have the values of the pattern, where it has any."""
        if not self._is_read and any(value is not None for value in wanted):
            found = self._found.get(wanted)
            if found is None and len(self._found) < _READ_ALL:
                found = self._found[wanted] = [
                    row for row, sign in self._world.matching(self._name, wanted) if sign is self._sign
                ]
            if found is not None:
                return iter(found)
        self._read()
        return super().matching(wanted)

    def _read(self) -> None:
        if not self._is_read:
            self._rows = dict.fromkeys(row for row, sign in self._world.facts(self._name) if sign is self._sign)
            self._is_read = True


class ObjectsOfTypes(Collection[str]):
    """The objects of some types in such a world; ``in`` looks a single one up as long as not all have been read."""

    def __init__(self, world: IndexedInterpretation, types: Types) -> None:
        self._world = world
        self._types = types
        self._looked_up = 0
        self._all: dict[str, None] | None = None

    def __contains__(self, name: object) -> bool:
        domain = self._world.domain
        if self._all is None and domain is not None and isinstance(name, str) and self._looked_up < _READ_ALL:
            self._looked_up += 1
            type_name = self._world.type_of(name)
            return type_name is not None and domain.is_subtype(type_name, self._types)
        return name in self._read()

    def __iter__(self) -> Iterator[str]:
        return iter(self._read())

    def __len__(self) -> int:
        return len(self._read())

    def _read(self) -> dict[str, None]:
        if self._all is None:
            self._all = dict.fromkeys(self._world.objects(self._types))
        return self._all


Guard = tuple[Atom, Relation]
"""An atom, and the rows outside of which it is false."""


def guards(condition: Formula, positive: bool = True) -> Iterator[Atom]:
    """Yield the atoms that are not false wherever the condition is not false (or, if not `positive`, not true).

    Variables that the condition itself quantifies are replaced by wildcards.
    """
    match condition:
        case Atom() if positive:
            yield condition
        case Not(part):
            yield from guards(part, not positive)
        case And(parts) if positive:
            for part in parts:
                yield from guards(part, positive)
        case Or(parts) if not positive:
            for part in parts:
                yield from guards(part, positive)
        case Imply(premise, conclusion) if not positive:
            yield from guards(premise, True)
            yield from guards(conclusion, False)
        case Preference(_, part):
            yield from guards(part, positive)
        case Exists(parameters, part) | Forall(parameters, part) if isinstance(condition, Exists) is positive:
            own = {key(p.name) for p in parameters}
            for atom in guards(part, positive):
                yield Atom(atom.name, tuple(["?" if is_variable(a, own) else a for a in atom.arguments]))


def is_variable(argument: str, variables: Collection[str]) -> bool:
    """Return whether an argument is one of the variables."""
    return is_wildcard(argument) and key(argument[1:]) in variables


def assignments(
    variables: Variables,
    guarded: Iterable[Guard],
    bindings: Bindings,
    objects: Callable[[Types], Collection[str]],
) -> Iterator[dict[str, str]]:
    """Yield the bindings with an object for each of the variables for which every guard has its row.

    Each variable gets objects of its types only; `objects` returns these in a collection that should have a fast
    ``in``. Variables that are bound already are bound anew.
    """
    outer = {variable: name for variable, name in bindings.items() if variable not in variables}
    steps = _plan(variables, list(guarded), set(outer), objects)
    if not steps:
        yield outer
        return
    # a stack of our own: there may be more variables than Python has frames
    open_steps = [steps[0](outer)]
    while open_steps:
        found = next(open_steps[-1], None)
        if found is None:
            open_steps.pop()
        elif len(open_steps) == len(steps):
            yield found
        else:
            open_steps.append(steps[len(open_steps)](found))


_Step = Callable[[dict[str, str]], Iterator[dict[str, str]]]


def _plan(
    variables: Variables, guarded: list[Guard], bound: set[str], objects: Callable[[Types], Collection[str]]
) -> list[_Step]:
    """Order the guards for reading: first those with bound variables alone, then those with the fewest rows."""

    def rank(guard: Guard) -> tuple[int, bool, int]:
        terms = [a for a in guard[0].arguments if not is_wildcard(a) or key(a[1:]) in bound]
        free = any(is_variable(a, unbound) for a in guard[0].arguments)
        return free, not terms, guard[1].cost

    steps: list[_Step] = []
    unbound = dict(variables)
    while unbound or guarded:
        if guarded:
            best = min(guarded, key=rank)
            guarded.remove(best)
            found = [key(a[1:]) for a in best[0].arguments if is_variable(a, unbound)]
            fresh = {variable: objects(unbound[variable]) for variable in found}
            steps.append(_by_rows(*best, fresh))
        else:
            variable = next(iter(unbound))
            fresh = {variable: objects(unbound[variable])}
            steps.append(_by_objects(variable, fresh[variable]))
        for variable in fresh:
            del unbound[variable]
            bound.add(variable)
    return steps


def _by_rows(atom: Atom, relation: Relation, fresh: Mapping[str, Collection[str]]) -> _Step:
    """Return the step that binds the fresh variables of an atom from its rows, to the objects that each may have."""
    places = [(i, key(a[1:])) for i, a in enumerate(atom.arguments) if is_variable(a, fresh)]

    def step(bindings: dict[str, str]) -> Iterator[dict[str, str]]:
        rows = relation.matching(pattern(atom, bindings))
        if not places:
            if next(rows, None) is not None:
                yield bindings
            return
        for row in rows:
            found = dict(bindings)
            for place, variable in places:
                value = row[place]
                if value not in fresh[variable] or found.setdefault(variable, value) != value:
                    break
            else:
                yield found

    return step


def _by_objects(variable: str, names: Collection[str]) -> _Step:
    def step(bindings: dict[str, str]) -> Iterator[dict[str, str]]:
        return ({**bindings, variable: name} for name in names)

    return step
