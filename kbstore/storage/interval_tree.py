"""The relational interval tree: which rows stood at a time, by plain B-tree indexes.

Source: H.-P. Kriegel, M. Pötke, T. Seidl, "Managing Intervals Efficiently in Object-Relational Databases",
VLDB 2000. Every closed interval is kept under one node of a virtual binary tree over time: the one within it where
the paths from the root to its two ends part. The intervals that contain a time t are kept on the path from the root
to t, so they are found by at most 63 index look-ups of each side, however long the history.
"""

from functools import lru_cache

from kbstore.clock import OPEN

LEVELS = 62
"""The height of the tree: times are below 2**62."""


def node(start: int, end: int) -> int | None:
    """The node of the half-open interval ``[start, end)``; None for an open or an empty one.

    Inside the tree every time is one higher, so that no node is 0: it is the leading bits that ``start + 1`` and
    ``end`` have in common, a one, and zeros.
    """
    if end == OPEN or end <= start:
        return None
    different = (start + 1) ^ end
    if not different:
        return end
    return end & ~((1 << (different.bit_length() - 1)) - 1)


@lru_cache(maxsize=256)
def path(t: int) -> tuple[tuple[int, ...], tuple[int, ...]]:
    """The nodes on the path from the root to a time: those left of it or on it, and those right of it.

    An interval that contains `t` is kept left of it and ends after it, or right of it and begins no later.
    """
    place = t + 1
    left = tuple((place >> height) << height for height in range(LEVELS) if (place >> height) & 1)
    right = tuple(((place >> height) | 1) << height for height in range(LEVELS) if not (place >> height) & 1)
    return left, right
