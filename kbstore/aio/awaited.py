"""Turns methods of kbstore's classes into coroutines with the same parameters, docstrings and types.

No method is written a second time: ``history = reading(kbstore.KnowledgeBase.history)`` is enough for people, for type
checkers and at run time.
"""

from collections.abc import AsyncIterator, Awaitable, Callable, Coroutine, Iterator
from functools import wraps
from itertools import islice
from typing import Any, Concatenate, ParamSpec, Protocol, TypeVar

P = ParamSpec("P")
R = TypeVar("R")

CHUNK = 256
"""The number of items of an iterator that are read in one go."""

Awaited = Callable[Concatenate[Any, P], Coroutine[Any, Any, R]]
"""A method that is a coroutine."""


class Reads(Protocol):
    """An object that calls functions with the object behind it, in a thread that reads."""

    def read(self, function: Callable[[Any], R], /) -> Awaitable[R]:
        """Call a function."""


class Writes(Protocol):
    """An object that calls functions with the object behind it, in the thread that writes."""

    def write(self, function: Callable[[Any], R], /) -> Awaitable[R]:
        """Call a function."""


def reading(method: Callable[Concatenate[Any, P], R]) -> Awaited[P, R]:
    """Return a method that reads, as a coroutine."""

    @wraps(method)
    async def awaited(self: Reads, /, *args: P.args, **kwargs: P.kwargs) -> R:
        return await self.read(lambda subject: method(subject, *args, **kwargs))

    return awaited


def writing(method: Callable[Concatenate[Any, P], R]) -> Awaited[P, R]:
    """Return a method that writes, as a coroutine."""

    @wraps(method)
    async def awaited(self: Writes, /, *args: P.args, **kwargs: P.kwargs) -> R:
        return await self.write(lambda subject: method(subject, *args, **kwargs))

    return awaited


def iterating(
    method: Callable[Concatenate[Any, P], Iterator[R]],
) -> Callable[Concatenate[Any, P], AsyncIterator[R]]:
    """Return a method that returns an iterator, as an asynchronous iterator."""

    @wraps(method)
    async def awaited(self: Reads, /, *args: P.args, **kwargs: P.kwargs) -> AsyncIterator[R]:
        found = await self.read(lambda subject: method(subject, *args, **kwargs))
        while chunk := await self.read(lambda _: list(islice(found, CHUNK))):
            for each in chunk:
                yield each

    return awaited
