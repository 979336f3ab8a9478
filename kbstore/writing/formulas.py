"""Checks formulas that are to be recorded, such as goals (rule D1), and spells names as first written (rule D3)."""

from collections.abc import Iterator
from itertools import chain

from kbstore.errors import KbStoreError
from kbstore.messages import KnowledgeType
from kbstore.model.expressions import NumericExpression, atoms_of
from kbstore.model.formulas import (
    Atom,
    Comparison,
    Defined,
    Exists,
    Forall,
    Formula,
    IsA,
    Parameter,
    Same,
    children,
    map_children,
    names_in,
)
from kbstore.names import is_wildcard, key
from kbstore.writing.resolution import NameResolver, violations_of

VIOLATION_METRIC = "is-violated"
"""PDDL 3.0's count of a preference's violations, which appears in metrics like a function."""

_UNBOUND: frozenset[str] = frozenset()


def condition_violations(
    resolver: NameResolver, condition: Formula, t: int, bound: frozenset[str] = _UNBOUND
) -> Iterator[str]:
    """Yield the violations of a condition at a time, each in one sentence; `bound` are the keys of bound variables."""
    match condition:
        case Atom():
            yield from _atom_violations(resolver, KnowledgeType.FACT, condition, t, bound)
        case Defined(function):
            yield from _atom_violations(resolver, KnowledgeType.FUNCTION, function, t, bound)
        case Comparison():
            yield from expression_violations(resolver, condition.left, t, bound)
            yield from expression_violations(resolver, condition.right, t, bound)
        case Same():
            yield from _term_violations(resolver, condition.left, condition.right, t=t, bound=bound)
        case IsA():
            yield from _term_violations(resolver, condition.name, t=t, bound=bound)
        case Exists() | Forall():
            for parameter in condition.parameters:
                for type_name in parameter.types:
                    if resolver.domain is not None and not resolver.domain.knows_type(type_name):
                        yield f"?{parameter.name} - {type_name}: the domain has no type {type_name}"
            bound |= {key(parameter.name) for parameter in condition.parameters}
    for part in children(condition):
        yield from condition_violations(resolver, part, t, bound)


def expression_violations(
    resolver: NameResolver, expression: NumericExpression, t: int, bound: frozenset[str] = _UNBOUND
) -> Iterator[str]:
    """Yield the violations of the functions that an expression reads, each in one sentence."""
    for atom in atoms_of(expression):
        if key(atom.name) != VIOLATION_METRIC:
            yield from _atom_violations(resolver, KnowledgeType.FUNCTION, atom, t, bound)


def symbol_violations(resolver: NameResolver, expression: NumericExpression) -> Iterator[str]:
    """Yield the violations of the symbols of the functions that an expression reads, regardless of objects."""
    for atom in atoms_of(expression):
        if key(atom.name) != VIOLATION_METRIC:
            try:
                resolver.symbols.ordered(KnowledgeType.FUNCTION, atom.name, atom.arguments, ())
            except KbStoreError as error:
                yield from violations_of(error, atom)


def _atom_violations(
    resolver: NameResolver, kind: KnowledgeType, atom: Atom, t: int, bound: frozenset[str]
) -> Iterator[str]:
    try:
        resolver.symbols.ordered(kind, atom.name, atom.arguments, ())
        signature = resolver.symbols.signature(kind, atom.name)
    except KbStoreError as error:
        yield from violations_of(error, atom)
        return
    types = [p.types for p in signature.parameters] if signature else [("object",)] * len(atom.arguments)
    fitting = [pair for pair in zip(atom.arguments, types, strict=True) if pair[0][:1] != "("]
    # values of object fluents are not computed, so their types are not checked; objects in their terms have to exist
    fitting += [(name, ("object",)) for term in atom.arguments if term[:1] == "(" for name in names_in(term)]
    ground = [pair for pair in fitting if not _is_bound(pair[0], bound)]
    yield from resolver.object_violations(str(atom), [name for name, _ in ground], [types for _, types in ground], t)


def _term_violations(resolver: NameResolver, *terms: str, t: int, bound: frozenset[str]) -> Iterator[str]:
    for term in chain.from_iterable(map(names_in, terms)):
        if not _is_bound(term, bound):
            yield from resolver.object_violations(term, [term], [("object",)], t)


def _is_bound(term: str, bound: frozenset[str]) -> bool:
    return term[:1] == "?" and key(term[1:]) in bound


# -- canonical form -------------------------------------------------------------------------------------------


def canonical_condition(resolver: NameResolver, condition: Formula) -> Formula:
    """Spell symbols and types as declared, and objects as first named, in a condition that has been checked.

    Without a domain, the use of a symbol in a formula may be its first, which fixes its arity (rule D2).
    """
    match condition:
        case Atom():
            return _canonical_atom(resolver, KnowledgeType.FACT, condition)
        case Defined(function):
            return Defined(_canonical_atom(resolver, KnowledgeType.FUNCTION, function))
        case Comparison(comparison, left, right):
            return Comparison(comparison, canonical_expression(resolver, left), canonical_expression(resolver, right))
        case Same(left_term, right_term):
            return Same(canonical_term(resolver, left_term), canonical_term(resolver, right_term))
        case IsA(name, type_name):
            return IsA(canonical_term(resolver, name), type_name)
        case Exists(parameters, part) | Forall(parameters, part):
            condition = type(condition)(tuple([_canonical_parameter(resolver, p) for p in parameters]), part)
    return map_children(condition, lambda part: canonical_condition(resolver, part))


def canonical_expression(resolver: NameResolver, expression: NumericExpression) -> NumericExpression:
    """Spell symbols as declared, and objects as first named, in a numeric expression that has been checked."""
    kind = KnowledgeType.FUNCTION
    return tuple([_canonical_atom(resolver, kind, token) if isinstance(token, Atom) else token for token in expression])


def canonical_term(resolver: NameResolver, name: str) -> str:
    """Return an object's name as first written; variables and object fluents' terms stay as they are."""
    return name if is_wildcard(name) or name[0] == "(" else resolver.object(name).timeline.spelling


def _canonical_atom(resolver: NameResolver, kind: KnowledgeType, atom: Atom) -> Atom:
    if key(atom.name) == VIOLATION_METRIC:
        return atom
    name, arguments = resolver.symbols.ordered(kind, atom.name, atom.arguments, ())
    resolver.symbols.learn(kind, name, len(arguments), ())
    return Atom(name, tuple([canonical_term(resolver, argument) for argument in arguments]))


def _canonical_parameter(resolver: NameResolver, parameter: Parameter) -> Parameter:
    if resolver.domain is None:
        return parameter
    return Parameter(parameter.name, tuple(map(resolver.domain.type_spelling, parameter.types)))
