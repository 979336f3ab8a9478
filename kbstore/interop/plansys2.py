"""Reads PlanSys2's messages `Param`, `Node` and `Tree`, or mappings of their shape, as items and conditions.

A `Param` is an object with its type, a `Node` a fact or the value of a function, a `Tree` a condition. As in PlanSys2's
evaluation, nodes of type NOT negate in a tree; the field `negate` counts only for a single node.
"""

from collections.abc import Callable, Mapping, Sequence
from enum import IntEnum
from typing import Any, Protocol

from kbstore.errors import InvalidKnowledge
from kbstore.evaluation.wellformed import MAX_DEPTH
from kbstore.messages import AssignOp, ComparisonType, Fact, Function, Instance, Operator
from kbstore.model.expressions import Atom, NumericExpression
from kbstore.model.formulas import And, Comparison, Exists, Formula, Not, Or, Parameter, Same
from kbstore.names import is_wildcard, problem


class ParamMessage(Protocol):
    """A `plansys2_msgs/Param`."""

    @property
    def name(self) -> str:
        """The object's name."""

    @property
    def type(self) -> str:
        """Its type."""


class NodeMessage(Protocol):
    """A `plansys2_msgs/Node`."""

    @property
    def node_type(self) -> int:
        """The kind of the node (`NodeType`)."""


class TreeMessage(Protocol):
    """A `plansys2_msgs/Tree`."""

    @property
    def nodes(self) -> Sequence[Any]:
        """The nodes, the root first."""


class NodeType(IntEnum):
    """The kinds of nodes."""

    UNKNOWN = 0
    AND = 1
    OR = 2
    NOT = 3
    ACTION = 4
    PREDICATE = 5
    FUNCTION = 6
    EXPRESSION = 7
    FUNCTION_MODIFIER = 8
    NUMBER = 9
    CONSTANT = 10
    PARAMETER = 11
    EXISTS = 12


COMPARISONS = {
    13: ComparisonType.EQUALS,
    14: ComparisonType.GREATEREQ,
    15: ComparisonType.GREATER,
    16: ComparisonType.LESSEQ,
    17: ComparisonType.LESS,
}
OPERATORS = {18: Operator.MUL, 19: Operator.DIV, 20: Operator.ADD, 21: Operator.SUB}
MODIFIERS = {
    22: AssignOp.ASSIGN,
    23: AssignOp.INCREASE,
    24: AssignOp.DECREASE,
    25: AssignOp.SCALE_UP,
    26: AssignOp.SCALE_DOWN,
}
"""The numbers of comparisons, operators and changes in the fields `expression_type` and `modifier_type`."""

_OBJECTS = (NodeType.CONSTANT, NodeType.PARAMETER)


def read(message: object) -> Instance | Fact | Function | Formula | None:
    """Return the item or condition of a PlanSys2 message; None if it is not one.

    Raises `InvalidKnowledge` for a message that is not well-formed, or is neither: an action, an effect that is not a
    change by a number.
    """
    nodes = _field(message, "nodes")
    if nodes is not None:
        return _Tree(nodes).read()
    if _field(message, "node_type") is not None:
        return _Tree([message]).read()
    name, type_name = _field(message, "name"), _field(message, "type")
    if isinstance(name, str) and isinstance(type_name, str):
        return Instance(instance_name=name, instance_type=type_name)
    return None


def read_atom(text: str) -> Atom:
    """Read a predicate or function as PlanSys2 writes it, for instance ``(robot_at leia kitchen)``.

    Raises `InvalidKnowledge` for anything else.
    """
    words = text.strip().removeprefix("(").removesuffix(")").split()
    if not words or any(bracket in word for word in words for bracket in "()"):
        raise InvalidKnowledge(
            f"{text!r:.80} is not a predicate or function with its arguments, (robot_at leia kitchen)"
        )
    return Atom(words[0], tuple(words[1:]))


class _Tree:
    """Reads the nodes of a tree."""

    def __init__(self, nodes: Any) -> None:
        if not isinstance(nodes, Sequence) or isinstance(nodes, str | bytes) or not nodes:
            raise InvalidKnowledge(f"a Tree has a list of nodes, the root first, not {nodes!r:.80}")
        self._nodes = nodes
        self._open: list[int] = []
        """The nodes from the root to the one that is being read."""

    def read(self) -> Fact | Function | Formula:
        """Return the whole tree as a condition, or as an item if its root is one."""
        root = self._nodes[0]
        match self._kind(root):
            case NodeType.FUNCTION:
                atom = self._atom(root)
                return Function(attribute_name=atom.name, values=atom.arguments, function_value=self._value(root))
            case NodeType.FUNCTION_MODIFIER:
                return self._change(root)
            case NodeType.PREDICATE:
                atom = self._atom(root)
                return Fact(
                    attribute_name=atom.name,
                    values=atom.arguments,
                    is_negative=bool(_field(root, "negate")),
                )
            case _:
                condition: Formula = self._at(0, self._condition)
                return condition

    def _change(self, node: Any) -> Function:
        function, operand = self._children(node, 2)
        atom, value = self._at(function, self._expression), self._at(operand, self._expression)
        operation = MODIFIERS.get(_field(node, "modifier_type"))
        if operation is None or not isinstance(atom[0], Atom) or not isinstance(value[0], float) or len(value) != 1:
            raise InvalidKnowledge("a FUNCTION_MODIFIER changes a function by a number: its children are these two")
        return Function(
            attribute_name=atom[0].name, values=atom[0].arguments, function_value=value[0], assign_op=operation
        )

    # -- conditions and expressions ---------------------------------------------------------------------------

    def _condition(self, node: Any) -> Formula:
        match self._kind(node):
            case NodeType.AND:
                return And(tuple([self._at(child, self._condition) for child in self._children(node)]))
            case NodeType.OR:
                return Or(tuple([self._at(child, self._condition) for child in self._children(node)]))
            case NodeType.NOT:
                return Not(self._at(self._children(node, 1)[0], self._condition))
            case NodeType.PREDICATE:
                return self._atom(node)
            case NodeType.EXISTS:
                parameters = tuple(
                    Parameter(_name(_field(found, "name")).removeprefix("?"), (_field(found, "type") or "object",))
                    for found in _field(node, "parameters") or ()
                )
                return Exists(parameters, self._at(self._children(node, 1)[0], self._condition))
            case NodeType.EXPRESSION if _field(node, "expression_type") in COMPARISONS:
                return self._comparison(node)
            case kind:
                raise InvalidKnowledge(f"a node of type {kind.name} is not a condition")

    def _comparison(self, node: Any) -> Formula:
        left, right = self._children(node, 2)
        comparison = COMPARISONS[_field(node, "expression_type")]
        sides = [self._nodes[child] for child in (left, right)]
        if comparison is ComparisonType.EQUALS and all(self._kind(side) in _OBJECTS for side in sides):
            return Same(*(self._term(side) for side in sides))
        return Comparison(comparison, self._at(left, self._expression), self._at(right, self._expression))

    def _expression(self, node: Any) -> NumericExpression:
        match self._kind(node):
            case NodeType.NUMBER:
                return (self._value(node),)
            case NodeType.FUNCTION:
                return (self._atom(node),)
            case NodeType.EXPRESSION if _field(node, "expression_type") in OPERATORS:
                left, right = self._children(node, 2)
                operator = OPERATORS[_field(node, "expression_type")]
                return (operator, *self._at(left, self._expression), *self._at(right, self._expression))
            case kind:
                raise InvalidKnowledge(f"a node of type {kind.name} is not a number")

    # -- nodes ------------------------------------------------------------------------------------------------

    def _at(self, index: int, read: Callable[[Any], Any]) -> Any:
        """Read a node that is a child of the one that is being read. Raises `InvalidKnowledge` for a cycle."""
        if index in self._open:
            raise InvalidKnowledge(f"node {index} of the tree is below itself; a tree has no cycle of children")
        if len(self._open) >= MAX_DEPTH:
            raise InvalidKnowledge(f"the tree is deeper than {MAX_DEPTH} nodes; split it")
        self._open.append(index)
        try:
            return read(self._nodes[index])
        finally:
            self._open.pop()

    def _children(self, node: Any, number: int | None = None) -> list[int]:
        children = [int(child) for child in _field(node, "children") or ()]
        kind = self._kind(node).name
        if number is not None and len(children) != number:
            raise InvalidKnowledge(f"a node of type {kind} has {number} child nodes, not {len(children)}")
        if not all(0 <= child < len(self._nodes) for child in children):
            raise InvalidKnowledge(f"a node of type {kind} has the children {children}, of {len(self._nodes)} nodes")
        return children

    @staticmethod
    def _kind(node: Any) -> NodeType:
        number = _field(node, "node_type")
        try:
            return NodeType(number)
        except ValueError:
            known = ", ".join(f"{kind.name} {kind.value}" for kind in NodeType)
            raise InvalidKnowledge(f"{number!r:.40} is not the type of a Node; it is one of {known}") from None

    @staticmethod
    def _value(node: Any) -> float:
        value = _field(node, "value")
        if isinstance(value, bool) or not isinstance(value, float | int):
            raise InvalidKnowledge(f"the value of a Node is a number, not {value!r:.80}")
        return float(value)

    def _term(self, node: Any) -> str:
        """Return the name of an object or of a variable, which a PARAMETER has in its parameters."""
        named = node
        if self._kind(node) is NodeType.PARAMETER and not _field(node, "name"):
            named = next(iter(_field(node, "parameters") or ()), node)
        return _name(_field(named, "name"))

    @staticmethod
    def _atom(node: Any) -> Atom:
        arguments = tuple(_name(_field(found, "name")) for found in _field(node, "parameters") or ())
        return Atom(_name(_field(node, "name")), arguments)


def _field(message: Any, name: str) -> Any:
    """Return a field of a message; None if it has none of that name."""
    return message.get(name) if isinstance(message, Mapping) else getattr(message, name, None)


def _name(name: Any) -> str:
    """Return a name that PDDL text can have. Raises `InvalidKnowledge` for any other."""
    if not isinstance(name, str):
        raise InvalidKnowledge(f"a name is text, not {name!r:.80}")
    wrong = None if is_wildcard(name) else problem(name)
    if wrong:
        raise InvalidKnowledge(f"the name {name!r:.80} {wrong}")
    return name
