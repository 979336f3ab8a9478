"""Pieces of a timeline in valid time, and how late knowledge edits them (rule L2)."""

from collections.abc import Sequence
from typing import NamedTuple

from kbstore.clock import OPEN
from kbstore.messages import KnowledgeType
from kbstore.model.timelines import EndCause, Value, number_at

Ended = tuple[int | None, EndCause]
"""The transaction that ended something, None for the open one, and why."""


class Piece(NamedTuple):
    """A span in which one value holds.

    Attributes:
        end: OPEN where it holds now.
        told: the transaction that first recorded it; None where that is the open transaction.
        ended: who ended it; None where it ended by the clock, or something follows.
    """

    start: int
    end: int
    value: Value
    told: int | None = None
    ended: Ended | None = None

    def value_at(self, kind: KnowledgeType, t: int) -> Value:
        """The value with which it goes on at `t`: a number that moves has moved by then."""
        if kind is not KnowledgeType.FUNCTION:
            return self.value
        return (False, number_at(self.value, self.start, t), *self.value[2:])

    def overlaps(self, start: int, end: int) -> bool:
        """Return whether it holds somewhere in ``[start, end)``."""
        return self.start < end and start < self.end


def cut(piece: Piece, kind: KnowledgeType, start: int, end: int, cause: EndCause) -> list[Piece]:
    """Return what is left of a piece before and after a span that it overlaps."""
    left = []
    if piece.start < start:
        left.append(piece._replace(end=start, ended=(None, cause)))
    if end < piece.end:
        left.append(piece._replace(start=end, value=piece.value_at(kind, end)))
    return left


def next_change(pieces: Sequence[Piece], kind: KnowledgeType, t: int) -> int:
    """Return the time at which something begins or ends next after `t`; OPEN if nothing does.

    A number that goes on at another rate, as an action starts or stops to move it, does not begin (rule L6).
    """
    for index, piece in enumerate(pieces):
        following = pieces[index + 1] if index + 1 < len(pieces) else None
        if piece.start > t and not (index and is_carried_on(pieces[index - 1], piece, kind)):
            return piece.start
        if piece.end > t and not (following is not None and following.start == piece.end):
            return piece.end
    return OPEN


def is_carried_on(piece: Piece, following: Piece, kind: KnowledgeType) -> bool:
    """Return whether a number only goes on at another rate: same value and own rate, another rate of what runs."""
    return (
        kind is KnowledgeType.FUNCTION
        and piece.end == following.start
        and piece.value[3] != following.value[3]
        and piece.value_at(kind, following.start)[:3] == following.value[:3]
    )


def numbers_in(pieces: Sequence[Piece], value: Value, start: int, end: int) -> list[Piece]:
    """A number that is recorded late, with what actions had added to its rate in ``[start, end)`` (rule L6).

    Of `pieces` that overlap, the first that covers a time counts; what has been taken away since then may come last.
    """
    times = {t for piece in pieces for t in (piece.start, piece.end) if start < t < end}
    found: list[Piece] = []
    for t in sorted({start} | times):
        told = next((piece for piece in pieces if piece.start <= t < piece.end), None)
        added = 0.0 if told is None else told.value[3] - told.value[2]
        if not found:
            found.append(Piece(start, end, (*value[:3], value[2] + added)))
        elif found[-1].value[3] != value[2] + added:
            moved = found[-1].value_at(KnowledgeType.FUNCTION, t)
            found[-1] = found[-1]._replace(end=t)
            found.append(Piece(t, end, (*moved[:3], value[2] + added)))
    return found
