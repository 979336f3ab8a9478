"""A timeline as a list of pieces in valid time, and how late knowledge edits it (rule L2)."""

from collections.abc import Callable
from dataclasses import dataclass, replace

from tests.oracle.items import Item, Number

FOREVER = 2**63 - 1
Spans = list[tuple[int, int]]


@dataclass(frozen=True)
class Piece:
    """An item known to hold from `start` to `end`.

    `first_recorded` and `ended` are None where this transaction records or ends it.
    """

    start: int
    end: int
    item: Item
    first_recorded: int | None = None
    ended: tuple[int | None, str] | None = None


def next_change(pieces: list[Piece], t: int) -> int:
    """The first time after t at which a piece begins or ends."""
    return min((at for piece in pieces for at in (piece.start, piece.end) if at > t), default=FOREVER)


def cut(
    pieces: list[Piece], since: int, until: int, cause: str, value: Callable[[Number, int, int], float]
) -> list[Piece]:
    """Cut a span out of the pieces. A moving number continues from its value at the end of the span."""
    left = []
    for piece in pieces:
        if until <= piece.start or piece.end <= since:
            left.append(piece)
            continue
        if piece.start < since:
            left.append(replace(piece, end=since, ended=(None, cause)))
        if until < piece.end:
            item = piece.item
            if isinstance(item, Number):
                item = replace(item, value=value(item, piece.start, until))
            left.append(replace(piece, start=until, item=item))
    return left


def merged(spans: Spans) -> Spans:
    """Spans in order of time, with adjacent ones joined."""
    found: Spans = []
    for start, end in spans:
        if found and found[-1][1] == start:
            found[-1] = (found[-1][0], end)
        elif start < end:
            found.append((start, end))
    return found


def minus(before: Spans, after: Spans) -> Spans:
    """The parts of some spans that other spans do not cover."""
    left = before
    for start, end in after:
        left = [
            piece
            for first, last in left
            for piece in ((first, min(last, start)), (max(first, end), last))
            if piece[0] < piece[1]
        ]
    return left
