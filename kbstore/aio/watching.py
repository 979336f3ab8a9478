"""Watches for asyncio, which follow a knowledge base or a condition without a thread for each."""

import asyncio
from collections.abc import AsyncIterator, Callable, Generator
from concurrent.futures import Future
from time import monotonic
from types import TracebackType
from typing import Any, Generic, Self, TypeVar

from kbstore.aio.workers import Workers
from kbstore.reading.watching import Watch as SyncWatch

Found = TypeVar("Found")


class Watch(AsyncIterator[Found], Generic[Found]):
    """An asynchronous iterator over changes as they happen (rules Q6, Q9), for one task at a time.

    It begins where it is awaited (``watch = await kb.watch()``), entered (``async with``) or first iterated, and raises
    there the errors of a wrong pattern or condition. `close` ends it quietly. A cancellation while it waits loses
    nothing: iterating further continues with the next change.
    """

    def __init__(self, begin: Callable[[], SyncWatch[Found]], workers: Workers) -> None:
        self._begin = begin
        self._workers = workers
        self._watch: SyncWatch[Found] | None = None
        self._looking: Future[bool] | None = None
        self._is_closed = False

    def __await__(self) -> Generator[Any, None, Self]:
        return self.__aenter__().__await__()

    async def __aenter__(self) -> Self:
        await self._begun()
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """End the iteration; a task that waits for the next thing stops waiting."""
        self._is_closed = True
        if self._watch is not None:
            self._watch.close()

    async def __anext__(self) -> Found:
        if self._is_closed:
            raise StopAsyncIteration
        watch = await self._begun()
        begin = monotonic()
        while not watch.is_ready:
            if self._workers.is_closed:
                raise StopAsyncIteration
            if not await self._look(watch, begin):
                await asyncio.sleep(watch.poll)
        try:
            return watch.take()
        except StopIteration:
            raise StopAsyncIteration from None

    async def _begun(self) -> SyncWatch[Found]:
        if self._watch is None:
            self._watch = await self._workers.read(self._begin)
        return self._watch

    async def _look(self, watch: SyncWatch[Found], begin: float) -> bool:
        """Look for the next change in a thread; if a cancelled task has left a look behind, wait for that instead."""
        if self._looking is None:
            self._looking = self._workers.submit(lambda: watch.look(begin))
        try:
            found = await asyncio.shield(asyncio.wrap_future(self._looking))
        except asyncio.CancelledError:
            raise
        except BaseException:
            self._looking = None
            raise
        self._looking = None
        return found
