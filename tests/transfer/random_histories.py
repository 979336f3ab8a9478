"""Random histories of a knowledge base, and all questions about one, for comparing answers."""

import random
from collections.abc import Iterator

from kbstore import HistoryUnavailable, KbStoreError, ManualClock, seconds

START = seconds(100)

DOMAIN = """
(define (domain yard)
  (:requirements :typing :fluents :durative-actions :negative-preconditions)
  (:types place robot - object room - place)
  (:constants home - place)
  (:predicates (lit) (open ?p - place) (near ?r - robot ?p - place) (busy ?r - robot))
  (:functions (cost) (battery ?r - robot))
  (:durative-action work :parameters (?r - robot ?p - place)
    :duration (and (>= ?duration 0) (<= ?duration 100))
    :condition (at start (not (busy ?r)))
    :effect (and (at start (busy ?r)) (at end (not (busy ?r))) (at end (open ?p))
                 (when (at start (lit)) (at end (near ?r ?p)))
                 (increase (cost) (* #t 2)) (decrease (battery ?r) (* #t 0.5)))))
"""

WIDER = DOMAIN.replace("(lit) (open", "(lit) (dusty ?p - place) (open")

OBJECTS = ("a - place", "b - room", "r - robot", "s - robot")
ATOMS = ("(lit)", "(open a)", "(open b)", "(near r a)", "(near r b)", "(near s a)", "(busy s)")
FUNCTIONS = ("(cost)", "(battery r)", "(battery s)")
GOALS = ("(open a)", "(near r b)", "(> (cost) 3)", "(or (lit) (open b))", "(not (lit))")
METRICS = ("minimize (cost)", "maximize (battery r)")
PATTERNS = ("(lit)", "(open ?)", "(near ? ?)", "(cost)", "(battery ?)", "? - place", "? - robot", "minimize (cost)")
CONDITIONS = ("(lit)", "(not (open a))", "(>= (cost) 4)", "(exists (?p - place) (near r ?p))")


def live(kb, clock: ManualClock, seed: int, steps: int, *, late: bool = False) -> Iterator[int]:
    """Write step by step, always in the same way for a seed; yield the time of each step before it.

    With `late`, every other step is late knowledge. Schedules and runs are ahead of the clock by some seconds, so that
    any later time cuts them.
    """
    chance = random.Random(seed)
    yield clock.now()
    kb.load(DOMAIN)
    kb.add(*OBJECTS, "(= (cost) 0)", "(= (battery r) 50)", client="loader", note="the yard")
    for _ in range(steps):
        clock.advance(chance.choice((0, 0, 1, seconds(1), seconds(2))))
        yield clock.now()
        try:
            if late and chance.random() < 0.5:
                _late_step(kb, chance, clock.now())
            else:
                _step(kb, chance, clock.now())
        except KbStoreError:
            # refused by a rule, as it would be anywhere
            continue


def _step(kb, chance: random.Random, now: int) -> None:
    ahead = now + seconds(chance.choice((1, 2, 3, 5, 8, 13)))
    atom, function, item = chance.choice(ATOMS), chance.choice(FUNCTIONS), chance.choice(OBJECTS)
    running = kb.state().running
    match chance.randrange(18):
        case 0 | 1 | 2:
            kb.add(atom if chance.random() < 0.7 else f"(not {atom})", client=chance.choice(("mapper", "driver")))
        case 3 | 4:
            kb.add(atom if chance.random() < 0.5 else f"(not {atom})", initial_time=ahead)
        case 5:
            kb.remove(atom)
        case 6:
            kb.add(f"(= {function} {chance.choice((1.5, 2, 40))})", initial_time=chance.choice((0, ahead)))
        case 7:
            kb.add(f"(increase {function} {chance.choice((0.1, 3))})")
        case 8:
            kb.add(f"(increase {function} (* #t {chance.choice((0, 0.25, -1))}))")
        case 9:
            for scheduled in kb.timed_knowledge()[:1]:
                kb.remove(scheduled, initial_time=scheduled.initial_time)
        case 10:
            kb.add(f"(not ({item}))", initial_time=chance.choice((0, ahead, ahead)))
        case 11:
            kb.add(item, initial_time=chance.choice((0, 0, ahead)))
        case 12:
            (kb.add_goal if chance.random() < 0.6 else kb.remove_goal)(chance.choice(GOALS))
        case 13:
            kb.add_metric(chance.choice(METRICS), initial_time=chance.choice((0, ahead)))
            kb.load(chance.choice((DOMAIN, WIDER)))
        case 14 | 15:
            kb.start("work", chance.choice("rs"), chance.choice("ab"), duration=ahead - now)
        case 16 if running:
            chance.choice((kb.end, kb.abort))(chance.choice(running))
        case _:
            kb.add("(> (cost) 1)" if chance.random() < 0.5 else "(not (> (cost) 1))", "(lit)")


def _late_step(kb, chance: random.Random, now: int) -> None:
    atom, function, item = chance.choice(ATOMS), chance.choice(FUNCTIONS), chance.choice(OBJECTS)
    since = max(START, kb.history_from, now - chance.choice((1, seconds(1), seconds(3), seconds(6))))
    span = {"since": since, "until": chance.choice((None, now, max(since + 1, now - 1)))}
    match chance.randrange(6):
        case 0 | 1:
            kb.add(atom if chance.random() < 0.6 else f"(not {atom})", **span, client="late")
        case 2:
            kb.add(f"(= {function} {chance.choice((7, 9.5))})", **span)
        case 3:
            kb.remove(chance.choice((atom, "(open ?)", "(near ? ?)", function)), **span)
        case 4:
            (kb.add if chance.random() < 0.5 else kb.remove)(item, **span)
        case _:
            (kb.add_goal if chance.random() < 0.7 else kb.remove_goal)(chance.choice(GOALS), **span)


def picture(state) -> dict[str, object]:
    """All content of a state."""

    def timed(items):
        return sorted((item.initial_time, str(item)) for item in items)

    return {
        "instances": timed(state.instances),
        "facts": timed(state.facts),
        "functions": timed(state.functions),
        "inequalities": timed(state.inequalities),
        "metric": str(state.metric),
        "goals": timed(state.goals),
        "timed": timed(state.timed_knowledge),
        "running": sorted((str(run), run.started, run.duration, run.number) for run in state.running),
        "domain": state.domain and state.domain.source,
    }


def assertion(found) -> tuple[object, ...]:
    """All content of an assertion."""
    transactions = found.recorded, found.ended, found.cancelled, found.superseded
    return str(found.item), found.initial_time, found.end_time, *transactions


def change(found) -> tuple[object, ...]:
    """All content of a change."""
    parts = found.asserted, found.ended, found.cancelled, found.superseded
    return found.number, found.time, found.transaction, *(sorted(map(repr, map(assertion, part))) for part in parts)


def answers(kb, since: int, until: int, last: int = 0, *, expected: bool = True) -> dict[object, object]:
    """The answers of a knowledge base about the times in ``[since, until]``: states, beliefs, history, changes.

    `last` is the number of the last transaction before `since`. With `expected`, also about later times.
    """
    changes = list(kb.changes(last))
    times = sorted({since, since + 1, until, *(t for c in changes for t in (c.time, c.time - 1, c.time + seconds(1)))})
    times = [t for t in times if since <= t <= until]
    later = [until + seconds(ahead) for ahead in (1, 4, 9, 14)] if expected else []
    found: dict[object, object] = {t: picture(kb.state(at=t)) for t in (*times, *later)}
    beliefs = times[:: max(1, len(times) // 4)]
    found |= {(t, b): picture(kb.state(t, b)) for t in (*times[::5], *later[1:3]) for b in beliefs}
    latest = changes[-1].transaction if changes else None
    found |= {(t, "latest"): picture(kb.state(t, latest)) for t in times[-1:] if latest}
    end = None if expected else until
    found |= {pattern: list(map(assertion, kb.history(pattern, since, end))) for pattern in PATTERNS}
    found |= {(condition, "when"): kb.when(condition, since, until) for condition in CONDITIONS}
    for belief in beliefs[1::2]:
        span = since, min(until, belief)
        found |= {(pattern, belief): list(map(assertion, kb.history(pattern, *span, belief))) for pattern in PATTERNS}
        found |= {(condition, "when", belief): kb.when(condition, *span, belief) for condition in CONDITIONS}
    found["diff"] = str(kb.diff(since, until))
    found["changes"] = list(map(change, changes))
    return found


def reasons(kb, at: int) -> dict[str, str]:
    """Why each fact is as it is at a time."""
    found = {}
    for atom in (*ATOMS, "(>= (cost) 4)"):
        try:
            found[atom] = str(kb.explain(atom, at=at))
        except HistoryUnavailable:
            found[atom] = "archived"
    return found
