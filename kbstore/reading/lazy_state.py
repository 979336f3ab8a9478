"""What stands at one stored moment, read from the store only as far as a question asks."""

from collections.abc import Collection, Iterable

from kbstore.evaluation.interpretation import Arguments, Number
from kbstore.evaluation.snapshot import Snapshot, StateRow
from kbstore.messages import KnowledgeType
from kbstore.model.domain import Domain
from kbstore.model.timelines import Role, atom_key
from kbstore.names import key
from kbstore.storage.repository import LogPosition, Repository


class LazyState:
    """An interpretation on an open repository: single things by their timelines, ranges as a whole when first asked."""

    def __init__(self, repository: Repository, time: int, domain: Domain | None, *, use_unknowns: bool) -> None:
        self.time = time
        self.domain = domain
        self.use_unknowns = use_unknowns
        self._repository = repository
        self._ranges: dict[KnowledgeType, Snapshot] = {}
        self._points: dict[tuple[KnowledgeType, str], StateRow | None] = {}

    def sign(self, name: str, arguments: Arguments) -> bool | None:
        """True where the fact is asserted, False where it is explicitly false, None where nothing is said."""
        row = self._row(KnowledgeType.FACT, atom_key((name, *arguments)))
        return None if row is None else not row[2][0]

    def facts(self, name: str) -> Iterable[tuple[Arguments, bool]]:
        """All facts of a predicate that are said, each with its sign."""
        return self._range(KnowledgeType.FACT).facts(name)

    def number(self, name: str, arguments: Arguments) -> Number | None:
        """The value of a numeric function, None where it is undefined."""
        row = self._row(KnowledgeType.FUNCTION, atom_key((name, *arguments)))
        return None if row is None else Number(row[2][1], row[2][3], row[1])

    def objects(self, types: Iterable[str]) -> Collection[str]:
        """The objects that exist and are of one of the types or their subtypes, constants included."""
        return self._range(KnowledgeType.INSTANCE).objects(types)

    def type_of(self, name: str) -> str | None:
        """The type of an object or constant, None where it does not exist."""
        constant = None if self.domain is None else self.domain.constant_types.get(name)
        if constant is not None:
            return constant
        row = self._row(KnowledgeType.INSTANCE, name)
        return None if row is None or row[2][0] else key(row[2][1])

    def _row(self, kind: KnowledgeType, name: str) -> StateRow | None:
        range_read = self._ranges.get(kind)
        if range_read is not None:
            return range_read.row(kind, name)
        if (kind, name) not in self._points:
            timeline = self._repository.find(Role.STATE, kind, [name]).get(name)
            self._points[kind, name] = None if timeline is None else self._repository.value_at(timeline, self.time)
        return self._points[kind, name]

    def _range(self, kind: KnowledgeType) -> Snapshot:
        found = self._ranges.get(kind)
        if found is None:
            rows = self._repository.state_at(kind, LogPosition(self.time))
            found = self._ranges[kind] = Snapshot(self.time, rows, self.domain, self.use_unknowns)
        return found
