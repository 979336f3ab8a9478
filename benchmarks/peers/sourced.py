"""eventsourcing: the world as one aggregate on SQLite, with snapshots, as advised for long streams."""

from bisect import bisect_right
from collections.abc import Iterable
from itertools import groupby
from pathlib import Path
from typing import ClassVar
from uuid import UUID

from eventsourcing.application import Application
from eventsourcing.domain import Aggregate, event

from benchmarks.peers.peer import Change, Standing

_INTERVAL = 500
"""Events from one snapshot to the next."""

Pairs = list[tuple[str, bool | None]]


class World(Aggregate):
    """The world, which each event changes."""

    def __init__(self) -> None:
        self.facts: dict[str, bool] = {}

    @event("Told")
    def tell(self, changes: Pairs) -> None:
        """Record what holds from now on, or no longer does."""
        for key, is_negative in changes:
            if is_negative is None:
                del self.facts[key]
            else:
                self.facts[key] = is_negative


class _Worlds(Application[UUID]):
    is_snapshotting_enabled = True
    env: ClassVar[dict[str, str]] = {"AGGREGATE_CACHE_MAXSIZE": "1", "DEEPCOPY_FROM_AGGREGATE_CACHE": "n"}


class Sourced:
    """One stream of events. The times of its versions are kept in memory, which costs it nothing here."""

    def __init__(self, path: Path) -> None:
        self._application = _Worlds({"PERSISTENCE_MODULE": "eventsourcing.sqlite", "SQLITE_DBNAME": str(path)})
        world = World()
        self._id = world.id
        self._times: list[int] = []
        self._application.save(world)

    def tell(self, changes: Iterable[Change]) -> None:
        """An event for each transaction, saved as often as a snapshot is taken."""
        world: World = self._application.repository.get(self._id)
        for time, told in groupby(changes, key=lambda change: change.time):
            world.tell([(key, is_negative) for _, key, is_negative in told])
            self._times.append(time)
            if world.version % _INTERVAL == 0:
                self._application.save(world)
                self._application.take_snapshot(self._id)
        self._application.save(world)

    def _at(self, t: int) -> World:
        # the first version is the empty world
        return self._application.repository.get(self._id, version=1 + bisect_right(self._times, t))

    def state(self, t: int) -> Standing:
        """The version at the time: from the snapshot before it, event by event."""
        return self._at(t).facts

    def point(self, key: str, t: int) -> bool:
        """The same, since a single fact cannot be read alone."""
        return self._at(t).facts.get(key) is False

    def write(self, change: Change) -> None:
        """One event, saved."""
        self._save(change.time, [(change.key, change.is_negative)])

    def bulk(self, keys: list[str], t: int) -> None:
        """One event with all of them."""
        self._save(t, [(key, False) for key in keys])

    def _save(self, t: int, told: Pairs) -> None:
        world: World = self._application.repository.get(self._id)
        world.tell(told)
        self._application.save(world)
        self._times.append(t)
        if world.version % _INTERVAL == 0:
            self._application.take_snapshot(self._id)

    def close(self) -> None:
        """Close the application."""
        self._application.close()
