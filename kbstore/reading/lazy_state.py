"""The state at one stored instant, read only as far as a question asks."""

from collections.abc import Collection, Iterable

from kbstore.clock import OPEN
from kbstore.evaluation.interpretation import Arguments, Number
from kbstore.evaluation.snapshot import Snapshot, StateRow
from kbstore.messages import KnowledgeType
from kbstore.model.domain import Domain
from kbstore.model.timelines import Role, atom_key
from kbstore.names import key
from kbstore.storage.records import LogPosition
from kbstore.storage.repository import Repository


class LazyState:
    """An interpretation on an open repository: single timelines by point queries, ranges as a whole when first asked.

    Attributes:
        until: The time at which the clock may change what has been read; `time` itself where that is not known.
    """

    def __init__(self, repository: Repository, time: int, domain: Domain | None, *, use_unknowns: bool) -> None:
        self.time = time
        self.domain = domain
        self.use_unknowns = use_unknowns
        self.until = OPEN
        self._repository = repository
        self._ranges: dict[KnowledgeType, Snapshot] = {}
        self._rows: dict[tuple[KnowledgeType, str], StateRow | None] = {}

    def sign(self, name: str, arguments: Arguments) -> bool | None:
        """True where the fact is asserted, False where it is explicitly false, None where nothing is said."""
        row = self.row(KnowledgeType.FACT, atom_key((name, *arguments)))
        return None if row is None else not row[2][0]

    def facts(self, name: str) -> Iterable[tuple[Arguments, bool]]:
        """All facts of a predicate that are said, each with its sign."""
        return self._range(KnowledgeType.FACT).facts(name)

    def number(self, name: str, arguments: Arguments) -> Number | None:
        """The value of a numeric function, None where it is undefined."""
        row = self.row(KnowledgeType.FUNCTION, atom_key((name, *arguments)))
        if row is None:
            return None
        if row[2][3]:
            # it moves
            self.until = self.time
        return Number(row[2][1], row[2][3], row[1])

    def objects(self, types: Iterable[str]) -> Collection[str]:
        """The objects that exist and are of one of the types or their subtypes, constants included."""
        return self._range(KnowledgeType.INSTANCE).objects(types)

    def type_of(self, name: str) -> str | None:
        """The type of an object or constant, None where it does not exist."""
        constant = None if self.domain is None else self.domain.constant_types.get(name)
        if constant is not None:
            return constant
        row = self.row(KnowledgeType.INSTANCE, name)
        return None if row is None or row[2][0] else key(row[2][1])

    def row(self, kind: KnowledgeType, name: str) -> StateRow | None:
        """The assertion that holds on one timeline of the state."""
        range_read = self._ranges.get(kind)
        if range_read is not None:
            return range_read.row(kind, name)
        if (kind, name) not in self._rows:
            self._rows[kind, name] = self._point(kind, name)
        return self._rows[kind, name]

    def _point(self, kind: KnowledgeType, name: str) -> StateRow | None:
        timeline = self._repository.find(Role.STATE, kind, [name]).get(name)
        if timeline is None:
            return None
        found = self._repository.value_at(kind, timeline, self.time)
        if found.value is None:
            self.until = min(self.until, self._repository.next_start(timeline, self.time))
            return None
        self.until = min(self.until, found.end_time)
        return timeline, found.initial_time, found.value

    def _range(self, kind: KnowledgeType) -> Snapshot:
        found = self._ranges.get(kind)
        if found is None:
            rows = self._repository.state_at(kind, LogPosition(self.time))
            found = self._ranges[kind] = Snapshot(self.time, rows, self.domain, self.use_unknowns)
            self.until = self.time
        return found
