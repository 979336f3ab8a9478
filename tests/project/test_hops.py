"""The way from a call to SQL is short: a profile of the call counts the modules that it enters."""

import os
import sys

import pytest

import kbstore

ROOT = os.path.dirname(kbstore.__file__)
DOMAIN = "(define (domain d) (:types waypoint) (:predicates (visited ?w - waypoint)) (:functions (battery)))"

LONGEST = 7
"""The number of modules that a call may enter on its way to SQL."""


def modules_to_sql(call):
    """The modules on the call stack whenever the driver executes a statement.

    Functions that have returned by then, such as a reader of PDDL text or a clock, are not on the way.
    """
    passed = set()

    def profile(frame, event, function):
        if event != "c_call" or getattr(function, "__name__", "") not in {"execute", "executemany"}:
            return
        while frame is not None:
            path = frame.f_code.co_filename
            if path.startswith(ROOT):
                passed.add(os.path.relpath(path, ROOT).removesuffix(".py").replace(os.sep, "."))
            frame = frame.f_back

    sys.setprofile(profile)
    try:
        call()
    finally:
        sys.setprofile(None)
    return passed


def modules_entered(call):
    """All modules whose functions run from a call to its last statement, and all that run in the whole of it."""
    entered, on_the_way = set(), set()

    def profile(frame, event, argument):
        if event == "call":
            entered.add(frame.f_globals.get("__name__", ""))
        elif event == "c_call" and argument.__name__ == "execute":
            on_the_way.update(entered)

    sys.setprofile(profile)
    try:
        call()
    finally:
        sys.setprofile(None)
    return tuple({name for name in names if name.startswith("kbstore")} for names in (on_the_way, entered))


@pytest.fixture
def kb():
    with kbstore.open("sqlite://", "hops") as kb:
        kb.load(DOMAIN)
        kb.add("wp7 - waypoint", "wp8 - waypoint", "(visited wp8)", "(= (battery) 80)")
        yield kb


def test_add_passes_few_modules_on_its_way_to_sql(kb):
    """From the call to SQL, `add` enters at most seven modules."""
    passed = modules_to_sql(lambda: kb.add("(visited wp7)"))
    assert {"knowledge_base", "storage.connection"} < passed
    assert len(passed) <= LONGEST, sorted(passed)


@pytest.mark.parametrize("ask", [lambda kb: kb.holds("(visited wp8)"), lambda kb: kb.value("(battery)")])
def test_a_question_passes_few_modules(kb, ask):
    """`holds` and `value`: with a cached answer, and after another transaction."""
    ask(kb)
    ask(kb)
    _, remembered = modules_entered(lambda: ask(kb))
    assert "kbstore.storage.repository" not in remembered
    assert len(remembered) <= LONGEST, sorted(remembered)
    kb.add("(visited wp7)")
    read, _ = modules_entered(lambda: ask(kb))
    assert "kbstore.storage.repository" in read
    assert len(read) <= LONGEST, sorted(read)


def test_a_question_about_the_past_passes_few_modules(kb):
    """The same with `at`."""
    past = kb.now()
    kb.holds("(visited wp8)", at=past)
    read, _ = modules_entered(lambda: kb.holds("(visited wp8)", at=past))
    assert "kbstore.storage.repository" in read
    assert len(read) <= LONGEST, sorted(read)
