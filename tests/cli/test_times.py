"""Times as they are typed."""

import pytest

from kbstore.cli.times import parse_time
from kbstore.clock import isoformat, seconds, time
from kbstore.errors import InvalidTime

NOW = time("2026-05-04T12:00:00Z")


@pytest.mark.parametrize(
    ("typed", "meant"),
    [
        ("now", "2026-05-04T12:00:00Z"),
        (" NOW ", "2026-05-04T12:00:00Z"),
        ("-5m", "2026-05-04T11:55:00Z"),
        ("+30s", "2026-05-04T12:00:30Z"),
        ("-1h30m", "2026-05-04T10:30:00Z"),
        ("+1d", "2026-05-05T12:00:00Z"),
        ("-90min", "2026-05-04T10:30:00Z"),
        ("+1.5s", "2026-05-04T12:00:01.5Z"),
        ("-250ms", "2026-05-04T11:59:59.75Z"),
        ("+1ns", "2026-05-04T12:00:00.000000001Z"),
        ("+0.5us", "2026-05-04T12:00:00.0000005Z"),
        ("2026-05-04T14:00:00+02:00", "2026-05-04T12:00:00Z"),
        ("2026-05-04T12:00:00.000000001Z", "2026-05-04T12:00:00.000000001Z"),
        ("1000000000", "1970-01-01T00:00:01Z"),
    ],
)
def test_a_time_is_read(typed, meant):
    """ISO 8601, now, relative times in units from days to nanoseconds, and nanoseconds."""
    assert isoformat(parse_time(typed, NOW)) == meant


@pytest.mark.parametrize(
    "typed",
    [
        "",
        "yesterday",
        "2026-05-04T12:00:00",
        "2026-05-04",
        "12:00",
        "-5",
        "-5 m",
        "5m",
        "-5x",
        "--5m",
        "1.5",
        "1e9",
        "+0.1ns",
        "2026-13-01T00:00:00Z",
        "99999999999999999999999999",
        "-999999d",
        "+999999d",
        "\u0661",
        "+" + "9" * 5000 + "d",
        "9" * 5000,
    ],
)
def test_text_that_is_not_a_time_is_refused(typed):
    """Anything else is an `InvalidTime` (T2)."""
    with pytest.raises(InvalidTime):
        parse_time(typed, NOW)


def test_the_error_lists_the_forms_of_times():
    """All forms are listed, for naive times, too."""
    for typed in ("tomorrow", "2026-05-04T12:00:00"):
        with pytest.raises(InvalidTime, match=r"ISO 8601 with an offset .*, now, -5m, \+30s, or nanoseconds"):
            parse_time(typed, NOW)


def test_relative_times_are_exact():
    """A tenth of a second is exact, without floats."""
    assert parse_time("+0.1s", 0) == seconds("0.1")
