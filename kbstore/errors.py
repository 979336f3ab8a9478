"""Everything that kbstore raises, under one root.

Each error also inherits the builtin that it resembles, so that a caller who knows only Python catches it, too.
A message says what was wrong, in PDDL, what was expected, and what to do.
"""

import re
from collections.abc import Sequence
from pathlib import Path

_CONTROL = re.compile(r"[\x00-\x08\x0b-\x1f\x7f-\x9f\u200b-\u200f\u2028-\u202e\u2060-\u206f\ufeff\ud800-\udfff]")
"""Characters that a terminal or a log obeys instead of showing them; tabs are shown."""

_BREAK = re.compile(r"\n(?!  )")
"""A line break that is not a message's own: what follows those is indented."""


class KbStoreError(Exception):
    """The root of all errors of kbstore. Messages show control characters of what they quote as escapes."""

    def __init__(self, *args: object) -> None:
        super().__init__(*(_escaped(part) if isinstance(part, str) else part for part in args))


class InvalidKnowledge(KbStoreError, ValueError):
    """Knowledge or a question does not fit the domain, the objects, or the shape of knowledge.

    ``violations`` has one sentence for each thing that is wrong; nothing of the transaction has been stored.
    """

    def __init__(self, *violations: str) -> None:
        self.violations: tuple[str, ...] = tuple(_escaped(_shortened(violation)) for violation in violations)
        super().__init__(_listed(self.violations))


class InvalidTime(KbStoreError, ValueError):
    """A value that cannot be read as a time or a duration."""


class PddlSyntaxError(KbStoreError, ValueError):
    """PDDL text that cannot be read; ``line`` and ``column`` count from 1, ``source`` is the file, if any.

    Where a file cannot be read at all, ``line`` is 0.
    """

    def __init__(
        self,
        problem: str,
        line: int = 1,
        column: int = 1,
        source: str | Path | None = None,
        text_line: str = "",
    ) -> None:
        self.problem = problem
        self.line = line
        self.column = column
        self.source = source
        place = f"{source}:{line}:{column}: " if source else f"line {line}, column {column}: " if line else ""
        super().__init__(f"{place}{problem}" + (_quoted(text_line, column) if text_line else ""))


class UnknownSymbol(KbStoreError, LookupError):
    """A predicate, function, type or operator that the domain does not know."""


class UndefinedFunction(KbStoreError, LookupError):
    """A numeric function was read that has no value at that time."""


class DivisionByZero(KbStoreError, ZeroDivisionError):
    """An expression divides by zero."""


class NotLinear(KbStoreError, ArithmeticError):
    """A comparison whose expression is not linear in time within the span asked for, so that `when` cannot solve it."""


class NotApplicable(KbStoreError, RuntimeError):
    """An operator was applied, started or ended where it cannot be; the message lists the conditions that fail."""


class ScheduledRelativeChange(KbStoreError, ValueError):
    """A change relative to a value (increase, scale-up, a rate) was given a time in the future."""


class ClockWentBackwards(KbStoreError, RuntimeError):
    """The clock is further behind the latest recorded time than the tolerance allows; nothing has been stored."""


class ClockJumped(KbStoreError, RuntimeError):
    """The system clock has advanced by more than the machine measured; nothing has been stored (rule T6)."""


class Conflict(KbStoreError, RuntimeError):
    """A transaction was committed after the one that the caller expected to be the latest."""


class HistoryUnavailable(KbStoreError, LookupError):
    """The question needs history that has been archived away."""


class SchemaOutOfDate(KbStoreError, RuntimeError):
    """The database's schema is older than this kbstore; the message names the command that upgrades it."""


class SchemaTooNew(KbStoreError, RuntimeError):
    """The database's schema is newer than this kbstore."""


class SchemaUnknown(KbStoreError, RuntimeError):
    """The database has a schema that is not kbstore's."""


class StoreWentBack(KbStoreError, RuntimeError):
    """The store is at an earlier transaction than before, or at another one of that number.

    A backup was restored, or a standby took over that did not have everything. Whoever had transactions acknowledged
    that are lost gets it once; the next question or transaction takes the store as it is.
    """


class StoreUnavailable(KbStoreError, ConnectionError):
    """The database cannot be reached, is locked by others, is full, or has been closed."""


class MissingLibrary(KbStoreError, ImportError):
    """A library that an optional part of kbstore needs is not installed."""


def _escaped(text: str) -> str:
    """The text with its control characters as Python writes them."""
    return _BREAK.sub(r"\\n", _CONTROL.sub(lambda found: repr(found.group())[1:-1], text))


def one_line(text: str) -> str:
    """Return a text with its control characters and line breaks as Python writes them."""
    return text if text.isprintable() else _escaped(text).replace("\n", r"\n")


def _listed(violations: Sequence[str]) -> str:
    if len(violations) == 1:
        return violations[0]
    return f"{len(violations)} violations:\n" + "\n".join(f"  - {violation}" for violation in violations)


def _shortened(sentence: str, length: int = 800) -> str:
    """A sentence about a very long text, without the middle of it."""
    if len(sentence) <= length:
        return sentence
    return f"{sentence[: length // 2]} ... {sentence[-length // 2 :]}"


def _quoted(text_line: str, column: int, width: int = 100) -> str:
    """The offending line with a mark under the column; of a very long line, the part around the column."""
    start = max(0, column - 1 - width // 2)
    shown = text_line[start : start + width].replace("\t", " ")
    return f"\n  {shown}\n  {' ' * (column - 1 - start)}^"
