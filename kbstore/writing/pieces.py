"""Pieces of a timeline in valid time, and how late knowledge edits them (rule L2)."""

from collections.abc import Sequence
from typing import NamedTuple

from kbstore.clock import OPEN
from kbstore.messages import KnowledgeType
from kbstore.model.timelines import EndCause, Value, number_at
from kbstore.storage.records import KnownAssertion

Ended = tuple[int | None, EndCause]
"""The transaction that ended something (None for the open transaction), and the cause."""


class Piece(NamedTuple):
    """A span in which one value holds on a timeline.

    Attributes:
        start, end: in nanoseconds; `end` is OPEN if it holds now.
        first_recorded: the transaction that first recorded it; None if that is the open transaction.
        ended: the transaction that ended it, and why; None if it ended by the clock, or by the next piece.
    """

    start: int
    end: int
    value: Value
    first_recorded: int | None = None
    ended: Ended | None = None

    def value_at(self, kind: KnowledgeType, t: int) -> Value:
        """Return the value at `t`: a number with a rate has moved by then."""
        if kind is not KnowledgeType.FUNCTION:
            return self.value
        return (False, number_at(self.value, self.start, t), *self.value[2:])

    def overlaps(self, start: int, end: int) -> bool:
        """Return whether it holds somewhere in ``[start, end)``."""
        return self.start < end and start < self.end


def piece_of(row: KnownAssertion, now: int) -> Piece:
    """Return a stored row as a piece that ends no later than now."""
    stored = row.stored
    ended = None if row.ended is None or row.cause is None else (row.ended, EndCause(row.cause))
    return Piece(stored.initial_time, min(stored.end_time, now), stored.value, row.first_recorded, ended)


def cut(piece: Piece, kind: KnowledgeType, start: int, end: int, cause: EndCause) -> list[Piece]:
    """Return the parts of a piece before and after a span that it overlaps."""
    left = []
    if piece.start < start:
        left.append(piece._replace(end=start, ended=(None, cause)))
    if end < piece.end:
        left.append(piece._replace(start=end, value=piece.value_at(kind, end)))
    return left


def next_change(pieces: Sequence[Piece], kind: KnowledgeType, t: int) -> int:
    """Return the time of the next start or end after `t`; OPEN if there is none.

    A change of a number's rate alone, because an action starts or stops moving it, does not count (rule L6).
    """
    for index, piece in enumerate(pieces):
        following = pieces[index + 1] if index + 1 < len(pieces) else None
        if piece.start > t and not (index and is_carried_on(pieces[index - 1], piece, kind)):
            return piece.start
        if piece.end > t and not (following is not None and following.start == piece.end):
            return piece.end
    return OPEN


def is_carried_on(piece: Piece, following: Piece, kind: KnowledgeType) -> bool:
    """Return whether a number only goes on at another rate: same value and own rate, but moved by other runs."""
    return (
        kind is KnowledgeType.FUNCTION
        and piece.end == following.start
        and piece.value[3] != following.value[3]
        and piece.value_at(kind, following.start)[:3] == following.value[:3]
    )


def numbers_in(pieces: Sequence[Piece], value: Value, start: int, end: int) -> list[Piece]:
    """Return a number that is recorded late as pieces, with what runs added to its rate in ``[start, end)`` (rule L6).

    Where `pieces` overlap, the first one counts: superseded pieces may follow the known ones.
    """
    times = {t for piece in pieces for t in (piece.start, piece.end) if start < t < end}
    found: list[Piece] = []
    for t in sorted({start} | times):
        known = next((piece for piece in pieces if piece.start <= t < piece.end), None)
        added = 0.0 if known is None else known.value[3] - known.value[2]
        if not found:
            found.append(Piece(start, end, (*value[:3], value[2] + added)))
        elif found[-1].value[3] != value[2] + added:
            moved = found[-1].value_at(KnowledgeType.FUNCTION, t)
            found[-1] = found[-1]._replace(end=t)
            found.append(Piece(t, end, (*moved[:3], value[2] + added)))
    return found
