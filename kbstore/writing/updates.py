"""Reads the updates that a caller gives into steps, which a transaction runs one after another."""

from collections import defaultdict
from collections.abc import Callable, Iterable, Sequence
from functools import partial
from itertools import groupby
from typing import Any, TypeVar

from kbstore.clock import TIME_LIMIT
from kbstore.errors import InvalidKnowledge, KbStoreError, UnknownSymbol
from kbstore.messages import (
    Condition,
    DomainInequality,
    Expression,
    Fact,
    Function,
    Goal,
    Inequality,
    Instance,
    KnowledgeItem,
    UpdateType,
)
from kbstore.model.symbols import SymbolTable
from kbstore.model.timelines import Role
from kbstore.pddl.parse import condition_of, goals_of
from kbstore.pddl.problem_reader import Problem
from kbstore.reading.questions import Knowledge, Question, as_condition, as_item, decoded
from kbstore.writing.handlers import Handlers
from kbstore.writing.late_handlers import LateHandlers
from kbstore.writing.resolution import Violations

Step = Callable[[], Violations]
"""A function that makes one update of the change set, and returns its violations."""

Item = TypeVar("Item", KnowledgeItem, Goal)


class Batch:
    """Steps in the order of the updates given, and the items in them, whose timelines can be loaded at once."""

    def __init__(self, now: int, initial_time: int = 0) -> None:
        self.steps: list[Step] = []
        self.items: dict[Role, list[KnowledgeItem | Condition]] = defaultdict(list)
        self._now = now
        self._initial_time = initial_time

    def add(
        self,
        role: Role,
        items: Sequence[Item],
        handler: Callable[[Item, int], Violations],
        place: Callable[[int], str] | None = None,
    ) -> None:
        """Add steps that pass items to a handler, each at its time; a time that is not after now is now (rule T4).

        `place` returns the place of an item in its file, which its violations name.
        """
        self.items[role] += items
        now, initial_time = self._now, self._initial_time
        steps: Iterable[Step] = [partial(handler, item, max(item.initial_time or initial_time, now)) for item in items]
        if place is not None:
            steps = [partial(_placed, step, place, index) for index, step in enumerate(steps)]
        self.steps += steps

    def read(
        self,
        role: Role,
        read: Callable[[Knowledge, SymbolTable], Sequence[Item]],
        handler: Callable[[Item, int], Violations],
        given: Iterable[Knowledge],
        symbols: SymbolTable,
    ) -> None:
        """Read what a caller gave, and add steps for it; an item that cannot be read fails when its step is run."""
        items: list[Item] = []
        for knowledge in given:
            try:
                items += read(knowledge, symbols)
            except KbStoreError as error:
                self.add(role, items, handler)
                items = []
                self.steps.append(partial(_fail, knowledge, error))
        self.add(role, items, handler)

    def run(self) -> None:
        """Run the steps one after another. Raises all violations together, or else the first other error (rule D1)."""
        violations: list[str] = []
        other: KbStoreError | None = None
        for step in self.steps:
            try:
                violations += step()
            except InvalidKnowledge as error:
                violations += error.violations
            except KbStoreError as error:
                other = other or error
        if violations:
            raise InvalidKnowledge(*dict.fromkeys(violations))
        if other is not None:
            raise other

    def read_updates(self, updates: Iterable[Any], handlers: Handlers | LateHandlers, symbols: SymbolTable) -> None:
        """Read pairs of an `UpdateType` and its item, and add steps for them."""
        for kind, group in groupby(updates, _kind):
            if kind is None:
                self.steps += [partial(_refuse, update) for update in group]
                continue
            given = [update[1] for update in group]
            match kind:
                case UpdateType.ADD_KNOWLEDGE:
                    self.read(Role.STATE, items_in, handlers.add, given, symbols)
                case UpdateType.REMOVE_KNOWLEDGE:
                    self.read(Role.STATE, items_in, handlers.remove, given, symbols)
                case UpdateType.ADD_GOAL:
                    self.read(Role.GOAL, goals_in, handlers.add_goal, given, symbols)
                case UpdateType.REMOVE_GOAL:
                    self.read(Role.GOAL, goals_in, handlers.remove_goal, given, symbols)
                case UpdateType.ADD_METRIC:
                    self.read(Role.STATE, items_in, handlers.add_metric, given, symbols)
                case UpdateType.REMOVE_METRIC:
                    self.read(Role.STATE, items_in, handlers.remove_metric, given, symbols)


def _fail(given: object, error: KbStoreError) -> Violations:
    """Run the step of an item that could not be read: raise its error; an unknown symbol is a violation (rule D1)."""
    if isinstance(error, UnknownSymbol):
        return [f"{given}: {error}"]
    raise error


def _kind(update: object) -> UpdateType | None:
    """Return the kind of an update; None for anything but a pair of a kind and knowledge."""
    if not isinstance(update, (tuple, list)) or len(update) != 2:
        return None
    if type(update[0]) is UpdateType:
        return update[0]
    try:
        return UpdateType(update[0])
    except ValueError:
        return None


def _refuse(update: object) -> Violations:
    kinds = ", ".join(f"{known.name} {known.value}" for known in UpdateType)
    raise InvalidKnowledge(
        f"{update!r:.100} is not an update; give pairs like (UpdateType.ADD_KNOWLEDGE, '(visited wp7)'), "
        f"the first of them one of {kinds}"
    )


def items_in(given: Knowledge, symbols: SymbolTable) -> Sequence[KnowledgeItem]:
    """Return the item that a caller gave as a message or text."""
    return [as_item(given, symbols)]


def goals_in(knowledge: Question, symbols: SymbolTable) -> Sequence[Goal]:
    """Return the goals that a caller gave as a message, text or formula; a conjunction is split (rule C10)."""
    given = decoded(knowledge)
    if isinstance(given, Fact):
        return [given]
    initial_time = 0
    if isinstance(given, Condition):
        initial_time = given.initial_time
    elif isinstance(given, Instance | Function | Expression | Inequality | DomainInequality):
        item = as_item(given, symbols)
        if isinstance(item, Fact | Inequality):
            return [item]
        if not isinstance(item, Function):
            raise InvalidKnowledge(f"{item} is not a goal; a goal is a fact, a negative fact or a condition")
        initial_time = item.initial_time
        given = condition_of(item, symbols.domain)
    goals = goals_of(as_condition(given, symbols), symbols.domain)
    return [goal.changed(initial_time=initial_time) for goal in goals] if initial_time else goals


def problem_batch(problem: Problem, handlers: Handlers, now: int) -> Batch:
    """Return the updates that add a problem; its timed-initial knowledge is relative to now (rule P3)."""
    batch = Batch(now)

    def place(part: str) -> Callable[[int], str]:
        return lambda index: _place(problem, part, index)

    batch.add(Role.STATE, problem.instances, handlers.add, place("instances"))
    batch.add(Role.STATE, problem.init, handlers.add, place("init"))
    timed = [item.changed(initial_time=now + offset) for offset, item in problem.timed]
    batch.add(Role.STATE, timed, lambda item, t: _too_late(item, t) or handlers.add(item, t), place("timed"))
    batch.add(Role.GOAL, problem.goals, handlers.add_goal, place("goals"))
    if problem.metric is not None:
        batch.add(Role.STATE, [problem.metric], handlers.add_metric)
    batch.steps += [partial(handlers.add_constraint, text) for text in (*problem.constraints, *problem.uncertain)]
    batch.steps += [partial(handlers.add_constraint, text, about) for about, text in problem.object_values.items()]
    for offset, about, text in problem.timed_values:
        batch.steps.append(partial(_too_late, text, now + offset))
        batch.steps.append(partial(handlers.add_constraint, text, about, now + offset))
    return batch


def _too_late(what: object, t: int) -> Violations:
    """Return that something is to take effect beyond what is a time, if it is (rule T1)."""
    return [] if t < TIME_LIMIT else [f"{what} is to take effect after the year 2116; times end at 2**62 nanoseconds"]


def closed_world_violations(problem: Problem) -> list[str]:
    """Return the parts of a problem that need an open world (that atoms are unknown), each with its place (rule P4)."""
    return [
        f"{_place(problem, 'uncertain', index)}: {text} says that facts are unknown, but in the closed world of this "
        "knowledge base what is not asserted is false; create one with kbstore.open(..., use_unknowns=True)"
        for index, text in enumerate(problem.uncertain)
    ]


def _place(problem: Problem, part: str, index: int) -> str:
    """Return the place of an item in its problem's file (rule D1)."""
    line, column = problem.places[part][index]
    return f"{problem.source}:{line}:{column}" if problem.source else f"line {line}, column {column}"


def _placed(step: Step, place: Callable[[int], str], index: int) -> Violations:
    return [f"{place(index)}: {sentence}" for sentence in step()]
