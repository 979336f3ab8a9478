"""Mirrors ROSPlan: records the problems that it generated, and the actions that it dispatched, with their effects.

ROSPlan changes its knowledge base by services, which no bag has. What it publishes is the whole problem each time that
it plans; between two of them, its action interface carries out the simple effects of each action, and so does this.
"""

import re
from collections.abc import Iterable, Iterator
from typing import Any

from kbstore.clock import ManualClock, seconds
from kbstore.knowledge_base import KnowledgeBase
from kbstore.messages import DomainFormula, Fact, UpdateType
from kbstore.model.results import Run, Transaction
from kbstore.names import key
from kbstore.pddl.problem_reader import read_problem
from kbstore.ros.bags.reading import Recorded
from kbstore.writing.unit_of_work import OpenTransaction

CLIENT = "rosplan"

FALSE_PRECONDITION, ENABLED, SUCCEEDED, FAILED = 0, 1, 2, 10
"""The status of an `ActionFeedback`."""

_NUMBERED = re.compile(r"message (\d+): ")


class RosplanMirror:
    """Records problems and actions in a knowledge base that has the domain.

    A transaction's note has the number of its message, so that an import that goes on knows where it stopped; `before`
    is the last transaction of the one before.
    """

    def __init__(self, kb: KnowledgeBase, clock: ManualClock, before: Transaction | None) -> None:
        self._kb, self._clock = kb, clock
        self._domain = kb.domain
        self._dispatched: dict[tuple[int, int], Any] = {}
        self._number = 0
        """The number of messages that have been taken."""
        noted = _NUMBERED.match(before.note) if before else None
        self._recorded = int(noted[1]) if noted else 0

    def take(self, found: Recorded) -> None:
        """Take the next message of the bag, and record what it says unless it is recorded.

        Raises `KbStoreError` if it does not fit the domain.
        """
        self._number += 1
        message = found.message
        if found.kind == "dispatch":
            # feedback refers to it by its numbers
            self._dispatched[message.plan_id, message.action_id] = message
        elif self._number > self._recorded:
            self._clock.set(found.time)
            if found.kind == "problem":
                self._record_problem(message.data, found)
            elif found.kind == "feedback" and (message.plan_id, message.action_id) in self._dispatched:
                self._record_feedback(self._dispatched[message.plan_id, message.action_id], message.status, found)

    def _transaction(self, found: Recorded, what: str) -> OpenTransaction:
        note = f"message {self._number}: {what}"
        return self._kb.transaction(client=found.sender or CLIENT, note=note)

    def _record_problem(self, text: str, found: Recorded) -> None:
        """Make state, goal and metric those of a problem; its timed-initial knowledge is relative to its time."""
        problem = read_problem(text, self._domain)
        with self._transaction(found, f"problem {problem.name}") as tx:
            tx.replace(*problem.instances, *problem.init)
            for offset, item in problem.timed:
                tx.add(item, initial_time=found.time + offset)
            tx.remove_goal(*tx.state().goals)
            tx.add_goal(*problem.goals)
            if problem.metric is None:
                tx.remove_metric()
            else:
                tx.add_metric(problem.metric)

    def _record_feedback(self, dispatched: Any, status: int, found: Recorded) -> None:
        """Record that an action starts, ends, or has failed."""
        operator = self._domain.operator(dispatched.name)
        given = {key(value.key): value.value for value in dispatched.parameters}
        labels = [key(parameter.key) for parameter in operator.formula.typed_parameters]
        bound = {label: given.get(label, "") for label in labels}
        words = (operator.name, *bound.values())
        with self._transaction(found, f"action {dispatched.action_id} of plan {dispatched.plan_id}") as tx:
            run = _running(tx, words)
            if status == ENABLED and run is None:
                tx.report_start(*words, duration=seconds(round(dispatched.duration, 6)) or None)
                self._carry_out(tx, bound, operator.at_start_del_effects, operator.at_start_add_effects)
            elif status == SUCCEEDED and run is not None:
                tx.report_end(run)
                self._carry_out(tx, bound, operator.at_end_del_effects, operator.at_end_add_effects)
            elif status in (FALSE_PRECONDITION, FAILED) and run is not None:
                tx.abort(run)

    def _carry_out(
        self,
        tx: OpenTransaction,
        bound: dict[str, str],
        deleted: Iterable[DomainFormula],
        added: Iterable[DomainFormula],
    ) -> None:
        """Carry out simple effects, deletes before adds, as ROSPlan's action interface does."""
        facts = [(UpdateType.REMOVE_KNOWLEDGE, fact) for fact in _grounded(bound, deleted)]
        tx.update(facts + [(UpdateType.ADD_KNOWLEDGE, fact) for fact in _grounded(bound, added)])


def _grounded(bound: dict[str, str], formulas: Iterable[DomainFormula]) -> Iterator[Fact]:
    """Facts of the effects of an operator; a label is a parameter's, or the name of a constant."""
    for formula in formulas:
        labels = [parameter.key for parameter in formula.typed_parameters]
        yield Fact(attribute_name=formula.name, values=[bound.get(key(label), label) for label in labels])


def _running(tx: OpenTransaction, words: tuple[str, ...]) -> Run | None:
    wanted = [*map(key, words)]
    return next((run for run in tx.state().running if [*map(key, (run.operator, *run.arguments))] == wanted), None)
