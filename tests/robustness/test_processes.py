"""Several processes on one store: nothing is lost or repeated, and one of several is first."""

import os
import signal
import time
from itertools import pairwise

import pytest

import kbstore
from tests.processes import answers, barrier, finish, queue, start
from tests.robustness.processes import follow, increment, keep_watching, open_and_add, race, watch, write

PROCESSES = 8
INCREMENTS = 500
"""Of each process."""


def test_no_increment_is_lost(shared_url, name):
    """C7, Q6: the counter that eight processes increase has the sum of all, in numbers without gaps."""
    with kbstore.open(shared_url, name) as kb:
        kb.add("(= (counter) 0)")
        together = barrier(PROCESSES)
        finish(*(start(increment, shared_url, name, INCREMENTS, together) for _ in range(PROCESSES)))
        total = PROCESSES * INCREMENTS
        assert kb.value("(counter)") == total
        changes = list(kb.changes(after=1))
        assert [change.number for change in changes] == list(range(2, total + 2))
        assert [change.asserted[0].item.function_value for change in changes] == list(range(1, total + 1))
        assert all(a.time <= b.time for a, b in pairwise(changes))


@pytest.mark.parametrize("attempt", range(2))
def test_a_store_may_be_opened_first_by_several(untouched_url, attempt):
    """Schema, WAL mode and knowledge base are created once, also where eight processes open the store at once."""
    del attempt
    together = barrier(PROCESSES)
    finish(*(start(open_and_add, untouched_url, "first", number, together) for number in range(PROCESSES)))
    assert kbstore.knowledge_bases(untouched_url) == ["first"]
    with kbstore.open(untouched_url, "first") as kb:
        assert {fact.arguments[0] for fact in kb.state().facts} == {f"p{number}" for number in range(PROCESSES)}
        assert [change.number for change in kb.changes()] == list(range(1, PROCESSES + 1))


def test_one_of_several_processes_with_the_same_expectation_succeeds(shared_url, name):
    """`expect`: of eight that expect the same transaction to be the latest, exactly one succeeds, in each round."""
    rounds, won, together = 8, queue(), barrier(PROCESSES)
    with kbstore.open(shared_url, name) as kb:
        kb.add("(ready)")
        finish(*(start(race, shared_url, name, me, rounds, together, won) for me in range(PROCESSES)))
        winners = sorted(answers(won))
        assert [(expected, number) for expected, _, number in winners] == [(n, n + 1) for n in range(1, rounds + 1)]
        assert [change.transaction.client for change in kb.changes(after=1)] == [f"p{me}" for _, me, _ in winners]


@pytest.mark.parametrize("follower", [follow, watch])
def test_a_follower_misses_and_repeats_nothing(shared_url, name, follower):
    """Q6: while three processes write, a fourth sees each transaction once, in order."""
    writers, times, seen = 3, 25, queue()
    with kbstore.open(shared_url, name) as kb:
        kb.add("(ready)")
    total = 1 + writers * times
    following = start(follower, shared_url, name, 0, total, seen)
    finish(*(start(write, shared_url, name, me, times) for me in range(writers)), following)
    found = answers(seen)
    assert [number for number, _ in found] == list(range(1, total + 1))
    expected = {f"(seen p{me} n{number})" for me in range(writers) for number in range(times)}
    assert {text for _, text in found[1:]} == expected


def test_a_killed_follower_can_be_restarted(shared_url, name, tmp_path):
    """Q6: killed at any time, and restarted after the last number that it recorded, it has seen each change once."""
    diary, total = tmp_path / "diary", 41
    diary.touch()
    with kbstore.open(shared_url, name) as kb:
        kb.add("(ready)")
    writing = start(write, shared_url, name, 0, total - 1)
    for kill_at in (5, 15, 25, 35):
        following = start(keep_watching, shared_url, name, diary, 10**9)
        while diary.read_bytes().count(b"\n") < kill_at:
            time.sleep(0.001)
        os.kill(following.pid, signal.SIGKILL)
        following.join()
    finish(writing, start(keep_watching, shared_url, name, diary, total))
    assert diary.read_text().split() == [str(number) for number in range(1, total + 1)]
