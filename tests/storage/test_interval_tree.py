"""The interval tree, compared with a search through all intervals."""

from hypothesis import example, given
from hypothesis import strategies as st

from kbstore.clock import OPEN, TIME_LIMIT
from kbstore.storage.interval_tree import EMPTY_LEVEL, LEVELS, OPEN_LEVEL, level, node, path, ranges, superseded

small = st.integers(0, 70)
near_a_power = st.builds(lambda power, near: max(0, 2**power + near), st.integers(0, 61), st.integers(-3, 3))
times = st.one_of(small, near_a_power, st.integers(0, TIME_LIMIT - 1))


@given(times, times)
def test_the_node_is_where_the_paths_to_both_ends_part(start, end):
    """The node of [start, end) has the leading bits that start + 1 and end share, then a one, then zeros."""
    if end <= start:
        assert node(start, end) is None
        return
    first, last = format(start + 1, "063b"), format(end, "063b")
    parting = next((place for place in range(63) if first[place] != last[place]), 63)
    expected = first if parting == 63 else first[:parting] + "1" + "0" * (62 - parting)
    assert format(node(start, end), "063b") == expected
    assert start < node(start, end) <= end


@given(times, times)
def test_the_level_is_the_number_of_trailing_zeros_of_the_node(start, end):
    """With its level the end of an interval gives its node; so does its beginning, which is less than a step before."""
    if end <= start:
        assert level(start, end) == EMPTY_LEVEL == -64
        return
    height, where = level(start, end), format(node(start, end), "b")
    assert where.endswith("1" + "0" * height)
    assert node(start, end) == end >> height << height
    assert node(start, end) - 2**height <= start + 1 <= node(start, end)


def test_open_and_empty_intervals_have_no_node():
    """Open intervals have a level above the tree, from 0 on; empty ones have a level that is never visited."""
    assert node(0, OPEN) is None
    assert node(TIME_LIMIT - 1, OPEN) is None
    assert node(7, 7) is None
    assert node(7, 3) is None
    assert level(0, OPEN) == OPEN_LEVEL == 62
    assert level(7, 7) == level(7, 3) == EMPTY_LEVEL
    begins, ends = ranges(TIME_LIMIT - 1)
    assert (begins[OPEN_LEVEL], ends[OPEN_LEVEL]) == (0, None)


def test_superseded_rows_have_separate_levels():
    """No level of a superseded row is one of a current row, or that of empty rows."""
    known = range(LEVELS + 1)
    gone = [superseded(level) for level in known]
    assert gone == list(range(-1, -64, -1))
    assert [superseded(level) for level in gone] == list(known)
    assert not {*known, EMPTY_LEVEL} & set(gone)


@given(times, times, times)
@example(0, 1, 0)
@example(0, TIME_LIMIT - 1, 0)
@example(0, TIME_LIMIT - 1, TIME_LIMIT - 2)
@example(TIME_LIMIT - 2, TIME_LIMIT - 1, TIME_LIMIT - 2)
def test_an_interval_is_found_at_a_time_if_it_contains_it(start, end, t):
    """On its level an interval is within one range, once, if start <= t < end, and never otherwise."""
    if end <= start:
        return
    begins, ends = ranges(t)
    first, past = begins[level(start, end)], ends[level(start, end)]
    found = (first is not None and first <= start <= t) + (past is not None and t < end < past)
    assert found == (start <= t < end)
    if start <= t < end:
        assert node(start, end) in path(t)


@given(times, times, times)
@example(0, 1, 0)
@example(0, TIME_LIMIT - 1, TIME_LIMIT - 2)
def test_the_block_around_a_time_is_enough(start, end, t):
    """The documented SQL: an interval begins by t in the block around t and ends beyond it, or ends in it."""
    if end <= start:
        return
    height = level(start, end)
    first = (t + 1) >> height << height
    found = (first - 1 <= start <= t and end >= first + 2**height) + (t < end < first + 2**height)
    assert found == (start <= t < end)


@given(times)
def test_a_path_has_one_node_for_each_level(t):
    """On each level the path has one node and one range, of beginnings or of ends."""
    begins, ends = ranges(t)
    assert len(path(t)) == len(set(path(t))) == LEVELS
    assert len(begins) == len(ends) == LEVELS + 1
    for height, (where, first, past) in enumerate(zip(path(t), begins[:-1], ends[:-1], strict=True)):
        assert where & -where == 2**height
        assert (first is None) == (where <= t + 1) != (past is None)
