"""Answers queries: finds the objects for the free variables for which a condition is true (rule V11).

A query is brought into disjunctive normal form. In each part, the atoms that must be true are joined
(`kbstore.evaluation.joins`), and the rest is evaluated for each binding that the join finds.
"""

from collections.abc import Collection, Iterator, Mapping, Sequence

from kbstore.errors import InvalidKnowledge
from kbstore.evaluation.evaluator import Evaluation
from kbstore.evaluation.interpretation import ListedInterpretation
from kbstore.evaluation.joins import Relation, assignments, guards
from kbstore.evaluation.rules import bodies
from kbstore.messages.enums import Truth
from kbstore.model.domain import Domain
from kbstore.model.expressions import Atom, atoms_of
from kbstore.model.formulas import (
    And,
    Comparison,
    Defined,
    Exists,
    Formula,
    Imply,
    IsA,
    Not,
    Or,
    Preference,
    Types,
    Variables,
    variables_of,
)
from kbstore.names import is_wildcard, key

ANY: Types = ("",)
"""The types of a variable that may be anything: without a domain, arguments need not exist (rule D2)."""


def ranges(condition: Formula, variables: Mapping[str, Types | None], domain: Domain | None) -> Variables:
    """Return the types of the objects that each free variable may be, by its key.

    `variables` has the types that a query gives. Raises `InvalidKnowledge` for a variable without a type that is not
    an argument of something true or defined wherever the condition is true.
    """
    binding = _binding(condition, True)
    found: dict[str, Types] = {}
    for variable, types in variables.items():
        if types is None and variable not in binding:
            raise InvalidKnowledge(
                f"?{variable} may be any object where the condition is true without it; give its type where it first "
                f"occurs: ?{variable} - object"
            )
        found[variable] = types or _declared(variable, binding, domain)
    return found


def find(condition: Formula, variables: Variables, world: ListedInterpretation) -> list[tuple[str, ...]]:
    """Return the objects for the variables for which a condition is true, without repetition, in their order."""
    evaluation = Evaluation(world)

    def objects(types: Types) -> Collection[str]:
        return _Anything() if types == ANY else evaluation.objects(types)

    found: set[tuple[str, ...]] = set()
    for _, conjuncts in bodies(condition, True, frozenset()):
        certain = [(atom, evaluation.rows(atom)) for conjunct in conjuncts for atom in guards(conjunct)]
        certain += [(atom, Relation(world.defined(key(atom.name)))) for atom in _compared(conjuncts)]
        # an atom that has been joined is true, unless it has a bare wildcard, whose object may not be of its type
        part = And(tuple(rest for rest in conjuncts if not _is_joined(rest, variables)))
        for bindings in assignments(variables, certain, {}, objects):
            names = tuple([bindings[variable] for variable in variables])
            if names not in found and (not part.parts or evaluation.evaluate(part, bindings) is Truth.TRUE):
                found.add(names)
    return sorted(found)


def _is_joined(conjunct: Formula, variables: Variables) -> bool:
    return isinstance(conjunct, Atom) and all(
        not is_wildcard(argument) or key(argument[1:]) in variables for argument in conjunct.arguments
    )


class _Anything(Collection[str]):
    """All names: an undeclared argument may be anything."""

    def __contains__(self, name: object) -> bool:
        return True

    def __iter__(self) -> Iterator[str]:
        raise AssertionError("a variable that may be anything is always an argument")

    def __len__(self) -> int:
        return 1 << 30


def _compared(conjuncts: Sequence[Formula]) -> Iterator[Atom]:
    """Yield the functions with variables that are defined wherever all of the conditions are true."""
    for conjunct in conjuncts:
        part = conjunct.part if isinstance(conjunct, Not) else conjunct
        if isinstance(part, Comparison):
            functions = atoms_of((*part.left, *part.right))
            yield from (function for function in functions if any(map(is_wildcard, function.arguments)))
        elif isinstance(part, Defined) and part is conjunct:
            yield part.function


_Binding = dict[str, list[Atom]]
"""The atoms by which each variable is bound."""


def _binding(condition: Formula, positive: bool) -> _Binding:
    """Return the variables that are arguments of something true or defined wherever a condition is true (or false)."""
    match condition:
        case Atom():
            return _of((condition,)) if positive else {}
        case Defined(function):
            return _of((function,)) if positive else {}
        case Comparison(_, left, right):
            # where a function is undefined, the comparison is neither true nor false
            return _of((*atoms_of(left), *atoms_of(right)))
        case IsA(name, type_name):
            return {key(name[1:]): []} if positive and type_name and is_wildcard(name) else {}
        case Not(part):
            return _binding(part, not positive)
        case Preference(_, part):
            return _binding(part, positive)
        case Imply(premise, conclusion):
            return _combined([_binding(premise, not positive), _binding(conclusion, positive)], every=positive)
        case And(parts) | Or(parts):
            found = [_binding(part, positive) for part in parts]
            return _combined(found, every=isinstance(condition, Or) is positive)
        case Exists(parameters, part) if positive:
            own = variables_of(parameters)
            return {name: atoms for name, atoms in _binding(part, True).items() if name not in own}
        case _:
            return {}


def _of(atoms: Sequence[Atom]) -> _Binding:
    found: _Binding = {}
    for atom in atoms:
        for argument in atom.arguments:
            if is_wildcard(argument) and len(argument) > 1:
                found.setdefault(key(argument[1:]), []).append(atom)
    return found


def _combined(found: Sequence[_Binding], *, every: bool) -> _Binding:
    """Return the variables that all parts bind, if `every` part has to, or else those that any part binds."""
    names = [set(part) for part in found]
    kept = (set.intersection(*names) if every else set.union(*names)) if names else set()
    return {name: [atom for part in found for atom in part.get(name, ())] for name in sorted(kept)}


def _declared(variable: str, binding: _Binding, domain: Domain | None) -> Types:
    """The types of all parameters that a variable is an argument for."""
    if domain is None:
        return ANY
    declared: dict[str, None] = {}
    for atom in binding[variable]:
        signature = domain.predicate_signatures.get(key(atom.name)) or domain.function_signatures.get(key(atom.name))
        for argument, parameter in zip(atom.arguments, signature.parameters if signature else (), strict=False):
            if is_wildcard(argument) and key(argument[1:]) == variable:
                declared |= dict.fromkeys(map(key, parameter.types))
    return tuple(declared) or ("object",)
