"""The reference's items of knowledge, and a domain to check them against."""

from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from fractions import Fraction
from typing import TypeVar

SECOND = 1_000_000_000
WILDCARD = "?"
ROOT = "object"

Timeline = tuple[object, ...]
"""The key of a timeline: the role, the kind of knowledge, and its name."""


@dataclass(frozen=True)
class Object:
    """An object with its type; negative, the end of its existence."""

    name: str
    type: str = ""
    positive: bool = True

    kind = "object"

    @property
    def identity(self) -> tuple[object, ...]:
        return (self.name,)

    @property
    def mentions(self) -> frozenset[str]:
        """An object does not depend on itself: its own timeline is never ended by its removal."""
        return frozenset()


@dataclass(frozen=True)
class Fact:
    """A fact, or with `positive` False an explicit falsehood."""

    name: str
    arguments: tuple[str, ...] = ()
    positive: bool = True

    kind = "fact"

    @property
    def identity(self) -> tuple[object, ...]:
        return (self.name, self.arguments)

    @property
    def mentions(self) -> frozenset[str]:
        return frozenset(self.arguments)


@dataclass(frozen=True)
class Number:
    """The value of a function, or a change of it: `operation` is the assign_op of rule C7 in lower case."""

    name: str
    arguments: tuple[str, ...] = ()
    value: float = 0.0
    rate: float = 0.0
    operation: str = "assign"

    kind = "function"

    @property
    def identity(self) -> tuple[object, ...]:
        return (self.name, self.arguments)

    @property
    def mentions(self) -> frozenset[str]:
        return frozenset(self.arguments)

    def at(self, start: int, t: int) -> float:
        """The value at t of a number asserted at `start` (rule C7, in its order of operations)."""
        return self.value + self.rate * ((t - start) / SECOND) if self.rate else self.value


Term = tuple[str, tuple[str, ...]]
"""A function with its arguments, as a metric or a comparison reads it."""


@dataclass(frozen=True)
class Metric:
    """The metric as its PDDL text, with the functions that it reads. An empty text in a removal matches any."""

    text: str = ""
    reads: tuple[Term, ...] = field(default=(), compare=False)

    kind = "metric"

    @property
    def identity(self) -> tuple[object, ...]:
        return ()

    @property
    def mentions(self) -> frozenset[str]:
        return frozenset(argument for _, arguments in self.reads for argument in arguments)


@dataclass(frozen=True)
class Comparison:
    """A recorded inequality (or a goal of that form) as its PDDL text, with the functions that it reads."""

    text: str
    reads: tuple[Term, ...] = field(default=(), compare=False)
    positive: bool = True

    kind = "inequality"

    @property
    def identity(self) -> tuple[object, ...]:
        return (self.text,)

    @property
    def mentions(self) -> frozenset[str]:
        return frozenset(argument for _, arguments in self.reads for argument in arguments)


@dataclass(frozen=True)
class Condition:
    """A goal that is neither a fact nor an inequality, as its PDDL text, with the facts that it mentions."""

    text: str
    facts: tuple[Fact, ...] = field(default=(), compare=False)

    kind = "condition"

    @property
    def identity(self) -> tuple[object, ...]:
        return (self.text,)

    @property
    def mentions(self) -> frozenset[str]:
        return frozenset(argument for fact in self.facts for argument in fact.arguments)


Item = Object | Fact | Number | Metric | Comparison | Condition


def timeline(role: str, item: Item) -> Timeline:
    """The timeline that an item in a role ("state" or "goal") belongs to."""
    return (role, item.kind, *item.identity)


def matches(pattern: Item, item: Item) -> bool:
    """Whether a removal's pattern matches an item of the same kind (rules V7, C4)."""
    if isinstance(pattern, Object) and isinstance(item, Object):
        return replace(pattern, type=pattern.type or item.type) == item
    if isinstance(pattern, Metric) and isinstance(item, Metric):
        return pattern.text in ("", item.text)
    if isinstance(pattern, Fact | Number) and isinstance(item, Fact | Number):
        return (
            pattern.name == item.name
            and len(pattern.arguments) == len(item.arguments)
            and all(
                wanted in (WILDCARD, found) for wanted, found in zip(pattern.arguments, item.arguments, strict=True)
            )
            and getattr(pattern, "positive", True) == getattr(item, "positive", True)
        )
    return pattern == item


Placed = TypeVar("Placed", Fact, Number, "Limit")

Signature = tuple[tuple[str, ...], ...]
"""The types that each parameter accepts; several are an ``either``."""


@dataclass(frozen=True)
class RefDomain:
    """A domain: types with their parents, constants with their types, and signatures."""

    name: str
    types: dict[str, str] = field(default_factory=dict, hash=False)
    constants: dict[str, str] = field(default_factory=dict, hash=False)
    predicates: dict[str, Signature] = field(default_factory=dict, hash=False)
    functions: dict[str, Signature] = field(default_factory=dict, hash=False)
    sensed: frozenset[str] = frozenset()

    def __repr__(self) -> str:
        return f"the domain {self.name}"

    def is_a(self, type_name: str, wanted: str) -> bool:
        """Whether a type is another one or below it."""
        while type_name not in (wanted, ROOT):
            type_name = self.types[type_name]
        return type_name == wanted

    def knows_type(self, type_name: str) -> bool:
        return type_name == ROOT or type_name in self.types


@dataclass(frozen=True)
class Limit:
    """A condition on a number: `comparison` is one of "<", "<=", ">" and ">="."""

    name: str
    arguments: tuple[str, ...]
    comparison: str
    bound: float

    def allows(self, value: Fraction) -> bool:
        """Whether a value satisfies it."""
        match self.comparison:
            case "<":
                return value < self.bound
            case "<=":
                return value <= self.bound
            case ">":
                return value > self.bound
            case _:
                return value >= self.bound


Wanted = Fact | Limit
"""A condition of an action."""


@dataclass(frozen=True)
class Flow:
    """A continuous effect on a function, per second: `rate` and each factor times its function, over the divisor.

    It acts while `condition` is true, and only if `at_start` was true before the at-start effects.
    """

    term: Term
    rate: float = 0.0
    factors: tuple[tuple[float, Term], ...] = ()
    divisor: Term | None = None
    condition: Fact | None = None
    at_start: Fact | None = None

    @property
    def reads(self) -> tuple[Term, ...]:
        """The functions that the rate reads."""
        return (*(term for _, term in self.factors), *([self.divisor] if self.divisor else []))


@dataclass(frozen=True)
class RefAction:
    """A durative action. Its formulas have the places of its parameters ("0", "1") where arguments go.

    A negative fact among the effects is a delete. `decided_at_start` are effects at the end, each after the fact that
    decides by its truth at the start whether it happens. `flows` move functions while it runs. `bounds` compare the
    duration in seconds, by "<=", ">=" or "=", with a number or a function.
    """

    name: str
    types: tuple[str, ...]
    needs: tuple[Fact, ...] = ()
    invariants: tuple[Wanted, ...] = ()
    at_start: tuple[Fact, ...] = ()
    at_end: tuple[Fact, ...] = ()
    decided_at_start: tuple[tuple[Fact, Fact], ...] = ()
    numbers_at_start: tuple[Number, ...] = ()
    numbers_at_end: tuple[Number, ...] = ()
    flows: tuple[Flow, ...] = ()
    bounds: tuple[tuple[str, float | Term], ...] = ()


@dataclass(frozen=True)
class Start:
    """The start of an action with its arguments and duration in nanoseconds.

    `force` overrules its bounds, and invariants that are expected to break.
    """

    action: RefAction
    arguments: tuple[str, ...]
    duration: int = 0
    force: bool = False

    def ground(self, places: tuple[str, ...]) -> tuple[str, ...]:
        """The arguments that belong to some places."""
        return tuple(self.arguments[int(place)] for place in places)

    def ground_term(self, term: Term) -> Term:
        """A function of the action with the arguments in their places."""
        return term[0], self.ground(term[1])

    def facts(self, facts: Iterable[Placed]) -> list[Placed]:
        """Some facts, numbers or limits of the action with the arguments in their places."""
        return [replace(fact, arguments=self.ground(fact.arguments)) for fact in facts]
