"""Random stories of a small depot, with schedules, ends of objects, runs, and late knowledge."""

import random
from contextlib import suppress

import kbstore
from kbstore import seconds
from kbstore.clock import ManualClock
from kbstore.errors import KbStoreError

START = seconds(1000)

DOMAIN = """
(define (domain depot)
  (:types robot place)
  (:predicates (lit) (ready ?r - robot) (near ?r - robot ?p - place) (clean ?p - place))
  (:functions (load ?r - robot) (cost))
  (:durative-action drive :parameters (?r - robot ?p - place) :duration (>= ?duration 0)
    :condition (and (at start (ready ?r)))
    :effect (and (at start (not (ready ?r))) (at end (near ?r ?p)) (at end (ready ?r)) (at end (not (clean ?p)))
                 (at end (increase (cost) 1)) (decrease (load ?r) (* #t 2))))
  (:durative-action sweep :parameters (?p - place) :duration (= ?duration 3)
    :effect (and (at start (lit)) (at end (clean ?p)) (at end (not (lit))))))
"""
OBJECTS = ("r - robot", "s - robot", "a - place", "b - place")
FACTS = ("(lit)", "(ready r)", "(ready s)", "(near r a)", "(near s b)", "(near r b)", "(clean a)", "(clean b)")


class Life:
    """Writes random knowledge; refused updates are not recorded."""

    def __init__(self, kb, clock, seed):
        self.kb, self.clock, self.random = kb, clock, random.Random(seed)
        self.runs, self.scheduled = [], []

    def live(self, steps):
        for _ in range(steps):
            self.clock.advance(self.random.choice([0, 0, 1, seconds(1), seconds(1), seconds(2)]))
            with suppress(KbStoreError):
                self.random.choices(list(self.weights), self.weights.values())[0](self)

    def later(self, *delays):
        return self.clock.now() + seconds(self.random.choice(delays))

    def schedule(self, item, t):
        self.kb.add(item, initial_time=t)
        self.scheduled.append((item, t))

    def add(self):
        fact = self.random.choice(FACTS)
        fact = fact if self.random.random() < 0.7 else f"(not {fact})"
        if self.random.random() < 0.4:
            self.schedule(fact, self.later(1, 3, 8))
        else:
            self.kb.add(fact)

    def remove(self):
        self.kb.remove(self.random.choice(FACTS))

    def cancel(self):
        item, t = self.random.choice(self.scheduled or [("(lit)", 1)])
        self.kb.remove(item, initial_time=t)

    def end_object(self):
        item = self.random.choice(OBJECTS)
        if self.random.random() < 0.5:
            self.kb.remove(item)
        else:
            self.schedule(f"(not ({item}))", self.later(2, 5, 9))

    def bring(self):
        self.kb.add(self.random.choice(OBJECTS))

    def number(self):
        t = self.random.choice([0, 0, self.later(4)])
        self.kb.add(f"(= (load {self.random.choice('rs')}) {self.random.randrange(90)})", initial_time=t)

    def start(self):
        if self.random.random() < 0.6:
            robot, place = self.random.choice("rs"), self.random.choice("ab")
            self.runs.append(self.kb.start("drive", robot, place, duration=seconds(self.random.choice([2, 5, 7]))))
        else:
            self.runs.append(self.kb.start("sweep", self.random.choice("ab")))

    def end(self):
        run = self.runs.pop(self.random.randrange(len(self.runs) or 1)) if self.runs else None
        if run is not None:
            self.random.choice((self.kb.end, self.kb.end, self.kb.abort))(run)

    def learn(self):
        """Late knowledge, about a past time."""
        since = self.random.randrange(START, self.clock.now() + 1)
        until = self.random.choice([None, min(since + seconds(4), self.clock.now())])
        fact = self.random.choice(FACTS)
        self.random.choice((self.kb.add, self.kb.remove))(fact, since=since, until=until)

    weights = {add: 30, remove: 10, cancel: 10, end_object: 6, bring: 8, number: 8, start: 18, end: 10, learn: 12}  # noqa: RUF012


def world(seed, steps=60, url="sqlite://"):
    """A knowledge base with a random story; every second one has unknowns."""
    clock = ManualClock(START)
    kb = kbstore.open(url, f"depot{seed}", clock=clock, use_unknowns=bool(seed % 2))
    kb.load(DOMAIN)
    kb.add(*OBJECTS, "(= (load r) 50)", "(= (load s) 20)", "(= (cost) 0)", "(ready r)", "(ready s)")
    kb.add_goal("(clean a)")
    Life(kb, clock, seed).live(steps)
    return kb


def pairs(kb, data, count, seed):
    """Random times, many of them at changes, each with a transaction or None for the belief."""
    chosen = random.Random(seed)
    origin = int(data["origin"])
    transactions = [change.transaction for change in kb.changes(data["base"])]
    corners = sorted({row[1] for row in (*data["rows"], *data["expected"])} | {row[2] or 0 for row in data["rows"]})
    for _ in range(count):
        t = chosen.choice([chosen.choice(corners) + chosen.choice([-1, 0, 1]), chosen.randrange(data["until"] + 10)])
        yield origin + max(0, t), chosen.choice([*transactions, None])


def values_of(state):
    """The facts and numbers of a state in the form of the page."""
    return sorted(map(str, state.facts)), sorted((str(item.atom), item.function_value) for item in state.functions)
