"""Formats times and durations for people: absolute, and relative to now."""

from dataclasses import dataclass

from kbstore.clock import SECOND, isoformat
from kbstore.messages import format_number

_MINUTE = 60 * SECOND
_HOUR = 60 * _MINUTE
DAY = 24 * _HOUR

_FINEST = ((10 * SECOND, SECOND), (SECOND, SECOND // 10), (0, SECOND // 1000))
"""The precision with which a relative time is shown, by the least distance from which on it is used."""

_UNITS = ((DAY, "d"), (_HOUR, "h"), (_MINUTE, "min"), (SECOND, "s"))


def span(ns: int) -> str:
    """Write a duration in nanoseconds: exactly below a minute, else to the second, in its two largest units.

    >>> span(131_000_000_000), span(1_500_000_000), span(90_061_000_000_000), span(0)
    ('2 min 11 s', '1.5 s', '1 d 1 h', '0 s')
    """
    if ns < _MINUTE:
        return f"{format_number(ns / SECOND)} s"
    parts = []
    ns += SECOND // 2
    for unit, name in _UNITS:
        count, ns = divmod(ns, unit)
        parts.append((count, name))
    first = next(index for index, (count, _) in enumerate(parts) if count)
    return " ".join(f"{count} {name}" for count, name in parts[first : first + 2] if count)


@dataclass(frozen=True, slots=True)
class TimeFormat:
    """The format of the times of one answer: in full, or (`brief`) as the time of the day of `now` where it is.

    >>> TimeFormat(121 * 10**9).relative(60 * 10**9), TimeFormat(0).relative(2 * 10**9)
    ('1 min 1 s ago', 'in 2 s')
    """

    now: int
    brief: bool = False

    def absolute(self, t: int | None) -> str:
        """Write a time as ISO 8601 in UTC; empty for None."""
        if t is None:
            return ""
        text = isoformat(t)
        if self.brief and t // DAY == self.now // DAY:
            return text[len("2026-05-04T") : -1]
        return text

    def relative(self, t: int | None) -> str:
        """Write the distance of a time from now, before or after; empty for None."""
        if t is None:
            return ""
        if t == self.now:
            return "now"
        away = abs(t - self.now)
        # a relative time is for orientation, and is rounded; the absolute time is exact
        finest = next(unit for least, unit in _FINEST if away >= least)
        shown = span(away // finest * finest)
        return f"{shown} ago" if t < self.now else f"in {shown}"

    def interval(self, start: int, end: int | None) -> str:
        """Write a half-open interval: ``from 09:00:00 until 09:01:00``."""
        return f"from {self.absolute(start)} " + ("on" if end is None else f"until {self.absolute(end)}")
