"""Questions about one fact or number: at t against a raw prepared point query, about now against a dict."""

from collections.abc import Iterator

import kbstore
from benchmarks import raw
from benchmarks.histories import DOMAIN, START, STEP, UNIFORM, History, fact
from benchmarks.measuring import CPU, side_by_side
from benchmarks.report import Result
from benchmarks.settings import Settings
from kbstore import Function, ManualClock

_KEY = "reachable wp3 wp4"


def measure(settings: Settings) -> Iterator[Result]:
    """Measure `holds` at a time, with an item and with text, and `holds` and `value` now."""
    history = History(UNIFORM, settings.size)
    path = settings.store(history)
    points = raw.Points(settings.new("points"), path)
    timeline = points.timeline(_KEY)
    t = history.moments()[3]
    item, text = fact(_KEY), f"({_KEY})"
    with kbstore.open(path, "bench", clock=ManualClock(START + (history.size + 1) * STEP)) as kb:
        found = side_by_side(
            {
                "raw": lambda: points.fetch(timeline, t),
                "item": lambda: kb.holds(item, at=t),
                "text": lambda: kb.holds(text, at=t),
            },
            clock=CPU,
            seconds=settings.seconds,
        )
        yield Result("holds at t, prepared item", "raw point query", found["item"], found["raw"], 3)
        yield Result("holds at t, PDDL text", "raw point query", found["text"], found["raw"])
    for domain in (DOMAIN, None):
        yield from _now(settings, domain)


def _now(settings: Settings, domain: str | None) -> Iterator[Result]:
    seen, battery = fact("seen cup"), Function.model_validate({"attribute_name": "battery", "values": ["kenny"]})
    world = {"(seen cup)": True}
    store = settings.new("now")
    with kbstore.open(store, "bench", clock=ManualClock(START)) as kb:
        if domain is not None:
            kb.load(domain)
        kb.add("cup - item", "kenny - robot", "(seen cup)", "(= (battery kenny) 80)")
        connection = raw.connect(store)
        found = side_by_side(
            {
                "version": lambda: connection.execute("PRAGMA data_version").fetchone(),
                "dict": lambda: world.get("(seen cup)"),
                "holds": lambda: kb.holds(seen),
                "value": lambda: kb.value(battery),
            },
            clock=CPU,
            seconds=settings.seconds,
        )
        connection.close()
    where = "" if domain else ", without a domain"
    yield Result(f"holds now{where}", "dict.get, in a function", found["holds"], found["dict"])
    # what SQLite needs to say whether another process has committed since
    yield Result(f"holds now{where}", "PRAGMA data_version", found["holds"], found["version"])
    yield Result(f"value now{where}", "dict.get, in a function", found["value"], found["dict"])
