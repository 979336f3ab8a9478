"""Explains why something holds, or does not: the reason, since when, and the transaction that made it so (rule V6)."""

from collections.abc import Mapping, Sequence
from typing import Protocol

from kbstore.evaluation import conditions
from kbstore.evaluation.argument_types import check_types
from kbstore.evaluation.interpretation import Interpretation
from kbstore.messages import KnowledgeType, Truth, format_number
from kbstore.model import formulas
from kbstore.model.domain import Domain
from kbstore.model.expressions import atoms_of
from kbstore.model.results import Explanation, Transaction
from kbstore.model.symbols import SymbolTable
from kbstore.model.timelines import EndCause, Identity, Role, StateRow, atom_key, number_at
from kbstore.names import is_wildcard, key
from kbstore.pddl.printer import condition_text
from kbstore.planning.simulator import TimelineEvent
from kbstore.reading.history import History
from kbstore.reading.questions import Question
from kbstore.reading.reader import Reader
from kbstore.reading.trajectory import since_when
from kbstore.storage.records import LogPosition, RecordedAssertion
from kbstore.storage.repository import Repository

_ENDED = {
    EndCause.OBJECT: "expired with its instance",
    EndCause.REMOVED: "removed",
    EndCause.CLEARED: "removed",
    EndCause.REPLACED: "removed",
    EndCause.RUN: "removed",
}


class Rows(Interpretation, Protocol):
    """An interpretation that has the assertions themselves."""

    def row(self, kind: KnowledgeType, name: str) -> StateRow | None:
        """The assertion that holds on one timeline of the state."""


class Explained(Protocol):
    """A state that can be explained: a whole `State`, or an `ExplainedPoint`, which reads only what it needs."""

    @property
    def at(self) -> int:
        """The time, in nanoseconds."""

    @property
    def belief(self) -> LogPosition | None:
        """The position in the log whose belief it is; None if it is not a belief of the past."""

    @property
    def draft(self) -> Mapping[Identity, EndCause] | None:
        """What an open transaction has ended, by timeline, and why; None for a state that is on record."""

    @property
    def domain(self) -> Domain | None:
        """The domain at that time."""

    @property
    def snapshot(self) -> "Rows":
        """The assertions that hold."""

    def explain(self, question: Question) -> Explanation:
        """Explain why a fact or condition is true, false or unknown."""


class ExplainedPoint:
    """The state at an interpretation's time, as it is known now."""

    belief: LogPosition | None = None
    draft: Mapping[Identity, EndCause] | None = None

    def __init__(self, explainer: "Explainer", world: Rows) -> None:
        self.snapshot = world
        self.at = world.time
        self.domain = world.domain
        self._explainer = explainer

    def explain(self, question: Question) -> Explanation:
        """Explain why a fact or condition is true, false or unknown."""
        return self._explainer.explain(self, question)


class Explainer:
    """Explains the states of one knowledge base."""

    def __init__(self, reader: Reader, history: History) -> None:
        self._reader = reader
        self._history = history

    def explain(self, state: Explained, question: Question) -> Explanation:
        """Explain why a fact or condition is true, false or unknown in a state.

        Raises `HistoryUnavailable` if the reason lies before the history in the store.
        """
        with self._reader.repository() as repository:
            head = repository.head()
            for asked in (state.at, state.at if state.belief is None else state.belief.time):
                self._reader.resolver.refuse_archived(asked, head)
            prepared = self._reader.questions.condition(question, SymbolTable(state.domain))
            check_types(prepared.named, state.snapshot.type_of, state.domain)
            return self._condition(repository, state, prepared.formula)

    def _condition(self, repository: Repository, state: Explained, condition: formulas.Formula) -> Explanation:
        truth = conditions.truth(condition, state.snapshot)
        match condition:
            case formulas.Atom() if not any(map(is_wildcard, condition.arguments)):
                return self._atom(repository, state, condition, truth)
            case formulas.Not(part):
                inner = self._condition(repository, state, part)
                text = condition_text(condition)
                return Explanation(text, truth, inner.reason, inner.since, inner.transaction, inner.parts)
            case formulas.Defined(function):
                return self._ground(
                    repository, state, condition_text(condition), truth, KnowledgeType.FUNCTION, function
                )
            case formulas.Comparison():
                return self._comparison(repository, state, condition, truth)
            case formulas.IsA():
                return self._object(repository, state, condition, truth)
        parts = [
            self._condition(repository, state, part)
            for part, _ in conditions.deciding(condition, state.snapshot)
            if part != condition
        ]
        return self._summary(repository, state, condition, truth, parts)

    def _atom(self, repository: Repository, state: Explained, atom: formulas.Atom, truth: Truth) -> Explanation:
        if state.domain is not None and state.domain.is_derived(atom.name):
            reason = {
                Truth.TRUE: "derived by the domain's rules",
                Truth.FALSE: "not derivable by the domain's rules",
                Truth.UNKNOWN: "not derivable from what is known",
            }[truth]
            return self._summary(repository, state, atom, truth, (), reason)
        return self._ground(repository, state, str(atom), truth, KnowledgeType.FACT, atom)

    def _comparison(
        self, repository: Repository, state: Explained, condition: formulas.Comparison, truth: Truth
    ) -> Explanation:
        parts = []
        for function in dict.fromkeys(atoms_of((*condition.left, *condition.right))):
            number = state.snapshot.number(key(function.name), tuple(map(key, function.arguments)))
            text = str(function) if number is None else f"(= {function} {format_number(number.at(state.at))})"
            defined = Truth.of(number is not None)
            parts.append(self._ground(repository, state, text, defined, KnowledgeType.FUNCTION, function))
        undefined = [part for part in parts if part.truth is Truth.FALSE]
        if truth is Truth.UNKNOWN:
            reason = "undefined function" if undefined else "divides by zero"
            return self._summary(repository, state, condition, truth, undefined or parts, reason)
        return self._summary(repository, state, condition, truth, parts, "by the values of its functions")

    def _object(self, repository: Repository, state: Explained, condition: formulas.IsA, truth: Truth) -> Explanation:
        text = condition_text(condition)
        if state.domain is not None and state.domain.constant_spelling(condition.name) is not None:
            return Explanation(text, truth, f"a constant of the domain {state.domain.name}")
        rows = self._rows(repository, state, KnowledgeType.INSTANCE, key(condition.name))
        drafted = self._drafted(state, text, truth, rows, KnowledgeType.INSTANCE, key(condition.name))
        found = drafted or self._of_row(repository, state, text, truth, rows, "never told")
        if truth is Truth.FALSE and found.reason == "asserted":
            reason = f"an object of type {state.snapshot.type_of(key(condition.name))}"
            return Explanation(text, truth, reason, found.since, found.transaction)
        return found

    def _summary(
        self,
        repository: Repository,
        state: Explained,
        condition: formulas.Formula,
        truth: Truth,
        parts: Sequence[Explanation],
        reason: str = "",
    ) -> Explanation:
        """Explain a condition by the parts that decide it.

        Usually its truth is as old as the latest of these parts. It may be older, or constant, if other parts decided
        it before; or later, as numbers move by the clock, and quantified objects come and go.
        """
        since = max((part.since for part in parts if part.since is not None), default=None)
        transaction = next((part.transaction for part in parts if part.since == since and since is not None), None)
        is_constant = isinstance(condition, formulas.Same | formulas.Truism)
        if state.draft is not None and self._truth_before(repository, state, condition) is not truth:
            since, transaction = state.at, None
        elif state.belief is None and not is_constant:
            guess = state.at if since is None else since
            turned = since_when(self._reader, repository, condition, truth, state.at, guess=guess)
            if turned == 0:
                # it was never different, although the parts that decide it now were
                since = transaction = None
            elif turned is not None and since is not None and turned < since:
                # other parts decided it before; the explanation at that time has the transaction
                first = self._reader.state(repository, self._reader.resolver.resolve(repository, turned))
                since, transaction = turned, self._condition(repository, first, condition).transaction
            elif turned is not None and turned != since:
                since, transaction = turned, self._transaction_of(repository, turned) or transaction
        if not reason:
            composed = "decided by its parts" if parts else "always so" if is_constant else "by all its objects"
            reason = parts[0].reason if len(parts) == 1 else composed
        return Explanation(condition_text(condition), truth, reason, since, transaction, tuple(parts))

    def _truth_before(self, repository: Repository, state: Explained, condition: formulas.Formula) -> Truth:
        """Return the truth of a condition without what an open transaction has changed."""
        point = self._reader.resolver.resolve(repository, state.at)
        return conditions.truth(condition, self._reader.world(repository, point, state.domain))

    def _transaction_of(self, repository: Repository, t: int) -> Transaction | None:
        """Return the transaction of a time; None if there was none, or more than one."""
        number = repository.first_transaction_from(t)
        if number is None:
            return None
        found = self._history.transactions(repository, [number, number + 1])
        return found[number] if [number] == [n for n, one in found.items() if one.time == t] else None

    # -- rows -------------------------------------------------------------------------------------------------

    def _ground(
        self,
        repository: Repository,
        state: Explained,
        text: str,
        truth: Truth,
        kind: KnowledgeType,
        atom: formulas.Atom,
    ) -> Explanation:
        """Explain the truth of a ground fact, or why a ground function is defined or not."""
        name = atom_key([key(name) for name in (atom.name, *atom.arguments)])
        event = self._expected(repository, state, Identity(Role.STATE, kind, name))
        if event is not None and event.run is not None:
            started = self._transaction_of(repository, event.run.started)
            return Explanation(text, truth, f"expected at the end of {event.run.action}", event.time, started)
        absent = "never told" if kind is KnowledgeType.FACT else "undefined function"
        rows = self._rows(repository, state, kind, name)
        drafted = self._drafted(state, text, truth, rows, kind, name)
        return drafted or self._of_row(repository, state, text, truth, rows, absent)

    @staticmethod
    def _drafted(
        state: Explained, text: str, truth: Truth, rows: Sequence[RecordedAssertion], kind: KnowledgeType, name: str
    ) -> Explanation | None:
        """Explain what an open transaction has changed itself; it has no number yet. None for anything else."""
        if state.draft is None:
            return None
        held = state.snapshot.row(kind, name)
        last = rows[-1] if rows else None
        stored = None if last is None or last.superseded is not None or last.end_time <= state.at else last
        if held is None:
            if stored is None:
                return None
            reason = _reason(state.draft.get(Identity(Role.STATE, kind, name), EndCause.REMOVED), kind)
            return Explanation(text, truth, reason, state.at)
        since, value = held[1:]
        if stored is not None:
            if kind is not KnowledgeType.FUNCTION and value == stored.value:
                return None
            if kind is KnowledgeType.FUNCTION and number_at(value, since, state.at) == number_at(
                stored.value, stored.initial_time, state.at
            ):
                return None
        is_negated = value[0] and kind is not KnowledgeType.INSTANCE
        reason = "explicitly false" if is_negated else "removed" if value[0] else "asserted"
        return Explanation(text, truth, reason, since)

    def _expected(self, repository: Repository, state: Explained, identity: Identity) -> TimelineEvent | None:
        """Return the last expected change of a timeline up to the state's time; None if there is none (rule O3)."""
        head = repository.head()
        belief = state.belief or LogPosition(self._reader.resolver.now(head))
        if state.at <= belief.time or not self._reader.running(repository, belief, head):
            return None
        believed = self._reader.state(repository, self._reader.resolver.at_position(head, belief))
        events = believed.projection().advance(state.at)
        return next((event for event in reversed(list(events)) if event.timeline.identity == identity), None)

    def _rows(
        self, repository: Repository, state: Explained, kind: KnowledgeType, name: str
    ) -> Sequence[RecordedAssertion]:
        """Return the latest rows of a timeline that begin by the state's time, as they were believed then."""
        timeline = repository.find(Role.STATE, kind, [name]).get(name)
        if timeline is None:
            return ()
        head = repository.head()
        upto = None if state.belief is None else self._reader.resolver.last_number(repository, state.belief)
        rows = repository.history(kind, [timeline], state.at, state.at + 1, upto)
        known = [row for row in rows if row.is_known]
        if not known and not head.history_from:
            # late knowledge superseded them all
            known = [row for row in rows if row.superseded is not None]
        if not known and head.history_from:
            # the timeline is still there, but its assertions may have been archived
            raise self._reader.resolver.archived(f"what was recorded of ({timeline.spelling})", head)
        return sorted(known, key=lambda row: (row.initial_time, row.recorded))

    def _of_row(
        self,
        repository: Repository,
        state: Explained,
        text: str,
        truth: Truth,
        rows: Sequence[RecordedAssertion],
        absent: str,
    ) -> Explanation:
        if not rows:
            return Explanation(text, truth, absent)
        row = rows[-1]
        number: int | None
        if row.superseded is not None:
            latest = max(rows, key=lambda row: row.superseded or 0)
            number, reason, since = latest.superseded, "removed", latest.initial_time
        elif row.end_time > state.at:
            number = row.first_recorded or row.recorded
            reason, since = ("explicitly false" if row.value[0] else "asserted"), row.initial_time
            if row.timeline.kind is KnowledgeType.INSTANCE and row.value[0]:
                reason = "removed"
        else:
            ((number, cause),) = self._history.enders(repository, [row])
            reason, since = _reason(cause, row.timeline.kind), row.end_time
        transactions = self._history.transactions(repository, [] if number is None else [number])
        return Explanation(text, truth, reason, since, transactions.get(number or 0))


def _reason(cause: EndCause, kind: KnowledgeType) -> str:
    reason = _ENDED[cause]
    return (
        f"undefined function: {reason}" if kind is KnowledgeType.FUNCTION and cause is not EndCause.OBJECT else reason
    )
