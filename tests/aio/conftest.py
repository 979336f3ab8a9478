"""Knowledge bases for asyncio on each kind of store, and checks that no threads are left."""

import asyncio
import itertools
import threading

import pytest

from kbstore import aio
from kbstore.clock import ManualClock
from tests.conftest import START

DOMAIN = "(define (domain d) (:types place) (:predicates (p) (q) (open ?x - place)) (:functions (f)))"

_numbers = itertools.count(1)


@pytest.fixture
def run(store_url):
    """Run a test's coroutine with an open knowledge base; no thread of kbstore is left afterwards."""

    def running(test, **options):
        async def main():
            clock = ManualClock(START)
            async with aio.open(store_url, f"aio{next(_numbers)}", **{"clock": clock, **options}) as kb:
                await kb.load(DOMAIN)
                return await asyncio.wait_for(test(kb), 60)

        try:
            return asyncio.run(main())
        finally:
            assert threads() == []

    return running


def threads():
    """The names of the threads of kbstore.aio."""
    return [thread.name for thread in threading.enumerate() if thread.name.startswith("kbstore")]
