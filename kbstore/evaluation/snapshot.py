"""A state in memory: an `Interpretation` that conditions are evaluated against."""

from collections import defaultdict
from collections.abc import Collection, Iterable, Mapping, Sequence
from functools import cached_property
from itertools import chain

from kbstore.evaluation.interpretation import Arguments, Number
from kbstore.messages import KnowledgeType
from kbstore.model.domain import ROOT_TYPE, Domain
from kbstore.model.timelines import Role, StateRow, atom_key
from kbstore.names import key

Parts = Mapping[KnowledgeType, Sequence[StateRow]]
"""Assertions by knowledge type."""


def by_kind(rows: Iterable[StateRow]) -> Parts:
    """Return assertions by knowledge type."""
    found: dict[KnowledgeType, list[StateRow]] = {kind: [] for kind in KnowledgeType}
    for row in rows:
        found[row[0].kind].append(row)
    return found


class Snapshot:
    """The state at one time, from the assertions that hold; indexed when it is asked again."""

    def __init__(self, time: int, parts: Parts, domain: Domain | None, use_unknowns: bool) -> None:
        self.time = time
        self.parts = parts
        self.domain = domain
        self.use_unknowns = use_unknowns
        self._by_key: dict[KnowledgeType, dict[str, StateRow]] = {}
        self._searched: set[KnowledgeType] = set()
        self._of_types: dict[tuple[str, ...], Collection[str]] = {}

    @property
    def rows(self) -> list[StateRow]:
        """All assertions that hold."""
        return list(chain.from_iterable(self.parts.values()))

    def of(self, kind: KnowledgeType, role: Role = Role.STATE) -> list[StateRow]:
        """The rows of a knowledge type."""
        return [row for row in self.parts.get(kind, ()) if row[0].role is role]

    def row(self, kind: KnowledgeType, name: str) -> StateRow | None:
        """The assertion that holds on one timeline of the state."""
        by_key = self._by_key.get(kind)
        if by_key is not None:
            return by_key.get(name)
        if kind not in self._searched:
            # most states are asked one question: to look for its row takes a fifth of the time of an index
            self._searched.add(kind)
            for row in self.parts.get(kind, ()):
                if row[0].key == name and row[0].role is Role.STATE:
                    return row
            return None
        by_key = self._by_key[kind] = {row[0].key: row for row in self.of(kind)}
        return by_key.get(name)

    @cached_property
    def _signs(self) -> dict[str, dict[Arguments, bool]]:
        found: dict[str, dict[Arguments, bool]] = defaultdict(dict)
        for timeline, _, value in self.of(KnowledgeType.FACT):
            name, *arguments = timeline.keys
            found[name][tuple(arguments)] = not value[0]
        return found

    @cached_property
    def types(self) -> dict[str, str]:
        """The type of each object that exists, constants included; both as keys."""
        found = dict(self.domain.constant_types) if self.domain is not None else {}
        for timeline, _, value in self.of(KnowledgeType.INSTANCE):
            if not value[0]:
                found[timeline.key] = key(value[1])
        return found

    def sign(self, name: str, arguments: Arguments) -> bool | None:
        """True where the fact is asserted, False where it is explicitly false, None where neither is."""
        row = self.row(KnowledgeType.FACT, atom_key((name, *arguments)))
        return None if row is None else not row[2][0]

    def facts(self, name: str) -> Iterable[tuple[Arguments, bool]]:
        """The facts of a predicate, of both signs, each with its sign."""
        return self._signs.get(name, {}).items()

    def number(self, name: str, arguments: Arguments) -> Number | None:
        """The value of a numeric function, None where it is undefined."""
        row = self.row(KnowledgeType.FUNCTION, atom_key((name, *arguments)))
        return None if row is None else Number(row[2][1], row[2][3], row[1])

    def defined(self, name: str) -> Iterable[Arguments]:
        """The arguments for which a numeric function is defined."""
        rows = self.of(KnowledgeType.FUNCTION)
        return [timeline.keys[1:] for timeline, _, _ in rows if timeline.keys[0] == name]

    def objects(self, types: Iterable[str]) -> Collection[str]:
        """The objects that exist and are of one of the types or their subtypes, constants included."""
        wanted = tuple(types)
        found = self._of_types.get(wanted)
        if found is None:
            fits = {type_name: is_of(self.domain, type_name, wanted) for type_name in set(self.types.values())}
            found = self._of_types[wanted] = [name for name, type_name in self.types.items() if fits[type_name]]
        return found

    def type_of(self, name: str) -> str | None:
        """The type of an object or constant, None where it does not exist."""
        row = self.row(KnowledgeType.INSTANCE, name)
        if row is not None and not row[2][0]:
            return key(row[2][1])
        return None if self.domain is None else self.domain.constant_types.get(name)


def is_of(domain: Domain | None, type_name: str, wanted: Sequence[str]) -> bool:
    """Return whether a type is one of those wanted, or below one."""
    if domain is not None:
        return domain.is_subtype(type_name, wanted)
    names = {key(name) for name in wanted}
    return ROOT_TYPE in names or key(type_name) in names
