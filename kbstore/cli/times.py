"""Parses times and durations as typed: those of `kbstore.clock.time`, and nanoseconds in digits; ``30s``, ``1m30s``."""

import re

from kbstore.clock import time
from kbstore.errors import InvalidTime

ADVICE = "write ISO 8601 with an offset (2026-05-01T12:00:00Z), now, -5m, +30s, or nanoseconds"


def parse_time(text: str, now: int) -> int:
    """Return a time in nanoseconds; a text that begins with a sign is relative to now. Raises `InvalidTime`.

    >>> parse_time("-1h30m", now=6_000_000_000_000)
    600000000000
    """
    typed = text.strip()
    if re.fullmatch(r"[0-9]+", typed):
        return time(int(typed[:20]))
    if not re.match(r"now|[+-]|\d{4}", typed, re.IGNORECASE):
        raise InvalidTime(f"{text!r} is not a time; {ADVICE}")
    try:
        return time(typed, now)
    except InvalidTime as error:
        raise InvalidTime(f"{str(error).partition(';')[0]}; {ADVICE}") from None


def parse_duration(text: str) -> int:
    """Return a duration in nanoseconds. Raises `InvalidTime` without units, so that nobody gives bare seconds.

    >>> parse_duration("1m30s")
    90000000000
    """
    try:
        return time(f"+{text.strip()}", 0)
    except InvalidTime:
        raise InvalidTime(f"{text!r} is not a duration; write it with units, like 30s, 1m30s or 250ms") from None
