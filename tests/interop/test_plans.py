"""Plans of unified_planning as steps in time, and their execution."""

from fractions import Fraction
from types import SimpleNamespace
from typing import Any

import pytest
from unified_planning.plans import PartialOrderPlan, SequentialPlan, TimeTriggeredPlan

import kbstore
from kbstore.clock import ManualClock, seconds
from kbstore.errors import InvalidKnowledge, NotApplicable
from kbstore.interop.plan_text import read_plan
from kbstore.interop.unified_planning import Happening, Step, execute, steps, to_problem
from kbstore.model.results import Run
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
    """A start may need the effect of an end; an action without length ends after its own start."""
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
    """A partially ordered plan is refused by its kind, with what to do."""
    with pytest.raises(InvalidKnowledge, match=r"PartialOrderPlan.*convert_to"):
        steps(PartialOrderPlan({look(problem, "wp0"): []}))


class Recorder:
    """A stand-in for a knowledge base that records its calls, and when."""

    def __init__(self, clock: ManualClock, refuses: str = "") -> None:
        self.clock = clock
        self.refuses = refuses
        self.calls: list[tuple[Any, ...]] = []

    def now(self) -> int:
        return self.clock.now()

    def state(self) -> Any:
        return SimpleNamespace(running=[])

    def apply(self, operator: str, *arguments: str) -> str:
        if operator == self.refuses:
            raise NotApplicable(operator)
        self.calls.append((self.now(), "apply", operator, *arguments))
        return f"transaction {len(self.calls)}"

    def start(self, operator: str, *arguments: str, duration: int) -> Run:
        self.calls.append((self.now(), "start", operator, *arguments, duration))
        return Run(operator, arguments, self.now(), duration)

    def broken(self, run: Run) -> list[Any]:
        return []

    def end(self, run: Run) -> str:
        self.calls.append((self.now(), "end", run))
        return f"transaction {len(self.calls)}"


def test_a_plan_is_executed_at_its_times(problem: Any):
    """Steps are done at their times from now on; each is returned with the answer of the knowledge base."""
    clock = ManualClock(seconds(100))
    knowledge_base = Recorder(clock)
    plan = TimeTriggeredPlan(
        [(Fraction(1), go(problem, "wp0", "wp1"), Fraction(4)), (Fraction(2), look(problem, "wp0"), None)]
    )
    run = Run("go", ("kenny", "wp0", "wp1"), seconds(101), seconds(4))
    happened = [(step.happening, outcome) for step, outcome in execute(knowledge_base, plan, clock.set)]
    assert happened == [(START, run), (APPLY, "transaction 2"), (END, "transaction 3")]
    assert knowledge_base.calls == [
        (seconds(101), "start", "go", "kenny", "wp0", "wp1", seconds(4)),
        (seconds(102), "apply", "Look", "wp0"),
        (seconds(105), "end", run),
    ]


def test_steps_without_times_are_not_waited_for(problem: Any):
    """The steps of a sequential plan are carried out one at each turn, at any time."""
    clock = ManualClock(seconds(100))
    knowledge_base = Recorder(clock)
    carried_out = execute(knowledge_base, SequentialPlan([look(problem, "wp1"), look(problem, "wp0")]), clock.set)
    next(carried_out)
    clock.advance(seconds(3))
    assert len(knowledge_base.calls) == 1
    next(carried_out)
    assert knowledge_base.calls[1] == (seconds(103), "apply", "Look", "wp0")


def test_a_step_that_is_refused_ends_the_execution(problem: Any):
    """O3: the error is the knowledge base's own, and later steps are not carried out."""
    clock = ManualClock()
    knowledge_base = Recorder(clock, refuses="Look")
    plan = TimeTriggeredPlan(
        [(Fraction(0), go(problem, "wp0", "wp1"), Fraction(4)), (Fraction(2), look(problem, "wp0"), None)]
    )
    with pytest.raises(NotApplicable):
        list(execute(knowledge_base, plan, clock.set))
    assert [call[1] for call in knowledge_base.calls] == ["start"]


ROUNDED = """
(define (domain rounded)
  (:predicates (ready) (done) (lit))
  (:functions (load) (level))
  (:durative-action fill :parameters () :duration (= ?duration (/ (load) 3))
    :condition (over all (lit)) :effect (and (increase (level) (* #t 3)) (at end (done))))
  (:durative-action rest :parameters () :duration (<= ?duration (/ (load) 3)) :condition () :effect (at end (ready))))
"""


@pytest.fixture
def rounded() -> Any:
    with kbstore.open("sqlite://", "rounded", clock=ManualClock(seconds(10))) as kb:
        kb.load(ROUNDED)
        kb.add("(= (load) 20)", "(= (level) 0)", "(lit)")
        yield kb


@pytest.mark.parametrize("printed", ["6.667", "6.666"])
def test_a_rounded_duration_is_the_one_that_the_domain_fixes(rounded: Any, printed: str):
    """O7: a plan is carried out with any rounding: 20 / 3 s fill exactly 20, and the end is at that time."""
    clock = rounded._clock
    done = list(execute(rounded, read_plan(f"0.0: (fill) [{printed}]", rounded.domain), clock.set))
    assert [step.happening for step, _ in done] == [START, END]
    assert done[1][1].time == seconds(10) + 6_666_666_667
    assert rounded.value("(level)") == 20
    assert rounded.holds("(done)")


def test_a_duration_rounded_across_a_bound_is_within_it(rounded: Any):
    """O7: 6.667 s where at most 20 / 3 s are allowed starts with half a millisecond less."""
    list(execute(rounded, read_plan("0.0: (rest) [6.667]", rounded.domain), rounded._clock.set))
    assert rounded.holds("(ready)")
    (run,) = rounded.runs()
    assert run.duration == seconds("6.6665")


def test_a_duration_that_is_not_rounded_is_refused(rounded: Any):
    """O7: a difference of more than a millisecond is another duration; nothing starts."""
    with pytest.raises(NotApplicable, match="duration"):
        list(execute(rounded, read_plan("0.0: (fill) [6.6]", rounded.domain), rounded._clock.set))
    assert rounded.runs() == []


def test_execution_stops_where_an_invariant_is_broken(rounded: Any):
    """O6: before the next step the broken condition is named; the run stays running, unless told to continue."""
    plan = read_plan("0.0: (fill) [6.667]", rounded.domain)
    carried_out = execute(rounded, plan, rounded._clock.set)
    next(carried_out)
    rounded._clock.advance(seconds(2))
    rounded.remove("(lit)")
    with pytest.raises(NotApplicable, match=r"\(lit\) is false since"):
        next(carried_out)
    (run,) = rounded.state().running
    rounded.abort(run)
    rounded.add("(lit)")
    carried_out = execute(rounded, plan, rounded._clock.set, stop_when_broken=False)
    next(carried_out)
    rounded.remove("(lit)")
    step, ended = next(carried_out)
    assert step.happening is END
    assert [broken.condition for broken in ended.broken] == ["(lit)"]


TANK = """
(define (domain tank) (:functions (level))
  (:durative-action fill :parameters () :duration (<= ?duration 9) :condition (over all (<= (level) 6))
    :effect (increase (level) (* #t 1)))
  (:action vent :parameters () :effect (assign (level) 0))
  (:action knock :parameters () :effect (increase (level) 0)))
"""


@pytest.fixture
def tank(clock: ManualClock) -> Any:
    with kbstore.open("sqlite://", clock=clock) as kb:
        kb.load(TANK)
        kb.add("(= (level) 0)")
        yield kb


def test_a_later_step_may_prevent_an_expected_break(tank: Any, clock: ManualClock):
    """O6: the level would be above 6 after 6 s, and is vented before; a validator accepts the plan."""
    done = execute(tank, read_plan("0: (fill) [8]\n5: (vent)", tank.domain), clock.set)
    assert [str(step) for step, _ in done] == ["0: start (fill)", "5: apply (vent)", "8: end (fill)"]
    (run,) = tank.runs()
    assert run.broken == ()
    assert run.forced == ("(<= (level) 6)",)
    assert tank.value("(level)") == 3


@pytest.mark.parametrize("plan", ["0: (fill) [8]", "0: (fill) [8]\n7: (vent)", "0: (fill) [10]\n5: (vent)"])
def test_a_break_that_no_step_prevents_is_refused_at_the_start(tank: Any, clock: ManualClock, plan: str):
    """O6, O7: no step comes before the break; and a duration that the domain does not allow stays refused."""
    with pytest.raises(NotApplicable, match=r"\(fill\) is not applicable"):
        list(execute(tank, read_plan(plan, tank.domain), clock.set))
    assert tank.runs() == []


def test_a_break_at_the_end_of_a_run_does_not_stop_the_plan(clock: ManualClock):
    """O6: two actions end at one time, and the first end breaks an invariant that the second needed until then."""
    domain = """
    (define (domain d) (:predicates (sealed) (done))
      (:durative-action hold :parameters () :duration (= ?duration 4)
        :effect (and (at start (sealed)) (at end (not (sealed)))))
      (:durative-action cure :parameters () :duration (= ?duration 3) :condition (over all (sealed))
        :effect (at end (done))))"""
    with kbstore.open("sqlite://", clock=clock) as kb:
        kb.load(domain)
        list(execute(kb, read_plan("0: (hold) [4]\n1: (cure) [3]", kb.domain), clock.set))
        assert kb.holds("(done)")
        assert [run.broken for run in kb.runs()] == [(), ()]


def test_a_break_that_was_not_prevented_stops_the_plan(tank: Any, clock: ManualClock):
    """O6: the step before the break does not help; the plan is stopped where the break is on record."""
    with pytest.raises(NotApplicable, match=r"the plan is stopped: \(fill\) .* needs \(<= \(level\) 6\)"):
        list(execute(tank, read_plan("0: (fill) [8]\n5: (knock)\n7: (vent)", tank.domain), clock.set))
    (run,) = tank.runs()
    assert run.outcome == "running"
    assert [broken.since for broken in run.broken] == [run.started + seconds(6) + 1]
