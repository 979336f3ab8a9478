"""One transaction: its updates in their order, applied to a copy of the world."""

from collections.abc import Iterable, Iterator
from dataclasses import replace
from itertools import pairwise
from typing import TypeVar

from tests.oracle.corrections import Refused, Update, expected_ends
from tests.oracle.items import (
    SECOND,
    Comparison,
    Condition,
    Fact,
    Item,
    Metric,
    Number,
    Object,
    RefDomain,
    Start,
    Term,
    Wanted,
    timeline,
)
from tests.oracle.updating import Updating
from tests.oracle.world import Running, Unsettled, World

Effect = TypeVar("Effect", Fact, Number)


class Overlay(Updating):
    """The world with the updates made so far; `finish` records them."""

    def __init__(self, world: World, now: int) -> None:
        super().__init__(world, now)
        self.first_error = ""
        self.completed: list[Running] = []

    # -- updates ----------------------------------------------------------------------------------------------

    def apply(self, update: Update) -> None:
        """Make one update; its violations and failures are collected, so that all are found."""
        self._apply(update)
        if not self.first_error and self.violations:
            self.first_error = "InvalidKnowledge"
        elif not self.first_error and self.failures:
            self.first_error = self.failures[0].error

    def _apply(self, update: Update) -> None:
        at = update.at if update.at > self.now else self.now
        if update.since is not None or update.until is not None:
            wrong = self.wrong_span(update, at)
            if wrong:
                self.failures.append(Refused("InvalidTime", wrong))
                return
            assert update.since is not None
            assert not isinstance(update.item, RefDomain | Start | None)
            if update.since < self.now:
                role = "goal" if update.what.endswith("goal") else "state"
                late = self.add_late if update.what.startswith("add") else self.remove_late
                late(role, update.item, update.since, update.until)
                return
        match update.what, update.item:
            case "clear", None:
                self.causes.update(dict.fromkeys(self.current, "cleared"))
                self.current.clear()
                self.pending.clear()
                self.running = []
            case "replace", None:
                self._replace(update.items)
            case "domain", RefDomain() as domain:
                self._load(domain)
            case "start", Start() as start:
                self._start(start)
            case (("end" | "abort"), Start() as start):
                self._stop(start, with_effects=update.what == "end")
            case (("add" | "add_metric"), (Object() | Fact() | Number() | Metric() | Comparison()) as item):
                self._add("state", item, at)
            case "add_goal", (Fact() | Comparison() | Condition()) as item:
                self._add("goal", item, at)
            case (("remove" | "remove_metric"), (Object() | Fact() | Number() | Metric() | Comparison()) as item):
                self._remove("state", item, at)
            case "remove_goal", (Fact() | Comparison() | Condition()) as item:
                self._remove("goal", item, at)
            case _:
                raise AssertionError(update)

    # -- running actions (rules O1 to O3) ---------------------------------------------------------------------

    def _start(self, start: Start) -> None:
        for argument, wanted in zip(start.arguments, start.action.types, strict=True):
            found = self.type_at(argument, self.now)
            assert self.domain
            if found is None or not self.domain.is_a(found, wanted):
                self.violations.append(f"{argument} is {found}, not {wanted}")
                return
        again = any((run.start.action, run.start.arguments) == (start.action, start.arguments) for run in self.running)
        against = [bound for bound in start.action.bounds if not self._allows(start, *bound)]
        if again or (against and not start.force) or not all(map(self._holds, start.facts(start.action.needs))):
            self.failures.append(Refused("NotApplicable", str(start)))
            return
        then = self._with_start(start)
        run = then.runs[-1]
        if not all(then.truth(wanted, self.now, run) for wanted in start.facts(start.action.invariants)):
            self.failures.append(Refused("NotApplicable", str(start)))
            return
        if any(then.lacks_a_number(flow, run, self.now) for flow in start.action.flows):
            raise Unsettled("a continuous effect on an undefined function, or at a rate that is undefined at once")
        if then.reads_what_moves(self.now):
            self.failures.append(Refused("NotLinear", str(start)))
            return
        forced = frozenset({*against, *self.expected_breaks(then, run)})
        if forced and not start.force:
            self.failures.append(Refused("NotApplicable", f"{start}: {forced}"))
            return
        self._begin(start, forced)

    def _begin(self, start: Start, forced: frozenset[object] = frozenset()) -> None:
        """Start an applicable action: its effects are decided before its at-start effects happen."""
        premises = {fact for fact, _ in start.action.decided_at_start}
        premises |= {flow.at_start for flow in start.action.flows if flow.at_start}
        remembered = frozenset(fact for fact in start.facts(premises) if self._holds(fact))
        decided = [
            effect
            for pair in start.action.decided_at_start
            for condition, effect in [start.facts(pair)]
            if condition in remembered
        ]
        at_start = start.facts(start.action.at_start)
        run = Running(start, self.now, decided, remembered, tuple(self._sensed(at_start)), forced)
        self._affect(at_start, start.facts(start.action.numbers_at_start))
        self.running = [*self.running, run]

    def _with_start(self, start: Start) -> World:
        """The world after a transaction that only starts an action."""
        draft = Overlay(self.world.copy(), self.now)
        draft._begin(start)
        draft.finish(0)
        return draft.world

    def expected_breaks(self, world: World, run: Running) -> list[Wanted]:
        """The invariants of a run that are expected not to be true somewhere before its expected end (rule O6).

        Between two changes numbers move steadily, and a limit that is kept at both ends is kept throughout.
        """
        end = run.expected_end
        times = {start for _, start in world.pending} | {other.expected_end for other in world.running}
        changes = sorted({self.now, end, *(t for t in times if self.now < t < end)})
        broken = []
        for wanted in run.start.facts(run.start.action.invariants):
            for first, following in pairwise(changes):
                for t in (first, following - 1):
                    then = world.copy()
                    expect(then, t, self.now)
                    same = next(other for other in then.runs if (other.start, other.started) == (run.start, self.now))
                    if not then.truth(wanted, t, same) and wanted not in broken:
                        broken.append(wanted)
        return broken

    def _allows(self, start: Start, comparison: str, bound: float | Term) -> bool:
        """Whether a bound allows a duration, to a nanosecond (rule O7); one that is undefined does not."""
        if isinstance(bound, tuple):
            name, places = bound
            current = self.current.get(timeline("state", Number(name, start.ground(places))))
            if current is None:
                return False
            assert isinstance(current[0], Number)
            bound = self.world.value(*current, self.now)
        over = start.duration - bound * SECOND
        return (comparison == ">=" or over <= 1) and (comparison == "<=" or over >= -1)

    def _stop(self, start: Start, with_effects: bool) -> None:
        found = [run for run in self.running if run.start == start]
        if not found:
            self.failures.append(Refused("NotApplicable", str(start)))
            return
        self.running = [run for run in self.running if run not in found]
        if with_effects:
            self.completed += found
            numbers = [replace(n, arguments=start.ground(n.arguments)) for n in start.action.numbers_at_end]
            decided = [effect for run in found for effect in run.decided]
            before = len(self.failures)
            self._affect([*start.facts(start.action.at_end), *decided], numbers)
            if len(self.failures) > before:
                # an effect changes a number that is not defined any more (rule O3)
                self.failures[before:] = [Refused("NotApplicable", str(start))]

    def _sensed(self, items: Iterable[Effect]) -> Iterator[Effect]:
        """The effects that are left to sensors (rule O8)."""
        return (item for item in items if self.domain and item.name in self.domain.sensed)

    def _affect(self, facts: list[Fact], numbers: list[Number]) -> None:
        """Deletes come before adds, then the numeric assignments (rule O2). What is sensed is expected only (O8)."""
        if not self.world.expecting:
            left = {*self._sensed(facts), *self._sensed(numbers)}
            facts, numbers = ([item for item in items if item not in left] for items in (facts, numbers))
        for fact in facts:
            if not fact.positive and self.world.use_unknowns:
                self._add("state", fact, self.now)
            elif not fact.positive:
                self._remove("state", replace(fact, positive=True), self.now)
        added: list[Item] = [*(fact for fact in facts if fact.positive), *numbers]
        for item in added:
            self._add("state", item, self.now)

    def _holds(self, wanted: Fact) -> bool:
        current = self.current.get(timeline("state", wanted))
        if current is None:
            return not wanted.positive and not self.world.use_unknowns
        return current[0] == wanted

    def _load(self, domain: RefDomain) -> None:
        """Check that all current and scheduled items are valid under the new domain (rule D4)."""
        self.domain = domain
        entries = [(line, item, self.now) for line, (item, _) in self.current.items()]
        scheduled = [(line, item, at) for (line, at), item in self.pending.items()]
        for _, item, at in entries + scheduled:
            if not isinstance(item, Object):
                self.violations += self.violations_of(item, at)
            elif item.positive and item.name in domain.constants:
                if at > self.now:
                    raise Unsettled("a constant has the name of an object that is only scheduled")
                self.violations.append(f"{item.name} is an object, and a constant of {domain.name}")
            elif not domain.knows_type(item.type):
                self.violations.append(f"no type {item.type}")

    # -- the end of the transaction ---------------------------------------------------------------------------

    def refuse(self) -> None:
        """Raise the violations of the transaction, else its first failure (rule D1)."""
        if self.violations:
            raise Refused("InvalidKnowledge", "; ".join(self.violations), self.first_error)
        if self.failures:
            raise self.failures[0]

    def finish(self, number: int) -> int:
        """Record the changes; return the number of changed timelines.

        Another domain counts as one more, and so do the runs.
        """
        world = self.world
        expected = expected_ends(world) if self.edited else {}
        changed = {line for line in self.edited if self.finish_edited(line, number, expected)}
        for line in dict.fromkeys([*world.current, *self.current]):
            before, after = world.current.get(line), self.current.get(line)
            if before and after and world.same(before.item, before.start, *after, self.now):
                continue
            changed.add(line)
            if before:
                before.end, before.ended_by = self.now, number
                before.end_cause = "replaced" if after else self.causes[line]
                del world.current[line]
            if after:
                world.current[line] = self.record(line, after[0], self.now, number)
        for line, at in dict.fromkeys([*world.pending, *self.pending]):
            scheduled, wanted = world.pending.get((line, at)), self.pending.get((line, at))
            if scheduled and wanted and world.same(scheduled.item, at, wanted, at, at):
                continue
            changed.add(line)
            if scheduled:
                scheduled.cancelled_by = number
                del world.pending[line, at]
            if wanted:
                world.pending[line, at] = self.record(line, wanted, at, number)
        running = world.running
        for run in running:
            if run not in self.running:
                run.ended, run.ended_by = self.now, number
                run.outcome = "ended" if run in self.completed else "aborted"
        begun = [run for run in self.running if run not in running]
        for run in begun:
            run.started_by = number
        world.runs += begun
        reloaded = self.domain != world.domain
        if reloaded:
            world.domains.append((self.now, self.domain))
        fresh = {
            line[2:]
            for line, assertion in world.current.items()
            if line[1] == "function" and assertion.recorded == number
        }
        world.follow(self.now, fresh)
        return len(changed) + reloaded + (running != self.running)


def expect(world: World, at: int, asked: int) -> None:
    """Let time pass until `at`, with the ends of runs that are expected after the time of asking."""
    world.advance(min(at, asked))
    world.expecting = True
    if at <= asked:
        return
    known = dict(world.totals)
    world.follow(asked, {line[2:] for line in world.current if line[1] == "function"})
    if any(rate is None and term not in known for term, rate in world.totals.items()):
        raise Unsettled("what is sensed is expected to move at a rate that is undefined")
    while True:
        ends = [run for run in world.running if asked < run.expected_end <= at]
        if not ends:
            break
        moment = min(run.expected_end for run in ends)
        if any(start == moment for _, start in world.pending):
            raise Unsettled("something is scheduled for the very time of an expected end")
        world.advance(moment)
        due = [run for run in ends if run.expected_end == moment and run.ended is None]
        if len(due) > 1:
            raise Unsettled("two actions are expected to end at one time")
        for run in due:
            overlay = Overlay(world, moment)
            overlay.apply(Update("end", run.start))
            if overlay.violations or overlay.failures:
                raise Unsettled("an expected end whose effects are impossible")
            overlay.finish(0)
        asked = moment
    world.advance(at)
