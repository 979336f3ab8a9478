"""A deliberately naive knowledge base: a list of transactions, and the world after each of them.

It is written from the rules alone, shares no code with kbstore, and prefers being obviously right to being fast:
current and scheduled assertions are two dictionaries, and time is walked forward one scheduled time after the other.
Items and answers are plain Python values with names in lower case.
"""

from tests.oracle.corrections import Refused, Update
from tests.oracle.items import (
    Comparison,
    Condition,
    Fact,
    Flow,
    Item,
    Limit,
    Metric,
    Number,
    Object,
    RefAction,
    RefDomain,
    Signature,
    Start,
    Timeline,
    Wanted,
)
from tests.oracle.memory import Answer, Change, Difference, Reference
from tests.oracle.world import Unsettled

__all__ = [
    "Answer",
    "Change",
    "Comparison",
    "Condition",
    "Difference",
    "Fact",
    "Flow",
    "Item",
    "Limit",
    "Metric",
    "Number",
    "Object",
    "RefAction",
    "RefDomain",
    "Reference",
    "Refused",
    "Signature",
    "Start",
    "Timeline",
    "Unsettled",
    "Update",
    "Wanted",
]
