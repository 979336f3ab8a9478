"""Lists of assertions, and the timelines that notebooks show of them."""

from collections.abc import Sequence
from typing import Any

from kbstore.clock import isoformat
from kbstore.messages.enums import KnowledgeType
from kbstore.model.html import table
from kbstore.model.pictures import Bar, Lane, Look, timeline
from kbstore.model.plain import Data, each, list_schema
from kbstore.model.results import Assertion
from kbstore.model.timelines import moved

MOST_BARS = 500
"""Assertions of a history that are drawn: the latest ones."""


class Assertions(list[Assertion]):
    """A list of assertions, which a notebook shows as a small timeline and a table."""

    def to_dict(self) -> list[Data]:
        """Return the assertions as plain data, one dict for each."""
        return each(self)

    @classmethod
    def __get_pydantic_core_schema__(cls, _source: object, handler: Any) -> Any:
        return list_schema(cls, Assertion, handler)

    def __repr__(self) -> str:
        return "[" + ",\n ".join(map(repr, self)) + "]"

    def _repr_html_(self) -> str:
        header = ("item", "since", "until", "recorded", "ended", "")
        return _picture(self) + table(f"{len(self)} assertions", header, [("", [_row(found) for found in self])])


def _picture(assertions: Sequence[Assertion]) -> str:
    """Draw a lane for each atom: true, explicitly false (thin), cancelled or superseded (pale), numbers as lines.

    What begins after the last transaction among them is hatched: it is scheduled.
    """
    known = max(
        (by.time for a in assertions for by in (a.recorded, a.ended, a.cancelled, a.superseded) if by), default=0
    )
    lanes: dict[str, list[Bar]] = {}
    for found in assertions[-MOST_BARS:]:
        item = found.item
        kind = getattr(item, "knowledge_type", None)
        is_number = kind is KnowledgeType.FUNCTION and not found.is_goal
        name = str(getattr(item, "atom", item)) if is_number else item.text
        until = "" if found.end_time is None else f" until {isoformat(found.end_time)}"
        lanes.setdefault(f"goal {name}" if found.is_goal else name, []).append(
            Bar(
                found.initial_time,
                found.end_time,
                _look(found, known, is_number=is_number),
                f"{found.item} from {isoformat(found.initial_time)}{until}, recorded by {found.recorded}",
                _values(found) if is_number else None,
            )
        )
    count = len(assertions)
    note = f"the latest {MOST_BARS} of {count:,}" if count > MOST_BARS else ""
    return timeline([Lane(name, bars) for name, bars in lanes.items()], note=note)


def _look(found: Assertion, known: int, *, is_number: bool) -> Look:
    if found.superseded is not None or found.cancelled is not None:
        return Look.SUPERSEDED
    if is_number:
        return Look.NUMBER
    if found.is_goal:
        return Look.WANTED
    is_negative = bool(getattr(found.item, "is_negative", False))
    if found.initial_time > known:
        return Look.SCHEDULED_FALSE if is_negative else Look.SCHEDULED
    return Look.FALSE if is_negative else Look.TRUE


def _values(found: Assertion) -> tuple[float, float]:
    value = float(getattr(found.item, "function_value", 0.0) or 0.0)
    lasted = 0 if found.end_time is None else found.end_time - found.initial_time
    return value, moved(value, getattr(found.item, "rate", 0.0), lasted)


def _row(found: Assertion) -> tuple[object, ...]:
    end = None if found.end_time is None else isoformat(found.end_time)
    ended = None if found.ended is None else found.ended.number
    all_marks = (("goal", found.is_goal), ("cancelled", found.cancelled), ("superseded", found.superseded))
    marks = " ".join(mark for mark, is_so in all_marks if is_so)
    return found.item, isoformat(found.initial_time), end, found.recorded.number, ended, marks
