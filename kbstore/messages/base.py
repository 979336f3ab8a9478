"""The base of all messages: frozen Pydantic models, and their validation errors as kbstore's."""

from collections.abc import Callable, Iterable, Mapping
from decimal import Decimal
from functools import cache
from typing import Any, Generic, Self, TypeVar, overload

from pydantic import BaseModel, ConfigDict, PlainSerializer, ValidationError, model_validator

from kbstore.errors import InvalidKnowledge, KbStoreError

_Value = TypeVar("_Value")


def as_list(element: Any) -> PlainSerializer:
    """Return what serializes a tuple of elements, the frozen value of a field, as the list that a ROS message has."""
    return PlainSerializer(list, return_type=list[element])


class lazy(Generic[_Value]):
    """A property of a frozen message that is computed once.

    `functools.cached_property` takes a lock at each first access in Python 3.11, which costs more than the work
    itself. Python 3.12 dropped the lock: delete this class together with the support of 3.11.
    """

    def __init__(self, work: Callable[[Any], _Value]) -> None:
        self._work = work
        self._name = work.__name__
        self.__doc__ = work.__doc__

    @overload
    def __get__(self, message: None, owner: type | None = None) -> Self: ...
    @overload
    def __get__(self, message: object, owner: type | None = None) -> _Value: ...
    def __get__(self, message: object, owner: type | None = None) -> _Value | Self:
        if message is None:
            return self
        value = message.__dict__[self._name] = self._work(message)
        return value


class Message(BaseModel):
    """A frozen Pydantic model with the field names of a ROS message.

    The constructor and `model_validate` both raise `pydantic.ValidationError` for a message that is not valid. Where
    kbstore reads a mapping or a ROS message itself, it raises `InvalidKnowledge` instead (`typed_error`).
    """

    model_config = ConfigDict(frozen=True, extra="forbid", ignored_types=(lazy,))

    @model_validator(mode="before")
    @classmethod
    def _read_attributes(cls, data: Any) -> Any:
        """Read a real ROS message by its attributes."""
        if isinstance(data, Mapping | cls):
            return data
        return {name: getattr(data, name) for name in cls.model_fields if hasattr(data, name)} or data

    def __repr_args__(self) -> Iterable[tuple[str | None, Any]]:
        """Show a message as its PDDL, ``Fact('(robot_at kenny wp0)')``, where it has some."""
        return super().__repr_args__() if type(self).__str__ is BaseModel.__str__ else [(None, str(self))]

    @classmethod
    def trusted(cls, **fields: Any) -> Self:
        """Make a message of fields that are known to be valid and complete, without validating them again.

        This is `model_construct` without its look at each field for aliases and defaults, which takes twice as long;
        validation takes three times as long. A state of 1,000 facts is 3,000 messages.
        """
        message = cls.__new__(cls)
        set_slot = object.__setattr__
        set_slot(message, "__dict__", fields)
        set_slot(message, "__pydantic_fields_set__", _given(cls))
        set_slot(message, "__pydantic_extra__", None)
        set_slot(message, "__pydantic_private__", None)
        return message

    def changed(self, **fields: Any) -> Self:
        """Copy the message with some fields changed to values that are known to be valid.

        Unlike `model_copy(update=...)` it does not copy the values of `lazy` properties, which may have changed, too.
        """
        kept = {name: self.__dict__[name] for name in type(self).model_fields}
        return type(self).trusted(**{**kept, **fields})


@cache
def _given(model: type[Message]) -> set[str]:
    """Return all fields of a model: one set for all its trusted messages, which are frozen."""
    return set(model.model_fields)


def typed_error(name: str, error: ValidationError, depth: int = 0) -> KbStoreError:
    """Return kbstore's error for what Pydantic found wrong with a message, one sentence for each wrong field.

    For a wrong time it is an `InvalidTime`, even if other fields are wrong, too.

    Args:
        name: the message's name in the sentences.
        error: the error that its validation raised.
        depth: how many leading parts of each location to leave out, as they lead to the message.
    """
    sentences: list[str] = []
    for problem in error.errors(include_url=False):
        cause = problem.get("ctx", {}).get("error")
        if isinstance(cause, KbStoreError) and not isinstance(cause, InvalidKnowledge):
            return cause
        field = ".".join(map(str, problem["loc"][depth:]))
        place = f"{name}: {field}: " if field else f"{name}: "
        if isinstance(cause, InvalidKnowledge):
            sentences += [f"{place}{violation}" for violation in cause.violations]
        else:
            sentences.append(f"{place}{problem['msg']} (got {problem['input']!r:.80})")
    return InvalidKnowledge(*sentences)


def format_number(number: float) -> str:
    """Write a number in PDDL: exact when read back as a double, and without an exponent (rule P2).

    >>> format_number(80.0), format_number(1e-7), format_number(-2.5)
    ('80', '0.0000001', '-2.5')
    """
    text = repr(float(number))
    if "e" in text or "E" in text:
        text = format(Decimal(text), "f")
    return text[:-2] if text.endswith(".0") else text
