"""The threads in which a knowledge base is read and written while the event loop goes on."""

import asyncio
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress
from typing import TypeVar

from kbstore.errors import StoreUnavailable

R = TypeVar("R")

READERS = 4
"""The most threads that read; others wait for them."""


class Workers:
    """The threads of one knowledge base: one that writes, some that read; started when needed, ended by `close`."""

    def __init__(self) -> None:
        self._reading = ThreadPoolExecutor(READERS, "kbstore-read")
        self._writing = ThreadPoolExecutor(1, "kbstore-write")
        self.is_closed = False

    def submit(self, call: Callable[[], R]) -> Future[R]:
        """Submit a call that reads."""
        return self._submit(self._reading, call)

    async def read(self, call: Callable[[], R]) -> R:
        """Make a call that reads, and wait for it; after a cancellation its result is dropped."""
        return await asyncio.wrap_future(self.submit(call))

    async def write(self, call: Callable[[], R], *, is_certain: bool = False) -> R:
        """Make a call that writes, after those before it, and wait for it.

        A cancellation is raised when the call has ended, so that nothing is written behind the caller's back. A call
        that has not begun by then is dropped, unless it `is_certain`.
        """
        return await _finished(self._submit(self._writing, call), is_certain=is_certain)

    async def close(self, closing: Callable[[], None]) -> None:
        """Call `closing` after the calls before it, and end the threads."""
        if self.is_closed:
            return
        self.is_closed = True

        def end() -> None:
            closing()
            self._reading.shutdown()

        try:
            await _finished(self._writing.submit(end), is_certain=True)
        finally:
            # does not block: its only thread is idle
            self._writing.shutdown()

    def _submit(self, threads: ThreadPoolExecutor, call: Callable[[], R]) -> Future[R]:
        if self.is_closed:
            raise StoreUnavailable("this knowledge base is closed; open it again with kbstore.aio.open()")
        return threads.submit(call)


async def _finished(job: Future[R], *, is_certain: bool) -> R:
    """Wait for a job, also after a cancellation, which is raised afterwards."""
    done = asyncio.wrap_future(job)
    try:
        return await asyncio.shield(done)
    except asyncio.CancelledError:
        while (is_certain or not job.cancel()) and not done.done():
            with suppress(asyncio.CancelledError):
                await asyncio.wait([done])
        raise
