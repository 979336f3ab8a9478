"""Computes lifespans of objects: adjacent existences of the same type are one lifespan (rule C6)."""

from collections.abc import Iterable, Sequence
from typing import NamedTuple

from kbstore.clock import OPEN
from kbstore.model.timelines import Value


class Lifespan(NamedTuple):
    """A span in which an object exists with one type: half-open, in nanoseconds."""

    start: int
    end: int
    type_name: str


def lifespans_of(value: Value | None, ahead: dict[int, Value], now: int) -> list[Lifespan]:
    """Return the lifespans of an object from now on, by the value of its timeline now and the scheduled ones."""
    found: list[Lifespan] = []
    start, type_name = now, None if value is None or value[0] else value[1]
    for t in sorted(ahead):
        is_negative, name = ahead[t]
        if is_negative:
            if type_name is not None:
                found.append(Lifespan(start, t, type_name))
            type_name = None
        elif type_name is None or type_name.lower() != name.lower():
            if type_name is not None:
                found.append(Lifespan(start, t, type_name))
            start, type_name = t, name
    if type_name is not None:
        found.append(Lifespan(start, OPEN, type_name))
    return found


def lost_time(before: Sequence[Lifespan], after: Sequence[Lifespan]) -> list[tuple[int, int]]:
    """Return the spans in which an object existed by `before`, and by `after` does not exist with the same type."""
    lost: list[tuple[int, int]] = []
    for start, end, type_name in before:
        for other_start, other_end, other_type in after:
            if other_end <= start or other_start >= end or other_type.lower() != type_name.lower():
                continue
            if other_start > start:
                lost.append((start, other_start))
            start = other_end  # noqa: PLW2901 - what is left of the span
        if start < end:
            lost.append((start, end))
    return lost


def joined(lifespans: Iterable[Lifespan]) -> list[Lifespan]:
    """Return lifespans, which are in order of time, with adjacent ones of the same type joined."""
    found: list[Lifespan] = []
    for lifespan in lifespans:
        last = found[-1] if found else None
        if last is not None and last.end == lifespan.start and last.type_name.lower() == lifespan.type_name.lower():
            found[-1] = last._replace(end=lifespan.end)
        else:
            found.append(lifespan)
    return found
