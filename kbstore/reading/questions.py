"""Everything that can be asked, read as a condition or an expression: PDDL text, items, messages, formulas."""

from collections.abc import Mapping
from typing import cast, get_args

from kbstore import logic
from kbstore.composites import unlabelled
from kbstore.domain import Domain
from kbstore.errors import InvalidKnowledge
from kbstore.messages import (
    Condition,
    ExprBase,
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
    found = knowledge if isinstance(knowledge, _ITEMS) else from_message(knowledge)
    match found:
        case Expression():
            return found.changed(expr=_arranged(found.expr, vocabulary))
        case Inequality(ineq=ineq):
            sides = {"LHS": _arranged(ineq.LHS, vocabulary), "RHS": _arranged(ineq.RHS, vocabulary)}
            return found.changed(ineq=ineq.model_copy(update=sides))
    return found


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
        item = _in_order(item, vocabulary)
    return condition_of(item, vocabulary.domain)


def as_expression(question: object, vocabulary: Vocabulary) -> logic.Expression:
    """The numeric expression whose value is asked for."""
    if isinstance(question, str):
        return parse_expression(question)
    if isinstance(question, ExprComposite):
        return from_composite(_arranged(question, vocabulary))
    if isinstance(question, tuple):
        return question
    if isinstance(question, logic.Atom):
        return (question,)
    item = as_item(question, vocabulary)
    if isinstance(item, Expression):
        return from_composite(item.expr)
    if not isinstance(item, Function):
        raise InvalidKnowledge(f"{item} has no value; ask for that of a function or expression, as: (battery kenny)")
    condition = condition_of(item.changed(function_value=None, is_negative=False), vocabulary.domain)
    return (cast("logic.Defined", condition).function,)


def _arranged(composite: ExprComposite, vocabulary: Vocabulary) -> ExprComposite:
    """The expression with its functions' arguments in the order of the parameters that they are labelled with (D1)."""
    if not any(parameter.key for token in composite.tokens for parameter in token.function.typed_parameters):
        return composite
    return ExprComposite(tokens=tuple(_arranged_token(token, vocabulary) for token in composite.tokens))


def _arranged_token(token: ExprBase, vocabulary: Vocabulary) -> ExprBase:
    given = token.function.typed_parameters
    if token.expr_type is not ExprType.FUNCTION or not any(parameter.key for parameter in given):
        return token
    labels, values = [parameter.key for parameter in given], [parameter.value for parameter in given]
    name, arguments = vocabulary.ordered(KnowledgeType.FUNCTION, token.function.name, values, labels)
    return token.model_copy(update={"function": unlabelled(logic.Atom(name, arguments))})


def _in_order(item: Fact | Function, vocabulary: Vocabulary) -> Fact | Function:
    """Without a domain, labels are those of the symbol's first use (rule D2)."""
    _, arguments = vocabulary.ordered(item.knowledge_type, item.attribute_name, item.arguments, item.labels)
    return type(item).model_validate({**item.model_dump(), "values": list(arguments)})


def item(text_or_mapping: object, domain: Domain | None = None) -> KnowledgeItem:
    """The knowledge item of a PDDL text, a mapping in the shape of the ROS message, or an object with its attributes.

    >>> str(item("(not (door_open wp7))"))
    '(not (door_open wp7))'
    """
    return as_item(text_or_mapping, Vocabulary(domain))
