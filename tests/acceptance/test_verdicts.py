"""The validator of the planner Kairos and the store say the same of random plans, good and bad (O1, O3, O5 to O7).

A plan is carried out step by step. It is valid exactly if nothing was refused, no invariant broke and every at-end
condition held; otherwise the validator rejects it, too, as far as it was carried out, for the same action and the same
condition. KBSTORE_TEST_EXAMPLES=200 carries out that many plans.
"""

import os
import random
import re
from typing import Any, NamedTuple

import kairos
import pytest

import kbstore
from kbstore import KnowledgeBase, ManualClock, NotApplicable
from kbstore.interop.plans import Happening, Step, execute
from tests.acceptance import validator
from tests.acceptance.conftest import BEGIN, load
from tests.acceptance.random_plans import good_or_bad

PLANS = int(os.environ.get("KBSTORE_TEST_EXAMPLES", "0")) or 24
CONDITION = re.compile(r"^  - (.*?) is (?:false|unknown)", re.MULTILINE)
BROKEN = re.compile(r"the plan is stopped: (\(.*?\)) since .*? needs (.*?) is (?:false|unknown) since")


class Complaint(NamedTuple):
    """What the store has against a plan: the action, the conditions, one of which the validator names, and when."""

    action: str
    conditions: list[str]
    place: int


def complaint(kb: KnowledgeBase, clock: ManualClock, steps: list[Step]) -> Complaint | None:
    """Carry out a plan, and return the first thing that the store has against it."""
    place = 0
    try:
        for step, outcome in execute(kb, steps, clock.set):
            place += 1
            if step.happening is Happening.END and outcome.failing:
                return Complaint(_named(step), [failing.condition for failing in outcome.failing], place)
    except NotApplicable as refusal:
        broken = BROKEN.search(str(refusal))
        if broken:
            return Complaint(broken[1], [broken[2]], place)
        return Complaint(_named(steps[place]), CONDITION.findall(str(refusal)), place + 1)
    return None


def as_the_validator_says(condition: str, action: str) -> list[str]:
    """A condition that fails, negative ones as what is true, and constraints on a duration with the parameter."""
    lifted = condition.replace(action.strip("()").split()[-1], "?t")
    negated = condition.removeprefix("(not ").removesuffix(")")
    return [f"{condition} is false", f"{negated} is true", f"{lifted}: "]


def _named(step: Step) -> str:
    return f"({' '.join((step.operator, *step.arguments))})"


def diagnostics(domain: str, problem: str, steps: list[Step]) -> list[str]:
    """What the validator has against a plan; its goal does not matter."""
    options = kairos.ValidateOptions()
    options.epsilon = 0.0
    plan = kairos.parse_plan(validator.plan_text(steps))
    report = kairos.validate_plan(domain, validator.with_goal(problem, []), plan, options)
    return [] if report.valid else [str(found) for found in report.diagnostics]


@pytest.mark.parametrize("seed", range(PLANS))
def test_the_store_and_the_validator_say_the_same_of_a_plan(seed: int, clock: ManualClock, kb: Any):
    """O1, O3, O5 to O7: accepted by both, or rejected by both for the same action and condition."""
    texts = load(kb, "tanks", seed)
    rng = random.Random(seed)
    time = ManualClock(BEGIN)
    with kbstore.open("sqlite://", "draft", clock=time) as draft:
        load(draft, "tanks", seed)
        steps = good_or_bad(draft, time, rng)
    found = complaint(kb, clock, steps)
    if found is None:
        assert diagnostics(*texts, steps) == []
        return
    done = steps[: found.place]
    begun = [step for step in done if step.happening is not Happening.END]
    against = diagnostics(*texts, begun)
    wanted = [text for condition in found.conditions for text in as_the_validator_says(condition, found.action)]
    assert any(found.action in line and any(text in line for text in wanted) for line in against), (found, against)
