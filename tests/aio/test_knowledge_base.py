"""Reading and writing a knowledge base from many tasks."""

import asyncio
import threading

import pytest

import kbstore
from kbstore import Conflict, InvalidKnowledge, StoreUnavailable, Truth, UnknownSymbol, aio, seconds
from kbstore.clock import ManualClock
from tests.aio.conftest import threads
from tests.conftest import START


def test_added_knowledge_is_returned(run):
    """The answers and the errors are those of `kbstore.KnowledgeBase`."""

    async def test(kb):
        added = await kb.add("hall - place", "(open hall)", "(= (f) 3)", client="door")
        assert (added.client, added.changes) == ("door", 3)
        assert await kb.holds("(open hall)")
        assert await kb.truth("(p)") is Truth.FALSE
        assert await kb.value("(* 2 (f))") == 6
        assert await kb.find("(open ?x)") == [{"x": "hall"}]
        assert (await kb.state(at=await kb.now())).holds("(open hall)")
        assert [change.number async for change in kb.changes()] == [1, 2]
        assert [change.number async for change in kb.changes(after=added)] == []
        assert (await kb.domain).name == "d"
        assert await kb.history_from == 0
        assert "(open hall)" in await kb.to_pddl()
        assert await kb.read(lambda plain: [plain.name, plain.holds("(open hall)")]) == [kb.name, True]
        with pytest.raises(UnknownSymbol, match="opne"):
            await kb.holds("(opne hall)")
        with pytest.raises(InvalidKnowledge):
            await kb.add("(open nowhere)")
        assert not kb.use_unknowns

    run(test)


def test_all_changes_come_in_order(run):
    """Q6: also where there are more than a thread fetches at once."""

    async def test(kb):
        for number in range(300):
            await kb.add(f"(= (f) {number})")
        assert [change.number async for change in kb.changes(after=1)] == list(range(2, 302))

    run(test)


class Witness(ManualClock):
    """A clock that records which threads have read it."""

    def __init__(self):
        super().__init__(START)
        self.threads = []

    def now(self):
        """Return the time that was last set."""
        self.threads.append(threading.current_thread())
        return super().now()


def test_a_short_question_needs_no_thread(tmp_path):
    """A fact or number that has been asked for before is read at once from a file; any other question in a thread."""

    async def test():
        clock, here = Witness(), threading.current_thread()
        async with aio.open(tmp_path / "k.db", clock=clock) as kb:
            await kb.add("(p)", "(= (f) 3)")

            async def asked_in(question):
                clock.threads.clear()
                await question
                return set(clock.threads)

            for short in (lambda: kb.holds("(p)"), lambda: kb.value("(f)")):
                assert here not in await asked_in(short())
                assert await asked_in(short()) == {here}
                await kb.add("(increase (f) 1)")
                assert await asked_in(short()) == {here}
            for long in (lambda: kb.holds("(and (p) (> (f) 2))"), kb.state, lambda: kb.holds("(p)", START)):
                await long()
                assert here not in await asked_in(long())
            assert await kb.value("(f)") == 5

    asyncio.run(test())


def test_a_question_does_not_stop_an_open_transaction(run, store_url):
    """The event loop is not blocked; in memory, with one connection, the question is answered after it."""

    async def test(kb):
        await kb.add("(p)")
        assert await kb.holds("(p)")
        assert await kb.holds("(p)")
        async with kb.transaction() as tx:
            await tx.remove("(p)")
            asking = asyncio.create_task(kb.holds("(p)"))
            await asyncio.sleep(0.05)
            await tx.add("(q)")
        return await asking

    assert run(test) is (store_url != "sqlite://")


def test_many_tasks(run):
    """No increment of a hundred tasks is lost, and there are five threads at most."""

    async def test(kb):
        await kb.add("(= (f) 0)")

        async def increase():
            await kb.add("(increase (f) 1)")
            assert await kb.value("(f)") > 0

        await asyncio.gather(*(increase() for _ in range(100)))
        assert 0 < len(threads()) <= 5
        return await kb.value("(f)")

    assert run(test) == 100


# -- transactions ---------------------------------------------------------------------------------------------


def test_a_transaction_sees_its_own_writes(run):
    """Its methods are awaited; other tasks see nothing of it before its end, and `result` is its transaction."""

    async def test(kb):
        async with kb.transaction(client="me", note="why") as tx:
            await tx.add("(p)", "(= (f) 2)")
            assert await tx.holds("(p)")
            assert await tx.value("(f)") == 2
            await tx.remove("(p)")
            assert not (await tx.state()).holds("(p)")
        assert (tx.result.number, tx.result.client, tx.result.note) == (2, "me", "why")
        assert [await kb.holds("(p)"), await kb.value("(f)")] == [False, 2]

    run(test)


def test_an_exception_stores_nothing(run):
    """C1: the next transaction takes the number."""

    async def test(kb):
        async def write(*items, expect=None):
            async with kb.transaction(expect=expect) as tx:
                for item in items:
                    await tx.add(item)
                raise ZeroDivisionError

        with pytest.raises(ZeroDivisionError):
            await write("(p)")
        with pytest.raises(InvalidKnowledge):
            await write("(p)", "(open nowhere)")
        with pytest.raises(Conflict):
            await write(expect=0)
        return (await kb.add("(q)")).number, await kb.holds("(p)")

    assert run(test) == (2, False)


def test_a_task_that_is_cancelled_in_its_block_stores_nothing(run):
    """Its writes are rolled back, and waiting tasks continue."""

    async def test(kb):
        begun = asyncio.Event()

        async def write():
            async with kb.transaction() as tx:
                await tx.add("(p)")
                begun.set()
                await asyncio.sleep(60)

        writer = asyncio.create_task(write())
        await begun.wait()
        waiting = asyncio.create_task(kb.add("(q)"))
        await asyncio.sleep(0.02)
        assert not waiting.done()
        writer.cancel()
        with pytest.raises(asyncio.CancelledError):
            await writer
        assert (await waiting).number == 2
        return await kb.holds("(p)")

    assert run(test) is False


def test_writing_past_an_open_transaction_is_refused(run):
    """In the task of the block, and in those that it starts: they would wait for each other forever."""

    async def test(kb):
        async with kb.transaction() as tx:
            for write in (kb.add("(q)"), kb.close(), asyncio.create_task(kb.add("(q)"))):
                with pytest.raises(Conflict, match="a transaction is open in this task"):
                    await write
            with pytest.raises(Conflict):
                async with kb.transaction():
                    pass
            await tx.add("(p)")
        await kb.add("(q)")
        with pytest.raises(Conflict):
            await tx.add("(p)")
        return await kb.holds("(and (p) (q))")

    assert run(test)


@pytest.mark.parametrize("cancelled_twice", [False, True])
def test_a_cancelled_write_that_has_begun_is_finished_first(run, cancelled_twice):
    """When the cancellation is raised the write has been stored; a write that had not begun never is."""

    async def test(kb):
        begun, going_on = threading.Event(), threading.Event()

        def slow(plain):
            begun.set()
            going_on.wait(30)
            return plain.add("(p)")

        writing = asyncio.create_task(kb.write(slow))
        while not begun.is_set():
            await asyncio.sleep(0.01)
        waiting = asyncio.create_task(kb.add("(q)"))
        await asyncio.sleep(0.02)
        for task in (writing, waiting, *[writing] * cancelled_twice):
            task.cancel()
            await asyncio.sleep(0.02)
        assert waiting.cancelled()
        assert not writing.done()
        going_on.set()
        with pytest.raises(asyncio.CancelledError):
            await writing
        return await kb.holds("(p)"), await kb.holds("(q)")

    assert run(test) == (True, False)


def test_a_transaction_cancelled_while_it_begins_releases_its_lock(tmp_path):
    """Its lock is not left behind: it waits for another program's lock, is cancelled, and others write."""

    async def test():
        async with aio.open(tmp_path / "k.db") as kb:
            with kbstore.open(tmp_path / "k.db") as other:
                with other.transaction() as tx:
                    tx.add("(p)")
                    entering = asyncio.create_task(kb.transaction().__aenter__())
                    await asyncio.sleep(0.1)
                    entering.cancel()
                    await asyncio.sleep(0.1)
                with pytest.raises(asyncio.CancelledError):
                    await entering
                other.add("(q)")
            await kb.add("(r)")
            return await kb.holds("(and (p) (q) (r))")

    assert asyncio.run(test())


# -- opening and closing --------------------------------------------------------------------------------------


def test_it_is_opened_with_or_without_a_block(tmp_path):
    """Awaited, it is closed by `close`, which may be called twice; afterwards it is `StoreUnavailable`."""

    async def test():
        kb = await aio.open(tmp_path / "k.db", "kenny")
        await kb.add("(p)")
        await kb.close()
        await kb.close()
        assert threads() == []
        for asking in (kb.holds("(p)"), kb.add("(p)"), kb.state()):
            with pytest.raises(StoreUnavailable, match="closed"):
                await asking
        async with aio.open(tmp_path / "k.db", "kenny", read_only=True) as kb:
            return await kb.holds("(p)")

    assert asyncio.run(test())


def test_a_store_that_cannot_be_opened_leaves_no_thread(tmp_path):
    """The error is that of `kbstore.open`."""

    async def test():
        with pytest.raises(StoreUnavailable):
            await aio.open(tmp_path / "missing.db", read_only=True)
        with pytest.raises(InvalidKnowledge):
            async with aio.open(tmp_path / "k.db", "\n"):
                pass
        opening = asyncio.ensure_future(aio.open(tmp_path / "k.db").__aenter__())
        await asyncio.sleep(0)
        opening.cancel()
        with pytest.raises(asyncio.CancelledError):
            await opening

    asyncio.run(test())
    assert threads() == []


def test_closing_waits_for_a_transaction_of_another_task(run):
    """The transaction that has begun is stored."""

    async def test(kb):
        begun = asyncio.Event()

        async def write():
            async with kb.transaction() as tx:
                begun.set()
                await asyncio.sleep(0.1)
                await tx.add("(p)")
            return tx.result.number

        writer = asyncio.create_task(write())
        await begun.wait()
        await kb.close()
        return await writer

    assert run(test) == 2


def test_an_action_runs(run):
    """O3: it is started, runs, and ends, as without asyncio."""
    domain = (
        "(define (domain d) (:predicates (p)) (:durative-action wait :parameters () :duration (= ?duration 5)"
        " :condition () :effect (at end (p))))"
    )

    async def test(kb):
        await kb.load(domain)
        started = await kb.start("wait")
        assert started.duration == seconds(5)
        assert [found.outcome for found in await kb.runs()] == ["running"]
        assert (await kb.end(started)).failing == []
        return await kb.holds("(p)")

    assert run(test)
