"""Plans of unified_planning as steps in time, and their execution on a knowledge base."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from enum import Enum
from fractions import Fraction
from typing import Any

from kbstore.clock import SECOND
from kbstore.errors import InvalidKnowledge
from kbstore.interop.up_symbols import library
from kbstore.messages.base import format_number


class Happening(Enum):
    """What a step does; the value is the name of the knowledge base's method for it."""

    APPLY = "apply"
    START = "start"
    END = "end"


@dataclass(frozen=True, slots=True)
class Step:
    """One thing to do: apply an instantaneous action, or start or end a durative one.

    `at` is in nanoseconds from the start of the plan, None in a plan that has an order but no times; `duration` in
    nanoseconds, None for what is instantaneous.
    """

    happening: Happening
    operator: str
    arguments: tuple[str, ...] = ()
    at: int | None = None
    duration: int | None = None

    def __str__(self) -> str:
        when = "" if self.at is None else f"{format_number(self.at / SECOND)}: "
        return f"{when}{self.happening.value} ({' '.join((self.operator, *self.arguments))})"


def steps(plan: Any) -> list[Step]:
    """The steps of a sequential or time-triggered plan, in the order in which they happen.

    A durative action is two steps, its start and its end. At one time ends come before what begins, as that may
    need what they bring about. Times are rounded to the nearest nanosecond.

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
    timed: list[tuple[int, int, Step]] = []  # time, order at that time, step
    for start, instance, duration in plan.timed_actions:
        at, (operator, arguments) = _nanoseconds(start), _named(instance)
        if duration is None:
            timed.append((at, 1, Step(Happening.APPLY, operator, arguments, at)))
            continue
        lasts = _nanoseconds(duration)
        timed.append((at, 1, Step(Happening.START, operator, arguments, at, lasts)))
        timed.append((at + lasts, 0 if lasts else 2, Step(Happening.END, operator, arguments, at + lasts, lasts)))
    return [step for *_, step in sorted(timed, key=lambda entry: entry[:2])]


def execute(knowledge_base: Any, plan: Any, wait: Callable[[int], object]) -> Iterator[tuple[Step, Any]]:
    """Carry out a plan, one step for each turn of the loop, beginning now.

    Before each step that has a time, `wait` is called with that time on the knowledge base's clock, and is to return
    when it has come: for a `ManualClock` that is its `set`, for a robot a function that sleeps. Then the step is done
    with `apply`, `start` or `end`, and comes with what that returned.

        for step, outcome in execute(kb, plan, clock.set):
            print(step)

    `NotApplicable` from a step ends the loop. What was started then still runs, and is found in ``kb.state().running``.
    """
    begin = knowledge_base.now()
    running: dict[tuple[str, tuple[str, ...]], Any] = {}
    for step in steps(plan):
        if step.at is not None:
            wait(begin + step.at)
        action = (step.operator, step.arguments)
        match step.happening:
            case Happening.APPLY:
                yield step, knowledge_base.apply(step.operator, *step.arguments)
            case Happening.START:
                running[action] = knowledge_base.start(step.operator, *step.arguments, duration=step.duration)
                yield step, running[action]
            case Happening.END:
                yield step, knowledge_base.end(running.pop(action))


def _named(instance: Any) -> tuple[str, tuple[str, ...]]:
    """The operator and the objects of an action of a plan."""
    for argument in instance.actual_parameters:
        if not argument.is_object_exp():
            raise InvalidKnowledge(f"{instance} has the argument {argument}; expected are objects")
    return instance.action.name, tuple(argument.object().name for argument in instance.actual_parameters)


def _nanoseconds(seconds: Fraction) -> int:
    return round(Fraction(seconds) * SECOND)
