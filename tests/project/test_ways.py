"""How many modules a question passes through on its way from the call to the store."""

import sys

import pytest

import kbstore
from tests.conftest import DOMAIN, OBJECTS, START

MOST = 7


def modules_on_the_way(call):
    """The modules of kbstore whose functions run from a call to its last statement, and those run in all."""
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
    with kbstore.open("sqlite://", clock=kbstore.ManualClock(START)) as kb:
        kb.load(DOMAIN)
        kb.add(*OBJECTS, "(open wp0)", "(= (battery kenny) 80)")
        yield kb


@pytest.mark.parametrize("ask", [lambda kb: kb.holds("(open wp0)"), lambda kb: kb.value("(battery kenny)")])
def test_a_question_passes_few_modules(kb, ask):
    """From the call to SQL: where the answer is remembered, and where somebody has written since."""
    ask(kb)
    ask(kb)
    _, remembered = modules_on_the_way(lambda: ask(kb))
    assert "kbstore.storage.repository" not in remembered
    assert len(remembered) <= MOST, sorted(remembered)
    kb.add("(open wp1)")
    read, _ = modules_on_the_way(lambda: ask(kb))
    assert "kbstore.storage.repository" in read
    assert len(read) <= MOST, sorted(read)


def test_a_question_about_the_past_passes_few_modules(kb):
    """The same for a time that is given."""
    kb.holds("(open wp0)", at=START)
    read, _ = modules_on_the_way(lambda: kb.holds("(open wp0)", at=START))
    assert "kbstore.storage.repository" in read
    assert len(read) <= MOST, sorted(read)
