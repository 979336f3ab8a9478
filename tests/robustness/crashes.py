"""A sequence of transactions with the known state after each, for processes that are killed in the middle."""

import os
import signal
import sqlite3
from contextlib import closing

import kbstore
from kbstore.clock import seconds
from tests.storage.invariants import violations

START = seconds(1000)
NAME = "crash"

DOMAIN = """
(define (domain crash)
  (:requirements :typing :fluents)
  (:types step)
  (:predicates (done ?s - step) (even) (due ?s - step) (alarm))
  (:functions (counter)))
"""
"""The domain, loaded by the first transaction; each later one is a step."""


def take_step(kb, clock, number):
    """Make the transaction of a number, from 2 on: it adds, replaces, schedules, cancels, and removes an object."""
    now = START + seconds(number)
    clock.set(now)
    with kb.transaction(client="runner", note=f"step {number}") as transaction:
        transaction.add(f"s{number} - step", f"(done s{number})", f"(= (counter) {number})")
        transaction.add("(even)" if number % 2 == 0 else "(not (even))")
        transaction.add(f"(due s{number})", initial_time=now + seconds(2.5))
        if number % 3 == 0:
            transaction.add("(alarm)", initial_time=now + seconds(10))
        elif number % 3 == 1:
            transaction.remove("(alarm)", initial_time=now + seconds(9))
        if number > 4:
            transaction.remove(f"s{number - 3}")
    assert transaction.result.number == number
    return transaction.result


def expected(number):
    """The state right after the transaction of a number, worked out by hand: objects, facts, timed knowledge.

    The objects of the last three steps exist. Each step schedules a fact for 2.5 s later, and removes it with its
    object after 3.
    """
    steps = range(max(2, number - 2), number + 1)
    facts = {f"(done s{step})" for step in steps}
    if number > 1:
        facts.add("(even)" if number % 2 == 0 else "(not (even))")
    scheduled = {f"(due s{step})" for step in steps} | ({"(alarm)"} if number % 3 == 0 else set())
    return {f"s{step} - step" for step in steps}, facts, scheduled


def run(url, diary, durability, until):
    """Take one step after another, recording each acknowledged number."""
    clock = kbstore.ManualClock(START)
    with kbstore.open(url, NAME, clock=clock, durability=durability) as kb, open(diary, "ab", buffering=0) as file:
        number = latest(kb)
        while number < until:
            number = (take_step(kb, clock, number + 1) if number else kb.load(DOMAIN)).number
            file.write(b"%d\n" % number)
        # nothing is closed properly
        os.kill(os.getpid(), signal.SIGKILL)


def latest(kb):
    """The number of the latest transaction."""
    return max((change.number for change in kb.changes()), default=0)


def noted(diary):
    """The last acknowledged number."""
    lines = diary.read_bytes().split(b"\n")[:-1]
    return int(lines[-1]) if lines else 0


def check(url, acknowledged, *, in_flight=1):
    """Check that the store has all acknowledged transactions, and the one in flight wholly or not at all.

    The store is sound, and works. Returns the number of its latest transaction, which is one made here.
    """
    if not url.startswith("postgresql"):
        with closing(sqlite3.connect(url.removeprefix("sqlite:///"))) as connection:
            assert connection.execute("PRAGMA integrity_check").fetchall() == [("ok",)]
            assert connection.execute("PRAGMA foreign_key_check").fetchall() == []
    clock = kbstore.ManualClock(START)
    with kbstore.open(url, NAME, clock=clock) as kb:
        number = latest(kb)
        assert acknowledged <= number <= acknowledged + in_flight
        assert [change.number for change in kb.changes()] == list(range(1, number + 1))
        if number:
            _compare(kb, number)
            last = take_step(kb, clock, number + 1).number
            _compare(kb, last)
        else:
            last = kb.load(DOMAIN).number
        with kb._database.connect() as session:

            def execute(sql):
                return session.driver.execute(sql).fetchall()

            assert violations(execute, execute(f"SELECT id FROM knowledge_bases WHERE name = '{NAME}'")[0][0]) == []
        return last


def _compare(kb, number):
    """Compare the state after a transaction, and after earlier ones, with the expected one."""
    for step in {number, max(1, number - 1), number // 2 or 1}:
        state = kb.state(at=START + seconds(step))
        found = (state.instances, state.facts, state.timed_knowledge)
        assert tuple({str(item) for item in items} for items in found) == expected(step)
        assert step == 1 or state.value("(counter)") == step
