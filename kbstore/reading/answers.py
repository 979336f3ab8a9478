"""Answers to single questions: cached, or read from one timeline, or evaluated on the state.

An answer about now is cached for the connection that computed it, until somebody commits to the knowledge base or the
clock reaches the time at which a part of the question changes. If moving numbers decide it, the assertions that it was
computed from are cached instead. An answer that is not cached takes one statement where one timeline decides it; any
other is evaluated on as much of the state as it reads (`kbstore.reading.lazy_state`).
"""

from collections.abc import Callable, Sequence
from typing import Any, Generic, NamedTuple, TypeVar

from kbstore.clock import OPEN, Clock, TimeLike
from kbstore.errors import KbStoreError
from kbstore.evaluation.argument_types import check_types
from kbstore.evaluation.interpretation import Interpretation, Number
from kbstore.evaluation.snapshot import Snapshot
from kbstore.messages import KnowledgeType, Truth
from kbstore.model.domain import Domain
from kbstore.model.results import AsOf, QueryResult
from kbstore.model.symbols import SymbolTable
from kbstore.model.timelines import Role
from kbstore.reading.lazy_state import LazyState, NotRead, PartialState
from kbstore.reading.prepared import PreparedCondition, PreparedExpression, question_key
from kbstore.reading.questions import Question
from kbstore.reading.reader import Reader
from kbstore.reading.resolver import TemporalPoint
from kbstore.reading.state import query_result
from kbstore.storage.caches import LRU
from kbstore.storage.repository import Repository

_Prepared = PreparedCondition | PreparedExpression

_Value = TypeVar("_Value")

_Answer = Truth | float

_Found = tuple[int, int, "_Answer | Number | _Moving"]
"""Since, until, and an answer, or what computes it: valid for ``since <= t < until``, until somebody commits."""


class _Moving(NamedTuple):
    """A question that moving numbers decide, to be evaluated again at later times.

    Attributes:
        prepared: the question.
        partial_state: the assertions that it reads.
        answer: the answer when they were read.
    """

    prepared: _Prepared
    partial_state: PartialState
    answer: _Answer

    def at(self, t: int) -> _Answer | None:
        """Return the answer at a time in nanoseconds; None if that needs more than has been read or checked."""
        try:
            answer = self.prepared.evaluate(self.partial_state.later(t))
        except (NotRead, KbStoreError):
            return None
        # types were checked for the earlier answer; another one may depend on types that were not (rule V10)
        return answer if answer == self.answer or not _needs_check(self.prepared, answer) else None


class Computed(NamedTuple, Generic[_Value]):
    """A value computed from a state.

    Attributes:
        value: the value.
        size: its size in assertions.
        until: returns the time, in nanoseconds, at which the clock may change it, or the state's own time if it is not
            to be cached; called on the same snapshot of the store, and only where it may be cached.
    """

    value: _Value
    size: int
    until: Callable[[], int]


class _QuestionKind(NamedTuple):
    """What differs between conditions and expressions.

    Attributes:
        prepared: the cache of prepared questions.
        prepare: how a question is prepared.
        cached: the attribute of the connection's memory that caches the answers.
    """

    prepared: LRU[Any, Any]
    prepare: Callable[[Question, SymbolTable], _Prepared]
    cached: str


_COMPUTED = (Number, _Moving)


class Answers:
    """Answers questions about one knowledge base; without `caching`, each is answered from the store."""

    def __init__(self, reader: Reader, clock: Clock, *, caching: bool) -> None:
        questions = reader.questions
        self._reader = reader
        self._database = reader.database
        self._resolver = reader.resolver
        self._domains = reader.domains
        self._clock = clock
        self._caches = caching and reader.database.can_cache
        self._conditions = _QuestionKind(questions.conditions, questions.condition, "truths")
        self._expressions = _QuestionKind(questions.expressions, questions.expression, "values")

    def truth(self, question: Question, at: TimeLike | None = None, as_of: AsOf | None = None) -> Truth:
        """Return the truth value of a condition at a time, as of another."""
        return self._ask(self._conditions, question, at, as_of)  # type: ignore[return-value]

    def value(self, question: Question, at: TimeLike | None = None, as_of: AsOf | None = None) -> float:
        """Return the value of an expression at a time, as of another.

        Raises `UndefinedFunction` or `DivisionByZero` if it has none.
        """
        return self._ask(self._expressions, question, at, as_of)  # type: ignore[return-value]

    def computed(
        self,
        name: tuple[object, ...] | None,
        compute: Callable[[Repository, TemporalPoint], Computed[_Value]],
        at: TimeLike | None = None,
    ) -> _Value:
        """Return a value computed from the state at a time, cached by `name` if it has one; no caller may change it."""
        connection = self._database.checkout()
        try:
            is_cached = self._caches and at is None and name is not None
            memory = connection.memory(self._reader.kb) if is_cached else None
            if memory is not None:
                known: tuple[int, Computed[_Value], int] | None = memory.computed.get(name)
                if known is not None and known[0] <= self._clock.now() < known[2]:
                    return known[1].value
            with self._reader.repository() as repository:
                point = self._resolver.resolve(repository, at)
                found = compute(repository, point)
                until = point.valid_time if memory is None else found.until()
            if memory is not None and point.valid_time < until:
                memory.computed.put(name, (point.valid_time, found, until))
            return found.value
        finally:
            self._database.checkin(connection)

    def is_quick(self, question: Question) -> bool:
        """Return whether a question is known to take at most one statement, on a connection of this thread's own."""
        key = self._domains.latest.domain, question if type(question) is str else question_key(question)
        found = self._conditions.prepared.get(key) or self._expressions.prepared.get(key)
        return self._database.is_local and self._caches and found is not None and found.key is not None

    def _ask(self, form: _QuestionKind, question: Question, at: TimeLike | None, as_of: AsOf | None) -> Truth | float:
        name = question if type(question) is str else question_key(question)
        connection = self._database.checkout()
        try:
            answers = None
            is_cached = self._caches and at is None and as_of is None
            if is_cached and (memory := connection.memory(self._reader.kb)) is not None:
                answers = getattr(memory, form.cached)
                known = self._cached(answers, name, self._clock.now())
                if known is not None:
                    return known
            found = None
            if as_of is None and not isinstance(at, str):
                # first the repository, then the prepared question: so it is not older than the repository has seen
                repository = Repository(connection, self._reader.kb, self._reader.memory)
                # times in text are left to the resolver: they may be relative to now
                prepared = form.prepared.get((self._domains.latest.domain, name))
                if prepared is not None and prepared.key is not None:
                    found = self._from_timeline(repository, prepared, at, look_ahead=answers is not None)
            if found is None:
                found = self._from_state(form, question, at, as_of, look_ahead=answers is not None)
            since, until, answer = found
            if answers is not None and name is not None and since < until:
                answers.put(name, found)
            if type(answer) is _Moving:
                return answer.answer
            return answer.at(since) if type(answer) is Number else answer  # type: ignore[return-value]
        finally:
            self._database.checkin(connection)

    @staticmethod
    def _cached(answers: LRU[Any, Any], name: object, now: int) -> _Answer | None:
        """Return the cached answer, if it is valid now."""
        known: _Found | None = answers.get(name)
        if known is None:
            return None
        since, until, answer = known
        if not since <= now < until:
            return None
        return answer.at(now) if isinstance(answer, _COMPUTED) else answer

    def _from_timeline(
        self, repository: Repository, prepared: _Prepared, at: TimeLike | None, *, look_ahead: bool
    ) -> _Found | None:
        """Return the answer by what holds on a single timeline; None if one statement is not enough."""
        generation, timeline = prepared.timeline
        if timeline is None or generation != repository.generation:
            assert prepared.key is not None
            found = repository.find(Role.STATE, prepared.kind, [prepared.key])
            timeline = found.get(prepared.key)
            prepared.timeline = repository.generation, timeline
        stored = self._resolver.resolve_stored(repository, prepared.kind, timeline, at)
        if stored is None:
            return None
        t, point = stored
        token, _, _, domain_version, _, end_time, initial_time = point[:7]
        version = self._domains.latest
        if domain_version != version.version or t < version.time:
            return None
        value = point[7:] if end_time is not None and end_time > t else None
        if value is None and not self._is_plausible(prepared, repository, token, version.domain):
            return None
        answer: _Answer | Number
        if type(prepared) is PreparedCondition:
            answer = prepared.if_absent if value is None else prepared.if_denied if value[0] else prepared.if_asserted
        elif value is None:
            return None
        else:
            answer = Number(value[1], value[3], initial_time) if value[3] else value[1]
        if value is None:
            end_time = OPEN if timeline is None or not look_ahead else repository.next_start(timeline, t)
        return t, end_time, answer

    def _from_state(
        self, form: _QuestionKind, question: Question, at: TimeLike | None, as_of: AsOf | None, *, look_ahead: bool
    ) -> _Found:
        """Evaluate the question, on as much of the state as it reads."""
        reader = self._reader
        with reader.repository() as repository:
            point = self._resolver.resolve(repository, at, as_of)
            symbols = reader.symbols_at(repository, point)
            world = reader.world(repository, point, symbols.domain)
            prepared = form.prepare(question, symbols)
            answer = self._evaluate(prepared, repository, world, point.head.token)
            if not look_ahead or not isinstance(world, LazyState):
                return point.valid_time, point.valid_time, answer
            if not world.is_moving:
                return point.valid_time, world.until, answer
            partial_state = world.partial_state
            if partial_state is None:
                return point.valid_time, point.valid_time, answer
            return point.valid_time, world.until, _Moving(prepared, partial_state, answer)

    def query(self, items: Sequence[Question], at: TimeLike | None = None) -> QueryResult:
        """Return whether each of several items is true at a time, on one snapshot of the store."""
        reader = self._reader
        names = [item if type(item) is str else question_key(item) for item in items]
        connection = self._database.checkout()
        try:
            memory = connection.memory(self._reader.kb) if self._caches and at is None else None
            domain = self._domains.latest.domain
            if memory is not None and domain is not None:
                # the cached answers are all of the latest commit; one reading of the clock makes them of one time
                now = self._clock.now()
                known = [self._cached(memory.truths, name, now) for name in names]
                if None not in known:
                    return query_result(items, [truth is Truth.TRUE for truth in known], SymbolTable(domain))
            with reader.repository() as repository:
                point = self._resolver.resolve(repository, at)
                symbols = reader.symbols_at(repository, point)
                world = reader.world(repository, point, symbols.domain)
                prepared = [self._conditions.prepare(item, symbols) for item in items]
                truths = [self._evaluate(item, repository, world, point.head.token) for item in prepared]
                if memory is not None and isinstance(world, LazyState) and not world.is_moving:
                    t, until = point.valid_time, world.until
                    for name, truth in zip(names, truths, strict=True):
                        if name is not None and t < until:
                            memory.truths.put(name, (t, until, truth))
        finally:
            self._database.checkin(connection)
        return query_result(items, [truth is Truth.TRUE for truth in truths], symbols)

    def _evaluate(
        self, prepared: _Prepared, repository: Repository, world: LazyState | Snapshot, token: int
    ) -> _Answer:
        """Return the answer in a world. Raises `InvalidKnowledge` if an object is of a wrong type (rule V10)."""
        try:
            answer: _Answer = prepared.evaluate(world)
        except KbStoreError:
            self._check(prepared, repository, world, token)
            raise
        if _needs_check(prepared, answer):
            self._check(prepared, repository, world, token)
        return answer

    def _check(self, prepared: _Prepared, repository: Repository, world: Interpretation, token: int) -> None:
        """Raise `InvalidKnowledge` if an object in the question has a wrong type in a world (rule V10)."""
        if not self._is_plausible(prepared, repository, token, world.domain):
            check_types(prepared.named, world.type_of, world.domain)

    @staticmethod
    def _is_plausible(prepared: _Prepared, repository: Repository, token: int, domain: Domain | None) -> bool:
        """Return whether no object in a question has ever been of a type that its parameter excludes (rule V10).

        Looked up once, and again when an object has been recorded. Callers need it only if nothing is asserted on the
        timeline: an assertion was checked when it was recorded.
        """
        if not prepared.named:
            return True
        generation, number, known = prepared.plausible
        if generation == repository.generation and (
            known == token or (known and not repository.has_objects_since(number))
        ):
            prepared.plausible = generation, number, token
            return True
        number = repository.head().number
        timelines = repository.find(Role.STATE, KnowledgeType.INSTANCE, [use.name for use in prepared.named])
        if timelines:
            types: dict[str, set[str]] = {}
            for row in repository.history(KnowledgeType.INSTANCE, list(timelines.values()), 0, OPEN):
                types.setdefault(row.timeline.key, set()).add(row.value[1])
            for use in prepared.named:
                if domain is None or not all(domain.is_subtype(name, use.types) for name in types.get(use.name, ())):
                    return False
        prepared.plausible = repository.generation, number, token
        return True


def _needs_check(prepared: _Prepared, answer: _Answer) -> bool:
    """Return whether an answer is right only if the objects are of the right types (rule V10)."""
    return not prepared.proves_types or answer in (Truth.FALSE, Truth.UNKNOWN)
