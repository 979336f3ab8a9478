"""The operators of a domain: instantaneous and durative actions with all that PDDL says of them."""

from dataclasses import dataclass

from kbstore.logic import Condition, Effect, Expression, Moment, Parameter
from kbstore.messages import ComparisonType, DomainFormula, DomainOperator, KeyValue


@dataclass(frozen=True)
class DurationConstraint:
    """One constraint on ``?duration``, for instance ``(<= ?duration 10)``."""

    comparison: ComparisonType
    bound: Expression
    moment: Moment = Moment.AT_START


@dataclass(frozen=True)
class Action:
    """An operator with everything that PDDL says of it.

    An instantaneous action has its precondition and effects at `Moment.AT_START`. A continuous effect belongs to
    the whole of a durative action, and stands in `effects` with `Moment.OVER_ALL`.
    """

    name: str
    parameters: tuple[Parameter, ...] = ()
    durative: bool = False
    duration: tuple[DurationConstraint, ...] = ()
    conditions: tuple[tuple[Moment, Condition], ...] = ()
    effects: tuple[tuple[Moment, Effect], ...] = ()

    def conditions_at(self, moment: Moment) -> tuple[Condition, ...]:
        """The conditions that must hold at a moment."""
        return tuple(condition for when, condition in self.conditions if when is moment)

    def effects_at(self, moment: Moment) -> tuple[Effect, ...]:
        """The effects of a moment."""
        return tuple(effect for when, effect in self.effects if when is moment)


def operator_message(action: Action) -> DomainOperator:
    """The operator as the message carries it; what the message cannot carry is left to the `Action`."""
    return DomainOperator(
        formula=DomainFormula(
            name=action.name, typed_parameters=tuple(KeyValue(p.name, p.type_text) for p in action.parameters)
        )
    )
