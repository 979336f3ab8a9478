"""Reads actions and durative actions, from their groups to `kbstore.model.actions.Action`."""

from collections.abc import Collection, Iterator
from dataclasses import dataclass

from kbstore.messages import ComparisonType, SpecialType
from kbstore.model.actions import Action, DurationConstraint
from kbstore.model.domain import Event
from kbstore.model.formulas import Parameter, Timing, Variables, changed_by
from kbstore.names import key
from kbstore.pddl.conditions import COMPARISONS, ConditionReader, conjuncts
from kbstore.pddl.definition import check_name, unknown_keyword
from kbstore.pddl.effects import EffectReader
from kbstore.pddl.expressions import read_expression
from kbstore.pddl.scope import NO_VARIABLES, Scope
from kbstore.pddl.sexpr import Group, node_text
from kbstore.pddl.timed_formulas import TimedReader
from kbstore.pddl.typed_lists import bound, read_parameters

_FIELDS = (":parameters", ":vars", ":precondition", ":effect", ":observe")
_EVENT_FIELDS = (":parameters", ":precondition", ":effect")
_DURATIVE_FIELDS = (":parameters", ":duration", ":condition", ":effect")
_FLIPPED = {
    ComparisonType.GREATER: ComparisonType.LESS,
    ComparisonType.GREATEREQ: ComparisonType.LESSEQ,
    ComparisonType.LESS: ComparisonType.GREATER,
    ComparisonType.LESSEQ: ComparisonType.GREATEREQ,
    ComparisonType.EQUALS: ComparisonType.EQUALS,
}


@dataclass
class ActionReader:
    """Reads the actions of a domain whose types, constants, predicates and functions are known."""

    scope: Scope

    def read(self, group: Group) -> Action:
        """Read the action that an ``(:action ...)`` or ``(:durative-action ...)`` section declares."""
        if group.word(0) == ":durative-action":
            return self._durative(group)
        name = check_name(self.scope, "action", group, 1)
        fields = self._fields(group, _FIELDS)
        parameters, variables = self._parameters(fields)
        conditions = ConditionReader(self.scope, frozenset())
        effects = EffectReader(self.scope, conditions, frozenset())
        precondition = conditions.read(fields.get(":precondition", _EMPTY), variables)
        return Action(
            name,
            parameters,
            conditions=tuple((Timing.AT_START, part) for part in conjuncts(precondition)),
            effects=tuple(
                (Timing.AT_START, effect) for effect in effects.read(fields.get(":effect", _EMPTY), variables)
            ),
            observe=conditions.read(fields[":observe"], variables) if ":observe" in fields else None,
        )

    def read_event(self, group: Group) -> Event:
        """Read the process or event of PDDL+ that a ``(:process ...)`` or ``(:event ...)`` section declares."""
        kind = group.word(0)[1:]
        name = check_name(self.scope, kind, group, 1)
        fields = self._fields(group, _EVENT_FIELDS)
        _, variables = self._parameters(fields)
        specials = frozenset((SpecialType.HASHT,)) if kind == "process" else frozenset[SpecialType]()
        conditions = ConditionReader(self.scope, frozenset())
        conditions.read(fields.get(":precondition", _EMPTY), variables)
        effects = EffectReader(self.scope, conditions, specials).read(fields.get(":effect", _EMPTY), variables)
        return Event(kind, name, frozenset(changed_by(effects)))

    def _durative(self, group: Group) -> Action:
        name = check_name(self.scope, "action", group, 1)
        fields = self._fields(group, _DURATIVE_FIELDS)
        if ":duration" not in fields:
            raise self.scope.error(f"the durative action {name} lacks its :duration", group)
        parameters, variables = self._parameters(fields)
        special = frozenset((SpecialType.DURATION,))
        conditions = ConditionReader(self.scope, special)
        timed = TimedReader(self.scope, conditions, EffectReader(self.scope, conditions, special))
        return Action(
            name,
            parameters,
            durative=True,
            duration=tuple(self._duration(fields[":duration"], variables, conditions)),
            conditions=tuple(timed.read_conditions(fields.get(":condition", _EMPTY), variables)),
            effects=tuple(timed.read_effects(fields.get(":effect", _EMPTY), variables)),
        )

    def _fields(self, group: Group, known: Collection[str]) -> dict[str, Group]:
        """The groups after the action's keywords."""
        fields: dict[str, Group] = {}
        for index in range(2, len(group), 2):
            keyword, value = group.word(index), group[index + 1] if index + 1 < len(group) else None
            if keyword not in known:
                problem = (
                    unknown_keyword(keyword, "part of this action", known)
                    if keyword.startswith(":")
                    else f"one of {', '.join(known)} is expected here, not {node_text(group[index], 60)}"
                )
                raise self.scope.error(problem, group, index)
            if keyword in fields:
                raise self.scope.error(f"{keyword} is here for the second time", group, index)
            if not isinstance(value, Group):
                raise self.scope.error(f"{keyword} is followed by a group in brackets", group, index + 1)
            fields[keyword] = value
        return fields

    def _parameters(self, fields: dict[str, Group]) -> tuple[tuple[Parameter, ...], Variables]:
        parameters = read_parameters(self.scope, fields.get(":parameters", _EMPTY))
        if ":vars" in fields:  # the deprecated second list, whose variables only the precondition finds
            more = read_parameters(self.scope, fields[":vars"])
            for parameter in more:
                if key(parameter.name) in map(key, (known.name for known in parameters)):
                    raise self.scope.error(f"the variable ?{parameter.name} is declared twice", fields[":vars"])
            parameters += more
        return parameters, bound(NO_VARIABLES, parameters)

    def _duration(
        self, group: Group, variables: Variables, conditions: ConditionReader
    ) -> Iterator[DurationConstraint]:
        """Yield the constraints on ``?duration``, each of the start unless it names its part of the action."""
        for part in conditions.groups_of(group) if group.word(0) == "and" else [group]:
            timed = part[2] if part.word(0) == "at" and part.word(1) in ("start", "end") and len(part) == 3 else None
            if isinstance(timed, Group):
                timing = Timing.AT_START if part.word(1) == "start" else Timing.AT_END
                yield self._constraint(timed, variables, timing)
            elif part:
                yield self._constraint(part, variables, Timing.AT_START)

    def _constraint(self, group: Group, variables: Variables, timing: Timing) -> DurationConstraint:
        comparison = COMPARISONS.get(group.word(0))
        is_left, is_right = group.word(1) == "?duration", group.word(2) == "?duration"
        if comparison is None or len(group) != 3 or is_left == is_right:
            raise self.scope.error(
                f"a constraint on the duration is (= ?duration value), or one of <=, >=, < and >, "
                f"not {node_text(group, 60)}",
                group,
            )
        bound_by = read_expression(self.scope, group, 2 if is_left else 1, variables, frozenset())
        return DurationConstraint(comparison if is_left else _FLIPPED[comparison], bound_by, timing)


_EMPTY = Group()
_EMPTY.start = 0
