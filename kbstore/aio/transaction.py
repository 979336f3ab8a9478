"""Transactions for asyncio, whose blocks may await other things, and the turns in which tasks write."""

import asyncio
from collections.abc import Callable
from contextvars import ContextVar
from types import TracebackType
from typing import Self, TypeVar

from kbstore.aio.awaited import writing
from kbstore.aio.workers import Workers
from kbstore.errors import Conflict
from kbstore.model.results import Transaction
from kbstore.writing.unit_of_work import OpenTransaction as SyncTransaction

R = TypeVar("R")

_turns: ContextVar[tuple[object, ...]] = ContextVar("kbstore_turns", default=())
"""The turns to write that a task has; tasks that it creates meanwhile inherit them."""


class Turn:
    """The turn to write, for which tasks wait one after another.

    Raises `Conflict` for a task that has it already, or whose creator has it, and would wait for ever.
    """

    def __init__(self) -> None:
        self._lock = asyncio.Lock()
        self._taken: object = None

    @property
    def is_taken(self) -> bool:
        """Whether a task has the turn."""
        return self._lock.locked()

    async def __aenter__(self) -> None:
        if self._taken in _turns.get():
            raise Conflict("a transaction is open in this task; write through it, or leave its block first")
        await self._lock.acquire()
        self._taken = object()
        _turns.set((*_turns.get(), self._taken))

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        _turns.set(tuple(turn for turn in _turns.get() if turn is not self._taken))
        self._taken = None
        self._lock.release()


class OpenTransaction:
    """An open transaction, from `kbstore.aio.KnowledgeBase.transaction`: an asynchronous context manager.

    Its methods are those of `kbstore.OpenTransaction`, awaited. Leaving the block stores their changes; leaving it by
    an exception, a cancellation included, stores nothing. Meanwhile other tasks wait before they write.
    """

    def __init__(self, transaction: SyncTransaction, turn: Turn, workers: Workers) -> None:
        self._transaction = transaction
        self._turn = turn
        self._workers = workers

    @property
    def result(self) -> Transaction:
        """The `Transaction`, after the block."""
        return self._transaction.result

    async def __aenter__(self) -> Self:
        await self._turn.__aenter__()
        try:
            await self._workers.write(self._transaction.__enter__)
        except BaseException as error:
            # also for a cancellation, after which it may have begun all the same
            await self.__aexit__(type(error), error, None)
            raise
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        try:
            await self._workers.write(lambda: self._transaction.__exit__(kind, error, trace), is_certain=True)
        finally:
            await self._turn.__aexit__(kind, error, trace)

    async def write(self, function: Callable[[SyncTransaction], R]) -> R:
        """Call a function with the `kbstore.OpenTransaction`, in the thread that writes."""
        return await self._workers.write(lambda: function(self._transaction))

    add = writing(SyncTransaction.add)
    remove = writing(SyncTransaction.remove)
    add_goal = writing(SyncTransaction.add_goal)
    remove_goal = writing(SyncTransaction.remove_goal)
    add_metric = writing(SyncTransaction.add_metric)
    remove_metric = writing(SyncTransaction.remove_metric)
    update = writing(SyncTransaction.update)
    replace = writing(SyncTransaction.replace)
    clear = writing(SyncTransaction.clear)
    load = writing(SyncTransaction.load)
    set_domain = writing(SyncTransaction.set_domain)
    set_sensed = writing(SyncTransaction.set_sensed)
    applicable = writing(SyncTransaction.applicable)
    apply = writing(SyncTransaction.apply)
    start = writing(SyncTransaction.start)
    end = writing(SyncTransaction.end)
    abort = writing(SyncTransaction.abort)
    report_start = writing(SyncTransaction.report_start)
    report_end = writing(SyncTransaction.report_end)
    state = writing(SyncTransaction.state)
    holds = writing(SyncTransaction.holds)
    value = writing(SyncTransaction.value)
