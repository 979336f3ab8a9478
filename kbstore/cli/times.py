"""Times as they are typed: ISO 8601, ``now``, ``-5m``, ``+1h30m``, or nanoseconds."""

import re
from decimal import Decimal

from kbstore.clock import seconds, time
from kbstore.errors import InvalidTime

_SECONDS = {"d": 86_400, "h": 3600, "m": 60, "min": 60, "s": 1}
_DECIMALS = {"ms": 3, "us": 6, "ns": 9}
_OFFSET = re.compile(r"[+-](?:\d+(?:\.\d+)?(?:min|ms|us|ns|[dhms]))+")
_PART = re.compile(r"(\d+(?:\.\d+)?)(min|ms|us|ns|[dhms])")

ADVICE = "write ISO 8601 with an offset (2026-05-01T12:00:00Z), now, -5m, +30s, or nanoseconds"


def parse_time(text: str, now: int) -> int:
    """The time that is meant, in nanoseconds; what begins with a sign is relative to now.

    >>> parse_time("-1h30m", now=6_000_000_000_000)
    600000000000
    """
    typed = text.strip()
    if typed.lower() == "now":
        return now
    if _OFFSET.fullmatch(typed):
        away = sum(_nanoseconds(*part) for part in _PART.findall(typed))
        return time(now - away if typed.startswith("-") else now + away)
    if re.fullmatch(r"[0-9]+", typed):
        return time(int(typed[:20]))
    if not re.match(r"\d{4}", typed):
        raise InvalidTime(f"{text!r} is not a time; {ADVICE}")
    try:
        return time(typed)
    except InvalidTime as error:
        raise InvalidTime(f"{str(error).partition(';')[0]}; {ADVICE}") from None


def _nanoseconds(number: str, unit: str) -> int:
    if unit in _DECIMALS:
        return seconds(Decimal(number).scaleb(-_DECIMALS[unit]))
    return seconds(Decimal(number) * _SECONDS[unit])
