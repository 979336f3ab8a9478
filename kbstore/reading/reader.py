"""Reading a knowledge base: which moment a question means, and what stood at it."""

import json
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import NamedTuple

from kbstore.clock import Clock, isoformat, time
from kbstore.domain import Domain
from kbstore.errors import HistoryUnavailable
from kbstore.evaluation.snapshot import Row
from kbstore.messages import KnowledgeType
from kbstore.pddl.domain_reader import read_domain
from kbstore.planning.projection import Projection, Running
from kbstore.reading.lazy_world import LazyWorld
from kbstore.reading.mentions import mentions
from kbstore.reading.questions import Question
from kbstore.reading.state import State
from kbstore.record import Explanation, Run, Transaction
from kbstore.storage.engine import Database
from kbstore.storage.repository import Head, Moment, Repository, RunRow, TimelineCache
from kbstore.vocabulary import Shape, Vocabulary


class DomainVersion(NamedTuple):
    """A version of the domain, and since when it counts."""

    version: int
    time: int
    transaction: int
    domain: Domain


class Place(NamedTuple):
    """The moment that a question means: a time, and whose belief about it."""

    at: int
    belief: Moment
    head: Head
    is_past_belief: bool


@dataclass
class Picture:
    """What stood at a moment, was pending and ran, under which vocabulary."""

    place: Place
    rows: list[Row]
    pending: list[Row]
    running: list[Running]
    vocabulary: Vocabulary


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
        self._versions: list[DomainVersion] = []
        self._loading = threading.Lock()

    @contextmanager
    def repository(self) -> Iterator[Repository]:
        """The knowledge base on one snapshot of the store."""
        with self.database.reading() as session:
            yield Repository(session, self.kb, self.cache)

    # -- moments ----------------------------------------------------------------------------------------------

    def now(self, head: Head) -> int:
        """Now in questions: a caller always sees what it wrote (rule T3)."""
        return max(time(self.clock.now()), head.time)

    def place(self, repository: Repository, at: object = None, as_of: object = None) -> Place:
        """The moment that a question means. Raises `HistoryUnavailable` for one that has been archived away."""
        head = repository.head()
        now = self.now(head)
        t = now if at is None else time(at)
        if as_of is None:
            belief = Moment(now)
        elif isinstance(as_of, Transaction):
            belief = repository.after_transaction(as_of.number, as_of.time)
        else:
            belief = Moment(min(time(as_of), now))
        for asked in (t, belief.time):
            self.refuse_archived(asked, head)
        return Place(t, belief, head, as_of is not None and belief.time <= t)

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

    def vocabulary(self, repository: Repository, head: Head, at: Moment) -> Vocabulary:
        """The vocabulary at a place in the record."""
        found: Domain | None = None
        for version in self.versions(repository, head):
            if version.time <= at.time and (at.number is None or version.transaction <= at.number):
                found = version.domain
        if found is not None:
            return Vocabulary(found)
        return Vocabulary(None, self.shapes(repository))

    def shapes(self, repository: Repository) -> dict[tuple[KnowledgeType, str], Shape]:
        """The shapes of symbols that a knowledge base without a domain keeps (rule D2)."""
        return {
            (KnowledgeType(kind), name_key): Shape(name, arity, tuple(labels.split()) if labels else None)
            for kind, name_key, name, arity, labels in repository.symbols()
        }

    def world(self, repository: Repository, place: Place) -> LazyWorld | None:
        """A moment as it is stored, to be read as far as needed; None where it must be reckoned."""
        t, belief = place.at, place.belief
        if place.is_past_belief or (belief.number is not None and t >= belief.time):
            return None
        if t > belief.time and self.running(repository, belief, place.head):
            return None
        vocabulary = self.vocabulary(repository, place.head, Moment(t))
        return LazyWorld(repository, t, vocabulary.domain, use_unknowns=self.use_unknowns)

    # -- pictures ---------------------------------------------------------------------------------------------

    def picture(self, repository: Repository, place: Place) -> Picture:
        """What stood (or is expected to stand) at a moment (rules Q1, Q2, O3)."""
        t, belief = place.at, place.belief
        exact = belief.number is not None and t == belief.time
        at = belief if exact else Moment(min(t, belief.time))
        if t > belief.time:
            at = belief
        vocabulary = self.vocabulary(repository, place.head, at)
        pending = _all_kinds(repository.pending, at)
        running = self.running(repository, at, place.head)
        if t <= belief.time:
            return Picture(place, _all_kinds(repository.standing, at), pending, running, vocabulary)
        if not place.is_past_belief and not running:
            # what was scheduled is stored with the interval that is expected of it
            rows = _all_kinds(repository.standing, Moment(t))
            return Picture(place, rows, pending, running, vocabulary)
        projection = Projection(
            belief.time,
            _all_kinds(repository.standing, at),
            pending,
            running,
            domain=vocabulary.domain,
            use_unknowns=self.use_unknowns,
            mentions=mentions,
        )
        for _ in projection.advance(t):
            pass
        return Picture(place, projection.rows, pending, projection.running, vocabulary)

    def running(self, repository: Repository, at: Moment, head: Head) -> list[Running]:
        """The durative actions that run at a place in the record."""
        if not head.last_run:
            return []
        return [as_running(row) for row in repository.running(at)]

    def state(self, repository: Repository, place: Place, as_of: object = None) -> State:
        """The state at a moment."""
        return self.state_of(self.picture(repository, place), as_of)

    def state_of(self, picture: Picture, as_of: object = None) -> State:
        """The state that a picture shows."""
        return State(
            at=picture.place.at,
            belief=None if as_of is None else picture.place.belief,
            name=self.name,
            rows=picture.rows,
            pending=picture.pending,
            running=picture.running,
            vocabulary=picture.vocabulary,
            use_unknowns=self.use_unknowns,
            mentions=mentions,
            explainer=self._explainer,
        )


def as_running(row: RunRow) -> Running:
    """A stored run, as the state knows it."""
    return Running(Run(row.operator, row.arguments, row.started, row.duration, row.number), row.rates)


def _all_kinds(read: Callable[[KnowledgeType, Moment], Sequence[Row]], at: Moment) -> list[Row]:
    return [row for kind in KnowledgeType for row in read(kind, at)]
