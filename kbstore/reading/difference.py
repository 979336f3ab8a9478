"""Compares the assertions of two states (rule Q5)."""

from kbstore.messages import Expression, Fact, Function, Inequality, Instance, KnowledgeItem
from kbstore.model.results import Diff
from kbstore.names import key
from kbstore.reading.state import State


def difference(before: State, after: State) -> Diff:
    """Return what became true, became false or was withdrawn, and which numbers, goals and metric changed."""
    became_true: list[KnowledgeItem] = []
    became_false: list[KnowledgeItem] = []
    withdrawn: list[KnowledgeItem] = []
    objects_before = {key(item.instance_name): item for item in before.instances}
    objects_after = {key(item.instance_name): item for item in after.instances}
    for name, item in objects_after.items():
        known = objects_before.get(name)
        if known is None or not _same_type(known, item):
            became_true.append(item)
    for name, item in objects_before.items():
        other = objects_after.get(name)
        if other is None or not _same_type(item, other):
            withdrawn.append(item)
    asserted_before = _asserted(before)
    asserted_after = _asserted(after)
    for text, asserted in asserted_after.items():
        earlier = asserted_before.get(text)
        if earlier is None or earlier.is_negative != asserted.is_negative:
            (became_false if asserted.is_negative else became_true).append(asserted)
    withdrawn += [item for text, item in asserted_before.items() if text not in asserted_after]
    goals_before = {str(goal).lower(): goal for goal in before.goals}
    goals_after = {str(goal).lower(): goal for goal in after.goals}
    return Diff(
        became_true=became_true,
        became_false=became_false,
        withdrawn=withdrawn,
        numbers=_numbers(before, after),
        goals_added=[goal for text, goal in goals_after.items() if text not in goals_before],
        goals_removed=[goal for text, goal in goals_before.items() if text not in goals_after],
        metric=None if _text(before.metric) == _text(after.metric) else (before.metric, after.metric),
    )


def _numbers(before: State, after: State) -> list[tuple[Function, float | None, float | None]]:
    values_before = {item.key: item for item in before.functions}
    values_after = {item.key: item for item in after.functions}
    found = []
    for name in dict.fromkeys((*values_before, *values_after)):
        old, new = values_before.get(name), values_after.get(name)
        old_value = None if old is None else old.function_value
        new_value = None if new is None else new.function_value
        if old_value != new_value:
            function = new or old
            assert function is not None
            found.append((function, old_value, new_value))
    return found


def _asserted(state: State) -> dict[str, Fact | Inequality]:
    """Return the facts and inequalities asserted in a state, of both signs, by their text without the sign."""
    items: list[Fact | Inequality] = [*state.facts, *state.inequalities]
    return {item.text.lower(): item for item in items}


def _same_type(one: Instance, other: Instance) -> bool:
    return key(one.instance_type) == key(other.instance_type)


def _text(metric: Expression | None) -> str:
    return "" if metric is None else str(metric).lower()
