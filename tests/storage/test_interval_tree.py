"""The interval tree, compared with intervals that are simply gone through."""

from hypothesis import example, given
from hypothesis import strategies as st

from kbstore.clock import OPEN, TIME_LIMIT
from kbstore.storage.interval_tree import LEVELS, node, path

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


def test_open_and_empty_intervals_have_no_node():
    """Open intervals have an index of their own; empty ones, as cancelled rows are, are in none."""
    assert node(0, OPEN) is None
    assert node(TIME_LIMIT - 1, OPEN) is None
    assert node(7, 7) is None
    assert node(7, 3) is None


@given(times, times, times)
@example(0, 1, 0)
@example(0, TIME_LIMIT - 1, 0)
@example(0, TIME_LIMIT - 1, TIME_LIMIT - 2)
@example(TIME_LIMIT - 2, TIME_LIMIT - 1, TIME_LIMIT - 2)
def test_an_interval_is_found_at_a_time_if_it_contains_it(start, end, t):
    """By the path of t and one comparison an interval is found once, if start <= t < end, and never otherwise."""
    if end <= start:
        return
    left, right = path(t)
    where = node(start, end)
    found = (where in right and start <= t) + (where in left and end > t)
    assert found == (start <= t < end)


@given(times)
def test_a_path_is_as_long_as_the_tree_is_high(t):
    """Each level has one node of the path, on one side of t, so that no question reads more than that."""
    left, right = path(t)
    assert len(left) + len(right) == LEVELS
    assert all(number <= t + 1 for number in left)
    assert all(number > t for number in right)
    assert not {*left} & {*right}
