"""An interrupt (Ctrl-C) at any point of a call leaves nothing open: the next call of the thread works."""

import contextlib
import gc
import itertools
import os
import sys
import threading

import pytest

import kbstore
from kbstore.errors import StoreUnavailable

ROOT = os.path.dirname(kbstore.__file__)
pytestmark = pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
"""An interrupt while an object is deleted is reported, not raised."""

ENDINGS = {"__exit__", "checkin", "_return", "put"}
"""Functions that clean up: an interrupt before their first line cannot be handled."""


class Interrupt:
    """A profiler that raises `KeyboardInterrupt` at the nth point at which CPython would raise it in kbstore.

    CPython checks for signals when a function in Python begins, and when one in C has returned.
    """

    def __init__(self, n):
        self.left = n
        self.moment = None

    def __call__(self, frame, event, function):
        code = frame.f_code
        is_ending = event == "call" and code.co_name in ENDINGS
        if event not in ("call", "c_return") or is_ending or not self.is_in_kbstore(frame):
            return
        self.left -= 1
        if self.left < 0:
            sys.setprofile(None)
            self.moment = f"{code.co_qualname}:{frame.f_lineno} {event} {getattr(function, '__name__', '')}"
            raise KeyboardInterrupt

    @staticmethod
    def is_in_kbstore(frame):
        caller = frame.f_back if frame.f_code.co_filename == contextlib.__file__ else frame
        return caller.f_code.co_filename.startswith(ROOT)


@pytest.fixture
def no_collection():
    """Disable the garbage collector, whose calls would swallow the interrupt."""
    gc.disable()
    yield
    gc.enable()


CALLS = {
    "a fact": lambda kb: kb.holds("(open hall)"),
    "a condition": lambda kb: kb.holds("(and (open hall) (not (lit den)))"),
    "a change": lambda kb: kb.add("(open den)"),
}


@pytest.fixture(params=["memory", "file", "postgresql"])
def opened(request, tmp_path, name):
    """A knowledge base, and a second one on the same store where that is possible."""
    if request.param == "memory":
        place = "sqlite://"
    elif request.param == "postgresql":
        # an interrupt just before a connection is returned keeps it from the pool
        place = f"{request.getfixturevalue('postgresql_url')}&pool_size=100"
    else:
        place = f"sqlite:///{tmp_path / 'store.db'}"
    with kbstore.open(place, name, busy_timeout=0.5, durability="normal") as kb:
        kb.add("(open hall)")
        if request.param == "memory":
            yield kb, kb
        else:
            with kbstore.open(place, name, busy_timeout=0.5, durability="normal") as other:
                yield kb, other


@pytest.mark.parametrize("call", CALLS.values(), ids=CALLS)
def test_an_interrupt_leaves_nothing_open(opened, call, no_collection):
    """No transaction and no lock, at any point; the thread works while the interrupt is still being handled."""
    kb, other = opened
    interrupted = 0
    for n in itertools.count():
        interrupt = Interrupt(n)
        try:
            sys.setprofile(interrupt)
            call(kb)
        except (KeyboardInterrupt, StoreUnavailable):
            # psycopg may raise an error of its own for an interrupt
            interrupted += 1
            works_on(kb, other, interrupt.moment)
        finally:
            sys.setprofile(None)
        if interrupt.moment is None:
            break
    assert interrupted > 8


def works_on(kb, other, moment):
    """Check that this thread, and another, read and write as they should."""
    found = []

    def ask():
        found.append(other.holds("(open hall)"))
        other.add("(lit den)")

    thread = threading.Thread(target=ask)
    thread.start()
    thread.join()
    assert found == [True], moment
    assert kb.holds("(lit den)"), moment
    assert kb.remove("(lit den)", "(open den)").number > 1, moment
    assert {str(fact) for fact in kb.state().facts} == {"(open hall)"}, moment
    assert not other.holds("(lit den)"), moment
    assert not any(connection.uses for connection in kb._database._connections._open), moment


UPDATES = {
    "add": lambda tx: tx.add("(open den)", "lamp - thing", "(lit den)"),
    "remove": lambda tx: tx.remove("(open hall)", "hall"),
    "clear": lambda tx: tx.clear(),
    "start": lambda tx: tx.start("close", "hall"),
}

DOMAIN = """
(define (domain rooms)
  (:requirements :typing :durative-actions)
  (:types thing)
  (:constants den - object)
  (:predicates (open ?x) (lit ?x))
  (:durative-action close :parameters (?x) :duration (= ?duration 5) :condition (at start (open ?x))
    :effect (and (at start (not (open ?x))) (at start (lit ?x)))))
"""


@pytest.mark.parametrize("update", UPDATES.values(), ids=UPDATES)
def test_an_interrupt_that_is_caught_in_the_block_leaves_no_half_of_an_update(update, no_collection):
    """C1: the update is stored as a whole or not at all, whatever follows it in the transaction."""
    seen = set()
    for n in itertools.count():
        interrupt = Interrupt(n)
        with kbstore.open("sqlite://") as kb:
            kb.load(DOMAIN)
            kb.add("hall - thing", "(open hall)")
            with contextlib.suppress(kbstore.InvalidKnowledge), kb.transaction() as tx:
                try:
                    sys.setprofile(interrupt)
                    update(tx)
                except KeyboardInterrupt:
                    pass
                finally:
                    sys.setprofile(None)
                tx.add("(open den)")
            state = kb.state()
            content = (*state.instances, *state.facts, *(run.action for run in state.running))
            seen.add(tuple(sorted(map(str, content))))
        if interrupt.moment is None:
            break
    before = ("(open hall)", "hall - thing")
    assert before in seen
    # without the interrupt, or with one before or after the whole update
    assert len(seen - {before, ("(open den)", *before)}) == 1
