"""The relational interval tree: finds the rows that held at a time by plain B-tree indexes.

Source: H.-P. Kriegel, M. Pötke, T. Seidl, "Managing Intervals Efficiently in Object-Relational Databases",
VLDB 2000. Every closed interval is stored under one node of a virtual binary tree over time: the node within it at
which the paths from the root to its two ends part. The intervals that contain a time t are stored on the path from the
root to t, so they are found by at most 62 index look-ups, however long the history.

Unlike in the paper, a row of the large tables stores not the node but its `level`, the height of the node above the
leaves: on one level the end of an interval gives its node. That is one byte instead of eight, in the row and in both of
its indexes. Open rows have a level of their own, as if the tree were higher by one. A row that was superseded moves to
the negative level ``-1 - level``, which questions about what is known now never visit.
"""

from functools import lru_cache

from kbstore.clock import OPEN

LEVELS = 62
"""The height of the tree: times are below 2**62."""

OPEN_LEVEL = LEVELS
"""The level of open rows."""

EMPTY_LEVEL = -2 - OPEN_LEVEL
"""The level of rows that were cancelled or have no length, and contain no time."""


def node(start: int, end: int) -> int | None:
    """Return the node of the half-open interval ``[start, end)``; None for an open or an empty one.

    Its bits are the leading bits that ``start + 1`` and ``end`` have in common, a one, and zeros. Inside the tree every
    time is one higher, so that no node is 0.
    """
    height = level(start, end)
    return (end >> height) << height if 0 <= height < LEVELS else None


def level(start: int, end: int) -> int:
    """Return the level of ``[start, end)``: the number of zeros at its node's end, `OPEN_LEVEL` or `EMPTY_LEVEL`."""
    if end == OPEN:
        return OPEN_LEVEL
    if end <= start:
        return EMPTY_LEVEL
    different = (start + 1) ^ end
    return (different or end & -end).bit_length() - 1


def superseded(level: int) -> int:
    """Return the level of a superseded row from the level that it had, or the other way round."""
    return -1 - level


@lru_cache(maxsize=256)
def path(t: int) -> tuple[int, ...]:
    """Return the nodes on the path from the root to a time: the intervals that contain it are stored under these."""
    place = t + 1
    return tuple(((place >> height) | 1) << height for height in range(LEVELS))


@lru_cache(maxsize=256)
def ranges(t: int) -> tuple[tuple[int | None, ...], tuple[int | None, ...]]:
    """Return for each level, from 0 on, a bound on the intervals that contain `t`: of their starts, or of their ends.

    If the path's node on a level is right of `t`, its intervals are those that start between the first number and `t`,
    both included; if it is at `t` or left of it, those that end after `t` and before the second number. On each level
    one of the two is None. The last level is that of open intervals, which start from 0 on.
    """
    place = t + 1
    begins: list[int | None] = []
    ends: list[int | None] = []
    for height in range(LEVELS):
        block = (place >> height) << height
        is_right_half = block >> height & 1
        begins.append(None if is_right_half else block - 1)
        ends.append(block + (1 << height) if is_right_half else None)
    return (*begins, 0), (*ends, None)
