"""The views for users, compared with the answers of the knowledge base, after random transactions."""

import random

import pytest

from kbstore.clock import seconds
from tests.storage.test_invariants import play, reading, sequences

RUNS = """
(define (domain runs)
  (:predicates (never))
  (:durative-action beep :parameters () :duration (<= ?duration 7) :condition () :effect ())
  (:durative-action hum :parameters () :duration (>= ?duration 8) :condition () :effect ()))
"""

SAME = "recorded_tx, ended_tx, cancelled_tx, superseded_tx, initial_ns, end_ns"


@pytest.fixture(params=range(8))
def world(request, open_kb, clock):
    """A knowledge base after random transactions, and a function that reads its views."""
    kb = open_kb()
    play(kb, clock, sequences(random.Random(request.param).choice))
    execute, _ = reading(kb)

    def view(name, *columns):
        return execute(f"SELECT {', '.join(columns)} FROM {name} WHERE knowledge_base = '{kb.name}'")

    return kb, view


def numbers(assertion):
    """The numbers that `SAME` names, as the knowledge base returns them."""
    transactions = (assertion.recorded, assertion.ended, assertion.cancelled, assertion.superseded)
    return (
        *(None if transaction is None else transaction.number for transaction in transactions),
        assertion.initial_time,
        assertion.end_time,
    )


def test_the_views_of_history_agree_with_history(world):
    """Q3: intervals, signs, values, and the transactions that recorded, ended or cancelled each assertion."""
    kb, view = world
    facts = [(str(found.item), *numbers(found)) for name in kb.domain.predicates for found in kb.history(pattern(name))]
    assert sorted(view("fact_history", "fact", SAME), key=repr) == sorted(facts, key=repr)
    functions = [
        (found.item.function_value, *numbers(found))
        for name in kb.domain.functions
        for found in kb.history(pattern(name))
    ]
    assert sorted(view("function_history", "value", SAME), key=repr) == sorted(functions, key=repr)
    objects = [
        (found.item.instance_name, found.item.instance_type, found.item.is_negative, *numbers(found))
        for found in kb.history({"knowledge_type": 0, "instance_name": "?"})
    ]
    shown = [(*row[:2], bool(row[2]), *row[3:]) for row in view("instance_history", "name, type, is_negative", SAME)]
    assert sorted(shown, key=repr) == sorted(objects, key=repr)


def test_everything_is_cleared_at_the_scheduled_end_of_an_object(bare, clock):
    """C12: the transaction that scheduled the end ended the facts about the object; one that was cancelled did not."""
    bare.add("wp0 - place", "wp1 - place", "(open wp0)", "(open wp1)")
    end = clock.now() + seconds(5)
    scheduled = bare.add("(not (wp0 - place))", "(not (wp1 - place))", initial_time=end)
    bare.remove("(not (wp1 - place))", initial_time=end)
    clock.set(end)
    cleared = bare.clear()
    execute, _ = reading(bare)
    rows = execute(
        f"SELECT fact, ended_tx, end_ns, ended_by FROM fact_history WHERE knowledge_base = '{bare.name}' ORDER BY fact"
    )
    assert rows == [
        ("(open wp0)", scheduled.number, end, "object"),
        ("(open wp1)", cleared.number, end, "cleared"),
    ]
    assert [(str(found.item), found.ended.number, found.end_time) for found in bare.history("(open ?)")] == [
        row[:3] for row in rows
    ]


def test_the_view_of_runs_agrees_with_runs(open_kb, clock):
    """Q8: `run_history` has each run with its times, outcome, forced conditions, and transactions."""
    kb = open_kb()
    kb.load(RUNS)
    for name, client in (("beep", "first"), ("hum", "second"), ("beep", "third")):
        clock.advance(seconds(10))
        run = kb.start(name, duration=seconds(7), client=client, force=True)
        clock.advance(seconds(1))
        if client == "first":
            kb.end(run, client="ender")
        elif client == "second":
            kb.abort(run)
    execute, _ = reading(kb)
    rows = execute(
        "SELECT action, operator, arguments, outcome, duration_s, forced, started_tx, started_client, ended_tx,"
        f" ended_client, started_ns, expected_end_ns, ended_ns FROM run_history WHERE knowledge_base = '{kb.name}'"
        " ORDER BY started_tx"
    )
    clients = {change.number: change.transaction.client or "" for change in kb.changes()}
    assert [(*row[:9], row[9] or "", *row[10:]) for row in rows] == [
        (
            f"({run.operator})",
            run.operator,
            "",
            run.outcome,
            run.seconds,
            "\n".join(run.forced) or None,
            run.started_by,
            clients[run.started_by],
            run.ended_by,
            "" if run.ended_by is None else clients[run.ended_by],
            run.started,
            run.expected_end,
            run.ended,
        )
        for run in kb.runs()
    ]
    assert [row[3] for row in rows] == ["ended", "aborted", "running"]
    assert [row[7] for row in rows] == ["first", "second", "third"]


def pattern(formula):
    """Any fact or function of a symbol."""
    return f"({' '.join((formula.name, *('?' for _ in formula.typed_parameters)))})"


def test_the_views_of_the_present_show_the_latest_state(world):
    """The state at the time of the latest transaction, by the interval tree."""
    kb, view = world
    state = kb.state(at=max(change.time for change in kb.changes()))
    assert sorted(view("current_facts", "fact, initial_ns")) == sorted(
        (str(item), item.initial_time) for item in state.facts
    )
    assert sorted(view("current_instances", "name, type, initial_ns")) == sorted(
        (item.instance_name, item.instance_type, item.initial_time) for item in state.instances
    )
    assert sorted(view("current_goals", "goal")) == sorted((str(item),) for item in state.goals)
    shown = dict(view("current_functions", "function, value"))
    assert shown == pytest.approx({item.atom: item.function_value for item in state.functions}, rel=1e-12)


def test_derived_ends_name_the_transaction_that_caused_them(open_kb, clock):
    """A future end is by the next assertion, or by the end of an object."""
    kb = open_kb()
    kb.load("(define (domain d) (:types place) (:predicates (open ?p - place)))")
    kb.add("wp0 - place", "wp1 - place")
    number = kb.add("(open wp0)", "(open wp1)").number
    ending = kb.add("(not (wp0 - place))", initial_time=clock.now() + 10).number
    following = kb.add("(not (open wp1))", initial_time=clock.now() + 20).number
    execute, _ = reading(kb)
    columns = "fact, recorded_tx, ended_by, ended_tx"
    rows = execute(f"SELECT {columns} FROM fact_history WHERE knowledge_base = '{kb.name}' ORDER BY initial_ns, fact")
    assert rows == [
        ("(open wp0)", number, "object", ending),
        ("(open wp1)", number, "replaced", following),
        ("(not (open wp1))", following, None, None),
    ]
