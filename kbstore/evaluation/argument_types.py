"""Refuses arguments of a question that cannot be meant: objects and variables never of the parameter's type (rule V10).

The objects that are bound to variables and to an action's parameters are not checked: where one does not fit, the atom
is absent.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from itertools import permutations
from typing import NamedTuple

from kbstore.errors import InvalidKnowledge
from kbstore.model.domain import ROOT_TYPE, Domain, Signature
from kbstore.model.expressions import NumericExpression, atoms_of
from kbstore.model.formulas import Atom, Comparison, Defined, Formula, Types, Variables, walk
from kbstore.names import is_wildcard, key

MOST_ARGUMENTS = 5
"""The most arguments whose other orders are tried to find out what was meant."""

TypeOf = Callable[[str], str | None]
"""The type of an object, both as keys; None where it does not exist."""


class NamedArgument(NamedTuple):
    """An object that a question names as an argument, and the types that the argument may have.

    Attributes:
        name: The object, as a key.
        types: The types of the parameter, as keys.
        atom: What it is an argument of.
        position: Its index among the arguments.
        signature: The declaration of the atom's symbol.
    """

    name: str
    types: Types
    atom: Atom
    position: int
    signature: Signature


def named_arguments(question: Formula | NumericExpression, domain: Domain | None) -> tuple[NamedArgument, ...]:
    """Return the objects that a question names as arguments of parameters with a type.

    Raises `InvalidKnowledge` for what is wrong in every state: a constant of a type that the parameter excludes, and a
    quantified variable whose type has no subtype in common with the parameter's.
    """
    if domain is None:
        return ()
    found: list[NamedArgument] = []
    for atom, signature, scope in _atoms(question, domain):
        for position, (argument, parameter) in enumerate(zip(atom.arguments, signature.parameters, strict=False)):
            types = tuple(map(key, parameter.types))
            if ROOT_TYPE in types:
                continue
            if not is_wildcard(argument):
                found.append(NamedArgument(key(argument), types, atom, position, signature))
            elif (own := scope.get(key(argument[1:]))) and domain.subtypes(own).isdisjoint(domain.subtypes(types)):
                raise InvalidKnowledge(
                    f"{atom}: {argument} is {_either(own)}, and {_place(position, signature)} is {_either(types)}: "
                    f"{signature}; no type is both"
                )
    constants = domain.constant_types
    check_types([use for use in found if use.name in constants], constants.get, domain)
    return tuple(use for use in found if use.name not in constants)


def check_types(uses: Iterable[NamedArgument], type_of: TypeOf, domain: Domain | None) -> None:
    """Raise `InvalidKnowledge` where an object that exists is of a type that the parameter excludes."""
    for use in uses:
        type_name = type_of(use.name)
        if domain is not None and type_name is not None and not domain.is_subtype(type_name, use.types):
            raise wrong_type(use, type_name, type_of, domain)


def wrong_type(use: NamedArgument, type_name: str, type_of: TypeOf, domain: Domain) -> InvalidKnowledge:
    """Return the error for an object of the wrong type, which suggests the probable meaning."""
    meant = _meant(use, type_of, domain)
    return InvalidKnowledge(
        f"{use.atom}: {use.atom.arguments[use.position]} is {_either((domain.type_spelling(type_name),))}, and "
        f"{_place(use.position, use.signature)} is {_either(use.types)}: {use.signature}"
        + (f"; did you mean {meant}?" if meant else "")
    )


def _meant(use: NamedArgument, type_of: TypeOf, domain: Domain) -> Atom | None:
    """The atom with its arguments in an order in which all of them fit."""
    arguments, parameters = use.atom.arguments, use.signature.parameters
    if len(arguments) > MOST_ARGUMENTS:
        return None

    def fits(argument: str, wanted: Sequence[str]) -> bool:
        type_name = None if is_wildcard(argument) else type_of(key(argument))
        return type_name is None or domain.is_subtype(type_name, wanted)

    for order in permutations(arguments):
        if all(fits(argument, parameter.types) for argument, parameter in zip(order, parameters, strict=True)):
            return Atom(use.atom.name, order)
    return None


def _atoms(question: Formula | NumericExpression, domain: Domain) -> Iterator[tuple[Atom, Signature, Variables]]:
    """The atoms of a question, each with its declaration and the variables in its scope."""
    if isinstance(question, tuple):
        yield from ((atom, domain.function_signature(atom.name), {}) for atom in atoms_of(question))
        return
    for node, _, scope in walk(question, {}):
        match node:
            case Atom():
                yield node, domain.predicate_signature(node.name), scope
            case Defined(function):
                yield function, domain.function_signature(function.name), scope
            case Comparison(_, left, right):
                for function in atoms_of((*left, *right)):
                    yield function, domain.function_signature(function.name), scope


def _place(position: int, signature: Signature) -> str:
    return f"?{signature.parameters[position].name} of {signature.name}"


def _either(types: Types) -> str:
    """Return types as a noun: ``a robot or item``."""
    return f"{'an' if types[0][0] in 'aeiou' else 'a'} {' or '.join(types)}"
