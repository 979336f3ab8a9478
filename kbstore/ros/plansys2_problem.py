"""PlanSys2's problem expert: its services, answered from a knowledge base, which they change in one transaction each.

Requests and responses are used by the attributes of the messages; no ROS is imported.
"""

from typing import Any, ClassVar

from kbstore.errors import InvalidKnowledge
from kbstore.interop.plansys2 import NodeType, read_atom
from kbstore.interop.plansys2_messages import MessageWriter
from kbstore.knowledge_base import KnowledgeBase
from kbstore.messages import Fact, Function, Instance, KnowledgeType
from kbstore.model.domain import ROOT_TYPE
from kbstore.model.expressions import Atom
from kbstore.names import bracketed, is_wildcard, key
from kbstore.pddl.parse import condition_of
from kbstore.pddl.problem_reader import read_problem
from kbstore.reading.state import State
from kbstore.ros.plansys2_service import Expert
from kbstore.writing.unit_of_work import OpenTransaction


class ProblemExpert(Expert):
    """Answers the services below ``problem_expert/``."""

    TYPES: ClassVar = {
        "add_problem": "AddProblem",
        "add_problem_function": "AffectNode",
        "add_problem_goal": "AddProblemGoal",
        "add_problem_instance": "AffectParam",
        "add_problem_predicate": "AffectNode",
        "clear_problem_knowledge": "ClearProblemKnowledge",
        "exist_problem_function": "ExistNode",
        "exist_problem_predicate": "ExistNode",
        "get_problem": "GetProblem",
        "get_problem_function": "GetNodeDetails",
        "get_problem_functions": "GetStates",
        "get_problem_goal": "GetProblemGoal",
        "get_problem_instance": "GetProblemInstanceDetails",
        "get_problem_instances": "GetProblemInstances",
        "get_problem_predicate": "GetNodeDetails",
        "get_problem_predicates": "GetStates",
        "is_problem_goal_satisfied": "IsProblemGoalSatisfied",
        "remove_problem_function": "AffectNode",
        "remove_problem_goal": "RemoveProblemGoal",
        "remove_problem_instance": "AffectParam",
        "remove_problem_predicate": "AffectNode",
        "update_problem_function": "AffectNode",
    }

    CHANGING = frozenset(name for name in TYPES if name.startswith(("add", "clear", "remove", "update")))
    """The services after which, if they succeed, `update_notify` is published."""

    QUIET = frozenset({"remove_problem_function", "update_problem_function"})
    """The changing services after which no `Knowledge` is published."""

    def __init__(self, kb: KnowledgeBase, messages: Any, *, client: str = "problem_expert") -> None:
        """Answer for a knowledge base.

        Args:
            kb: has a domain.
            messages: message types by name, like the module `plansys2_msgs.msg`.
            client: the client of all transactions.
        """
        self._kb = kb
        self._messages = messages
        self._client = client

    def _transaction(self, note: str) -> OpenTransaction:
        return self._kb.transaction(client=self._client, note=note)

    def _writer(self) -> MessageWriter:
        return MessageWriter(self._messages, self._kb.domain)

    # -- problems and goals -----------------------------------------------------------------------------------

    def add_problem(self, request: Any, response: Any) -> None:
        """Add a problem in PDDL to what holds; its goal, if it has one, replaces the goal."""
        text = request.problem
        if "(" not in text:
            raise InvalidKnowledge(f"the problem is PDDL text, (define (problem ...) ...), not {text!r:.80}")
        with self._transaction("add_problem") as tx:
            if read_problem(text, self._kb.domain).goals:
                tx.remove_goal(*tx.state().goals)
            tx.load(None, text)

    def get_problem(self, request: Any, response: Any) -> None:
        """Answer with the problem in PDDL."""
        response.problem = self._kb.to_pddl()

    def add_problem_goal(self, request: Any, response: Any) -> None:
        """Replace the goal."""
        if _is_empty(request.tree):
            raise InvalidKnowledge("the goal is empty; give a Tree with a condition, or call remove_problem_goal")
        with self._transaction("add_problem_goal") as tx:
            tx.remove_goal(*tx.state().goals)
            tx.add_goal(request.tree)

    def remove_problem_goal(self, request: Any, response: Any) -> None:
        """Remove the whole goal."""
        with self._transaction("remove_problem_goal") as tx:
            tx.remove_goal(*tx.state().goals)

    def get_problem_goal(self, request: Any, response: Any) -> None:
        """Answer with the goal: a conjunction, or a tree without nodes."""
        writer = self._writer()
        response.tree = writer.tree(condition_of(goal, writer.domain) for goal in self._kb.goals())

    def is_problem_goal_satisfied(self, request: Any, response: Any) -> None:
        """Answer whether a goal holds; an empty one does."""
        response.satisfied = not request.tree.nodes or self._kb.holds(request.tree)

    def clear_problem_knowledge(self, request: Any, response: Any) -> None:
        """End everything that holds; the constants of the domain remain."""
        with self._transaction("clear_problem_knowledge") as tx:
            tx.clear()

    # -- objects ----------------------------------------------------------------------------------------------

    def add_problem_instance(self, request: Any, response: Any) -> None:
        """Add an object; a constant of that type is there already."""
        if not request.param.type:
            raise InvalidKnowledge(f"{request.param.name} is without a type; give one that the domain declares")
        constants = self._kb.domain.constant_types
        if constants.get(key(request.param.name)) != key(request.param.type):
            with self._transaction("add_problem_instance") as tx:
                tx.add(request.param)

    def remove_problem_instance(self, request: Any, response: Any) -> None:
        """Remove an object by its name, of any type, and its mentions."""
        name = request.param.name
        with self._transaction("remove_problem_instance") as tx:
            _existing(name, tx.state())
            tx.remove(Instance(instance_name=name))

    def get_problem_instance(self, request: Any, response: Any) -> None:
        """Answer with an object and its type."""
        found = _existing(request.instance, self._kb.state())
        response.instance = self._writer().param(found.instance_name, (found.instance_type,))

    def get_problem_instances(self, request: Any, response: Any) -> None:
        """Answer with all objects, constants included."""
        writer, found = self._writer(), self._kb.instances(include_constants=True)
        response.instances = [writer.param(item.instance_name, (item.instance_type,)) for item in found]

    # -- predicates -------------------------------------------------------------------------------------------

    def add_problem_predicate(self, request: Any, response: Any) -> None:
        """Add a fact; with `negate`, that it is false."""
        with self._transaction("add_problem_predicate") as tx:
            tx.add(_fact(request.node, is_negative=bool(request.node.negate)))

    def remove_problem_predicate(self, request: Any, response: Any) -> None:
        """Remove a fact; one that does not hold may be removed, of objects that exist and fit.

        The `negate` of a node is ignored: a delete effect in a tree of PlanSys2 has it set.
        """
        fact = _fact(request.node)
        self._check(fact, fact)
        with self._transaction("remove_problem_predicate") as tx:
            tx.remove(fact)

    def exist_problem_predicate(self, request: Any, response: Any) -> None:
        """Answer whether a fact holds, derived ones included; the `negate` of a node is ignored."""
        response.exist = self._kb.holds(_fact(request.node))

    def get_problem_predicate(self, request: Any, response: Any) -> None:
        """Answer with a fact that holds, given as text."""
        atom = read_atom(request.expression)
        if not self._kb.holds(atom):
            raise InvalidKnowledge(f"{atom} does not hold")
        response.node = self._writer().atom(NodeType.PREDICATE, atom)

    def get_problem_predicates(self, request: Any, response: Any) -> None:
        """Answer with all facts that hold, derived ones included."""
        writer = self._writer()
        response.states = [writer.atom(NodeType.PREDICATE, atom) for atom in _true_atoms(self._kb.state())]

    # -- functions --------------------------------------------------------------------------------------------

    def add_problem_function(self, request: Any, response: Any) -> None:
        """Set the value of a function."""
        with self._transaction("add_problem_function") as tx:
            tx.add(_function(request.node))

    def update_problem_function(self, request: Any, response: Any) -> None:
        """Set the value of a function that has one."""
        function = _function(request.node)
        self._kb.value(function.atom)
        with self._transaction("update_problem_function") as tx:
            tx.add(function)

    def remove_problem_function(self, request: Any, response: Any) -> None:
        """Remove the value of a function; one without a value may be removed, of objects that exist and fit."""
        function = _function(request.node)
        self._check(function, function.changed(function_value=None))
        with self._transaction("remove_problem_function") as tx:
            tx.remove(function)

    def exist_problem_function(self, request: Any, response: Any) -> None:
        """Answer whether a function has a value."""
        response.exist = self._kb.holds(_function(request.node).changed(function_value=None))

    def get_problem_function(self, request: Any, response: Any) -> None:
        """Answer with a function and its value, given as text."""
        atom = read_atom(request.expression)
        node = self._writer().atom(NodeType.FUNCTION, atom)
        node.value = self._kb.value(str(atom))
        response.node = node

    def get_problem_functions(self, request: Any, response: Any) -> None:
        """Answer with all functions that have values."""
        writer = self._writer()
        nodes = []
        for function in self._kb.functions():
            node = writer.atom(NodeType.FUNCTION, Atom(function.attribute_name, function.arguments))
            node.value = function.function_value
            nodes.append(node)
        response.states = nodes

    def _check(self, item: Fact | Function, question: Fact | Function) -> None:
        """Raise `InvalidKnowledge` for an item with an object that does not exist, as PlanSys2 does, or does not fit.

        It is checked before the transaction (rule V10), which would read the whole state for that.
        """
        for name in item.arguments:
            # the removal itself takes ? for any object
            if is_wildcard(name) or not self._kb.holds(Instance(instance_name=name, instance_type=ROOT_TYPE)):
                raise InvalidKnowledge(f"{item}: there is no object {name}")
        self._kb.holds(question)

    # -- everything -------------------------------------------------------------------------------------------

    def knowledge(self) -> Any:
        """Return the state as a `Knowledge`: functions are listed without their values, as PlanSys2 does."""
        state = self._kb.state()
        message = self._messages.Knowledge()
        constants = () if state.domain is None else state.domain.constants
        message.instances = [*(item.instance_name for item in state.instances), *constants]
        message.predicates = [bracketed(key(atom.name), *atom.arguments) for atom in _true_atoms(state)]
        message.functions = [bracketed(key(item.attribute_name), *item.arguments) for item in state.functions]
        message.goal = f"(and {' '.join(map(str, state.goals))})" if state.goals else ""
        return message


def _fact(node: Any, *, is_negative: bool = False) -> Fact:
    _check_kind(node, NodeType.PREDICATE)
    return Fact(attribute_name=node.name, values=_arguments(node), is_negative=is_negative)


def _function(node: Any) -> Function:
    _check_kind(node, NodeType.FUNCTION)
    return Function(attribute_name=node.name, values=_arguments(node), function_value=node.value)


def _check_kind(node: Any, kind: NodeType) -> None:
    """Raise `InvalidKnowledge` for a node of another kind; a node without a kind will do, as with PlanSys2."""
    if node.node_type not in (NodeType.UNKNOWN, kind):
        raise InvalidKnowledge(
            f"{node.name or 'the node'} has the node_type {node.node_type}, not {kind.name} {kind:d}"
        )


def _arguments(node: Any) -> list[str]:
    return [parameter.name for parameter in node.parameters]


def _is_empty(tree: Any) -> bool:
    """Return whether a tree is empty: it has no nodes, or its root should have parts and has none."""
    nodes = tree.nodes
    return not nodes or (nodes[0].node_type in _WITH_PARTS and not nodes[0].children)


_WITH_PARTS = (NodeType.AND, NodeType.OR, NodeType.NOT, NodeType.EXPRESSION, NodeType.FUNCTION_MODIFIER)


def _existing(name: str, state: State) -> Instance:
    """Return an object or constant as it was first written. Raises `InvalidKnowledge` if it does not exist."""
    type_name, domain = state.snapshot.type_of(key(name)), state.domain
    if type_name is None or domain is None:
        raise InvalidKnowledge(f"there is no object {name}")
    row = state.snapshot.row(KnowledgeType.INSTANCE, key(name))
    spelling = row[0].spelling if row is not None else domain.constant_spelling(name) or name
    return Instance(instance_name=spelling, instance_type=domain.type_spelling(type_name))


def _true_atoms(state: State) -> list[Atom]:
    """Return the facts that are true, derived ones included."""
    found = [Atom(fact.attribute_name, fact.arguments) for fact in state.facts if not fact.is_negative]
    for rules in state.domain.rules.values() if state.domain is not None else ():
        head = rules[0].head
        variables = [f"a{position}" for position in range(len(head.parameters))]
        for bindings in state.find(Atom(head.name, tuple(f"?{name}" for name in variables))):
            found.append(Atom(head.name, tuple(bindings[name] for name in variables)))
    return found
