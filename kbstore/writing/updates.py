"""What is given to a transaction, as updates that its editor does one after another."""

from collections.abc import Callable, Sequence
from functools import partial

from kbstore.errors import InvalidKnowledge, KbStoreError, UnknownSymbol
from kbstore.messages import Condition, Fact, Function, Goal, Inequality, KnowledgeItem, UpdateType
from kbstore.model.symbols import SymbolTable
from kbstore.pddl.parse import condition_of, goals_of
from kbstore.pddl.problem_reader import Problem
from kbstore.reading.questions import as_condition, as_item

GOAL_UPDATES = (UpdateType.ADD_GOAL, UpdateType.REMOVE_GOAL)

Update = Callable[[], Sequence[str]]
"""Does one update to the draft; returns its violations."""


def read_update(update: object) -> tuple[UpdateType, object]:
    """An update as it was given: its kind, and what it tells. Raises `InvalidKnowledge` for anything else."""
    try:
        kind, knowledge = update  # type: ignore[misc]
        return UpdateType(kind), knowledge  # type: ignore[has-type]
    except (TypeError, ValueError):
        kinds = ", ".join(f"{known.name} {known.value}" for known in UpdateType)
        raise InvalidKnowledge(
            f"{update!r:.100} is no update; give pairs like (UpdateType.ADD_KNOWLEDGE, '(visited wp7)'), "
            f"the first of them one of {kinds}"
        ) from None


def items_of(kind: UpdateType, knowledge: object, symbol_table: SymbolTable) -> Sequence[KnowledgeItem | Condition]:
    """The items that are meant by what was given; of a goal that is a conjunction, its parts (rule C10)."""
    return _goals(knowledge, symbol_table) if kind in GOAL_UPDATES else [as_item(knowledge, symbol_table)]


def _goals(knowledge: object, symbol_table: SymbolTable) -> Sequence[Goal]:
    if isinstance(knowledge, Fact):
        return [knowledge]
    initial_time = 0
    if isinstance(knowledge, Condition):
        initial_time = knowledge.initial_time
    elif not isinstance(knowledge, str):
        item = as_item(knowledge, symbol_table)
        if isinstance(item, Fact | Inequality):
            return [item]
        if not isinstance(item, Function):
            raise InvalidKnowledge(f"{item} is not a goal; a goal is a fact, a negative fact or a condition")
        initial_time = item.initial_time
        knowledge = condition_of(item, symbol_table.domain)
    goals = goals_of(as_condition(knowledge, symbol_table), symbol_table.domain)
    return [goal.changed(initial_time=initial_time) for goal in goals] if initial_time else goals


def failing(knowledge: object, error: KbStoreError) -> Update:
    """What stands for an item that could not be read; a symbol that is not known is a violation (rule D1)."""

    def update() -> Sequence[str]:
        if isinstance(error, UnknownSymbol):
            return [f"{knowledge}: {error}"]
        raise error

    return update


def problem_updates(
    problem: Problem,
    now: int,
    update: Callable[[UpdateType, KnowledgeItem | Condition, int], Update],
    constrain: Callable[[str], Sequence[str]],
) -> list[Update]:
    """What a problem adds; its timed-initial knowledge is relative to now (rule P3).

    `update` makes the update of an item from a time on; `constrain` keeps a trajectory constraint.
    """
    add, goal = UpdateType.ADD_KNOWLEDGE, UpdateType.ADD_GOAL
    updates: list[Update] = []
    for part, found in (
        ("instances", [update(add, item, 0) for item in problem.instances]),
        ("init", [update(add, item, 0) for item in problem.init]),
        ("timed", [update(add, item, now + offset) for offset, item in problem.timed]),
        ("goals", [update(goal, item, 0) for item in problem.goals]),
    ):
        updates += [_placed(done, problem, part, index) for index, done in enumerate(found)]
    if problem.metric is not None:
        updates.append(update(UpdateType.ADD_METRIC, problem.metric, 0))
    updates += [partial(constrain, text) for text in problem.constraints]
    return updates


def _placed(update: Update, problem: Problem, part: str, index: int) -> Update:
    """An update whose violations tell where in the problem's file it stands (rule D1)."""

    def placed() -> Sequence[str]:
        violations = update()
        if violations:
            line, column = problem.places[part][index]
            place = f"{problem.source}:{line}:{column}" if problem.source else f"line {line}, column {column}"
            return [f"{place}: {sentence}" for sentence in violations]
        return violations

    return placed
