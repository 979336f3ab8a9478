"""The relational interval tree: which rows stood at a time, by plain B-tree indexes.

Source: H.-P. Kriegel, M. Pötke, T. Seidl, "Managing Intervals Efficiently in Object-Relational Databases",
VLDB 2000. Every closed interval is kept under one node of a virtual binary tree over time: the highest node that
lies within it. The intervals that contain a time t are kept on the path from the root to t, so they are found by
at most 63 index look-ups of each side, however long the history.
"""

from kbstore.clock import OPEN

LEVELS = 62
"""The height of the tree: times are below 2**62."""


def node(start: int, end: int) -> int | None:
    """The node of the half-open interval ``[start, end)``; None for an open or an empty one.

    Inside the tree every time is one higher, so that no node is 0: it is the number within ``start + 1 .. end``
    that has the most zero bits at its end.
    """
    if end == OPEN or end <= start:
        return None
    different = (start + 1) ^ end
    if not different:
        return end
    return end & ~((1 << (different.bit_length() - 1)) - 1)


# The nodes on the path to :t that lie left of it, and those right of it (or on it), as subqueries. The IN form is
# deliberate: after ANALYZE, SQLite puts a Bloom filter over a join with the levels and scans the whole index.
LEVELS_CTE = f"WITH RECURSIVE level(h) AS (SELECT 0 UNION ALL SELECT h + 1 FROM level WHERE h < {LEVELS})"
_T = "(CAST(:t AS BIGINT) + 1)"
NODES_RIGHT = f"(SELECT (({_T} >> h) | 1) << h FROM level WHERE ({_T} >> h) & 1 = 0)"
NODES_LEFT = f"(SELECT ({_T} >> h) << h FROM level WHERE ({_T} >> h) & 1 = 1)"
