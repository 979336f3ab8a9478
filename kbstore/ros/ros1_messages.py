"""ROS 1 messages of ROSPlan, made from kbstore's own, which have the same field names."""

from collections.abc import Callable
from enum import IntEnum
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
"""Makes a message of a type, with ROS's defaults in its fields: ``make("KnowledgeItem")``.

A type is named as in its package; the response of a service is ``GetInstanceServiceResponse``.
"""

_ITEMS = (Instance, Fact, Function, Expression, Inequality)


def to_ros(message: Message, make: Make) -> Any:
    """Return a message of ROS with the values of one of kbstore's; a field that ROS lacks (a rate) is left out."""
    return filled(make("KnowledgeItem" if isinstance(message, _ITEMS) else type(message).__name__), message, make)


def filled(target: Any, source: Message, make: Make) -> Any:
    """The same into a message that is there already, which is returned."""
    for name in type(source).model_fields:
        if not hasattr(target, name):
            continue
        value = getattr(source, name)
        if name == "initial_time":
            stamp(getattr(target, name), value)
        elif isinstance(value, Message):
            filled(getattr(target, name), value, make)
        elif isinstance(value, tuple):
            setattr(target, name, [to_ros(part, make) for part in value])
        elif value is not None:
            setattr(target, name, int(value) if isinstance(value, IntEnum) else value)
    return target


def stamp(target: Any, t: int) -> None:
    """Set a time of ROS 1 to nanoseconds."""
    target.secs, target.nsecs = divmod(t, SECOND)
