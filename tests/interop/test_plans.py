"""Plans of unified_planning as steps in time, and their execution."""

from fractions import Fraction
from types import SimpleNamespace
from typing import Any

import pytest
from unified_planning.plans import PartialOrderPlan, SequentialPlan, TimeTriggeredPlan

from kbstore.clock import ManualClock, seconds
from kbstore.errors import InvalidKnowledge, NotApplicable
from kbstore.interop.unified_planning import Happening, Step, execute, steps, to_problem
from tests.interop.states import state

APPLY, START, END = Happening.APPLY, Happening.START, Happening.END
ACTIONS = """
(:action Look :parameters (?p - place) :effect (visited ?p))
(:durative-action go :parameters (?m - mover ?a ?b - place) :duration (<= ?duration 100)
  :condition (at start (at ?m ?a)) :effect (and (at start (not (at ?m ?a))) (at end (at ?m ?b))))
"""


@pytest.fixture(scope="module")
def problem() -> Any:
    return to_problem(state(ACTIONS))


def look(problem: Any, place: str) -> Any:
    return problem.action("Look")(problem.object(place))


def go(problem: Any, start: str, end: str) -> Any:
    return problem.action("go")(problem.object("kenny"), problem.object(start), problem.object(end))


def test_a_sequential_plan_is_one_step_after_the_other(problem: Any):
    """The steps have an order and no times."""
    plan = SequentialPlan([look(problem, "wp1"), look(problem, "Depot")])
    assert steps(plan) == [Step(APPLY, "Look", ("wp1",)), Step(APPLY, "Look", ("Depot",))]


def test_a_time_triggered_plan_starts_and_ends(problem: Any):
    """Each durative action is two steps; all steps are in the order of time, in nanoseconds."""
    plan = TimeTriggeredPlan(
        [
            (Fraction(7), look(problem, "wp0"), None),
            (Fraction(1, 2), go(problem, "wp0", "wp1"), Fraction(10)),
            (Fraction(1, 3), go(problem, "wp1", "Depot"), Fraction(2, 3)),
        ]
    )
    there, back = ("kenny", "wp0", "wp1"), ("kenny", "wp1", "Depot")
    assert steps(plan) == [
        Step(START, "go", back, 333_333_333, 666_666_667),
        Step(START, "go", there, seconds("0.5"), seconds(10)),
        Step(END, "go", back, seconds(1), 666_666_667),
        Step(APPLY, "Look", ("wp0",), seconds(7)),
        Step(END, "go", there, seconds("10.5"), seconds(10)),
    ]


def test_ends_come_before_starts_of_the_same_time(problem: Any):
    """A start may need what an end brings about; an action without length ends after its own start."""
    plan = TimeTriggeredPlan(
        [
            (Fraction(5), go(problem, "wp1", "wp0"), Fraction(0)),
            (Fraction(5), look(problem, "wp0"), None),
            (Fraction(0), go(problem, "wp0", "wp1"), Fraction(5)),
        ]
    )
    assert [str(step) for step in steps(plan)] == [
        "0: start (go kenny wp0 wp1)",
        "5: end (go kenny wp0 wp1)",
        "5: start (go kenny wp1 wp0)",
        "5: apply (Look wp0)",
        "5: end (go kenny wp1 wp0)",
    ]


def test_other_plans_are_refused(problem: Any):
    """A plan that is only partly ordered is named, with what to do."""
    with pytest.raises(InvalidKnowledge, match=r"PartialOrderPlan.*convert_to"):
        steps(PartialOrderPlan({look(problem, "wp0"): []}))


class Recorder:
    """Stands for a knowledge base: writes down what it is told, and when."""

    def __init__(self, clock: ManualClock, refuses: str = "") -> None:
        self.clock = clock
        self.refuses = refuses
        self.told: list[tuple[Any, ...]] = []

    def now(self) -> int:
        return self.clock.now()

    def state(self) -> Any:
        return SimpleNamespace(running=[])

    def apply(self, operator: str, *arguments: str) -> str:
        if operator == self.refuses:
            raise NotApplicable(operator)
        self.told.append((self.now(), "apply", operator, *arguments))
        return f"transaction {len(self.told)}"

    def start(self, operator: str, *arguments: str, duration: int) -> tuple[str, ...]:
        self.told.append((self.now(), "start", operator, *arguments, duration))
        return ("run", *arguments)

    def end(self, run: tuple[str, ...]) -> str:
        self.told.append((self.now(), "end", run))
        return f"transaction {len(self.told)}"


def test_a_plan_is_executed_at_its_times(problem: Any):
    """Steps are done at their times from now on; each comes with what the knowledge base answered."""
    clock = ManualClock(seconds(100))
    knowledge_base = Recorder(clock)
    plan = TimeTriggeredPlan(
        [(Fraction(1), go(problem, "wp0", "wp1"), Fraction(4)), (Fraction(2), look(problem, "wp0"), None)]
    )
    run = ("run", "kenny", "wp0", "wp1")
    happened = [(step.happening, outcome) for step, outcome in execute(knowledge_base, plan, clock.set)]
    assert happened == [(START, run), (APPLY, "transaction 2"), (END, "transaction 3")]
    assert knowledge_base.told == [
        (seconds(101), "start", "go", "kenny", "wp0", "wp1", seconds(4)),
        (seconds(102), "apply", "Look", "wp0"),
        (seconds(105), "end", run),
    ]


def test_steps_without_times_are_not_waited_for(problem: Any):
    """A sequential plan is carried out one step at each turn, at whatever time it is."""
    clock = ManualClock(seconds(100))
    knowledge_base = Recorder(clock)
    carried_out = execute(knowledge_base, SequentialPlan([look(problem, "wp1"), look(problem, "wp0")]), clock.set)
    next(carried_out)
    clock.advance(seconds(3))
    assert len(knowledge_base.told) == 1
    next(carried_out)
    assert knowledge_base.told[1] == (seconds(103), "apply", "Look", "wp0")


def test_a_step_that_is_refused_ends_the_execution(problem: Any):
    """O3: the error is the knowledge base's own, and nothing after it is done."""
    clock = ManualClock()
    knowledge_base = Recorder(clock, refuses="Look")
    plan = TimeTriggeredPlan(
        [(Fraction(0), go(problem, "wp0", "wp1"), Fraction(4)), (Fraction(2), look(problem, "wp0"), None)]
    )
    with pytest.raises(NotApplicable):
        list(execute(knowledge_base, plan, clock.set))
    assert [told[1] for told in knowledge_base.told] == ["start"]
