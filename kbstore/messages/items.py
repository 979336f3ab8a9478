"""The KnowledgeItem in its five types, and the Condition, for goals that no item can carry."""

from abc import abstractmethod
from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Annotated, Any, Literal

from pydantic import BeforeValidator, Field, TypeAdapter, ValidationError, field_validator, model_validator

from kbstore.clock import TimeLike, isoformat, time
from kbstore.errors import InvalidKnowledge
from kbstore.messages.base import Message, format_number, lazy, typed_error
from kbstore.messages.enums import AssignOp, KnowledgeType
from kbstore.messages.formulas import DomainInequality, ExprComposite, KeyValue, Values
from kbstore.names import bracketed, key

ValuesLike = Mapping[str, str] | Iterable[str | KeyValue]
"""Arguments as callers may give them: objects by label, labelled values, or names in order."""

Time = Annotated[int, BeforeValidator(lambda value: 0 if value is None else time(value))]
"""Nanoseconds; as an `initial_time`, 0 means now (T1)."""


class _Item(Message):
    initial_time: Time = 0
    is_negative: bool = False

    @model_validator(mode="before")
    @classmethod
    def _read_whole_message(cls, data: Any) -> Any:
        """Read a whole KnowledgeItem message: it has the fields of all five types, and those of the others are ignored.

        A mapping without `knowledge_type` has been written for this model, so that any other field is a mistake.
        """
        if isinstance(data, Mapping) and "knowledge_type" in data:
            return {name: value for name, value in data.items() if name not in _FIELDS or name in cls.model_fields}
        return data

    def __repr_args__(self) -> Iterable[tuple[str | None, Any]]:
        yield from super().__repr_args__()
        if self.initial_time:
            yield "since", isoformat(self.initial_time)

    @property
    @abstractmethod
    def text(self) -> str:
        """The item in PDDL without its sign."""

    def __str__(self) -> str:
        # no name in PDDL has a line break; one in a message must not break the line of a log
        return (f"(not {self.text})" if self.is_negative else self.text).replace("\n", r"\n")


class Instance(_Item):
    """An object, and its type: ``wp7 - waypoint``. Negative, the end of the object's existence."""

    knowledge_type: Literal[KnowledgeType.INSTANCE] = KnowledgeType.INSTANCE
    instance_type: str = ""
    instance_name: str = ""

    @property
    def text(self) -> str:
        """For instance ``wp7 - waypoint``."""
        text = f"{self.instance_name} - {self.instance_type}" if self.instance_type else self.instance_name
        return f"({text})" if self.is_negative else text


class _Attribute(_Item):
    attribute_name: str = ""
    values: Values = ()

    @lazy
    def arguments(self) -> tuple[str, ...]:
        """The names of the arguments, in the item's order."""
        return tuple([value.value for value in self.values])

    @lazy
    def labels(self) -> tuple[str, ...]:
        """The labels of the arguments, empty where there are none."""
        return tuple([value.key for value in self.values])

    @lazy
    def key(self) -> tuple[str, ...]:
        """The attribute's name and the arguments as they are compared (rule D3)."""
        return tuple(map(key, (self.attribute_name, *self.arguments)))

    @lazy
    def timeline_key(self) -> str:
        """The key in one text, which is that of the timeline where the arguments are in the order of the parameters."""
        return " ".join(self.key)

    @property
    def text(self) -> str:
        """The atom in PDDL, for instance ``(robot_at kenny wp0)``."""
        return bracketed(self.attribute_name, *self.arguments)


class Fact(_Attribute):
    """A proposition: ``(robot_at kenny wp0)``. Negative, it is explicitly false (rule V2)."""

    knowledge_type: Literal[KnowledgeType.FACT] = KnowledgeType.FACT

    if TYPE_CHECKING:

        def __init__(
            self,
            *,
            attribute_name: str = "",
            values: ValuesLike = (),
            is_negative: bool = False,
            initial_time: TimeLike | None = 0,
            knowledge_type: Literal[KnowledgeType.FACT] = KnowledgeType.FACT,
        ) -> None: ...


def trusted_fact(name: str, values: Values, *, is_negative: bool = False, **known: Any) -> Fact:
    """Make a fact of parts that are known to be valid, with the defaults of all other fields.

    `known` are the values of `lazy` properties that need not be computed again.
    """
    return Fact.trusted(
        initial_time=0,
        is_negative=is_negative,
        attribute_name=name,
        values=values,
        knowledge_type=KnowledgeType.FACT,
        **known,
    )


class Function(_Attribute):
    """A numeric function's value: ``(= (battery kenny) 80)``, or a change of it (rule C7).

    `rate` is in units per second. In a question, an item without `function_value` asks whether the function is defined.
    """

    knowledge_type: Literal[KnowledgeType.FUNCTION] = KnowledgeType.FUNCTION
    function_value: float | None = None
    assign_op: AssignOp = AssignOp.ASSIGN
    rate: float = 0.0

    if TYPE_CHECKING:

        def __init__(
            self,
            *,
            attribute_name: str = "",
            values: ValuesLike = (),
            function_value: float | None = None,
            assign_op: AssignOp = AssignOp.ASSIGN,
            rate: float = 0.0,
            is_negative: bool = False,
            initial_time: TimeLike | None = 0,
            knowledge_type: Literal[KnowledgeType.FUNCTION] = KnowledgeType.FUNCTION,
        ) -> None: ...

    @field_validator("function_value", "rate", mode="before")
    @classmethod
    def _number(cls, value: Any) -> Any:
        # a message may carry NaN, as a float64 does; what is stored may not (rule C7), which is decided there
        if isinstance(value, bool):
            raise InvalidKnowledge(f"{value!r} is not a value for a numeric function; give a number")
        return value

    @property
    def atom(self) -> str:
        """The function's term in PDDL, for instance ``(battery kenny)``."""
        return super().text

    @property
    def text(self) -> str:
        """The assignment in PDDL, for instance ``(increase (battery kenny) 5)``."""
        if self.function_value is None:
            return self.atom
        value = format_number(self.function_value)
        match self.assign_op:
            case AssignOp.ASSIGN:
                return f"(= {self.atom} {value})"
            case AssignOp.ASSIGN_CTS:
                return f"(increase {self.atom} (* #t {value}))"
            case operation:
                return f"({operation.pddl} {self.atom} {value})"


class Expression(_Item):
    """The metric: ``minimize (total-time)``."""

    knowledge_type: Literal[KnowledgeType.EXPRESSION] = KnowledgeType.EXPRESSION
    optimization: str = ""
    expr: ExprComposite = ExprComposite()

    @field_validator("optimization")
    @classmethod
    def _known(cls, value: str) -> str:
        if value.lower() not in ("", "minimize", "maximize"):
            raise InvalidKnowledge(f"{value!r:.60} is not an optimization; give 'minimize' or 'maximize'")
        return value.lower()

    @property
    def text(self) -> str:
        """For instance ``minimize (total-time)``."""
        return f"{self.optimization} {self.expr}".strip()


class Inequality(_Item):
    """A comparison of two numeric expressions: ``(> (battery kenny) 20)``."""

    knowledge_type: Literal[KnowledgeType.INEQUALITY] = KnowledgeType.INEQUALITY
    ineq: DomainInequality

    @property
    def text(self) -> str:
        """For instance ``(> (battery kenny) 20)``."""
        return str(self.ineq)


class Condition(Message):
    """A goal that no KnowledgeItem can carry (a disjunction, a quantified or preferred goal), in PDDL text."""

    text: str
    initial_time: Time = 0

    def __str__(self) -> str:
        return self.text


KnowledgeItem = Annotated[
    Instance | Fact | Function | Expression | Inequality,
    Field(discriminator="knowledge_type", description="A piece of knowledge, in one of five types."),
]
"""A piece of knowledge, discriminated by its `knowledge_type`."""

Goal = Fact | Inequality | Condition
"""A part of the goal (rule C10)."""

_MODELS: dict[int, type[Message]] = {
    KnowledgeType.INSTANCE: Instance,
    KnowledgeType.FACT: Fact,
    KnowledgeType.FUNCTION: Function,
    KnowledgeType.EXPRESSION: Expression,
    KnowledgeType.INEQUALITY: Inequality,
}
_FIELDS = frozenset(name for model in _MODELS.values() for name in model.model_fields)
_ADAPTER: TypeAdapter[KnowledgeItem] = TypeAdapter(KnowledgeItem)


def from_message(message: object) -> KnowledgeItem:
    """Read an item from a mapping in the shape of the ROS message, or from an object with its attributes.

    Raises `InvalidKnowledge` with one sentence for each wrong field, and for a message without a `knowledge_type`;
    `InvalidTime` for an `initial_time` that is not a time.
    """
    try:
        return _ADAPTER.validate_python(message)
    except ValidationError as error:
        first = error.errors(include_url=False, include_context=False, include_input=False)[0]
        if first["loc"]:
            name = _MODELS[int(first["loc"][0])].__name__
            raise typed_error(name, error, depth=1) from None
    expected = ", ".join(f"{kind.name} {kind.value}" for kind in KnowledgeType)
    raise InvalidKnowledge(f"{message!r:.80} is not a KnowledgeItem: its knowledge_type is one of {expected}")
