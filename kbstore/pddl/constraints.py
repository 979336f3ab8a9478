"""Reads trajectory constraints (PDDL 3.0), which are checked and stored as text."""

from collections.abc import Iterator
from dataclasses import dataclass

from kbstore.model.formulas import Variables
from kbstore.pddl.conditions import MAX_DEPTH, TRAJECTORY, ConditionReader
from kbstore.pddl.expressions import is_number
from kbstore.pddl.scope import NO_VARIABLES, Scope
from kbstore.pddl.sexpr import Group, node_text
from kbstore.pddl.typed_lists import bound

_SHAPES = {
    "always": "c",
    "sometime": "c",
    "at-most-once": "c",
    "within": "nc",
    "sometime-after": "cc",
    "sometime-before": "cc",
    "always-within": "ncc",
    "hold-during": "nnc",
    "hold-after": "nc",
}
"""The arguments of each operator: numbers (n) and conditions (c)."""


@dataclass
class ConstraintReader:
    """Reads a ``(:constraints ...)`` section."""

    scope: Scope
    conditions: ConditionReader

    def read(self, section: Group) -> list[str]:
        """Read the constraints, each as PDDL text. Raises `PddlSyntaxError`; reports symbols that do not fit."""
        return [node_text(constraint) for constraint in self._parts(section)]

    def _parts(self, section: Group) -> Iterator[Group]:
        for index in range(1, len(section)):
            constraint = section[index]
            if not isinstance(constraint, Group):
                raise self.scope.error(f"a constraint is in brackets, not {constraint}", section, index)
            for part in self.conditions.groups_of(constraint) if constraint.word(0) == "and" else [constraint]:
                if part:
                    self._check(part, NO_VARIABLES, 0)
                    yield part

    def _check(self, group: Group, variables: Variables, depth: int) -> None:
        if depth > MAX_DEPTH:
            raise self.scope.error(f"constraints nested deeper than {MAX_DEPTH} levels cannot be read", group)
        word = group.word(0)
        if word == "and":
            for part in self.conditions.groups_of(group):
                self._check(part, variables, depth + 1)
        elif word == "forall":
            parameters, part = self.conditions.quantified(group)
            self._check(part, bound(variables, parameters), depth + 1)
        elif word == "preference":
            self._check(self.conditions.preference(group)[1], variables, depth + 1)
        elif (word, group.word(1)) == ("at", "end") and len(group) == 3 and isinstance(group[2], Group):
            self.conditions.read(group[2], variables, depth + 1)
        elif word in _SHAPES:
            self._check_shape(group, variables, depth)
        else:
            raise self.scope.error(
                f"{node_text(group, 60)} is not a constraint; there are {', '.join(sorted(TRAJECTORY))}, at end, "
                "and, forall and preference",
                group,
            )

    def _check_shape(self, group: Group, variables: Variables, depth: int) -> None:
        shape = _SHAPES[group.word(0)]
        if len(group) != len(shape) + 1:
            raise self.scope.error(
                f"({group.word(0)} ...) takes {len(shape)} operands, not {len(group) - 1}: {node_text(group, 60)}",
                group,
            )
        for index, kind in enumerate(shape, 1):
            node = group[index]
            if kind == "n" and not is_number(node):
                raise self.scope.error(f"a number is expected here, not {node_text(node, 60)}", group, index)
            if kind == "c":
                if not isinstance(node, Group):
                    raise self.scope.error(f"a condition in brackets is expected here, not {node}", group, index)
                self.conditions.read(node, variables, depth + 1)
