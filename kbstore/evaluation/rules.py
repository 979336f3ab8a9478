"""The rules of derived predicates: what they depend on, and their bodies as joins (rule V9)."""

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from itertools import product

from kbstore.errors import InvalidKnowledge
from kbstore.evaluation.interpretation import Arguments
from kbstore.evaluation.wellformed import check
from kbstore.model.domain import Domain, Signature
from kbstore.model.formulas import (
    And,
    Atom,
    Comparison,
    Defined,
    Exists,
    Forall,
    Formula,
    Imply,
    IsA,
    Not,
    Or,
    Preference,
    Types,
    Variables,
    variables_of,
    walk,
)
from kbstore.model.stratification import strata
from kbstore.names import is_wildcard, key

_MAX_CLAUSES = 64
"""In a rule whose disjunctions multiply to more clauses, some disjunctions remain as they are."""


@dataclass(frozen=True)
class Clause:
    """One way to derive a predicate: the head's variables, all variables, and what must be true of them."""

    head: tuple[str, ...]
    variables: Variables
    conjuncts: tuple[Formula, ...]
    reads: tuple[frozenset[str], ...]
    """The derived predicates that each conjunct reads."""


@dataclass(frozen=True)
class Rule:
    """A rule with the types of its head's variables, and as clauses."""

    head: tuple[str, ...]
    variables: Variables
    condition: Formula
    clauses: tuple[Clause, ...]

    def bindings(self, row: Arguments) -> dict[str, str] | None:
        """The bindings that make the head this row; None if there are none."""
        bindings: dict[str, str] = {}
        for variable, name in zip(self.head, row, strict=True):
            if bindings.setdefault(variable, name) != name:
                return None
        return bindings


@dataclass(frozen=True)
class Program:
    """The rules of a domain, ready to be evaluated. Predicates are keys."""

    rules: Mapping[str, tuple[Rule, ...]]
    ranges: Mapping[str, tuple[Types, ...]]
    """The types of each predicate's parameters."""
    dependencies: Mapping[str, frozenset[str]]
    """The derived predicates that each derived predicate reads."""
    strata: tuple[frozenset[str], ...]
    numeric: frozenset[str]
    """The predicates whose own rules compare numbers, and so may be unknown in a closed world."""

    def reachable(self, name: str) -> set[str]:
        """The derived predicates on which one depends, itself included."""
        found, todo = {name}, [name]
        while todo:
            more = self.dependencies[todo.pop()] - found
            found |= more
            todo.extend(more)
        return found

    def needed(self, name: str) -> list[frozenset[str]]:
        """The strata on which a predicate depends, in the order in which they are evaluated."""
        reachable = self.reachable(name)
        return [stratum for stratum in self.strata if stratum & reachable]


@lru_cache(maxsize=64)
def program(domain: Domain) -> Program:
    """Compile the rules of a domain.

    Raises `InvalidKnowledge` or `UnknownSymbol` for rules that are not well-formed or not stratified.
    """
    for name, rules in domain.rules.items():
        # a predicate that cannot be computed is never asked for
        for rule in rules if name not in domain.uncomputed else ():
            check(rule.condition, domain, {p.name: p.name for p in rule.head.parameters})
    order = strata(domain)
    compiled = {
        name: tuple(
            _compiled(rule.head, alternative, domain) for rule in rules for alternative in _alternatives(rule.condition)
        )
        for name, rules in domain.rules.items()
    }
    return Program(
        compiled,
        {name: _types(domain.predicate_signature(name)) for name in domain.rules},
        {
            name: frozenset().union(*(_reads(rule.condition, domain) for rule in rules))
            for name, rules in compiled.items()
        },
        tuple(order),
        frozenset(name for name, rules in compiled.items() if any(_compares(rule.condition) for rule in rules)),
    )


def _types(signature: Signature) -> tuple[Types, ...]:
    return tuple(tuple(map(key, p.types)) for p in signature.parameters)


def _alternatives(condition: Formula) -> tuple[Formula, ...]:
    return condition.parts if isinstance(condition, Or) else (condition,)


def _compiled(own: Signature, condition: Formula, domain: Domain) -> Rule:
    """Compile a rule; its head's variables are of the types of both the rule and the predicate's declaration."""
    head = tuple(key(p.name) for p in own.parameters)
    declared = domain.predicate_signature(own.name)
    if len(head) != len(declared.parameters):
        raise InvalidKnowledge(f"a rule derives {own}, but the predicate is declared as {declared}")
    variables: dict[str, Types] = {}
    restrictions: list[Formula] = []
    for variable, *both in zip(head, _types(declared), _types(own), strict=True):
        for types in both:
            if types != variables.setdefault(variable, types) and "object" not in types:
                restrictions.append(Or(tuple(IsA(f"?{variable}", type_name) for type_name in types)))
    if restrictions:
        condition = And((*restrictions, condition))
    clauses = tuple(
        Clause(head, {**variables, **inner}, conjuncts, tuple(_reads(c, domain) for c in conjuncts))
        for inner, conjuncts in bodies(condition, True, _liftable(condition, variables))
    )
    return Rule(head, variables, condition, clauses)


def _reads(condition: Formula, domain: Domain) -> frozenset[str]:
    """The derived predicates in a condition."""
    nodes = (occurrence.node for occurrence in walk(condition, {}))
    return frozenset(key(node.name) for node in nodes if isinstance(node, Atom) and domain.is_derived(node.name))


def _compares(condition: Formula) -> bool:
    return any(isinstance(occurrence.node, Comparison) for occurrence in walk(condition, {}))


def _liftable(condition: Formula, variables: Variables) -> frozenset[str]:
    """Return the quantified variables that can be joined with the head's: declared once, and nowhere used outside."""
    declared = Counter(list(variables))
    loose = set[str]()
    for occurrence in walk(condition, variables):
        match occurrence.node:
            case Exists(parameters) | Forall(parameters):
                declared.update(key(p.name) for p in parameters)
            case Atom(_, arguments) | Defined(Atom(_, arguments)):
                loose.update(key(a[1:]) for a in arguments if is_wildcard(a) and key(a[1:]) not in occurrence.scope)
            case IsA(name) if is_wildcard(name):
                loose.update({key(name[1:])} - set(occurrence.scope))
    return frozenset(variable for variable, times in declared.items() if times == 1 and variable not in loose)


_Body = tuple[Variables, tuple[Formula, ...]]


def bodies(condition: Formula, positive: bool, liftable: frozenset[str]) -> list[_Body]:
    """Return the disjunctive normal form of a condition (or, if not `positive`, of its negation), as far as it pays.

    Existential quantifiers (and negated universal ones) are dissolved if all of their variables are `liftable`.
    """
    match condition:
        case Not(part):
            return bodies(part, not positive, liftable)
        case Preference(_, part):
            return bodies(part, positive, liftable)
        case Imply(premise, conclusion):
            return bodies(Or((Not(premise), conclusion)), positive, liftable)
        case And(parts) | Or(parts):
            alternatives = [bodies(part, positive, liftable) for part in parts]
            if isinstance(condition, Or) is positive:
                return [body for found in alternatives for body in found]
            return _multiplied(parts, alternatives, positive)
        case Exists(parameters, part) | Forall(parameters, part) if isinstance(condition, Exists) is positive:
            own = variables_of(parameters)
            if liftable.issuperset(own):
                return [({**own, **inner}, body) for inner, body in bodies(part, positive, liftable)]
    return [({}, (condition if positive else Not(condition),))]


def _multiplied(parts: tuple[Formula, ...], alternatives: list[list[_Body]], positive: bool) -> list[_Body]:
    """Return every choice of one body of each part; if these would be too many, some parts remain as they are."""
    number = 1
    for i, found in enumerate(alternatives):
        if number * len(found) > _MAX_CLAUSES:
            alternatives[i] = [({}, (parts[i] if positive else Not(parts[i]),))]
        number *= len(alternatives[i])
    return [
        ({k: v for inner, _ in chosen for k, v in inner.items()}, tuple(c for _, body in chosen for c in body))
        for chosen in product(*alternatives)
    ]
