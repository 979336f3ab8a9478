"""Questions about one fact or one function at one time: one statement each, and none for what was just asked about now.

Every other question reads as much as it needs (`kbstore.reading.lazy_state`), or the whole state.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

from kbstore.clock import OPEN, TIME_LIMIT, time
from kbstore.errors import KbStoreError
from kbstore.evaluation.interpretation import Number
from kbstore.messages import Fact, Function, KnowledgeType, Truth
from kbstore.model.formulas import Atom, Defined, Not
from kbstore.model.symbols import SymbolTable
from kbstore.model.timelines import Role, Timeline, Value, atom_key
from kbstore.names import is_wildcard, key
from kbstore.reading.questions import Question, as_condition, as_expression
from kbstore.reading.reader import Reader
from kbstore.storage import queries
from kbstore.storage.connection import AnswerCache, StoreConnection
from kbstore.storage.repository import LogPosition, Repository

_PREPARED = 50_000
"""How many prepared questions, and how many answers about now, are kept."""


class PointAnswer(NamedTuple):
    """What stands on a timeline at `t`, since when, and until it ends or something begins; None: nothing stands.

    `memory` is where the answer may be remembered until somebody commits.
    """

    value: Value | None
    initial_time: int
    until: int
    t: int
    memory: AnswerCache | None = None


class PreparedQuestion:
    """A question about one timeline, ready to be asked; `negated` by ``not``."""

    __slots__ = ("key", "kind", "negated", "statement", "timeline", "version")

    def __init__(self, kind: KnowledgeType, key: str, *, negated: bool, version: int) -> None:
        self.kind = kind
        self.key = key
        self.negated = negated
        self.version = version
        self.statement = queries.for_kind[kind].point
        self.timeline: Timeline | None = None


class PointQueries:
    """Asks such questions of one knowledge base.

    `caching` keeps answers about now for each connection, for as long as SQLite says that nobody has committed, and
    until the clock reaches the time at which the answer changes.
    """

    def __init__(self, reader: Reader, *, caching: bool) -> None:
        self._reader = reader
        self._database = reader.database
        self._clock = reader.clock
        self._caching = caching and reader.database.can_remember
        self._prepared: dict[object, tuple[Question, PreparedQuestion | None]] = {}

    def truth(self, question: Question, at: object) -> Truth | None:
        """The truth of a ground fact, None if it is not such a question, or not one about a stored moment."""
        if at is None and self._caching:
            memory = self._database.recall()
            if memory is not None:
                known = memory.truths.get(question if type(question) is str else id(question))
                if known is not None and known[1] <= self._clock.now() < known[2]:
                    truth: Truth = known[3]
                    return truth
        point = self._point(question, self._fact)
        if point is None:
            return None
        session = self._database.checkout()
        try:
            found = self._answer(session, point, at)
            if found is None:
                return None
            truth = self._truth_of(point, found.value)
            if found.memory is not None:
                _remember(found.memory.truths, question, found, truth)
            return truth
        finally:
            self._database.checkin(session)

    def number(self, question: Question, at: object) -> float | None:
        """The value of a ground function, None if it is not such a question, or has no value."""
        if at is None and self._caching:
            memory = self._database.recall()
            if memory is not None:
                known = memory.numbers.get(question if type(question) is str else id(question))
                if known is not None and known[1] <= (now := self._clock.now()) < known[2]:
                    number: Number = known[3]
                    return number.at(now)
        point = self._point(question, self._function)
        if point is None:
            return None
        session = self._database.checkout()
        try:
            found = self._answer(session, point, at)
            if found is None or found.value is None:
                return None
            _, value, _, rate = found.value
            number = Number(value, rate, found.initial_time)
            if found.memory is not None:
                _remember(found.memory.numbers, question, found, number)
            return number.at(found.t)
        finally:
            self._database.checkin(session)

    # -- answers ----------------------------------------------------------------------------------------------

    def _truth_of(self, point: PreparedQuestion, value: Value | None) -> Truth:
        if point.kind is KnowledgeType.FUNCTION:
            truth = Truth.of(value is not None)
        elif value is None:
            truth = Truth.UNKNOWN if self._reader.use_unknowns else Truth.FALSE
        else:
            truth = Truth.FALSE if value[0] else Truth.TRUE
        return ~truth if point.negated else truth

    def _answer(self, session: StoreConnection, point: PreparedQuestion, at: object) -> PointAnswer | None:
        """What stands, at the moment that was meant; None where it must be reckoned."""
        if at is not None:
            return self._ask(session, point, at if type(at) is int else time(at), about_now=False)
        now = self._clock.now()
        if not self._caching or session.in_transaction:
            return self._ask(session, point, time(now), about_now=True)
        memory = session.memory()
        known: PointAnswer | None = memory.points.get(point)
        if known is not None and known.t <= now < known.until:
            return known._replace(t=now)
        found = self._ask(session, point, time(now), about_now=True)
        if found is not None:
            found = found._replace(until=self._until(session, point, found), memory=memory)
            _make_room(memory.points)
            memory.points[point] = found
        return found

    def _ask(self, session: StoreConnection, point: PreparedQuestion, t: int, *, about_now: bool) -> PointAnswer | None:
        timeline = point.timeline
        if timeline is None:
            timeline = point.timeline = self._find(session, point)
        reader = self._reader
        row = session.look_up(point.statement, reader.kb, 0 if timeline is None else timeline.id, t)
        assert row is not None
        last_time, history_from, domain_version, last_run, end, initial_time = row[:6]
        if about_now:
            if last_time > t:
                # a caller always sees what it wrote, also where the clock is behind (rule T3)
                return self._ask(session, point, last_time, about_now=False)
        elif t > last_time and (last_run or reader.is_archive) and t > self._clock.now():
            return None
        if t < history_from or not 0 <= t < TIME_LIMIT:
            return None
        if point.version != domain_version:
            self._prepared.clear()
            return None
        if t < reader.latest_version_time:
            return None
        if end is None or end <= t:
            return PointAnswer(None, 0, OPEN, t)
        return PointAnswer(row[6:], initial_time, end, t)

    def _until(self, session: StoreConnection, point: PreparedQuestion, found: PointAnswer) -> int:
        """When the answer changes, if nobody writes."""
        if found.value is not None or point.timeline is None:
            return found.until
        parameters = {"kb": self._reader.kb, "timeline": point.timeline.id, "t": found.t}
        row = session.first(queries.for_kind[point.kind].next_start, parameters)
        return OPEN if row is None else int(row[0])

    def _find(self, session: StoreConnection, point: PreparedQuestion) -> Timeline | None:
        repository = Repository(session, self._reader.kb, self._reader.cache)
        return repository.find(Role.STATE, point.kind, [point.key]).get(point.key)

    # -- prepared questions -----------------------------------------------------------------------------------

    def _point(
        self, question: Question, read: Callable[[Question, SymbolTable, int], PreparedQuestion | None]
    ) -> PreparedQuestion | None:
        # an item that is asked for again is found by itself, in a fifth of the time that what it says takes
        asked = (question if type(question) is str else id(question), read)
        known = self._prepared.get(asked)
        if known is not None:
            return known[1]
        if isinstance(question, str):
            name: object = asked
        elif isinstance(question, Fact | Function):
            value = question.function_value if isinstance(question, Function) else None
            name = (question.key, question.is_negative, question.labels, type(question), value, read)
        else:
            return None
        point: PreparedQuestion | None
        known = self._prepared.get(name)
        if known is None:
            with self._reader.repository() as repository:
                head = repository.head()
                symbol_table = self._reader.symbol_table(repository, head, LogPosition(self._reader.now(head)))
            try:
                point = read(question, symbol_table, head.domain_version)
            except KbStoreError:
                # refused with the right words where it is asked as any other question
                point = None
            if symbol_table.domain is None and (point is None or _has_new_labels(question, symbol_table)):
                # what it asks may be another thing once more has been told (rule D2)
                return None
        else:
            point = known[1]
        _make_room(self._prepared)
        self._prepared[asked] = self._prepared[name] = (question, point)
        return point

    @staticmethod
    def _fact(question: Question, symbol_table: SymbolTable, version: int) -> PreparedQuestion | None:
        condition = as_condition(question, symbol_table)
        negated = isinstance(condition, Not)
        if isinstance(condition, Not):
            condition = condition.part
        match condition:
            case Atom() if symbol_table.domain is None or not symbol_table.domain.is_derived(condition.name):
                return _ground(KnowledgeType.FACT, condition, symbol_table, negated=negated, version=version)
            case Defined() if symbol_table.domain is None and isinstance(question, str):
                # as long as there is no predicate of that name
                return None
            case Defined(function):
                return _ground(KnowledgeType.FUNCTION, function, symbol_table, negated=negated, version=version)
        return None

    @staticmethod
    def _function(question: Question, symbol_table: SymbolTable, version: int) -> PreparedQuestion | None:
        expression = as_expression(question, symbol_table)
        if len(expression) != 1 or not isinstance(expression[0], Atom):
            return None
        return _ground(KnowledgeType.FUNCTION, expression[0], symbol_table, negated=False, version=version)


def _remember(answers: dict[Any, Any], question: Question, found: PointAnswer, answer: object) -> None:
    """Keep an answer with the times between which it is right. A text is found by what it says, an item by itself."""
    _make_room(answers)
    answers[question if type(question) is str else id(question)] = (question, found.t, found.until, answer)


def _make_room(remembered: dict[Any, Any]) -> None:
    if len(remembered) >= _PREPARED:
        remembered.clear()


def _has_new_labels(question: Question, symbol_table: SymbolTable) -> bool:
    """Whether an item has labels whose order is not known yet."""
    if not isinstance(question, Fact | Function) or not any(question.labels):
        return False
    shape = symbol_table.shapes.get((question.knowledge_type, question.key[0]))
    return shape is None or shape.labels is None


def _ground(
    kind: KnowledgeType, atom: Atom, symbol_table: SymbolTable, *, negated: bool, version: int
) -> PreparedQuestion | None:
    if any(map(is_wildcard, atom.arguments)):
        return None
    if symbol_table.domain is None and (kind, key(atom.name)) not in symbol_table.shapes:
        return None
    name, arguments = symbol_table.ordered(kind, atom.name, atom.arguments, ())
    return PreparedQuestion(
        kind, atom_key([key(word) for word in (name, *arguments)]), negated=negated, version=version
    )
