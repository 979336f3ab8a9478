"""Reads runs of durative actions, and when their invariants (over-all conditions) were broken (rules O6, Q8)."""

from collections.abc import Iterator, Mapping, Sequence
from itertools import groupby

from kbstore.clock import OPEN, TimeLike
from kbstore.errors import InvalidKnowledge, KbStoreError, NotLinear, UnknownSymbol
from kbstore.evaluation.interpretation import Arguments
from kbstore.evaluation.snapshot import Snapshot
from kbstore.evaluation.when import truths
from kbstore.messages import KnowledgeType, Truth
from kbstore.model.domain import Domain
from kbstore.model.formulas import Atom, Formula, Timing
from kbstore.model.results import AsOf, Broken, Run
from kbstore.model.symbols import arity_problem
from kbstore.model.timelines import Identity, Role, Value, atom_key, fact_value
from kbstore.names import check_is_text, key, matches
from kbstore.pddl.printer import condition_text
from kbstore.planning import effects
from kbstore.planning.grounding import GroundAction
from kbstore.reading.reader import Reader, as_run
from kbstore.reading.trajectory import Piece, StoredTrajectory
from kbstore.storage.records import Head, LogPosition, RunRow
from kbstore.storage.repository import Repository

TruthPiece = tuple[int, int, Truth]
"""Start, end (nanoseconds), and the truth in between."""


class Runs:
    """Reads the runs of one knowledge base."""

    def __init__(self, reader: Reader) -> None:
        self._reader = reader

    def within(
        self, pattern: str | None, since: TimeLike | None, until: TimeLike | None, as_of: AsOf | None
    ) -> list[Run]:
        """Return the runs that match a pattern and meet ``[since, until)``, in the order of their starts (rule Q8)."""
        with self._reader.repository() as repository:
            begin = repository.head().history_from if since is None else since
            first, last, _ = self._reader.resolver.resolve_span(repository, begin, until)
            wanted = None if pattern is None else self._keys(repository, pattern, first, last)
            believed = self._reader.resolver.resolve(repository, None, as_of).system_time
            return [
                self._run(repository, row)
                for stored in repository.runs_between(first, last)
                if (row := _as_of(stored, believed)) is not None and (wanted is None or _matches(wanted, row))
            ]

    def broken(self, run: Run, *, kept: bool = False) -> list[Broken]:
        """Return the over-all conditions of a run that were not true, each with the spans in which they were not.

        With `kept`, only within the history that has not been archived; otherwise all of it is needed (rule Q7).
        """
        if not isinstance(run, Run):
            raise InvalidKnowledge(f"{run!r:.80} is not a run; give what start() returned, or one of kb.runs()")
        with self._reader.repository() as repository:
            row = repository.run(run.number)
            if row is None or row.started != run.started:
                raise InvalidKnowledge(f"{run} is not a run of {self._reader.name}; give what start() returned")
            return self._broken(repository, row, kept=kept)

    def beginning(self, repository: Repository, first: int, last: int) -> list[Broken]:
        """Return the invariants that break at a time in ``[first, last]``, in the order of these times."""
        found = [
            broken
            for row in repository.runs_between(first, last + 1)
            for broken in self._broken(repository, row, kept=True)
            if first <= broken.since <= last
        ]
        return sorted(found, key=lambda broken: broken.since)

    def _run(self, repository: Repository, row: RunRow) -> Run:
        return as_run(row, tuple(self._broken(repository, row, kept=True)))

    def _broken(self, repository: Repository, row: RunRow, *, kept: bool) -> list[Broken]:
        """Evaluate the over-all conditions over ``[started, ended)``, under the domain of each time (rule O6)."""
        now = self._reader.resolver.resolve(repository)
        head, last = now.head, min(row.end_time, now.valid_time + 1)
        first = max(row.started, head.history_from) if kept else row.started
        pieces: dict[str, list[TruthPiece]] = {}
        unwritten = self._unwritten(repository, row, head)
        if first < last:
            self._reader.resolver.refuse_archived(first, head)
        for start, end, symbols in self._reader.domains.within(repository, head, first, last):
            domain = symbols.domain
            if domain is None or first >= last:
                continue
            trajectory = _RunTrajectory(self._reader, repository, now, (start, end), domain)
            trajectory.started, trajectory.unwritten = row.started, unwritten
            for condition in _invariants(domain, row):
                try:
                    found = truths(condition, trajectory, duration=row.duration_s)
                except (NotLinear, InvalidKnowledge, UnknownSymbol):
                    # not decidable under this version of the domain
                    found = [(start, end, Truth.UNKNOWN)]
                pieces.setdefault(condition_text(condition), []).extend(found)
        is_open = row.end_time == OPEN
        return sorted(
            (
                Broken(text, truth, start, None if is_open and end == last else end, row.number)
                for text, found in pieces.items()
                for start, end, truth in _joined(found)
                if truth is not Truth.TRUE
            ),
            key=lambda broken: broken.since,
        )

    def _unwritten(self, repository: Repository, row: RunRow, head: Head) -> dict[Identity, Value]:
        """Return the values that the at-start effects of a run would have given to sensed symbols (rule O8).

        The effects are evaluated on the state before the start; if that has been archived, on an empty one, which
        leaves the unconditional ones.
        """
        position = repository.after_transaction(row.recorded - 1, row.started)
        domain = self._reader.domains.symbol_table(repository, head, position).domain
        action = None if domain is None or not domain.sensed else _ground(domain, row)
        if domain is None or action is None:
            return {}
        world = Snapshot(row.started, {}, domain, self._reader.use_unknowns)
        if row.started >= head.history_from:
            point = self._reader.resolver.at_position(head, position)
            world = self._reader.state(repository, point).snapshot
        try:
            found = effects.evaluate(action, Timing.AT_START, world, duration=row.duration_s)
        except KbStoreError:
            return {}
        return {
            Identity(Role.STATE, kind, atom_key((atom.name, *atom.arguments))): value or fact_value(is_negative=True)
            for kind, atom, value in effects.outcome(found, world, lambda function: 0.0)
            if atom.name in domain.sensed
        }

    def _keys(self, repository: Repository, pattern: str, first: int, last: int) -> Sequence[str]:
        """Return the words of a pattern, or its single name, as keys.

        Raises `UnknownSymbol` or `InvalidKnowledge` unless a version of the domain in the span has such an action.
        """
        check_is_text("pattern of runs", pattern)
        text = pattern.strip()
        if text.startswith("(") != text.endswith(")") or not text.strip("()"):
            raise InvalidKnowledge(
                f"{pattern!r:.80} is not a pattern of runs; write one like (goto kenny ? ?), or goto"
            )
        words = text.strip("()").split()
        refusal: UnknownSymbol | InvalidKnowledge | None = None
        for _, _, symbols in self._reader.domains.within(repository, repository.head(), first, last):
            if symbols.domain is None:
                continue
            try:
                action = symbols.domain.action(words[0])
            except UnknownSymbol as error:
                refusal = refusal or error
                continue
            problem = arity_problem(Atom(action.name, tuple(words[1:])), action) if text.startswith("(") else None
            if problem is None:
                return [*map(key, words)]
            refusal = refusal or InvalidKnowledge(problem)
        if refusal is not None:
            raise refusal
        return [*map(key, words)]


class _RunTrajectory(StoredTrajectory):
    """The stored trajectory with the at-start effects of a run on sensed symbols, as if they were written (rule O8).

    They count until the next assertion on their timelines.
    """

    started: int
    unwritten: Mapping[Identity, Value]

    def all_signs(self, name: str) -> Mapping[Arguments, Sequence[tuple[int, int, bool]]]:
        """Return the pieces of every fact of a predicate, those of unwritten effects included."""
        found = dict(super().all_signs(name))
        for identity in self.unwritten:
            predicate, *arguments = identity.key.split(" ")
            if identity.kind is KnowledgeType.FACT and predicate == name:
                found[tuple(arguments)] = self.signs(name, tuple(arguments))
        return found

    def _with_expected(self, identity: Identity) -> list[Piece]:
        pieces = super()._with_expected(identity)
        if identity not in self.unwritten:
            return pieces
        start, end = self.span
        later = [piece for piece in pieces if piece[3] > self.started]
        until = later[0][0] if later else end
        value = self.unwritten[identity]
        return [(start, until, value, self.started), *later] if start < until else later


def _as_of(row: RunRow, believed: LogPosition) -> RunRow | None:
    """Return a run as it was on record at a position: one that ended later was running; None if it had not begun."""
    number, time = believed.number, believed.time
    if row.started > time or (number is not None and row.recorded > number):
        return None
    ended_later = row.end_time != OPEN and (row.end_time > time or (number is not None and (row.ended or 0) > number))
    return row._replace(end_time=OPEN, outcome=None, ended=None) if ended_later else row


def _matches(wanted: Sequence[str], row: RunRow) -> bool:
    keys = [key(name) for name in (row.operator, *row.arguments)]
    return keys[:1] == list(wanted) if len(wanted) == 1 else matches(wanted, keys)


def _ground(domain: Domain, row: RunRow) -> GroundAction | None:
    """Return the action of a run with its objects, whether they exist or not; None if the domain does not have it."""
    try:
        action = domain.action(row.operator)
    except UnknownSymbol:
        return None
    names = [key(parameter.name) for parameter in action.parameters]
    return GroundAction(action, row.arguments, dict(zip(names, map(key, row.arguments), strict=False)))


def _invariants(domain: Domain, row: RunRow) -> Sequence[Formula]:
    """Return the over-all conditions of a run, with its objects for their variables."""
    action = _ground(domain, row)
    return [] if action is None else action.conditions(Timing.OVER_ALL)


def _joined(pieces: Sequence[TruthPiece]) -> Iterator[TruthPiece]:
    """Yield the pieces with adjacent ones of the same truth value joined."""
    for truth, group in groupby(pieces, key=lambda piece: piece[2]):
        same = list(group)
        yield same[0][0], same[-1][1], truth
