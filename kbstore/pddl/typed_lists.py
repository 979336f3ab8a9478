"""Reads typed lists, ``?r - robot ?from ?to - waypoint``, in all the spellings of real files."""

from collections.abc import Iterator
from typing import NamedTuple

from kbstore.model.domain import ROOT_TYPE
from kbstore.model.formulas import Parameter, Types, Variables
from kbstore.names import key
from kbstore.pddl.scope import Scope
from kbstore.pddl.sexpr import Group, node_text


class Typed(NamedTuple):
    """A name in a typed list with its types, as written (none where none are written), and their places."""

    place: int
    name: str
    types: Types = ()
    types_place: int = -1


def read_typed_list(scope: Scope, group: Group, start: int) -> Iterator[Typed]:
    """Yield each name of a typed list with its types.

    Reads ``- type`` also where it is glued: ``?x -type``, and ``wp0- waypoint`` if the next word can only be a type.
    Raises `PddlSyntaxError`.
    """
    pending: list[tuple[int, str]] = []
    index = start
    while index < len(group):
        node = group[index]
        types: Types | None = None
        if isinstance(node, Group):
            raise scope.error(f"a name is expected here, not {node_text(node, 60)}", group, index)
        if node == "-":
            index += 1
            types = _types(scope, group, index)
        elif node[0] == "-" and pending:
            types = (node[1:],)
        elif node[-1] == "-" and _ends_in_type(scope, group, index):
            pending.append((index, node[:-1]))
            index += 1
            types = _types(scope, group, index)
        else:
            pending.append((index, node))
        index += 1
        if types is not None:
            if not pending and not _begins_line(scope, group, index - 2):
                raise scope.error("'-' gives the type of the names before it, but there are none", group, index - 2)
            yield from (Typed(place, name, types, index - 1) for place, name in pending)
            pending.clear()
    yield from (Typed(place, name) for place, name in pending)


def read_parameters(scope: Scope, group: Group, start: int = 0, *, positional: bool = False) -> tuple[Parameter, ...]:
    """Read the typed variables of a group.

    A name may occur in the list twice where the parameters are `positional`, as in the declaration of a predicate
    (rule P4). Raises `PddlSyntaxError`; reports unknown types.
    """
    parameters: list[Parameter] = []
    for index, variable, types, types_place in read_typed_list(scope, group, start):
        if variable[0] != "?" or len(variable) == 1:
            raise scope.error(f"a variable is expected here, with a name after its '?', not {variable}", group, index)
        name = variable[1:]
        if not positional and key(name) in (key(parameter.name) for parameter in parameters):
            raise scope.error(f"the variable {variable} is declared twice in this list", group, index)
        known = tuple(scope.type_name(type_name, group, types_place) for type_name in types)
        parameters.append(Parameter(name, known or (ROOT_TYPE,)))
    return tuple(parameters)


def bound(variables: Variables, parameters: tuple[Parameter, ...]) -> Variables:
    """Return the bound variables together with more, which parameters bind."""
    return {**variables, **{key(parameter.name): parameter.types for parameter in parameters}}


def _types(scope: Scope, group: Group, index: int) -> Types:
    if index >= len(group):
        raise scope.error("a type is missing after '-'", group, index)
    node = group[index]
    if isinstance(node, str):
        if node == "-":
            raise scope.error("a type is expected after '-'", group, index)
        return (node,)
    if node.word(0) != "either" or len(node) < 2 or not all(isinstance(part, str) for part in node):
        raise scope.error(f"a type, or (either type ...), is expected here, not {node_text(node, 60)}", group, index)
    return tuple(node[1:])  # type: ignore[arg-type]


def _begins_line(scope: Scope, group: Group, index: int) -> bool:
    """Return whether a word begins a line: some generators write ``- type`` there for a type without objects."""
    offset = scope.source.offset(group, index)
    _, column = scope.source.place(offset)
    return not scope.source.text[offset - column + 1 : offset].strip()


def _ends_in_type(scope: Scope, group: Group, index: int) -> bool:
    """Return whether the word with a '-' glued to its end is followed by a type: nothing else can be there."""
    if index + 1 >= len(group) or len(group[index]) < 2:
        return False
    if index + 2 < len(group) and group[index + 2] == "-":
        return False
    following = group[index + 1]
    if isinstance(following, Group):
        return following.word(0) == "either"
    return following[0] != "?" if str(group[index])[0] == "?" else scope.knows_type(following)
