"""Reads questions in all their forms (PDDL text, items, messages, formulas) as items, conditions or expressions."""

from collections.abc import Mapping, Sequence
from typing import Any, Protocol, cast, get_args

from pydantic import ValidationError

from kbstore.conversion import from_composite
from kbstore.errors import InvalidKnowledge
from kbstore.interop import plansys2
from kbstore.messages import (
    Condition,
    DomainFormula,
    DomainInequality,
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
from kbstore.messages.base import typed_error
from kbstore.model import formulas
from kbstore.model.domain import Domain
from kbstore.model.expressions import NumericExpression
from kbstore.model.symbols import SymbolTable
from kbstore.pddl.parse import condition_of, parse_condition, parse_expression, parse_item
from kbstore.pddl.printer import condition_text


class KnowledgeMessage(Protocol):
    """A ROS message KnowledgeItem."""

    @property
    def knowledge_type(self) -> int:
        """Which of the five types it is."""


class InequalityMessage(Protocol):
    """A ROS message DomainInequality."""

    @property
    def comparison_type(self) -> int:
        """The comparison of the two sides."""


class ExpressionMessage(Protocol):
    """A ROS message ExprComposite."""

    @property
    def tokens(self) -> Sequence[Any]:
        """The expression in prefix order."""


Knowledge = (
    str
    | KnowledgeItem
    | Condition
    | KnowledgeMessage
    | InequalityMessage
    | plansys2.ParamMessage
    | plansys2.NodeMessage
    | plansys2.TreeMessage
    | Mapping[str, Any]
)
"""A piece of knowledge: PDDL text, an item, or a message of ROSPlan or PlanSys2, as an object or as a mapping."""

Question = Knowledge | ExpressionMessage | formulas.Formula | NumericExpression
"""A question: a piece of knowledge, or a condition or an expression, as a message or of the model."""

_ITEMS = (Fact, Function, Instance, Expression, Inequality)
_FORMULAS = get_args(formulas.Formula)
_DECODED = (str, *_ITEMS, Condition, ExprComposite, DomainInequality, *_FORMULAS, tuple)

_Decoded = str | KnowledgeItem | Condition | ExprComposite | DomainInequality | formulas.Formula | NumericExpression


def decoded(question: Question) -> _Decoded:
    """Return the item, condition or expression of a message or a mapping, by its fields; anything else as it is.

    Raises `InvalidKnowledge` if it does not have the fields of any message, or if one of them is wrong.
    """
    if isinstance(question, _DECODED):
        return question  # type: ignore[no-any-return]

    def has(field: str) -> bool:
        return field in question if isinstance(question, Mapping) else hasattr(question, field)

    if not has("knowledge_type"):
        for model, field in ((ExprComposite, "tokens"), (DomainInequality, "comparison_type")):
            if has(field):
                try:
                    return model.model_validate(question)
                except ValidationError as error:
                    raise typed_error(model.__name__, error) from None
        meant = plansys2.read(question)
        if meant is not None:
            return meant
    return from_message(question)


def as_item(knowledge: Question, symbol_table: SymbolTable) -> KnowledgeItem:
    """Return the item of a PDDL text, a message, a mapping with its fields, or an object with its attributes."""
    if isinstance(knowledge, str):
        item = parse_item(knowledge, symbol_table.domain)
        if isinstance(item, Fact) and symbol_table.domain is None and symbol_table.is_function(item.attribute_name):
            return Function(attribute_name=item.attribute_name, values=item.values, is_negative=item.is_negative)
        return item
    given = decoded(knowledge)
    match given:
        case Fact() | Function() | Instance():
            return given
        case DomainInequality():
            return as_item(Inequality(ineq=given), symbol_table)
        case Inequality():
            left, right = _in_order(given.ineq.LHS, symbol_table), _in_order(given.ineq.RHS, symbol_table)
            return given.changed(ineq=given.ineq.changed(LHS=left, RHS=right))
        case Expression():
            return given.changed(expr=_in_order(given.expr, symbol_table))
        case ExprComposite() | tuple():
            raise InvalidKnowledge(f"{given!s:.200} is an expression, which has a value: ask for it by kb.value(...)")
        case Condition():
            return parse_item(given.text, symbol_table.domain)
        case _:
            return parse_item(condition_text(cast("formulas.Formula", given)), symbol_table.domain)


def as_condition(question: Question, symbol_table: SymbolTable) -> formulas.Formula:
    """Return the condition that a question asks."""
    if isinstance(question, str):
        condition = parse_condition(question, symbol_table.domain)
        if (
            isinstance(condition, formulas.Atom)
            and symbol_table.domain is None
            and symbol_table.is_function(condition.name)
        ):
            return formulas.Defined(condition)
        if isinstance(condition, formulas.IsA) and not condition.type_name:
            raise InvalidKnowledge(
                f"{condition.name} is a bare word, and not a condition; a fact is in brackets: ({condition.name}); "
                f"whether an object exists is asked with its type: {condition.name} - object"
            )
        return condition
    given = decoded(question)
    if isinstance(given, _FORMULAS):
        return cast("formulas.Formula", given)
    if isinstance(given, Condition):
        return parse_condition(given.text, symbol_table.domain)
    item = as_item(given, symbol_table)
    if symbol_table.domain is None and isinstance(item, Fact | Function) and any(item.labels):
        item = _unlabelled(item, symbol_table)
    return condition_of(item, symbol_table.domain)


def as_expression(question: Question, symbol_table: SymbolTable) -> NumericExpression:
    """Return the numeric expression whose value a question asks for."""
    if isinstance(question, str):
        return parse_expression(question)
    given = decoded(question)
    if isinstance(given, ExprComposite):
        return from_composite(_in_order(given, symbol_table))
    if isinstance(given, tuple):
        return given
    if isinstance(given, formulas.Atom):
        return (given,)
    item = as_item(given, symbol_table)
    if isinstance(item, Expression):
        return from_composite(item.expr)
    if not isinstance(item, Function):
        raise InvalidKnowledge(f"{item} has no value; ask for that of a function or expression, as: (battery kenny)")
    condition = as_condition(item.changed(function_value=None, is_negative=False), symbol_table)
    return (cast("formulas.Defined", condition).function,)


def _in_order(expression: ExprComposite, symbol_table: SymbolTable) -> ExprComposite:
    """Return an expression with the arguments of its functions in the order of the parameters (rules D1, D2)."""

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
    """Return an item with its arguments in the order of the symbol's first use, and without labels (rule D2)."""
    _, arguments = symbol_table.ordered(item.knowledge_type, item.attribute_name, item.arguments, item.labels)
    return type(item).model_validate({**item.model_dump(), "values": list(arguments)})


def item(text_or_mapping: Knowledge, domain: Domain | None = None) -> KnowledgeItem:
    """Return the item of a PDDL text, a mapping with a ROS message's fields, or an object with its attributes.

    >>> str(item("(not (door_open wp7))"))
    '(not (door_open wp7))'
    """
    return as_item(text_or_mapping, SymbolTable(domain))
