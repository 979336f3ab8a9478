"""What a peer is asked to do, and the history that it is told."""

from collections.abc import Iterable, Iterator
from typing import NamedTuple, Protocol

from benchmarks.histories import History


class Change(NamedTuple):
    """From a time on, this is said of a fact.

    Attributes:
        time: nanoseconds.
        key: the fact, as ``reachable wp0 wp1``.
        is_negative: its sign; None if nothing is said of it any more.
    """

    time: int
    key: str
    is_negative: bool | None


Standing = dict[str, bool]
"""What stands: each fact with its sign."""


class Peer(Protocol):
    """A store that can tell what stood when. Times only grow; a write that returned outlasts a loss of power."""

    def tell(self, changes: Iterable[Change]) -> None:
        """Take a history, the fastest way; changes of one time are one transaction."""

    def state(self, t: int) -> Standing:
        """All that stood."""

    def point(self, key: str, t: int) -> bool:
        """Whether a fact was true."""

    def write(self, change: Change) -> None:
        """Change the sign of a fact that stands, in a transaction of its own."""

    def bulk(self, keys: list[str], t: int) -> None:
        """Many new facts, in one transaction."""

    def close(self) -> None:
        """Close the files."""


def changes(history: History) -> Iterator[Change]:
    """The facts of a history: what is said of an object that goes goes with it."""
    speaking: dict[str, dict[str, None]] = {}
    for time, gone, come, said in history.steps():
        for name in gone:
            yield from (Change(time, key, None) for key in speaking.pop(name))
        speaking.update((name, {}) for name in come)
        for key, is_negative in said:
            speaking[key.split(" ")[1]][key] = None
            yield Change(time, key, is_negative)
