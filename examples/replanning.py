"""A robot plans, something goes wrong, it plans again; then it looks back at the moment before.

    pip install 'kbstore[planning]' up-kairos
    python replanning.py

Kenny is to bring a blood sample to the laboratory before its staff leaves. The short way is through a glass door that
opens in a minute; the centrifuge there is rinsed meanwhile. The planner is Kairos, under unified_planning. The world is
played here: by a clock that is moved by hand, and a door that does not open.
"""

from collections.abc import Callable, Iterator, Sequence
from itertools import product
from typing import Any

import kairos
import up_kairos
from unified_planning.shortcuts import OneshotPlanner, get_environment

import kbstore
from kbstore import KnowledgeBase, ManualClock, NotApplicable, State, seconds
from kbstore.interop.unified_planning import Happening, Step, execute, steps

DOMAIN = """\
; Metres, seconds, percent.
(define (domain courier)
  (:requirements :strips :typing :fluents :durative-actions :duration-inequalities :continuous-effects
                 :timed-initial-literals)
  (:types robot place door machine sample)
  (:predicates
    (robot_at ?r - robot ?p - place) (path ?a ?b - place) (charger_at ?p - place)
    (doorway ?d - door ?a ?b - place) (open ?d - door)
    (machine_at ?m - machine ?p - place) (idle ?m - machine) (clean ?m - machine) (staffed ?p - place)
    (sample_at ?s - sample ?p - place) (carries ?r - robot ?s - sample) (analysed ?s - sample))
  (:functions (battery ?r - robot) (distance ?a ?b - place))

  (:action take
    :parameters (?r - robot ?s - sample ?p - place)
    :precondition (and (robot_at ?r ?p) (sample_at ?s ?p))
    :effect (and (not (sample_at ?s ?p)) (carries ?r ?s)))

  (:action put
    :parameters (?r - robot ?s - sample ?p - place)
    :precondition (and (robot_at ?r ?p) (carries ?r ?s))
    :effect (and (not (carries ?r ?s)) (sample_at ?s ?p)))

  ; one metre a second, at half a percent
  (:durative-action drive
    :parameters (?r - robot ?a ?b - place)
    :duration (= ?duration (distance ?a ?b))
    :condition (and (at start (robot_at ?r ?a)) (at start (path ?a ?b))
                    (at start (>= (battery ?r) (/ (distance ?a ?b) 2))))
    :effect (and (at start (not (robot_at ?r ?a))) (at end (robot_at ?r ?b)) (decrease (battery ?r) (* #t 0.5))))

  (:durative-action pass
    :parameters (?r - robot ?d - door ?a ?b - place)
    :duration (= ?duration (distance ?a ?b))
    :condition (and (at start (robot_at ?r ?a)) (at start (doorway ?d ?a ?b)) (over all (open ?d))
                    (at start (>= (battery ?r) (/ (distance ?a ?b) 2))))
    :effect (and (at start (not (robot_at ?r ?a))) (at end (robot_at ?r ?b)) (decrease (battery ?r) (* #t 0.5))))

  (:durative-action charge
    :parameters (?r - robot ?p - place)
    :duration (and (>= ?duration 10) (<= ?duration 90))
    :condition (and (over all (robot_at ?r ?p)) (over all (charger_at ?p)))
    :effect (increase (battery ?r) (* #t 1)))

  (:durative-action rinse
    :parameters (?m - machine)
    :duration (= ?duration 360)
    :condition (at start (idle ?m))
    :effect (and (at start (not (idle ?m))) (at end (idle ?m)) (at end (clean ?m))))

  (:durative-action analyse
    :parameters (?m - machine ?s - sample ?p - place)
    :duration (= ?duration 30)
    :condition (and (at start (idle ?m)) (at start (clean ?m)) (over all (machine_at ?m ?p))
                    (over all (sample_at ?s ?p)) (over all (staffed ?p)))
    :effect (and (at start (not (idle ?m))) (at start (not (clean ?m))) (at end (idle ?m)) (at end (analysed ?s)))))
"""

PROBLEM = """\
; The glass door opens a minute after loading; the staff leaves seven minutes after loading.
(define (problem blood-sample)
  (:domain courier)
  (:objects kenny - robot ward corridor court lab - place glass_door - door centrifuge - machine blood - sample)
  (:init
    (robot_at kenny ward) (charger_at ward) (= (battery kenny) 50)
    (sample_at blood ward) (machine_at centrifuge lab) (idle centrifuge) (staffed lab)
    (path ward corridor)  (path corridor ward)  (= (distance ward corridor) 40)  (= (distance corridor ward) 40)
    (path corridor court) (path court corridor) (= (distance corridor court) 60) (= (distance court corridor) 60)
    (path court lab)      (path lab court)      (= (distance court lab) 50)      (= (distance lab court) 50)
    (doorway glass_door corridor lab) (doorway glass_door lab corridor)
    (= (distance corridor lab) 10) (= (distance lab corridor) 10)
    (at 60 (open glass_door))
    (at 420 (not (staffed lab))))
  (:goal (analysed blood))
  (:metric minimize (total-time)))
"""

START = kbstore.time("2026-05-04T07:00:00Z")


# -- the robot --------------------------------------------------------------------------------------------------


def plan_for(problem: Any) -> Any:
    """The first plan that Kairos finds."""
    with OneshotPlanner(name="kairos", params={"anytime": False}) as planner:
        plan = planner.solve(problem, timeout=20).plan
    if plan is None:
        raise SystemExit("Kairos finds no plan")
    return plan


def waiting(kb: KnowledgeBase, clock: ManualClock) -> Callable[[int], None]:
    """Waits until a time. A camera watches the door, and contradicts what the schedule says of it."""

    def wait(t: int) -> None:
        clock.set(t)
        if kb.holds("(open glass_door)"):
            kb.add("(not (open glass_door))", client="camera", note="the door is shut")

    return wait


def carry_out(kb: KnowledgeBase, plan: Any, wait: Callable[[int], None]) -> bool:
    """Execute a plan step by step; whether it came to its end."""
    try:
        for step, _ in execute(kb, plan, wait):
            print(f"  {shown(kb.now())}  {step.happening.value:5}  {action(step):42} battery {level(kb)}")
    except NotApplicable as failure:
        print(f"  {shown(kb.now())}  {failure}")
        return False
    return True


# -- the judge --------------------------------------------------------------------------------------------------


def prefixes(plan: Any, since: int, until: int) -> Iterator[tuple[int, list[Step]]]:
    """What of a plan, begun at `since`, has begun by each of its times up to `until`."""
    begun = [step for step in steps(plan) if step.happening is not Happening.END and since + step.at <= until]
    for at in sorted({step.at for step in begun}):
        yield since + at, [step for step in begun if step.at <= at]


def agrees(kb: KnowledgeBase, start: State, t: int, prefix: Sequence[Step]) -> bool:
    """Whether Kairos' validator comes to what the store expected at `t`.

    It begins at a state, and is given what of a plan has begun by `t`. The goal that it checks is everything that the
    store says of the time when all of that has ended, and all that was scheduled has taken effect.
    """
    ends = [start.at + step.at + (step.duration or 0) for step in prefix]
    ends += [item.initial_time for item in start.timed_knowledge] + [run.expected_end for run in start.running]
    expected = kb.state(at=max(ends), as_of=t)
    problem = start.to_pddl()
    problem = problem[: problem.index("(:goal")] + f"(:goal (and {' '.join(everything(expected))})))"
    lines = [f"{step.at / 1e9:.9f}: {action(step)} [{(step.duration or 0) / 1e9:.9f}]" for step in prefix]
    return bool(kairos.validate_plan(kb.domain_to_pddl(), problem, kairos.parse_plan("\n".join(lines))))


def everything(state: State) -> Iterator[str]:
    """Each fact that holds in a state, each that does not, and each number."""
    for predicate in state.domain.predicates:
        types = [parameter.value for parameter in predicate.typed_parameters]
        for arguments in product(*map(state.objects, types)):
            atom = f"({' '.join((predicate.name, *arguments))})"
            yield atom if state.holds(atom) else f"(not {atom})"
    yield from map(str, state.functions)


# -- the story --------------------------------------------------------------------------------------------------


def main() -> None:
    """Plan, fail, plan again, finish, look back."""
    up_kairos.register()
    get_environment().credits_stream = None
    clock = ManualClock(START)
    with kbstore.open("sqlite://", "kenny", clock=clock) as kb:
        kb.load(DOMAIN, PROBLEM, client="mission")

        heading("The plan")
        morning = kb.state()
        first = plan_for(kb.to_problem())
        show(first)

        heading("Its execution, at the times of the plan")
        wait = waiting(kb, clock)
        assert not carry_out(kb, first, wait), "the door was to stay shut"
        failure = kb.state()
        print(f"\n  {kb.explain('(open glass_door)')}")

        heading("The problem as it now stands: what changes, what is running, what is to come")
        static = ("path", "doorway", "distance", "_at ward", "_at centrifuge")
        text = failure.to_pddl()
        lines = text[text.index("(:init") : text.index("(:goal")].splitlines()
        print("\n".join(line for line in lines if line.strip() and not any(word in line for word in static)))

        heading("The plan from there, and its execution; the centrifuge is still being rinsed")
        second = plan_for(kb.to_problem())
        assert carry_out(kb, second, wait)
        print(f"\n  {', '.join(map(str, kb.goals()))}: {'reached' if kb.query(*kb.goals()) else 'missed'}")

        heading("Back to the second before: the plan from what stood then")
        before = failure.at - seconds(1)
        show(plan_for(kb.to_problem(at=before)), before)

        heading("And from what was expected then of the second after")
        show(plan_for(kb.to_problem(at=failure.at, as_of=before)), failure.at)

        heading("Does the planner's own validator come to the states that the store tells of?")
        for plan, start, until in ((first, morning, before), (second, failure, kb.now())):
            for t, prefix in prefixes(plan, start.at, until):
                verdict = "yes" if agrees(kb, start, t, prefix) else "NO"
                print(f"  {verdict:3}  after {action(prefix[-1])} has begun at {shown(t)}")


def show(plan: Any, since: int = START) -> None:
    """A plan, at the times when it would be executed."""
    for step in steps(plan):
        if step.happening is not Happening.END:
            lasts = f"for {step.duration / 1e9:g} s" if step.duration else ""
            print(f"  {shown(since + step.at)}  {action(step):50} {lasts}".rstrip())


def action(step: Step) -> str:
    """The action of a step, as in PDDL."""
    return f"({' '.join((step.operator, *step.arguments))})"


def level(kb: KnowledgeBase) -> str:
    """What is in the battery."""
    return f"{kb.value('(battery kenny)'):.1f} %"


def shown(t: int) -> str:
    """A time, as minutes, seconds and thousandths after the start."""
    minutes, rest = divmod((t - START) / 1e9, 60)
    return f"{minutes:02.0f}:{rest:06.3f}"


def heading(text: str) -> None:
    """A line above a part of the story."""
    print(f"\n{text}\n{'-' * len(text)}")


if __name__ == "__main__":
    main()
