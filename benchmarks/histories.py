"""Histories to measure on. About a thousand facts hold at any time; they differ in how facts change.

A history is a sequence of steps, one transaction each. `replay` plays them to a knowledge base through its public
methods; `benchmarks.filling` writes the same rows directly, as fast as the database takes them.
"""

import random
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import NamedTuple

import kbstore
from kbstore import Fact, Instance, ManualClock, UpdateType, seconds

START = seconds(1_700_000_000)
"""When the first step takes place, in nanoseconds."""

STEP = seconds("0.1")
"""The time between two steps, of which up to a half is jitter."""

STANDING = 1000
"""How many facts hold at any time."""

DOMAIN = """
(define (domain office)
  (:requirements :strips :typing :fluents)
  (:types place item robot - object)
  (:predicates (reachable ?from ?to - place) (seen ?i - item) (light ?i - item) (clean ?i - item) (wanted ?i - item))
  (:functions (battery ?r - robot) (distance ?from ?to - place)))
"""

_PLACES = 40
_PREDICATES = ("seen", "light", "clean", "wanted")
_LIVING = STANDING // len(_PREDICATES)


class Step(NamedTuple):
    """One transaction: objects that end (with all that mentions them), objects that begin, facts with their signs."""

    time: int
    gone: list[str]
    come: list[str]
    said: list[tuple[str, bool]]


@dataclass(frozen=True)
class History:
    """A shape of history, and its size: the number of assertions, objects included."""

    shape: str
    size: int

    @property
    def type_name(self) -> str:
        """The type of its objects."""
        return "item" if self.shape == PASSING else "place"

    def steps(self) -> Iterator[Step]:
        """The steps, the same each time."""
        return _SHAPES[self.shape](self.size, random.Random(self.size))

    def moments(self) -> list[int]:
        """Six times to ask about, from near the beginning to near the end."""
        steps = self.size / 5 - _LIVING if self.shape == PASSING else self.size - STANDING - _PLACES
        return [START + int(steps * part) * STEP for part in (0.02, 0.2, 0.4, 0.6, 0.8, 0.98)]


UNIFORM, SKEWED, PASSING = SHAPES = ("uniform", "skewed", "passing objects")


def _flips(size: int, choice: random.Random, pick: Callable[[], int]) -> Iterator[Step]:
    """Facts about places that change their sign, one at each step."""
    places = [f"wp{number}" for number in range(_PLACES)]
    keys = [f"reachable {a} {b}" for a in places for b in places[:25]]
    signs = [False] * STANDING
    yield Step(START, [], places, [(key, False) for key in keys])
    for tick in range(1, size - STANDING - _PLACES + 1):
        index = pick()
        signs[index] = not signs[index]
        yield Step(_time(tick, choice), [], [], [(keys[index], signs[index])])


def _uniform(size: int, choice: random.Random) -> Iterator[Step]:
    """Each fact is as likely to change as any other."""
    return _flips(size, choice, lambda: int(choice.random() * STANDING))


def _skewed(size: int, choice: random.Random) -> Iterator[Step]:
    """Nine changes of ten are of ten facts; half of the facts never change."""

    def pick() -> int:
        return int(choice.random() * 10) if choice.random() < 0.9 else 10 + int(choice.random() * (STANDING / 2 - 10))

    return _flips(size, choice, pick)


def _passing(size: int, choice: random.Random) -> Iterator[Step]:
    """Objects that begin, with four facts each, and end: no timeline is ever used again."""
    names = [f"item{number}" for number in range(size // (len(_PREDICATES) + 1))]

    def said(name: str) -> list[tuple[str, bool]]:
        return [(f"{predicate} {name}", False) for predicate in _PREDICATES]

    yield Step(START, [], names[:_LIVING], [fact for name in names[:_LIVING] for fact in said(name)])
    for tick, name in enumerate(names[_LIVING:], 1):
        yield Step(_time(tick, choice), [names[tick - 1]], [name], said(name))


_SHAPES: dict[str, Callable[[int, random.Random], Iterator[Step]]] = {
    UNIFORM: _uniform,
    SKEWED: _skewed,
    PASSING: _passing,
}


def _time(tick: int, choice: random.Random) -> int:
    return START + tick * STEP + int(choice.random() * (STEP // 2))


def replay(history: History, url: str, name: str = "bench", *, durability: str = "normal") -> None:
    """Play a history to a new knowledge base, step by step, through `kbstore.KnowledgeBase.update`."""
    clock = ManualClock(START)
    with kbstore.open(url, name, clock=clock, durability=durability) as kb:
        kb.load(DOMAIN)
        for step in history.steps():
            clock.set(step.time)
            kb.update(updates(step, history.type_name))


def updates(step: Step, type_name: str) -> list[tuple[UpdateType, object]]:
    """A step as `kbstore.KnowledgeBase.update` takes it."""
    items: list[tuple[UpdateType, object]] = []
    items += [(UpdateType.REMOVE_KNOWLEDGE, Instance(instance_name=name)) for name in step.gone]
    items += [(UpdateType.ADD_KNOWLEDGE, Instance(instance_name=name, instance_type=type_name)) for name in step.come]
    items += [(UpdateType.ADD_KNOWLEDGE, fact(key, is_negative)) for key, is_negative in step.said]
    return items


def fact(key: str, is_negative: bool = False) -> Fact:
    """The fact of a timeline's key."""
    name, *arguments = key.split(" ")
    return Fact.model_validate({"attribute_name": name, "values": arguments, "is_negative": is_negative})
