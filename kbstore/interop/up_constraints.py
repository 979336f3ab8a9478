"""Translates trajectory constraints (PDDL 3.0) to those of unified_planning."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Union

from kbstore.errors import InvalidKnowledge
from kbstore.interop.up_formulas import NOTHING, FormulaTranslator, UpVariables
from kbstore.interop.up_symbols import quantified
from kbstore.model.domain import Domain
from kbstore.model.formulas import Formula, Parameter, Variables
from kbstore.pddl.conditions import ConditionReader
from kbstore.pddl.scope import NO_VARIABLES, Scope
from kbstore.pddl.sexpr import Group, SourceText, node_text
from kbstore.pddl.typed_lists import bound

_MAKERS = {
    "always": "Always",
    "sometime": "Sometime",
    "at-most-once": "AtMostOnce",
    "sometime-before": "SometimeBefore",
    "sometime-after": "SometimeAfter",
}
"""The operators that unified_planning has, and its names for them."""


@dataclass(frozen=True)
class TrajectoryConstraint:
    """A constraint: ``and``, ``forall``, or an operator with its conditions."""

    word: str
    parts: tuple[Union[Formula, "TrajectoryConstraint"], ...]
    parameters: tuple[Parameter, ...] = ()


def read_constraint(text: str, domain: Domain) -> TrajectoryConstraint:
    """Read a constraint from its stored text, which has been checked before.

    Raises `InvalidKnowledge` for an operator that unified_planning does not have.
    """
    source = SourceText(text)
    reader = ConditionReader(Scope(source, domain))
    top = source.read()
    return _read(reader, top[0] if len(top) == 1 and isinstance(top[0], Group) else top, NO_VARIABLES)


def _read(reader: ConditionReader, group: Group, variables: Variables) -> TrajectoryConstraint:
    word = group.word(0)
    parts = [part for part in group[1:] if isinstance(part, Group)]
    if word == "and":
        return TrajectoryConstraint(word, tuple(_read(reader, part, variables) for part in parts))
    if word == "forall":
        parameters, part = reader.quantified(group)
        return TrajectoryConstraint(word, (_read(reader, part, bound(variables, parameters)),), parameters)
    if word not in _MAKERS:
        raise InvalidKnowledge(
            f"{node_text(group, 60)} has no counterpart in unified_planning; it has {', '.join(_MAKERS)}"
        )
    return TrajectoryConstraint(word, tuple(reader.read(part, variables) for part in parts))


def translated(constraint: TrajectoryConstraint, formulas: FormulaTranslator, scope: UpVariables = NOTHING) -> Any:
    """Return the constraint as an expression of unified_planning."""
    make = formulas.symbols.environment.expression_manager
    if constraint.word in _MAKERS:
        conditions = [part for part in constraint.parts if not isinstance(part, TrajectoryConstraint)]
        return getattr(make, _MAKERS[constraint.word])(
            *(formulas.condition(condition, scope) for condition in conditions)
        )
    each = list(formulas.bound(constraint.parameters, scope)) if constraint.word == "forall" else [([], scope)]
    parts = [part for part in constraint.parts if isinstance(part, TrajectoryConstraint)]
    return make.And(
        *(
            make.Forall(translated(part, formulas, inner), *variables)
            if variables
            else translated(part, formulas, inner)
            for variables, inner in each
            for part in parts
        )
    )


def types_of(constraint: TrajectoryConstraint) -> Iterator[str]:
    """Yield the types that a constraint's quantifiers range over."""
    yield from (type_name for parameter in constraint.parameters for type_name in parameter.types)
    for part in constraint.parts:
        yield from types_of(part) if isinstance(part, TrajectoryConstraint) else quantified(part)
