"""What stood at a moment, as it was read; of the past, kept for a while, since nobody changes it any more."""

import threading
from collections import OrderedDict
from dataclasses import dataclass
from typing import NamedTuple

from kbstore.evaluation.snapshot import Snapshot, StateRow
from kbstore.planning.simulator import RunningAction
from kbstore.storage.repository import Head, LogPosition

_KEPT = 50_000
"""How many assertions the pictures that are kept may have together; 20 MB or so."""


class TemporalPoint(NamedTuple):
    """The moment that a question means: a time, and whose belief about it."""

    at: int
    belief: LogPosition
    head: Head
    is_past_belief: bool

    @property
    def is_settled(self) -> bool:
        """Whether what stood is the same whatever is written from now on (rule T5)."""
        return self.at < self.head.time and self.at < self.belief.time


@dataclass(frozen=True, slots=True)
class StateData:
    """What stood at a moment, what was pending, and what ran."""

    snapshot: Snapshot
    pending: list[StateRow]
    running: list[RunningAction]

    @property
    def size(self) -> int:
        """How many assertions it has."""
        return len(self.snapshot.rows) + len(self.pending)


class StateCache:
    """The pictures of settled moments that were asked for last, by their times."""

    def __init__(self) -> None:
        self._pictures: OrderedDict[int, StateData] = OrderedDict()
        self._size = 0
        self._turning = threading.Lock()

    def find(self, t: int) -> StateData | None:
        """The picture of a time, if it is there."""
        with self._turning:
            found = self._pictures.get(t)
            if found is not None:
                self._pictures.move_to_end(t)
            return found

    def put(self, t: int, picture: StateData) -> None:
        """Keep a picture, instead of those that nobody has asked for in a long time."""
        with self._turning:
            if t in self._pictures or picture.size > _KEPT:
                return
            self._pictures[t] = picture
            # each has some size of its own, too
            self._size += 1 + picture.size
            while self._size > _KEPT:
                _, oldest = self._pictures.popitem(last=False)
                self._size -= 1 + oldest.size
