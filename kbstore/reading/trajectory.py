"""Reads what held over a span of time: the `Trajectory` on which `when` is computed.

It reads only the timelines that a condition refers to, from the assertion that holds at the start of the span.
"""

from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from functools import cached_property

from kbstore.clock import OPEN, SECOND
from kbstore.errors import InvalidKnowledge, NotLinear, UnknownSymbol
from kbstore.evaluation.argument_types import NamedArgument, wrong_type
from kbstore.evaluation.interpretation import Arguments, Number, Span
from kbstore.evaluation.intervals import Intervals, merged
from kbstore.evaluation.snapshot import is_of
from kbstore.evaluation.trajectory_views import TrajectoryAt
from kbstore.evaluation.wellformed import check
from kbstore.evaluation.when import intervals
from kbstore.messages import KnowledgeType, Truth
from kbstore.model.domain import Domain
from kbstore.model.formulas import Formula, Not
from kbstore.model.lifespans import Lifespan, joined
from kbstore.model.results import AsOf
from kbstore.model.symbols import SymbolTable
from kbstore.model.timelines import Identity, Role, Timeline, Value, atom_key
from kbstore.names import key
from kbstore.pddl.printer import condition_text
from kbstore.planning.simulator import TimelineEvent
from kbstore.reading.prepared import PreparedCondition
from kbstore.reading.questions import Question
from kbstore.reading.reader import Reader
from kbstore.reading.resolver import TemporalPoint
from kbstore.storage.records import RecordedAssertion
from kbstore.storage.repository import Repository

Piece = tuple[int, int, Value, int]
"""Start, end, value, and the initial time of the assertion; times in nanoseconds."""

MINUTE = 60 * SECOND
"""The span that `since_when` looks back at first, in nanoseconds."""


class StoredTrajectory:
    """The assertions over a span, under one version of the domain; after now, the expected ones (rule O3)."""

    def __init__(
        self,
        reader: Reader,
        repository: Repository,
        now: TemporalPoint,
        span: Span,
        domain: Domain | None,
    ) -> None:
        self.span = span
        self.domain = domain
        self.use_unknowns = reader.use_unknowns
        self._reader = reader
        self._repository = repository
        self._point = now
        self._pieces: dict[Identity, list[Piece]] = {}

    # -- the trajectory --------------------------------------------------------------------------------------

    def signs(self, name: str, arguments: Arguments) -> Sequence[tuple[int, int, bool]]:
        """Return the pieces in which one fact is asserted or explicitly false, each with its sign."""
        pieces = self._of_key(KnowledgeType.FACT, atom_key((name, *arguments)))
        return [(start, end, not value[0]) for start, end, value, _ in pieces]

    def all_signs(self, name: str) -> Mapping[Arguments, Sequence[tuple[int, int, bool]]]:
        """Return these pieces for every fact of a predicate that has some in the span."""
        timelines = self._repository.of_symbol(Role.STATE, KnowledgeType.FACT, name)
        expected = [identity for identity in self._expected if _is_of_symbol(identity, name)]
        self._load(timelines)
        identities = dict.fromkeys((*(timeline.identity for timeline in timelines), *expected))
        found = {}
        for identity in identities:
            pieces = self._with_expected(identity)
            if pieces:
                found[tuple(identity.key.split(" ")[1:])] = [
                    (start, end, not value[0]) for start, end, value, _ in pieces
                ]
        return found

    def numbers(self, name: str, arguments: Arguments) -> Sequence[tuple[int, int, Number]]:
        """Return the pieces in which one numeric function is defined."""
        pieces = self._of_key(KnowledgeType.FUNCTION, atom_key((name, *arguments)))
        return [(start, end, Number(value[1], value[3], since)) for start, end, value, since in pieces]

    def lifespans(self, types: Iterable[str]) -> Mapping[str, Sequence[Span]]:
        """Return the objects that exist somewhere in the span and are of one of the types, with their lifespans."""
        wanted = list(types)
        return {
            name: spans
            for name, pieces in self._objects.items()
            if (spans := [(start, end) for start, end, kind in pieces if is_of(self.domain, kind, wanted)])
        }

    def lifespan(self, name: str) -> Sequence[tuple[int, int, str]]:
        """Return the spans in which an object exists, each with its type; a constant exists for the whole span."""
        constant = self._constants.get(name)
        if constant is not None:
            return [(*self.span, constant)]
        return _existences(self._of_key(KnowledgeType.INSTANCE, name))

    @cached_property
    def _constants(self) -> Mapping[str, str]:
        return {} if self.domain is None else self.domain.constant_types

    @cached_property
    def _objects(self) -> dict[str, Sequence[tuple[int, int, str]]]:
        self._load(self._repository.of_kind(Role.STATE, KnowledgeType.INSTANCE))
        found: dict[str, Sequence[tuple[int, int, str]]] = {
            name: [(*self.span, type_name)] for name, type_name in self._constants.items()
        }
        for identity in list(self._pieces):
            if identity.kind is KnowledgeType.INSTANCE and identity.key not in found:
                existences = _existences(self._with_expected(identity))
                if existences:
                    found[identity.key] = existences
        return found

    # -- pieces -----------------------------------------------------------------------------------------------

    def _of_key(self, kind: KnowledgeType, name: str) -> list[Piece]:
        identity = Identity(Role.STATE, kind, name)
        if identity not in self._pieces:
            self._load(self._repository.find(Role.STATE, kind, [name]).values())
        return self._with_expected(identity)

    def _load(self, timelines: Iterable[Timeline]) -> None:
        """Read what held on timelines in the span, all of one knowledge type."""
        missing = [timeline for timeline in timelines if timeline.identity not in self._pieces]
        if not missing:
            return
        start, end = self.span
        by_timeline: dict[Identity, list[RecordedAssertion]] = defaultdict(list)
        for row in self._repository.history(missing[0].kind, missing, start, end, self._upto):
            if row.is_known and row.end_time > max(start, row.initial_time):
                by_timeline[row.timeline.identity].append(row)
        for timeline in missing:
            rows = sorted(by_timeline[timeline.identity], key=lambda row: row.initial_time)
            self._pieces[timeline.identity] = [
                (max(start, row.initial_time), min(end, row.end_time), row.value, row.initial_time) for row in rows
            ]

    @cached_property
    def _upto(self) -> int | None:
        return self._reader.resolver.known_by(self._repository, self._point)

    def _with_expected(self, identity: Identity) -> list[Piece]:
        """Return the pieces of a timeline; if something runs, those after now are the expected ones."""
        stored = self._pieces.get(identity, [])
        now = self._point.system_time.time
        if not self._projects:
            return stored
        start, end = self.span
        pieces: list[Piece] = []
        for piece in stored:
            if piece[0] <= now:
                pieces.append(piece)
        events = [(event.time, event.value) for event in self._expected.get(identity, ())]
        if pieces and pieces[-1][1] > now:
            first = events[0][0] if events else OPEN
            pieces[-1] = (pieces[-1][0], min(end, first), pieces[-1][2], pieces[-1][3])
        for index, (t, value) in enumerate(events):
            until = min(end, events[index + 1][0] if index + 1 < len(events) else OPEN)
            if value is not None and until > max(t, start):
                pieces.append((max(t, start), until, value, t))
        return [piece for piece in pieces if piece[1] > piece[0]]

    @cached_property
    def _projects(self) -> bool:
        now = self._point.system_time.time
        return self.span[1] > now + 1 and bool(
            self._reader.running(self._repository, self._point.system_time, self._point.head)
        )

    @cached_property
    def _expected(self) -> dict[Identity, list[TimelineEvent]]:
        """The changes that are expected after now, by timeline."""
        found: dict[Identity, list[TimelineEvent]] = defaultdict(list)
        if self._projects:
            state = self._reader.state(self._repository, self._point)
            for event in state.projection().advance(self.span[1]):
                found[event.timeline.identity].append(event)
        return found


def when_true(
    reader: Reader,
    repository: Repository,
    condition: Question,
    since: int,
    until: int,
    as_of: AsOf | None = None,
) -> Intervals:
    """Return the maximal intervals in ``[since, until)`` in which a condition is true (rule Q4), as of a time.

    Each version of the domain counts for its part of the span. A symbol must be known to one of them (rule D4); under
    the others nothing is asserted of it. Raises `InvalidKnowledge` if an object is of a wrong type throughout (V10).
    """
    found: list[Span] = []
    first, last, now = reader.resolver.resolve_span(repository, since, until, as_of)
    upto = reader.resolver.known_by(repository, now)
    parts = list(reader.domains.within(repository, now.head, first, last, upto))
    prepared, checked = _prepared(reader, condition, [symbol_table for _, _, symbol_table in parts])
    formula = prepared.formula
    misfits: dict[NamedArgument, InvalidKnowledge | None] = {}
    for start, end, symbol_table in parts:
        domain = symbol_table.domain
        if domain is not None and end > now.valid_time + 1:
            domain = domain.forecast
        if domain is not checked:
            with suppress(UnknownSymbol):
                check(formula, domain)
        trajectory = StoredTrajectory(reader, repository, now, (start, end), symbol_table.domain)
        for use in prepared.named:
            _note_types(use, trajectory, misfits)
        found += intervals(formula, trajectory)
    for error in misfits.values():
        if error is not None:
            raise error
    return merged(found)


def _note_types(
    use: NamedArgument, trajectory: StoredTrajectory, misfits: dict[NamedArgument, InvalidKnowledge | None]
) -> None:
    """Note the error for an object that exists in a span with a wrong type; None once it fits anywhere (rule V10)."""
    domain = trajectory.domain
    for start, _, type_name in trajectory.lifespan(use.name) if domain is not None else ():
        assert domain is not None
        if domain.is_subtype(type_name, use.types):
            misfits[use] = None
        elif use not in misfits:
            misfits[use] = wrong_type(use, type_name, TrajectoryAt(trajectory, start).type_of, domain)


def since_when(
    reader: Reader, repository: Repository, condition: Formula, truth: Truth, at: int, *, guess: int
) -> int | None:
    """Return the time since which a condition has had, without interruption, its truth value at the time `at`.

    0 if it always had; None if that cannot be computed (rule Q4, `NotLinear`). History is read from `guess` on, and
    from ever earlier times until the change is found, so a guess shortly before the change saves time. Raises
    `HistoryUnavailable` if the change is before the history in the store (rule Q7).
    """
    head = repository.head()
    begin = head.history_from
    length = max(at - guess, MINUTE)
    while True:
        first = max(begin, at - length)
        try:
            since = _since_within(reader, repository, condition, truth, (first, at + 1))
        except (NotLinear, InvalidKnowledge):
            return None
        if since > first:
            return since
        if first == begin:
            if begin:
                raise reader.resolver.archived(f"since when {condition_text(condition)} is {truth.name.lower()}", head)
            return 0
        length *= 32


def _since_within(reader: Reader, repository: Repository, condition: Formula, truth: Truth, span: Span) -> int:
    """Return the time since which a condition has had its truth value at the end of a span; at least its start."""
    first, at = span[0], span[1] - 1

    def true_in(condition: Formula) -> Intervals:
        return when_true(reader, repository, condition, *span)

    if truth is Truth.UNKNOWN:
        known = [*true_in(condition), *true_in(Not(condition))]
        return min(max((end for _, end in known), default=first), at)
    same = true_in(condition if truth is Truth.TRUE else Not(condition))
    # the truth may come from an open transaction, whose changes are not in the store yet
    return same[-1][0] if same and same[-1][1] > at else at


def _prepared(
    reader: Reader, condition: Question, symbol_tables: Sequence[SymbolTable]
) -> tuple[PreparedCondition, Domain | None]:
    """Prepare a condition under the latest version of the domain that knows its symbols; return it and that domain."""
    # before the first domain any symbol is accepted; that does not make it known
    declared = [symbol_table for symbol_table in symbol_tables if symbol_table.domain is not None]
    refusal: UnknownSymbol | None = None
    for symbol_table in reversed(declared or symbol_tables):
        try:
            return reader.questions.condition(condition, symbol_table), symbol_table.domain
        except UnknownSymbol as error:
            refusal = refusal or error
    assert refusal is not None
    raise refusal


def _is_of_symbol(identity: Identity, name: str) -> bool:
    return (
        identity.role is Role.STATE
        and identity.kind is KnowledgeType.FACT
        and (identity.key == name or identity.key.startswith(f"{name} "))
    )


def _existences(pieces: Iterable[Piece]) -> list[Lifespan]:
    return joined(Lifespan(start, end, key(value[1])) for start, end, value, _ in pieces if not value[0])
