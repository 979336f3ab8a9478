"""Questions about one fact or one function at one time: one statement each, and none for what was just asked about now.

Every other question reads as much as it needs (`kbstore.lazy_world`), or the whole state.
"""

from collections.abc import Callable
from typing import NamedTuple

from kbstore.clock import OPEN, time
from kbstore.errors import KbStoreError
from kbstore.interpretation import Number
from kbstore.logic import Atom, Defined, Not
from kbstore.messages import Fact, Function, KnowledgeType, Truth
from kbstore.names import is_wildcard, key
from kbstore.questions import Question, as_condition, as_expression
from kbstore.reading import Reader
from kbstore.storage import queries
from kbstore.storage.engine import Session
from kbstore.storage.repository import Head, Repository
from kbstore.timelines import Role, Timeline, Value
from kbstore.vocabulary import Vocabulary

_PREPARED = 50_000
"""How many prepared questions, and how many answers about now, are kept."""


class Answer(NamedTuple):
    """What stands on a timeline from a time on, until it ends or something begins; None: nothing stands."""

    value: Value | None
    initial_time: int
    until: int


class Point:
    """A question about one timeline, ready to be asked; `negated` by ``not``."""

    __slots__ = ("key", "kind", "negated", "timeline", "version")

    def __init__(self, kind: KnowledgeType, key: str, *, negated: bool, version: int) -> None:
        self.kind = kind
        self.key = key
        self.negated = negated
        self.version = version
        self.timeline: Timeline | None = None


class Points:
    """Asks such questions of one knowledge base.

    `caching` keeps answers about now for each connection, for as long as SQLite's ``data_version`` says that nobody
    else has committed, and until the clock reaches the time at which the answer changes.
    """

    def __init__(self, reader: Reader, *, caching: bool) -> None:
        self._reader = reader
        self._clock = reader.clock
        self._caching = caching and reader.database.dialect == "sqlite"
        self._prepared: dict[object, Point | None] = {}

    def truth(self, question: Question, at: object) -> Truth | None:
        """The truth of a ground fact, None if it is not such a question, or not one about a stored moment."""
        point = self._point(question, self._fact)
        if point is None:
            return None
        answer = self._answer(point, at)
        if answer is None:
            return None
        value = answer[0].value
        if point.kind is KnowledgeType.FUNCTION:
            truth = Truth.of(value is not None)
        elif value is None:
            truth = Truth.UNKNOWN if self._reader.use_unknowns else Truth.FALSE
        else:
            truth = Truth.FALSE if value[0] else Truth.TRUE
        return ~truth if point.negated else truth

    def number(self, question: Question, at: object) -> float | None:
        """The value of a ground function, None if it is not such a question, or has no value."""
        point = self._point(question, self._function)
        answer = None if point is None else self._answer(point, at)
        if answer is None or answer[0].value is None:
            return None
        _, value, _, rate = answer[0].value
        return Number(value, rate, answer[0].initial_time).at(answer[1])

    # -- answers ----------------------------------------------------------------------------------------------

    def _answer(self, point: Point, at: object) -> tuple[Answer, int] | None:
        """What stands, and the moment that was meant; None where it must be reckoned."""
        database = self._reader.database
        if at is not None:
            with database.asking() as session:
                return self._ask(session, point, time(at), about_now=False)
        with database.asking() as session:
            now = time(self._clock.now())
            if not self._caching or session.in_transaction:
                return self._ask(session, point, now, about_now=True)
            answers = session.answers(self._reader.kb)
            known: tuple[Answer, int, int] | None = answers.get(point)
            if known is not None:
                answer, since, latest = known
                now = max(now, latest)
                if since <= now < answer.until:
                    return answer, now
            found = self._ask(session, point, now, about_now=True)
            if found is not None:
                answer, now = found
                if len(answers) >= _PREPARED:
                    answers.clear()
                latest = now if now > self._clock.now() else 0
                answers[point] = (answer._replace(until=self._until(session, point, answer, now)), now, latest)
            return found

    def _ask(self, session: Session, point: Point, t: int, *, about_now: bool) -> tuple[Answer, int] | None:
        timeline = point.timeline
        if timeline is None:
            timeline = point.timeline = self._find(session, point)
        parameters = {"kb": self._reader.kb, "timeline": 0 if timeline is None else timeline.id, "t": t}
        row = session.first(queries.for_kind[point.kind].point, parameters)
        assert row is not None
        head = Head(*row[:5])
        if about_now and head.time > t:
            # a caller always sees what it wrote, also where the clock is behind (rule T3)
            return self._ask(session, point, head.time, about_now=False)
        self._reader.refuse_archived(t, head)
        if point.version != self._version(session, head, t):
            self._prepared.clear()
            return None
        if not about_now and head.last_run and t > max(head.time, self._clock.now()):
            return None
        end = row[5]
        if end is None or end <= t:
            return Answer(None, 0, OPEN), t
        return Answer(row[7:], row[6], end), t

    def _until(self, session: Session, point: Point, answer: Answer, now: int) -> int:
        """When the answer changes, if nobody writes."""
        if answer.value is not None or point.timeline is None:
            return answer.until
        parameters = {"kb": self._reader.kb, "timeline": point.timeline.id, "t": now}
        row = session.first(queries.for_kind[point.kind].next_start, parameters)
        return OPEN if row is None else int(row[0])

    def _find(self, session: Session, point: Point) -> Timeline | None:
        repository = Repository(session, self._reader.kb, self._reader.cache)
        return repository.find(Role.STATE, point.kind, [point.key]).get(point.key)

    def _version(self, session: Session, head: Head, t: int) -> int:
        """The version of the domain at a time; 0 for none."""
        repository = Repository(session, self._reader.kb, self._reader.cache)
        versions = self._reader.versions(repository, head)
        if versions and versions[-1].time <= t:
            return versions[-1].version
        return sum(version.time <= t for version in versions)

    # -- prepared questions -----------------------------------------------------------------------------------

    def _point(self, question: Question, read: Callable[[Question, int], Point | None]) -> Point | None:
        if isinstance(question, str):
            name: object = (question, read)
        elif isinstance(question, Fact | Function):
            name = (question.key, question.is_negative, question.labels, type(question), read)
            if isinstance(question, Function):
                name = (*name, question.function_value)
        else:
            return None
        try:
            return self._prepared[name]
        except KeyError:
            pass
        with self._reader.repository() as repository:
            head = repository.head()
            self._reader.versions(repository, head)
        try:
            point = read(question, head.domain_version)
        except KbStoreError:
            # refused with the right words where it is asked as any other question
            point = None
        if len(self._prepared) >= _PREPARED:
            self._prepared.clear()
        self._prepared[name] = point
        return point

    def _vocabulary(self, version: int) -> Vocabulary:
        versions = self._reader.known_versions
        return Vocabulary(versions[version - 1].domain if version else None)

    def _fact(self, question: Question, version: int) -> Point | None:
        vocabulary = self._vocabulary(version)
        if vocabulary.domain is None:
            return None
        condition = as_condition(question, vocabulary)
        negated = isinstance(condition, Not)
        if isinstance(condition, Not):
            condition = condition.part
        match condition:
            case Atom() if not vocabulary.domain.is_derived(condition.name):
                return self._ground(KnowledgeType.FACT, condition, vocabulary, negated=negated, version=version)
            case Defined(function):
                return self._ground(KnowledgeType.FUNCTION, function, vocabulary, negated=negated, version=version)
        return None

    def _function(self, question: Question, version: int) -> Point | None:
        vocabulary = self._vocabulary(version)
        expression = as_expression(question, vocabulary)
        if vocabulary.domain is None or len(expression) != 1 or not isinstance(expression[0], Atom):
            return None
        return self._ground(KnowledgeType.FUNCTION, expression[0], vocabulary, negated=False, version=version)

    @staticmethod
    def _ground(
        kind: KnowledgeType, atom: Atom, vocabulary: Vocabulary, *, negated: bool, version: int
    ) -> Point | None:
        if any(map(is_wildcard, atom.arguments)):
            return None
        name, arguments = vocabulary.ordered(kind, atom.name, atom.arguments, ())
        return Point(kind, " ".join(map(key, (name, *arguments))), negated=negated, version=version)
