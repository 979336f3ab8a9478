"""One transaction: its updates in their order, on top of what is believed."""

import math
from dataclasses import replace

from tests.oracle.corrections import Corrections, Refused, Update, expected_ends
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
    Timeline,
    matches,
    timeline,
)
from tests.oracle.late import FOREVER, Spans, minus
from tests.oracle.world import Running, Unsettled, World


class Overlay(Corrections):
    """What would be believed with the updates made so far; `finish` makes it so."""

    def __init__(self, world: World, now: int) -> None:
        super().__init__(world, now)
        self.first_error = ""

    # -- updates ----------------------------------------------------------------------------------------------

    def apply(self, update: Update) -> None:
        """Make one update; what is wrong with it is remembered, so that all violations are found."""
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
                self.causes.update(dict.fromkeys(self.standing, "cleared"))
                self.standing.clear()
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

    def _add(self, role: str, item: Item, at: int) -> None:
        if isinstance(item, Object) and not item.positive and at == self.now:
            self._remove(role, replace(item, positive=True), at)
            return
        found = list(self.violations_of(item, at))
        if found:
            self.violations += found
            return
        if isinstance(item, Object) and not item.positive and self.type_at(item.name, at - 1) not in (None, item.type):
            return  # as in a removal, the type must match, or nothing changes (rules C4, C9)
        if isinstance(item, Number) and item.operation != "assign":
            if at > self.now:
                self.failures.append(Refused("ScheduledRelativeChange", str(item)))
                return
            changed = self._changed_number(role, item)
            if changed is None:
                return
            item = changed
        self._put(timeline(role, item), item, at)

    def _replace(self, items: tuple[Item, ...]) -> None:
        """What stands and is not among the items goes, objects first, and then the items are added (rule C13)."""
        kept = {timeline("state", item) for item in items if not (isinstance(item, Object) and not item.positive)}
        for kind in ("object", "fact", "function", "inequality"):
            for line, (item, _) in list(self.standing.items()):
                asserted = not isinstance(item, Object) or item.positive
                if line[:2] == ("state", kind) and asserted and line not in kept and line in self.standing:
                    self._put(line, None, self.now)
        for item in items:
            if isinstance(item, Metric) or (isinstance(item, Number) and item.operation != "assign"):
                self.violations.append(f"{item} is not what a state asserts")
            else:
                self._add("state", item, self.now)

    def _changed_number(self, role: str, item: Number) -> Number | None:
        standing = self.standing.get(timeline(role, item))
        if standing is None:
            self.failures.append(Refused("UndefinedFunction", str(item)))
            return None
        number, start = standing
        assert isinstance(number, Number)
        value, rate, amount = self.world.value(number, start, self.now), number.rate, item.value
        match item.operation:
            case "increase":
                value += amount
            case "decrease":
                value -= amount
            case "scale_up":
                value *= amount
            case "scale_down":
                if amount == 0:
                    self.failures.append(Refused("DivisionByZero", str(item)))
                    return None
                value /= amount
            case "assign_cts":
                rate = amount
        if not math.isfinite(value):
            self.violations.append(f"{item} overflows")
            return None
        return Number(item.name, item.arguments, value, rate)

    def _put(self, line: Timeline, item: Item | None, at: int, cause: str = "removed") -> None:
        """Let a timeline say something, or nothing, from now or from a scheduled time on."""
        before = self.lifetimes(line[2]) if line[1] == "object" else []
        if at > self.now:
            if item is None:
                self.pending.pop((line, at), None)
            else:
                self.pending[line, at] = item
        elif item is None:
            self.standing.pop(line, None)
            self.causes[line] = cause
        elif not (line in self.standing and self.world.same(*self.standing[line], item, at, at)):
            last = self.past.get(line, [])[-1:]
            again = last and last[0].end == at and self.world.same(last[0].item, last[0].start, item, at, at)
            self.standing[line] = (last[0].item, last[0].start) if again else (item, at)
        if line[1] == "object":
            self._lose(str(line[2]), minus(before, self.lifetimes(line[2])))

    def _lose(self, name: str, lost: Spans) -> None:
        """An object does not exist in these spans any more: nothing speaks of it until its next start (rule C9)."""
        starts = sorted(start for start, _ in self.lifetimes(name))
        for first, _ in lost:
            next_start = min((start for start in starts if start > first), default=FOREVER)
            if first == self.now:
                for line in [line for line, (item, _) in self.standing.items() if name in item.mentions]:
                    del self.standing[line]
                    self.causes[line] = "object"
                self.running = [run for run in self.running if name not in run.start.arguments]
            for line, at in [key for key, item in self.pending.items() if name in item.mentions]:
                if first <= at < next_start:
                    del self.pending[line, at]

    def _remove(self, role: str, pattern: Item, at: int) -> None:
        found = list(self.pattern_violations_of(pattern))
        if found:
            self.violations += found
            return
        kind = (role, pattern.kind)
        if at > self.now:
            matched = [key for key, item in self.pending.items() if key[0][:2] == kind and matches(pattern, item)]
            for line, start in matched:
                if start == at:
                    self._cancel(line, start)
            return
        for line in [line for line, (item, _) in self.standing.items() if line[:2] == kind and matches(pattern, item)]:
            self._put(line, None, self.now)

    def _cancel(self, line: Timeline, at: int) -> None:
        kept = self.pending[line, at]
        self._put(line, None, at)
        if line[1] == "object" and self.types_meet(str(line[2])):
            self.violations.append(f"cancelling {kept} lets two types meet")

    # -- running actions (rules O1 to O3) ---------------------------------------------------------------------

    def _start(self, start: Start) -> None:
        for argument, wanted in zip(start.arguments, start.action.types, strict=True):
            found = self.type_at(argument, self.now)
            assert self.domain
            if found is None or not self.domain.is_a(found, wanted):
                self.violations.append(f"{argument} is {found}, not {wanted}")
                return
        again = any((run.start.action, run.start.arguments) == (start.action, start.arguments) for run in self.running)
        allowed = start.force or all(self._allows(start, *bound) for bound in start.action.bounds)
        if again or not allowed or not all(map(self._holds, start.facts(start.action.needs))):
            self.failures.append(Refused("NotApplicable", str(start)))
            return
        if any(
            timeline("state", Number(name, start.ground(places))) not in self.standing
            for (name, places), _ in start.action.rates
        ):
            raise Unsettled("a continuous effect on an undefined function")
        decided = [
            effect
            for pair in start.action.decided_at_start
            for condition, effect in [start.facts(pair)]
            if self._holds(condition)
        ]
        self._affect(start.facts(start.action.at_start), [])
        if not all(map(self._holds, start.facts(start.action.invariants))):
            self.failures.append(Refused("NotApplicable", str(start)))
            return
        self.running = [*self.running, Running(start, self.now, decided)]

    def _allows(self, start: Start, comparison: str, bound: float | Term) -> bool:
        """Whether a bound allows a duration, to a nanosecond (rule O7); one that is undefined does not."""
        if isinstance(bound, tuple):
            name, places = bound
            standing = self.standing.get(timeline("state", Number(name, start.ground(places))))
            if standing is None:
                return False
            assert isinstance(standing[0], Number)
            bound = self.world.value(*standing, self.now)
        over = start.duration - bound * SECOND
        return (comparison == ">=" or over <= 1) and (comparison == "<=" or over >= -1)

    def _stop(self, start: Start, with_effects: bool) -> None:
        found = [run for run in self.running if run.start == start]
        if not found:
            self.failures.append(Refused("NotApplicable", str(start)))
            return
        self.running = [run for run in self.running if run not in found]
        if with_effects:
            numbers = [replace(n, arguments=start.ground(n.arguments)) for n in start.action.numbers_at_end]
            decided = [effect for run in found for effect in run.decided]
            self._affect([*start.facts(start.action.at_end), *decided], numbers)

    def _affect(self, facts: list[Fact], numbers: list[Number]) -> None:
        """Deletes come before adds, then the numeric assignments (rule O2)."""
        for fact in facts:
            if not fact.positive and self.world.use_unknowns:
                self._add("state", fact, self.now)
            elif not fact.positive:
                self._remove("state", replace(fact, positive=True), self.now)
        added: list[Item] = [*(fact for fact in facts if fact.positive), *numbers]
        for item in added:
            self._add("state", item, self.now)

    def _holds(self, wanted: Fact) -> bool:
        standing = self.standing.get(timeline("state", wanted))
        if standing is None:
            return not wanted.positive and not self.world.use_unknowns
        return standing[0] == wanted

    def _load(self, domain: RefDomain) -> None:
        """Everything that stands or is scheduled must be valid under the new domain (rule D4)."""
        self.domain = domain
        entries = [(line, item, self.now) for line, (item, _) in self.standing.items()]
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
        """Raise what is wrong with the transaction, if anything is (rule D1: violations come first)."""
        if self.violations:
            raise Refused("InvalidKnowledge", "; ".join(self.violations), self.first_error)
        if self.failures:
            raise self.failures[0]

    def finish(self, number: int) -> int:
        """Record what has changed; returns how many timelines that are.

        Another domain counts as one more, and so does what runs.
        """
        world = self.world
        expected = expected_ends(world) if self.edited else {}
        changed = {line for line in self.edited if self.finish_edited(line, number, expected)}
        for line in dict.fromkeys([*world.standing, *self.standing]):
            before, after = world.standing.get(line), self.standing.get(line)
            if before and after and world.same(before.item, before.start, *after, self.now):
                continue
            changed.add(line)
            if before:
                before.end, before.ended_by = self.now, number
                before.end_cause = "replaced" if after else self.causes[line]
                del world.standing[line]
            if after:
                world.standing[line] = self.record(line, after[0], self.now, number)
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
                run.ended = self.now
        world.runs += [run for run in self.running if run not in running]
        reloaded = self.domain != world.domain
        if reloaded:
            world.domains.append((self.now, self.domain))
        return len(changed) + reloaded + (running != self.running)
