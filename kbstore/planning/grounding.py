"""Operators with objects for their parameters."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property

from kbstore import names
from kbstore.errors import InvalidKnowledge
from kbstore.evaluation.interpretation import Interpretation
from kbstore.evaluation.substitution import instantiated
from kbstore.model.actions import Action
from kbstore.model.domain import Domain
from kbstore.model.formulas import And, Atom, Forall, Formula, Parameter, Preference, Timing, Truism
from kbstore.model.symbols import arity_problem
from kbstore.names import bracketed, check_is_text, key


@dataclass(frozen=True)
class GroundAction:
    """An operator with an object for each parameter.

    `arguments` are the objects' names as they were given; `bindings` maps each parameter's name, without the
    question mark, to the object, both as keys (`kbstore.names.key`).
    """

    action: Action
    arguments: tuple[str, ...]
    bindings: Mapping[str, str]

    def __str__(self) -> str:
        return bracketed(self.action.name, *self.arguments)

    @cached_property
    def spellings(self) -> Mapping[str, str]:
        """The object of each parameter as it was given; parameters as keys."""
        return dict(zip(map(key, (p.name for p in self.action.parameters)), self.arguments, strict=True))

    def conditions(self, timing: Timing) -> list[Formula]:
        """Return the conditions of a part of the action with objects for its parameters.

        Conjunctions are split into their parts, and preferences left out (`required`).
        """
        return [
            instantiated(part, self.spellings)
            for condition in self.action.conditions_at(timing)
            for part in required(condition)
        ]


def ground(domain: Domain, name: str, arguments: tuple[str, ...], world: Interpretation) -> GroundAction:
    """Return the operator of that name with objects, which must exist in the world and be of its parameters' types.

    Raises `UnknownSymbol` if the domain has no such operator, and `InvalidKnowledge` with everything that is wrong
    with the arguments.
    """
    action = domain.action(name)
    for fluent in domain.object_fluents.keys() & action.symbols if domain.object_fluents else ():
        raise InvalidKnowledge(f"the operator {action.name} cannot be applied: {domain.uncomputed[fluent]}")
    check_is_text("name of an object", *arguments)
    given = bracketed(action.name, *arguments)
    wrong = arity_problem(Atom(action.name, arguments), action)
    violations = [wrong] if wrong else []
    for argument, parameter in zip(arguments, action.parameters, strict=False):
        wrong = _mismatch(domain, argument, parameter, world)
        if wrong:
            violations.append(f"{given}: ?{parameter.name} is {wrong}")
    if violations:
        raise InvalidKnowledge(*violations)
    bindings = {key(p.name): key(argument) for p, argument in zip(action.parameters, arguments, strict=True)}
    return GroundAction(action, arguments, bindings)


def _mismatch(domain: Domain, argument: str, parameter: Parameter, world: Interpretation) -> str | None:
    """Return the problem of an argument, as the words after "?wp is"; None if it fits."""
    expected = f"an object of the type {parameter.type_text} is expected"
    problem = names.problem(argument)
    if problem:
        return f"{argument!r:.80}, which {problem}; {expected}"
    type_name = world.type_of(key(argument))
    if type_name is None:
        return f"{argument}, which does not exist; {expected}"
    if not domain.is_subtype(type_name, parameter.types):
        spelling = domain.type_spelling(type_name) if domain.knows_type(type_name) else type_name
        return f"{argument}, which is of the type {spelling}; {expected}"
    return None


def required(condition: Formula) -> Iterator[Formula]:
    """Yield the parts of a conjunction, without truisms and preferences.

    A preference never keeps an action from being applied (PDDL 3.0).
    """
    match condition:
        case And(parts):
            for part in parts:
                yield from required(part)
        case Forall(parameters, part):
            parts = tuple(required(part))
            if parts:
                yield Forall(parameters, parts[0] if len(parts) == 1 else And(parts))
        case Truism() | Preference():
            pass
        case _:
            yield condition
