"""The one kind of cache: its entries, and when they are dropped."""

import pytest

from kbstore.storage.caches import LRU


def test_the_least_recently_used_goes_first():
    """Of four entries that exceed the bound, the one that was asked for again stays."""
    cache = LRU(4)
    for key in "abcd":
        cache.put(key, key.upper())
    assert cache.find("a") == "A"
    for key in "ef":
        cache.put(key, key.upper())
    assert cache.find("a") == "A"
    assert cache.find("b") is None
    assert cache.find("f") == "F"


def test_an_entry_stays_while_half_of_the_bound_is_used_beside_it():
    """The guarantee: after n puts an entry is there if n is less than half of the bound."""
    cache = LRU(100)
    cache.put("first", 1)
    for number in range(49):
        cache.put(number, number)
    assert cache["first"] == 1


def test_it_never_holds_more_than_its_bound():
    """After any puts and finds, the entries together are no larger than the bound."""
    cache = LRU(30, size=len)
    for number in range(200):
        cache.put(number, "x" * (number * 7 % 13 + 1))
        cache.find(number * 5 % 17)
        assert sum(map(len, [*cache.values(), *cache._older.values()])) <= 30 + 13


def test_dropped_entries_are_released_gradually():
    """Each new entry releases as much as it takes: no generation is released at once, or stays for long."""
    released = []

    class Entry(list):
        def __del__(self):
            released.append(len(self))

    cache = LRU(100, size=len)
    for number in range(60):
        before = sum(released)
        cache.put(number, Entry("x" * (number % 3 + 1)))
        assert sum(released) - before <= 3 + 3
        assert 2 * number - 100 - 6 <= sum(released)
    assert sum(released) > 0


def test_the_older_generation_is_found_by_find_and_by_index():
    """`find` and ``[]`` look in both generations; an entry found there is young again."""
    cache = LRU(4)
    for key in "abc":
        cache.put(key, key.upper())
    assert "a" not in cache
    assert cache["a"] == "A"
    assert "a" in cache
    with pytest.raises(KeyError):
        cache["z"]
    assert cache.find("z") is None


def test_states_are_weighed_by_their_assertions():
    """The bound is a number of assertions; the states that were not asked for longest are dropped."""
    cache = LRU(30, size=lambda size: size)
    cache.put(1, 10)
    cache.put(2, 10)
    assert cache.find(1)
    cache.put(3, 15)
    assert [t for t in (1, 2, 3) if cache.find(t)] == [1, 3]
    cache.put(4, 31)
    assert [t for t in (1, 3, 4) if cache.find(t)] == [1, 3]


def test_a_bound_of_0_turns_it_off():
    """Nothing is cached, and nothing is found."""
    cache = LRU(0)
    cache.put("a", 1)
    assert cache.find("a") is None
    assert len(cache) == 0


def test_stale_entries_are_dropped_from_both_generations():
    """`drop` removes keys from both generations, `clear` removes all."""
    cache = LRU(4)
    for t in (10, 20, 30):
        cache.put(t, t)
    cache.drop((20, 30))
    assert [t for t in (10, 20, 30) if cache.find(t)] == [10]
    cache.clear()
    assert cache.find(10) is None


def test_putting_many_is_putting_one_after_another():
    """After `put_all`, the generations and the unreleased entries are the same as after a `put` for each."""
    at_once, one_by_one = LRU(30), LRU(30)
    for size in (0, 4, 11, 1, 40, 3, 15, 16, 2, 9):
        values = {number * 5 % 17: number for number in range(size)}
        at_once.put_all(values)
        for key, value in values.items():
            one_by_one.put(key, value)
        assert at_once.find(3) == one_by_one.find(3)
        assert dict(at_once) == dict(one_by_one)
        assert (at_once._older, at_once._dropped) == (one_by_one._older, one_by_one._dropped)
    at_once = LRU(0)
    at_once.put_all({"a": 1})
    assert len(at_once) == 0
