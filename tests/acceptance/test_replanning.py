"""The loop: load, plan, execute, fail, export, plan again, finish; and planning from before the failure."""

from collections.abc import Callable
from typing import Any

import pytest
import unified_planning.shortcuts as up
from unified_planning.model import Problem

from kbstore import KnowledgeBase, ManualClock, NotApplicable, Truth, seconds
from kbstore.clock import SECOND
from kbstore.interop.plans import execute, steps
from tests.acceptance import validator
from tests.acceptance.conftest import BEGIN

OPEN = "(open glass_door)"


def plan_for(problem: Problem) -> Any:
    with up.OneshotPlanner(name="kairos", params={"anytime": False}) as planner:
        plan = planner.solve(problem, timeout=20).plan
    assert plan is not None
    with up.PlanValidator(name="kairos-val") as validator:
        assert validator.validate(problem, plan)
    return plan


def operators(plan: Any) -> set[str]:
    return {step.operator for step in steps(plan)}


def initially(problem: Problem, fluent: str, *objects: str) -> Any:
    value = problem.initial_value(problem.fluent(fluent)(*map(problem.object, objects)))
    return value.constant_value()


@pytest.fixture
def wait(kb: KnowledgeBase, clock: ManualClock) -> Callable[[int], None]:
    """A wait; while the schedule has the door open, a camera reports that it is shut."""

    def waiting(t: int) -> None:
        clock.set(t)
        if kb.holds(OPEN):
            kb.add(f"(not {OPEN})", client="camera")

    return waiting


@pytest.fixture
def failed(kb: KnowledgeBase, courier: Any, wait: Callable[[int], None]) -> list[tuple[int, str]]:
    """The first plan, up to the door that stays shut; the problem's text after each step."""
    kb.load(courier.DOMAIN, courier.PROBLEM)
    plan = plan_for(kb.to_problem())
    assert "pass" in operators(plan)
    written = []

    def carry_out() -> None:
        for _ in execute(kb, plan, wait):
            written.append((list(kb.changes())[-1].number, kb.to_pddl()))

    with pytest.raises(NotApplicable, match=r"\(open glass_door\) is false since"):
        carry_out()
    return written


def test_the_example_runs(courier: Any, capsys: pytest.CaptureFixture[str]):
    """The script prints the whole story: a failure, a second plan that reaches the goal, and states that agree."""
    courier.main()
    output = capsys.readouterr().out
    assert f"{OPEN} is false since 2026-05-04T07:01:00Z" in output
    assert "; (rinse centrifuge) has been running for 60 s, its end is expected in 300 s" in output
    assert "(analysed blood): reached" in output
    # once in the plan, once refused, and twice in the plans from before the failure
    assert output.count("(pass kenny glass_door corridor lab)") == 4
    verdicts = output[output.index("validator") :].splitlines()[2:]
    assert len(verdicts) > 6
    assert all(line.startswith("  yes") for line in verdicts)


@pytest.mark.usefixtures("failed")
def test_a_failure_is_explained(kb: KnowledgeBase):
    """V6, O1: who recorded it, and since when; the robot's place, and the battery that the way left."""
    explained = kb.explain(OPEN)
    assert (explained.truth, explained.reason) == (Truth.FALSE, "explicitly false")
    assert explained.transaction is not None
    assert (explained.transaction.client, explained.since) == ("camera", BEGIN + seconds(60))
    (reason,) = kb.applicable("pass", "kenny", "glass_door", "corridor", "lab").failing
    assert (reason.condition, reason.since) == (OPEN, BEGIN + seconds(60))
    assert kb.holds("(robot_at kenny corridor)")
    assert kb.value("(battery kenny)") == 30


@pytest.mark.usefixtures("failed")
def test_runs_are_part_of_the_problem_after_the_failure(kb: KnowledgeBase, wait: Callable[[int], None]):
    """O4: the end effects of the centrifuge's rinsing are scheduled; the new plan needs them, and they come."""
    (run,) = kb.state().running
    assert (run.operator, run.expected_end) == ("rinse", BEGIN + seconds(360))
    init = kb.to_pddl().split("(:init")[1]
    assert "(at 300 (idle centrifuge))\n    (at 300 (clean centrifuge))" in init
    assert OPEN not in init
    plan = plan_for(kb.to_problem())
    assert "charge" in operators(plan)
    assert not {"pass", "rinse"} & operators(plan)
    done = [(str(step), kb.now()) for step, _ in execute(kb, plan, wait)]
    assert ("300: end (rinse centrifuge)", BEGIN + seconds(360)) in done
    assert kb.query(*kb.goals())
    assert kb.state().running == []
    assert kb.when("(clean centrifuge)", BEGIN, kb.now())[0][0] == BEGIN + seconds(360)


@pytest.mark.usefixtures("failed")
def test_planning_from_a_moment_before_the_failure(kb: KnowledgeBase, wait: Callable[[int], None]):
    """Q1, Q2, T5: after the end of the mission, one can still plan from any time of it, past or expected.

    A second before it was due to open, the door was shut and expected to open. As of then it was expected to be open a
    second later; as of the camera's report, it was not. (Right after that the robot turned round, at the same time.)
    """
    (camera,) = [change.transaction for change in kb.changes() if change.transaction.client == "camera"]
    for _ in execute(kb, plan_for(kb.to_problem()), wait):
        pass
    failure, before = BEGIN + seconds(60), BEGIN + seconds(59)
    as_it_was = kb.to_problem(at=before)
    assert not initially(as_it_was, "open", "glass_door")
    assert ["glass_door" in str(effects) for t, effects in as_it_was.timed_effects.items() if t.delay == 1] == [True]
    as_expected = kb.to_problem(at=failure, as_of=before)
    assert initially(as_expected, "open", "glass_door")
    as_it_came = kb.to_problem(at=failure, as_of=camera)
    assert not initially(as_it_came, "open", "glass_door")
    for problem in (as_it_was, as_expected, as_it_came):
        assert initially(problem, "robot_at", "kenny", "corridor")
        assert initially(problem, "battery", "kenny") == 30
    assert ["pass" in operators(plan_for(p)) for p in (as_it_was, as_expected, as_it_came)] == [True, True, False]


def test_the_past_is_exported_as_it_was(kb: KnowledgeBase, wait: Callable[[int], None], failed: list[tuple[int, str]]):
    """T5, Q2: the problem as of each transaction is, word for word, the one that was written right after it."""
    written = list(failed)
    for _ in execute(kb, plan_for(kb.to_problem()), wait):
        written.append((list(kb.changes())[-1].number, kb.to_pddl()))
    transactions = {change.number: change.transaction for change in kb.changes()}
    assert len(written) > 12
    for number, text in written:
        transaction = transactions[number]
        assert kb.to_pddl(at=transaction.time, as_of=transaction) == text


def test_a_door_that_shuts_in_the_middle(kb: KnowledgeBase, courier: Any, clock: ManualClock):
    """O3: a broken over-all condition is found by asking; the action is aborted, and the next plan starts there.

    An unknown place has to be reported: an aborted action leaves the robot nowhere until its localisation finds it.
    """
    kb.load(courier.DOMAIN, courier.PROBLEM)
    executed = execute(kb, plan_for(kb.to_problem()), clock.set)
    run = next(outcome for step, outcome in executed if step.operator == "pass")
    assert run.started == BEGIN + seconds(60)
    clock.advance(seconds(4))
    kb.add(f"(not {OPEN})", client="camera")
    clock.advance(seconds(1))
    assert kb.when(f"(not {OPEN})", run.started, kb.now()) == [(run.started + seconds(4), kb.now())]
    kb.abort(run)
    assert not kb.holds("(robot_at kenny ?)")
    kb.add("(robot_at kenny corridor)", client="localisation")
    assert kb.value("(battery kenny)") == 27.5
    plan = plan_for(kb.to_problem())
    assert "pass" not in operators(plan)
    for _ in execute(kb, plan, clock.set):
        pass
    assert kb.query(*kb.goals())


def test_planning_takes_time(kb: KnowledgeBase, courier: Any, clock: ManualClock, wait: Callable[[int], None]):
    """Q1, O3: one plans from the state that is expected when the planner will be done, and begins then."""
    kb.load(courier.DOMAIN, courier.PROBLEM)
    kb.start("rinse", "centrifuge")
    ready = kb.now() + seconds(30)
    problem = kb.to_problem(at=ready)
    timed = {float(t.delay): sorted(map(str, effects)) for t, effects in problem.timed_effects.items()}
    assert {t: len(effects) for t, effects in timed.items()} == {30.0: 1, 330.0: 2, 390.0: 1}
    plan = plan_for(problem)
    clock.set(ready)
    for _ in execute(kb, plan, clock.set):
        pass
    assert kb.query(*kb.goals())


def test_the_validator_agrees_after_a_failure(
    kb: KnowledgeBase, courier: Any, wait: Callable[[int], None], failed: Any
):
    """O3, O4: every state of the second plan is the one that the validator computes from the exported problem."""
    begin, problem = kb.now(), kb.to_pddl()
    done = [step for step, _ in execute(kb, plan_for(kb.to_problem()), wait)]
    own = [step for step in done if step.operator != "rinse"]
    seen = {at: kb.state(at=begin + at) for at in validator.between(done, [seconds(360)])}
    assert validator.disagreements(courier.DOMAIN, problem, validator.plan_text(own), seen) == []
    wrong = {at + 10 * SECOND: state for at, state in list(seen.items())[:1]}
    assert validator.disagreements(courier.DOMAIN, problem, validator.plan_text(own), wrong) != []
