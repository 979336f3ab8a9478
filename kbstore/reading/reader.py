"""Reads the states of a knowledge base."""

from collections.abc import Callable, Mapping, Sequence
from copy import copy
from types import TracebackType
from typing import TYPE_CHECKING, NamedTuple

from kbstore.clock import OPEN, SECOND, TIME_LIMIT, Clock, TimeLike
from kbstore.evaluation.snapshot import Snapshot, by_kind
from kbstore.messages import KnowledgeType
from kbstore.model.domain import Domain
from kbstore.model.results import AsOf, Broken, Explanation, Run
from kbstore.model.symbols import SymbolTable
from kbstore.model.timelines import EndCause, Identity, StateRow
from kbstore.planning.rates import RunningAction
from kbstore.planning.simulator import Simulator
from kbstore.reading.domains import DomainVersions
from kbstore.reading.lazy_state import LazyState
from kbstore.reading.mentions import mentions
from kbstore.reading.prepared import PreparedQuestions
from kbstore.reading.questions import Question
from kbstore.reading.resolver import MAX_STEP, TOLERANCE, Resolver, TemporalPoint
from kbstore.reading.state import State
from kbstore.reading.state_data import StateData
from kbstore.storage.caches import ASSERTIONS, LRU, TIMELINES
from kbstore.storage.database import Database
from kbstore.storage.memory import StoreMemory
from kbstore.storage.records import Head, LogPosition, RunRow
from kbstore.storage.repository import Repository

if TYPE_CHECKING:
    from sqlalchemy import Connection


class _Past(NamedTuple):
    """A cached past state.

    Attributes:
        data: the state.
        late: the last transaction with late knowledge when it was read.
        generation: the generation of the store when it was read. A thread that began to read before the store went back
            may put a state into the cache after it was emptied; its generation gives that state away.
    """

    data: StateData
    late: int
    generation: int


class Reader:
    """Reads the states of one knowledge base, and has the caches that all readers of it share.

    Attributes:
        resolver: decides which instant a question means.
        domains: the versions of the domain.
        questions: the prepared questions.
        memory: the timelines, and how far the record has been seen.
        borrowed: a connection of the caller's, in whose transaction updates are written; usually None.
    """

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
        tolerance: int = TOLERANCE,
        max_step: int = MAX_STEP,
    ) -> None:
        self.database = database
        self.kb = kb
        self.name = name
        self.use_unknowns = use_unknowns
        self.resolver = Resolver(name, clock, tolerance=tolerance, max_step=max_step, is_archive=is_archive)
        self.domains = DomainVersions(caching=caching)
        self.questions = PreparedQuestions(use_unknowns=use_unknowns, caching=caching)
        self.memory = StoreMemory(name, TIMELINES if caching else 0)
        self.memory.when_gone_back(self._forget)
        self._states: LRU[int, _Past] = LRU(ASSERTIONS if caching else 0, lambda past: past.data.size)
        self._explainer = explainer
        self.borrowed: Connection | None = None

    def within(self, connection: "Connection") -> "Reader":
        """Return a reader for writing in a transaction of the caller's.

        It has caches of its own, because what it reads may never be committed.
        """
        made = copy(self)
        made.borrowed = connection
        made.domains = self.domains.copy()
        made.questions = PreparedQuestions(use_unknowns=self.use_unknowns, caching=False)
        made._states = LRU(0)
        made.memory = StoreMemory(self.name, self.memory.bound)
        made.memory.progress.seen = self.memory.progress.seen
        made.memory.when_gone_back(made._forget)
        return made

    def _forget(self) -> None:
        """Forget everything, as the store has gone back."""
        self.domains.forget(self.memory.progress.returns)
        self.questions.forget()
        self._states.clear()
        self.database.forget_answers()

    def repository(self) -> "_SnapshotRepository":
        """Open the knowledge base on one snapshot of the store, as a context manager."""
        return _SnapshotRepository(self)

    def symbol_table(self, repository: Repository, head: Head, position: LogPosition) -> SymbolTable:
        """Return the symbols known at a position in the log."""
        return self.domains.symbol_table(repository, head, position)

    def symbols_at(self, repository: Repository, point: TemporalPoint) -> SymbolTable:
        """Return the symbols for a question about a point; after now, those that can be forecast (rule P4)."""
        symbols = self.symbol_table(repository, point.head, point.position)
        if symbols.domain is not None and point.valid_time > point.system_time.time:
            return SymbolTable(symbols.domain.forecast)
        return symbols

    def running(self, repository: Repository, position: LogPosition, head: Head) -> list[RunningAction]:
        """Return the durative actions that run at a position in the log."""
        return [as_running(row) for row in repository.running(position)] if head.last_run else []

    def world(self, repository: Repository, point: TemporalPoint, domain: Domain | None) -> LazyState | Snapshot:
        """Return an interpretation at a point for a few questions; a stored state is read only as far as they need."""
        if point.is_known_now:
            past = self._cached(repository, point) if point.is_settled else None
            if past is None:
                return LazyState(repository, point.valid_time, domain, use_unknowns=self.use_unknowns)
            return past.snapshot
        return self._data(repository, point, domain).snapshot

    def state_at(self, at: TimeLike | None, as_of: AsOf | None) -> State:
        """Return the state at a time, as of another."""
        with self.repository() as repository:
            if self.database.dialect == "postgresql" and as_of is None:
                t = self.resolver.read_clock() if at is None else at
                if type(t) is int and 0 <= t < TIME_LIMIT and self._states.find(t) is None:
                    repository.read_state(t)
                    while at is None and t < repository.head().time:
                        # now is no earlier than the latest transaction (rule T3), and others may be committed meanwhile
                        t = repository.head().time
                        repository.read_state(t)
                    at = t
            return self.state(repository, self.resolver.resolve(repository, at, as_of))

    def state(self, repository: Repository, point: TemporalPoint) -> State:
        """Return the state at a point."""
        symbols = self.symbols_at(repository, point)
        data = self._cached(repository, point) if point.is_settled else None
        if data is None:
            data = self._data(repository, point, symbols.domain)
            if point.is_settled:
                self._states.put(point.valid_time, _Past(data, point.head.late, repository.generation))
        return self.state_of(data, symbols, point.system_time if point.is_as_of else None)

    def _cached(self, repository: Repository, point: TemporalPoint) -> StateData | None:
        """Return a past state from the cache, unless late knowledge has reached its time since (rule L4)."""
        past = self._states.find(point.valid_time)
        if past is None or past.generation != repository.generation:
            return None
        if past.late == point.head.late:
            return past.data
        if past.late > point.head.late or repository.late_from(past.late) <= point.valid_time:
            return None
        self._states.put(point.valid_time, past._replace(late=point.head.late))
        return past.data

    def state_of(
        self,
        data: StateData,
        symbols: SymbolTable,
        as_of: LogPosition | None = None,
        draft: Mapping[Identity, EndCause] | None = None,
    ) -> State:
        """Return the state with some data; `draft` is what the open transaction has ended whose state it is."""
        return State(
            data,
            belief=as_of,
            name=self.name,
            symbol_table=symbols,
            questions=self.questions,
            mentions=mentions,
            explainer=self._explainer,
            draft=draft,
        )

    def _data(self, repository: Repository, point: TemporalPoint, domain: Domain | None) -> StateData:
        """Read the state, or the expected state, at a point (rules Q1, Q2, O3)."""
        t = point.valid_time
        pending = _all_kinds(repository.scheduled_at, point.position)
        if t > point.system_time.time:
            running = [as_running(row) for row in point.running]
        else:
            running = self.running(repository, point.position, point.head)
        if point.rows_at is None:
            simulator = Simulator(
                point.position.time,
                _all_kinds(repository.state_at, point.position),
                pending,
                running,
                domain=domain,
                use_unknowns=self.use_unknowns,
                mentions=mentions,
            )
            for _ in simulator.advance(t):
                pass
            parts, running = by_kind(simulator.rows), simulator.running
        else:
            parts = {kind: repository.state_at(kind, point.rows_at) for kind in KnowledgeType}
        return StateData(Snapshot(t, parts, domain, self.use_unknowns), pending, running)


class _SnapshotRepository:
    """`Reader.repository`, as a class: a generator would take a microsecond of each question."""

    __slots__ = ("_context", "_reader")

    def __init__(self, reader: Reader) -> None:
        self._reader = reader
        self._context = reader.database.read()

    def __enter__(self) -> Repository:
        connection = self._context.__enter__()
        try:
            return Repository(connection, self._reader.kb, self._reader.memory)
        except BaseException as error:
            self._context.__exit__(type(error), error, error.__traceback__)
            raise

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._context.__exit__(kind, error, trace)


def as_running(row: RunRow) -> RunningAction:
    """Return a stored run as a state shows it, while it runs."""
    return RunningAction(as_run(row._replace(end_time=OPEN, outcome=None, ended=None)), row.remembered)


def as_run(row: RunRow, broken: tuple[Broken, ...] = ()) -> Run:
    """Return a stored run as callers get it."""
    return Run(
        row.operator,
        row.arguments,
        row.started,
        row.duration,
        row.number,
        None if row.duration_s == row.duration / SECOND else row.duration_s,
        row.forced,
        None if row.end_time == OPEN else row.end_time,
        row.outcome or "running",
        row.recorded,
        row.ended,
        broken,
    )


def _all_kinds(read: Callable[[KnowledgeType, LogPosition], Sequence[StateRow]], at: LogPosition) -> list[StateRow]:
    return [row for kind in KnowledgeType for row in read(kind, at)]
