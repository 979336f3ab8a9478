"""Selects parts of a state to show: those that match patterns, refer to an object, or are of some kinds."""

import re
from collections import Counter
from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import TypeVar

from kbstore.messages import (
    Condition,
    Expression,
    Fact,
    Function,
    Goal,
    Inequality,
    Instance,
    KnowledgeItem,
)
from kbstore.model.formulas import changed_by
from kbstore.model.plain import Data, plain
from kbstore.model.results import Run
from kbstore.names import key
from kbstore.reading.patterns import Pattern
from kbstore.reading.state import State

FOLDED = 5
"""The most facts or numbers of one name that are shown although no action changes them."""

_NAME = re.compile(r"(?<=\s)[^\s()]+")
"""A word of PDDL text that is not the first one in its brackets."""

_Item = TypeVar("_Item", bound=KnowledgeItem | Condition)


class Part(StrEnum):
    """A part of a state."""

    OBJECTS = "objects"
    FACTS = "facts"
    NUMBERS = "numbers"
    RUNS = "runs"
    SCHEDULED = "scheduled"
    INEQUALITIES = "inequalities"
    GOALS = "goals"
    METRIC = "metric"


@dataclass(frozen=True)
class Selection:
    """The part of a state to show; `folded` counts the facts and numbers, by name, left out as never changing."""

    state: State
    instances: Sequence[Instance] = ()
    facts: Sequence[Fact] = ()
    functions: Sequence[Function] = ()
    running: Sequence[Run] = ()
    timed_knowledge: Sequence[KnowledgeItem] = ()
    inequalities: Sequence[Inequality] = ()
    goals: Sequence[Goal] = ()
    metric: Expression | None = None
    folded: tuple[tuple[str, int], ...] = ()

    def to_dict(self) -> Data:
        """Return the selection as plain data for JSON, in the form of that of the whole state."""
        parts = ("instances", "facts", "functions", "inequalities", "metric", "goals", "timed_knowledge", "running")
        return self.state.to_dict() | {part: plain(getattr(self, part)) for part in parts}


def select(
    state: State,
    patterns: Sequence[str] = (),
    about: Collection[str] = (),
    only: Collection[Part] = (),
    *,
    folding: bool = False,
) -> Selection:
    """Select what matches one of the patterns, refers to one of the objects, and is of one of the parts.

    Args:
        state: what to select from.
        patterns: items in PDDL, in which ``?`` matches any object; none select everything.
        about: names of objects; none select everything.
        only: parts of the state; none select all of them.
        folding: leave out facts and numbers that no action changes and that are many, unless something is selected.

    Raises `UnknownSymbol` or `InvalidKnowledge` for a pattern that does not fit the domain.
    """
    wanted = [Pattern(pattern, state.symbol_table) for pattern in patterns]
    names = {key(name) for name in about}

    def chosen(part: Part, items: Iterable[_Item]) -> list[_Item]:
        if only and part not in only:
            return []
        return [
            item
            for item in items
            if (not wanted or any(pattern.matches(item) for pattern in wanted))
            and (not names or not names.isdisjoint(_names_in(item)))
        ]

    runs = [] if wanted or (only and Part.RUNS not in only) else state.running
    metrics = chosen(Part.METRIC, [state.metric] if state.metric else [])
    facts, functions = chosen(Part.FACTS, state.facts), chosen(Part.NUMBERS, state.functions)
    folded: Counter[str] = Counter()
    if folding and not (wanted or names or only):
        folded = _unchanging(state)
    return Selection(
        state,
        chosen(Part.OBJECTS, state.instances),
        [fact for fact in facts if fact.attribute_name not in folded],
        [function for function in functions if function.attribute_name not in folded],
        [run for run in runs if not names or not names.isdisjoint(map(key, run.arguments))],
        chosen(Part.SCHEDULED, state.timed_knowledge),
        chosen(Part.INEQUALITIES, state.inequalities),
        chosen(Part.GOALS, state.goals),
        metrics[0] if metrics else None,
        tuple(sorted(folded.items())),
    )


def _names_in(item: KnowledgeItem | Condition) -> set[str]:
    match item:
        case Fact() | Function():
            return set(map(key, item.arguments))
        case Instance():
            return {key(item.instance_name)}
        case _:
            return set(map(key, _NAME.findall(str(item))))


def _unchanging(state: State) -> Counter[str]:
    """Count the facts and numbers, by name, that are many, that no action changes, and that have no schedule."""
    if state.domain is None:
        return Counter()
    changed = {name for action in state.domain.actions.values() for name in changed_by(e for _, e in action.effects)}
    changed |= {key(item.attribute_name) for item in state.timed_knowledge if isinstance(item, Fact | Function)}
    counted = Counter(item.attribute_name for item in (*state.facts, *state.functions))
    return Counter({name: count for name, count in counted.items() if count > FOLDED and key(name) not in changed})
