"""Watching a knowledge base, and a condition, from many tasks (rules Q6, Q9)."""

import asyncio
import itertools
from contextlib import suppress

import pytest

from kbstore import InvalidKnowledge, Truth, UnknownSymbol, aio, seconds
from kbstore.clock import ManualClock
from tests.aio.conftest import threads
from tests.conftest import START


def test_changes_are_followed(run):
    """Q6: every later transaction, as it comes, and nothing twice."""

    async def test(kb):
        async def follow():
            found = []
            async for change in kb.watch(after=1, poll=0.01):
                found.append(change.number)
                if len(found) == 20:
                    return found
            return found

        following = asyncio.create_task(follow())
        for number in range(20):
            await kb.add(f"(= (f) {number})")
        return await following

    assert run(test) == list(range(2, 22))


def test_a_watch_begins_where_it_is_awaited(run):
    """Q6: a change between then and the first poll is not missed."""

    async def test(kb):
        watch = await kb.watch(timeout=0)
        added = await kb.add("(p)")
        entered = kb.watch("(q)", timeout=0)
        async with entered:
            await kb.add("(q)")
            seen = [change.number async for change in entered]
        return added.number, [change.number async for change in watch], seen

    assert run(test) == (2, [2, 3], [3])


def test_a_wrong_pattern_is_refused_where_it_begins(run):
    """Q6, Q9: with the error of `kbstore.KnowledgeBase.watch`."""

    async def test(kb):
        with pytest.raises(UnknownSymbol):
            await kb.watch("(opne ?)")
        with pytest.raises(InvalidKnowledge):
            async for _ in kb.watch("(and (p) (q))"):
                pass
        with pytest.raises(UnknownSymbol):
            await kb.wait_for("(opne)", timeout=1)

    run(test)


def test_a_watcher_that_is_cancelled_misses_nothing(run):
    """A task that gives up waiting, again and again, and continues, gets every change once."""

    async def test(kb):
        watch, found = await kb.watch(poll=0.001), []

        async def write():
            for number in range(60):
                await kb.add(f"(= (f) {number})")

        writing = asyncio.create_task(write())
        for patience in itertools.cycle(range(1, 8)):
            with suppress(TimeoutError):
                found.append((await asyncio.wait_for(anext(watch), 0.0005 * patience)).number)
            if len(found) == 60:
                break
        await writing
        return found

    assert run(test) == list(range(2, 62))


def test_a_cancelled_task_stops_watching(run):
    """The cancellation is raised at once, and the knowledge base is closed as if there had been no watch."""

    async def test(kb):
        async def follow():
            async for _ in kb.watch():
                pass

        task = asyncio.create_task(follow())
        await asyncio.sleep(0.1)
        task.cancel()
        with pytest.raises(asyncio.CancelledError):
            await task

    run(test)


@pytest.mark.parametrize("closes", ["watch", "knowledge base"])
def test_closing_ends_a_watch_quietly(run, closes):
    """Q6, Q9: an iteration ends, without an error; also one that had not begun."""

    async def test(kb):
        watches = [await kb.watch(), await kb.watch_condition("(p)")]

        async def follow(watch, found):
            async for each in watch:
                found.append(each)
            return found

        changes, truths = [], []
        following = [
            asyncio.create_task(follow(watch, found)) for watch, found in zip(watches, (changes, truths), strict=True)
        ]
        waiting = asyncio.create_task(kb.wait_for("(p)"))
        while not truths:
            await asyncio.sleep(0.05)
        if closes == "watch":
            waiting.cancel()
            with suppress(asyncio.CancelledError):
                await waiting
            for watch in watches:
                watch.close()
        else:
            await kb.close()
            assert await waiting is None
        await asyncio.gather(*following)
        assert changes == []
        assert truths == [(START, Truth.FALSE, None)]
        closed = kb.watch()
        closed.close()
        assert [change async for change in closed] == []

    run(test)


def test_a_condition_is_waited_for(run):
    """Q9: at once where it is true, later when it becomes true, and None after the timeout."""

    async def test(kb):
        assert await kb.wait_for("(p)", timeout=0) is None
        assert await kb.wait_for("(p)", timeout=0.1, poll=0.01) is None
        waiting = asyncio.create_task(kb.wait_for("(p)", timeout=30, poll=0.01))
        await asyncio.sleep(0.05)
        added = await kb.add("(p)")
        assert await waiting == added.time
        assert await kb.wait_for("(p)", timeout=0) == added.time

    run(test)


def test_changes_by_the_clock_are_followed(run):
    """Q6, Q9: a scheduled change, without a transaction."""
    clock = ManualClock(START)

    async def test(kb):
        await kb.add("(p)", initial_time=START + seconds(5))
        changes, truths = await kb.watch(timeout=0), await kb.watch_condition("(p)", timeout=0)
        clock.advance(seconds(9))
        assert [(change.time, change.by_clock) async for change in changes] == [(START + seconds(5), True)]
        return [(t, truth, cause) async for t, truth, cause in truths]

    assert run(test, clock=clock) == [(START, Truth.FALSE, None), (START + seconds(5), Truth.TRUE, None)]


def test_many_watchers_need_few_threads(tmp_path):
    """Q6: two hundred watching and waiting tasks get their results with five threads."""

    async def test():
        async with aio.open(tmp_path / "k.db") as kb:
            await kb.add("(p)", "(= (f) 0)")

            async def follow():
                return (await anext(kb.watch("(f)", after=1, poll=0.2))).number

            following = [asyncio.create_task(follow()) for _ in range(100)]
            waiting = [asyncio.create_task(kb.wait_for("(> (f) 0)", poll=0.2)) for _ in range(100)]
            await asyncio.sleep(0.1)
            assert len(threads()) <= 5
            added = await kb.add("(= (f) 1)")
            assert set(await asyncio.gather(*following)) == {added.number}
            assert all(await asyncio.gather(*waiting))

    asyncio.run(test())
    assert threads() == []
