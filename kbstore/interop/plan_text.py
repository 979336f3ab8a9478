"""Plans as planners print them, in the format of the planning competitions.

    0.000: (undock kenny home) [10.000]
    10.001: (drive kenny home office) [24.000]

Times and durations are in seconds. A plan without times, one action a line, is a sequence.
"""

import re
from fractions import Fraction

from kbstore.clock import TIME_LIMIT
from kbstore.errors import PddlSyntaxError
from kbstore.interop.plans import Happening, Step, in_order, nanoseconds, timed_steps
from kbstore.model.domain import Domain

_NUMBER = r"(\d{1,20}(?:\.\d{0,30})?|\.\d{1,30})"
_ACTION = re.compile(rf"(?:{_NUMBER}\s*+:\s*+)?\(\s*+([^()\s]++)([^()]*+)\)\s*+(?:\[\s*+{_NUMBER}\s*+\])?")
"""An action with its time and duration. Nothing in it is tried twice, so that long lines are read in linear time."""


def read_plan(text: str, domain: Domain) -> list[Step]:
    """The steps of a plan in text, in the order in which they happen; `kbstore.interop.plans.execute` takes them.

    Blank lines and comments (``;``) are no part of it. The domain tells which actions take time: of an instantaneous
    one, a duration in the text counts for nothing. Times are rounded to the nearest nanosecond.

    Raises:
        PddlSyntaxError: a line is no action, or one lacks the time or the duration that it needs.
        UnknownSymbol: the domain has no operator of that name.
    """
    found: list[Step] = []
    is_timed: bool | None = None
    for number, line in enumerate(text.splitlines(), 1):
        content = line.partition(";")[0].strip()
        if not content:
            continue
        match = _ACTION.fullmatch(content)
        if match is None:
            raise _refused("expected is one action a line, as 12.5: (drive kenny home office) [24]", number, line)
        at, duration = _time(match[1]), _time(match[4])
        if max(at or 0, duration or 0) >= TIME_LIMIT:
            raise _refused("a time in a plan is below 2**62 nanoseconds", number, line)
        action, arguments = domain.action(match[2]), tuple(match[3].split())
        if is_timed is not None and is_timed != (at is not None):
            raise _refused("some actions of the plan have a time and others have none", number, line)
        is_timed = at is not None
        if action.durative and (at is None or duration is None):
            raise _refused(f"{action.name} takes time, and needs a time and a duration: 0: (...) [24]", number, line)
        if at is None:
            found.append(Step(Happening.APPLY, action.name, arguments))
        else:
            found += timed_steps(action.name, arguments, at, duration if action.durative else None)
    return in_order(found) if is_timed else found


def _time(text: str | None) -> int | None:
    return None if text is None else nanoseconds(Fraction(text))


def _refused(problem: str, line: int, text: str) -> PddlSyntaxError:
    return PddlSyntaxError(problem, line=line, source="plan", text_line=text)
