"""The types that users see: mypy accepts what kbstore takes, and finds what it would refuse."""

import re
import subprocess
import sys

import pytest

from tests.project.conftest import ROOT

SNIPPET = """\
from datetime import UTC, datetime, timedelta
from typing import Any

import kbstore
from kbstore import ExprComposite, Fact, KnowledgeItem, aio, seconds


class Stamp:
    sec: int = 0
    nanosec: int = 0


def right(kb: kbstore.KnowledgeBase, message: Any, mapping: dict[str, object]) -> None:
    kb.add("(p)", Fact(attribute_name="p"), mapping, message, initial_time="+30s")
    kb.add(Fact(attribute_name="p", values=["a"]), Fact(attribute_name="p", values={"x": "a"}, is_negative=True))
    kb.add(kbstore.Function(attribute_name="f", values=[kbstore.KeyValue("x", "a")], function_value=3))
    kb.add(*kb.state().facts, initial_time=datetime.now(UTC))
    kb.holds(Fact(attribute_name="p"), at=Stamp(), as_of=kb.add("(p)"))
    kb.value(ExprComposite(), {"sec": 3, "nanosec": 0})
    kb.start("go", duration=timedelta(seconds=3))
    kb.start("go", duration=Stamp())
    kb.when("(p)", "-5m", "now")
    items: list[KnowledgeItem] = [kbstore.item("(p)")]
    kb.query(*items)
    names: list[str] = [formula.name for formula in kb.domain.predicates]
    operator: kbstore.DomainOperator = kb.domain.operators["go"]
    times: list[kbstore.TimeLike] = [1, "now", datetime.now(UTC), Stamp()]
    durations: list[kbstore.DurationLike] = [1, timedelta(0), Stamp()]
    asked: list[kbstore.Question] = ["(p)", items[0], mapping]
    added: list[kbstore.Knowledge] = ["(p)", items[0], mapping]


def wrong(kb: kbstore.KnowledgeBase, tx: kbstore.OpenTransaction, state: kbstore.State) -> None:
    kb.add(42)  # wrong
    Fact(attribute_name="p", values=[3])  # wrong
    Fact(name="p")  # wrong
    kb.remove(None)  # wrong
    kb.add_goal(3.5)  # wrong
    kb.holds("(p)", 3.5)  # wrong
    kb.holds(b"(p)")  # wrong
    kb.truth("(p)", at=timedelta(0))  # wrong
    kb.value("(f)", as_of=1.5)  # wrong
    kb.state(object())  # wrong
    kb.start("go", duration=3.5)  # wrong
    kb.start("go", duration="3")  # wrong
    kb.history(3)  # wrong
    kb.when("(p)", None, None)  # wrong
    kb.diff(1.0, 2)  # wrong
    tx.add(42)  # wrong
    tx.remove("(p)", initial_time=2.5)  # wrong
    state.holds(42)  # wrong
    kbstore.time(2.5)  # wrong
    kbstore.item(42)  # wrong
    kbstore.ManualClock(2.5)  # wrong
    state.domain.predicates  # wrong


async def awaited(kb: aio.KnowledgeBase) -> None:
    async with aio.open("kenny.db", "kenny", read_only=True) as other:
        facts: list[Fact] = (await other.state(at="-5m")).facts
    text: str = await kb.to_pddl()
    strict: kbstore.StrictPddl = await kb.to_pddl(strict_names=True)
    added: kbstore.Transaction = await kb.add("(p)", initial_time="+30s")
    async for change in kb.watch("(p)", after=added.number):
        number: int = change.number
    async with kb.transaction(client="me") as tx:
        await tx.add("(p)")
        holds: bool = await tx.holds("(p)")
    domain: kbstore.Domain = await kb.domain
    await kb.add(42)  # wrong
    await kb.holds("(p)", 3.5)  # wrong
    await tx.remove("(p)", initial_time=2.5)  # wrong
    kb.add("(p)").number  # wrong
    aio.open("kenny.db", nme="kenny")  # wrong
"""


@pytest.mark.timeout(300)
def test_mypy_finds_what_would_be_refused(tmp_path):
    """A strict check of a user's module: no error where kbstore takes it, one in each line where it does not."""
    path = tmp_path / "user.py"
    path.write_text(SNIPPET, encoding="utf-8")
    command = [sys.executable, "-m", "mypy", "--strict", "--no-error-summary", "--config-file=", str(path)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    found = {int(line) for line in re.findall(r"user\.py:(\d+): error", done.stdout)}
    lines = SNIPPET.splitlines()
    expected = {number for number, line in enumerate(lines, 1) if line.endswith("# wrong")}
    assert found == expected, done.stdout + done.stderr
