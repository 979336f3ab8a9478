"""``python -m benchmarks.soak``: one store under a steady load, for minutes; what it takes should not grow.

One process writes a number of changes a second, in transactions of ten; two poll the state of now and single facts
ten times a second, and one watches. Each is paced by the clock, so that a wait shows as a latency and not as less work.
It stops by itself. Memory, the write-ahead log and latencies are printed at the end, and as JSON with ``--json``.
"""

import argparse
import json
import multiprocessing
import os
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final, NamedTuple

import kbstore

CHANGES: Final = 200
"""The default number of facts that change in a second."""

_TOGETHER: Final = 10
_PLACES: Final = 500
_POLLS: Final = 10.0
_QUIET: Final = 5.0
_PATIENCE: Final = 60.0
"""Seconds beyond its time after which a process is taken to hang."""

_DOMAIN: Final = """
(define (domain soak)
  (:types place)
  (:predicates (open ?p - place))
  (:functions (level ?p - place)))
"""

_Work = Callable[[kbstore.KnowledgeBase, int], None]


class Spread(NamedTuple):
    """The latencies of one kind of work, in milliseconds."""

    count: int
    p50: float
    p99: float
    longest: float


class Soak(NamedTuple):
    """What a soak measured.

    Attributes:
        latencies: by kind of work.
        memory: of each process, after a fifth of the time and at the end, in MB.
        log: the largest write-ahead log that was seen, in MB.
        watched: the number of transactions that the watcher got, and the number that there were.
    """

    seconds: float
    latencies: dict[str, Spread]
    memory: dict[str, tuple[float, float]]
    log: float
    watched: tuple[int, int]


def spread(latencies: list[float]) -> Spread:
    """The spread of latencies in seconds."""
    found = sorted(latencies)
    places = (len(found) // 2, len(found) * 99 // 100, len(found) - 1)
    return Spread(len(found), *(round(found[place] * 1000, 3) for place in places))


def soak(path: Path, seconds: float, changes: int = CHANGES) -> Soak:
    """Run the load against a new store for some seconds."""
    with kbstore.open(path, "soak") as kb:
        kb.load(_DOMAIN)
        kb.add(*(f"p{number} - place" for number in range(_PLACES)))
        kb.add(*(f"(= (level p{number}) 0)" for number in range(_PLACES)))
        first = kb.add("(open p0)").number
    # a fork would take along what this process has open
    processes = multiprocessing.get_context("spawn")
    start = processes.Barrier(4)
    until = time.monotonic() + seconds + _PATIENCE
    work = {"write": changes / _TOGETHER, "poll a state": _POLLS, "poll a fact": _POLLS, "watch": changes / _TOGETHER}
    running = [
        processes.Process(target=_run, args=(name, path, rate, seconds, first, start)) for name, rate in work.items()
    ]
    for process in running:
        process.start()
    log = 0
    while time.monotonic() < until and any(process.is_alive() for process in running):
        time.sleep(0.05)
        log = max(log, _size(path.with_name(path.name + "-wal")))
    for process in running:
        process.join(0.0 if process.is_alive() else None)
    if any(process.exitcode != 0 for process in running):
        for process in running:
            process.terminate()
        raise RuntimeError("a process of the soak failed, or did not end in time")
    found = {name: json.loads(_results(path, name).read_text()) for name in work}
    with kbstore.open(path, "soak", read_only=True) as kb:
        recorded = kb.state().facts and sum(1 for _ in kb.changes(first))
    return Soak(
        seconds,
        {name: spread(each["latencies"]) for name, each in found.items()},
        {name: each["memory"] for name, each in found.items()},
        log / 1e6,
        (len(found["watch"]["latencies"]), int(recorded)),
    )


def _results(path: Path, name: str) -> Path:
    return path.with_name(f"{name}.json")


def _run(name: str, path: Path, rate: float, seconds: float, first: int, start: Any) -> None:
    """One process: its latencies, and its memory after a fifth of the time and at the end."""
    with kbstore.open(path, "soak") as kb:
        run = _watch if name == "watch" else _paced
        start.wait(_PATIENCE)
        latencies, early = run(kb, name, rate, seconds, first)
        _results(path, name).write_text(json.dumps({"latencies": latencies, "memory": (early, _memory())}))


def _paced(kb: kbstore.KnowledgeBase, name: str, rate: float, seconds: float, _: int) -> tuple[list[float], float]:
    work = _WORK[name]
    latencies: list[float] = []
    began, early = time.monotonic(), 0.0
    for turn in range(round(seconds * rate)):
        time.sleep(max(0.0, began + turn / rate - time.monotonic()))
        started = time.perf_counter()
        work(kb, turn)
        latencies.append(time.perf_counter() - started)
        if not early and time.monotonic() - began > seconds / 5:
            early = _memory()
    return latencies, early


def _watch(kb: kbstore.KnowledgeBase, _: str, rate: float, seconds: float, first: int) -> tuple[list[float], float]:
    """How long after its time a transaction is delivered, until the last, or until none has come for some seconds."""
    latencies: list[float] = []
    began, early = time.monotonic(), 0.0
    for change in kb.watch(after=first, timeout=_QUIET):
        latencies.append(max(0.0, (time.time_ns() - change.time) / 1e9))
        if not early and time.monotonic() - began > seconds / 5:
            early = _memory()
        if change.number == first + round(seconds * rate):
            break
    return latencies, early


def _write(kb: kbstore.KnowledgeBase, turn: int) -> None:
    numbers = [(turn * _TOGETHER + place) % _PLACES for place in range(_TOGETHER)]
    kb.add(*(f"(= (level p{number}) {turn + 1})" for number in numbers))


def _poll_state(kb: kbstore.KnowledgeBase, _: int) -> None:
    kb.state()


def _poll_fact(kb: kbstore.KnowledgeBase, turn: int) -> None:
    kb.value(f"(level p{turn % _PLACES})")


_WORK: Final[dict[str, _Work]] = {"write": _write, "poll a state": _poll_state, "poll a fact": _poll_fact}


def _memory() -> float:
    """The memory of this process, in MB; 0 where that is unknown."""
    status = Path("/proc/self/statm")
    if not status.exists():
        return 0.0
    return int(status.read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 1e6


def _size(path: Path) -> int:
    try:
        return path.stat().st_size
    except FileNotFoundError:
        return 0


def main() -> None:
    """Run the soak, and print what it measured."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.soak", description="A steady load for minutes.")
    parser.add_argument("--seconds", type=float, default=300.0, help="how long (default: 300)")
    parser.add_argument("--changes", type=int, default=CHANGES, help=f"changes a second (default: {CHANGES})")
    parser.add_argument("--directory", help="where the store is made (default: where temporary files are)")
    parser.add_argument("--json", action="store_true", help="print JSON")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="kbstore-soak-", dir=arguments.directory) as directory:
        found = soak(Path(directory) / "soak.db", arguments.seconds, arguments.changes)
    if arguments.json:
        print(json.dumps(found._asdict()))
        return
    for name, (count, p50, p99, longest) in found.latencies.items():
        early, late = found.memory[name]
        print(
            f"{name:13} {count:7,} times   p50 {p50:7.2f} ms   p99 {p99:7.2f} ms   longest {longest:8.2f} ms   "
            f"memory {early:.0f} MB, at the end {late:.0f} MB"
        )
    print(
        f"write-ahead log: {found.log:.1f} MB at most; "
        f"watched {found.watched[0]:,} of {found.watched[1]:,} transactions"
    )


if __name__ == "__main__":
    main()
