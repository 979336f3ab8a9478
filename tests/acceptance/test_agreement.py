"""The validator of the planner Kairos agrees with the store about every state that a plan leads to (O1 to O3)."""

import random
from itertools import product
from typing import Any

import kairos
import pytest

from kbstore import KnowledgeBase, ManualClock
from kbstore.clock import SECOND
from kbstore.interop.plan_text import read_plan
from kbstore.interop.plans import Happening, Step, execute
from tests.acceptance import validator
from tests.acceptance.conftest import BEGIN, load
from tests.acceptance.random_plans import walk


def assert_agreement(kb: KnowledgeBase, texts: tuple[str, str], steps: list[Step]) -> None:
    """Every state between two steps, and the expected state at each step, agree with the validator."""
    domain, problem = texts
    scheduled = [item.initial_time - BEGIN for item in kb.state(at=BEGIN, as_of=BEGIN).timed_knowledge]
    plan = validator.plan_text(steps)
    seen = {at: kb.state(at=BEGIN + at) for at in validator.between(steps, scheduled)}
    assert validator.disagreements(domain, problem, plan, seen) == []
    for t in sorted({step.at for step in steps if step.at is not None}):
        begun = [step for step in steps if step.happening is not Happening.END and step.at <= t]
        last = max([t, *scheduled, *(step.at + (step.duration or 0) for step in begun)])
        expected = kb.state(at=BEGIN + last, as_of=BEGIN + t)
        assert expected.running == []
        goal = validator.with_goal(problem, validator.everything(expected))
        assert validator.complaints(domain, goal, validator.plan_text(begun)) == []


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("world", ["lights", "jugs"])
def test_random_walks_through_classical_and_numeric_worlds(kb: Any, clock: ManualClock, world: str, seed: int):
    """O1, O2: the sequence that the store applied is a valid plan, and each state is that of the validator."""
    texts = load(kb, world, seed)
    steps = walk(kb, clock, random.Random(seed), 12)
    assert_agreement(kb, texts, steps)


@pytest.mark.parametrize("seed", range(8))
def test_random_walks_through_a_temporal_world(kb: Any, clock: ManualClock, seed: int):
    """O3: overlapping actions, added contributions to one function, effects at start, at end and continuous."""
    texts = load(kb, "cranes", seed)
    steps = walk(kb, clock, random.Random(seed), 20)
    assert_agreement(kb, texts, steps)
    starts = [(step.at, step.at + step.duration) for step in steps if step.happening is Happening.START]
    assert any(a < c < b for a, b in starts for c, _ in starts), "nothing overlaps"


@pytest.mark.parametrize(
    ("world", "seed"),
    [*product(["lights"], [0, 2, 3, 5]), *product(["jugs"], [0, 2, 10]), *product(["cranes"], [0, 1, 3, 10])],
)
def test_plans_of_the_planner(kb: Any, clock: ManualClock, world: str, seed: int):
    """P2, O1 to O3: a plan for the exported problem can be executed in the store, and reaches the goal there."""
    domain, problem = load(kb, world, seed)
    parsed = kairos.parse_problem(problem, kairos.parse_domain(domain))
    found = kairos.Planner().solve(parsed, timeout=10, anytime=False).plan
    assert found is not None
    steps = read_plan(found.to_string(precision=9), kb.domain)
    for step, _ in execute(kb, steps, clock.set):
        if step.at is None:
            clock.advance(SECOND)
    assert kb.query(*kb.goals())
    placed = [
        Step(step.happening, step.operator, step.arguments, place * SECOND, step.duration) if step.at is None else step
        for place, step in enumerate(steps)
    ]
    assert_agreement(kb, (domain, problem), placed)
