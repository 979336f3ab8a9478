"""The public interface of a knowledge base: one named world in a store.

The module is longer than others, as it has a method for each question and each change. A method documents its meaning
and leaves the work to `kbstore.reading`, `kbstore.writing` and `kbstore.transfer`.
"""

import os
import threading
from collections.abc import Iterable, Iterator, Sequence
from copy import copy
from functools import partial
from pathlib import Path
from time import monotonic
from types import TracebackType
from typing import TYPE_CHECKING, Any, Literal, Self, cast, overload
from weakref import WeakSet

from kbstore.clock import Clock, DurationLike, ManualClock, SystemClock, TimeLike, isoformat, time
from kbstore.conversion import MessageDomain
from kbstore.errors import Conflict, InvalidKnowledge, InvalidTime, StoreUnavailable, UnknownSymbol
from kbstore.evaluation.intervals import Intervals
from kbstore.interop.up_loading import PlanningProblem
from kbstore.messages import (
    Expression,
    Fact,
    Function,
    Goal,
    Instance,
    KnowledgeItem,
    Truth,
    UpdateType,
)
from kbstore.messages.gc_pause import gc_paused
from kbstore.model.assertions import Assertions
from kbstore.model.results import (
    Applicability,
    AsOf,
    Broken,
    Change,
    Diff,
    Ended,
    Explanation,
    FailingCondition,
    QueryResult,
    Run,
    Transaction,
)
from kbstore.names import check_is_text
from kbstore.pddl.strict_names import StrictPddl, strict_domain
from kbstore.pddl.writer import write_domain
from kbstore.reading.answers import Answers, Computed
from kbstore.reading.beliefs import Belief, beliefs
from kbstore.reading.bindings import bindings
from kbstore.reading.condition_watch import ConditionWatch, TruthChange
from kbstore.reading.difference import difference
from kbstore.reading.explanation import ExplainedPoint, Explainer
from kbstore.reading.history import Baseline, History
from kbstore.reading.lazy_state import LazyState
from kbstore.reading.parts import Parts
from kbstore.reading.questions import Knowledge, Question
from kbstore.reading.reader import Reader
from kbstore.reading.resolver import MAX_STEP, TOLERANCE, TemporalPoint
from kbstore.reading.runs import Runs
from kbstore.reading.sampling import Sample, sampled
from kbstore.reading.state import State
from kbstore.reading.trajectory import when_true
from kbstore.reading.watching import ChangeWatch, Found, Watch
from kbstore.storage import directory
from kbstore.storage.database import Database
from kbstore.storage.memory import TimelineCache
from kbstore.storage.repository import Repository
from kbstore.transfer.archive_mark import is_archive
from kbstore.writing.action_executor import applicability
from kbstore.writing.ingesting import BATCH, Counted, Ingested, ingest
from kbstore.writing.unit_of_work import OpenTransaction

if TYPE_CHECKING:
    from sqlalchemy import Connection

    from kbstore.transfer.archive import Archived
    from kbstore.transfer.push import Push
    from kbstore.transfer.rows import Progress


class KnowledgeBase:
    """A knowledge base; made by `kbstore.open`, and a context manager that closes it.

    It may be used from several threads and, after a fork, from the child. Methods accept any time-like value (rule T2)
    and return times in nanoseconds.
    """

    def __init__(
        self,
        database: Database,
        name: str,
        *,
        clock: Clock | None = None,
        use_unknowns: bool | None = None,
        validate: bool = True,
        read_only: bool = False,
        cache: bool = True,
        tolerance: int = TOLERANCE,
        max_step: int = MAX_STEP,
    ) -> None:
        self.name = name
        self._database = database
        self._is_archive = is_archive(database)
        self._read_only = read_only or self._is_archive
        self._validate = validate
        # in an archive now is its end
        self._clock = ManualClock() if self._is_archive else clock or SystemClock()
        kb, unknowns = self._find_or_create(use_unknowns)
        if use_unknowns is not None and use_unknowns != unknowns:
            raise InvalidKnowledge(
                f"{name} was created with use_unknowns={unknowns}, which is stored and cannot be changed; "
                f"open it without use_unknowns, or give another name"
            )
        self.use_unknowns = unknowns
        if cache:
            database.listen(kb)
        self._reader = Reader(
            database,
            kb,
            name,
            use_unknowns=unknowns,
            clock=self._clock,
            explainer=self._explain_state,
            caching=cache,
            is_archive=self._is_archive,
            tolerance=tolerance,
            max_step=max_step,
        )
        self._history = History(self._reader)
        self._runs = Runs(self._reader)
        self._explainer = Explainer(self._reader, self._history)
        self._answers = Answers(self._reader, self._clock, caching=cache)
        self._parts = Parts(self._reader, self._answers)
        self._writing = threading.local()
        self._watches: WeakSet[Watch[Any] | Push] = WeakSet()

    def _find_or_create(self, use_unknowns: bool | None) -> tuple[int, bool]:
        with self._database.connect() as connection:
            found = directory.find(connection, self.name)
        if found is None:
            if self._read_only:
                raise StoreUnavailable(f"there is no knowledge base {self.name!r}, and read_only cannot create it")
            with self._database.begin() as connection:
                found, _ = directory.create(connection, self.name, use_unknowns=bool(use_unknowns))
        return found

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Close the connections to the store, and end watches; methods called afterwards raise `StoreUnavailable`."""
        for watch in list(self._watches):
            watch.close()
        self._database.close()

    def now(self) -> int:
        """Return now: the clock's time, or the latest recorded one if the clock is behind it (rule T3)."""
        with self._reader.repository() as repository:
            return self._reader.resolver.now(repository.head())

    # -- writing ----------------------------------------------------------------------------------------------

    def transaction(
        self,
        *,
        client: str = "",
        note: str = "",
        expect: int | None = None,
        connection: "Connection | None" = None,
    ) -> OpenTransaction:
        """Begin a transaction: a context manager with the same writing methods, and a `state` that sees its own writes.

        Args:
            client: who writes.
            note: why.
            expect: the number of the latest transaction that the caller knows; entering the block raises `Conflict` if
                another one has been committed since.
            connection: a SQLAlchemy connection of the caller's to the same database. The block takes part in its
                transaction, which the caller commits or rolls back; until then nobody else sees what was written, and
                other writers of this knowledge base wait (on SQLite, of the whole file). An exception in the block
                rolls back to its beginning, and leaves the caller's transaction usable. On SQLite the caller must have
                begun to write (``BEGIN IMMEDIATE``); on PostgreSQL the isolation level must be READ COMMITTED.
        """
        reader = self._reader if connection is None else self._reader.within(connection)
        return self._transaction(reader, client=client, note=note, expect=expect)

    def _transaction(self, reader: Reader, *, client: str, note: str, expect: int | None = None) -> OpenTransaction:
        return OpenTransaction(
            reader,
            client=client,
            note=note,
            expect=expect,
            validate=self._validate,
            refuse_writing=self._refuse_writing,
            writing=self._writing,
        )

    def _refuse_writing(self) -> None:
        if self._is_archive:
            raise StoreUnavailable(f"{self.name} is an archive here, which nobody writes to; write to its store")
        if self._read_only:
            raise StoreUnavailable(f"{self.name} was opened with read_only=True; open it without to write")
        if getattr(self._writing, "open", False):
            raise Conflict("a transaction is open in this thread; write through it, or leave its block first")

    def add(
        self,
        *items: Knowledge,
        initial_time: TimeLike | None = None,
        since: TimeLike | None = None,
        until: TimeLike | None = None,
        client: str = "",
        note: str = "",
    ) -> Transaction:
        """Add knowledge to the state: items, their PDDL text, or messages.

        `initial_time` is for items without one of their own; a time after now makes timed-initial knowledge. Knowledge
        that has held since a time in the past is late, and given with `since`: it holds until the next beginning or
        end on its timeline, or `until` a time that is not after now (rules L1, L2).

        Raises `InvalidKnowledge` with all violations; nothing is stored then.
        """
        with gc_paused(), self.transaction(client=client, note=note) as tx:
            tx.add(*items, initial_time=initial_time, since=since, until=until)
        return tx.result

    def remove(
        self,
        *items: Knowledge,
        initial_time: TimeLike | None = None,
        since: TimeLike | None = None,
        until: TimeLike | None = None,
        client: str = "",
        note: str = "",
    ) -> Transaction:
        """Remove what matches from the state (``?`` matches any object).

        With an `initial_time` after now, cancel what is scheduled for that time. With `since`, a time in the past,
        remove what matched then, up to the next beginning on its timeline; with `until`, what matched between the two
        (rule L3).
        """
        with gc_paused(), self.transaction(client=client, note=note) as tx:
            tx.remove(*items, initial_time=initial_time, since=since, until=until)
        return tx.result

    def add_goal(
        self,
        *goals: Knowledge,
        initial_time: TimeLike | None = None,
        since: TimeLike | None = None,
        until: TimeLike | None = None,
        client: str = "",
        note: str = "",
    ) -> Transaction:
        """Add to the goal; a conjunction is split into its parts (rule C10). Times are as for `add`."""
        with gc_paused(), self.transaction(client=client, note=note) as tx:
            tx.add_goal(*goals, initial_time=initial_time, since=since, until=until)
        return tx.result

    def remove_goal(
        self,
        *goals: Knowledge,
        initial_time: TimeLike | None = None,
        since: TimeLike | None = None,
        until: TimeLike | None = None,
        client: str = "",
        note: str = "",
    ) -> Transaction:
        """Remove what matches from the goal. Times are as for `remove`."""
        with gc_paused(), self.transaction(client=client, note=note) as tx:
            tx.remove_goal(*goals, initial_time=initial_time, since=since, until=until)
        return tx.result

    def add_metric(
        self, *metrics: Knowledge, initial_time: TimeLike | None = None, client: str = "", note: str = ""
    ) -> Transaction:
        """Set the metric, for instance ``minimize (total-time)``; it replaces any other."""
        with self.transaction(client=client, note=note) as tx:
            tx.add_metric(*metrics, initial_time=initial_time)
        return tx.result

    def remove_metric(
        self, *metrics: Knowledge, initial_time: TimeLike | None = None, client: str = "", note: str = ""
    ) -> Transaction:
        """Remove the metric; if one is given, only if it is that one."""
        with self.transaction(client=client, note=note) as tx:
            tx.remove_metric(*metrics, initial_time=initial_time)
        return tx.result

    def update(
        self,
        updates: Iterable[tuple[UpdateType | int, Knowledge]],
        *,
        since: TimeLike | None = None,
        until: TimeLike | None = None,
        client: str = "",
        note: str = "",
    ) -> Transaction:
        """Make several updates in order, all or none: pairs of an `UpdateType`, or its number, and knowledge."""
        with gc_paused(), self.transaction(client=client, note=note) as tx:
            tx.update(updates, since=since, until=until)
        return tx.result

    def ingest(
        self,
        items: Iterable[Knowledge],
        *,
        batch: int = BATCH,
        client: str = "",
        note: str = "",
        progress: Counted | None = None,
    ) -> Ingested:
        """Add the items of an iterable that need not fit into memory, in one transaction for each `batch` of them.

        A batch that fails is rolled back and ends the ingestion; the batches before it stay committed.

        Args:
            items: what `add` takes, any number of them.
            batch: how many items a transaction takes.
            client: who adds them.
            note: why.
            progress: called after each batch with the number of items stored so far.

        Raises:
            InvalidKnowledge: with the violations of one batch, each with the number of its item, counted from 1.
        """
        # there may be as many timelines as items, so the cache of timelines lasts for one batch only
        reader = copy(self._reader)

        def begin() -> OpenTransaction:
            reader.memory = copy(self._reader.memory)
            reader.memory.timelines = TimelineCache(reader.memory.bound)
            return self._transaction(reader, client=client, note=note)

        return ingest(begin, items, batch=batch, progress=progress)

    def replace(self, *items: Knowledge, client: str = "", note: str = "") -> Transaction:
        """Replace the state by the items, in one transaction that records the difference alone (rule C13).

        Objects, facts, functions and recorded inequalities that hold and are not among the items are removed, an object
        with what mentions it and what runs with it. Goals, metric and what is scheduled are left alone.

        Args:
            items: everything that is to hold, objects included; each as for `add`.
            client: who replaces it.
            note: why.

        Raises:
            InvalidKnowledge: with all violations; also for an item of a future time, a relative change or a metric.
        """
        with gc_paused(), self.transaction(client=client, note=note) as tx:
            tx.replace(*items)
        return tx.result

    def clear(self, *, client: str = "", note: str = "") -> Transaction:
        """End everything that holds, cancel everything scheduled, and abort what runs; history remains (rule C12)."""
        with self.transaction(client=client, note=note) as tx:
            tx.clear()
        return tx.result

    def load(
        self,
        domain: str | os.PathLike[str] | PlanningProblem | None,
        problem: str | os.PathLike[str] | None = None,
        *,
        replace: bool = False,
        once: bool = False,
        client: str = "",
        note: str = "",
    ) -> Transaction:
        """Load a PDDL domain, a problem, or both, from paths or text, in one transaction.

        A `unified_planning` Problem is loaded as both, in its own names (rule P7). A problem adds to what holds; with
        `replace`, everything is cleared first. Its timed-initial knowledge is relative to now. With `once`, nothing
        happens if this knowledge base has ever loaded the same texts, even if it was cleared since: for services that
        load at each start.

        Raises:
            PddlSyntaxError: with the place, for text that cannot be read.
            InvalidKnowledge: with everything that does not fit the domain.
        """
        with gc_paused(), self.transaction(client=client, note=note) as tx:
            tx.load(domain, problem, replace=replace, once=once)
        return tx.result

    def set_sensed(self, name: str, sensed: bool, *, client: str = "", note: str = "") -> Transaction:
        """Mark a predicate or function as sensed, or not (rule O8). Raises `UnknownSymbol`."""
        with self.transaction(client=client, note=note) as tx:
            tx.set_sensed(name, sensed)
        return tx.result

    # -- the state --------------------------------------------------------------------------------------------

    def state(self, at: TimeLike | None = None, as_of: AsOf | None = None) -> State:
        """Return the state at a time; with `as_of` (a time or a `Transaction`), as it was believed then."""
        return self._reader.state_at(at, as_of)

    def truth(self, question: Question, at: TimeLike | None = None, as_of: AsOf | None = None) -> Truth:
        """Return the truth value of a fact or condition at a time."""
        return self._answers.truth(question, at, as_of)

    def holds(self, question: Question, at: TimeLike | None = None, as_of: AsOf | None = None) -> bool:
        """Return whether a fact or condition is true at a time."""
        return self._answers.truth(question, at, as_of) is Truth.TRUE

    def value(self, question: Question, at: TimeLike | None = None, as_of: AsOf | None = None) -> float:
        """Return the value of a numeric function or expression at a time.

        Raises `UndefinedFunction` or `DivisionByZero` where it has none.
        """
        return self._answers.value(question, at, as_of)

    def find(self, condition: Question, at: TimeLike | None = None, as_of: AsOf | None = None) -> list[dict[str, str]]:
        """Find the objects for a condition's free variables for which it is true at a time (rule V11).

        Variables of one name are the same object: ``(and (robot_at ?r ?w) (> (battery ?r) 20))``. A variable that is
        not an argument of something true needs a type where it first occurs: ``(not (visited ?w - waypoint))``.

        Returns:
            One dict for each answer, from variables (without their question mark) to objects, in the order of the
            objects; without free variables one empty dict, or none.

        Raises:
            InvalidKnowledge: a variable needs a type, or the question cannot be meant (rule V10).
        """
        with self._reader.repository() as repository:
            point = self._reader.resolver.resolve(repository, at, as_of)
            symbols = self._reader.symbols_at(repository, point)
            return bindings(condition, symbols, self._reader.world(repository, point, symbols.domain))

    def explain(self, question: Question, at: TimeLike | None = None, as_of: AsOf | None = None) -> Explanation:
        """Explain why a fact or condition is true, false or unknown at a time, and which transaction made it so."""
        return self.state(at, as_of).explain(question)

    def query(self, *items: Question, at: TimeLike | None = None) -> QueryResult:
        """Return whether each of several items is true, as ROSPlan's query does."""
        return self._answers.query(items, at)

    def instances(
        self,
        type_name: str = "",
        *,
        include_constants: bool = False,
        include_subtypes: bool = False,
        at: TimeLike | None = None,
    ) -> list[Instance]:
        """Return the objects of a type, or all."""
        return self._parts.instances(
            type_name, at, include_constants=include_constants, include_subtypes=include_subtypes
        )

    def propositions(self, name: str = "", at: TimeLike | None = None) -> list[Fact]:
        """Return the facts of a predicate, or all, of both signs."""
        return self._parts.propositions(name, at)

    def functions(self, name: str = "", at: TimeLike | None = None) -> list[Function]:
        """Return the values of a numeric function, or of all."""
        return self._parts.functions(name, at)

    def timed_knowledge(self, name: str = "", at: TimeLike | None = None) -> list[KnowledgeItem]:
        """Return the items scheduled to take effect after the time, of one predicate or function, or of all."""
        return self._parts.timed_knowledge(name, at)

    def goals(self, at: TimeLike | None = None) -> list[Goal]:
        """Return the parts of the goal."""
        return self._parts.goals(at)

    def metric(self, at: TimeLike | None = None) -> Expression | None:
        """Return the metric; None if there is none."""
        return self._parts.metric(at)

    @property
    def domain(self) -> MessageDomain:
        """The domain now. Raises `UnknownSymbol` if none has been loaded."""
        with self._reader.repository() as repository:
            point = self._reader.resolver.resolve(repository)
            domain = self._reader.domains.in_force(repository, point.head, point.position).domain
        if domain is None:
            raise UnknownSymbol(f"{self.name} has no domain; load one: kb.load('domain.pddl')")
        return cast("MessageDomain", domain)

    @overload
    def to_pddl(
        self,
        at: TimeLike | None = None,
        as_of: AsOf | None = None,
        *,
        explicit_negatives: bool = False,
        strict_names: Literal[False] = False,
    ) -> str: ...
    @overload
    def to_pddl(
        self,
        at: TimeLike | None = None,
        as_of: AsOf | None = None,
        *,
        explicit_negatives: bool = False,
        strict_names: Literal[True],
    ) -> StrictPddl: ...
    def to_pddl(
        self,
        at: TimeLike | None = None,
        as_of: AsOf | None = None,
        *,
        explicit_negatives: bool = False,
        strict_names: bool = False,
    ) -> str | StrictPddl:
        """Write the planning problem as of any moment in PDDL (rules P2, O4).

        With `strict_names`, names that some planners do not read are replaced. The result is then a `StrictPddl`: the
        `text`, and the replaced `names`, for `read_plan` (rule P5).
        """
        state = self.state(at, as_of)
        if strict_names:
            return state.to_pddl(explicit_negatives=explicit_negatives, strict_names=True)
        return state.to_pddl(explicit_negatives=explicit_negatives)

    @overload
    def domain_to_pddl(self, *, strict_names: Literal[False] = False) -> str: ...
    @overload
    def domain_to_pddl(self, *, strict_names: Literal[True]) -> StrictPddl: ...
    def domain_to_pddl(self, *, strict_names: bool = False) -> str | StrictPddl:
        """Write the domain as it was loaded; with `strict_names` as a `StrictPddl`, in the names of `to_pddl`."""
        return strict_domain(self.domain) if strict_names else write_domain(self.domain)

    def constraints(self, at: TimeLike | None = None) -> list[str]:
        """Return the parts of problems that no item can carry, in PDDL: `State.constraints` (rule P4)."""
        return self.state(at).constraints

    def to_problem(self, at: TimeLike | None = None, as_of: AsOf | None = None) -> Any:
        """Return the planning problem as of any moment as a `unified_planning` Problem (extra `planning`)."""
        from kbstore.interop.unified_planning import to_problem

        return to_problem(self.state(at, as_of))

    # -- over time --------------------------------------------------------------------------------------------

    def history(
        self,
        pattern: Knowledge | None = None,
        since: TimeLike | None = None,
        until: TimeLike | None = None,
        as_of: AsOf | None = None,
    ) -> Assertions:
        """Return the assertions that match a pattern, in order of time; ``?`` matches any object (rule Q3).

        Without a pattern, all but those of goals. With `as_of` (a time or a `Transaction`), those that were on record
        then, as they were.
        """
        return self._history.assertions(pattern, since, until, as_of)

    def transactions(
        self, since: TimeLike | None = None, until: TimeLike | None = None, as_of: AsOf | None = None
    ) -> list[Transaction]:
        """Return the transactions of a span, in order; with `as_of`, those that had been committed then."""
        return self._history.transactions_within(since, until, as_of)

    def frame(
        self,
        pattern: str | None = None,
        since: TimeLike | None = None,
        until: TimeLike | None = None,
        as_of: AsOf | None = None,
        *,
        of: str = "facts",
    ) -> Any:
        """Return the record as a `pyarrow.Table`, for pandas and polars (extra `frames`).

        ``kb.frame("(robot_at kenny ?)").to_pandas()``; ``polars.from_arrow(kb.frame(of="runs"))``. The columns have the
        names of the views in SQL. Times are ``timestamp[ns, UTC]``, exact; what is open or did not happen is null.

        Args:
            pattern: a fact, a function or an action, in which ``?`` matches any object; None: all.
            since: the beginning of the span; None: that of the history.
            until: its end; None: no end.
            as_of: a time or a `Transaction`: what was on record then.
            of: "facts", "numbers", "runs" or "transactions". A number has a row for each span in which it holds still
                or moves at one rate, with its value at both ends.

        Raises:
            MissingLibrary: pyarrow is not installed.
            InvalidKnowledge: the pattern matches something that the table does not have.
        """
        from kbstore.report.frames import arrow_table
        from kbstore.report.relations import relation

        return arrow_table(relation(self, of, pattern, since, until, as_of))

    def when(self, condition: Question, since: TimeLike, until: TimeLike, as_of: AsOf | None = None) -> Intervals:
        """Return the maximal half-open intervals in ``[since, until)`` in which a condition is true (rule Q4).

        With `as_of` (a time or a `Transaction`), as it was believed then.

        Raises `NotLinear` where a comparison is not linear in time within the span.
        """
        with self._reader.repository() as repository:
            now = self._reader.resolver.now(repository.head())
            first, last = time(since, now), time(until, now)
            if last < first:
                raise InvalidTime(f"until ({isoformat(last)}) is before since ({isoformat(first)}); give them in order")
            return when_true(self._reader, repository, condition, first, last, as_of)

    def beliefs(self, condition: Question, at: TimeLike) -> list[Belief]:
        """Return what was believed about one time, over transaction time: since when was it known (rule L4).

        Returns:
            Intervals of transaction time ``(since, until, truth)``, half-open, from the first transaction on; the last
            has `until` None.
        """
        with self._reader.repository() as repository:
            return beliefs(self._reader, repository, condition, at)

    def diff(self, t1: TimeLike, t2: TimeLike, as_of: AsOf | None = None) -> Diff:
        """Return what became true, false or was withdrawn, and how numbers changed, from `t1` to `t2` (rule Q5).

        With `as_of` (a time or a `Transaction`), as it was believed then.
        """
        with self._reader.repository() as repository:
            before, after = (
                self._reader.state(repository, self._reader.resolver.resolve(repository, at, as_of)) for at in (t1, t2)
            )
        return difference(before, after)

    def changes(self, after: int | Change | Transaction = 0) -> Iterator[Change]:
        """Iterate over the transactions after one, in the order of commit, each with all that it did (rule Q6)."""
        if not isinstance(after, int | Change | Transaction):
            raise InvalidKnowledge(f"{after!r:.80} is not a transaction; give its number, a Transaction or a Change")
        return self._history.changes(after if isinstance(after, int) else after.number)

    def baseline(self, since: TimeLike | None = None, *, most: int | None = None) -> Baseline:
        """Return what is on record at a time: with ``changes(baseline.number)``, the history from there on.

        Args:
            since: the time; None, or a time before the history in the store, is that history's begin.
            most: without `since`, the time is that of the latest transaction with at least so many after it.
        """
        return self._history.baseline(None if since is None else time(since, self.now()), most)

    def watch(
        self,
        pattern: Knowledge | None = None,
        after: int | Change | None = None,
        *,
        poll: float = 0.05,
        timeout: float | None = None,
    ) -> Watch[Change]:
        """Follow the transactions as they happen, and what takes effect by the clock alone (rule Q6).

        Args:
            pattern: only changes with an assertion that matches it, and only those assertions.
            after: a `Change`, or the number of a transaction, after which to go on; None: after the latest.
            poll: seconds between two looks at the store.
            timeout: seconds to wait for the next such change, after which the iterator ends; None: forever.

        Returns:
            An iterator. Its `close`, which any thread may call, ends it quietly; so does `close` of this object.

        Raises:
            UnknownSymbol: the domain does not know the pattern's predicate or function.
            InvalidKnowledge: nothing can match the pattern.
        """
        return self._watched(ChangeWatch(self._reader, self._history, pattern, after, poll=poll, timeout=timeout))

    def watch_condition(
        self, condition: Question, *, poll: float = 0.05, timeout: float | None = None
    ) -> Watch[TruthChange]:
        """Follow a condition: its truth now, and each change of it as it happens (rule Q9).

        Args:
            condition: anything that `holds` takes.
            poll: seconds between two looks at the store.
            timeout: seconds to wait for the next change, after which the iterator ends; None: forever.

        Returns:
            An iterator of a time, the truth from then on, and the transaction that made it so. The transaction is None
            for the first, and for a change by the clock alone (a schedule, the end of an object, a number that moves).
            It is closed like that of `watch`.

        Raises:
            UnknownSymbol, InvalidKnowledge: at the call, the condition cannot be asked; while iterating, it cannot be
                asked any more. That also raises `NotLinear` and other errors of `when`.
        """
        return self._watched(ConditionWatch(self._reader, self._history, condition, poll=poll, timeout=timeout))

    def wait_for(self, condition: Question, timeout: float | None = None, *, poll: float = 0.05) -> int | None:
        """Wait until a condition is true (rule Q9).

        Args:
            condition: anything that `holds` takes.
            timeout: seconds to wait at most; None: forever.
            poll: seconds between two looks at the store.

        Returns:
            The first time from now on at which it is true; None after the timeout, and where `close` ends the waiting.

        Raises:
            What `watch_condition` raises.
        """
        deadline = None if timeout is None else monotonic() + timeout
        watch = ConditionWatch(self._reader, self._history, condition, poll=poll, deadline=deadline)
        return next((t for t, truth, _ in self._watched(watch) if truth is Truth.TRUE), None)

    def sample(self, expression: Question, since: TimeLike, until: TimeLike, step: DurationLike) -> list[Sample]:
        """Return the value of an expression at `since`, and at each `step` from there on before `until`.

        Returns:
            Pairs of a time and the value then, None where it is undefined.

        Raises:
            InvalidTime: `until` is before `since`, or the step is 0.
        """
        with self._reader.repository() as repository:
            return sampled(self._reader, repository, expression, since, until, step)

    def _watched(self, watch: Watch[Found]) -> Watch[Found]:
        self._watches.add(watch)
        return watch

    def timeline(
        self,
        path: str | os.PathLike[str] | None = None,
        *,
        patterns: Sequence[str] = (),
        since: TimeLike | None = None,
        until: TimeLike | None = None,
        as_of: AsOf | None = None,
    ) -> str:
        """Draw the history as one self-contained page of HTML, and return its text.

        The page shows what held when, what was scheduled, cancelled and expected, what ran, and at its cursor the
        state; its slider shows what was believed after each transaction. It needs no network.

        Args:
            path: a file to write the page to; one that exists is replaced.
            patterns: only the lanes that match one of these: ``"(robot_at kenny ?)"``, or a word, for everything with
                that predicate, function, operator or object.
            since: the beginning of the span; None, or an earlier time: that of the history in the store.
            until: its end; None: the last time about which something is known, or now if that is soon after it.
            as_of: a time or a `Transaction` whose belief is shown first; None: what is known now.
        """
        from kbstore.report.timeline.data import timeline_data
        from kbstore.report.timeline.page import page

        now = self.now()
        first, last = (None if t is None else time(t, now) for t in (since, until))
        believed = as_of if as_of is None or isinstance(as_of, Transaction) else time(as_of, now)
        text = page(timeline_data(self, patterns, since=first, until=last, as_of=believed))
        if path is not None:
            Path(path).write_text(text, encoding="utf-8")
        return text

    # -- operators --------------------------------------------------------------------------------------------

    def applicable(
        self, operator: str, *arguments: str, at: TimeLike | None = None, duration: DurationLike | None = None
    ) -> Applicability:
        """Return whether an operator can be applied at a time, and which conditions fail since when (rules O1, O7).

        `duration` is as in `start`; the domain's constraints on it are among the conditions.
        """
        compute = partial(self._applicable, operator, arguments, duration)
        check_is_text("name", operator, *arguments)
        name = ("applicable", operator, arguments) if duration is None else None
        failing = self._answers.computed(name, compute, at)
        return Applicability(list(failing))

    def _applicable(
        self,
        operator: str,
        arguments: Sequence[str],
        duration: DurationLike | None,
        repository: Repository,
        point: TemporalPoint,
    ) -> Computed[Sequence[FailingCondition]]:
        """Compute which conditions of an operator fail at a point."""
        world = self._reader.world(repository, point, self._reader.symbols_at(repository, point).domain)
        whole: list[State] = []

        def read_state() -> State:
            whole.append(self._reader.state(repository, point))
            return whole[-1]

        found = applicability(ExplainedPoint(self._explainer, world), read_state, operator, arguments, duration)

        def until() -> int:
            # what fails by the action's own effects does so since the time that is asked about
            since_then = any(condition.since == point.valid_time for condition in found.failing)
            if not isinstance(world, LazyState) or world.is_moving or whole or since_then:
                return point.valid_time
            return world.until

        return Computed(found.failing, 1 + len(found.failing), until)

    def apply(self, operator: str, *arguments: str, client: str = "", note: str = "") -> Transaction:
        """Apply an instantaneous action. Raises `NotApplicable` with the conditions that fail."""
        with self.transaction(client=client, note=note) as tx:
            tx.apply(operator, *arguments)
        return tx.result

    def start(
        self,
        operator: str,
        *arguments: str,
        duration: DurationLike | None = None,
        force: bool = False,
        client: str = "",
        note: str = "",
    ) -> Run:
        """Start a durative action: at-start effects take place, continuous ones begin (rule O3).

        Args:
            operator: the name of the action.
            arguments: the objects for its parameters.
            duration: in nanoseconds (``kbstore.seconds(20)``), a `timedelta` or a duration stamp; without it the
                domain must fix it.
            force: start it also where the domain's constraints do not allow the duration (rule O7), or an over-all
                condition is expected to break before the end (O6); the answer's `forced` lists what was overruled.
            client: who starts it.
            note: why.

        Raises:
            NotApplicable: with each condition that fails, and since when, or from when on it is expected to.
            NotLinear: a rate, or the expected truth of a condition, cannot be computed (rules O5, O6).
            InvalidTime: `duration` is a bare number of nanoseconds below a millisecond, which is meant as seconds.
        """
        with self.transaction(client=client, note=note) as tx:
            return tx.start(operator, *arguments, duration=duration, force=force)

    def end(self, run: Run, *, client: str = "", note: str = "") -> Ended:
        """End a durative action: its at-end effects take place.

        The result's `failing` has the at-end conditions that fail, and its `broken` the over-all conditions that were
        not true meanwhile, each with its span (rules O3, O6).

        Raises `NotApplicable` if it does not run, or if an effect refers to an object that no longer exists.
        """
        with self.transaction(client=client, note=note) as tx:
            failing = tx.end(run).failing
        done = tx.result
        return Ended(
            done.number, done.time, done.client, done.note, done.changes, failing, self._runs.broken(run, kept=True)
        )

    def abort(self, run: Run, *, client: str = "", note: str = "") -> Transaction:
        """Abort a durative action: its continuous effects stop, and nothing else happens."""
        with self.transaction(client=client, note=note) as tx:
            tx.abort(run)
        return tx.result

    def broken(self, run: Run) -> list[Broken]:
        """Return the over-all conditions of a run that were broken while it ran, each with its spans (rule O6).

        A condition that is unknown, or cannot be decided, counts as not true.
        """
        return self._runs.broken(run)

    def runs(
        self,
        pattern: str | None = None,
        since: TimeLike | None = None,
        until: TimeLike | None = None,
        as_of: AsOf | None = None,
    ) -> list[Run]:
        """Return the durative actions that ran within a span, in the order of their starts (rule Q8).

        Args:
            pattern: ``"(goto_waypoint kenny ? ?)"`` or the name of an operator; None: all.
            since: the beginning of the span; None: that of the history in the store.
            until: its end; None: no end.
            as_of: a time or a `Transaction`; a run that ended later is running then.
        """
        return self._runs.within(pattern, since, until, as_of)

    @property
    def history_from(self) -> int:
        """The time from which on the store has history; what ended before has been archived (rule Q7)."""
        with self._reader.repository() as repository:
            return repository.head().history_from

    def archive(
        self, before: TimeLike, path: str | os.PathLike[str], *, progress: "Progress | None" = None
    ) -> "Archived":
        """Move the history before a time into an archive, and free its space (rule Q7).

        The archive is an SQLite file. Opened like a store, ``kbstore.open(path, name)``, it answers as this knowledge
        base would have answered just before that time. From then on, questions here that need older history raise
        `HistoryUnavailable`. The file of the last archiving is continued, so that one file can hold all of the past; a
        new file begins where the store's history began. Readers and writers go on meanwhile, except that writers wait
        at the end, while an SQLite file is made smaller (VACUUM). If it is stopped at any moment, call it again with
        the same arguments, and it finishes.

        Args:
            before: a time that is not after the latest transaction.
            path: a new file, or an archive to continue.
            progress: called repeatedly with the number of rows done and the total.

        Raises:
            InvalidTime: the time is after the latest transaction.
            HistoryUnavailable: the history before has been archived already, or some would be missing between the file
                and the store.
            InvalidKnowledge: the file is not an archive, or that of another knowledge base.
            StoreUnavailable: the store or the file cannot be reached, or the file is not sound.
        """
        self._refuse_writing()
        # whole stores are moved rarely, and the statements for it take 10 ms to make
        from kbstore.transfer.archive import archive

        return archive(self._reader, before, path, progress=progress)

    def is_quick(self, question: Question) -> bool:
        """Return whether a question about now needs one short read of an SQLite file at most, or none.

        This is so for a fact or a number that has been asked for before. It is for callers that must not wait.
        """
        return self._answers.is_quick(question)

    def _explain_state(self, state: State, question: Question) -> Explanation:
        return self._explainer.explain(state, question)

    def __repr__(self) -> str:
        return f"<KnowledgeBase {self.name!r} in {self._database.engine.url.render_as_string(hide_password=True)}>"
