"""What all messages share: they are frozen, and a refusal is an error of kbstore's."""

from collections.abc import Mapping
from decimal import Decimal
from typing import Any, Self

from pydantic import BaseModel, ConfigDict, ValidationError, model_validator

from kbstore.errors import InvalidKnowledge, KbStoreError


class Message(BaseModel):
    """A frozen Pydantic model with the field names of a ROS message."""

    model_config = ConfigDict(frozen=True, extra="forbid", use_enum_values=False)

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
        set_slot(message, "__pydantic_fields_set__", set(fields))
        set_slot(message, "__pydantic_extra__", None)
        set_slot(message, "__pydantic_private__", None)
        return message

    def changed(self, **fields: Any) -> Self:
        """A copy with some fields changed to values that are known to be valid."""
        kept = {name: self.__dict__[name] for name in type(self).model_fields}
        return type(self).trusted(**{**kept, **fields})


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
