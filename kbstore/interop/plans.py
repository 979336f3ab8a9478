"""Plans as steps in time, and their execution on a knowledge base."""

from bisect import bisect_left
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from enum import Enum
from fractions import Fraction
from typing import Any

from kbstore.clock import SECOND
from kbstore.errors import InvalidKnowledge, NotApplicable
from kbstore.interop.up_symbols import library
from kbstore.messages.base import format_number
from kbstore.model.results import Run
from kbstore.names import bracketed, key

ROUNDING = 2
"""Nanoseconds by which two times of a plan may differ although they are meant to be the same."""

PRINTED = 1_000_000
"""Nanoseconds by which a duration in a plan may differ from one that the domain allows: planners print 3 decimals."""


class Happening(Enum):
    """The kind of a step; the value is the name of the knowledge base's method for it."""

    APPLY = "apply"
    START = "start"
    END = "end"


@dataclass(frozen=True, slots=True)
class Step:
    """One step of a plan: applies an instantaneous action, or starts or ends a durative one.

    `at` is in nanoseconds from the start of the plan, None in a plan that has an order but no times; `duration` is in
    nanoseconds, None for an instantaneous action.
    """

    happening: Happening
    operator: str
    arguments: tuple[str, ...] = ()
    at: int | None = None
    duration: int | None = None

    def __str__(self) -> str:
        when = "" if self.at is None else f"{format_number(self.at / SECOND)}: "
        return f"{when}{self.happening.value} {bracketed(self.operator, *self.arguments)}"

    @property
    def action(self) -> tuple[str, ...]:
        """The keys of the operator and its arguments, which the start and the end of one run share."""
        return (key(self.operator), *map(key, self.arguments))


def steps(plan: Any) -> list[Step]:
    """Return the steps of a sequential or time-triggered plan of unified_planning, in the order in which they happen.

    A durative action is two steps, its start and its end. At one time ends come before beginnings, which may need the
    effects of the ends. Times are rounded to the nearest nanosecond.

    Raises `InvalidKnowledge` for other kinds of plans, and for arguments that are not objects.
    """
    up = library()
    if isinstance(plan, up.plans.SequentialPlan):
        return [Step(Happening.APPLY, *_named(instance)) for instance in plan.actions]
    if not isinstance(plan, up.plans.TimeTriggeredPlan):
        raise InvalidKnowledge(
            f"a plan is a SequentialPlan or a TimeTriggeredPlan of unified_planning, not {type(plan).__name__};"
            " plan.convert_to(...) makes one of some others"
        )
    timed: list[Step] = []
    for start, instance, duration in plan.timed_actions:
        lasts = None if duration is None else nanoseconds(duration)
        timed += timed_steps(*_named(instance), nanoseconds(start), lasts)
    return in_order(timed)


def timed_steps(operator: str, arguments: tuple[str, ...], at: int, duration: int | None) -> list[Step]:
    """Return the steps of an action that begins at a time; without a duration it is applied. Times in nanoseconds."""
    if duration is None:
        return [Step(Happening.APPLY, operator, arguments, at)]
    return [
        Step(Happening.START, operator, arguments, at, duration),
        Step(Happening.END, operator, arguments, at + duration, duration),
    ]


def in_order(timed: Iterable[Step]) -> list[Step]:
    """Sort steps that have times: at one time ends come first, and otherwise the order stays.

    An end that comes `ROUNDING` or less after a beginning is moved to it: a planner that lets an action begin at the
    end of another may print a start and a duration, in decimals, that add up to a nanosecond more.
    """
    found = list(timed)
    beginnings = sorted({step.at for step in found if step.happening is not Happening.END and step.at is not None})

    def place(step: Step) -> tuple[int, int]:
        assert step.at is not None
        if step.happening is not Happening.END:
            return step.at, 1
        return step.at, 0 if step.duration else 2  # an action that takes no time ends after its own start

    return sorted((_rounded(step, beginnings) for step in found), key=place)


def _rounded(step: Step, beginnings: Sequence[int]) -> Step:
    """Return an end at the beginning just before it, unless that is its own; any other step as it is."""
    if step.happening is not Happening.END or step.at is None or not step.duration:
        return step
    first = bisect_left(beginnings, step.at - min(ROUNDING, step.duration - 1))
    if first < len(beginnings) and beginnings[first] < step.at:
        return replace(step, at=beginnings[first])
    return step


def execute(
    knowledge_base: Any,
    plan: Sequence[Step] | Any,
    wait: Callable[[int], object],
    *,
    stop_when_broken: bool = True,
) -> Iterator[tuple[Step, Any]]:
    """Execute a plan, one step for each iteration, beginning now.

    Before each step that has a time, `wait` is called with that time on the knowledge base's clock, and has to return
    when it has come: for a `ManualClock` that is its `set`, for a robot a function that sleeps. Then the step is
    performed with `apply`, `start` or `end`, and yielded with the result of that.

        for step, outcome in execute(kb, plan, clock.set):
            print(step)

    Actions that run when a plan with times begins are part of the problem that it solves (rule O4): each is ended at
    its expected end, also after the last step, unless it has been ended or aborted by then. Overdue ones are left
    alone.

    A duration that the planner rounded is replaced by one that the domain allows, if there is one within a millisecond,
    and the action ends accordingly. An action is started although one of its over-all conditions is expected to break,
    if the plan has another step before that, which may prevent it.

    `NotApplicable` ends the loop: from a step, or before one if an over-all condition of a running action has been
    broken (rule O6). Actions that were started still run, and are listed in ``kb.state().running``.

    Args:
        knowledge_base: The `KnowledgeBase` to act on.
        plan: A plan of unified_planning, or steps.
        wait: Waits until a time, in nanoseconds.
        stop_when_broken: False to go on when an over-all condition has been broken.
    """
    todo = list(plan) if isinstance(plan, Sequence) else steps(plan)
    begin = knowledge_base.now()
    before: list[Run] = []
    if all(step.at is not None for step in todo):
        before = [run for run in knowledge_base.state().running if run.expected_end > begin]
        ends = [_end_of(run, begin) for run in before]
        todo = in_order([*ends, *todo])
    running: dict[tuple[str, ...], Run] = {_end_of(run, begin).action: run for run in before}
    for index, step in enumerate(todo):
        if step.at is not None:
            following = todo[index + 1].at if index + 1 < len(todo) else None
            following = None if following is None else begin + following
            wait(_due(step, begin, following, running.get(step.action), knowledge_base.now()))
        if stop_when_broken:
            _refuse_broken(knowledge_base, running.values())
        match step.happening:
            case Happening.APPLY:
                yield step, knowledge_base.apply(step.operator, *step.arguments)
            case Happening.START:
                later = (other.at for other in todo[index + 1 :] if other.happening is not Happening.END)
                repair = next((begin + at for at in later if at is not None), None)
                running[step.action] = _start(knowledge_base, step, repair)
                yield step, running[step.action]
            case Happening.END:
                run = running.pop(step.action)
                if run not in before or run in knowledge_base.state().running:
                    yield step, knowledge_base.end(run)


def _start(knowledge_base: Any, step: Step, repair: int | None) -> Run:
    """Start an action with its duration in the plan, or one within `PRINTED` of it that the domain allows.

    An over-all condition that is expected to break does not keep it from starting if another step, at the time
    `repair`, comes before that: it may prevent the break, and otherwise the break stops the plan.
    """
    try:
        started: Run = knowledge_base.start(step.operator, *step.arguments, duration=step.duration)
        return started
    except NotApplicable:
        # the fixed duration, and durations on either side of a bound, which rounding may have crossed
        near = () if step.duration is None else (None, step.duration - PRINTED // 2, step.duration + PRINTED // 2)
        for duration in (step.duration, *near):
            with suppress(NotApplicable, InvalidKnowledge), knowledge_base.transaction() as tx:
                force = _is_only_foreseen(tx, step, duration, repair)
                started = tx.start(step.operator, *step.arguments, duration=duration, force=force)
                if step.duration is not None and abs(started.duration - step.duration) > PRINTED:
                    raise
                return started
        raise


def _is_only_foreseen(tx: Any, step: Step, duration: int | None, repair: int | None) -> bool:
    """Return whether nothing keeps an action from starting but breaks that are expected at `repair` or later."""
    if repair is None:
        return False
    failing = tx.applicable(step.operator, *step.arguments, duration=duration).failing
    return bool(failing) and all(f.since is not None and f.since >= max(repair, tx.now + 1) for f in failing)


def _due(step: Step, begin: int, following: int | None, run: Run | None, now: int) -> int:
    """Return the time at which a step is due.

    An end whose time the plan rounded is due at the expected end of its run, but no later than the step that follows.
    """
    planned = begin + (step.at or 0)
    if step.happening is not Happening.END or run is None or not 0 < abs(run.expected_end - planned) <= PRINTED:
        return planned
    latest = run.expected_end if following is None else min(run.expected_end, following)
    return max(latest, now)


def _refuse_broken(knowledge_base: Any, runs: Iterable[Run]) -> None:
    """Raise `NotApplicable` if an over-all condition of a run has been broken.

    A condition that breaks at the very time at which the run is to end does not count, as it ends now.
    """
    now = knowledge_base.now()
    for run in runs:
        broken = [found for found in knowledge_base.broken(run) if found.since < now or run.expected_end > now]
        if broken:
            raise NotApplicable(
                f"the plan is stopped: {run} needs {broken[0]}; abort it and plan again, or go on with "
                "stop_when_broken=False"
            )


def _end_of(run: Run, begin: int) -> Step:
    return Step(Happening.END, run.operator, run.arguments, run.expected_end - begin, run.duration)


def _named(instance: Any) -> tuple[str, tuple[str, ...]]:
    """Return the operator and the objects of an action of a plan."""
    for argument in instance.actual_parameters:
        if not argument.is_object_exp():
            raise InvalidKnowledge(f"{instance} has the argument {argument}; expected are objects")
    return instance.action.name, tuple(argument.object().name for argument in instance.actual_parameters)


def nanoseconds(seconds: Fraction) -> int:
    """Convert exact seconds to nanoseconds, rounded to the nearest."""
    return round(Fraction(seconds) * SECOND)
