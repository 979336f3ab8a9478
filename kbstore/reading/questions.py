"""Everything that can be asked, read as a condition or an expression: PDDL text, items, messages, formulas."""

from collections.abc import Mapping
from typing import Any, Protocol, cast, get_args

from kbstore.conversion import from_composite
from kbstore.errors import InvalidKnowledge
from kbstore.messages import (
    Condition,
    DomainFormula,
    ExprComposite,
    Expression,
    ExprType,
    Fact,
    Function,
    Inequality,
    Instance,
    KnowledgeItem,
    KnowledgeType,
    from_message,
    key_values,
)
from kbstore.model import formulas
from kbstore.model.domain import Domain
from kbstore.model.expressions import NumericExpression
from kbstore.model.symbols import SymbolTable
from kbstore.pddl.parse import condition_of, parse_condition, parse_expression, parse_item


class KnowledgeMessage(Protocol):
    """A ROS message KnowledgeItem."""

    @property
    def knowledge_type(self) -> int:
        """Which of the five types it is."""


Knowledge = str | KnowledgeItem | Condition | KnowledgeMessage | Mapping[str, Any]
"""A piece of knowledge: PDDL text, an item, or a ROS message, as an object or as a mapping of the same shape."""

Question = Knowledge | ExprComposite | formulas.Formula | NumericExpression
"""A question: a piece of knowledge, or a condition or an expression of the model."""

_ITEMS = (Instance, Fact, Function, Expression, Inequality)
_FORMULAS = get_args(formulas.Formula)


def as_item(knowledge: Question, symbol_table: SymbolTable) -> KnowledgeItem:
    """The item that is meant by PDDL text, a message, a mapping in its shape, or an object with its attributes."""
    if isinstance(knowledge, str):
        item = parse_item(knowledge, symbol_table.domain)
        if isinstance(item, Fact) and symbol_table.domain is None and symbol_table.is_function(item.attribute_name):
            return Function(attribute_name=item.attribute_name, values=item.values, is_negative=item.is_negative)
        return item
    given = knowledge if isinstance(knowledge, _ITEMS) else from_message(knowledge)
    match given:
        case Inequality():
            left, right = _in_order(given.ineq.LHS, symbol_table), _in_order(given.ineq.RHS, symbol_table)
            return given.changed(ineq=given.ineq.changed(LHS=left, RHS=right))
        case Expression():
            return given.changed(expr=_in_order(given.expr, symbol_table))
    return given


def as_condition(question: Question, symbol_table: SymbolTable) -> formulas.Formula:
    """The condition that a question asks."""
    if isinstance(question, str):
        condition = parse_condition(question, symbol_table.domain)
        if (
            isinstance(condition, formulas.Atom)
            and symbol_table.domain is None
            and symbol_table.is_function(condition.name)
        ):
            return formulas.Defined(condition)
        return condition
    if isinstance(question, _FORMULAS):
        return cast("formulas.Formula", question)
    if isinstance(question, Condition):
        return parse_condition(question.text, symbol_table.domain)
    item = as_item(question, symbol_table)
    if symbol_table.domain is None and isinstance(item, Fact | Function) and any(item.labels):
        item = _unlabelled(item, symbol_table)
    return condition_of(item, symbol_table.domain)


def as_expression(question: Question, symbol_table: SymbolTable) -> NumericExpression:
    """The numeric expression whose value is asked for."""
    if isinstance(question, str):
        return parse_expression(question)
    if isinstance(question, ExprComposite):
        return from_composite(_in_order(question, symbol_table))
    if isinstance(question, tuple):
        return question
    if isinstance(question, formulas.Atom):
        return (question,)
    item = as_item(question, symbol_table)
    if isinstance(item, Expression):
        return from_composite(item.expr)
    if not isinstance(item, Function):
        raise InvalidKnowledge(f"{item} has no value; ask for that of a function or expression, as: (battery kenny)")
    condition = as_condition(item.changed(function_value=None, is_negative=False), symbol_table)
    return (cast("formulas.Defined", condition).function,)


def _in_order(expression: ExprComposite, symbol_table: SymbolTable) -> ExprComposite:
    """The expression with the arguments of its functions in the order of the parameters (rules D1, D2)."""

    def arranged(formula: DomainFormula) -> DomainFormula:
        given = formula.typed_parameters
        labels = [parameter.key for parameter in given]
        _, arguments = symbol_table.ordered(KnowledgeType.FUNCTION, formula.name, [p.value for p in given], labels)
        return formula.changed(typed_parameters=key_values(("",) * len(arguments), arguments))

    tokens = expression.tokens
    if not any(parameter.key for token in tokens for parameter in token.function.typed_parameters):
        return expression
    return expression.changed(
        tokens=tuple(
            token.changed(function=arranged(token.function)) if token.expr_type is ExprType.FUNCTION else token
            for token in tokens
        )
    )


def _unlabelled(item: Fact | Function, symbol_table: SymbolTable) -> Fact | Function:
    """Without a domain, labels are those of the symbol's first use (rule D2)."""
    _, arguments = symbol_table.ordered(item.knowledge_type, item.attribute_name, item.arguments, item.labels)
    return type(item).model_validate({**item.model_dump(), "values": list(arguments)})


def item(text_or_mapping: Knowledge, domain: Domain | None = None) -> KnowledgeItem:
    """The knowledge item of a PDDL text, a mapping in the shape of the ROS message, or an object with its attributes.

    >>> str(item("(not (door_open wp7))"))
    '(not (door_open wp7))'
    """
    return as_item(text_or_mapping, SymbolTable(domain))
