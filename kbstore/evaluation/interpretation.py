"""Protocols for evaluating formulas: an interpretation at one time, or a trajectory over a span.

All names that go in and come out are keys (`kbstore.names.key`). Both are protocols because what holds can come
from a state in memory, from single rows of the database, or from a state with the effects of an action on top.
"""

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

from kbstore.model.domain import Domain
from kbstore.model.timelines import moved

Arguments = tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Number:
    """The value of a numeric function: `value` at the time `since`, moving by `rate` per second from then on."""

    value: float
    rate: float = 0.0
    since: int = 0

    def at(self, t: int) -> float:
        """Return the value at a time in nanoseconds (rule C7)."""
        return moved(self.value, self.rate, t - self.since)


class Interpretation(Protocol):
    """The facts, numbers and objects at one time."""

    @property
    def time(self) -> int:
        """The time, in nanoseconds."""

    @property
    def domain(self) -> Domain | None:
        """The domain at that time."""

    @property
    def use_unknowns(self) -> bool:
        """Whether absent reads as unknown (open world) instead of false (rule V2)."""

    def sign(self, name: str, arguments: Arguments) -> bool | None:
        """True where the fact is asserted, False where it is explicitly false, None where neither is."""

    def facts(self, name: str) -> Iterable[tuple[Arguments, bool]]:
        """The facts of a predicate, of both signs, each with its sign."""

    def number(self, name: str, arguments: Arguments) -> Number | None:
        """The value of a numeric function, None where it is undefined."""

    def objects(self, types: Iterable[str]) -> Collection[str]:
        """The objects that exist and are of one of the types or their subtypes, constants included."""

    def type_of(self, name: str) -> str | None:
        """The type of an object or constant, None where it does not exist."""


class ListedInterpretation(Interpretation, Protocol):
    """An interpretation that also lists the defined functions."""

    def defined(self, name: str) -> Iterable[Arguments]:
        """The arguments for which a numeric function is defined."""


class IndexedInterpretation(Interpretation, Protocol):
    """An interpretation that finds facts by any of their objects."""

    def matching(self, name: str, wanted: tuple[str | None, ...]) -> Iterable[tuple[Arguments, bool]]:
        """The facts of a predicate that have the given arguments, at least one of them, each with its sign."""


Span = tuple[int, int]
"""A half-open interval of time, in nanoseconds."""


class Trajectory(Protocol):
    """The facts, numbers and objects over a span of time, under one domain.

    Pieces are in order of time, do not overlap, and are clipped to the span; where there is none, nothing holds.
    """

    @property
    def span(self) -> Span:
        """The span."""

    @property
    def domain(self) -> Domain | None:
        """The domain throughout the span."""

    @property
    def use_unknowns(self) -> bool:
        """Whether absent reads as unknown."""

    def signs(self, name: str, arguments: Arguments) -> Sequence[tuple[int, int, bool]]:
        """The pieces in which one fact is asserted or denied, each with its sign."""

    def all_signs(self, name: str) -> Mapping[Arguments, Sequence[tuple[int, int, bool]]]:
        """The pieces of every fact of a predicate that is asserted or denied somewhere in the span."""

    def numbers(self, name: str, arguments: Arguments) -> Sequence[tuple[int, int, Number]]:
        """The pieces in which one numeric function is defined."""

    def lifespans(self, types: Iterable[str]) -> Mapping[str, Sequence[Span]]:
        """The objects that exist somewhere in the span and are of one of the types or their subtypes, with when.

        Constants are included, for the whole span.
        """

    def lifespan(self, name: str) -> Sequence[tuple[int, int, str]]:
        """Return the spans in which an object exists, each with its type; a constant exists for the whole span."""
