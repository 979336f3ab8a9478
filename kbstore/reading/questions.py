"""Everything that can be asked, read as a condition or an expression: PDDL text, items, messages, formulas."""

from collections.abc import Mapping
from typing import cast, get_args

from kbstore import logic
from kbstore.domain import Domain
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
from kbstore.pddl.forms import condition_of, from_composite, parse_condition, parse_expression, parse_item
from kbstore.vocabulary import Vocabulary

Question = str | KnowledgeItem | Condition | logic.Condition | Mapping[str, object] | object
"""What can be asked: PDDL text, an item, a mapping or object in the shape of the ROS message, a formula."""

_ITEMS = (Instance, Fact, Function, Expression, Inequality)
_FORMULAS = get_args(logic.Condition)


def as_item(knowledge: object, vocabulary: Vocabulary) -> KnowledgeItem:
    """The item that is meant by PDDL text, a message, a mapping in its shape, or an object with its attributes."""
    if isinstance(knowledge, str):
        item = parse_item(knowledge, vocabulary.domain)
        if isinstance(item, Fact) and vocabulary.domain is None and vocabulary.is_function(item.attribute_name):
            return Function(attribute_name=item.attribute_name, values=item.values, is_negative=item.is_negative)
        return item
    given = knowledge if isinstance(knowledge, _ITEMS) else from_message(knowledge)
    match given:
        case Inequality():
            left, right = _in_order(given.ineq.LHS, vocabulary), _in_order(given.ineq.RHS, vocabulary)
            return given.changed(ineq=given.ineq.changed(LHS=left, RHS=right))
        case Expression():
            return given.changed(expr=_in_order(given.expr, vocabulary))
    return given


def as_condition(question: Question, vocabulary: Vocabulary) -> logic.Condition:
    """The condition that a question asks."""
    if isinstance(question, str):
        condition = parse_condition(question, vocabulary.domain)
        if isinstance(condition, logic.Atom) and vocabulary.domain is None and vocabulary.is_function(condition.name):
            return logic.Defined(condition)
        return condition
    if isinstance(question, _FORMULAS):
        return cast("logic.Condition", question)
    if isinstance(question, Condition):
        return parse_condition(question.text, vocabulary.domain)
    item = as_item(question, vocabulary)
    if vocabulary.domain is None and isinstance(item, Fact | Function) and any(item.labels):
        item = _unlabelled(item, vocabulary)
    return condition_of(item, vocabulary.domain)


def as_expression(question: object, vocabulary: Vocabulary) -> logic.Expression:
    """The numeric expression whose value is asked for."""
    if isinstance(question, str):
        return parse_expression(question)
    if isinstance(question, ExprComposite):
        return from_composite(_in_order(question, vocabulary))
    if isinstance(question, tuple):
        return question
    if isinstance(question, logic.Atom):
        return (question,)
    item = as_item(question, vocabulary)
    if isinstance(item, Expression):
        return from_composite(item.expr)
    if not isinstance(item, Function):
        raise InvalidKnowledge(f"{item} has no value; ask for that of a function or expression, as: (battery kenny)")
    condition = as_condition(item.changed(function_value=None, is_negative=False), vocabulary)
    return (cast("logic.Defined", condition).function,)


def _in_order(expression: ExprComposite, vocabulary: Vocabulary) -> ExprComposite:
    """The expression with the arguments of its functions in the order of the parameters (rules D1, D2)."""

    def arranged(formula: DomainFormula) -> DomainFormula:
        given = formula.typed_parameters
        labels = [parameter.key for parameter in given]
        _, arguments = vocabulary.ordered(KnowledgeType.FUNCTION, formula.name, [p.value for p in given], labels)
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


def _unlabelled(item: Fact | Function, vocabulary: Vocabulary) -> Fact | Function:
    """Without a domain, labels are those of the symbol's first use (rule D2)."""
    _, arguments = vocabulary.ordered(item.knowledge_type, item.attribute_name, item.arguments, item.labels)
    return type(item).model_validate({**item.model_dump(), "values": list(arguments)})


def item(text_or_mapping: object, domain: Domain | None = None) -> KnowledgeItem:
    """The knowledge item of a PDDL text, a mapping in the shape of the ROS message, or an object with its attributes.

    >>> str(item("(not (door_open wp7))"))
    '(not (door_open wp7))'
    """
    return as_item(text_or_mapping, Vocabulary(domain))
