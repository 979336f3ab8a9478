"""Reads conditions, from their groups to the formulas of `kbstore.model.formulas`."""

from collections.abc import Iterator
from dataclasses import dataclass

from kbstore.errors import InvalidKnowledge
from kbstore.messages import ComparisonType, SpecialType
from kbstore.model.formulas import (
    And,
    Comparison,
    Defined,
    Exists,
    Forall,
    Formula,
    Imply,
    IsA,
    Not,
    Or,
    Parameter,
    Preference,
    Same,
    Truism,
    Variables,
)
from kbstore.names import is_wildcard
from kbstore.pddl.expressions import ANY_SPECIAL, is_number, read_expression, read_function
from kbstore.pddl.scope import NO_VARIABLES, Scope
from kbstore.pddl.sexpr import Group, node_text
from kbstore.pddl.typed_lists import bound, read_parameters

MAX_DEPTH = 150
"""Conditions and effects nested deeper than this are refused, so that recursion over them is safe."""

COMPARISONS = {comparison.pddl: comparison for comparison in ComparisonType}

TRAJECTORY = frozenset(
    (
        "always",
        "sometime",
        "within",
        "at-most-once",
        "sometime-after",
        "sometime-before",
        "always-within",
        "hold-during",
        "hold-after",
    )
)
"""The operators of trajectory constraints (PDDL 3.0)."""

UNCERTAIN = ("oneof", "or", "unknown")
"""The operators by which the initial state of a contingent problem constrains unknown atoms."""

_WORDS = frozenset(("and", "or", "not", "imply", "forall", "exists", "preference", *COMPARISONS, *TRAJECTORY))


@dataclass
class ConditionReader:
    """Reads conditions of one text; `specials` are the special numbers that may occur in them."""

    scope: Scope
    specials: frozenset[SpecialType] = ANY_SPECIAL

    def read(self, group: Group, variables: Variables = NO_VARIABLES, depth: int = 0) -> Formula:
        """Read the condition in a group.

        A conjunction within a conjunction, a disjunction within a disjunction and double negations are dissolved.
        Raises `PddlSyntaxError`; reports symbols that do not fit (`Scope.diagnose`).
        """
        if depth > MAX_DEPTH:
            raise self.scope.error(f"conditions nested deeper than {MAX_DEPTH} levels cannot be read", group)
        negative, word = False, group.word(0)
        while word == "not" and not self.is_atom(group):
            group = self._only_group(group)
            negative, word = not negative, group.word(0)
        if negative:
            return Not(self.read(group, variables, depth + 1))
        if not group:
            return Truism()
        if word not in _WORDS or self.is_atom(group):
            return self._atom(group, variables)
        match word:
            case "and":
                parts = tuple(self._parts(group, variables, depth))
                return And(parts) if parts else Truism()
            case "or":
                return Or(tuple(self._parts(group, variables, depth)))
            case "imply":
                return self._imply(group, variables, depth)
            case "forall" | "exists":
                parameters, part = self.quantified(group)
                inner = self.read(part, bound(variables, parameters), depth + 1)
                return Forall(parameters, inner) if word == "forall" else Exists(parameters, inner)
            case "preference":
                name, part = self.preference(group)
                return Preference(name, self.read(part, variables, depth + 1))
            case "=":
                return self._equals(group, variables)
            case ">" | ">=" | "<" | "<=":
                return self._comparison(group, variables)
        raise self.scope.error(f"({word} ...) constrains a plan's course, and belongs in (:constraints ...)", group)

    def quantified(self, group: Group) -> tuple[tuple[Parameter, ...], Group]:
        """Return the variables of ``(forall (?x - t) part)`` or ``exists``, and the part."""
        if len(group) != 3 or not isinstance(group[1], Group) or not isinstance(group[2], Group):
            word = group.word(0)
            raise self.scope.error(
                f"({word} (?x - type) ...) takes a list of variables and one more group, "
                f"not {len(group) - 1}: {node_text(group, 60)}",
                group,
            )
        return read_parameters(self.scope, group[1]), group[2]

    def preference(self, group: Group) -> tuple[str, Group]:
        """Return the name of a preference, empty if it has none, and its part."""
        part = group[-1]
        if len(group) not in (2, 3) or not isinstance(part, Group):
            raise self.scope.error(f"a preference is (preference name (condition)), not {node_text(group, 60)}", group)
        return self.scope.name(group, 1, "preference") if len(group) == 3 else "", part

    def groups_of(self, group: Group) -> Iterator[Group]:
        """Yield the parts of a conjunction or a disjunction; those of the same kind within it are dissolved."""
        word = group.word(0)
        levels = [iter(enumerate(group))]
        owners = [group]
        next(levels[0])
        while levels:
            for index, part in levels[-1]:
                if not isinstance(part, Group):
                    raise self.scope.error(
                        f"({word} ...) takes conditions or effects in brackets, not {part}", owners[-1], index
                    )
                if part.word(0) == word and not self.is_atom(part):
                    levels.append(iter(enumerate(part)))
                    owners.append(part)
                    next(levels[-1])
                    break
                yield part
            else:
                levels.pop()
                owners.pop()

    def is_atom(self, group: Group) -> bool:
        """Return whether a keyword is used as the name of a declared predicate.

        Without a domain none is declared, but an operator of constraints before plain names can be nothing else.
        """
        word = group.word(0)
        return (
            (self.scope.is_predicate(word) or (self.scope.domain is None and word in TRAJECTORY))
            and word not in COMPARISONS
            and (len(group) > 1 or word not in ("and", "or"))
            and group.is_flat()
        )

    def _parts(self, group: Group, variables: Variables, depth: int) -> Iterator[Formula]:
        for part in self.groups_of(group):
            condition = self.read(part, variables, depth + 1)
            if not (isinstance(condition, Truism) and group.word(0) == "and"):
                yield condition

    def _only_group(self, group: Group) -> Group:
        part = group[1] if len(group) == 2 else None
        if not isinstance(part, Group):
            raise self.scope.error(f"(not ...) takes one condition in brackets, not {node_text(group, 60)}", group)
        return part

    def _atom(self, group: Group, variables: Variables) -> Formula:
        scope = self.scope
        name = scope.name(group, 0, "predicate")
        if scope.patterns and len(group) == 3 and group[1] == "-" and isinstance(group[2], str):
            return IsA(name, scope.type_name(group[2], group, 2))
        if scope.is_predicate(name):
            return scope.atom(group, scope.predicate(name, group), variables)
        if scope.patterns and scope.is_function(name):
            return Defined(read_function(scope, group, variables, wildcards=True))
        if (name.lower(), group.word(1)) in _TIMED:
            raise scope.error(f"({name} {group[1]} ...) belongs to durative actions", group)
        split = scope.unglued(group)
        return scope.atom(split, scope.predicate(str(split[0]), split), variables)

    def _imply(self, group: Group, variables: Variables, depth: int) -> Formula:
        if len(group) != 3 or not isinstance(group[1], Group) or not isinstance(group[2], Group):
            raise self.scope.error(f"(imply ...) takes two conditions in brackets: {node_text(group, 60)}", group)
        premise = self.read(group[1], variables, depth + 1)
        return Imply(premise, self.read(group[2], variables, depth + 1))

    def _comparison(self, group: Group, variables: Variables) -> Formula:
        self._two_operands(group)
        left = read_expression(self.scope, group, 1, variables, self.specials)
        right = read_expression(self.scope, group, 2, variables, self.specials)
        return Comparison(COMPARISONS[group.word(0)], left, right)

    def _equals(self, group: Group, variables: Variables) -> Formula:
        """Read ``(= a b)``, which compares objects if both sides are words that are neither numbers nor functions."""
        self._two_operands(group)
        if self._is_of_object_fluents(group):
            return self._same(group, variables)
        sides = [node for node in group[1:] if isinstance(node, str)]
        is_numeric = any(
            side.lower() in ("#t", "?duration", "total-time")
            or self.scope.is_bare_function(side)
            or (is_number(side) and not self.scope.is_object(side))
            for side in sides
        )
        names_variable = any(is_wildcard(side) and side.lower() != "?duration" for side in sides)
        if len(sides) < 2 or (is_numeric and not names_variable):
            return self._comparison(group, variables)
        return self._same(group, variables)

    def _is_of_object_fluents(self, group: Group) -> bool:
        """Return whether ``(= (location ?r) wp0)`` compares objects: such a term with a name, or with another one."""
        terms = [self.scope.is_object_term(side) for side in group[1:]]
        if self.scope.domain is not None:
            return any(terms)
        return any(terms) and any(isinstance(side, str) and not is_number(side) for side in group[1:])

    def _same(self, group: Group, variables: Variables) -> Formula:
        sides: list[str] = []
        for index, node in enumerate(group[1:], 1):
            if isinstance(node, Group):
                if not self.scope.is_object_term(node):
                    raise self.scope.error(f"an object is expected here, not {node_text(node, 60)}", group, index)
                sides.append(self.scope.object_term(node, variables))
                continue
            sides.append(node)
            problem = self.scope.misfit(node, variables)
            if self.scope.patterns and is_wildcard(node) and node[1:].lower() not in variables:
                problem = f"{node} matches nothing in a comparison; write (exists (?x - some-type) ...)"
            if problem:
                self.scope.diagnose(InvalidKnowledge, f"{node_text(group)}: {problem}", group, index)
        return Same(sides[0], sides[1])

    def _two_operands(self, group: Group) -> None:
        if len(group) != 3:
            raise self.scope.error(
                f"({group.word(0)} ...) compares two values, not {len(group) - 1}: {node_text(group, 60)}", group
            )


def conjuncts(condition: Formula) -> tuple[Formula, ...]:
    """Return the parts of a conjunction, none of a truism, and of any other condition the condition itself."""
    if isinstance(condition, And):
        return condition.parts
    return () if isinstance(condition, Truism) else (condition,)


_TIMED = frozenset((("at", "start"), ("at", "end"), ("over", "all")))
