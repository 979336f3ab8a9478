"""Reads plans as planners print them, with the text around them (rule P6).

    0.000: (undock kenny home) [10.000]
    10.001: (drive kenny home office) [24.000]

That is the format of the planning competitions, which POPF, OPTIC, ENHSP, LPG and TFD print, too, and without times
Fast Downward's `sas_plan`. FF and Metric-FF number the steps of a sequence; Fast Downward's log has its costs:

    step    0: UNDOCK KENNY HOME                  undock kenny home (1)
            1: DRIVE KENNY HOME OFFICE            drive kenny home office (1)

Times and durations are in seconds.
"""

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from fractions import Fraction
from typing import NamedTuple

from kbstore.clock import TIME_LIMIT
from kbstore.errors import PddlSyntaxError
from kbstore.interop.plans import Happening, Step, in_order, nanoseconds, timed_steps
from kbstore.model.domain import Domain
from kbstore.names import key

_NUMBER = r"(\d{1,20}(?:\.\d{0,30})?|\.\d{1,30})"

# possessive quantifiers try nothing twice, so that long lines are read in linear time
_ACTION = re.compile(
    rf"(?:{_NUMBER}\s*+:\s*+)?\(\s*+([^()\s]++)([^()]*+)\)\s*+"
    rf"(?:\[\s*+(?:D\s*+:\s*+)?{_NUMBER}\s*+(?:;\s*+C\s*+:[^\[\]]*+)?\])?"
)
"""An action with its time and duration; LPG writes the duration as ``[D:10.0; C:0.1]``, with a cost."""
_NUMBERED = re.compile(r"(step\s++)?(\d{1,9})\s*+:\s*+([A-Za-z][^\s()\[\]]*+)((?:\s++[^\s()\[\]]++)*+)", re.I)
"""A step of FF, without brackets and with its number in the sequence."""
_COSTED = re.compile(r"([A-Za-z][^\s()\[\]]*+)((?:\s++[^\s()\[\]]++)*+)\s++\(\d++\)")
"""A step in the log of Fast Downward, with its cost in brackets."""

_LIKE_A_STEP = re.compile(r"[-+]?[\d.][\d.e+-]*+\s*+:\s*+\(|\(\s*+[^\s\d()|]|step\s++\d++\s*+:", re.I)
"""The beginning of a line that is meant to be a step."""
_NO_ACTION = re.compile(r"[\d.]++\s*+:\s*+(?:-+\s*waiting\s*-+|@PlanEND)", re.I)
"""The line that ENHSP prints between the actions of a PDDL+ plan."""
_NEW_PLAN = re.compile(
    r";;;; Solution Found|^; Plan found with metric|^(?:\[t=[^\]]*\] )?Solution found[!.]?$|found legal plan as follows"
    r"|^Found Plan:|^Plan computed:|^Solution with original makespan|^Rescheduled Plan",
    re.I,
)
"""The line that announces a plan; planners that go on improving print several, the best of them last."""
_EMPTY_PLAN = re.compile(r"empty plan solves it|plan[- ]length: ?0\b", re.I)
_LOG = re.compile(r"(?:\[t=[^\]]*\] )?Solution found[!.]$")
"""After this, every line of Fast Downward's log that ends in a number in brackets is a step."""
_END_OF_LOG = re.compile(r"plan length: ?\d+ step", re.I)
_COLOUR = re.compile(r"\x1b\[[\d;]*m")


def read_plan(text: str, domain: Domain, names: Mapping[str, str] | None = None) -> list[Step]:
    """Read the steps of a plan in text, in the order in which they happen.

    `kbstore.interop.plans.execute` executes them. Blank lines, comments (``;``) and text that planners print around a
    plan are skipped; if there are several plans, the last is read. The domain determines which actions take time: the
    text's duration of an instantaneous one is ignored. Times are rounded to the nearest nanosecond.

    Args:
        text: the output of a planner, or a plan's file.
        domain: the domain that the plan is for.
        names: the knowledge base's names for names in the text, if the problem was written with others:
            `StrictPddl.names` (rule P5).

    Raises:
        PddlSyntaxError: a line looks like a step and is not one, an action lacks the time or the duration that it
            needs, or the text has no plan.
        UnknownSymbol: the domain has no operator of that name.
    """
    reader = _PlanReader(domain, {key(name): meant for name, meant in (names or {}).items()})
    for number, line in enumerate(text.splitlines(), 1):
        reader.line(number, _COLOUR.sub("", line) if "\x1b" in line else line)
    return reader.steps()


class _Written(NamedTuple):
    """A step as it is written: times in seconds."""

    operator: str
    arguments: tuple[str, ...]
    at: str | None = None
    duration: str | None = None


@dataclass
class _PlanReader:
    domain: Domain
    names: Mapping[str, str]
    found: list[Step] = field(default_factory=list)
    is_timed: bool | None = None
    first_text: tuple[int, str] | None = None
    is_announced: bool = False
    in_log: bool = False
    last_number: int | None = None

    def line(self, number: int, line: str) -> None:
        if _NEW_PLAN.search(line):
            self.found.clear()
            self.is_timed = self.last_number = None
            self.is_announced = True
            self.in_log = _LOG.match(line) is not None
            return
        if _EMPTY_PLAN.search(line):
            self.is_announced = True
        content = _without_comment(line)
        if not content:
            return
        written = self._written(content)
        if written is not None:
            self.found += self._steps(written, number, line)
        elif _NO_ACTION.match(content):
            pass
        elif self._is_like_a_step(content):
            raise _refused("expected is one action a line, as 12.5: (drive kenny home office) [24]", number, line)
        else:
            self.first_text = self.first_text or (number, line)
            self.in_log = self.in_log and not _END_OF_LOG.search(content)

    def steps(self) -> list[Step]:
        if not self.found and self.first_text is not None and not self.is_announced:
            raise _refused(
                "there is no plan in this text; a plan has one action a line, as 12.5: (drive kenny home office) [24]",
                *self.first_text,
            )
        return in_order(self.found) if self.is_timed else self.found

    def _written(self, content: str) -> _Written | None:
        action = _ACTION.fullmatch(content)
        if action is not None:
            return _Written(action[2], tuple(action[3].split()), action[1], action[4])
        numbered = _NUMBERED.fullmatch(content)
        if numbered is not None:
            follows = self.last_number is not None and int(numbered[2]) == self.last_number + 1
            if numbered[1] or follows or self._is_operator(numbered[3]):
                self.last_number = int(numbered[2])
                return _Written(numbered[3], tuple(numbered[4].split()))
        costed = _COSTED.fullmatch(content)
        if costed is not None and (self.in_log or self._is_operator(costed[1])):
            return _Written(costed[1], tuple(costed[2].split()))
        return None

    def _is_like_a_step(self, content: str) -> bool:
        """Return whether a line that is not a step was meant to be one, and not text around the plan."""
        if _LIKE_A_STEP.match(content):
            return True
        number, colon, _ = content.partition(":")
        if colon and self.last_number is not None and number.strip() == str(self.last_number + 1):
            return True
        return self.in_log and self._is_operator(content.split(None, 1)[0])

    def _steps(self, written: _Written, number: int, line: str) -> Iterator[Step]:
        operator = self._meant(written.operator)
        if key(operator) == "reach-goal" and not self._is_operator(operator):
            return  # FF's own action, which brings about a goal that is not a conjunction
        at, duration = _time(written.at), _time(written.duration)
        if max(at or 0, duration or 0) >= TIME_LIMIT:
            raise _refused("a time in a plan is below 2**62 nanoseconds", number, line)
        action, arguments = self.domain.action(operator), tuple(map(self._meant, written.arguments))
        if self.is_timed is not None and self.is_timed != (at is not None):
            raise _refused("some actions of the plan have a time and others have none", number, line)
        self.is_timed = at is not None
        if action.durative and (at is None or duration is None):
            raise _refused(f"{action.name} takes time, and needs a time and a duration: 0: (...) [24]", number, line)
        if at is None:
            yield Step(Happening.APPLY, action.name, arguments)
        else:
            yield from timed_steps(action.name, arguments, at, duration if action.durative else None)

    def _meant(self, name: str) -> str:
        return self.names.get(key(name), name)

    def _is_operator(self, name: str) -> bool:
        return key(self._meant(name)) in self.domain.actions


def _without_comment(line: str) -> str:
    """Return the line up to its comment; a ``;`` between duration and cost in brackets does not begin one."""
    content, semicolon, rest = line.partition(";")
    if semicolon and content.rpartition("[")[2].lstrip()[:1] in ("D", "d") and "]" in rest:
        inside, bracket, after = rest.partition("]")
        content += semicolon + inside + bracket + after.partition(";")[0]
    return content.strip()


def _time(text: str | None) -> int | None:
    return None if text is None else nanoseconds(Fraction(text))


def _refused(problem: str, line: int, text: str) -> PddlSyntaxError:
    return PddlSyntaxError(problem, line=line, source="plan", text_line=text)
