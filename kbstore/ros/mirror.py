"""Mirrors PlanSys2: records what it publishes about its knowledge, its plan and its executions, with the times.

It reads messages by their attributes and needs no ROS: the recorder feeds it live, the importer of bags from a file.
"""

import os
from collections.abc import Iterable, Mapping, Sequence
from functools import lru_cache
from typing import Any, TypeVar

from kbstore.clock import ManualClock
from kbstore.errors import Conflict, InvalidKnowledge
from kbstore.interop.plansys2 import read, read_atom
from kbstore.knowledge_base import KnowledgeBase
from kbstore.messages import Fact, Function, Instance
from kbstore.model.domain import Domain
from kbstore.model.results import Transaction
from kbstore.names import key
from kbstore.pddl.problem_reader import read_problem
from kbstore.ros.executions import Executions
from kbstore.ros.object_types import ObjectTypes

CLIENT = "plansys2"

Item = TypeVar("Item", Instance, Fact, Function)


class Mirror:
    """Records what PlanSys2 publishes in a knowledge base of its own.

    All symbols in it are sensed (rule O8): snapshots report what holds, and the effects of actions are not computed.
    """

    def __init__(
        self,
        kb: KnowledgeBase,
        clock: ManualClock,
        *,
        domain: str | os.PathLike[str] | None = None,
        problem: str | os.PathLike[str] | None = None,
        client: str = CLIENT,
    ) -> None:
        """Load the domain, and read the types of objects from the problem; it is not recorded otherwise.

        Args:
            kb: the knowledge base; it was opened with `clock`.
            clock: is set to the time of each message.
            domain: PDDL text or a path; None: the one that the knowledge base has.
            problem: PDDL text or a path of a problem that declares objects.
            client: the client of all transactions.

        Raises:
            UnknownSymbol: there is no domain.
            ClockWentBackwards: the clock is before what has been recorded.
        """
        self._kb, self._clock, self._client = kb, clock, client
        if domain is not None:
            self._load(domain)
        self._domain: Domain = kb.domain
        self._objects = {item.instance_name: item for item in kb.instances()}
        types = {name: item.instance_type for name, item in self._objects.items()}
        if problem is not None:
            types.update(declared_types(problem, self._domain))
        self.types = ObjectTypes(self._domain, types)
        self._executions = Executions(kb, client)
        self._facts: dict[str, Fact] = {}
        self._functions: dict[str, Function] = {}
        self._goal = ""
        self._number: int | None = None
        """The last transaction, if the state is still that of the last snapshot; otherwise None."""

    def _load(self, domain: str | os.PathLike[str]) -> None:
        with self._kb.transaction(client=self._client, note="the domain of PlanSys2") as tx:
            tx.load(domain)
            found = tx.state().domain
            for name in () if found is None else (*found.predicate_signatures, *found.function_signatures):
                tx.set_sensed(name, True)

    # -- knowledge --------------------------------------------------------------------------------------------

    def learn(self, message: Any) -> None:
        """Infer types of objects from a `Knowledge`, without recording it."""
        for text in (*message.predicates, *message.functions):
            atom = read_atom(text)
            self.types.observe(self._domain.symbol(atom.name), atom.arguments)

    def give_types(self, instances: Iterable[Any]) -> None:
        """Take the types of objects from `Param` messages."""
        for instance in instances:
            self.types.give(instance.name, instance.type)

    def missing_types(self, message: Any) -> list[str]:
        """Return the objects of a `Knowledge` whose types are not known yet."""
        return [name for name in message.instances if not self.types.knows(name)]

    def knowledge(self, message: Any, time: int, values: Sequence[Any] = ()) -> Transaction:
        """Make the state and the goal those of a `Knowledge`, by the difference alone (rule C13).

        Args:
            message: has `instances`, `predicates`, `functions` and `goal`.
            time: when it was published, in nanoseconds.
            values: `Node` messages of functions, since a `Knowledge` lists functions without their values. A function
                that is not among them keeps the value that is recorded, or remains undefined.

        Raises:
            InvalidKnowledge: with all violations, objects among them whose types cannot be inferred.
            ClockWentBackwards: the time is before what has been recorded.
        """
        if self.missing_types(message):
            self.learn(message)
        types = self.types.types_of(message.instances)
        objects = {name: _instance(name, type_name) for name, type_name in types.items()}
        # what is derived is listed by PlanSys2, too
        asserted = {text: _fact(text) for text in message.predicates}
        facts = {text: fact for text, fact in asserted.items() if not self._domain.is_derived(fact.attribute_name)}
        valued = _by_atom(_functions(values))
        self._clock.set(time)
        retyped = [old for name, old in self._objects.items() if name in types and old.instance_type != types[name]]
        if retyped:
            # an object of another type needs an end before it (C6)
            self._kb.remove(*retyped, client=self._client, note="another type")
            self._clock.set(time + 1)
        try:
            tx, functions = self._snapshot(message, objects, facts, valued, self._number)
        except Conflict:
            tx, functions = self._snapshot(message, objects, facts, valued, None)
        self._objects, self._facts, self._functions = objects, facts, functions
        self._goal, self._number = message.goal, tx.number
        return tx

    def _snapshot(
        self,
        message: Any,
        objects: dict[str, Instance],
        facts: dict[str, Fact],
        valued: Mapping[str, Function],
        number: int | None,
    ) -> tuple[Transaction, dict[str, Function]]:
        """Record a snapshot: the difference to the last one, if that is transaction `number` and nobody wrote since.

        Returns the functions, too: those of the snapshot that have a value, given or recorded.
        """
        with self._kb.transaction(client=self._client, note="snapshot", expect=number) as tx:
            recorded = _by_atom(tx.state().functions) if number is None else self._functions
            values = {**recorded, **valued}
            listed = [key(str(read_atom(text))) for text in message.functions]
            functions = {atom: values[atom] for atom in listed if atom in values}
            if number is None:
                tx.replace(*objects.values(), *facts.values(), *functions.values())
            else:
                tx.remove(*_without(self._facts, facts), *_without(self._objects, objects))
                tx.remove(*_without(self._functions, functions))
                tx.add(*_without(objects, self._objects), *_without(facts, self._facts), *functions.values())
            if number is None or message.goal != self._goal:
                tx.remove_goal(*tx.state().goals)
                if message.goal:
                    tx.add_goal(message.goal)
        return tx.result, functions

    def functions(self, nodes: Sequence[Any], time: int) -> Transaction:
        """Make the functions those of `Node` messages, and leave the rest of the state as it is.

        PlanSys2 publishes no `Knowledge` when a function is updated or removed. Functions of objects that are not
        recorded are left to the next `Knowledge`.
        """
        given = _by_atom(_functions(nodes))
        self._clock.set(time)
        with self._kb.transaction(client=self._client, note="functions") as tx:
            state = tx.state()
            exist = {key(name) for name in state.objects()}
            known = {atom: item for atom, item in given.items() if exist.issuperset(map(key, item.arguments))}
            tx.remove(*_without(_by_atom(state.functions), known))
            tx.add(*known.values())
        self._functions = known
        self._executions.recorded.append(tx.result.number)
        self._follow()
        return tx.result

    # -- plans and executions ---------------------------------------------------------------------------------

    def plan(self, message: Any, *, is_noted: bool = False) -> None:
        """Take the expected durations from a `Plan`; it is the note of the next start unless it `is_noted` already."""
        self._executions.plan(message, is_noted=is_noted)

    def action_execution_info(self, message: Any, time: int) -> None:
        """Record what an `ActionExecutionInfo` reports: a run that starts, ends or is aborted.

        Raises:
            UnknownSymbol, InvalidKnowledge: the domain does not have such an action, or the objects do not exist.
            ClockWentBackwards: the time is before what has been recorded.
        """
        self._clock.set(time)
        self._executions.info(message, time)
        self._follow()

    def actions_hub(self, message: Any, time: int) -> None:
        """Record what an `ActionExecution` reports, as `action_execution_info` does."""
        self._clock.set(time)
        self._executions.hub(message)
        self._follow()

    def _follow(self) -> None:
        """Count the executions' transactions as the mirror's; after one of somebody else's the state is not known."""
        for number in self._executions.recorded:
            if self._number is not None:
                self._number = number if number in (self._number, self._number + 1) else None
        self._executions.recorded.clear()


def declared_types(problem: str | os.PathLike[str], domain: Domain) -> Mapping[str, str]:
    """Return the objects that a problem declares, and their types."""
    return {item.instance_name: item.instance_type for item in read_problem(problem, domain).instances}


def _without(items: Mapping[str, Item], others: Mapping[str, Item]) -> list[Item]:
    """Return the items whose names are not among those of others."""
    return [item for name, item in items.items() if name not in others]


def _functions(nodes: Sequence[Any]) -> list[Function]:
    found = [read(node) for node in nodes]
    for node, item in zip(nodes, found, strict=True):
        if not isinstance(item, Function):
            raise InvalidKnowledge(f"{node!r:.80} is not a Node of a function")
    return [item for item in found if isinstance(item, Function)]


def _by_atom(items: Iterable[Function]) -> dict[str, Function]:
    return {key(item.atom): item for item in items}


@lru_cache(maxsize=50_000)
def _instance(name: str, type_name: str) -> Instance:
    return Instance(instance_name=name, instance_type=type_name)


@lru_cache(maxsize=50_000)
def _fact(text: str) -> Fact:
    atom = read_atom(text)
    return Fact(attribute_name=atom.name, values=atom.arguments)
