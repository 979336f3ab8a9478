"""Lists of half-open intervals of time, and what follows from them."""

from collections.abc import Iterable
from typing import Any

from kbstore.evaluation.interpretation import Span
from kbstore.model.plain import Data, list_schema, times


class Intervals(list[Span]):
    """The maximal intervals in which something is true: in order, apart from each other, in nanoseconds.

    Compares equal to a plain list of the same pairs.
    """

    @property
    def ever(self) -> bool:
        """Whether it is true at any time."""
        return bool(self)

    @property
    def first(self) -> int | None:
        """The first time at which it is true; None if there is none."""
        return self[0][0] if self else None

    @property
    def last(self) -> int | None:
        """The last nanosecond at which it is true; None if there is none."""
        return self[-1][1] - 1 if self else None

    @property
    def total(self) -> int:
        """The total time for which it is true, in nanoseconds."""
        return sum(end - start for start, end in self)

    def to_dict(self) -> list[Data]:
        """Return the intervals as plain data, each with its ends as ISO 8601 text and in nanoseconds."""
        return [times(start=start, end=end) for start, end in self]

    @classmethod
    def __get_pydantic_core_schema__(cls, _source: object, handler: Any) -> Any:
        return list_schema(cls, Span, handler)

    def always(self, span: Span) -> bool:
        """Return whether it is true throughout a span; an empty span lies within anything."""
        start, end = span
        return start >= end or any(a <= start and end <= b for a, b in self)


def merged(intervals: Iterable[Span]) -> Intervals:
    """The union of intervals in any order; those that meet or overlap become one, and empty ones vanish."""
    result = Intervals()
    for start, end in sorted(intervals):
        if start >= end:
            continue
        if result and start <= result[-1][1]:
            result[-1] = (result[-1][0], max(end, result[-1][1]))
        else:
            result.append((start, end))
    return result
