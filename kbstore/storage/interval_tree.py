"""The relational interval tree: which rows held at a time, by plain B-tree indexes.

Source: H.-P. Kriegel, M. Pötke, T. Seidl, "Managing Intervals Efficiently in Object-Relational Databases",
VLDB 2000. Every closed interval is kept under one node of a virtual binary tree over time: the one within it where
the paths from the root to its two ends part. The intervals that contain a time t are kept on the path from the root
to t, so they are found by at most 62 index look-ups, however long the history.

Other than in the paper a row of the large tables keeps not the node but its `level`, the height of the node above the
leaves: on one level the end of an interval gives its node. That is one byte instead of eight, in the row and in both of
its indexes. Rows that are open have a level of their own, as if the tree were higher by one. A row that was
superseded moves to the negative level ``-1 - level``, which questions about what is known now never visit.
"""

from functools import lru_cache

from kbstore.clock import OPEN

LEVELS = 62
"""The height of the tree: times are below 2**62."""

OPEN_LEVEL = LEVELS
"""The level of what is open."""

EMPTY_LEVEL = -2 - OPEN_LEVEL
"""The level of what is cancelled or has no length: no time is in it."""


def node(start: int, end: int) -> int | None:
    """The node of the half-open interval ``[start, end)``; None for an open or an empty one.

    Inside the tree every time is one higher, so that no node is 0: it is the leading bits that ``start + 1`` and
    ``end`` have in common, a one, and zeros.
    """
    height = level(start, end)
    return (end >> height) << height if 0 <= height < LEVELS else None


def level(start: int, end: int) -> int:
    """The level of ``[start, end)``: how many zeros its node ends with, `OPEN_LEVEL`, or `EMPTY_LEVEL`."""
    if end == OPEN:
        return OPEN_LEVEL
    if end <= start:
        return EMPTY_LEVEL
    different = (start + 1) ^ end
    return (different or end & -end).bit_length() - 1


def superseded(level: int) -> int:
    """The level of a row that was superseded, of that which it had; and back."""
    return -1 - level


@lru_cache(maxsize=256)
def path(t: int) -> tuple[int, ...]:
    """The nodes on the path from the root to a time: what contains it is kept under these."""
    place = t + 1
    return tuple(((place >> height) | 1) << height for height in range(LEVELS))


@lru_cache(maxsize=256)
def ranges(t: int) -> tuple[tuple[int | None, ...], tuple[int | None, ...]]:
    """For each level, from 0 on, where the intervals that contain a time begin, or where they end.

    If the path's node of a level is right of `t`, they are those that begin from the first number on, and no later
    than `t`; if it is left of it or on it, they are those that end after `t` and before the second number. For each
    level one of the two is None. What is open is the last level, and begins from 0 on.
    """
    place = t + 1
    blocks = [(place >> height) << height for height in range(LEVELS)]
    begins = tuple(None if block >> height & 1 else block - 1 for height, block in enumerate(blocks))
    ends = tuple(block + (1 << height) if block >> height & 1 else None for height, block in enumerate(blocks))
    return (*begins, 0), (*ends, None)
