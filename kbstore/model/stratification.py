"""Stratification of derived predicates (rule V9).

After K. R. Apt, H. A. Blair and A. Walker, "Towards a theory of declarative knowledge", 1988: no derived predicate may
depend on itself through a negation. The strata are the strongly connected components of the dependencies (R. Tarjan,
"Depth-first search and linear graph algorithms", SIAM J. Comput. 1(2), 1972).
"""

from collections.abc import Mapping

from kbstore.errors import InvalidKnowledge
from kbstore.model.domain import Domain
from kbstore.model.formulas import Atom, variables_of, walk
from kbstore.names import key


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
