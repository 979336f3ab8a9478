"""Reads the conditions and effects of durative actions, each with the part of the action that it belongs to."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from kbstore.model.formulas import (
    And,
    Effect,
    Exists,
    Forall,
    ForEach,
    Formula,
    Preference,
    Timing,
    Truism,
    Variables,
    When,
    WhenAtStart,
)
from kbstore.pddl.conditions import ConditionReader, conjuncts
from kbstore.pddl.effects import EffectReader
from kbstore.pddl.scope import Scope
from kbstore.pddl.sexpr import Group, node_text
from kbstore.pddl.typed_lists import bound

TimedCondition = tuple[Timing, Formula]
TimedEffect = tuple[Timing, Effect]

_MOMENTS = {("at", "start"): Timing.AT_START, ("over", "all"): Timing.OVER_ALL, ("at", "end"): Timing.AT_END}


@dataclass
class TimedReader:
    """Reads conditions and effects ``at start``, ``over all`` and ``at end``."""

    scope: Scope
    conditions: ConditionReader
    effects: EffectReader

    def read_conditions(self, group: Group, variables: Variables, depth: int = 0) -> Iterator[TimedCondition]:
        """Read conditions; conjunctions are split. Raises `PddlSyntaxError`; reports symbols that do not fit."""
        self.effects.check_depth(group, depth)
        if not group:
            return
        word, timing = group.word(0), self._timing(group)
        if timing is not None:
            condition = self.conditions.read(self._inner(group), variables, depth + 1)
            yield from ((timing, part) for part in conjuncts(condition))
        elif word == "and":
            for part_group in self.conditions.groups_of(group):
                yield from self.read_conditions(part_group, variables, depth + 1)
        elif word == "forall":
            parameters, inner = self.conditions.quantified(group)
            for when, part in self.read_conditions(inner, bound(variables, parameters), depth + 1):
                yield when, Forall(parameters, part)
        elif word == "exists":
            parameters, inner = self.conditions.quantified(group)
            timed = list(self.read_conditions(inner, bound(variables, parameters), depth + 1))
            yield self._one_moment(group, timed), Exists(parameters, _joined([part for _, part in timed]))
        elif word == "preference":
            name, inner = self.conditions.preference(group)
            timed = list(self.read_conditions(inner, variables, depth + 1))
            for when in Timing:
                parts = [part for at, part in timed if at is when]
                if parts:
                    yield when, Preference(name, _joined(parts))
        else:
            raise self.scope.error(
                "a condition of a durative action says when it has to hold, at start, over all or at end: "
                f"(at start {node_text(group, 60)})",
                group,
            )

    def read_effects(self, group: Group, variables: Variables, depth: int = 0) -> Iterator[TimedEffect]:
        """Read effects, continuous ones as `Timing.OVER_ALL`. Raises `PddlSyntaxError`; reports misfitting symbols."""
        self.effects.check_depth(group, depth)
        if not group:
            return
        word, timing = group.word(0), self._timing(group)
        if timing is Timing.OVER_ALL:
            raise self.scope.error(
                "an effect happens at start or at end, or continuously: (increase (f) (* #t 2))", group
            )
        elif timing is not None:
            for effect in self.effects.read(self._inner(group), variables, depth + 1):
                yield timing, effect
        elif word == "and":
            for part in self.conditions.groups_of(group):
                yield from self.read_effects(part, variables, depth + 1)
        elif word == "forall":
            parameters, inner = self.conditions.quantified(group)
            timed = list(self.read_effects(inner, bound(variables, parameters), depth + 1))
            for when in Timing:
                effects = tuple(effect for at, effect in timed if at is when)
                if effects:
                    yield when, ForEach(parameters, effects)
        elif word == "when":
            yield from self._conditional(group, variables, depth)
        elif word in ("increase", "decrease"):
            yield Timing.OVER_ALL, self.effects.continuous(group, variables)
        else:
            raise self.scope.error(
                f"an effect of a durative action says when it happens: (at end {node_text(group, 60)})", group
            )

    def _conditional(self, group: Group, variables: Variables, depth: int) -> Iterator[TimedEffect]:
        premise, consequence = self.effects.when(group)
        conditions = list(self.read_conditions(premise, variables, depth + 1))
        effects = list(self.read_effects(consequence, variables, depth + 1))
        for timing in Timing:
            parts = tuple(effect for when, effect in effects if when is timing)
            if parts:
                yield timing, self._when(group, timing, conditions, parts)

    def _when(
        self, group: Group, timing: Timing, conditions: Sequence[TimedCondition], parts: tuple[Effect, ...]
    ) -> Effect:
        """Return the conditional effect of one part on conditions of that part, of the start, or of both."""
        self._check_known(group, timing, [when for when, _ in conditions])
        own = [part for when, part in conditions if when is timing]
        at_start = [part for when, part in conditions if when is not timing]
        if not at_start:
            return When(_joined(own), parts)
        return WhenAtStart(_joined(at_start), (When(_joined(own), parts),) if own else parts)

    def _check_known(self, group: Group, timing: Timing, asked: Sequence[Timing]) -> None:
        """Refuse conditions of parts whose truth is not known when the effect happens."""
        for other in asked:
            if other in (timing, Timing.AT_START):
                continue
            if timing is Timing.AT_END:
                raise self.scope.error(
                    "an effect at end that depends on a condition over all cannot be read: whether it held throughout "
                    "is not recorded; ask for it at start, at end, or at both",
                    group,
                )
            effect = "a continuous effect" if timing is Timing.OVER_ALL else "an effect at start"
            raise self.scope.error(
                f"{effect} cannot depend on a condition {other.value}, which is known only later; ask for it at start, "
                "or make the effect one at end",
                group,
            )

    def _timing(self, group: Group) -> Timing | None:
        """Return the part that ``(at start (p))`` names; None for anything else, like ``(at kenny wp0)``."""
        timing = _MOMENTS.get((group.word(0), group.word(1)))
        return timing if len(group) > 2 and isinstance(group[2], Group) else None

    def _inner(self, group: Group) -> Group:
        inner = group[2]
        if len(group) != 3 or not isinstance(inner, Group):
            raise self.scope.error(f"({group[0]} {group[1]} ...) takes one group: {node_text(group, 60)}", group)
        return inner

    def _one_moment(self, group: Group, timed: Sequence[TimedCondition]) -> Timing:
        timings = {timing for timing, _ in timed}
        if len(timings) != 1:
            raise self.scope.error(f"all of ({group.word(0)} ...) has to be of one moment, at start or at end", group)
        return timings.pop()


def _joined(parts: list[Formula]) -> Formula:
    return parts[0] if len(parts) == 1 else And(tuple(parts)) if parts else Truism()
