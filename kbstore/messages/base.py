"""What all messages share: they are frozen, and a refusal is an error of kbstore's."""

from collections.abc import Callable, Mapping
from decimal import Decimal
from functools import cache
from typing import Any, Generic, Self, TypeVar, overload

from pydantic import BaseModel, ConfigDict, ValidationError, WrapSerializer, model_validator

from kbstore.errors import InvalidKnowledge, KbStoreError

_Value = TypeVar("_Value")

AS_LIST = WrapSerializer(lambda values, dump: list(dump(values)))
"""A frozen field of several values, which `model_dump` gives as the list that a ROS message has."""


class lazy(Generic[_Value]):
    """A property of a frozen message that is worked out once.

    `functools.cached_property` takes a lock each time in Python 3.11, which costs more than the work.
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
    """A frozen Pydantic model with the field names of a ROS message."""

    model_config = ConfigDict(frozen=True, extra="forbid", ignored_types=(lazy,))

    def __init__(self, **data: Any) -> None:
        try:
            super().__init__(**data)
        except ValidationError as error:
            raise typed_error(type(self).__name__, error) from None

    @model_validator(mode="before")
    @classmethod
    def _read_attributes(cls, data: Any) -> Any:
        """A real ROS message is read by its attributes."""
        if isinstance(data, Mapping | cls):
            return data
        return {name: getattr(data, name) for name in cls.model_fields if hasattr(data, name)} or data

    @classmethod
    def trusted(cls, **fields: Any) -> Self:
        """A message from fields that are known to be valid and complete, without validating them again."""
        message = cls.__new__(cls)
        set_slot = object.__setattr__
        set_slot(message, "__dict__", fields)
        set_slot(message, "__pydantic_fields_set__", _given(cls))
        set_slot(message, "__pydantic_extra__", None)
        set_slot(message, "__pydantic_private__", None)
        return message

    def changed(self, **fields: Any) -> Self:
        """A copy with some fields changed to values that are known to be valid."""
        kept = {name: self.__dict__[name] for name in type(self).model_fields}
        return type(self).trusted(**{**kept, **fields})


@cache
def _given(model: type[Message]) -> set[str]:
    """All fields of a model: one set for all its trusted messages, which are frozen."""
    return set(model.model_fields)


def typed_error(name: str, error: ValidationError) -> KbStoreError:
    """The error of kbstore's that says what Pydantic found."""
    sentences = []
    for problem in error.errors(include_url=False):
        cause = problem.get("ctx", {}).get("error")
        if isinstance(cause, KbStoreError):
            return cause
        field = ".".join(str(part) for part in problem["loc"])
        sentences.append(f"{name}: {field + ': ' if field else ''}{problem['msg']} (got {problem['input']!r:.80})")
    return InvalidKnowledge(*sentences)


def format_number(number: float) -> str:
    """The number in PDDL: exact when read back as a double, and without an exponent (rule P2).

    >>> format_number(80.0), format_number(1e-7), format_number(-2.5)
    ('80', '0.0000001', '-2.5')
    """
    text = repr(float(number))
    if "e" in text or "E" in text:
        text = format(Decimal(text), "f")
    return text[:-2] if text.endswith(".0") else text
