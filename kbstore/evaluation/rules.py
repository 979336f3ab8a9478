"""The rules of derived predicates: what they depend on, their strata, and their bodies as joins (rule V9).

Stratification is that of K. R. Apt, H. A. Blair and A. Walker, "Towards a theory of declarative knowledge", 1988: no
derived predicate may depend on itself through a negation. The strata are the strongly connected components of the
dependencies (R. Tarjan, "Depth-first search and linear graph algorithms", SIAM J. Comput. 1(2), 1972).
"""

from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import lru_cache
from itertools import product
from typing import NamedTuple

from kbstore.errors import InvalidKnowledge
from kbstore.evaluation.interpretation import Arguments
from kbstore.evaluation.joins import Types, Variables, variables_of
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
)
from kbstore.names import is_wildcard, key

_MAX_CLAUSES = 64
"""A rule whose disjunctions multiply to more clauses keeps some of them as they are."""


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


class Occurrence(NamedTuple):
    """A condition within a condition: whether under an even number of negations, and the variables in its scope."""

    node: Formula
    positive: bool
    scope: Variables


def walk(condition: Formula, scope: Variables, positive: bool = True) -> Iterator[Occurrence]:
    """A condition and all conditions within it."""
    todo = [Occurrence(condition, positive, scope)]
    while todo:
        occurrence = todo.pop()
        yield occurrence
        positive, scope = occurrence.positive, occurrence.scope
        match occurrence.node:
            case Not(part):
                todo.append(Occurrence(part, not positive, scope))
            case And(parts) | Or(parts):
                todo.extend(Occurrence(part, positive, scope) for part in parts)
            case Imply(premise, conclusion):
                todo += [Occurrence(premise, not positive, scope), Occurrence(conclusion, positive, scope)]
            case Exists(parameters, part) | Forall(parameters, part):
                todo.append(Occurrence(part, positive, {**scope, **variables_of(parameters)}))
            case Preference(_, part):
                todo.append(Occurrence(part, positive, scope))


def strata(domain: Domain) -> list[frozenset[str]]:
    """The derived predicates of a domain, as keys, in the order in which they are evaluated.

    Each stratum depends only on itself, without negation, and on those before it. Raises `InvalidKnowledge` where a
    derived predicate depends on itself through a negation.
    """
    positive: dict[str, set[str]] = {name: set() for name in domain.rules}
    negative: dict[str, set[str]] = {name: set() for name in domain.rules}
    for name, rules in domain.rules.items():
        for rule in rules:
            for occurrence in walk(rule.condition, variables_of(rule.head.parameters)):
                if isinstance(occurrence.node, Atom) and domain.is_derived(occurrence.node.name):
                    (positive if occurrence.positive else negative)[name].add(key(occurrence.node.name))
    components = _components({name: sorted(positive[name] | negative[name]) for name in domain.rules})
    violations = [
        f"the derived predicate {domain.rules[name][0].head.name} depends on itself through the negation of "
        f"{', '.join(sorted(negative[name] & component))}; derived predicates must be stratified, so that what is "
        "negated can be decided first"
        for component in components
        for name in sorted(component)
        if negative[name] & component
    ]
    if violations:
        raise InvalidKnowledge(*violations)
    return components


@lru_cache(maxsize=64)
def program(domain: Domain) -> Program:
    """The rules of a domain, ready to be evaluated.

    Raises `InvalidKnowledge` or `UnknownSymbol` for rules that are not well-formed or not stratified.
    """
    for rules in domain.rules.values():
        for rule in rules:
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
    """The rule, its head's variables restricted to the types of both the rule and the predicate's declaration."""
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
        for inner, conjuncts in _bodies(condition, True, _liftable(condition, variables))
    )
    return Rule(head, variables, condition, clauses)


def _reads(condition: Formula, domain: Domain) -> frozenset[str]:
    """The derived predicates in a condition."""
    nodes = (occurrence.node for occurrence in walk(condition, {}))
    return frozenset(key(node.name) for node in nodes if isinstance(node, Atom) and domain.is_derived(node.name))


def _compares(condition: Formula) -> bool:
    return any(isinstance(occurrence.node, Comparison) for occurrence in walk(condition, {}))


def _liftable(condition: Formula, variables: Variables) -> frozenset[str]:
    """The quantified variables that can be joined with the head's: declared once, and nowhere used outside."""
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


def _bodies(condition: Formula, positive: bool, liftable: frozenset[str]) -> list[_Body]:
    """The disjunctive normal form of a condition (or, if not `positive`, of its negation), as far as it pays.

    Quantifiers whose variables are `liftable` are dissolved where they stand for an existence.
    """
    match condition:
        case Not(part):
            return _bodies(part, not positive, liftable)
        case Preference(_, part):
            return _bodies(part, positive, liftable)
        case Imply(premise, conclusion):
            return _bodies(Or((Not(premise), conclusion)), positive, liftable)
        case And(parts) | Or(parts):
            alternatives = [_bodies(part, positive, liftable) for part in parts]
            if isinstance(condition, Or) is positive:
                return [body for bodies in alternatives for body in bodies]
            return _multiplied(parts, alternatives, positive)
        case Exists(parameters, part) | Forall(parameters, part) if isinstance(condition, Exists) is positive:
            own = variables_of(parameters)
            if liftable.issuperset(own):
                return [({**own, **inner}, body) for inner, body in _bodies(part, positive, liftable)]
    return [({}, (condition if positive else Not(condition),))]


def _multiplied(parts: tuple[Formula, ...], alternatives: list[list[_Body]], positive: bool) -> list[_Body]:
    """Every choice of one body of each part, unless these are too many: then parts with a choice stay as they are."""
    number = 1
    for i, bodies in enumerate(alternatives):
        if number * len(bodies) > _MAX_CLAUSES:
            alternatives[i] = [({}, (parts[i] if positive else Not(parts[i]),))]
        number *= len(alternatives[i])
    return [
        ({k: v for inner, _ in chosen for k, v in inner.items()}, tuple(c for _, body in chosen for c in body))
        for chosen in product(*alternatives)
    ]


def _components(graph: Mapping[str, list[str]]) -> list[frozenset[str]]:
    """The strongly connected components of a graph, each after those that it leads to (Tarjan, not recursive)."""
    components: list[frozenset[str]] = []
    order: dict[str, int] = {}  # when each node was first seen
    low: dict[str, int] = {}  # the earliest seen node of the path to which each node leads
    path: dict[str, None] = {}
    for root in graph:
        todo = [] if root in order else [(root, iter(graph[root]))]
        while todo:
            node, successors = todo[-1]
            if node not in order:
                order[node] = low[node] = len(order)
                path[node] = None
            fresh = next((other for other in successors if other not in order or other in path), None)
            if fresh is not None and fresh not in order:
                todo.append((fresh, iter(graph[fresh])))
            elif fresh is not None:
                low[node] = min(low[node], order[fresh])
            else:
                todo.pop()
                if todo:
                    above = todo[-1][0]
                    low[above] = min(low[above], low[node])
                if low[node] == order[node]:
                    component = set[str]()
                    while node not in component:
                        component.add(path.popitem()[0])
                    components.append(frozenset(component))
    return components
