"""`when` on one fact, as its history grows, against fetching the rows of its timeline."""

import sqlite3
from collections.abc import Iterator

import kbstore
from benchmarks.histories import DOMAIN, START, STEP, fact
from benchmarks.measuring import CPU, side_by_side
from benchmarks.report import Result
from benchmarks.settings import Settings
from kbstore import ManualClock, UpdateType

_KEY = "reachable wp0 wp1"


def measure(settings: Settings) -> Iterator[Result]:
    """Measure `when` for a fact that keeps changing its sign: over all of its history, and over three changes."""
    for count in settings.intervals:
        store = settings.new("when")
        with kbstore.open(store, "bench", clock=ManualClock(START), durability="normal") as kb:
            kb.load(DOMAIN)
            kb.add("wp0 - place", "wp1 - place")
            kb.update(
                (UpdateType.ADD_KNOWLEDGE, fact(_KEY, bool(index % 2)).changed(initial_time=START + (index + 1) * STEP))
                for index in range(count)
            )
            until, middle = START + (count + 2) * STEP, START + count // 2 * STEP
            connection = sqlite3.connect(store)
            rows = "SELECT initial_time, end_time, is_negative FROM facts WHERE kb_id = 1 AND timeline_id = ?"
            (timeline,) = connection.execute("SELECT id FROM timelines WHERE key = ?", (_KEY,)).fetchone()
            found = side_by_side(
                {
                    "raw": lambda: connection.execute(rows, (timeline,)).fetchall(),  # noqa: B023 - called at once
                    "all": lambda: kb.when(f"({_KEY})", START, until),  # noqa: B023 - called at once
                    "part": lambda: kb.when(f"({_KEY})", middle, middle + 3 * STEP),  # noqa: B023 - called at once
                },
                clock=CPU,
                seconds=settings.seconds,
            )
            connection.close()
        yield Result(f"when, {count:,} changes", "raw fetch of its rows", found["all"], found["raw"])
        yield Result(f"when, three of {count:,} changes", "raw fetch of all rows", found["part"], found["raw"])
