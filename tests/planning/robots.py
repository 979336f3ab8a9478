"""A small domain of robots, and short ways to write actions about it."""

from kbstore.messages import AssignOp, ComparisonType, SpecialType
from kbstore.model.actions import Action, DurationConstraint
from kbstore.model.domain import Domain
from kbstore.model.expressions import NumericExpression
from kbstore.model.formulas import Atom, Effect, Formula, NumericEffect, Parameter, Timing
from kbstore.planning.grounding import GroundAction, ground
from tests.evaluation.interpretations import World, signatures

START, OVER_ALL, END = Timing.AT_START, Timing.OVER_ALL, Timing.AT_END
DURATION = SpecialType.DURATION


def atom(text: str) -> Atom:
    """``"at ?r wp0"`` is the atom ``(at ?r wp0)``."""
    name, *arguments = text.split()
    return Atom(name, tuple(arguments))


def parameters(text: str) -> tuple[Parameter, ...]:
    """``"r:robot a:wp"`` are the parameters ``?r - robot ?a - wp``; several types are ``"r:robot|wp"``."""
    pairs = (word.split(":") for word in text.split())
    return tuple(Parameter(name, tuple(types.split("|"))) for name, types in pairs)


def change(operation: AssignOp, function: str, *value: object) -> NumericEffect:
    """A numeric effect; the strings among the tokens of its value are functions."""
    return NumericEffect(operation, atom(function), tokens(*value))


def tokens(*value: object) -> NumericExpression:
    """An expression; strings are functions."""
    return tuple(atom(token) if isinstance(token, str) else token for token in value)  # type: ignore[misc]


def action(
    takes: str = "",
    *,
    conditions: list[tuple[Timing, Formula]] | None = None,
    effects: list[tuple[Timing, Effect]] | None = None,
    duration: list[tuple[ComparisonType, NumericExpression]] | None = None,
    durative: bool | None = None,
) -> Action:
    """The action ``act``; durative if it has a duration, unless `durative` is given."""
    return Action(
        "act",
        parameters(takes),
        durative=bool(duration) if durative is None else durative,
        duration=tuple(DurationConstraint(*constraint) for constraint in duration or ()),
        conditions=tuple(conditions or ()),
        effects=tuple(effects or ()),
    )


def robots(*actions: Action) -> Domain:
    """The domain: robots and trucks are movers, waypoints are places; ``depot`` is a constant."""
    return Domain(
        "robots",
        types={"mover": "object", "Robot": "mover", "truck": "mover", "wp": "object"},
        constants={"depot": "wp"},
        predicate_signatures=signatures(
            "at m:mover p:wp", "docked m:mover", "door", "seen p:wp", "path a:wp b:wp", "near a:wp b:wp"
        ),
        function_signatures=signatures("x", "y", "battery m:mover", "distance a:wp b:wp", "speed m:mover", "hops"),
        actions={a.name: a for a in actions},
    )


OBJECTS = {"kenny": "robot", "rob": "robot", "t1": "truck", "wp0": "wp", "wp1": "wp"}


def world(
    act: Action | None = None,
    *,
    facts: dict[str, bool] | None = None,
    numbers: dict[str, float] | None = None,
    use_unknowns: bool = False,
) -> World:
    """A world with two robots, a truck and two waypoints beside the depot."""
    return World(
        robots(*(act,) if act else ()), objects=OBJECTS, facts=facts, numbers=numbers, use_unknowns=use_unknowns
    )


def grounded(act: Action, *arguments: str) -> GroundAction:
    """The action with objects, which are assumed to exist."""
    return ground(robots(act), "act", arguments, world(act))
