"""``python -m benchmarks.ingesting STORE COUNT``: ingest facts, and print the memory used meanwhile, in MB."""

import json
import os
import sys
from collections.abc import Iterator
from pathlib import Path

import kbstore
from benchmarks.histories import DOMAIN, START, fact
from kbstore import Fact, ManualClock


def main() -> None:
    """Ingest facts that are all new, so that nothing remembered is of use."""
    store, count = Path(sys.argv[1]), int(sys.argv[2])
    places = [f"wp{number}" for number in range(int(count**0.5) + 1)]

    def facts() -> Iterator[Fact]:
        for number in range(count):
            first, second = divmod(number, len(places))
            yield fact(f"reachable {places[first]} {places[second]}")

    held: dict[int, float] = {}
    with kbstore.open(store, "bench", clock=ManualClock(START)) as kb:
        kb.load(DOMAIN)
        kb.add(*(f"{place} - place" for place in places))
        kb.ingest(facts(), batch=min(10_000, count // 10), progress=lambda done: held.update({done: _held()}))
    json.dump(held, sys.stdout)


def _held() -> float:
    """Resident memory; the greatest ever, which `getrusage` tells, begins with that of the process that forked."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6


if __name__ == "__main__":
    main()
