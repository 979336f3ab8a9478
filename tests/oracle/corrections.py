"""Late knowledge in a transaction: edits of the past (rules L1 to L8)."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

from tests.oracle.draft import Draft
from tests.oracle.items import Comparison, Item, Metric, Number, Object, RefDomain, Start, Timeline, matches, timeline
from tests.oracle.late import FOREVER, Piece, Spans, cut, merged, minus, next_change
from tests.oracle.world import Assertion, Running, World


class Refused(Exception):
    """The transaction is refused; `error` is the name of kbstore's error for it.

    `first` is the name of the error for the first invalid update.
    """

    def __init__(self, error: str, why: str, first: str = "") -> None:
        super().__init__(f"{error}: {why}")
        self.error = error
        self.first = first or error


@dataclass(frozen=True)
class Update:
    """One update.

    `what` is add, remove, add_goal, remove_goal, add_metric, remove_metric, clear, domain, start, end, abort, or
    replace, which has `items`.
    """

    what: str
    item: Item | RefDomain | Start | None = None
    at: int = 0
    since: int | None = None
    until: int | None = None
    items: tuple[Item, ...] = ()


class Corrections(Draft):
    """A draft whose past can be edited."""

    def __init__(self, world: World, now: int) -> None:
        super().__init__(world, now)
        self.running: list[Running] = world.running
        self.causes: dict[Timeline, str] = {}
        self.edited: set[Timeline] = set()
        self.violations: list[str] = []
        self.failures: list[Refused] = []

    def wrong_span(self, update: Update, at: int) -> str:
        since, until = update.since, update.until
        if since is None or since > self.now:
            return f"since {since} is not before now"
        if until is not None and not since < until <= self.now:
            return f"until {until} is not between {since} and now"
        if since == self.now:
            return ""
        if at > self.now:
            return f"an item for {at}"
        if isinstance(update.item, Metric) or (
            isinstance(update.item, Comparison) and not update.what.endswith("goal")
        ):
            return "a metric or a recorded inequality"
        return ""

    def _edit(self, line: Timeline, pieces: list[Piece], cause: str) -> None:
        """Replace the pieces of a timeline up to now."""
        self.edited.add(line)
        pieces = sorted((piece for piece in pieces if piece.start <= self.now), key=lambda piece: piece.start)
        self.past[line] = [replace(piece, end=min(piece.end, self.now)) for piece in pieces if piece.start < self.now]
        if pieces and pieces[-1].end > self.now:
            self.current[line] = (pieces[-1].item, pieces[-1].start)
        elif self.current.pop(line, None):
            self.causes[line] = cause

    def _blank(self, line: Timeline, since: int, until: int, cause: str = "removed") -> None:
        before = self.lifetimes(line[2]) if line[1] == "object" else []
        self._edit(line, cut(self.known(line), since, until, cause, self.world.value), cause)
        if line[1] == "object":
            self._lose_late(str(line[2]), minus(before, self.lifetimes(line[2])))

    def _lose_late(self, name: str, lost: Spans) -> None:
        """End every mention of an object in the spans in which it did not exist (rule L5)."""
        for first, last in lost:
            for line in {*self.past, *self.current}:
                mentioning = [piece for piece in self.known(line) if name in piece.item.mentions]
                others = [piece for piece in self.known(line) if piece not in mentioning]
                left = cut(mentioning, first, last, "object", self.world.value)
                if left != mentioning:
                    self._edit(line, [*others, *left], "object")
            next_start = min((start for start, _ in self.lifetimes(name) if start > first), default=FOREVER)
            for line, at in [key for key, item in self.pending.items() if name in item.mentions]:
                if first <= at < next_start:
                    del self.pending[line, at]
            if first <= self.now < last:
                self.running = [run for run in self.running if name not in run.start.arguments]

    def remove_late(self, role: str, pattern: Item, since: int, until: int | None) -> None:
        found = self._in_each_domain(since, until or since + 1, lambda: self.pattern_violations_of(pattern))
        if all(found):
            self.violations += found[0]
            return
        for line in [line for line in {*self.past, *self.current} if line[:2] == (role, pattern.kind)]:
            for piece in self.known(line):
                if matches(pattern, piece.item) and piece.start < (until or since + 1) and since < piece.end:
                    self._blank(line, max(since, piece.start), min(piece.end, until or FOREVER))

    def add_late(self, role: str, item: Item, since: int, until: int | None) -> None:
        if isinstance(item, Object) and not item.positive:
            self.remove_late(role, replace(item, positive=True), since, until)
            return
        if isinstance(item, Number) and item.operation != "assign":
            self.failures.append(Refused("ScheduledRelativeChange", str(item)))
            return
        line = timeline(role, item)
        pieces = self.known(line)
        following = min([next_change(pieces, since), *(at for found, at in self.pending if found == line)])
        end = min([until or following, *self._ends_of_objects(item, since)])
        found = [why for version in self._late_violations(item, since, end, until) for why in version]
        if found:
            self.violations += found
            return
        span = [piece for piece in pieces if piece.start < end and since < piece.end]
        same = [self.world.same(item, since, p.item, p.start, max(since, p.start)) for p in span]
        if until is None and any(again and piece.start == since for piece, again in zip(span, same, strict=True)):
            return
        covered = merged([(piece.start, piece.end) for piece in span])
        if until is not None and all(same) and covered and covered[0][0] <= since and until <= covered[0][1]:
            return
        ended = [piece.ended for piece in span if piece.end == end and until is None]
        ended += [(None if until else by, "object") for by in self._enders_of_objects(item, end)]
        left = cut(pieces, since, until or end, "replaced", self.world.value)
        late = Piece(since, end if end <= self.now else FOREVER, item, ended=ended[0] if ended else None)
        self._edit(line, [*left, late], "replaced")

    def _ends_of_objects(self, item: Item, since: int) -> list[int]:
        return [end for name in item.mentions for _, end in self.lifetimes(name) if end > since]

    def _enders_of_objects(self, item: Item, end: int) -> list[int | None]:
        """The transactions that ended an object of an item at a time."""
        lines: list[Timeline] = [("state", "object", name) for name in sorted(item.mentions)]
        pieces = [piece for line in lines for piece in self.known(line) if piece.end == end]
        return [piece.ended[0] if piece.ended else None for piece in pieces]

    def _late_violations(self, item: Item, since: int, end: int, until: int | None) -> list[list[str]]:
        """The violations of a late item under each domain that is in force while it holds (rule L5)."""
        if isinstance(item, Object):
            return self._in_each_domain(since, end, lambda: self._late_object_violations(item, since, end))
        return self._in_each_domain(since, end, lambda: self._late_atom_violations(item, since, until))

    def _late_object_violations(self, item: Object, since: int, end: int) -> Iterator[str]:
        if self.domain and not self.domain.knows_type(item.type):
            yield f"no type {item.type}"
        elif self.domain and item.name in self.domain.constants:
            yield f"{item.name} is a constant"
        for start, until, type_name in self.existences(item.name):
            if type_name != item.type and start <= end and since <= until:
                yield f"{item} meets an existence of another type"

    def _late_atom_violations(self, item: Item, since: int, until: int | None) -> Iterator[str]:
        yield from self.violations_of(item, since)
        for name in item.mentions if self.domain and until else ():
            if name not in self.domain.constants and not any(
                start <= since and until <= end for start, end in self.lifetimes(name)
            ):
                yield f"{name} does not exist until {until}"

    def _in_each_domain(self, since: int, end: int, check: Callable[[], Iterator[str]]) -> list[list[str]]:
        """The violations that a check finds under each domain in force within a span."""
        latest = self.domain
        versions = [*self.world.domains, (self.now, latest)]
        ends = [start for start, _ in versions[1:]] + [FOREVER]
        found: list[list[str]] = []
        for (start, domain), version_end in zip(versions, ends, strict=True):
            if max(since, start) < min(end, version_end):
                self.domain = domain
                found.append(list(check()))
        self.domain = latest
        return found

    def finish_edited(self, line: Timeline, number: int, expected: dict[int, Assertion]) -> bool:
        """Record the pieces of a timeline; assertions that differ stay on record, superseded (rule L8)."""
        pieces = {piece.start: piece for piece in self.known(line)}
        now_replaced = "replaced" if self.now in pieces else self.causes.get(line, "removed")
        old = [
            assertion
            for assertion in self.world.assertions
            if assertion.timeline == line and assertion.counts and assertion.start <= self.now
        ]
        recorded: dict[int, Assertion] = {}
        changed = False
        for assertion in old:
            piece = pieces.get(assertion.start)
            kept = piece is not None and piece.item == assertion.item
            if kept and piece.end == (assertion.end or FOREVER):
                recorded[assertion.start] = assertion
                continue
            changed = True
            if assertion.end is None and (assertion.start == self.now or (kept and piece.end == self.now)):
                assertion.end, assertion.ended_by, assertion.end_cause = self.now, number, now_replaced
                if assertion.start < self.now:
                    recorded[assertion.start] = assertion
            else:
                as_expected = expected[id(assertion)]
                assertion.end, assertion.ended_by = as_expected.end, as_expected.ended_by
                assertion.superseded_by = number
        for start, piece in pieces.items():
            if start not in recorded:
                changed = True
                recorded[start] = self.record(line, piece.item, start, number)
                recorded[start].first_recorded = piece.first_recorded or number
                recorded[start].end = piece.end if piece.end < FOREVER else None
        for start, assertion in recorded.items():
            if assertion.recorded == number and assertion.end in recorded:
                assertion.ended_by, assertion.end_cause = recorded[assertion.end].recorded, "replaced"
            elif assertion.recorded == number and assertion.end is not None:
                by, cause = pieces[start].ended or (None, "removed")
                assertion.ended_by, assertion.end_cause = by or number, cause
        self.world.current.pop(line, None)
        self.world.current.update((line, assertion) for assertion in recorded.values() if assertion.end is None)
        return changed

    def record(self, line: Timeline, item: Item, start: int, number: int) -> Assertion:
        assertion = Assertion(line, item, start, number)
        self.world.assertions.append(assertion)
        return assertion


def expected_ends(world: World) -> dict[int, Assertion]:
    """Each assertion as it would be without further transactions, by the identity of the one in the world."""
    later = world.copy()
    later.expecting = True
    later.advance(FOREVER)
    return {
        id(assertion): as_expected for assertion, as_expected in zip(world.assertions, later.assertions, strict=True)
    }
