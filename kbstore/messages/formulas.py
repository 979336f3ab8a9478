"""Formulas and numeric expressions: DomainFormula, ExprBase, ExprComposite, DomainAssignment, DomainInequality."""

from collections.abc import Iterable, Mapping
from functools import lru_cache
from typing import Annotated, Any

from pydantic import BeforeValidator, model_validator

from kbstore.errors import InvalidKnowledge
from kbstore.messages.base import Message, as_list, format_number
from kbstore.messages.enums import AssignOp, ComparisonType, ExprType, Operator, SpecialType
from kbstore.names import bracketed


class KeyValue(Message):
    """A label with the object, or in an ungrounded formula the type, that belongs to it."""

    key: str = ""
    value: str = ""

    def __init__(self, key: str = "", value: str = "", **data: Any) -> None:
        data.update(key=key, value=value)
        super().__init__(**data)

    def __repr_args__(self) -> Iterable[tuple[str | None, Any]]:
        return [(None, self.key), (None, self.value)]


KNOWN_VALUES = 50_000
"""The most labelled names in the cache, which are about 25 MB."""


def key_values(labels: Iterable[str], names: Iterable[str]) -> tuple[KeyValue, ...]:
    """Label names that are known to be valid; there is one label for each name."""
    return tuple([_key_value(label, name) for label, name in zip(labels, names, strict=True)])


@lru_cache(maxsize=KNOWN_VALUES)
def _key_value(label: str, name: str) -> KeyValue:
    """Return the same object each time, as many facts refer to the same things."""
    return KeyValue.trusted(key=label, value=name)


def _read_values(values: Any) -> Any:
    """Labelled values from a mapping, or from a list of what `_read_value` reads."""
    if isinstance(values, Mapping):
        return tuple({"key": label, "value": name} for label, name in values.items())
    if isinstance(values, str | bytes) or not isinstance(values, Iterable):
        raise InvalidKnowledge(
            f"values are {{label: name}}, a list of KeyValue, or a list of names, not {values!r:.80}"
        )
    return tuple(values)


def _read_value(value: Any) -> Any:
    """One labelled value from a bare name; a KeyValue, and what has its fields, is left to the model."""
    if isinstance(value, str):
        return KeyValue.trusted(key="", value=value)
    if isinstance(value, KeyValue | Mapping) or (hasattr(value, "key") and hasattr(value, "value")):
        return value
    raise InvalidKnowledge(f"a value is a name, a KeyValue or {{'key': label, 'value': name}}, not {value!r:.80}")


Values = Annotated[
    tuple[Annotated[KeyValue, BeforeValidator(_read_value)], ...], BeforeValidator(_read_values), as_list(KeyValue)
]
"""Arguments with their labels; labels are empty where only names were given."""


class DomainFormula(Message):
    """An atomic formula: ungrounded, its parameters map label to type; grounded, label to object."""

    name: str = ""
    typed_parameters: Values = ()

    def __str__(self) -> str:
        """A grounded formula in PDDL."""
        return bracketed(self.name, *(p.value for p in self.typed_parameters))

    def __repr_args__(self) -> Iterable[tuple[str | None, Any]]:
        labelled = {parameter.key: parameter.value for parameter in self.typed_parameters}
        names = [parameter.value for parameter in self.typed_parameters]
        return [(None, self.name), (None, labelled if len(labelled) == len(names) and "" not in labelled else names)]

    def declaration(self) -> str:
        """An ungrounded formula in PDDL, for instance ``(robot_at ?r - robot ?wp - waypoint)``."""
        parameters = (f"?{p.key} - {p.value}" for p in self.typed_parameters)
        return bracketed(self.name, *parameters)


class ExprBase(Message):
    """One token of an expression in prefix order."""

    expr_type: ExprType
    constant: float = 0.0
    function: DomainFormula = DomainFormula()
    op: Operator = Operator.ADD
    special_type: SpecialType = SpecialType.HASHT

    @classmethod
    def of(cls, token: "float | int | DomainFormula | Operator | SpecialType") -> "ExprBase":
        """Make the token of a number, a function, an operator or a special number."""
        match token:
            case Operator():
                return cls(expr_type=ExprType.OPERATOR, op=token)
            case SpecialType():
                return cls(expr_type=ExprType.SPECIAL, special_type=token)
            case DomainFormula():
                return cls(expr_type=ExprType.FUNCTION, function=token)
            case _:
                return cls(expr_type=ExprType.CONSTANT, constant=token)

    def __str__(self) -> str:
        match self.expr_type:
            case ExprType.CONSTANT:
                return format_number(self.constant)
            case ExprType.FUNCTION:
                return str(self.function)
            case ExprType.OPERATOR:
                return self.op.pddl
            case ExprType.SPECIAL:
                return self.special_type.pddl


class ExprComposite(Message):
    """A numeric expression: its tokens in prefix (Polish) order, of any depth."""

    tokens: Annotated[tuple[ExprBase, ...], as_list(ExprBase)] = ()

    @model_validator(mode="after")
    def _check(self) -> "ExprComposite":
        """Each operator needs its operands, and nothing may be left over."""
        wanted = 1 if self.tokens else 0
        for index, token in enumerate(self.tokens):
            if wanted == 0:
                raise InvalidKnowledge(f"the expression ends before its token {index + 1}, {token}")
            wanted += token.op.arity - 1 if token.expr_type is ExprType.OPERATOR else -1
        if wanted:
            raise InvalidKnowledge(f"the expression {' '.join(map(str, self.tokens))!r:.80} lacks {wanted} operand(s)")
        return self

    def __str__(self) -> str:
        """The expression in PDDL."""
        return prefix_text(token.op if token.expr_type is ExprType.OPERATOR else str(token) for token in self.tokens)


def prefix_text(tokens: Iterable[Operator | str]) -> str:
    """Write an expression in PDDL, from its operators and the texts of its operands in prefix order.

    A sum whose first operand is a sum is written as one sum of all operands, and a product likewise: read again, the
    text gives the same nested expression.
    """
    words: list[str] = []
    lacking: list[int] = []
    before: Operator | str = ""
    for token in tokens:
        if token in (Operator.ADD, Operator.MUL) and token is before:
            lacking[-1] += 1
        elif isinstance(token, Operator):
            words.append(f"({token.pddl}")
            lacking.append(token.arity)
        else:
            closing = 0
            while lacking:
                lacking[-1] -= 1
                if lacking[-1]:
                    break
                lacking.pop()
                closing += 1
            words.append(token + ")" * closing)
        before = token
    return " ".join(words)


class DomainAssignment(Message):
    """The numeric effect of an action."""

    assign_type: AssignOp = AssignOp.ASSIGN
    LHS: DomainFormula = DomainFormula()
    RHS: ExprComposite = ExprComposite()
    grounded: bool = False

    def __str__(self) -> str:
        value = f"(* #t {self.RHS})" if self.assign_type is AssignOp.ASSIGN_CTS else str(self.RHS)
        return f"({self.assign_type.pddl} {self.LHS} {value})"


class DomainInequality(Message):
    """A comparison of two numeric expressions."""

    comparison_type: ComparisonType = ComparisonType.GREATER
    LHS: ExprComposite = ExprComposite()
    RHS: ExprComposite = ExprComposite()
    grounded: bool = True

    def __str__(self) -> str:
        return f"({self.comparison_type.pddl} {self.LHS} {self.RHS})"
