"""Reading a knowledge base: which moment a question means, and what stood at it."""

import json
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import NamedTuple

from kbstore.clock import Clock, isoformat, time
from kbstore.errors import HistoryUnavailable
from kbstore.evaluation.snapshot import Snapshot, StateRow
from kbstore.messages import KnowledgeType
from kbstore.model.domain import Domain
from kbstore.model.results import Explanation, Run, Transaction
from kbstore.model.symbols import InferredSignature, SymbolTable
from kbstore.pddl.domain_reader import read_domain
from kbstore.planning.simulator import RunningAction, Simulator
from kbstore.reading.lazy_state import LazyState
from kbstore.reading.mentions import mentions
from kbstore.reading.questions import Question
from kbstore.reading.state import State
from kbstore.reading.state_cache import StateCache, StateData, TemporalPoint
from kbstore.storage.database import Database
from kbstore.storage.repository import Head, LogPosition, Repository, RunRow, TimelineCache


class DomainVersion(NamedTuple):
    """A version of the domain, and since when it counts."""

    version: int
    time: int
    transaction: int
    domain: Domain


class Reader:
    """Reads one knowledge base. Holds what never changes: timelines, versions of the domain."""

    def __init__(
        self,
        database: Database,
        kb: int,
        name: str,
        *,
        use_unknowns: bool,
        clock: Clock,
        explainer: Callable[[State, Question], Explanation],
        caching: bool = True,
        is_archive: bool = False,
    ) -> None:
        self.database = database
        self.is_archive = is_archive
        self.kb = kb
        self.name = name
        self.use_unknowns = use_unknowns
        self.clock = clock
        self.cache = TimelineCache()
        self._explainer = explainer
        self._album = StateCache() if caching else None
        self._versions: list[DomainVersion] = []
        self._loading = threading.Lock()

    @contextmanager
    def repository(self) -> Iterator[Repository]:
        """The knowledge base on one snapshot of the store."""
        with self.database.read() as session:
            yield Repository(session, self.kb, self.cache)

    # -- moments ----------------------------------------------------------------------------------------------

    def now(self, head: Head) -> int:
        """Now in questions: a caller always sees what it wrote (rule T3)."""
        return max(time(self.clock.now()), head.time)

    def place(self, repository: Repository, at: object = None, as_of: object = None) -> TemporalPoint:
        """The moment that a question means. Raises `HistoryUnavailable` for one that has been archived away."""
        head = repository.head()
        now = self.now(head)
        t = now if at is None else time(at)
        if as_of is None:
            belief = LogPosition(now)
        elif isinstance(as_of, Transaction):
            belief = repository.after_transaction(as_of.number, as_of.time)
        else:
            belief = LogPosition(min(time(as_of), now))
        for asked in (t, belief.time):
            self.refuse_archived(asked, head)
        return TemporalPoint(t, belief, head, as_of is not None and belief.time <= t)

    def refuse_archived(self, t: int, head: Head) -> None:
        """Raise `HistoryUnavailable` for a time before which history has been archived away (rule Q7).

        In an archive, also for a time after its end.
        """
        if self.is_archive and t > head.time:
            raise HistoryUnavailable(
                f"this archive of {self.name} ends at {isoformat(head.time + 1)}, and {isoformat(t)} cannot be "
                "answered here: ask the store that it was taken from, or a later archive"
            )
        if t < head.history_from:
            raise self.archived(isoformat(t), head)

    def archived(self, asked: str, head: Head) -> HistoryUnavailable:
        """The refusal of a question that needs what has been archived away."""
        return HistoryUnavailable(
            f"{self.name} keeps its history from {isoformat(head.history_from)} on; what was before has been "
            f"archived, and {asked} cannot be answered here: ask the archive"
        )

    # -- domains ----------------------------------------------------------------------------------------------

    def versions(self, repository: Repository, head: Head) -> list[DomainVersion]:
        """All versions of the domain, in order."""
        if len(self._versions) < head.domain_version:
            with self._loading:
                known = list(self._versions)
                for version, since, number, source, sensed in repository.domain_versions(len(known)):
                    domain = read_domain(source).marked(json.loads(sensed))
                    known.append(DomainVersion(version, since, number, domain))
                self._versions = known
        return self._versions[: head.domain_version]

    @property
    def latest_version_time(self) -> int:
        """Since when the latest version of the domain that was read counts; 0 if there is none."""
        return self._versions[-1].time if self._versions else 0

    def symbol_table(self, repository: Repository, head: Head, at: LogPosition) -> SymbolTable:
        """The vocabulary at a place in the record."""
        found: Domain | None = None
        for version in self.versions(repository, head):
            if version.time <= at.time and (at.number is None or version.transaction <= at.number):
                found = version.domain
        if found is not None:
            return SymbolTable(found)
        return SymbolTable(None, self.shapes(repository))

    def shapes(self, repository: Repository) -> dict[tuple[KnowledgeType, str], InferredSignature]:
        """The shapes of symbols that a knowledge base without a domain keeps (rule D2)."""
        return {
            (KnowledgeType(kind), name_key): InferredSignature(name, arity, tuple(labels.split()) if labels else None)
            for kind, name_key, name, arity, labels in repository.symbols()
        }

    def world(self, repository: Repository, place: TemporalPoint) -> LazyState | None:
        """A moment as it is stored, to be read as far as needed; None where it must be reckoned."""
        t, belief = place.at, place.belief
        if place.is_past_belief or (belief.number is not None and t >= belief.time):
            return None
        if t > belief.time and self.running(repository, belief, place.head):
            return None
        symbol_table = self.symbol_table(repository, place.head, LogPosition(t))
        return LazyState(repository, t, symbol_table.domain, use_unknowns=self.use_unknowns)

    # -- pictures ---------------------------------------------------------------------------------------------

    def picture(self, repository: Repository, place: TemporalPoint, domain: Domain | None) -> StateData:
        """What stood (or is expected to stand) at a moment (rules Q1, Q2, O3)."""
        if self._album is None or not place.is_settled:
            return self._picture(repository, place, domain)
        picture = self._album.find(place.at)
        if picture is None:
            picture = self._picture(repository, place, domain)
            self._album.put(place.at, picture)
        return picture

    def _picture(self, repository: Repository, place: TemporalPoint, domain: Domain | None) -> StateData:
        t, belief = place.at, place.belief
        at = self._known(place)
        pending = _all_kinds(repository.scheduled_at, at)
        running = self.running(repository, at, place.head)
        if t > belief.time and (place.is_past_belief or running):
            projection = Simulator(
                belief.time,
                _all_kinds(repository.state_at, at),
                pending,
                running,
                domain=domain,
                use_unknowns=self.use_unknowns,
                mentions=mentions,
            )
            for _ in projection.advance(t):
                pass
            rows, running = projection.rows, projection.running
        else:
            # what was scheduled is stored with the interval that is expected of it
            rows = _all_kinds(repository.state_at, at if t <= belief.time else LogPosition(t))
        return StateData(Snapshot(t, rows, domain, self.use_unknowns), pending, running)

    @staticmethod
    def _known(place: TemporalPoint) -> LogPosition:
        """The place in the record up to which a question uses it."""
        t, belief = place.at, place.belief
        is_exact = belief.number is not None and t == belief.time
        return belief if is_exact or t > belief.time else LogPosition(t)

    def running(self, repository: Repository, at: LogPosition, head: Head) -> list[RunningAction]:
        """The durative actions that run at a place in the record."""
        if not head.last_run:
            return []
        return [as_running(row) for row in repository.running(at)]

    def state(self, repository: Repository, place: TemporalPoint, as_of: object = None) -> State:
        """The state at a moment."""
        symbol_table = self.symbol_table(repository, place.head, self._known(place))
        picture = self.picture(repository, place, symbol_table.domain)
        return self.state_of(picture, symbol_table, None if as_of is None else place.belief)

    def state_of(self, picture: StateData, symbol_table: SymbolTable, belief: LogPosition | None = None) -> State:
        """The state that a picture shows."""
        return State(
            picture,
            belief=belief,
            name=self.name,
            symbol_table=symbol_table,
            mentions=mentions,
            explainer=self._explainer,
        )


def as_running(row: RunRow) -> RunningAction:
    """A stored run, as the state knows it."""
    run = Run(row.operator, row.arguments, row.started, row.duration, row.number)
    return RunningAction(run, row.rates, row.remembered)


def _all_kinds(read: Callable[[KnowledgeType, LogPosition], Sequence[StateRow]], at: LogPosition) -> list[StateRow]:
    return [row for kind in KnowledgeType for row in read(kind, at)]
