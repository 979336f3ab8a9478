"""The messages of the knowledge base as frozen Pydantic models, with the original field names and numbers."""

from kbstore.messages.base import Message, format_number
from kbstore.messages.domain import DomainOperator
from kbstore.messages.enums import (
    AssignOp,
    ComparisonType,
    ExprType,
    KnowledgeType,
    Operator,
    SpecialType,
    Truth,
    UpdateType,
)
from kbstore.messages.formulas import (
    DomainAssignment,
    DomainFormula,
    DomainInequality,
    ExprBase,
    ExprComposite,
    KeyValue,
    key_values,
)
from kbstore.messages.items import (
    Condition,
    Expression,
    Fact,
    Function,
    Goal,
    Inequality,
    Instance,
    KnowledgeItem,
    from_message,
)

__all__ = [
    "AssignOp",
    "ComparisonType",
    "Condition",
    "DomainAssignment",
    "DomainFormula",
    "DomainInequality",
    "DomainOperator",
    "ExprBase",
    "ExprComposite",
    "ExprType",
    "Expression",
    "Fact",
    "Function",
    "Goal",
    "Inequality",
    "Instance",
    "KeyValue",
    "KnowledgeItem",
    "KnowledgeType",
    "Message",
    "Operator",
    "SpecialType",
    "Truth",
    "UpdateType",
    "format_number",
    "from_message",
    "key_values",
]
