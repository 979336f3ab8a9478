"""Each peer side by side with kbstore: the state at t, a point at t, a single write, many facts at once."""

import gc
import importlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import count
from pathlib import Path
from statistics import median

import kbstore
from benchmarks.histories import PASSING, START, STEP, UNIFORM, History, fact
from benchmarks.measuring import CPU, WALL, Way, once, side_by_side
from benchmarks.peers.peer import Change, Peer, changes
from benchmarks.report import Missing, Result
from benchmarks.settings import Settings
from benchmarks.writes import copy
from kbstore import KnowledgeBase, ManualClock

_AHEAD = 1.0
"""The bar: kbstore takes less time than the peer."""


@dataclass(frozen=True)
class _Kind:
    """A peer: the distribution to install, and the class that adapts it."""

    name: str
    distribution: str
    module: str
    type_name: str
    ahead_in_bulk: bool = True

    def make(self, path: Path) -> Peer:
        """A new one. Raises `ModuleNotFoundError` if it is not installed."""
        module = importlib.import_module(f"benchmarks.peers.{self.module}")
        peer: Peer = getattr(module, self.type_name)(path)
        return peer


PEERS = (
    _Kind("DuckDB", "duckdb", "duck", "Duck", False),
    _Kind("SQLAlchemy-Continuum", "SQLAlchemy-Continuum", "continuum", "Continuum"),
    _Kind("eventsourcing", "eventsourcing", "sourced", "Sourced"),
)


def measure(settings: Settings) -> Iterator[Result | Missing]:
    """Measure the peers that are installed, and list the others as missing."""
    for kind in PEERS:
        for shape in (UNIFORM, PASSING):
            history = History(shape, settings.peers)
            try:
                peer = kind.make(settings.new(f"{kind.module}-{shape.split()[0]}"))
            except ModuleNotFoundError:
                yield Missing(kind.name, f"not installed: pip install {kind.distribution}")
                break
            peer.tell(changes(history))
            yield from _reading(settings, kind.name, peer, history)
            if shape == UNIFORM:
                yield from _writing(settings, kind, peer, history)
            peer.close()


def _reading(settings: Settings, name: str, peer: Peer, history: History) -> Iterator[Result]:
    """Measure each question at the time that is worst for kbstore, of six."""
    worst: dict[str, Result] = {}
    with kbstore.open(settings.store(history), "bench", clock=_clock(history)) as kb:
        for t in history.moments():
            for what, (ours, theirs) in _questions(kb, peer, t).items():
                found = side_by_side({"ours": ours, "theirs": theirs}, clock=CPU, seconds=settings.seconds / 4)
                told = f"{what}, {history.shape}, {history.size:,}"
                result = Result(told, name, found["ours"], found["theirs"], _AHEAD)
                if what not in worst or result.ratio > worst[what].ratio:
                    worst[what] = result
    yield from worst.values()


def _questions(kb: KnowledgeBase, peer: Peer, t: int) -> dict[str, tuple[Way, Way]]:
    """The questions, after a check that both answer alike."""
    asked = kb.state(at=t).facts[500]
    times = count(t)
    key = " ".join(asked.key)
    standing = peer.state(t)
    if standing != {" ".join(item.key): item.is_negative for item in kb.state(at=t).facts}:
        raise AssertionError(f"{type(peer).__name__} tells another state at {t} than kbstore")
    return {
        "state at t and one question": (lambda: kb.state(at=next(times)).holds(asked), lambda: peer.state(t)[key]),
        "holds at t": (lambda: kb.holds(asked, at=t), lambda: peer.point(key, t)),
    }


def _writing(settings: Settings, kind: _Kind, peer: Peer, history: History) -> Iterator[Result]:
    store = settings.new("beside")
    copy(settings.store(history), store)
    clock = _clock(history)
    with kbstore.open(store, "bench", clock=clock) as kb:
        flips = _Flips(clock, {" ".join(item.key): item.is_negative for item in kb.state().facts})
        ways = {"ours": flips.way(lambda c: kb.add(fact(c.key, bool(c.is_negative)))), "theirs": flips.way(peer.write)}
        found = side_by_side(ways, clock=WALL, seconds=settings.seconds, minimum=50)
        yield Result("single durable write", kind.name, found["ours"], found["theirs"], _AHEAD)
        yield _bulk(settings, kind, peer, kb, clock)


class _Flips:
    """Changes of the sign of one fact after another; each side makes its own."""

    def __init__(self, clock: ManualClock, signs: dict[str, bool]) -> None:
        self._clock = clock
        self._signs = signs

    def way(self, write: Callable[[Change], object]) -> Way:
        """One change each time it is called."""
        signs = dict(self._signs)
        keys = list(signs)
        count = 0

        def flip() -> None:
            nonlocal count
            key = keys[count * 389 % len(keys)]
            count += 1
            signs[key] = not signs[key]
            # peers keep microseconds
            self._clock.advance(1000)
            write(Change(self._clock.now(), key, signs[key]))

        return flip


def _bulk(settings: Settings, kind: _Kind, peer: Peer, kb: KnowledgeBase, clock: ManualClock) -> Result:
    """Add facts about new places, which kbstore checks to exist, up to three times while it is quick."""
    count = settings.peers_bulk
    ours: list[float] = []
    theirs: list[float] = []
    while len(ours) < 3 and sum(theirs) < settings.seconds:
        places = [f"new{len(ours)}-{number}" for number in range(int(count**0.5) + 1)]
        kb.add(*(f"{place} - place" for place in places))
        keys = [f"reachable {a} {b}" for a in places for b in places][:count]
        items = [fact(key) for key in keys]
        clock.advance(STEP)
        gc.collect()
        ours.append(once(lambda: kb.add(*items), CPU))  # noqa: B023 - called at once
        theirs.append(once(lambda: peer.bulk(keys, clock.now()), CPU))  # noqa: B023 - called at once
    bar = _AHEAD if kind.ahead_in_bulk else None
    return Result(f"{count:,} new facts at once", kind.name, median(ours), median(theirs), bar)


def _clock(history: History) -> ManualClock:
    return ManualClock(START + (history.size + 1) * STEP)
