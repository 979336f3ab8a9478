"""Latched start conditions: at-start conditions of an action's later effects (rules O2, O3).

A condition that was true is remembered as PDDL text, with objects for its variables and all names as keys. These texts
are stored with the run: they record what was true, and do not change with the domain and the objects.
"""

from collections.abc import Iterator
from itertools import product

from kbstore.evaluation.evaluator import Evaluation
from kbstore.evaluation.interpretation import Interpretation
from kbstore.evaluation.substitution import Bindings, instantiated
from kbstore.messages import Truth
from kbstore.model.formulas import Effect, ForEach, Formula, Parameter, Timing, When, WhenAtStart
from kbstore.names import key
from kbstore.pddl.printer import condition_text
from kbstore.planning.grounding import GroundAction

Remembered = frozenset[str]
"""The conditions that were true at the start; `premise` writes them."""

NOTHING: Remembered = frozenset()


def remembered(
    ground: GroundAction, timing: Timing, world: Interpretation, *, duration: float | None = None
) -> Remembered:
    """Return the at-start conditions of a later part's effects that are true in `world`, the state before the start.

    Below ``forall`` they are evaluated for the objects that exist in `world`. `duration`, in seconds, is the value of
    ``?duration``.
    """
    evaluation = Evaluation(world, duration=duration)
    found = set()
    for condition, parameters in _conditions(ground.action.effects_at(timing)):
        variables = [key(p.name) for p in parameters]
        for chosen in product(*(world.objects(p.types) for p in parameters)):
            bindings = {**ground.bindings, **dict(zip(variables, chosen, strict=True))}
            if evaluation.truth(condition, bindings) is Truth.TRUE:
                found.add(premise(condition, bindings))
    return frozenset(found)


def premise(condition: Formula, bindings: Bindings) -> str:
    """Write a condition with objects for its variables as it is remembered: one line of PDDL."""
    return key(condition_text(instantiated(condition, bindings)))


def _conditions(effects: tuple[Effect, ...]) -> Iterator[tuple[Formula, list[Parameter]]]:
    """Yield each at-start condition among effects, with those parameters of ``forall`` around it that it mentions."""
    todo: list[tuple[Effect, dict[str, Parameter]]] = [(effect, {}) for effect in effects]
    while todo:
        effect, around = todo.pop()
        match effect:
            case ForEach(parameters, parts):
                inner = {**around, **{key(p.name): p for p in parameters}}
                todo.extend((part, inner) for part in parts)
            case When(_, parts):
                todo.extend((part, around) for part in parts)
            case WhenAtStart(condition, parts):
                todo.extend((part, around) for part in parts)
                yield condition, [p for name, p in around.items() if _mentions(condition, name)]


def _mentions(condition: Formula, variable: str) -> bool:
    """Return whether a variable, given by its key, is free in a condition."""
    return instantiated(condition, {variable: "object"}) != condition
