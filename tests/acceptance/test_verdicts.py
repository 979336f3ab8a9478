"""The validator of the planner Kairos and the store agree on random plans, good and bad (O1, O3, O5 to O7).

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
from kbstore import KnowledgeBase, ManualClock, NotApplicable, Run
from kbstore.interop.plans import Happening, Step, execute
from tests.acceptance import validator
from tests.acceptance.conftest import BEGIN, load
from tests.acceptance.random_plans import good_or_bad

PLANS = int(os.environ.get("KBSTORE_TEST_EXAMPLES", "0")) or 24
CONDITION = re.compile(r"^  - (.*?) is (?:false|unknown)", re.MULTILINE)


class Complaint(NamedTuple):
    """The store's objections to a plan at one time: actions with their conditions; and the number of steps taken."""

    reasons: list[tuple[str, str]]
    steps: int


def complaint(kb: KnowledgeBase, clock: ManualClock, steps: list[Step]) -> Complaint | None:
    """Carry out a plan, and return the store's first objection."""
    taken = 0
    try:
        for step, outcome in execute(kb, steps, clock.set):
            taken += 1
            if step.happening is Happening.END and outcome.failing:
                return Complaint([(named(step), failing.condition) for failing in outcome.failing], taken)
    except NotApplicable as refusal:
        if "the plan is stopped" not in str(refusal):
            reasons = [(named(steps[taken]), text) for text in CONDITION.findall(str(refusal))]
            # actions started although they were expected to break, too: the validator names one of them
            reasons += [(named(run), text) for run in kb.state().running for text in run.forced]
            return Complaint(reasons, taken + 1)
        reasons = [(named(run), broken.condition) for run in kb.state().running for broken in kb.broken(run)]
        return Complaint(reasons, taken)
    return None


def as_the_validator_says(action: str, condition: str) -> list[str]:
    """A failing condition in the validator's form: a negative one as the true fact, some with their parameter."""
    lifted = condition.replace(action.strip("()").split()[-1], "?t")
    negated = condition.removeprefix("(not ").removesuffix(")")
    return [f"{condition} is false", f"{negated} is true", f"{lifted}: ", f"{lifted} with ?t"]


def named(step: Step | Run) -> str:
    return f"({' '.join((step.operator, *step.arguments))})"


def diagnostics(domain: str, problem: str, steps: list[Step]) -> list[str]:
    """The validator's objections to a plan; its goal does not matter."""
    options = kairos.ValidateOptions()
    options.epsilon = 0.0
    plan = kairos.parse_plan(validator.plan_text(steps))
    report = kairos.validate_plan(domain, validator.with_goal(problem, []), plan, options)
    return [] if report.valid else [str(found) for found in report.diagnostics]


@pytest.mark.parametrize("seed", range(PLANS))
def test_the_store_and_the_validator_agree_on_a_plan(seed: int, clock: ManualClock, kb: Any):
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
    begun = [step for step in steps[: found.steps] if step.happening is not Happening.END]
    against = diagnostics(*texts, begun)
    assert any(
        action in line and any(text in line for text in as_the_validator_says(action, condition))
        for action, condition in found.reasons
        for line in against
    ), (found, against)
