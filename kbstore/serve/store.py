"""The knowledge bases of one store, each opened when it is first asked for."""

import asyncio
import os
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from typing import TYPE_CHECKING, TypeVar

import kbstore
from kbstore import aio
from kbstore.aio.workers import Workers
from kbstore.clock import Clock, SystemClock
from kbstore.serve.problems import Refused

if TYPE_CHECKING:
    from sqlalchemy import Engine

Found = TypeVar("Found")

MOST_WATCHES = 100
"""The most streams that are followed at once."""


class Store:
    """The knowledge bases of one store, for the tasks of one event loop.

    Attributes:
        patience: The most seconds that an answer may take.
        most: The most bytes that it may have.
    """

    def __init__(
        self,
        url: "str | os.PathLike[str] | Engine",
        *,
        allow_writes: bool = False,
        clock: Callable[[str], Clock] = lambda _: SystemClock(),
        patience: float = 10,
        most: int = 50_000_000,
    ) -> None:
        self._url = url
        self._allow_writes = allow_writes
        self._clock = clock
        self.patience = patience
        self.most = most
        self._opened: dict[str, aio.KnowledgeBase] = {}
        self._only = ""
        self._opening = asyncio.Lock()
        self._workers = Workers()
        self._watches: set[aio.Watch[kbstore.Change]] = set()

    async def names(self) -> list[str]:
        """The names of the knowledge bases."""
        return await self._workers.read(lambda: kbstore.knowledge_bases(self._url))

    def opened(self, name: str | None) -> aio.KnowledgeBase | None:
        """The knowledge base of a name, or the only one, if it has been asked for before."""
        return self._opened.get(self._only if name is None else name)

    async def get(self, name: str | None) -> aio.KnowledgeBase:
        """Return the knowledge base of a name; without a name the only one, also after others have been created."""
        found = self.opened(name)
        if found is not None:
            return found
        names = await self.names()
        if name is None and len(names) == 1:
            name = self._only = names[0]
        if name not in names:
            there = f"the store has {', '.join(names) or 'none yet'}"
            what = "which knowledge base? give kb=..." if name is None else f"there is no knowledge base {name!r}"
            raise Refused(422 if name is None else 404, f"{what}; {there}")
        async with self._opening:
            if name not in self._opened:
                clock, is_reading = self._clock(name), not self._allow_writes
                self._opened[name] = await aio.open(self._url, name, clock=clock, read_only=is_reading)
        return self._opened[name]

    async def read(self, kb: aio.KnowledgeBase, function: Callable[[kbstore.KnowledgeBase], Found]) -> Found:
        """Ask a knowledge base in a thread. Raises `Refused` if the answer takes longer than `patience`."""
        try:
            async with asyncio.timeout(self.patience):
                return await kb.read(function)
        except TimeoutError:
            raise Refused(
                503, f"the answer takes more than {self.patience:g} s: ask for less, such as a shorter span"
            ) from None

    @asynccontextmanager
    async def following(self, watch: aio.Watch[kbstore.Change]) -> AsyncIterator[aio.Watch[kbstore.Change]]:
        """Follow a watch, until `stop`. Raises `Refused` if too many streams are followed."""
        if len(self._watches) >= MOST_WATCHES:
            raise Refused(503, f"{MOST_WATCHES} streams are followed already; end one, or come back later")
        self._watches.add(watch)
        try:
            yield await watch
        finally:
            watch.close()
            self._watches.discard(watch)

    def stop(self) -> None:
        """End all streams, so that the server can stop."""
        for watch in self._watches:
            watch.close()

    async def close(self) -> None:
        """Close all knowledge bases, and end their threads."""
        self.stop()
        for kb in self._opened.values():
            await kb.close()
        await self._workers.close(lambda: None)
