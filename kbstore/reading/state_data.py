"""The data of a `State`."""

from dataclasses import dataclass

from kbstore.evaluation.snapshot import Snapshot
from kbstore.model.timelines import StateRow
from kbstore.planning.rates import RunningAction


@dataclass(frozen=True, slots=True)
class StateData:
    """The assertions that hold at a time, the scheduled ones, and the running actions."""

    snapshot: Snapshot
    pending: list[StateRow]
    running: list[RunningAction]

    @property
    def size(self) -> int:
        """The size as caches count it: the number of assertions, and one for the state itself."""
        return 1 + sum(map(len, self.snapshot.parts.values())) + len(self.pending)
