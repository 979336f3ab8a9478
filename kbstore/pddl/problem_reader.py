"""Reads problems, from PDDL text to the items of a knowledge base, each with its place."""

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import overload

from kbstore.errors import InvalidKnowledge, KbStoreError
from kbstore.messages import Expression, Goal, Instance, KnowledgeType, SpecialType
from kbstore.messages.gc_pause import gc_paused
from kbstore.model.domain import ROOT_TYPE, Domain
from kbstore.names import key
from kbstore.names import problem as name_problem
from kbstore.pddl.conditions import ConditionReader, conjuncts
from kbstore.pddl.constraints import ConstraintReader
from kbstore.pddl.definition import Definition, read_definition
from kbstore.pddl.domain_reader import object_type, read_requirements
from kbstore.pddl.init_reader import Entry, InitReader
from kbstore.pddl.item_reader import ItemReader, read_metric
from kbstore.pddl.parse import goal_of
from kbstore.pddl.scope import Scope
from kbstore.pddl.sexpr import Group, SourceText
from kbstore.pddl.typed_lists import read_typed_list

_SECTIONS = (
    ":domain",
    ":requirements",
    ":objects",
    ":init",
    ":goal",
    ":constraints",
    ":metric",
    ":length",
)

MAX_VIOLATIONS = 1000
"""A file with so many violations is not read to its end."""


class SourcePositions(Sequence[tuple[int, int]]):
    """The line and the column of each item of a list, computed when asked for."""

    def __init__(self, source: SourceText, offsets: Sequence[int]) -> None:
        self._source = source
        self._offsets = offsets

    def __len__(self) -> int:
        return len(self._offsets)

    @overload
    def __getitem__(self, index: int) -> tuple[int, int]: ...
    @overload
    def __getitem__(self, index: slice) -> "SourcePositions": ...
    def __getitem__(self, index: int | slice) -> "tuple[int, int] | SourcePositions":
        if isinstance(index, slice):
            return SourcePositions(self._source, self._offsets[index])
        return self._source.place(self._offsets[index])


@dataclass(frozen=True)
class Problem:
    """A planning problem, as items of a knowledge base.

    `timed` has the offsets of timed-initial knowledge from the initial state, in nanoseconds; `constraints` are PDDL
    text, and so are the values of object fluents: by term, and in `timed_values` with offset and term. `places` has
    the line and column of each item of "instances", "init", "timed" and "goals"; `source` is the file, None for text.
    """

    name: str
    domain_name: str
    requirements: tuple[str, ...] = ()
    instances: list[Instance] = field(default_factory=list)
    init: list[Entry] = field(default_factory=list)
    timed: list[tuple[int, Entry]] = field(default_factory=list)
    goals: list[Goal] = field(default_factory=list)
    metric: Expression | None = None
    constraints: list[str] = field(default_factory=list)
    object_values: dict[str, str] = field(default_factory=dict)
    timed_values: list[tuple[int, str, str]] = field(default_factory=list)
    uncertain: list[str] = field(default_factory=list)
    places: Mapping[str, Sequence[tuple[int, int]]] = field(default_factory=dict, compare=False)
    source: str | None = field(default=None, compare=False)


def read_problem(source: str | os.PathLike[str] | SourceText, domain: Domain | None = None) -> Problem:
    """Read the problem in a file, or in PDDL text. Its sections may come in any order.

    Raises:
        PddlSyntaxError: with the place, for what cannot be read, and for a problem of another domain.
        InvalidKnowledge: with everything that does not fit the domain or the declared objects (up to
            `MAX_VIOLATIONS`), each with its place.
    """
    text = SourceText.open(source)
    violations: list[str] = []

    def report(_kind: type[KbStoreError], problem: str, offset: int) -> None:
        violations.append(text.diagnosis(problem, offset))
        if len(violations) == MAX_VIOLATIONS:
            raise InvalidKnowledge(*violations, "there may be more; reading has been given up here")

    with gc_paused():
        problem = _ProblemReader(Scope(text, domain, report=report)).read()
    if violations:
        raise InvalidKnowledge(*violations)
    return problem


@dataclass
class _ProblemReader:
    scope: Scope

    def read(self) -> Problem:
        scope = self.scope
        definition = read_definition(scope, "problem", _SECTIONS, ())
        domain_name = self._domain_name(definition)
        requirements = read_requirements(scope, definition)
        instances, instance_offsets = self._objects(definition.one(":objects") or Group())
        init = InitReader(scope)
        init.read(definition.one(":init") or Group())
        goals, goal_offsets = self._goals(definition)
        constraints = definition.one(":constraints")
        return Problem(
            definition.name,
            domain_name,
            requirements,
            instances,
            init.entries,
            init.timed,
            goals,
            self._metric(definition.one(":metric")),
            ConstraintReader(scope, ConditionReader(scope, frozenset())).read(constraints) if constraints else [],
            init.object_values,
            init.timed_values,
            init.uncertain,
            {
                "instances": SourcePositions(scope.source, instance_offsets),
                "init": SourcePositions(scope.source, init.offsets),
                "timed": SourcePositions(scope.source, init.timed_offsets),
                "goals": SourcePositions(scope.source, goal_offsets),
                "uncertain": SourcePositions(scope.source, init.uncertain_offsets),
            },
            scope.source.name,
        )

    def _domain_name(self, definition: Definition) -> str:
        section = definition.one(":domain")
        if section is None:
            raise self.scope.error("the problem does not name its domain: (:domain name)", definition.whole)
        name = self.scope.name(section, 1, "domain")
        domain = self.scope.domain
        if domain is not None and key(name) != key(domain.name):
            raise self.scope.error(f"this problem is of the domain {name}, not of {domain.name}", section, 1)
        return name

    def _objects(self, section: Group) -> tuple[list[Instance], list[int]]:
        """Read the declared objects; from here on the scope knows them, and the domain's constants."""
        scope = self.scope
        constants = scope.domain.constant_types if scope.domain else {}
        known: dict[str, str] = {}
        type_names: dict[int, str] = {-1: ROOT_TYPE}
        instances: list[Instance] = []
        offsets: list[int] = []
        located = scope.source.offsets(section) if section else []
        for typed in read_typed_list(scope, section, 1):
            name, name_key = typed.name, key(typed.name)
            if typed.types_place not in type_names:
                type_names[typed.types_place] = object_type(scope, section, typed)
            type_name = type_names[typed.types_place]
            wrong = name_problem(name)
            if wrong:
                scope.diagnose(InvalidKnowledge, f"the object name {name:.60} {wrong}", section, typed.place)
            if name_key in known:
                if known[name_key] != key(type_name):
                    problem = f"the object {name} is declared twice, as {known[name_key]} and as {type_name}"
                    scope.diagnose(InvalidKnowledge, problem, section, typed.place)
            elif name_key in constants:
                # to repeat a constant adds nothing, unless it is of another type
                if constants[name_key] != key(type_name):
                    problem = f"{name} - {type_name} is a constant of the domain, of type {constants[name_key]}"
                    scope.diagnose(InvalidKnowledge, problem, section, typed.place)
            else:
                known[name_key] = key(type_name)
                instances.append(
                    Instance.trusted(
                        initial_time=0,
                        is_negative=False,
                        knowledge_type=KnowledgeType.INSTANCE,
                        instance_type=type_name,
                        instance_name=name,
                    )
                )
                offsets.append(located[typed.place])
        if scope.domain is not None:
            scope.objects = {**constants, **known}
        return instances, offsets

    def _goals(self, definition: Definition) -> tuple[list[Goal], list[int]]:
        section = definition.one(":goal")
        if section is None:
            return [], []
        if len(section) != 2 or not isinstance(section[1], Group):
            raise self.scope.error("the goal is one condition in brackets: (:goal (and (p) (q)))", section, 1)
        reader, items = ConditionReader(self.scope, frozenset()), ItemReader(self.scope)
        goals: list[Goal] = []
        offsets: list[int] = []
        for group in reader.groups_of(section[1]) if section[1].word(0) == "and" else [section[1]]:
            parts = [goal_of(part, items) for part in conjuncts(reader.read(group))]
            goals += parts
            offsets += [group.start] * len(parts)
        return goals, offsets

    def _metric(self, section: Group | None) -> Expression | None:
        if section is None:
            return None
        optimization, expression = read_metric(self.scope, section, 1, frozenset((SpecialType.TOTAL_TIME,)))
        return Expression(optimization=optimization, expr=ItemReader(self.scope).composite(expression))
