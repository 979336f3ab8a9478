"""The enums of the messages, with their numbers."""

from enum import Enum, IntEnum
from typing import NoReturn, TypeVar

_Enum = TypeVar("_Enum", bound=Enum)


def plain(enum: type[_Enum]) -> type[_Enum]:
    """Make the members of an enum plain attributes of its class, for those that are read on the hot path.

    Python 3.11 finds ``KnowledgeType.FACT`` through a descriptor, which takes five times as long. Python 3.12 dropped
    it: delete this function together with the support of 3.11.
    """
    for member in enum:
        type.__setattr__(enum, member.name, member)
    return enum


@plain
class KnowledgeType(IntEnum):
    """The type of a knowledge item."""

    # an enum hashes by its name, in Python; these are parts of keys on the hot path
    __hash__ = int.__hash__

    INSTANCE = 0
    FACT = 1
    FUNCTION = 2
    EXPRESSION = 3
    INEQUALITY = 4


@plain
class UpdateType(IntEnum):
    """The operation of an update."""

    ADD_KNOWLEDGE = 0
    ADD_GOAL = 1
    REMOVE_KNOWLEDGE = 2
    REMOVE_GOAL = 3
    ADD_METRIC = 4
    REMOVE_METRIC = 5


@plain
class AssignOp(IntEnum):
    """The change of a value by a numeric effect or a function item (rule C7)."""

    ASSIGN = 0
    INCREASE = 1
    DECREASE = 2
    SCALE_UP = 3
    SCALE_DOWN = 4
    ASSIGN_CTS = 5

    @property
    def pddl(self) -> str:
        """The word for it in PDDL; a continuous effect is an ``increase`` by ``(* #t rate)``."""
        return _ASSIGN_WORDS[self]


@plain
class ComparisonType(IntEnum):
    """The comparison of two numeric expressions."""

    GREATER = 0
    GREATEREQ = 1
    LESS = 2
    LESSEQ = 3
    EQUALS = 4

    @property
    def pddl(self) -> str:
        """The symbol for it in PDDL."""
        return _COMPARISON_SYMBOLS[self]


class ExprType(IntEnum):
    """The type of a token of an expression."""

    CONSTANT = 0
    FUNCTION = 1
    OPERATOR = 2
    SPECIAL = 3


class Operator(IntEnum):
    """An arithmetic operator in an expression."""

    ADD = 0
    SUB = 1
    MUL = 2
    DIV = 3
    UMINUS = 4

    @property
    def pddl(self) -> str:
        """The symbol for it in PDDL; the unary minus is ``-``, too."""
        return _OPERATOR_SYMBOLS[self]

    @property
    def arity(self) -> int:
        """The number of operands in prefix order."""
        return 1 if self is Operator.UMINUS else 2


class SpecialType(IntEnum):
    """A special number in an expression: elapsed time, total time, the duration of an action."""

    HASHT = 0
    TOTAL_TIME = 1
    DURATION = 2

    @property
    def pddl(self) -> str:
        """The word for it in PDDL."""
        return _SPECIAL_WORDS[self]


_ASSIGN_WORDS = ("assign", "increase", "decrease", "scale-up", "scale-down", "increase")
_COMPARISON_SYMBOLS = (">", ">=", "<", "<=", "=")
_OPERATOR_SYMBOLS = ("+", "-", "*", "/", "-")
_SPECIAL_WORDS = ("#t", "(total-time)", "?duration")


@plain
class Truth(Enum):
    """The three truth values of Kleene's logic.

    A truth value has no `bool()`: unknown is neither true nor false. Compare it (``is Truth.TRUE``), or ask
    `holds`, which is True exactly when the truth is TRUE.
    """

    TRUE = "true"
    FALSE = "false"
    UNKNOWN = "unknown"

    __hash__ = object.__hash__

    def __bool__(self) -> NoReturn:
        raise TypeError("a Truth may be UNKNOWN and has no bool(); use holds(), or compare: truth(...) is Truth.TRUE")

    def __invert__(self) -> "Truth":
        return _NEGATION[self]

    def __str__(self) -> str:
        return self.value

    @classmethod
    def of(cls, value: bool) -> "Truth":
        """Return TRUE or FALSE for a bool."""
        return cls.TRUE if value else cls.FALSE


_NEGATION = {Truth.TRUE: Truth.FALSE, Truth.FALSE: Truth.TRUE, Truth.UNKNOWN: Truth.UNKNOWN}
