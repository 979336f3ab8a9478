"""The state and schedule as a transaction would leave them, and the validation of further updates."""

import itertools
from collections.abc import Iterator
from dataclasses import replace

from tests.oracle.items import (
    WILDCARD,
    Comparison,
    Condition,
    Fact,
    Item,
    Metric,
    Number,
    Object,
    Signature,
    Timeline,
    timeline,
)
from tests.oracle.late import FOREVER, Piece, Spans, merged
from tests.oracle.world import World


class Draft:
    """The past, the state and the schedule with the updates made so far, and the validation of further ones.

    `past` has the pieces of each timeline up to now; a current item that began before now is the last of them, too.
    """

    def __init__(self, world: World, now: int) -> None:
        world.advance(now)
        self.world = world
        self.now = now
        self.domain = world.domain
        self.current: dict[Timeline, tuple[Item, int]] = {
            line: (assertion.item, assertion.start) for line, assertion in world.current.items()
        }
        self.pending: dict[tuple[Timeline, int], Item] = {
            key: assertion.item for key, assertion in world.pending.items()
        }
        self.past: dict[Timeline, list[Piece]] = {}
        for assertion in sorted(world.assertions, key=lambda assertion: assertion.start):
            if assertion.counts and assertion.start < now:
                ended = (assertion.ended_by, assertion.end_cause) if assertion.ended_by else None
                piece = Piece(assertion.start, assertion.end or now, assertion.item, assertion.first_recorded, ended)
                self.past.setdefault(assertion.timeline, []).append(piece)

    def known(self, line: Timeline) -> list[Piece]:
        """The pieces of a timeline up to now, in order of time; the current one has no end."""
        pieces = list(self.past.get(line, ()))
        if line in self.current:
            item, start = self.current[line]
            if start < self.now:
                pieces[-1] = replace(pieces[-1], end=FOREVER)
            else:
                pieces.append(Piece(start, FOREVER, item))
        return pieces

    # -- the existence of objects -----------------------------------------------------------------------------

    def _trajectory(self, name: object) -> list[tuple[int, Object]]:
        """The assertions of an object's timeline from now on, in order of time."""
        line = ("state", "object", name)
        trajectory = [(self.now, self.current[line][0])] if line in self.current else []
        trajectory += [(at, item) for (found, at), item in self.pending.items() if found == line]
        return sorted(((at, item) for at, item in trajectory if isinstance(item, Object)), key=lambda entry: entry[0])

    def existences(self, name: object) -> list[tuple[int, int, str]]:
        """The spans in which an object exists, with its type, from the first time to the last."""
        past = [(p.start, p.end, p.item) for p in self.past.get(("state", "object", name), ())]
        trajectory = self._trajectory(name)
        ends = [at for at, _ in trajectory[1:]] + [FOREVER]
        found = past + [(start, end, item) for (start, item), end in zip(trajectory, ends, strict=False)]
        return [(start, end, item.type) for start, end, item in found if isinstance(item, Object) and item.positive]

    def lifetimes(self, name: object) -> Spans:
        """The spans in which an object exists, with adjacent ones joined."""
        return merged([(start, end) for start, end, _ in self.existences(name)])

    def type_at(self, name: str, t: int) -> str | None:
        """The type of an object at a time, None where it does not exist."""
        if self.domain and name in self.domain.constants:
            return self.domain.constants[name]
        return next((type_name for start, end, type_name in self.existences(name) if start <= t < end), None)

    def types_meet(self, name: str) -> bool:
        """Whether existences of different types overlap or touch."""
        return any(
            one[2] != other[2] and one[1] >= other[0] for one, other in itertools.pairwise(self.existences(name))
        )

    # -- what is valid ----------------------------------------------------------------------------------------

    def violations_of(self, item: Item, at: int) -> Iterator[str]:
        match item:
            case Object():
                yield from self._object_violations(item, at)
            case Fact():
                yield from self._atom_violations("predicate", item.name, item.arguments, at)
            case Number():
                yield from self._atom_violations("function", item.name, item.arguments, at)
            case Metric() | Comparison():
                for name, arguments in item.reads:
                    yield from self._atom_violations("function", name, arguments, at)
            case Condition():
                for fact in item.facts:
                    yield from self._atom_violations("predicate", fact.name, fact.arguments, at)

    def _object_violations(self, item: Object, at: int) -> Iterator[str]:
        if self.domain:
            if not self.domain.knows_type(item.type):
                yield f"no type {item.type}"
                return
            if item.name in self.domain.constants:
                yield f"{item.name} is a constant"
                return
        if not item.positive:
            return
        tried = dict(self.pending), dict(self.current)
        line = timeline("state", item)
        if at > self.now:
            self.pending[line, at] = item
        else:
            self.current[line] = (item, at)
        meets = self.types_meet(item.name)
        self.pending, self.current = tried
        exists = self.type_at(item.name, self.now)
        if at == self.now and exists not in (None, item.type):
            meets = True
        if meets:
            yield f"{item} meets an existence of another type"

    def _atom_violations(self, kind: str, name: str, arguments: tuple[str, ...], at: int) -> Iterator[str]:
        if WILDCARD in arguments:
            yield f"{name} {arguments} has a wildcard"
        if self.domain is None:
            yield from self._first_use_violations(kind, name, arguments)
            return
        found = list(self._symbol_violations(kind, name, arguments))
        yield from found
        for types, argument in zip(self._signature(kind, name) or (), arguments, strict=not found):
            type_name = self.type_at(argument, at)
            if not found and (type_name is None or not any(self.domain.is_a(type_name, wanted) for wanted in types)):
                yield f"{argument} in {name} is {type_name}, not {types}"

    def _signature(self, kind: str, name: str) -> Signature | None:
        assert self.domain
        return (self.domain.predicates if kind == "predicate" else self.domain.functions).get(name)

    def _first_use_violations(self, kind: str, name: str, arguments: tuple[str, ...]) -> Iterator[str]:
        """Without a domain a symbol keeps the arity of its first use (rule D2)."""
        wanted = {"predicate": Fact, "function": Number}[kind]
        known = {
            len(assertion.item.arguments)
            for assertion in self.world.assertions
            if isinstance(assertion.item, Fact | Number)
            and isinstance(assertion.item, wanted)
            and assertion.item.name == name
        }
        if known and len(arguments) not in known:
            yield f"{name} was first used with {known} arguments"

    def pattern_violations_of(self, pattern: Item) -> Iterator[str]:
        """The symbols and arities of a removal are checked, its objects are not (rule C4)."""
        match pattern:
            case Object():
                if self.domain and pattern.type and not self.domain.knows_type(pattern.type):
                    yield f"no type {pattern.type}"
                if self.domain and pattern.name in self.domain.constants:
                    yield f"{pattern.name} is a constant"
            case Fact():
                yield from self._symbol_violations("predicate", pattern.name, pattern.arguments)
            case Number():
                yield from self._symbol_violations("function", pattern.name, pattern.arguments)
            case Metric() | Comparison():
                for name, arguments in pattern.reads:
                    yield from self._symbol_violations("function", name, arguments)
            case Condition():
                for fact in pattern.facts:
                    yield from self._symbol_violations("predicate", fact.name, fact.arguments)

    def _symbol_violations(self, kind: str, name: str, arguments: tuple[str, ...]) -> Iterator[str]:
        if self.domain is None:
            yield from self._first_use_violations(kind, name, arguments)
            return
        signature = self._signature(kind, name)
        if signature is None:
            yield f"no {kind} {name}"
        elif len(signature) != len(arguments):
            yield f"{name} has {len(signature)} arguments"
