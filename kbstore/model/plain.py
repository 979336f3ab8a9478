"""Answers as plain data for JSON: dicts, lists, texts and numbers.

Each time is given twice: as ISO 8601 text (exact to the nanosecond), and as an integer of nanoseconds under a name that
ends in ``_ns``. Each piece of knowledge is given as ``pddl`` text and as ``item``, in the shape of the ROS message.
"""

from collections.abc import Iterable
from dataclasses import fields
from enum import Enum
from pathlib import Path
from typing import Any

from kbstore.clock import isoformat
from kbstore.messages import Message

Data = dict[str, Any]

TIMES = frozenset(("time", "initial_time", "end_time", "since", "until", "started", "history_from"))
"""The names of those fields of results that are times."""


class Result:
    """The base of the dataclasses that are answers to questions."""

    __slots__ = ()

    def to_dict(self) -> Data:
        """Return the result as plain data for JSON, each time as ISO 8601 text and in nanoseconds."""
        found: Data = {}
        for field in fields(self):  # type: ignore[arg-type]
            value = getattr(self, field.name)
            found |= times(**{field.name: value}) if field.name in TIMES else {field.name: plain(value)}
        return found


def plain(answer: object) -> Any:
    """Return an answer, or a value that is in one, as plain data."""
    match answer:
        case Message():
            return {"pddl": str(answer), "item": answer.model_dump(mode="json")}
        case Result():
            return answer.to_dict()
        case Enum() | Path():
            return str(answer)
        case list() | tuple():
            return each(answer)
        case _:
            return answer


def each(answers: Iterable[object]) -> list[Any]:
    """Return several answers as plain data."""
    return [plain(answer) for answer in answers]


def times(**named: int | None) -> Data:
    """Return times under their names, as text and in nanoseconds; None where there is none."""
    found: Data = {}
    for name, t in named.items():
        found[name] = None if t is None else isoformat(t)
        found[f"{name.removesuffix('_time')}_ns"] = t
    return found


def list_schema(kind: type[list[Any]], part: Any, handler: Any) -> Any:
    """Return how Pydantic reads and writes a list that is a class of its own: as a list of its parts."""
    from pydantic_core import core_schema

    return core_schema.no_info_after_validator_function(kind, handler.generate_schema(list[part]))
