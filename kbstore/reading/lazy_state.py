"""The state at one stored instant, read only as far as a question asks."""

from collections.abc import Collection, Iterable
from itertools import takewhile
from typing import cast

from kbstore.clock import OPEN
from kbstore.evaluation.interpretation import Arguments, Number
from kbstore.evaluation.snapshot import Snapshot
from kbstore.messages import KnowledgeType
from kbstore.model.domain import Domain
from kbstore.model.timelines import Role, StateRow, Timeline, atom_key
from kbstore.names import key
from kbstore.storage.records import LogPosition
from kbstore.storage.repository import Repository

_FEW = 4
"""The most timelines without an assertion whose next starts are looked up; with more, any next start counts."""


class NotRead(Exception):
    """Raised when a question needs assertions that have not been read."""


Rows = dict[tuple[KnowledgeType, str], StateRow | None]
"""The assertions that hold on some timelines, by knowledge type and key; None where nothing holds."""


class PartialState:
    """An interpretation by some timelines only. Raises `NotRead` if a question needs others."""

    def __init__(self, rows: Rows, time: int, domain: Domain | None, *, use_unknowns: bool) -> None:
        self.time = time
        self.domain = domain
        self.use_unknowns = use_unknowns
        self._rows = rows

    def later(self, time: int) -> "PartialState":
        """Return the same state at a later time, at which the same assertions hold."""
        return PartialState(self._rows, time, self.domain, use_unknowns=self.use_unknowns)

    def row(self, kind: KnowledgeType, name: str) -> StateRow | None:
        """The assertion that holds on one timeline of the state."""
        if (kind, name) not in self._rows:
            self._rows[kind, name] = self._point(kind, name)
        return self._rows[kind, name]

    def _point(self, kind: KnowledgeType, name: str) -> StateRow | None:
        raise NotRead

    def sign(self, name: str, arguments: Arguments) -> bool | None:
        """True where the fact is asserted, False where it is explicitly false, None where neither is."""
        row = self.row(KnowledgeType.FACT, atom_key((name, *arguments)))
        return None if row is None else not row[2][0]

    def number(self, name: str, arguments: Arguments) -> Number | None:
        """The value of a numeric function, None where it is undefined."""
        row = self.row(KnowledgeType.FUNCTION, atom_key((name, *arguments)))
        return None if row is None else Number(row[2][1], row[2][3], row[1])

    def type_of(self, name: str) -> str | None:
        """The type of an object or constant, None where it does not exist."""
        constant = None if self.domain is None else self.domain.constant_types.get(name)
        if constant is not None:
            return constant
        row = self.row(KnowledgeType.INSTANCE, name)
        return None if row is None or row[2][0] else key(row[2][1])

    def facts(self, name: str) -> Iterable[tuple[Arguments, bool]]:
        """The facts of a predicate, of both signs, each with its sign."""
        raise NotRead

    def defined(self, name: str) -> Iterable[Arguments]:
        """The arguments for which a numeric function is defined."""
        raise NotRead

    def objects(self, types: Iterable[str]) -> Collection[str]:
        """The objects that exist and are of one of the types or their subtypes, constants included."""
        raise NotRead


class LazyState(PartialState):
    """An interpretation that reads on demand from a repository: a timeline, a pattern's matches, or a predicate."""

    def __init__(self, repository: Repository, time: int, domain: Domain | None, *, use_unknowns: bool) -> None:
        super().__init__({}, time, domain, use_unknowns=use_unknowns)
        self._repository = repository
        self._objects: Snapshot | None = None
        self._ends = OPEN
        self._absent: list[Timeline] = []
        self._has_ranges = False

    @property
    def is_moving(self) -> bool:
        """Whether a number that moves has been read."""
        read = self._rows.items()
        return any(row is not None and row[2][3] for (kind, _), row in read if kind is KnowledgeType.FUNCTION)

    @property
    def partial_state(self) -> PartialState | None:
        """The timelines read so far; None if more than single timelines were read."""
        return None if self._has_ranges else self.later(self.time)

    @property
    def until(self) -> int:
        """The time, in nanoseconds, at which the clock may change what has been read, apart from moving numbers."""
        if self._has_ranges or len(self._absent) > _FEW:
            return min(self._ends, self._repository.next_due(self.time))
        return min(self._ends, *(self._repository.next_start(line, self.time) for line in self._absent), OPEN)

    def facts(self, name: str) -> Iterable[tuple[Arguments, bool]]:
        """The facts of a predicate, of both signs, each with its sign."""
        return self._facts(self._repository.holding(Role.STATE, KnowledgeType.FACT, self.time, name))

    def defined(self, name: str) -> Iterable[Arguments]:
        """The arguments for which a numeric function is defined."""
        self._has_ranges = True
        rows = self._repository.holding(Role.STATE, KnowledgeType.FUNCTION, self.time, name)
        return [timeline.keys[1:] for timeline, _, _ in rows]

    def matching(self, name: str, wanted: tuple[str | None, ...]) -> Iterable[tuple[Arguments, bool]]:
        """The facts of a predicate that have the given arguments, at least one of them, each with its sign."""
        if None not in wanted:
            sign = self.sign(name, cast("Arguments", wanted))
            return [] if sign is None else [(cast("Arguments", wanted), sign)]
        bound = tuple(takewhile(lambda value: value is not None, wanted))
        if bound:
            # bound arguments at the front are a prefix of the timelines' keys, which an index finds
            words = atom_key((name, *cast("Arguments", bound)))
            rows = self._repository.holding(Role.STATE, KnowledgeType.FACT, self.time, words)
        else:
            about = next(value for value in wanted if value is not None)
            line = self._repository.find(Role.STATE, KnowledgeType.INSTANCE, [about]).get(about)
            if line is None:
                return []
            rows = self._repository.holding(Role.STATE, KnowledgeType.FACT, self.time, name, mentioning=line)
        return [
            (arguments, sign)
            for arguments, sign in self._facts(rows)
            if len(arguments) == len(wanted)
            and all(value is None or value == found for value, found in zip(wanted, arguments, strict=True))
        ]

    def _facts(self, rows: Iterable[StateRow]) -> list[tuple[Arguments, bool]]:
        self._has_ranges = True
        found = []
        for row in rows:
            self._rows[KnowledgeType.FACT, row[0].key] = row
            found.append((row[0].keys[1:], not row[2][0]))
        return found

    def objects(self, types: Iterable[str]) -> Collection[str]:
        """The objects that exist and are of one of the types or their subtypes, constants included."""
        if self._objects is None:
            rows = self._repository.state_at(KnowledgeType.INSTANCE, LogPosition(self.time))
            parts = {KnowledgeType.INSTANCE: rows}
            self._objects = Snapshot(self.time, parts, self.domain, self.use_unknowns)
            self._has_ranges = True
        return self._objects.objects(types)

    def _point(self, kind: KnowledgeType, name: str) -> StateRow | None:
        if kind is KnowledgeType.INSTANCE and self._objects is not None:
            return self._objects.row(kind, name)
        timeline = self._repository.find(Role.STATE, kind, [name]).get(name)
        if timeline is None:
            return None
        found = self._repository.value_at(kind, timeline, self.time)
        assert found is not None, "a snapshot does not go back"
        end_time, initial_time, *value = found[5:]
        if end_time is None or end_time <= self.time:
            self._absent.append(timeline)
            return None
        self._ends = min(self._ends, end_time)
        return timeline, initial_time, tuple(value)
