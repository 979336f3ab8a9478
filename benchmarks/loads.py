"""Loading problems: parsing alone, and loading against raw writes of the same rows."""

from collections.abc import Iterator

import kbstore
from benchmarks.histories import DOMAIN, START
from benchmarks.measuring import CPU, once
from benchmarks.report import Result
from benchmarks.settings import Settings
from benchmarks.writes import same_rows
from kbstore import ManualClock
from kbstore.pddl.domain_reader import read_domain
from kbstore.pddl.problem_reader import read_problem


def measure(settings: Settings) -> Iterator[Result]:
    """Measure problems with more and more init facts; parsing is linear if the time for each fact stays the same."""
    each: float | None = None
    for count in settings.init:
        text = problem(count)
        domain = read_domain(DOMAIN)
        reading = once(lambda: read_problem(text, domain), CPU) / count  # noqa: B023 - called at once
        if each is not None:
            yield Result(f"reading alone, each of {count:,} init facts", f"of {settings.init[0]:,}", reading, each)
        each = each or reading
        store, empty = settings.new("load"), settings.new("load-raw")
        kbstore.open(empty, "bench", clock=ManualClock(START)).close()
        with kbstore.open(store, "bench", clock=ManualClock(START)) as kb:
            ours = once(lambda: kb.load(DOMAIN, text), CPU)  # noqa: B023 - called at once
        theirs = once(same_rows(store, empty), CPU)
        yield Result(f"load, {count:,} init facts", "raw, the same rows", ours, theirs, 12)


def problem(count: int) -> str:
    """A problem with a number of init facts."""
    places = [f"wp{number}" for number in range(int(count**0.5) + 1)]
    facts = [f"(reachable {a} {b})" for a in places for b in places][:count]
    head = f"(define (problem large) (:domain office) (:objects {' '.join(places)} - place) (:init"
    return "\n".join((head, *facts, ") (:goal (and)))"))
