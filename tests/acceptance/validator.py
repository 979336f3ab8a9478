"""An independent judge of states: the validator of the planner Kairos.

Two ways to ask it whether a state of the store is the one that a plan leads to:

- a *witness* is an action added to the domain whose precondition is the whole state; a plan with the witness
  at some time is valid exactly if all of that holds then, also while other actions run;
- a *prefix* of a plan is validated against a problem whose goal is the whole state.

Numbers agree within the validator's tolerance of 1e-6.
"""

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from functools import partial
from itertools import product

import kairos

from kbstore import State
from kbstore.clock import SECOND
from kbstore.interop.plans import Happening, Step
from kbstore.messages.base import format_number

_WORD = re.compile(r"[^\s()]+")


def everything(state: State, *, numbers: bool = True) -> Iterator[str]:
    """Each fact that holds in a state, each that does not, and each defined number unless excluded."""
    assert state.domain is not None
    for signature in state.domain.predicate_signatures.values():
        objects = [sorted({o for t in p.types for o in state.objects(t)}) for p in signature.parameters]
        for arguments in product(*objects):
            atom = f"({' '.join((signature.name, *arguments))})"
            yield atom if state.holds(atom) else f"(not {atom})"
    for function in state.functions if numbers else ():
        assert function.function_value is not None
        yield f"(= {function.atom} {format_number(function.function_value)})"


def decimal(nanoseconds: int) -> str:
    """Seconds, exactly."""
    whole, rest = divmod(nanoseconds, SECOND)
    return f"{whole}.{rest:09d}"


def plan_text(steps: Iterable[Step]) -> str:
    """The plan of some steps; ends belong to their starts."""
    lines = []
    for place, step in enumerate(steps):
        if step.happening is not Happening.END:
            at = place * SECOND if step.at is None else step.at
            action = " ".join((step.operator, *step.arguments))
            lines.append(f"{decimal(at)}: ({action}) [{decimal(step.duration or 0)}]")
    return "\n".join(lines)


def complaints(domain: str, problem: str, plan: str) -> list[str]:
    """The validator's objections to a plan; empty if it is valid.

    Steps at one time may interfere: the store orders them.
    """
    options = kairos.ValidateOptions()
    options.epsilon = 0.0
    report = kairos.validate_plan(domain, problem, kairos.parse_plan(plan), options)
    return [] if report.valid else [str(diagnostic) for diagnostic in report.diagnostics] or [str(report.status)]


def with_goal(problem: str, goal: Iterable[str]) -> str:
    """A problem that kbstore wrote, with another goal and without a metric."""
    return f"{problem[: problem.index('  (:goal')]}  (:goal (and {' '.join(goal)})))"


def disagreements(
    domain: str, problem: str, plan: str, states: Mapping[int, State], *, numbers: bool = True
) -> list[str]:
    """The validator's objections to a plan, and to states at times (in nanoseconds) of the plan."""
    witnesses, lines = [], [plan]
    for number, (at, state) in enumerate(states.items()):
        objects = state.objects()
        variables = [f"?{name}" for name in objects]
        names = dict(zip(map(str.lower, objects), variables, strict=True))
        content = " ".join(_WORD.sub(partial(_renamed, names), text) for text in everything(state, numbers=numbers))
        parameters = " ".join(variables)
        witnesses.append(
            f"(:action witness-{number} :parameters ({parameters}) :precondition (and {content}) :effect (and))"
        )
        lines.append(f"{decimal(at)}: (witness-{number} {' '.join(objects)})")
    opened = domain[: domain.rindex(")")]
    return complaints(" ".join((opened, *witnesses, ")")), with_goal(problem, []), "\n".join(lines))


def _renamed(names: Mapping[str, str], word: re.Match[str]) -> str:
    return names.get(word[0].lower(), word[0])


def between(steps: Sequence[Step], others: Iterable[int] = ()) -> list[int]:
    """A time after each step and before the next one, and before each of the times `others`; in nanoseconds."""
    times = sorted({step.at for step in steps if step.at is not None} | {0, *others})
    return [(a + b) // 2 for a, b in zip(times, [*times[1:], times[-1] + SECOND], strict=True) if b - a > 1000]
