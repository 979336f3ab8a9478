"""Adding and removing knowledge in a transaction, now or scheduled (rules C1 to C13)."""

import math
from dataclasses import replace

from tests.oracle.corrections import Corrections, Refused
from tests.oracle.items import Item, Metric, Number, Object, Timeline, matches, timeline
from tests.oracle.late import FOREVER, Spans, minus


class Updating(Corrections):
    """A draft to which items are added, and from which they are removed."""

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
        """Remove the current items that are not given, objects first, and then add those given (rule C13)."""
        kept = {timeline("state", item) for item in items if not (isinstance(item, Object) and not item.positive)}
        for kind in ("object", "fact", "function", "inequality"):
            for line, (item, _) in list(self.current.items()):
                asserted = not isinstance(item, Object) or item.positive
                if line[:2] == ("state", kind) and asserted and line not in kept and line in self.current:
                    self._put(line, None, self.now)
        for item in items:
            if isinstance(item, Metric) or (isinstance(item, Number) and item.operation != "assign"):
                self.violations.append(f"{item} is not what a state asserts")
            else:
                self._add("state", item, self.now)

    def _changed_number(self, role: str, item: Number) -> Number | None:
        current = self.current.get(timeline(role, item))
        if current is None:
            self.failures.append(Refused("UndefinedFunction", str(item)))
            return None
        number, start = current
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
        """Assert or end an item on a timeline, from now or from a scheduled time on."""
        before = self.lifetimes(line[2]) if line[1] == "object" else []
        if at > self.now:
            if item is None:
                self.pending.pop((line, at), None)
            else:
                self.pending[line, at] = item
        elif item is None:
            self.current.pop(line, None)
            self.causes[line] = cause
        elif not (line in self.current and self.world.same(*self.current[line], item, at, at)):
            last = self.past.get(line, [])[-1:]
            again = last and last[0].end == at and self.world.same(last[0].item, last[0].start, item, at, at)
            self.current[line] = (last[0].item, last[0].start) if again else (item, at)
        if line[1] == "object":
            self._lose(str(line[2]), minus(before, self.lifetimes(line[2])))

    def _lose(self, name: str, lost: Spans) -> None:
        """End every mention of an object in the spans that it lost, up to its next start (rule C9)."""
        starts = sorted(start for start, _ in self.lifetimes(name))
        for first, _ in lost:
            next_start = min((start for start in starts if start > first), default=FOREVER)
            if first == self.now:
                for line in [line for line, (item, _) in self.current.items() if name in item.mentions]:
                    del self.current[line]
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
        for line in [line for line, (item, _) in self.current.items() if line[:2] == kind and matches(pattern, item)]:
            self._put(line, None, self.now)

    def _cancel(self, line: Timeline, at: int) -> None:
        kept = self.pending[line, at]
        self._put(line, None, at)
        if line[1] == "object" and self.types_meet(str(line[2])):
            self.violations.append(f"cancelling {kept} lets two types meet")
