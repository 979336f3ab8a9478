"""A knowledge base for asyncio: the names of `kbstore.KnowledgeBase`, awaited."""

import asyncio
from collections.abc import Awaitable, Callable, Generator
from contextlib import suppress
from functools import partial, wraps
from types import TracebackType
from typing import Any, Concatenate, ParamSpec, Self, TypeVar

import kbstore
from kbstore.aio.awaited import Awaited, iterating, reading, writing
from kbstore.aio.transaction import OpenTransaction, Turn
from kbstore.aio.watching import Watch
from kbstore.aio.workers import Workers
from kbstore.knowledge_base import KnowledgeBase as SyncKnowledgeBase
from kbstore.messages import Truth
from kbstore.reading.questions import Question
from kbstore.reading.watching import Watch as SyncWatch

P = ParamSpec("P")
R = TypeVar("R")


def _answering(method: Callable[Concatenate[Any, P], R]) -> Awaited[P, R]:
    """Return a method that answers a question as a coroutine, which needs no thread where that takes microseconds."""
    in_thread = reading(method)

    @wraps(method)
    async def awaited(self: "KnowledgeBase", /, *args: P.args, **kwargs: P.kwargs) -> R:
        if len(args) == 1 and not kwargs and self.is_quick(args[0]):  # type: ignore[arg-type]
            return method(self.sync, *args, **kwargs)
        return await in_thread(self, *args, **kwargs)

    return awaited


def _watching(
    method: Callable[Concatenate[Any, P], SyncWatch[R]],
) -> Callable[Concatenate[Any, P], Watch[R]]:
    """Return a method that returns a watch, with a watch for asyncio."""

    @wraps(method)
    def watch(self: "KnowledgeBase", /, *args: P.args, **kwargs: P.kwargs) -> Watch[R]:
        return self.watched(partial(method, self.sync, *args, **kwargs))

    return watch


class KnowledgeBase:
    """A knowledge base; made by `kbstore.aio.open`, for the tasks of one event loop.

    It has the methods of `kbstore.KnowledgeBase`, to be awaited, with the same parameters, answers and errors. Reading
    is done in a few threads of its own, and writing in another one, one task after the other; in an SQLite file,
    questions about one fact or number now are answered at once. A task that is cancelled while it writes gets its
    cancellation when the write has been stored or refused. `close` ends the threads.
    """

    def __init__(self, sync: SyncKnowledgeBase, workers: Workers) -> None:
        self.sync = sync
        """The `kbstore.KnowledgeBase`, whose methods block the thread that calls them."""
        self._workers = workers
        self._turn = Turn()

    @property
    def name(self) -> str:
        """The name of the knowledge base."""
        return self.sync.name

    @property
    def use_unknowns(self) -> bool:
        """Whether absent reads as unknown."""
        return self.sync.use_unknowns

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        await self.close()

    async def close(self) -> None:
        """End watches and threads, after an open transaction; methods called afterwards raise `StoreUnavailable`."""
        async with self._turn:
            await self._workers.close(self.sync.close)

    async def read(self, function: Callable[[SyncKnowledgeBase], R]) -> R:
        """Call a function with the `kbstore.KnowledgeBase` in a thread, to ask several questions in one go.

        >>> async def facts(kb):
        ...     return await kb.read(lambda kb: kb.state().to_dict()["facts"])
        """
        return await self._workers.read(lambda: function(self.sync))

    async def write(self, function: Callable[[SyncKnowledgeBase], R]) -> R:
        """Call a function with the `kbstore.KnowledgeBase`, in the thread that writes, when it is this task's turn."""
        async with self._turn:
            return await self._workers.write(lambda: function(self.sync))

    def is_quick(self, question: Question) -> bool:
        """Return whether a question about now is answered within microseconds, so that it needs no thread."""
        # the one connection of a store in memory belongs to an open transaction
        return not self._turn.is_taken and self.sync.is_quick(question)

    # -- writing ----------------------------------------------------------------------------------------------

    def transaction(self, *, client: str = "", note: str = "", expect: int | None = None) -> OpenTransaction:
        """Begin a transaction: ``async with kb.transaction() as tx: await tx.add(...)``.

        The parameters are those of `kbstore.KnowledgeBase.transaction`, without `connection`, as a connection of the
        caller's belongs to another thread.
        """
        made = self.sync.transaction(client=client, note=note, expect=expect)
        return OpenTransaction(made, self._turn, self._workers)

    add = writing(SyncKnowledgeBase.add)
    remove = writing(SyncKnowledgeBase.remove)
    add_goal = writing(SyncKnowledgeBase.add_goal)
    remove_goal = writing(SyncKnowledgeBase.remove_goal)
    add_metric = writing(SyncKnowledgeBase.add_metric)
    remove_metric = writing(SyncKnowledgeBase.remove_metric)
    update = writing(SyncKnowledgeBase.update)
    ingest = writing(SyncKnowledgeBase.ingest)
    replace = writing(SyncKnowledgeBase.replace)
    clear = writing(SyncKnowledgeBase.clear)
    load = writing(SyncKnowledgeBase.load)
    set_sensed = writing(SyncKnowledgeBase.set_sensed)
    apply = writing(SyncKnowledgeBase.apply)
    start = writing(SyncKnowledgeBase.start)
    end = writing(SyncKnowledgeBase.end)
    abort = writing(SyncKnowledgeBase.abort)
    archive = writing(SyncKnowledgeBase.archive)

    # -- one time ---------------------------------------------------------------------------------------------

    truth = _answering(SyncKnowledgeBase.truth)
    holds = _answering(SyncKnowledgeBase.holds)
    value = _answering(SyncKnowledgeBase.value)
    now = reading(SyncKnowledgeBase.now)
    state = reading(SyncKnowledgeBase.state)
    find = reading(SyncKnowledgeBase.find)
    explain = reading(SyncKnowledgeBase.explain)
    query = reading(SyncKnowledgeBase.query)
    instances = reading(SyncKnowledgeBase.instances)
    propositions = reading(SyncKnowledgeBase.propositions)
    functions = reading(SyncKnowledgeBase.functions)
    timed_knowledge = reading(SyncKnowledgeBase.timed_knowledge)
    goals = reading(SyncKnowledgeBase.goals)
    metric = reading(SyncKnowledgeBase.metric)
    constraints = reading(SyncKnowledgeBase.constraints)
    applicable = reading(SyncKnowledgeBase.applicable)
    to_pddl = reading(SyncKnowledgeBase.to_pddl)
    domain_to_pddl = reading(SyncKnowledgeBase.domain_to_pddl)
    to_problem = reading(SyncKnowledgeBase.to_problem)

    @property
    def domain(self) -> Awaitable[kbstore.Domain]:
        """The domain now, to be awaited. Raises `UnknownSymbol` if none has been loaded."""
        return self.read(lambda kb: kb.domain)

    # -- over time --------------------------------------------------------------------------------------------

    history = reading(SyncKnowledgeBase.history)
    when = reading(SyncKnowledgeBase.when)
    beliefs = reading(SyncKnowledgeBase.beliefs)
    diff = reading(SyncKnowledgeBase.diff)
    sample = reading(SyncKnowledgeBase.sample)
    runs = reading(SyncKnowledgeBase.runs)
    broken = reading(SyncKnowledgeBase.broken)
    timeline = reading(SyncKnowledgeBase.timeline)
    transactions = reading(SyncKnowledgeBase.transactions)
    frame = reading(SyncKnowledgeBase.frame)
    baseline = reading(SyncKnowledgeBase.baseline)
    changes = iterating(SyncKnowledgeBase.changes)
    watch = _watching(SyncKnowledgeBase.watch)
    watch_condition = _watching(SyncKnowledgeBase.watch_condition)

    def watched(self, begin: Callable[[], SyncWatch[R]]) -> Watch[R]:
        """Return the watch that `begin` makes, for asyncio."""
        return Watch(begin, self._workers)

    async def wait_for(self, condition: Question, timeout: float | None = None, *, poll: float = 0.05) -> int | None:
        """Wait until a condition is true, as `kbstore.KnowledgeBase.wait_for`, without a thread that waits."""
        async with self.watch_condition(condition, poll=poll) as watch:
            with suppress(TimeoutError):
                async with asyncio.timeout(timeout):
                    async for t, truth, _ in watch:
                        if truth is Truth.TRUE:
                            return t
        return None

    @property
    def history_from(self) -> Awaitable[int]:
        """The time from which on the store has history, to be awaited."""
        return self.read(lambda kb: kb.history_from)

    def __repr__(self) -> str:
        return f"<kbstore.aio.KnowledgeBase {self.name!r}>"


class Opening:
    """The result of `kbstore.aio.open`: await it, or enter it with ``async with``, which closes it afterwards."""

    def __init__(self, opening: Callable[[], SyncKnowledgeBase]) -> None:
        self._opening = opening
        self._opened: KnowledgeBase | None = None

    def __await__(self) -> Generator[Any, None, KnowledgeBase]:
        return self.__aenter__().__await__()

    async def __aenter__(self) -> KnowledgeBase:
        workers = Workers()
        opened: list[SyncKnowledgeBase] = []
        try:
            await workers.write(lambda: opened.append(self._opening()))
        except BaseException:
            # after a cancellation it may have been opened all the same
            await workers.close(opened[0].close if opened else lambda: None)
            raise
        self._opened = KnowledgeBase(opened[0], workers)
        return self._opened

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        assert self._opened is not None
        await self._opened.close()


def _opening(function: Callable[P, SyncKnowledgeBase]) -> Callable[P, Opening]:
    @wraps(function)
    def opening(*args: P.args, **kwargs: P.kwargs) -> Opening:
        return Opening(partial(function, *args, **kwargs))

    return opening


open = _opening(kbstore.open)
