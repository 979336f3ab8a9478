"""The actions of a domain, instantaneous and durative, with every feature of PDDL."""

from dataclasses import dataclass
from functools import cached_property

from kbstore.messages.enums import ComparisonType
from kbstore.model.expressions import NumericExpression
from kbstore.model.formulas import Comparison, Effect, Formula, Parameter, Timing, symbols_in


@dataclass(frozen=True)
class DurationConstraint:
    """One constraint on ``?duration``, for instance ``(<= ?duration 10)``."""

    comparison: ComparisonType
    bound: NumericExpression
    timing: Timing = Timing.AT_START


@dataclass(frozen=True)
class Action:
    """An operator with all of its conditions and effects.

    An instantaneous action has its precondition and effects at `Timing.AT_START`. A continuous effect belongs to
    the whole of a durative action, and is in `effects` with `Timing.OVER_ALL`. The `observe` condition of a sensing
    action is stored and written back, but not computed (rule P4).
    """

    name: str
    parameters: tuple[Parameter, ...] = ()
    durative: bool = False
    duration: tuple[DurationConstraint, ...] = ()
    conditions: tuple[tuple[Timing, Formula], ...] = ()
    effects: tuple[tuple[Timing, Effect], ...] = ()
    observe: Formula | None = None

    @cached_property
    def symbols(self) -> frozenset[str]:
        """The keys of the predicates, functions and object fluents that its conditions and effects name."""
        bounds = (Comparison(c.comparison, c.bound, c.bound) for c in self.duration)
        parts = (part for _, part in (*self.conditions, *self.effects))
        return frozenset().union(*map(symbols_in, (*parts, *bounds)))

    def conditions_at(self, timing: Timing) -> tuple[Formula, ...]:
        """Return the conditions that must hold at a part of the action."""
        return tuple(condition for when, condition in self.conditions if when is timing)

    def effects_at(self, timing: Timing) -> tuple[Effect, ...]:
        """Return the effects of a part of the action."""
        return tuple(effect for when, effect in self.effects if when is timing)
