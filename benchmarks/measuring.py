"""Measuring side by side: several ways to do the same, in turns, each reported by its lower quartile."""

import gc
import statistics
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

Way = Callable[[], Any]

MINIMUM = 7
"""The least number of rounds."""

_SLICE = 0.000_2
"""In seconds: anything faster is done several times for each reading of the clock."""


Clock = Callable[[], float]

CPU: Clock = time.process_time
"""CPU time, for work on rows in memory: nothing waits, and other processes do not count."""

WALL: Clock = time.perf_counter
"""Wall-clock time, for work that waits for the disk or for a server."""


def side_by_side(
    ways: dict[str, Way], *, clock: Clock = WALL, seconds: float = 1.0, minimum: int = MINIMUM
) -> dict[str, float]:
    """The lower quartile of each way's durations in seconds; one round does each once, in turns.

    Other work on the machine only ever adds to a duration, so that the lower ones tell more about the way itself.

    Args:
        ways: what to do, by name. Each is done once beforehand, unmeasured.
        clock: `CPU` or `WALL`.
        seconds: how long to go on, for all ways together.
        minimum: rounds at least.
    """
    repeats = {name: _repeats(way) for name, way in ways.items()}
    durations: dict[str, list[float]] = {name: [] for name in ways}
    began = time.perf_counter()
    rounds = 0
    with _quiet():
        while rounds < minimum or time.perf_counter() - began < seconds:
            for name, way in ways.items():
                durations[name].append(_lasting(way, repeats[name], clock))
            rounds += 1
    return {name: statistics.quantiles(found, n=4)[0] for name, found in durations.items()}


def once(way: Way, clock: Clock = WALL) -> float:
    """Return how long something takes that can be done only once, in seconds."""
    gc.collect()
    return _lasting(way, 1, clock)


def _repeats(way: Way) -> int:
    way()
    first = _lasting(way, 1, WALL)
    return 1 if first > _SLICE else max(1, int(_SLICE / max(first, 1e-7)))


def _lasting(way: Way, repeats: int, clock: Clock) -> float:
    if repeats == 1:
        began = clock()
        way()
        return clock() - began
    turns = range(repeats)
    began = clock()
    for _ in turns:
        way()
    return (clock() - began) / repeats


@contextmanager
def _quiet() -> Iterator[None]:
    """Begin without garbage; the collector itself stays on, as it is for a caller."""
    gc.collect()
    gc.freeze()
    try:
        yield
    finally:
        gc.unfreeze()
