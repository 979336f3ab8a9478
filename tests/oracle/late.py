"""What is known of a timeline as a list of pieces in valid time, and how late knowledge edits it (rule L2)."""

from collections.abc import Callable
from dataclasses import dataclass, replace

from tests.oracle.items import Item, Number

FOREVER = 2**63 - 1
Spans = list[tuple[int, int]]


@dataclass(frozen=True)
class Piece:
    """From `start` to `end` this is known. `first_told` and `ended` are None where it is this transaction's doing."""

    start: int
    end: int
    item: Item
    first_told: int | None = None
    ended: tuple[int | None, str] | None = None


def next_change(pieces: list[Piece], t: int) -> int:
    """When something begins or ends next after a time."""
    return min((at for piece in pieces for at in (piece.start, piece.end) if at > t), default=FOREVER)


def cut(
    pieces: list[Piece], since: int, until: int, cause: str, value: Callable[[Number, int, int], float]
) -> list[Piece]:
    """The pieces with a span left blank. A number that moves goes on from its value at the end of the span."""
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
    """Spans in order of time, where adjacent ones are one."""
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
