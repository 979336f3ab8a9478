"""What a `State` is made from."""

from dataclasses import dataclass

from kbstore.evaluation.snapshot import Snapshot, StateRow
from kbstore.planning.rates import RunningAction


@dataclass(frozen=True, slots=True)
class StateData:
    """What holds at an instant, what is scheduled, and what runs."""

    snapshot: Snapshot
    pending: list[StateRow]
    running: list[RunningAction]

    @property
    def size(self) -> int:
        """How many assertions it has, and one for itself."""
        return 1 + len(self.snapshot.rows) + len(self.pending)
