"""Makes ROSPlan's ROS 1 messages from kbstore's own, which have the same field names."""

from collections.abc import Callable
from functools import lru_cache
from typing import Any

from kbstore.clock import SECOND
from kbstore.messages import (
    Expression,
    Fact,
    Function,
    Inequality,
    Instance,
    Message,
)

Make = Callable[[str], Any]
"""A function that makes a message of a type, with ROS's defaults in its fields: ``make("KnowledgeItem")``.

A type is named as in its package; the response of a service is ``GetInstanceServiceResponse``. A message lists its
fields in ``__slots__``, as those of genpy do.
"""

_NAMES = dict.fromkeys((Instance, Fact, Function, Expression, Inequality), "KnowledgeItem")


def to_ros(message: Message, make: Make) -> Any:
    """Return a ROS message with the values of one of kbstore's; a field that ROS lacks (the rate) is left out."""
    kind = type(message)
    return filled(make(_NAMES.get(kind) or kind.__name__), message, make)


def filled(target: Any, source: Message, make: Make) -> Any:
    """Copy the values of a message of kbstore's into a ROS message, and return that."""
    kind_of_target: Any = type(target)
    for name in _shared(type(source), kind_of_target):
        value = getattr(source, name)
        kind = type(value)
        if kind in _PLAIN:
            if name == "initial_time":
                stamp(target.initial_time, value)
            else:
                setattr(target, name, value)
        elif kind is tuple:
            setattr(target, name, [to_ros(part, make) for part in value])
        elif isinstance(value, Message):
            filled(getattr(target, name), value, make)
        elif value is not None:
            setattr(target, name, int(value))
    return target


_PLAIN = frozenset((str, int, float, bool))


@lru_cache(maxsize=64)
def _shared(source: type[Message], target: type[Any]) -> tuple[str, ...]:
    """Return the fields that both messages have; cached, because a state of 1,000 facts is 2,000 messages."""
    fields = set(target.__slots__)
    return tuple(name for name in source.model_fields if name in fields)


def stamp(target: Any, t: int) -> None:
    """Set a time of ROS 1 to nanoseconds."""
    target.secs, target.nsecs = divmod(t, SECOND)
