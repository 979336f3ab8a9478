"""The shapes of the answers in JSON: knowledge as PDDL with its parts, times as ISO 8601 text.

The models read kbstore's results by their attributes. A time is text, exact to the nanosecond: JavaScript rounds
numbers of that size.
"""

from typing import Annotated, Any, Generic, Literal, TypeVar

from pydantic import BaseModel, BeforeValidator, ConfigDict, TypeAdapter, WithJsonSchema, model_validator

from kbstore.clock import isoformat
from kbstore.messages import Condition, Expression, Fact, Function, Instance
from kbstore.reading.state import State

T = TypeVar("T")

Time = Annotated[
    str,
    BeforeValidator(isoformat),
    WithJsonSchema({"type": "string", "format": "date-time", "examples": ["2026-05-04T09:00:00.000000001Z"]}),
]
Text = Annotated[str, BeforeValidator(str)]
Truth = Annotated[Literal["true", "false", "unknown"], BeforeValidator(str)]


class _Answer(BaseModel):
    model_config = ConfigDict(from_attributes=True, frozen=True)


class Item(_Answer):
    """A piece of knowledge: an object, a fact, a number, a goal, a metric or an inequality."""

    pddl: str
    kind: Literal["instance", "fact", "function", "expression", "inequality", "condition"]
    name: str | None = None
    """The predicate, function or object."""
    arguments: list[str] | None = None
    type: str | None = None
    """The type of an object."""
    is_negative: bool = False
    value: float | None = None
    rate: float | None = None
    """How fast a number changes, per second."""
    since: Time | None = None
    """The time since when it holds, or from which on it is scheduled to."""

    @model_validator(mode="before")
    @classmethod
    def _read(cls, item: Any) -> dict[str, Any]:
        found: dict[str, Any] = {"pddl": str(item), "since": item.initial_time}
        match item:
            case Condition():
                return found | {"kind": "condition"}
            case Instance():
                found |= {"name": item.instance_name, "type": item.instance_type}
            case Fact():
                found |= {"name": item.attribute_name, "arguments": item.arguments}
            case Function():
                found |= {"name": item.attribute_name, "arguments": item.arguments}
                found |= {"value": item.function_value, "rate": item.rate}
        kind = item.knowledge_type.name.lower()
        return found | {"kind": kind, "is_negative": not isinstance(item, Expression) and item.is_negative}


class Transaction(_Answer):
    """One atomic change."""

    number: int
    time: Time
    client: str
    note: str
    changes: int
    """How many timelines it changed; 0 if there was nothing to change, and nothing was recorded."""


class Assertion(_Answer):
    """One row of history: the item held from `initial_time` until `end_time`, null while it is open."""

    item: Item
    initial_time: Time
    end_time: Time | None
    recorded: Transaction
    ended: Transaction | None
    cancelled: Transaction | None
    superseded: Transaction | None
    is_goal: bool


class Broken(_Answer):
    """An invariant of an action that was not true in a span."""

    condition: str
    truth: Truth
    since: Time
    until: Time | None


class Run(_Answer):
    """A durative action that runs, or ran; `seconds` is its duration."""

    number: int
    operator: str
    arguments: list[str]
    started: Time
    seconds: float
    expected_end: Time
    ended: Time | None
    outcome: Literal["running", "ended", "aborted"]
    started_by: int
    ended_by: int | None
    forced: list[str]
    broken: list[Broken]


class Change(_Answer):
    """What one transaction did, or, where `by_clock`, what took effect by the clock alone."""

    number: int
    time: Time
    by_clock: bool
    transaction: Transaction
    asserted: list[Assertion]
    ended: list[Assertion]
    cancelled: list[Assertion]
    superseded: list[Assertion]
    broken: list[Broken]


class Explanation(_Answer):
    """Why something is true, false or unknown, with the parts that decide it."""

    subject: str
    truth: Truth
    reason: str
    since: Time | None
    transaction: Transaction | None
    parts: list["Explanation"]


class Numbers(_Answer):
    """How a number differs; null where it is undefined."""

    function: str
    before: float | None
    after: float | None


class Metrics(_Answer):
    """How the metric differs; null where there is none."""

    before: Item | None
    after: Item | None


class Difference(_Answer):
    """What differs between two times."""

    became_true: list[Item]
    became_false: list[Item]
    withdrawn: list[Item]
    numbers: list[Annotated[Numbers, BeforeValidator(lambda row: _row(row, row[0].atom))]]
    goals_added: list[Item]
    goals_removed: list[Item]
    metric: Annotated[Metrics, BeforeValidator(lambda pair: {"before": pair[0], "after": pair[1]})] | None


def _row(row: Any, function: str) -> dict[str, Any]:
    return {"function": function, "before": row[1], "after": row[2]}


class Interval(_Answer):
    """A half-open interval of time."""

    start: Time
    end: Time

    @model_validator(mode="before")
    @classmethod
    def _read(cls, interval: Any) -> dict[str, Any]:
        return {"start": interval[0], "end": interval[1]}


class Situation(_Answer):
    """Everything that holds at one time."""

    knowledge_base: str
    at: Time
    as_of: Time | None
    domain: str | None
    use_unknowns: bool
    instances: list[Item]
    facts: list[Item]
    functions: list[Item]
    inequalities: list[Item]
    metric: Item | None
    goals: list[Item]
    timed_knowledge: list[Item]
    running: list[Run]
    constraints: list[str]

    @model_validator(mode="before")
    @classmethod
    def _read(cls, state: State) -> dict[str, Any]:
        found = {name: getattr(state, name) for name in cls.model_fields if name != "knowledge_base"}
        return found | {"knowledge_base": state.name, "domain": state.domain and state.domain.name}


class Holding(_Answer):
    """Whether a condition is true."""

    condition: str
    holds: bool
    truth: Truth


class Value(_Answer):
    """The value of an expression."""

    expression: str
    value: float


class Served(_Answer):
    """A knowledge base of the store."""

    name: str
    page: str
    """The address of its timeline."""


class Shape(Generic[T]):
    """The conversion of one kind of answers to JSON."""

    def __init__(self, kind: Any) -> None:
        self.kind = kind
        self._adapter: TypeAdapter[Any] = TypeAdapter(kind)

    def json(self, answer: T) -> bytes:
        """Return an answer as JSON."""
        return self._adapter.dump_json(self._adapter.validate_python(answer, from_attributes=True))
