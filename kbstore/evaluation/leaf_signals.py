"""The truth over a span of the leaves of conditions: facts, comparisons, existence."""

from collections.abc import Iterator, Mapping, Sequence
from itertools import product
from math import prod

from kbstore.evaluation import comparisons, signals
from kbstore.evaluation.evaluator import wild_types
from kbstore.evaluation.interpretation import Span, Trajectory
from kbstore.evaluation.joins import Relation
from kbstore.evaluation.signals import Signal
from kbstore.evaluation.substitution import ArgumentPattern, Bindings, pattern
from kbstore.messages.enums import Truth
from kbstore.model.formulas import Atom, Comparison, Types
from kbstore.names import key


class LeafSignals:
    """The signals of leaves over one trajectory, with objects for their variables; names are keys.

    `duration`, in seconds, is the value of ``?duration``.
    """

    def __init__(self, trajectory: Trajectory, duration: float | None) -> None:
        self._trajectory = trajectory
        self._span = trajectory.span
        self._duration = duration
        self._relations: dict[str, Relation] = {}

    def constant(self, truth: Truth) -> Signal:
        """Return the signal of one truth throughout the span."""
        return [(self._span[0], truth)]

    def fact(self, atom: Atom, bindings: Bindings) -> Signal:
        """Return the signal of a fact; with wildcards, for some objects that match."""
        name, wanted = key(atom.name), pattern(atom, bindings)
        if None in wanted:
            return self._wild_fact(name, wanted)
        signs = self._trajectory.signs(name, wanted)  # type: ignore[arg-type]
        absent = Truth.UNKNOWN if self._trajectory.use_unknowns else Truth.FALSE
        return signals.painted(self._span, ((start, end, Truth.of(sign)) for start, end, sign in signs), absent)

    def comparison(self, comparison: Comparison, bindings: Bindings) -> Signal:
        """Return the signal of a comparison. Raises `NotLinear`."""
        return comparisons.over_span(
            comparison,
            self._span,
            lambda function: self._trajectory.numbers(function.name, function.arguments),
            bindings,
            self._duration,
        )

    def defined(self, function: Atom, bindings: Bindings) -> Signal:
        """Return the signal of a function being defined; with wildcards, for some objects that match."""
        name, wanted = key(function.name), pattern(function, bindings)
        domain = self._trajectory.domain
        ranges = wild_types(wanted, domain.function_signatures.get(name) if domain else None)
        found = []
        for chosen in product(*map(self.objects, ranges)):
            filler = iter(chosen)
            arguments = tuple([next(filler) if value is None else value for value in wanted])
            spans = ((start, end) for start, end, _ in self._trajectory.numbers(name, arguments))
            found.append(self._all([self._spans(spans), *map(self.presence, chosen, ranges)]))
        return self._any(found)

    def is_a(self, name: str | None, types: Types) -> Signal:
        """Return the signal of an object, or some object, existing with one of the types."""
        if name is None:
            return self._any([self.presence(each, types) for each in self.objects(types)])
        domain = self._trajectory.domain
        if domain is None:
            return self.presence(name, types)
        lifespan = self._trajectory.lifespan(name)
        return self._spans((start, end) for start, end, kind in lifespan if domain.is_subtype(kind, types))

    def presence(self, name: str, types: Types) -> Signal:
        """Return the signal of one object existing with one of the types, from the lifespans of all of these types."""
        return self._spans(self.objects(types).get(name, ()))

    def objects(self, types: Types) -> Mapping[str, Sequence[Span]]:
        """The objects of some types that exist somewhere in the span, with their lifespans."""
        return self._trajectory.lifespans(types)

    def wild_ranges(self, name: str, wanted: ArgumentPattern) -> list[Types]:
        """The types of a predicate's parameters for which a pattern has wildcards."""
        domain = self._trajectory.domain
        return wild_types(wanted, domain.predicate_signatures.get(name) if domain else None)

    def _wild_fact(self, name: str, wanted: ArgumentPattern) -> Signal:
        """Return the signal that is true while the fact is asserted for some objects that match.

        In an open world it is false only while it is explicitly false for all of them, which takes a domain to know.
        """
        asserted, denied = (list(self._matching(name, wanted, sign)) for sign in (True, False))
        if not self._trajectory.use_unknowns:
            return self._any(asserted)
        if self._trajectory.domain is None:
            return self._any([*asserted, self.constant(Truth.UNKNOWN)])
        return self._any(
            [*asserted, signals.false_else_unknown(self._all_denied(denied, self.wild_ranges(name, wanted)))]
        )

    def _matching(self, name: str, wanted: ArgumentPattern, sign: bool) -> Iterator[Signal]:
        """Yield, for each row that matches, the signal of its sign while the objects for the wildcards exist."""
        known = self._trajectory.all_signs(name)
        if name not in self._relations:
            self._relations[name] = Relation(known)
        ranges = self.wild_ranges(name, wanted)
        for row in self._relations[name].matching(wanted):
            spans = [(start, end) for start, end, its_sign in known[row] if its_sign is sign]
            if spans and self._trajectory.domain is None:
                yield self._spans(spans)
            elif spans:
                wild = (name for name, value in zip(row, wanted, strict=True) if value is None)
                yield self._all([self._spans(spans), *map(self.presence, wild, ranges)])

    def _all_denied(self, denied: Sequence[Signal], ranges: Sequence[Types]) -> Signal:
        """Return the signal that is true while the denied rows are as many as the combinations of objects."""
        groups = [denied, *([self.presence(name, types) for name in self.objects(types)] for types in ranges)]
        steps: list[tuple[int, int, int]] = []  # time, group, change in how many of its signals are true
        for i, group in enumerate(groups):
            for signal in group:
                for j, (t, truth) in enumerate(signal):
                    if j or truth is Truth.TRUE:
                        steps.append((t, i, 1 if truth is Truth.TRUE else -1))
        steps.sort()
        counts = [0] * len(groups)
        pieces, now = [], self._span[0]
        for t, i, step in [*steps, (self._span[1], 0, 0)]:
            if t > now:
                pieces.append((now, t, Truth.of(counts[0] == prod(counts[1:]))))
                now = t
            counts[i] += step
        return signals.painted(self._span, pieces, Truth.FALSE)

    def _spans(self, spans: Iterator[Span] | Sequence[Span]) -> Signal:
        return signals.painted(self._span, ((start, end, Truth.TRUE) for start, end in spans), Truth.FALSE)

    def _all(self, parts: Sequence[Signal]) -> Signal:
        return signals.conjunction(parts, self._span[0])

    def _any(self, parts: Sequence[Signal]) -> Signal:
        return signals.disjunction(parts, self._span[0])
