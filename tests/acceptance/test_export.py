"""Problems exported during a mission: other readers read them, and planners continue from them (P2, O4)."""

import random
from typing import Any

import kairos
import pytest
import unified_planning.shortcuts as up
from unified_planning.io import PDDLReader

from kbstore import KnowledgeBase, ManualClock, seconds
from kbstore.interop.plan_text import read_plan
from kbstore.interop.plans import Happening, execute
from tests.acceptance import validator
from tests.acceptance.conftest import BEGIN, load
from tests.acceptance.random_plans import walk


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("world", ["lights", "jugs", "cranes"])
def test_the_problem_of_any_time_is_read_by_the_planner(kb: KnowledgeBase, clock: ManualClock, world: str, seed: int):
    """P2: Kairos can read the problem as of any past time, with the runs of that time."""
    load(kb, world, seed)
    steps = walk(kb, clock, random.Random(seed), 12)
    domain = kairos.parse_domain(kb.domain_to_pddl())
    for at in validator.between(steps):
        report = kairos.check_problem(kb.to_pddl(at=BEGIN + at), kb.domain_to_pddl())
        assert [str(d) for d in report.diagnostics if d.severity is kairos.Severity.ERROR] == []
        assert kairos.parse_problem(kb.to_pddl(at=BEGIN + at), domain).name == kb.name


@pytest.mark.parametrize("seed", range(4))
def test_waiting_leads_to_the_state_that_the_store_expects(kb: KnowledgeBase, clock: ManualClock, seed: int):
    """O4: from the problem at t, by waiting, the validator comes to the state that was expected at t."""
    domain, _ = load(kb, "cranes", seed)
    steps = walk(kb, clock, random.Random(seed), 16)
    lasting = 0
    for at in validator.between(steps):
        state = kb.state(at=BEGIN + at)
        ends = [run.expected_end for run in state.running] + [item.initial_time for item in state.timed_knowledge]
        expected = kb.state(at=max([state.at, *ends]), as_of=state.at)
        problem = validator.with_goal(state.to_pddl(), validator.everything(expected))
        assert validator.complaints(domain, problem, "") == []
        lasting += len(state.running)
    assert lasting > 10


@pytest.mark.parametrize("seed", range(5))
def test_a_plan_from_the_middle_is_carried_out(kb: KnowledgeBase, clock: ManualClock, seed: int):
    """O4: a plan for the current problem, while several actions run, reaches its goal in the store.

    All facts agree on the way. Numbers do not have to: the problem has a running action's result for a function as its
    value at the end, even if other actions change it meanwhile.
    """
    domain, _ = load(kb, "cranes", seed)
    walk(kb, clock, random.Random(seed), 9, finish=False)
    runs, begin = kb.state().running, kb.now()
    assert runs
    kb.remove_goal(*kb.goals())
    kb.add_goal("(and (filled t0) (filled t1) (at_dock c0 d1) (free c0) (forall (?t - tank) (not (filling ?t))))")
    problem = kb.to_pddl()
    found = kairos.Planner().solve(
        kairos.parse_problem(problem, kairos.parse_domain(domain)), timeout=10, anytime=False
    )
    assert found.plan is not None
    steps = read_plan(found.plan.to_string(precision=9), kb.domain)
    done = [step for step, _ in execute(kb, steps, clock.set)]
    ended = {(step.operator, step.arguments) for step in done if step.happening is Happening.END}
    assert {(run.operator, run.arguments) for run in runs} <= ended
    assert kb.query(*kb.goals())
    scheduled = [item.initial_time - begin for item in kb.state(at=begin - 1).timed_knowledge]
    seen = {at: kb.state(at=begin + at) for at in validator.between(done, [t for t in scheduled if t > 0])}
    assert validator.disagreements(domain, problem, validator.plan_text(steps), seen, numbers=False) == []


@pytest.mark.filterwarnings("ignore:.*deprecated - use:DeprecationWarning")
@pytest.mark.parametrize("world", ["lights", "courier"])
def test_unified_planning_reads_what_it_supports(kb: KnowledgeBase, clock: ManualClock, world: str, courier: Any):
    """P2, O4: that library's own reader of the text, and `to_problem`, give the same initial state and schedule."""
    if world == "courier":
        kb.load(courier.DOMAIN, courier.PROBLEM)
        kb.start("rinse", "centrifuge")
        clock.advance(seconds("20.5"))
    else:
        load(kb, world, 3)
        walk(kb, clock, random.Random(3), 5)
    read = PDDLReader().parse_problem_string(kb.domain_to_pddl(), kb.to_pddl())
    made = kb.to_problem()

    def parts(problem: Any) -> Any:
        timed = {str(t): sorted(map(str, effects)) for t, effects in problem.timed_effects.items()}
        values = {str(f): str(v) for f, v in problem.explicit_initial_values.items() if not v.is_false()}
        return timed, values, list(map(str, problem.goals)), {o.name: o.type.name for o in problem.all_objects}

    assert parts(read) == parts(made)
    assert bool(made.timed_effects) == (world == "courier")


@pytest.mark.parametrize("world", ["lights", "jugs", "courier"])
def test_a_plan_from_the_middle_under_unified_planning(kb: KnowledgeBase, clock: ManualClock, world: str, courier: Any):
    """The same through `to_problem` and that library's plans, validated by its engine for Kairos."""
    if world == "courier":
        kb.load(courier.DOMAIN, courier.PROBLEM)
        kb.start("rinse", "centrifuge")
        clock.advance(seconds("20.5"))
    else:
        load(kb, world, 10 if world == "jugs" else 5)
        walk(kb, clock, random.Random(2), 2)
    problem = kb.to_problem()
    with up.OneshotPlanner(name="kairos", params={"anytime": False}) as planner:
        plan = planner.solve(problem, timeout=10).plan
    with up.PlanValidator(name="kairos-val") as validator:
        assert validator.validate(problem, plan)
    assert list(execute(kb, plan, clock.set))
    assert kb.query(*kb.goals())
