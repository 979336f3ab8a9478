from itertools import pairwise

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from kbstore.evaluation.intervals import Intervals, merged


def test_intervals_are_a_list_of_pairs() -> None:
    """Q4: the answer of `when` is a list of (start, end)."""
    assert Intervals([(1, 3), (5, 9)]) == [(1, 3), (5, 9)]


def test_properties_of_intervals() -> None:
    """Q4: ever, first and last time, total duration; the last time is within the half-open interval."""
    intervals = Intervals([(10, 30), (50, 51)])
    assert (intervals.ever, intervals.first, intervals.last, intervals.total) == (True, 10, 50, 21)
    never = Intervals()
    assert (never.ever, never.first, never.last, never.total) == (False, None, None, 0)


@pytest.mark.parametrize(
    ("span", "always"),
    [((10, 30), True), ((10, 31), False), ((9, 12), False), ((12, 55), False), ((50, 51), True), ((40, 40), True)],
)
def test_always_is_throughout_a_span(span: tuple[int, int], always: bool) -> None:
    """Q4: a half-open span lies within one interval; an empty one within anything."""
    assert Intervals([(10, 30), (50, 60)]).always(span) is always


@settings(deadline=None)
@given(st.lists(st.tuples(st.integers(0, 20), st.integers(0, 20))))
def test_merged_intervals_cover_the_same_times_and_are_maximal(intervals: list[tuple[int, int]]) -> None:
    """Q4: maximal half-open intervals, in order, none of which meet."""
    found = merged(intervals)
    assert {t for a, b in found for t in range(a, b)} == {t for a, b in intervals for t in range(a, b)}
    assert all(a < b for a, b in found)
    assert all(b < c for (_, b), (c, _) in pairwise(found))
