"""Times, durations and clocks (rules T1 to T3).

Inside kbstore a time is an integer of nanoseconds on the knowledge base's clock, 0 <= t < 2**62. `TimeLike` and
`DurationLike` are the types of what callers may give instead.
"""

import re
import time as _time
from collections.abc import Mapping
from datetime import UTC, datetime, timedelta
from decimal import Decimal, InvalidOperation
from typing import Any, Protocol, runtime_checkable

from kbstore.errors import InvalidTime

SECOND = 1_000_000_000
"""Nanoseconds in a second."""

OPEN = 2**63 - 1
"""The end time of an assertion that is open: nothing ends it yet."""

TIME_LIMIT = 2**62
"""Times are below this: the year 2116."""

_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
_OFFSET = re.compile(r"(Z|[+-]\d{2}:?\d{2}(:?\d{2})?)$", re.IGNORECASE)
_FRACTION = re.compile(r"[.,](\d+)")

_SECONDS = {"d": 86_400, "h": 3600, "m": 60, "min": 60, "s": 1}
_DECIMALS = {"ms": 3, "us": 6, "ns": 9}
_RELATIVE = re.compile(r"[+-](?:\d+(?:\.\d+)?(?:min|ms|us|ns|[dhms]))+")
_PART = re.compile(r"(\d+(?:\.\d+)?)(min|ms|us|ns|[dhms])")


class Ros2Stamp(Protocol):
    """A time or duration message of ROS 2 (`builtin_interfaces`)."""

    @property
    def sec(self) -> int:
        """Whole seconds."""

    @property
    def nanosec(self) -> int:
        """Nanoseconds beyond the whole seconds."""


class Ros1Stamp(Protocol):
    """A `rospy.Time` or `rospy.Duration`."""

    @property
    def secs(self) -> int:
        """Whole seconds."""

    @property
    def nsecs(self) -> int:
        """Nanoseconds beyond the whole seconds."""


class NanosecondStamp(Protocol):
    """A `rclpy.time.Time` or `rclpy.duration.Duration`."""

    @property
    def nanoseconds(self) -> int:
        """The whole time in nanoseconds."""


Stamp = Ros2Stamp | Ros1Stamp | NanosecondStamp | Mapping[str, int]
"""A time or duration as messages carry it: an object, or a mapping with the same names."""

TimeLike = int | str | datetime | Stamp
"""A time: nanoseconds, ISO 8601 text with an offset, an aware `datetime`, or a stamp (rule T2).

Where a knowledge base is asked, also text relative to its now: ``now``, ``-5m``, ``+30s``.
"""

DurationLike = int | timedelta | Stamp
"""A duration: nanoseconds, a `timedelta`, or a stamp."""


@runtime_checkable
class Clock(Protocol):
    """A source of time for a knowledge base."""

    def now(self) -> int:
        """Return the time in nanoseconds."""


class SystemClock:
    """The wall clock, in nanoseconds since 1970."""

    def now(self) -> int:
        """Return the wall clock's time in nanoseconds."""
        return _time.time_ns()

    @staticmethod
    def elapsed() -> int:
        """Return nanoseconds since some fixed time, independent of the wall clock; suspended time counts on Linux."""
        boot = getattr(_time, "CLOCK_BOOTTIME", None)
        return _time.monotonic_ns() if boot is None else _time.clock_gettime_ns(boot)


class ManualClock:
    """A clock that is moved by hand: for simulations, replays and tests."""

    def __init__(self, start: TimeLike = 0) -> None:
        self._now = time(start)

    def now(self) -> int:
        """Return the time that was last set."""
        return self._now

    def set(self, t: TimeLike) -> None:
        """Move to the time `t`, forwards or backwards."""
        self._now = time(t)

    def advance(self, ns: DurationLike) -> None:
        """Move forward by a duration: nanoseconds, a `timedelta` or a duration stamp."""
        self._now = time(self._now + duration(ns))


def seconds(x: int | float | str | Decimal) -> int:
    """Convert seconds to nanoseconds.

    A decimal number is exact; a float counts as the decimal number that it prints as, so that ``seconds(0.1)`` is
    100,000,000, and is rounded to a nanosecond.

    Raises `InvalidTime` for what is not a number, is out of range, or (unless a float) is finer than a nanosecond.
    """
    if isinstance(x, bool) or not isinstance(x, int | float | str | Decimal):
        raise InvalidTime(f"seconds() takes an int, Decimal, str or float, not {x!r}")
    try:
        exact = Decimal(repr(x)) if isinstance(x, float) else Decimal(x)
    except InvalidOperation:
        raise InvalidTime(f"{x!r} is not a number of seconds; write one like '12.5'") from None
    if not exact.is_finite() or abs(exact) >= 10**11:
        raise InvalidTime(f"{x!r} seconds is out of range; a time is below 2**62 nanoseconds (the year 2116)")
    if isinstance(x, float):
        return int((exact * SECOND).to_integral_value())
    numerator, denominator = exact.as_integer_ratio()
    nanoseconds, rest = divmod(numerator * SECOND, denominator)
    if rest:
        raise InvalidTime(f"{x!r} seconds is finer than a nanosecond; give at most nine decimals")
    return nanoseconds


def time(x: TimeLike, now: int | None = None) -> int:
    """Return a time in nanoseconds from anything of rule T2.

    Takes an ``int`` of nanoseconds, a timezone-aware ``datetime``, an ISO 8601 string with an offset, or a stamp
    with ``sec``/``nanosec``, ``secs``/``nsecs`` or ``nanoseconds`` (an object or a mapping). Where `now` is given,
    also a string relative to it: ``now``, ``-5m``, ``+1h30m``, with the units d, h, m (or min), s, ms, us and ns.

    Raises `InvalidTime` for anything else, and for times outside 0 <= t < 2**62.

    >>> time("-1h30m", now=6_000_000_000_000)
    600000000000
    """
    t = x if type(x) is int else _convert(x, now)
    if not 0 <= t < TIME_LIMIT:
        raise InvalidTime(f"the time {x!r} is outside 0 <= t < 2**62 nanoseconds (the year 2116)")
    return t


def duration(x: DurationLike) -> int:
    """Return a duration in nanoseconds, from an ``int`` of nanoseconds, a ``timedelta`` or a duration stamp.

    Raises `InvalidTime` for anything else and for negative durations.
    """
    if isinstance(x, timedelta):
        ns = (x.days * 86_400 + x.seconds) * SECOND + x.microseconds * 1000
    elif isinstance(x, int) and not isinstance(x, bool):
        ns = int(x)
    else:
        stamp = None if isinstance(x, str | float | bool) else _stamp(x)
        if stamp is None:
            raise InvalidTime(
                f"{x!r} is not a duration; give nanoseconds (kbstore.seconds(12.5)), a timedelta or a duration stamp"
            )
        ns = stamp
    if not 0 <= ns < TIME_LIMIT:
        raise InvalidTime(f"the duration {x!r} is outside 0 <= d < 2**62 nanoseconds")
    return ns


def isoformat(t: int) -> str:
    """Write a time in nanoseconds as ISO 8601 text in UTC, with up to nine decimals and no trailing zeros.

    >>> isoformat(1_500_000_000)
    '1970-01-01T00:00:01.5Z'
    """
    whole, rest = divmod(t, SECOND)
    text = (_EPOCH + timedelta(seconds=whole)).strftime("%Y-%m-%dT%H:%M:%S")
    return text + (f".{rest:09d}".rstrip("0") if rest else "") + "Z"


def _convert(x: TimeLike, now: int | None) -> int:
    if isinstance(x, bool):
        raise InvalidTime(f"{x!r} is not a time; give nanoseconds, for instance kbstore.seconds(12.5)")
    if isinstance(x, int):
        return int(x)
    if isinstance(x, float):
        raise InvalidTime(
            f"{x!r} is a float, which cannot hold nanoseconds; write kbstore.seconds({x!r}) for seconds, or an int"
        )
    if isinstance(x, datetime):
        return _from_datetime(x)
    if isinstance(x, str):
        return _from_text(x, now)
    stamp = _stamp(x)
    if stamp is None:
        raise InvalidTime(
            f"{x!r} is not a time; give an int of nanoseconds (kbstore.seconds(12.5)), an aware datetime, "
            "ISO 8601 text with an offset, or a stamp with sec and nanosec"
        )
    return stamp


def _from_datetime(x: datetime) -> int:
    if x.utcoffset() is None:
        raise InvalidTime(f"{x!r} has no timezone; write it with one, for instance tzinfo=datetime.UTC")
    since = x - _EPOCH
    return (since.days * 86_400 + since.seconds) * SECOND + since.microseconds * 1000


def _from_text(x: str, now: int | None) -> int:
    text = x.strip()
    advice = "write ISO 8601 with an offset, like 2026-05-01T12:00:00Z"
    if text.lower() == "now" or _RELATIVE.fullmatch(text):
        if now is None:
            raise InvalidTime(f"{x!r} is relative to now, and no knowledge base is asked here; {advice}")
        away = sum(_unit(*part) for part in _PART.findall(text))
        return now - away if text[0] == "-" else now + away
    if now is not None:
        advice += ", or relative to now, like -5m"
    if not _OFFSET.search(text):
        raise InvalidTime(f"{x!r} is not a time with an offset; {advice}")
    # datetime keeps microseconds only, so the fraction is read apart
    fraction = _FRACTION.search(text)
    digits = fraction.group(1) if fraction else ""
    if len(digits.rstrip("0")) > 9:
        raise InvalidTime(f"{x!r} is finer than a nanosecond; give at most nine decimals")
    try:
        whole = datetime.fromisoformat(_FRACTION.sub("", text, count=1).upper())
    except ValueError:
        raise InvalidTime(f"{x!r} is not a time; {advice}") from None
    return _from_datetime(whole) + int(digits[:9].ljust(9, "0"))


def _unit(number: str, unit: str) -> int:
    """Nanoseconds of one part of a relative time, like ``1.5h``."""
    if unit in _DECIMALS:
        return seconds(Decimal(number).scaleb(-_DECIMALS[unit]))
    return seconds(Decimal(number) * _SECONDS[unit])


def _stamp(x: object) -> int | None:
    """Nanoseconds of a stamp object or mapping; None if it is neither."""

    def read(name: str) -> Any:
        return x.get(name) if isinstance(x, Mapping) else getattr(x, name, None)

    for whole_name, rest_name in (("sec", "nanosec"), ("secs", "nsecs")):
        whole, rest = read(whole_name), read(rest_name)
        if _is_int(whole) and _is_int(rest):
            return int(whole) * SECOND + int(rest)
    nanoseconds = read("nanoseconds")
    return int(nanoseconds) if _is_int(nanoseconds) else None


def _is_int(x: object) -> bool:
    return hasattr(x, "__index__") and not isinstance(x, bool)
