"""Writes PlanSys2's messages: `Param`, `Node`, `Tree`, and the details of a domain.

PlanSys2 reads a domain in lower case and compares exactly, so symbols are written in lower case, and objects as they
are. Its evaluation does not negate a conjunction as a whole, so negations are written before atoms.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any

from kbstore.errors import InvalidKnowledge
from kbstore.interop.plansys2 import COMPARISONS, MODIFIERS, OPERATORS, NodeType
from kbstore.messages import AssignOp, Operator
from kbstore.model.actions import Action
from kbstore.model.domain import DerivedRule, Domain, Signature
from kbstore.model.expressions import Atom, NumericExpression, Token
from kbstore.model.formulas import (
    Add,
    And,
    Comparison,
    Delete,
    Effect,
    Exists,
    Forall,
    Formula,
    Imply,
    Not,
    NumericEffect,
    Or,
    Preference,
    Same,
    Timing,
    Truism,
)
from kbstore.names import key
from kbstore.pddl.printer import condition_text

_COMPARISONS = {meant: number for number, meant in COMPARISONS.items()}
_OPERATORS = {meant: number for number, meant in OPERATORS.items()}
_MODIFIERS = {meant: number for number, meant in MODIFIERS.items()}

_FIELDS = {
    Timing.AT_START: ("at_start_requirements", "at_start_effects"),
    Timing.OVER_ALL: ("over_all_requirements", None),
    Timing.AT_END: ("at_end_requirements", "at_end_effects"),
}
"""The fields of a `DurativeAction` for conditions and effects."""

Names = Mapping[str, str]
"""The name to write for each variable, by the variable's key without the question mark."""


class MessageWriter:
    """Writes messages of one domain; `types` has the message types by name, like the module `plansys2_msgs.msg`."""

    def __init__(self, types: Any, domain: Domain) -> None:
        self.types = types
        self.domain = domain

    # -- parameters and atoms ---------------------------------------------------------------------------------

    def param(self, name: str, types: Sequence[str] = ()) -> Any:
        """Write an object, or a parameter, with its type and all types below it."""
        message = self.types.Param()
        message.name = name
        if types:
            message.type = key(types[0])
            below = self.domain.subtypes(tuple(types))
            message.sub_types = [t for t in map(key, self.domain.types) if t in below and t != message.type]
        return message

    def atom(self, kind: NodeType, atom: Atom, names: Names | None = None) -> Any:
        """Write a predicate or function with its arguments, and the types of its parameters."""
        node = self.types.Node()
        node.node_type, node.name = int(kind), key(atom.name)
        symbols = self.domain.predicate_signatures if kind is NodeType.PREDICATE else self.domain.function_signatures
        signature = symbols.get(key(atom.name))
        is_declared = signature is not None and len(signature.parameters) == len(atom.arguments)
        types = [p.types for p in signature.parameters] if signature and is_declared else [()] * len(atom.arguments)
        found = (_bound(argument, names or {}) for argument in atom.arguments)
        node.parameters = [self.param(*named) for named in zip(found, types, strict=True)]
        return node

    def symbol(self, kind: NodeType, signature: Signature) -> Any:
        """Write the declaration of a predicate or function; PlanSys2 calls its parameters by type and position."""
        node = self.types.Node()
        node.node_type, node.name = int(kind), key(signature.name)
        node.parameters = [
            self.param(f"?{key(p.types[0])}{position}", p.types) for position, p in enumerate(signature.parameters)
        ]
        return node

    # -- trees ------------------------------------------------------------------------------------------------

    def tree(self, parts: Iterable[Formula | Effect], names: Names | None = None) -> Any:
        """Write conditions or effects as one conjunction; without any, a tree without nodes.

        Raises `InvalidKnowledge` for what a `Tree` cannot carry.
        """
        message = self.types.Tree()
        message.nodes = _TreeWriter(self, names or {}).conjunction(parts)
        return message

    # -- actions and rules ------------------------------------------------------------------------------------

    def action(self, action: Action, arguments: Sequence[str]) -> Any:
        """Write an instantaneous action, with objects for its parameters as far as they are given."""
        message, names = self._action(self.types.Action(), action, arguments)
        message.preconditions = self.tree(action.conditions_at(Timing.AT_START), names)
        message.effects = self.tree(action.effects_at(Timing.AT_START), names)
        return message

    def durative_action(self, action: Action, arguments: Sequence[str]) -> Any:
        """Write a durative action, with objects for its parameters as far as they are given."""
        message, names = self._action(self.types.DurativeAction(), action, arguments)
        for timing, (requirements, effects) in _FIELDS.items():
            setattr(message, requirements, self.tree(action.conditions_at(timing), names))
            if effects:
                setattr(message, effects, self.tree(action.effects_at(timing), names))
            elif action.effects_at(timing):
                raise _no_message(f"the continuous effects of {action.name}")
        return message

    def derived(self, rule: DerivedRule) -> Any:
        """Write a rule for a derived predicate."""
        message = self.types.Derived()
        message.predicate = self.symbol(NodeType.PREDICATE, rule.head)
        message.preconditions = self.tree([rule.condition], _names(rule.head, ()))
        return message

    def _action(self, message: Any, action: Action, arguments: Sequence[str]) -> tuple[Any, Names]:
        message.name = key(action.name)
        names = _names(action, arguments)
        message.parameters = [self.param(names[key(p.name)], p.types) for p in action.parameters]
        return message, names


class _TreeWriter:
    """The nodes of one tree, the root first."""

    def __init__(self, writer: MessageWriter, names: Names) -> None:
        self._writer = writer
        self._names = names
        self._nodes: list[Any] = []

    def conjunction(self, parts: Iterable[Formula | Effect]) -> list[Any]:
        """Return the nodes of a conjunction, whose parts may be conjunctions, too."""
        found = [part for whole in parts for part in _split(whole)]
        if found:
            self._branch(NodeType.AND, found, self._part)
        return self._nodes

    def _part(self, part: Formula | Effect) -> None:
        match part:
            case Add(atom):
                self._condition(atom)
            case Delete(atom):
                self._condition(Not(atom))
            case NumericEffect(operation, function, value) if operation is not AssignOp.ASSIGN_CTS:
                node = self._add(NodeType.FUNCTION_MODIFIER)
                node.modifier_type = _MODIFIERS[operation]
                self._below(node, lambda: self._atom(NodeType.FUNCTION, function))
                self._below(node, lambda: self._expression(value))
            case _ if isinstance(part, Formula):
                self._condition(part)
            case _:
                raise _no_message("a conditional, universal or continuous effect")

    def _condition(self, condition: Formula, *, negated: bool = False) -> None:
        match condition:
            case Not(part):
                self._condition(part, negated=not negated)
            case Imply(premise, conclusion):
                self._condition(Or((Not(premise), conclusion)), negated=negated)
            case And(parts) | Or(parts):
                kind = NodeType.AND if isinstance(condition, And) is not negated else NodeType.OR
                self._branch(kind, parts, lambda part: self._condition(part, negated=negated))
            case Truism():
                self._add(NodeType.OR if negated else NodeType.AND)
            case Forall(parameters, part) if negated:
                self._condition(Exists(parameters, Not(part)))
            case Atom() | Comparison() | Same() | Exists() if negated:
                self._branch(NodeType.NOT, [condition], lambda part: self._leaf(part, negate=True))
            case Atom() | Comparison() | Same() | Exists():
                self._leaf(condition)
            case _:
                raise _no_message(condition_text(condition))

    def _leaf(self, condition: Formula, *, negate: bool = False) -> None:
        match condition:
            case Atom():
                node = self._atom(NodeType.PREDICATE, condition)
            case Comparison(comparison, left, right):
                node = self._add(NodeType.EXPRESSION)
                node.expression_type = _COMPARISONS[comparison]
                for side in (left, right):
                    self._below(node, lambda side=side: self._expression(side))
            case Same(left, right):
                node = self._add(NodeType.EXPRESSION)
                node.expression_type = 13
                for term in (left, right):
                    self._below(node, lambda term=term: self._term(term))
            case Exists(parameters, part):
                node = self._add(NodeType.EXISTS)
                node.parameters = [self._writer.param(_bound(f"?{p.name}", self._names), p.types) for p in parameters]
                self._below(node, lambda: self._condition(part))
        node.negate = negate

    def _term(self, term: str) -> None:
        """Write an object or a variable; PlanSys2 has the name of a PARAMETER in its parameters."""
        name = _bound(term, self._names)
        if name.startswith("?"):
            self._add(NodeType.PARAMETER).parameters = [self._writer.param(name)]
        else:
            self._add(NodeType.CONSTANT).name = name

    def _expression(self, expression: NumericExpression) -> None:
        self._operand(iter(expression), expression)

    def _operand(self, tokens: Iterator[Token], whole: NumericExpression) -> None:
        match next(tokens):
            case Atom() as function:
                self._atom(NodeType.FUNCTION, function)
            case Operator.UMINUS:
                node = self._add(NodeType.EXPRESSION)
                node.expression_type = _OPERATORS[Operator.SUB]
                self._below(node, lambda: self._number(0.0))
                self._below(node, lambda: self._operand(tokens, whole))
            case Operator() as operator:
                node = self._add(NodeType.EXPRESSION)
                node.expression_type = _OPERATORS[operator]
                for _ in range(2):
                    self._below(node, lambda: self._operand(tokens, whole))
            case float(number) | int(number):
                self._number(float(number))
            case _:
                raise _no_message("?duration, #t and total-time")

    def _number(self, number: float) -> None:
        self._add(NodeType.NUMBER).value = number

    def _atom(self, kind: NodeType, atom: Atom) -> Any:
        return self._add(kind, self._writer.atom(kind, atom, self._names))

    def _branch(self, kind: NodeType, parts: Sequence[Any], write: Any) -> None:
        node = self._add(kind)
        for part in parts:
            self._below(node, lambda part=part: write(part))

    def _below(self, node: Any, write: Any) -> None:
        """Write a part as the next child of a node."""
        node.children = [*node.children, len(self._nodes)]
        write()

    def _add(self, kind: NodeType, node: Any = None) -> Any:
        node = self._writer.types.Node() if node is None else node
        node.node_type, node.node_id = int(kind), len(self._nodes)
        self._nodes.append(node)
        return node


def _split(part: Formula | Effect) -> Iterator[Formula | Effect]:
    """Yield the parts of a conjunction without truisms and preferences, which never fail."""
    match part:
        case And(parts):
            for inner in parts:
                yield from _split(inner)
        case Truism() | Preference():
            pass
        case _:
            yield part


def _names(declared: Action | Signature, arguments: Sequence[str]) -> Names:
    """Return the name for each parameter: its object if one is given, otherwise its position, ``?2``."""
    given = [*arguments, *(f"?{position}" for position in range(len(arguments), len(declared.parameters)))]
    return {key(p.name): name for p, name in zip(declared.parameters, given, strict=False)}


def _bound(argument: str, names: Names) -> str:
    return names.get(key(argument[1:]), argument) if argument.startswith("?") else argument


def _no_message(what: str) -> InvalidKnowledge:
    return InvalidKnowledge(
        f"PlanSys2's messages cannot carry {what}; take the PDDL text, from get_domain or get_problem"
    )
