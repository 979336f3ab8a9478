"""Reads queries: conditions whose free variables are asked for (rule V11)."""

from collections.abc import Iterable
from typing import NamedTuple

from kbstore.model.domain import Domain
from kbstore.model.expressions import atoms_of
from kbstore.model.formulas import Atom, Comparison, Defined, Formula, IsA, Types, walk
from kbstore.names import is_wildcard, key
from kbstore.pddl.conditions import ConditionReader
from kbstore.pddl.scope import Scope
from kbstore.pddl.sexpr import Group, Node, SourceText, node_text


class FreeVariable(NamedTuple):
    """A variable that a query asks for, as it is first written; its types, as keys, where it is given any."""

    name: str
    types: Types | None = None


class Query(NamedTuple):
    """A condition, and its free variables in the order in which they first occur."""

    condition: Formula
    variables: tuple[FreeVariable, ...]


def parse_query(text: str, domain: Domain | None = None) -> Query:
    """Read a query: a condition in which a free variable may have a type at its first occurrence.

    ``(not (visited ?w - waypoint))`` asks for waypoints, and ``?w - waypoint`` for all of them. Raises what
    `kbstore.pddl.parse.parse_condition` raises.
    """
    source = SourceText(text)
    context = Scope(source, domain, patterns=True)
    top = source.read()
    group = top[0] if len(top) == 1 and isinstance(top[0], Group) else top
    found = _Finder(context)
    condition = found.read(group)
    if group is top and not _is_typed(group):
        raise context.error(f"{node_text(top, 60)} is not a condition; a condition is in brackets", top, 0)
    variables = tuple(found.variables.values())
    bound = {key(variable.name): variable.types or ("object",) for variable in variables}
    return Query(ConditionReader(context).read(condition, bound), variables)


def query_of(condition: Formula) -> Query:
    """Return the query for the free variables of a condition, none of which has a type."""
    found: dict[str, FreeVariable] = {}
    for node, _, scope in walk(condition, {}):
        for argument in _arguments(node):
            if is_wildcard(argument) and len(argument) > 1 and key(argument[1:]) not in scope:
                found.setdefault(key(argument[1:]), FreeVariable(argument[1:]))
    return Query(condition, tuple(found.values()))


class _Finder:
    """Finds the free variables of a group, and removes their types from it."""

    def __init__(self, context: Scope) -> None:
        self.variables: dict[str, FreeVariable] = {}
        self._context = context

    def read(self, group: Group, bound: frozenset[str] = frozenset()) -> Group:
        """Return the group without the types of free variables."""
        first = group[1] if group.word(0) in ("exists", "forall") and len(group) == 3 else None
        if isinstance(first, Group):
            own = {key(word[1:]) for word in first if isinstance(word, str) and word[:1] == "?"}
            part = group[2]
            return _group(group, [group[0], first, self.read(part, bound | own) if isinstance(part, Group) else part])
        kept: list[Node] = []
        index = 0
        while index < len(group):
            node = group[index]
            index += 1
            if isinstance(node, Group):
                kept.append(self.read(node, bound))
                continue
            kept.append(node)
            if node[:1] != "?" or len(node) == 1 or node.lower() == "?duration" or key(node[1:]) in bound:
                continue
            types: Types | None = None
            if index + 1 < len(group) and group[index] == "-":
                types = self._types(group, index + 1)
                if _is_typed(group):
                    # as a condition of its own, ?w - waypoint asks for the type
                    kept += group[index : index + 2]
                index += 2
            self.variables.setdefault(key(node[1:]), FreeVariable(node[1:], types))
        return _group(group, kept)

    def _types(self, group: Group, index: int) -> Types:
        node = group[index]
        names = [node] if isinstance(node, str) else [word for word in node[1:] if isinstance(word, str)]
        if isinstance(node, Group) and (node.word(0) != "either" or not names):
            raise self._context.error(f"a type is expected after '-', not {node_text(node, 60)}", group, index)
        return tuple(key(self._context.type_name(name, group, index)) for name in names)


def _is_typed(group: Group) -> bool:
    """Return whether a group is a variable or an object with its type, as in ``?w - waypoint``."""
    return len(group) == 3 and group[1] == "-" and isinstance(group[0], str) and isinstance(group[2], str)


def _group(like: Group, children: Iterable[Node]) -> Group:
    made = Group(children)
    made.start = like.start
    return made


def _arguments(node: Formula) -> Iterable[str]:
    match node:
        case Atom(_, arguments) | Defined(Atom(_, arguments)):
            return arguments
        case Comparison(_, left, right):
            return [argument for atom in atoms_of((*left, *right)) for argument in atom.arguments]
        case IsA(name):
            return (name,)
    return ()
