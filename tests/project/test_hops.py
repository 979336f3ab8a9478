"""The way from a call to SQL is short: a profile of the call counts the modules that it passes."""

import os
import sys

import pytest

import kbstore

ROOT = os.path.dirname(kbstore.__file__)
DOMAIN = "(define (domain d) (:types waypoint) (:predicates (visited ?w - waypoint)))"

LONGEST = 7
"""How many modules a call may pass on its way to SQL."""


def modules_to_sql(call):
    """The modules on the call stack whenever the driver executes a statement.

    What is called and has answered by then, such as a reader of PDDL text or a clock, is not on the way.
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


@pytest.fixture
def kb():
    with kbstore.open("sqlite://", "hops") as kb:
        kb.load(DOMAIN)
        kb.add("wp7 - waypoint", "wp8 - waypoint", "(visited wp8)")
        yield kb


def test_add_passes_few_modules_on_its_way_to_sql(kb):
    """From the call to SQL, `add` enters at most seven modules."""
    passed = modules_to_sql(lambda: kb.add("(visited wp7)"))
    assert {"knowledge_base", "storage.connection"} < passed
    assert len(passed) <= LONGEST, sorted(passed)
