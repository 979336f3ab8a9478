"""The results of questions: transactions, assertions, changes, differences, runs, explanations.

They are frozen dataclasses: a web framework can take them as response models, and `to_dict` returns plain data. Their
reprs are short, for a person who reads them in a REPL; some have a longer `str`.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field

from kbstore.clock import SECOND, TimeLike, isoformat
from kbstore.messages import Condition, Expression, Function, Goal, KnowledgeItem, Truth, format_number
from kbstore.model.html import table
from kbstore.model.pictures import Look, comparison
from kbstore.model.plain import Data, Result, times
from kbstore.names import bracketed


@dataclass(frozen=True, slots=True)
class Transaction(Result):
    """One atomic change: its number in the knowledge base, its time, who made it, and how many timelines changed."""

    number: int
    time: int
    client: str = ""
    note: str = ""
    changes: int = 0

    def __str__(self) -> str:
        who = f" by {self.client}" if self.client else ""
        why = f" ({self.note})" if self.note else ""
        return f"transaction {self.number} at {isoformat(self.time)}{who}{why}"

    def __repr__(self) -> str:
        who = f" by {self.client!r}" if self.client else ""
        why = f", {self.note!r}" if self.note else ""
        changes = _counted((self.changes, "change"))
        return f"{type(self).__name__}({self.number} at {isoformat(self.time)}{who}: {changes or 'no change'}{why})"


AsOf = TimeLike | Transaction
"""The values of `as_of`: a time, or a transaction, which includes everything up to it and nothing after it."""


@dataclass(frozen=True, slots=True)
class Assertion(Result):
    """One row of history: the item held from `initial_time` until `end_time` (None while open).

    `recorded`, `ended`, `cancelled` and `superseded` are the transactions that did so. An end by the clock (the next
    assertion, the end of an object), past or to come, has the transaction that scheduled it as `ended`. An assertion
    that late knowledge changed remains as it was, superseded; what is left of it is another assertion, with the
    transaction that first recorded it. `is_goal` distinguishes a goal from a part of the state.
    """

    item: KnowledgeItem | Condition
    initial_time: int
    end_time: int | None
    recorded: Transaction
    ended: Transaction | None = None
    cancelled: Transaction | None = None
    superseded: Transaction | None = None
    is_goal: bool = False

    def __str__(self) -> str:
        end = "" if self.end_time is None else isoformat(self.end_time)
        text = f"{self.item} [{isoformat(self.initial_time)}, {end})"
        return f"{text} cancelled" if self.cancelled else f"{text} superseded" if self.superseded else text

    def __repr__(self) -> str:
        end = "" if self.end_time is None else f", until={isoformat(self.end_time)!r}"
        marks = ", goal" if self.is_goal else ""
        marks += ", cancelled" if self.cancelled else ", superseded" if self.superseded else ""
        return f"Assertion({str(self.item)!r}, since={isoformat(self.initial_time)!r}{end}{marks})"

    def to_dict(self) -> Data:
        """Return the assertion as plain data: its item as PDDL and as a message, its times, its transactions."""
        found = Result.to_dict(self)
        return {**found.pop("item"), **found}


@dataclass(frozen=True, slots=True)
class Change(Result):
    """The changes of one transaction; or, from `watch`, what took effect by the clock alone at `time`.

    What late knowledge leaves of an assertion that it supersedes is asserted again: take away what is `superseded`, add
    what is `asserted`, and you have what is known. `broken` has the over-all conditions of runs that are broken from
    then on (rule O6); only `watch` without a pattern fills it. `domain` is the name of the domain that the transaction
    loaded or changed.
    """

    number: int
    transaction: Transaction
    asserted: list[Assertion] = field(default_factory=list)
    ended: list[Assertion] = field(default_factory=list)
    cancelled: list[Assertion] = field(default_factory=list)
    time: int = 0
    broken: list["Broken"] = field(default_factory=list)
    superseded: list[Assertion] = field(default_factory=list)
    domain: str | None = field(default=None, compare=False)

    @property
    def by_clock(self) -> bool:
        """Whether the change took effect by the clock alone, and not by a transaction."""
        return self.time != self.transaction.time

    def __repr__(self) -> str:
        parts = ("asserted", "ended", "cancelled", "superseded", "broken")
        counts = [f"{len(getattr(self, part))} {part}" for part in parts if getattr(self, part)]
        what = ", ".join(counts if self.domain is None else [f"domain {self.domain!r}", *counts])
        clock = " by the clock" if self.by_clock else ""
        return f"Change({self.number} at {isoformat(self.time)}{clock}: {what or 'nothing'})"

    def to_dict(self) -> Data:
        """Return the change as plain data."""
        return {"number": self.number, **times(time=self.time), "by_clock": self.by_clock, **Result.to_dict(self)}


_PARTS = ("became_true", "became_false", "withdrawn", "goals_added", "goals_removed")
"""The parts of a difference that are lists of items."""


@dataclass(frozen=True, slots=True)
class Diff(Result):
    """The difference between two times (rule Q5)."""

    became_true: list[KnowledgeItem] = field(default_factory=list)
    became_false: list[KnowledgeItem] = field(default_factory=list)
    withdrawn: list[KnowledgeItem] = field(default_factory=list)
    numbers: list[tuple[Function, float | None, float | None]] = field(default_factory=list)
    goals_added: list[Goal] = field(default_factory=list)
    goals_removed: list[Goal] = field(default_factory=list)
    metric: tuple[Expression | None, Expression | None] | None = None

    def __bool__(self) -> bool:
        return any(getattr(self, part) for part in (*_PARTS, "numbers", "metric"))

    def __str__(self) -> str:
        return "\n".join(self._lines()) or "no difference"

    def __repr__(self) -> str:
        parts = [
            f"{len(found)} {name.replace('_', ' ')}"
            for name in ("became_true", "became_false", "withdrawn", "numbers", "goals_added", "goals_removed")
            if (found := getattr(self, name))
        ]
        return f"Diff({', '.join([*parts, *(['metric'] if self.metric else [])]) or 'no difference'})"

    def _repr_html_(self) -> str:
        items = [(name.replace("_", " "), [(item,) for item in getattr(self, name)]) for name in _PARTS]
        numbers = [(f"{item.atom} {_number(before)} -> {_number(after)}",) for item, before, after in self.numbers]
        metric = [(f"{self.metric[0] or 'none'} -> {self.metric[1] or 'none'}",)] if self.metric else []
        return self._picture() + table(
            "difference" if self else "no difference", (), [*items, ("numbers", numbers), ("metric", metric)]
        )

    def _picture(self) -> str:
        rows = [
            (str(item), before, after)
            for items, before, after in (
                (self.became_true, "", Look.TRUE),
                (self.became_false, "", Look.FALSE),
                (self.withdrawn, Look.SUPERSEDED, ""),
                (self.goals_added, "", Look.WANTED),
                (self.goals_removed, Look.WANTED, ""),
            )
            for item in items
        ]
        return comparison(rows, [(item.atom, before, after) for item, before, after in self.numbers])

    def to_dict(self) -> Data:
        """Return the difference as plain data."""
        numbers = [{"function": item.atom, "before": before, "after": after} for item, before, after in self.numbers]
        return {**Result.to_dict(self), "numbers": numbers}

    def _lines(self) -> Iterator[str]:
        for sign, part in zip(("+", "!", "-", "+ goal", "- goal"), _PARTS, strict=True):
            yield from (f"{sign} {item}" for item in getattr(self, part))
        for function, before, after in self.numbers:
            yield f"~ {function.atom} {_number(before)} -> {_number(after)}"
        if self.metric:
            yield f"~ metric {self.metric[0] or 'none'} -> {self.metric[1] or 'none'}"


@dataclass(frozen=True, slots=True)
class Broken(Result):
    """An over-all condition of a run that was not true in ``[since, until)`` (rule O6); `until` None: it still is not.

    `truth` is false or unknown; it is also unknown where the condition could not be decided.
    """

    condition: str
    truth: Truth
    since: int
    until: int | None = None
    run: int = field(default=0, compare=False)
    """The number of the run."""

    def __str__(self) -> str:
        until = "" if self.until is None else f" until {isoformat(self.until)}"
        return f"{self.condition} is {self.truth} since {isoformat(self.since)}{until}"

    def __repr__(self) -> str:
        return f"Broken({str(self)!r})"


@dataclass(frozen=True, slots=True)
class Run(Result):
    """A durative action that runs, or ran.

    `started` and `duration` are in nanoseconds; `duration_s` is the exact duration in seconds, which `duration` rounds
    (None: `duration` is exact). `forced` has the conditions that ``force=True`` overruled (rule O7).

    `KnowledgeBase.runs` also fills: when it `ended` (None while it runs), its `outcome` ("running", "ended" or
    "aborted"), the numbers of the transactions that started and ended it, and which invariants were `broken` when.
    """

    operator: str
    arguments: tuple[str, ...]
    started: int
    duration: int
    number: int = 0
    duration_s: float | None = None
    forced: tuple[str, ...] = ()
    ended: int | None = field(default=None, compare=False)
    outcome: str = field(default="running", compare=False)
    started_by: int = field(default=0, compare=False)
    ended_by: int | None = field(default=None, compare=False)
    broken: tuple[Broken, ...] = field(default=(), compare=False)

    @property
    def action(self) -> str:
        """The action in PDDL: ``(goto_waypoint kenny wp0 wp7)``."""
        return bracketed(self.operator, *self.arguments)

    @property
    def seconds(self) -> float:
        """The value of ``?duration``, in seconds."""
        return self.duration / SECOND if self.duration_s is None else self.duration_s

    @property
    def expected_end(self) -> int:
        """The time at which its end is expected, in nanoseconds."""
        return self.started + self.duration

    def __str__(self) -> str:
        return f"{self.action} since {isoformat(self.started)} for {format_number(self.duration / SECOND)} s"

    def __repr__(self) -> str:
        return f"Run({self.action!r}, started={isoformat(self.started)!r}, {format_number(self.seconds)} s)"

    def to_dict(self) -> Data:
        """Return the run as plain data."""
        found = Result.to_dict(self)
        duration = found.pop("duration")
        return {**found, "duration_ns": duration, **times(expected_end=self.expected_end, ended=self.ended)}


@dataclass(frozen=True, slots=True)
class QueryResult(Result):
    """The answer to a query, in the form of ROSPlan's: one bool for each item, and the items that are not true."""

    all_true: bool
    results: list[bool]
    false_knowledge: list[KnowledgeItem | Condition]

    def __bool__(self) -> bool:
        return self.all_true


@dataclass(frozen=True, slots=True)
class FailingCondition(Result):
    """A condition of an operator that does not hold, and since when.

    `since` is the time from which it has had its `truth`, false or unknown, without interruption. It is None if the
    condition never had another truth, if it depends on ``?duration``, or if that time is before the history in the
    store. The condition of an effect that needs a number without a value is the function; it `is_undefined`.
    """

    condition: str
    since: int | None
    truth: Truth
    is_undefined: bool = False

    @property
    def verdict(self) -> str:
        """What the condition is: false, unknown or undefined."""
        return "undefined" if self.is_undefined else str(self.truth)

    def __str__(self) -> str:
        since = "" if self.since is None else f" since {isoformat(self.since)}"
        return f"{self.condition} is {self.verdict}{since}"

    def __repr__(self) -> str:
        return f"FailingCondition({str(self)!r})"


@dataclass(frozen=True, slots=True)
class Applicability(Result):
    """Whether an operator can be applied, as its own truth value, and the conditions that fail."""

    failing: list[FailingCondition]

    def __bool__(self) -> bool:
        return not self.failing

    def __repr__(self) -> str:
        return f"Applicability({'applicable' if self else ', '.join(map(str, self.failing))})"

    def to_dict(self) -> Data:
        """Return the answer as plain data."""
        return {"applicable": bool(self), **Result.to_dict(self)}


@dataclass(frozen=True, slots=True, repr=False)
class Ended(Transaction):
    """The transaction that ended a durative action, with the at-end conditions that failed (rule O3).

    `broken` has the over-all conditions that were not true while it ran (rule O6).
    """

    failing: list[FailingCondition] = field(default_factory=list)
    broken: list[Broken] = field(default_factory=list)


@dataclass(frozen=True, slots=True)
class Explanation(Result):
    """Why a fact or a condition is true, false or unknown.

    `reason` is one of: asserted, explicitly false, never told, removed, expired with its instance, undefined function,
    expected at the end of an action that runs; for a condition, it sums up the deciding `parts`. `transaction` made it
    so, at `since`. If it is only expected, `transaction` started the action.
    """

    subject: str
    truth: Truth
    reason: str
    since: int | None = None
    transaction: Transaction | None = None
    parts: tuple["Explanation", ...] = ()

    def __str__(self) -> str:
        undefined = self.truth is not Truth.TRUE and self.reason.startswith("undefined function: ")
        text = f"{self.subject} is {self.reason if undefined else f'{self.truth}: {self.reason}'}"
        if self.since is not None:
            text += f" since {isoformat(self.since)}"
        if self.transaction is not None:
            text += f", {self.transaction}"
        return "\n  ".join((text, *("\n  ".join(str(part).split("\n")) for part in self.parts)))

    def __repr__(self) -> str:
        return f"Explanation({str(self).partition(chr(10))[0]!r})"


def _number(value: float | None) -> str:
    return "undefined" if value is None else format_number(value)


def _counted(*counts: tuple[int, str]) -> str:
    """List counts with their nouns, without those that are 0."""
    return ", ".join(f"{number} {noun}" + ("" if number == 1 else "s") for number, noun in counts if number)
