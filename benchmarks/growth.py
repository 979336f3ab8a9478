"""Growth of the time for the state at t with the length of the history: each size against the one before."""

from collections.abc import Callable, Iterator
from contextlib import ExitStack
from itertools import count

import kbstore
from benchmarks.histories import SHAPES, START, STEP, History
from benchmarks.measuring import CPU, side_by_side
from benchmarks.report import Result
from benchmarks.settings import Settings
from kbstore import KnowledgeBase, ManualClock

_LARGE = 1_000_000
"""Sizes from this one on have a bar."""


def measure(settings: Settings) -> Iterator[Result]:
    """Measure each shape of history at the worst of six times, all sizes in turns."""
    for shape in SHAPES:
        worst = dict.fromkeys(settings.grown, 0.0)
        with ExitStack() as stack:
            stores: dict[int, tuple[KnowledgeBase, list[int]]] = {}
            for size in settings.grown:
                history = History(shape, size)
                clock = ManualClock(START + (size + 1) * STEP)
                kb = stack.enter_context(kbstore.open(settings.store(history), "bench", clock=clock))
                stores[size] = kb, history.moments()
            for index in range(6):
                ways = {str(size): _way(kb, moments[index]) for size, (kb, moments) in stores.items()}
                found = side_by_side(ways, clock=CPU, seconds=settings.seconds)
                worst = {size: max(before, found[str(size)]) for size, before in worst.items()}
        for small, large in zip(settings.grown, settings.grown[1:], strict=False):
            what = f"growth of state at t, {shape}, {large:,}"
            yield Result(what, f"the same with {small:,}", worst[large], worst[small], 1.3 if small >= _LARGE else None)


def _way(kb: KnowledgeBase, t: int) -> Callable[[], bool]:
    asked = kb.state(at=t).facts[500]
    times = count(t)
    return lambda: kb.state(at=next(times)).holds(asked)
