"""Calls of PlanSys2's experts without ROS: requests, responses and messages are made from their definitions."""

from kbstore.interop.plansys2 import NodeType
from tests.ros.doubles import given, make


class Messages:
    """Message types by name, like the module `plansys2_msgs.msg`."""

    def __getattr__(self, name):
        return lambda: make(name)


def call(expert, service, **fields):
    """The response to a service with some fields of its request set."""
    kind = expert.TYPES[service]
    return expert.answer(service, given(f"{kind}Request", **fields), make(f"{kind}Response"))


def param(name, type_name=""):
    """A `Param` without subtypes, as clients write it."""
    return given("Param", name=name, type=type_name)


def node(kind, name="", *arguments, **fields):
    """A `Node`; its arguments are names."""
    return given("Node", node_type=int(kind), name=name, parameters=[param(a) for a in arguments], **fields)


def predicate(name, *arguments, **fields):
    """A `Node` of a predicate."""
    return node(NodeType.PREDICATE, name, *arguments, **fields)


def function(name, *arguments, value=0.0):
    """A `Node` of a function."""
    return node(NodeType.FUNCTION, name, *arguments, value=value)


def tree(*nodes):
    """A `Tree` of nodes, the root first."""
    for number, found in enumerate(nodes):
        found.node_id = number
    return given("Tree", nodes=list(nodes))


def text(message, number=0):
    """A node of a tree, with all below it, as text; or a node alone."""
    if not hasattr(message, "nodes"):
        return f"({' '.join((message.name, *(p.name for p in message.parameters)))})"
    if not message.nodes:
        return ""
    found = message.nodes[number]
    assert found.node_id == number
    below = [text(message, child) for child in found.children]
    match NodeType(found.node_type):
        case NodeType.PREDICATE | NodeType.FUNCTION:
            return text(found)
        case NodeType.NUMBER:
            return str(found.value)
        case NodeType.CONSTANT:
            return found.name
        case NodeType.PARAMETER:
            return found.parameters[0].name
        case NodeType.EXISTS:
            return f"(exists {' '.join(f'{p.name}:{p.type}' for p in found.parameters)} {below[0]})"
        case NodeType.EXPRESSION:
            sign = {13: "=", 14: ">=", 15: ">", 16: "<=", 17: "<", 18: "*", 19: "/", 20: "+", 21: "-"}
            return f"({sign[found.expression_type]} {' '.join(below)})"
        case NodeType.FUNCTION_MODIFIER:
            change = {22: "assign", 23: "increase", 24: "decrease", 25: "scale-up", 26: "scale-down"}
            return f"({change[found.modifier_type]} {' '.join(below)})"
        case kind:
            return f"({' '.join((kind.name.lower(), *below))})"
