"""The world after some transactions, and how it changes as time passes."""

from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from fractions import Fraction
from typing import TypeVar

from tests.oracle.items import (
    SECOND,
    Fact,
    Flow,
    Item,
    Limit,
    Number,
    Object,
    RefDomain,
    Start,
    Term,
    Timeline,
    Wanted,
    timeline,
)


class Unsettled(Exception):
    """The rules do not define the result of this transaction, so nothing can be expected of it."""


Mutable = TypeVar("Mutable", "Assertion", "Running")


def _twin(one: Mutable) -> Mutable:
    """A copy of one object, quicker than by the module `copy`."""
    twin = object.__new__(type(one))
    twin.__dict__.update(one.__dict__)
    return twin


@dataclass(eq=False)
class Assertion:
    """One assertion. `end` and its cause are None while nothing has ended it.

    `first_recorded` is the transaction that first recorded it, where this is a part that late knowledge has left.
    """

    timeline: Timeline
    item: Item
    start: int
    recorded: int
    end: int | None = None
    ended_by: int | None = None
    end_cause: str = ""
    cancelled_by: int | None = None
    superseded_by: int | None = None
    first_recorded: int = 0

    def __post_init__(self) -> None:
        self.first_recorded = self.first_recorded or self.recorded

    @property
    def counts(self) -> bool:
        """Whether it is part of what is known now about some time (rules V1, L8)."""
        return not self.cancelled_by and not self.superseded_by and self.end != self.start

    def holds_at(self, t: int) -> bool:
        """Whether it holds at t, a time that has come."""
        return self.counts and self.start <= t and (self.end is None or t < self.end)


@dataclass(eq=False)
class Running:
    """A durative action that runs, or ran until `ended`.

    `decided` are the effects decided at its start, `remembered` the facts that were true before it. `unwritten` are the
    at-start effects on sensed symbols. `pieces` are the rates that it had, each from a time on.
    """

    start: Start
    started: int
    decided: list[Fact]
    remembered: frozenset[Fact] = frozenset()
    unwritten: tuple[Fact, ...] = ()
    forced: frozenset[str] = frozenset()
    ended: int | None = None
    outcome: str = "running"
    pieces: tuple[tuple[int, dict[Term, float | None]], ...] = ()
    started_by: int = 0
    ended_by: int | None = None

    @property
    def expected_end(self) -> int:
        return self.started + self.start.duration

    def moved(self, term: Term, since: int, until: int) -> Fraction:
        """What the action adds to a function from one time to another (rules O3, O5); nothing without a rate."""
        last = until if self.ended is None else min(until, self.ended)
        ends = [start for start, _ in self.pieces[1:]] + [last]
        return sum(
            (
                Fraction(rates[term] or 0.0) * Fraction(max(0, min(end, last) - max(start, since)), SECOND)
                for (start, rates), end in zip(self.pieces, ends, strict=False)
                if term in rates
            ),
            Fraction(),
        )


@dataclass
class World:
    """What holds and what is scheduled; `assertions` has every assertion in the order of recording.

    `runs` are all runs, ended or not; `expecting` is whether time passes in a forecast. `totals` are the rates that
    runs add to functions, None where one is undefined.
    """

    assertions: list[Assertion] = field(default_factory=list)
    current: dict[Timeline, Assertion] = field(default_factory=dict)
    pending: dict[tuple[Timeline, int], Assertion] = field(default_factory=dict)
    runs: list[Running] = field(default_factory=list)
    domains: list[tuple[int, RefDomain | None]] = field(default_factory=lambda: [(0, None)])
    use_unknowns: bool = False
    expecting: bool = False
    totals: dict[Term, float | None] = field(default_factory=dict)

    def copy(self) -> "World":
        """An equal world, which may change without changing this one."""
        twins = {assertion: _twin(assertion) for assertion in self.assertions}
        return World(
            list(twins.values()),
            {line: twins[assertion] for line, assertion in self.current.items()},
            {key: twins[assertion] for key, assertion in self.pending.items()},
            [_twin(run) for run in self.runs],
            list(self.domains),
            self.use_unknowns,
            self.expecting,
            self.totals,
        )

    @property
    def domain(self) -> RefDomain | None:
        """The domain that was loaded last."""
        return self.domains[-1][1]

    @property
    def running(self) -> list[Running]:
        """The actions that run."""
        return [run for run in self.runs if run.ended is None]

    def value(self, number: Number, start: int, t: int) -> float:
        """The value at t of a function asserted at `start`, with the contributions of runs (rules C7, O3)."""
        term = number.name, number.arguments
        return number.at(start, t) + float(sum(run.moved(term, start, t) for run in self.runs))

    def exact(self, number: Number, start: int, t: int) -> Fraction:
        """The same, exactly."""
        own = Fraction(number.value) + Fraction(number.rate) * Fraction(t - start, SECOND)
        return own + sum(run.moved((number.name, number.arguments), start, t) for run in self.runs)

    def truth(self, wanted: Wanted, t: int, run: Running | None = None) -> bool | None:
        """Whether a condition is true at a time that has come, None where that is unknown (rules V2, V3, V5).

        As an over-all condition of a run, with its at-start effects on what is sensed (rule O8).
        """
        if isinstance(wanted, Limit):
            number = self._assertion_at(("state", "function", wanted.name, wanted.arguments), t)
            if number is None:
                return None
            assert isinstance(number.item, Number)
            return wanted.allows(self.exact(number.item, number.start, t))
        line = timeline("state", wanted)
        if run and any(
            assertion.timeline == line and assertion.counts and run.started < assertion.start <= t
            for assertion in self.assertions
        ):
            run = None
        signs = [fact.positive for fact in (run.unwritten if run else ()) if timeline("state", fact) == line]
        if signs:
            return any(signs) == wanted.positive
        assertion = self._assertion_at(line, t)
        if assertion is None:
            return None if self.use_unknowns else not wanted.positive
        return assertion.item == wanted

    def _assertion_at(self, line: Timeline, t: int) -> Assertion | None:
        return next(
            (assertion for assertion in self.assertions if assertion.timeline == line and assertion.holds_at(t)), None
        )

    # -- continuous effects (rule O5) -------------------------------------------------------------------------

    def active_flows(self, run: Running, t: int) -> list[Flow]:
        """The continuous effects of a run that act at a time, with its arguments substituted."""
        found = []
        for flow in run.start.action.flows:
            condition, at_start = (
                None if fact is None else run.start.facts([fact])[0] for fact in (flow.condition, flow.at_start)
            )
            if (at_start is None or at_start in run.remembered) and (condition is None or self._now_holds(condition)):
                found.append(self._grounded(flow, run))
        return found

    def _grounded(self, flow: Flow, run: Running) -> Flow:
        return replace(
            flow,
            term=run.start.ground_term(flow.term),
            factors=tuple((factor, run.start.ground_term(term)) for factor, term in flow.factors),
            divisor=flow.divisor and run.start.ground_term(flow.divisor),
        )

    def _now_holds(self, wanted: Fact) -> bool:
        assertion = self.current.get(timeline("state", wanted))
        if assertion is None:
            return not wanted.positive and not self.use_unknowns
        return assertion.item == wanted

    def _rate(self, flow: Flow, t: int) -> float | None:
        values = {}
        for name, arguments in flow.reads:
            assertion = self.current.get(("state", "function", name, arguments))
            if assertion is None:
                return None
            assert isinstance(assertion.item, Number)
            values[name, arguments] = self.value(assertion.item, assertion.start, t)
        rate = flow.rate + sum(factor * values[term] for factor, term in flow.factors)
        if flow.divisor is None:
            return rate
        return rate / values[flow.divisor] if values[flow.divisor] else None

    def lacks_a_number(self, flow: Flow, run: Running, t: int) -> bool:
        """Whether a continuous effect, were it to act, has no rate, or no number to move."""
        grounded = self._grounded(flow, run)
        return ("state", "function", *grounded.term) not in self.current or self._rate(grounded, t) is None

    def follow(self, t: int, fresh: Iterable[Term] = ()) -> None:
        """Let runs move numbers at the rates of now; without a rate a number becomes undefined, unless `fresh`.

        Sensed numbers are moved only in a forecast (rule O8).
        """
        sensed = self.domain.sensed if self.domain and not self.expecting else frozenset()
        before, self.totals = self.totals, {}
        for run in self.running:
            rates: dict[Term, float | None] = {}
            for flow in self.active_flows(run, t):
                if flow.term[0] not in sensed:
                    rate = self._rate(flow, t)
                    for sums in (rates, self.totals):
                        known = sums.get(flow.term, 0.0)
                        sums[flow.term] = None if known is None or rate is None else known + rate
            run.pieces = (*(piece for piece in run.pieces if piece[0] < t), (t, rates))
        for term, total in self.totals.items():
            assertion = self.current.get(("state", "function", *term))
            if total is None and before.get(term, 0.0) is not None and term not in set(fresh) and assertion:
                del self.current[assertion.timeline]
                assertion.end, assertion.end_cause = t, "run"

    def reads_what_moves(self, now: int) -> bool:
        """Whether a rate reads a number that moves, now or by the schedule."""
        if not any(flow.reads for run in self.running for flow in run.start.action.flows):
            return False
        ahead = self.copy()
        ahead.expecting = True
        for t in sorted({now, *(start for _, start in self.pending)}):
            ahead.advance(t)
            flows = [flow for run in ahead.running for flow in ahead.active_flows(run, t)]
            moving = {flow.term for flow in flows}
            for assertion in (*ahead.current.values(), *ahead.pending.values()):
                if isinstance(assertion.item, Number) and assertion.item.rate:
                    moving.add((assertion.item.name, assertion.item.arguments))
            if any(term in moving for flow in flows for term in flow.reads):
                return True
        return False

    def same(self, one: Item, one_start: int, other: Item, other_start: int, t: int) -> bool:
        """Whether two items of one timeline are equal at t (rule C2)."""
        if isinstance(one, Number) and isinstance(other, Number):
            values = self.value(one, one_start, t), self.value(other, other_start, t)
            return values[0] == values[1] and one.rate == other.rate
        return one == other

    def advance(self, t: int) -> None:
        """Let everything that is scheduled up to t take effect, in order of time."""
        for moment in sorted({start for _, start in self.pending if start <= t}):
            self._take_effect(moment)

    def _take_effect(self, moment: int) -> None:
        due = [assertion for (_, start), assertion in self.pending.items() if start == moment]
        for assertion in due:
            del self.pending[assertion.timeline, moment]
        for assertion in due:
            if self._ends_an_object(assertion):
                self._end_dependents(assertion)
        for assertion in due:
            before = self.current.get(assertion.timeline)
            if before:
                before.end, before.ended_by, before.end_cause = moment, assertion.recorded, "replaced"
            self.current[assertion.timeline] = assertion
        self.follow(
            moment, {assertion.timeline[2:] for assertion in due if assertion.timeline[:2] == ("state", "function")}
        )

    def _ends_an_object(self, assertion: Assertion) -> bool:
        before = self.current.get(assertion.timeline)
        return (
            isinstance(assertion.item, Object)
            and not assertion.item.positive
            and before is not None
            and isinstance(before.item, Object)
            and before.item.positive
        )

    def _end_dependents(self, ending: Assertion) -> None:
        assert isinstance(ending.item, Object)
        for assertion in [
            assertion for assertion in self.current.values() if ending.item.name in assertion.item.mentions
        ]:
            del self.current[assertion.timeline]
            assertion.end, assertion.ended_by, assertion.end_cause = ending.start, ending.recorded, "object"
        for run in self.running:
            if ending.item.name in run.start.arguments:
                if not self.expecting:
                    raise Unsettled("an object of what runs has ended by the clock")
                run.ended = ending.start
