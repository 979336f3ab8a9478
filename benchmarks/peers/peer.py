"""What a peer has to do, and the history that it is given."""

from collections.abc import Iterable, Iterator
from typing import NamedTuple, Protocol

from benchmarks.histories import History
from kbstore.clock import OPEN


class Change(NamedTuple):
    """A change of what holds of a fact from a time on.

    Attributes:
        time: nanoseconds.
        key: the fact, as ``reachable wp0 wp1``.
        is_negative: its sign; None if nothing holds of it any more.
    """

    time: int
    key: str
    is_negative: bool | None


Standing = dict[str, bool]
"""What holds: each fact with its sign."""


class Peer(Protocol):
    """A store that knows what held when. Times only grow; a write that returned outlasts a loss of power."""

    def tell(self, changes: Iterable[Change]) -> None:
        """Load a history, in the fastest way; changes of one time are one transaction."""

    def state(self, t: int) -> Standing:
        """Everything that held."""

    def point(self, key: str, t: int) -> bool:
        """Whether a fact was true."""

    def write(self, change: Change) -> None:
        """Change the sign of a fact, in a transaction of its own."""

    def bulk(self, keys: list[str], t: int) -> None:
        """Many new facts, in one transaction."""

    def close(self) -> None:
        """Close the files."""


def changes(history: History) -> Iterator[Change]:
    """The facts of a history; those about an object end with it."""
    speaking: dict[str, dict[str, None]] = {}
    for time, gone, come, said in history.steps():
        for name in gone:
            yield from (Change(time, key, None) for key in speaking.pop(name))
        speaking.update((name, {}) for name in come)
        for key, is_negative in said:
            speaking[key.split(" ")[1]][key] = None
            yield Change(time, key, is_negative)


def intervals(changes: Iterable[Change]) -> list[tuple[str, bool, int, int]]:
    """A history as facts with their signs and the intervals in which they held."""
    found: list[tuple[str, bool, int, int]] = []
    standing: dict[str, tuple[bool, int]] = {}
    for time, key, is_negative in changes:
        if key in standing:
            found.append((key, *standing.pop(key), time))
        if is_negative is not None:
            standing[key] = (is_negative, time)
    return found + [(key, *since, OPEN) for key, since in standing.items()]
