"""Unit of work: takes the write lock, fixes now, collects the updates of a transaction, and stores them together."""

import json
import os
import threading
from collections.abc import Callable, Iterable, Sequence
from contextlib import AbstractContextManager
from functools import cached_property
from hashlib import sha256
from types import TracebackType
from typing import Self, TypeVar

from kbstore.clock import DurationLike, TimeLike, isoformat, time
from kbstore.errors import Conflict, InvalidKnowledge, StoreUnavailable
from kbstore.interop.up_loading import PlanningProblem, sources
from kbstore.messages import KnowledgeType, UpdateType
from kbstore.messages.gc_pause import gc_paused
from kbstore.model.domain import Domain
from kbstore.model.results import Applicability, Run, Transaction
from kbstore.model.symbols import SymbolTable
from kbstore.model.timelines import Role, Timeline
from kbstore.names import check_text
from kbstore.pddl.domain_reader import read_domain
from kbstore.pddl.problem_reader import read_problem
from kbstore.pddl.sexpr import SourceText
from kbstore.reading.mentions import mentions
from kbstore.reading.questions import Knowledge, Question
from kbstore.reading.reader import Reader
from kbstore.reading.state import State
from kbstore.storage.records import DomainRow, LogPosition, SymbolRow
from kbstore.storage.repository import Repository
from kbstore.writing.action_executor import ActionExecutor, applicability
from kbstore.writing.change_set import ChangeSet
from kbstore.writing.compatibility import violations
from kbstore.writing.flush import Flush
from kbstore.writing.handlers import Handlers
from kbstore.writing.late_handlers import LateHandlers, Version, late_span
from kbstore.writing.resolution import Violations
from kbstore.writing.updates import Batch, Item, closed_world_violations, goals_in, items_in, problem_batch
from kbstore.writing.working_state import WorkingState

Result = TypeVar("Result")


class OpenTransaction:
    """An open transaction, from `KnowledgeBase.transaction`: a context manager.

    Its updates apply in order, at one and the same now. Leaving the block stores them; leaving it by an exception
    stores nothing. `result` is the `Transaction` afterwards.
    """

    result: Transaction

    def __init__(
        self,
        reader: Reader,
        *,
        client: str = "",
        note: str = "",
        expect: int | None = None,
        validate: bool,
        refuse_writing: Callable[[], None],
        writing: threading.local,
    ) -> None:
        """`refuse_writing` raises if nothing may be written; `writing.open` says that a transaction is, in a thread."""
        for text, what in ((client, "client"), (note, "note")):
            check_text(text, what)
        self._reader = reader
        self._client = client
        self._note = note
        self._expect = expect
        self._validate = validate
        self._is_open = False
        self._refuse_writing = refuse_writing
        self._writing = writing
        self._context: AbstractContextManager[object] | None = None

    def __enter__(self) -> Self:
        self._refuse_writing()
        database, borrowed = self._reader.database, self._reader.borrowed
        context = database.begin() if borrowed is None else database.savepoint(borrowed)
        connection = context.__enter__()
        self._context = context
        try:
            self._begin(Repository(connection, self._reader.kb, self._reader.memory))
            self._is_open = self._writing.open = True
        except BaseException as error:
            self.__exit__(type(error), error, error.__traceback__)
            raise
        return self

    def _begin(self, repository: Repository) -> None:
        reader = self._reader
        # another block may have been left with this transaction before
        vars(self).pop("result", None)
        self._is_whole = True
        self._loads: list[str] = []
        self._repository = repository
        self._head = repository.head(for_update=True)
        if self._head.source is not None:
            raise StoreUnavailable(
                f"{reader.name} is a copy here, which only a push from its source writes to: {self._head.source}. "
                "Write there; or, if that is gone for good, make this copy the original: kbstore db adopt"
            )
        if self._expect is not None and self._head.number > self._expect:
            raise Conflict(
                f"transaction {self._head.number} has been committed, but nothing after {self._expect} was expected; "
                "read the state again, and decide anew"
            )
        self.now = reader.resolver.now_for_writing(self._head)
        position = LogPosition(self.now)
        symbols = reader.symbol_table(repository, self._head, position)
        self._domain, self._stored_inferred = symbols.domain, dict(symbols.inferred)
        self._change_set = ChangeSet(repository, self.now, mentions)
        running = reader.running(repository, position, self._head)
        self._executor = ActionExecutor(self._change_set, running, self._head.last_run)
        self._use_symbols(symbols)

    def _use_symbols(self, symbols: SymbolTable) -> None:
        handlers = Handlers(
            self._change_set,
            self._repository,
            symbols if self._validate else SymbolTable(None, {}),
            self._executor.abort_with,
        )
        self._symbols, self._handlers = symbols, handlers

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Store and commit; an error in storing rolls back, like one in the block. Nothing if it is not open."""
        context, self._context = self._context, None
        if context is None:
            return
        self._is_open = self._writing.open = False
        try:
            result = None
            try:
                if kind is None:
                    with gc_paused():
                        result = self._store()
            except BaseException as failure:
                context.__exit__(type(failure), failure, failure.__traceback__)
                raise
            context.__exit__(kind, error, trace)
            if result is not None:
                self.result = result
                self._repository.committed()
        finally:
            self._release()

    def _release(self) -> None:
        """Free the transaction's objects, before the garbage collector traverses all of them."""
        made = vars(self)
        for name in ("_change_set", "_executor", "_handlers", "_repository", "_working"):
            made.pop(name, None)

    def _open_handlers(self) -> Handlers:
        """Return the handlers. Raises `Conflict` outside of the block, where updates would be lost silently."""
        if not self._is_open:
            raise Conflict("a transaction is used inside its block only; begin one: with kb.transaction() as tx: ...")
        return self._handlers

    # -- storing ----------------------------------------------------------------------------------------------

    def _store(self) -> Transaction:
        """Write the changes, if there are any (rule C1), and return the transaction."""
        if not self._is_whole:
            raise InvalidKnowledge(
                "a load or an update has failed half-way in this transaction; nothing of it has been stored"
            )
        if self._reader.use_unknowns:
            self._handlers.end_uncertain()
        if not self._executor.is_idle:
            self._working.follow_rates(self._symbols.domain)
        writes = Flush(self._change_set, self._repository).rows()
        self._executor.write(writes)
        domain = self._symbols.domain
        if domain is not None and domain is not self._domain:
            writes.domain = DomainRow(domain.name, domain.source, json.dumps(sorted(domain.sensed)))
            writes.changes += 1
        if not writes.changes:
            return Transaction(self._head.number, self.now, self._client, self._note, 0)
        writes.symbols = [
            SymbolRow(int(kind), name_key, signature.name, signature.arity, " ".join(signature.labels or ()))
            for (kind, name_key), signature in self._symbols.inferred.items()
            if self._stored_inferred.get((kind, name_key)) != signature
        ]
        writes.timelines += [
            Timeline(0, Role.LOAD, KnowledgeType.EXPRESSION, digest, None)
            for digest in dict.fromkeys(self._loads)
            if not self._repository.find(Role.LOAD, KnowledgeType.EXPRESSION, [digest])
        ]
        head = self._repository.save(writes, self._head, self.now, client=self._client, note=self._note)
        return Transaction(head.number, self.now, self._client, self._note, writes.changes)

    def _atomically(self, act: Callable[[], Result]) -> Result:
        """Call a function; if it raises an error, undo everything that it changed, runs included (rule C1)."""
        # an interrupt, which may come at any point, is not undone: the transaction stores nothing then
        was_whole, self._is_whole = self._is_whole, False
        self._change_set.savepoint()
        runs, inferred = self._executor.copy(), dict(self._symbols.inferred)
        try:
            result = act()
        except Exception:
            self._change_set.roll_back()
            self._executor.restore(runs)
            self._symbols.inferred.clear()
            self._symbols.inferred.update(inferred)
            self._is_whole = was_whole
            raise
        self._is_whole = was_whole
        return result

    # -- updates ----------------------------------------------------------------------------------------------

    def add(
        self,
        *items: Knowledge,
        initial_time: TimeLike | None = None,
        since: TimeLike | None = None,
        until: TimeLike | None = None,
    ) -> None:
        """Add knowledge to the state; `initial_time` counts for items without one of their own.

        With `since`, a time that has passed, it is late knowledge (rule L1); with `until` it holds until then.
        """
        handlers, symbols = self._handlers_since(since, until)
        self._update(Role.STATE, items_in, handlers.add, items, initial_time, symbols)

    def remove(
        self,
        *items: Knowledge,
        initial_time: TimeLike | None = None,
        since: TimeLike | None = None,
        until: TimeLike | None = None,
    ) -> None:
        """Remove what holds and matches; with a time after now, cancel what is scheduled for it.

        With `since`, remove what matched at that time, or with `until` between the two (rule L3).
        """
        handlers, symbols = self._handlers_since(since, until)
        self._update(Role.STATE, items_in, handlers.remove, items, initial_time, symbols)

    def add_goal(
        self,
        *goals: Knowledge,
        initial_time: TimeLike | None = None,
        since: TimeLike | None = None,
        until: TimeLike | None = None,
    ) -> None:
        """Add to the goal; a conjunction is split into its parts."""
        handlers, symbols = self._handlers_since(since, until)
        self._update(Role.GOAL, goals_in, handlers.add_goal, goals, initial_time, symbols)

    def remove_goal(
        self,
        *goals: Knowledge,
        initial_time: TimeLike | None = None,
        since: TimeLike | None = None,
        until: TimeLike | None = None,
    ) -> None:
        """Remove from the goal."""
        handlers, symbols = self._handlers_since(since, until)
        self._update(Role.GOAL, goals_in, handlers.remove_goal, goals, initial_time, symbols)

    def add_metric(self, *metrics: Knowledge, initial_time: TimeLike | None = None) -> None:
        """Set the metric."""
        self._update(Role.STATE, items_in, self._open_handlers().add_metric, metrics, initial_time, self._symbols)

    def remove_metric(self, *metrics: Knowledge, initial_time: TimeLike | None = None) -> None:
        """Remove the metric; if one is given, only if it is that one."""
        if metrics:
            self._update(
                Role.STATE, items_in, self._open_handlers().remove_metric, metrics, initial_time, self._symbols
            )
            return
        handlers, t = self._open_handlers(), max(_time(initial_time, self.now), self.now)
        self._atomically(lambda: handlers.remove_metric(None, t))

    def _update(
        self,
        role: Role,
        read: Callable[[Knowledge, SymbolTable], Sequence[Item]],
        handler: Callable[[Item, int], Violations],
        given: Iterable[Knowledge],
        initial_time: TimeLike | None,
        symbols: SymbolTable,
    ) -> None:
        """Read everything that is given, and pass it to a handler, all or nothing."""
        batch = Batch(self.now, _time(initial_time, self.now))
        with gc_paused():
            batch.read(role, read, handler, given, symbols)
            self._apply_batch(batch)

    def update(
        self,
        updates: Iterable[tuple[UpdateType | int, Knowledge]],
        *,
        initial_time: TimeLike | None = None,
        since: TimeLike | None = None,
        until: TimeLike | None = None,
    ) -> None:
        """Apply several updates, in order, all or none."""
        handlers, symbols = self._handlers_since(since, until)
        batch = Batch(self.now, _time(initial_time, self.now))
        with gc_paused():
            batch.read_updates(updates, handlers, symbols)
            self._apply_batch(batch)

    def _handlers_since(
        self, since: TimeLike | None, until: TimeLike | None
    ) -> tuple[Handlers | LateHandlers, SymbolTable]:
        """Return the handlers for what holds since a time, or from now on, and the symbols known then (rule L1)."""
        handlers = self._open_handlers()
        span = late_span(since, until, self.now)
        if span is None:
            return handlers, self._symbols
        head = self._head
        if span[0] < head.history_from:
            raise self._reader.resolver.archived(f"what has held since {isoformat(span[0])}", head)
        versions = self._versions()
        late = LateHandlers(
            self._change_set,
            self._repository,
            versions,
            self._executor.abort_with,
            *span,
            use_unknowns=self._reader.use_unknowns,
        )
        return late, next(symbols for start, symbols in reversed(versions) if start <= span[0])

    def _versions(self) -> list[Version]:
        """Return the versions of the domain, each with the time from which on it is in force."""
        if not self._validate:
            return [(0, SymbolTable(None, {}))]
        domains = self._reader.domains
        known = domains.all(self._repository, self._head)
        undeclared = domains.inferred(self._repository) if known else self._symbols
        versions = [(0, undeclared), *((version.time, SymbolTable(version.domain)) for version in known)]
        if self._symbols.domain is not self._domain:
            versions.append((self.now, self._symbols))
        return versions

    def _apply_batch(self, batch: Batch) -> None:
        for role, items in batch.items.items():
            self._change_set.prefetch(role, items)
        self._atomically(batch.run)

    def replace(self, *items: Knowledge) -> None:
        """Make the state what the items assert, by the difference alone (rule C13)."""
        handlers = self._open_handlers()
        batch = Batch(self.now)
        with gc_paused():
            batch.read(Role.STATE, items_in, handlers.assert_now, items, self._symbols)
            given = list(batch.items[Role.STATE])
            batch.steps.insert(0, lambda: handlers.remove_others(given))
            self._apply_batch(batch)

    def clear(self) -> None:
        """End everything that holds, cancel everything scheduled, abort what runs (rule C12)."""
        handlers = self._open_handlers()

        def clear() -> None:
            handlers.clear()
            self._executor.abort_all()

        self._atomically(clear)

    # -- domains and problems ---------------------------------------------------------------------------------

    def load(
        self,
        domain: str | os.PathLike[str] | PlanningProblem | None = None,
        problem: str | os.PathLike[str] | None = None,
        *,
        replace: bool = False,
        once: bool = False,
    ) -> None:
        """Load a domain, and a problem: paths, PDDL text, or a `unified_planning` Problem (rules D4, P3, P7).

        `replace` clears first. With `once`, nothing happens if the same texts have ever been loaded.
        """
        self._open_handlers()
        self._is_whole = False
        with gc_paused():
            self._load(domain, problem, replace=replace, once=once)
        self._is_whole = True

    def _load(
        self,
        domain: str | os.PathLike[str] | PlanningProblem | None,
        problem: str | os.PathLike[str] | None,
        *,
        replace: bool,
        once: bool,
    ) -> None:
        given = [None if source is None else SourceText.open(source) for source in sources(domain, problem)]
        digest = self._digest(*given)
        if once and self._was_loaded(digest):
            return
        loaded = self._symbols.domain if given[0] is None else read_domain(given[0])
        read = None if given[1] is None else read_problem(given[1], loaded)
        if read is not None and read.uncertain and not self._reader.use_unknowns:
            raise InvalidKnowledge(*closed_world_violations(read))
        if replace:
            self.clear()
        if loaded is not None and given[0] is not None:
            self.set_domain(self._marked(loaded))
        if read is not None:
            self._apply_batch(problem_batch(read, self._handlers, self.now))
        self._loads.append(digest)

    def _digest(self, domain: SourceText | None, problem: SourceText | None) -> str:
        """Return a digest by which a domain and a problem are recognised; without a domain, the one in force counts."""
        known = self._symbols.domain.source if self._symbols.domain else ""
        texts = (known if domain is None else domain.text, "" if problem is None else problem.text)
        return sha256("\0".join(texts).encode("utf-8", "surrogatepass")).hexdigest()

    def _was_loaded(self, digest: str) -> bool:
        return digest in self._loads or bool(self._repository.find(Role.LOAD, KnowledgeType.EXPRESSION, [digest]))

    def _marked(self, domain: Domain) -> Domain:
        """Return a domain with the sensed symbols of the one before marked, as far as it has them."""
        known = self._symbols.domain
        if known is None:
            return domain
        symbols = domain.predicate_signatures.keys() | domain.function_signatures.keys()
        return domain.marked(known.sensed & symbols)

    def set_domain(self, domain: Domain) -> None:
        """Set another version of the domain (rule D4).

        Raises `InvalidKnowledge` if what holds, is scheduled or runs does not fit it.
        """
        known = self._symbols.domain
        if known is not None and known.source == domain.source and known.sensed == domain.sensed:
            return
        if known is None or known.source != domain.source:
            wrong = violations(domain, self._change_set, self._handlers.everything(), self._executor.running)
            if wrong:
                raise InvalidKnowledge(*wrong)
        self._use_symbols(SymbolTable(domain))

    def set_sensed(self, name: str, sensed: bool) -> None:
        """Mark a predicate as sensed, or not, in a new version of the domain."""
        self._open_handlers()
        domain = self._symbols.domain
        if domain is None:
            raise InvalidKnowledge(f"{name} cannot be marked as sensed without a domain; load one first")
        if domain.is_sensed(name) != sensed:
            self.set_domain(domain.with_sensed(name, sensed))

    # -- operators --------------------------------------------------------------------------------------------

    def applicable(self, operator: str, *arguments: str, duration: DurationLike | None = None) -> Applicability:
        """Return whether an operator can be applied to the state as the transaction has it (rule O1)."""
        state = self.state()
        return applicability(state, lambda: state, operator, arguments, duration)

    def apply(self, operator: str, *arguments: str) -> None:
        """Apply an instantaneous action (rules O2, O3)."""
        self._act(lambda: self._executor.apply(self.state(), self._handlers, operator, arguments))

    def start(self, operator: str, *arguments: str, duration: DurationLike | None = None, force: bool = False) -> Run:
        """Start a durative action: its at-start effects are recorded, and its continuous effects begin."""
        return self._act(
            lambda: self._executor.start(self.state(), self._handlers, operator, arguments, duration, force)
        )

    def end(self, run: Run) -> Applicability:
        """End a durative action: its at-end effects are recorded. Return the at-end conditions that fail."""
        return self._act(lambda: self._executor.end(self.state(), self._handlers, run))

    def abort(self, run: Run) -> None:
        """Abort a durative action: only its continuous effects stop."""
        self._act(lambda: self._executor.abort(run))

    def report_start(self, operator: str, *arguments: str, duration: DurationLike | None = None) -> Run:
        """Record the start of an action that something else carries out, durative or not.

        Its conditions are not evaluated, and nothing changes but what runs: whoever carries it out reports its effects.
        Without a `duration`, and if the domain does not fix one, it is overdue from its start on. Raises
        `NotApplicable` if it runs already.
        """
        return self._act(
            lambda: self._executor.report_start(self.state(), self._handlers, operator, arguments, duration)
        )

    def report_end(self, run: Run) -> None:
        """Record the end of an action that something else carries out: its run ends, and nothing else changes."""
        self._act(lambda: self._executor.report_end(run))

    def _act(self, act: Callable[[], Result]) -> Result:
        """Call a function that executes an operator, all of it or nothing."""
        self._open_handlers()
        return self._atomically(act)

    # -- the state as the transaction has it ------------------------------------------------------------------

    @cached_property
    def _working(self) -> WorkingState:
        use_unknowns = self._reader.use_unknowns
        return WorkingState(self._repository, self._change_set, self._executor, self._domain, use_unknowns=use_unknowns)

    def state(self) -> State:
        """Return the state at the transaction's now, with what it has written itself."""
        self._open_handlers()
        data = self._working.data(self._symbols.domain)
        ended = {state.timeline.identity: state.cause for state in self._change_set.states() if state.value is None}
        return self._reader.state_of(data, self._symbols, draft=ended)

    def holds(self, question: Question) -> bool:
        """Return whether a fact or condition is true in the state as the transaction has it."""
        return self.state().holds(question)

    def value(self, question: Question) -> float:
        """Return the value of a function or expression in the state as the transaction has it."""
        return self.state().value(question)


def _time(initial_time: TimeLike | None, now: int) -> int:
    return 0 if initial_time is None else time(initial_time, now)
