"""The soak test: its report, without judging its speed."""

from benchmarks.soak import soak, spread


def test_a_spread_is_of_what_was_measured():
    """Of 1 to 200 ms: the median, the 99th percentile, and the longest, in milliseconds."""
    assert spread([number / 1000 for number in range(200, 0, -1)]) == (200, 101.0, 199.0, 200.0)


def test_a_short_soak_has_the_shape_of_a_long_one(tmp_path):
    """It stops by itself, has latencies and memory of each kind of work, and the watcher misses nothing."""
    found = soak(tmp_path / "soak.db", 1.0, 50)
    assert found.latencies.keys() == found.memory.keys() == {"write", "poll a state", "poll a fact", "watch"}
    assert {name: each.count for name, each in found.latencies.items() if name != "watch"} == {
        "write": 5,
        "poll a state": 10,
        "poll a fact": 10,
    }
    assert all(0 <= each.p50 <= each.p99 <= each.longest for each in found.latencies.values())
    assert found.watched == (5, 5)
    assert found.log > 0
