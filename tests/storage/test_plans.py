"""Every question reads by indexes only the rows that it needs: the plans of both engines.

SQLite is asked before and after ANALYZE, as its guesses without statistics differ. PostgreSQL keeps the plan of a
prepared statement, so one made for an empty table has to be right for a full one, too.
"""

import json
import re
from functools import cached_property
from itertools import pairwise

import pytest

from kbstore.messages import KnowledgeType
from kbstore.storage import queries
from kbstore.storage.assertion_queries import for_kind
from kbstore.storage.interval_tree import LEVELS, path, ranges, superseded
from kbstore.storage.statements import BulkStatement, Lookup, Statement
from kbstore.storage.whole_state import whole_state
from tests.storage.stores import KB, SPAN

T = SPAN // 2
TIMELINE = 5

VALUES = {
    "kb": KB,
    "t": T,
    "number": 500,
    "latest": 502,
    "after": 500,
    "upto": 502,
    "first": T,
    "last": T + SPAN // 1000,
    "end": T + SPAN // 1000,
    "since": T,
    "until": T + SPAN // 100,
    "timeline": TIMELINE,
    "name": "kb2",
    "key": "p1 o1",
    "first_key": "p1",
    "last_key": "p1!",
    "object": TIMELINE,
    "role": 0,
    "kind": 2,
    "time": T,
}
ARRAYS = {
    "numbers": [500, 501],
    "ids": [TIMELINE, TIMELINE + 4],
    "begins": ranges(T)[0],
    "ends": ranges(T)[1],
    "path": path(T),
    "levels": [*range(LEVELS), *map(superseded, range(LEVELS))],
    "keys": ["p1 o1", "p2 o9"],
}

KEYS = [[500, seq] for seq in (1_000_000, 1_000_001)]
"""The transaction and position of an assertion."""

WHOLE = ("knowledge_base_names", "symbols", "timelines_of_kind")
"""Questions whose answer is all rows."""


def questions(tables):
    """The statements that read, by name; those of assertions for each of some tables."""
    named = [(name, statement) for name, statement in vars(queries).items() if isinstance(statement, Statement)]
    for kind in for_kind.values():
        if kind.table in tables:
            named += [
                (f"{kind.table}.{name}", getattr(kind, name))
                for name, found in vars(type(kind)).items()
                if isinstance(found, cached_property)
            ]
    return {
        name: statement
        for name, statement in named
        if not isinstance(statement, BulkStatement) and statement.sqlite.lstrip().startswith(("SELECT", "WITH"))
    }


ALL = ("facts", "functions", "instances", "expressions", "inequalities")
READING = [name for name in questions(ALL) if name not in WHOLE]


def values_of(statement, as_array):
    """Values for all parameters; the same name has another meaning in some statements."""
    values = VALUES | {name: as_array(value) for name, value in ARRAYS.items()}
    if statement is queries.timelines_of_symbol:
        values |= {"first": "p1", "last": "p1!"}
    if "json_extract" in statement.sqlite:
        values["keys"] = json.dumps(KEYS)
        values["pairs"] = json.dumps([[TIMELINE, T], [TIMELINE + 4, T + 1]])
    return values


def sqlite_plan(driver, statement):
    values = values_of(statement, json.dumps)
    if isinstance(statement, Lookup):
        parameters = tuple(values[name] for name in statement.names)
    else:
        parameters = {name: values[name] for name in set(re.findall(r"(?<![:\w]):(\w+)", statement.sqlite))}
    return [step[3] for step in driver.execute(f"EXPLAIN QUERY PLAN {statement.sqlite}", parameters)]


def goes_through(step):
    """Whether a step of SQLite's plan reads a table, or all rows of a knowledge base in it."""
    scan = re.search(r"SCAN (?!span|found)", step) and "VIRTUAL TABLE" not in step and "CONSTANT ROW" not in step
    return scan or "(kb_id=?)" in step or "BLOOM" in step or "AUTOMATIC" in step


@pytest.fixture(scope="module", params=["guessed", "analysed", "analysed when it was young"])
def sqlite(request, long_sqlite):
    """The long history, before and after ANALYZE; and if that was while each table had fifty rows."""
    if request.param != "guessed":
        long_sqlite.execute("ANALYZE")
    if request.param == "analysed when it was young":
        for index, statistics in long_sqlite.execute("SELECT idx, stat FROM sqlite_stat1").fetchall():
            numbers = [int(number) for number in statistics.split()]
            young = " ".join(str(max(1, number * 50 // max(numbers))) for number in numbers)
            long_sqlite.execute("UPDATE sqlite_stat1 SET stat = ? WHERE idx = ?", (young, index))
        # the statistics are read again
        long_sqlite.execute("ANALYZE sqlite_schema")
    return long_sqlite


# runs that ended at one time are searched among all, which are few
@pytest.mark.parametrize("name", [name for name in READING if name != "running_as_of"])
def test_nothing_is_scanned_on_sqlite(sqlite, name):
    """No question scans a table, or all rows of a knowledge base, or puts a Bloom filter over a join."""
    plan = sqlite_plan(sqlite, questions(ALL)[name])
    assert [step for step in plan if step.startswith(("SEARCH", "SCAN"))]
    assert not [step for step in plan if goes_through(step)]


@pytest.mark.parametrize("table", ALL)
def test_the_two_branches_of_state_at_t_on_sqlite(sqlite, table):
    """The state at t is read from one range of starts or of ends on each level; open rows have a separate level."""
    statements = next(found for found in for_kind.values() if found.table == table)
    branches = [
        f"SEARCH {table} USING INDEX ix_{table}_begin (kb_id=? AND level=? AND initial_time>? AND initial_time<?)",
        f"SEARCH {table} USING INDEX ix_{table}_end (kb_id=? AND level=? AND end_time>? AND end_time<?)",
    ]
    plan = [step for step in sqlite_plan(sqlite, statements.holding) if step.startswith("SEARCH")]
    assert plan == branches
    as_of = [step for step in sqlite_plan(sqlite, statements.holding_as_of) if step.startswith("SEARCH")]
    assert as_of == branches * 2


def test_running_actions_are_read_from_the_tree_on_sqlite(sqlite):
    """The runs at t are read by the tree, too, however many earlier runs there are."""
    plan = [step for step in sqlite_plan(sqlite, queries.running) if step.startswith("SEARCH")]
    assert plan == [
        "SEARCH runs USING INDEX ix_runs_node (kb_id=? AND node=?)",
        "SEARCH runs USING INDEX ix_runs_open (kb_id=? AND initial_time<?)",
    ]


@pytest.mark.parametrize("table", ALL)
def test_a_timeline_is_read_by_one_lookup_on_sqlite(sqlite, table):
    """A question about one timeline searches one index for one row, and reads the row of the knowledge base."""
    statements = next(found for found in for_kind.values() if found.table == table)
    assert sqlite_plan(sqlite, statements.point) == [
        "SEARCH heads USING INTEGER PRIMARY KEY (rowid=?)",
        f"SEARCH {table} USING INDEX ux_{table}_timeline (kb_id=? AND timeline_id=? AND initial_time<?) LEFT-JOIN",
    ]


@pytest.mark.parametrize("table", ALL)
@pytest.mark.parametrize(
    ("name", "used"),
    [
        ("by_key", "{table} USING INDEX sqlite_autoindex_{table}_1 (kb_id=? AND recorded_tx=? AND seq=?)"),
        ("live", "{table} USING INDEX ux_{table}_timeline (kb_id=? AND timeline_id=? AND initial_time>?)"),
        ("next_start", "{table} USING INDEX ux_{table}_timeline (kb_id=? AND timeline_id=? AND initial_time>?)"),
    ],
)
def test_future_rows_are_found_by_their_index_on_sqlite(sqlite, table, name, used):
    """A writer reads the end of a timeline; a scheduled row is read by its key."""
    statements = next(found for found in for_kind.values() if found.table == table)
    plan = [step.replace("COVERING ", "") for step in sqlite_plan(sqlite, getattr(statements, name))]
    assert f"SEARCH {used.format(table=table)}" in plan


@pytest.mark.parametrize(
    ("name", "used"),
    [
        ("pending", "schedules USING INDEX ix_schedules_node (kb_id=? AND node=?)"),
        ("due", "schedules USING INDEX ix_schedules_initial_time (kb_id=? AND initial_time>? AND initial_time<?)"),
        ("ahead", "schedules USING INDEX ix_schedules_initial_time (kb_id=? AND initial_time>?)"),
        ("revised", "revisions USING PRIMARY KEY (kb_id=? AND tx>? AND tx<?)"),
    ],
)
def test_schedules_and_revisions_are_found_by_their_indexes_on_sqlite(sqlite, name, used):
    """Pending rows have a separate tree; due rows are found by time; revisions by their transactions."""
    assert f"SEARCH {used}" in sqlite_plan(sqlite, getattr(queries, name))


HISTORY_OF_ONE = (
    "SELECT * FROM {view} WHERE knowledge_base = 'kb2' AND timeline_key = '{key}'",
    "SELECT * FROM {view} WHERE knowledge_base = 'kb2' AND timeline_key >= '{key}' AND timeline_key < '{key}!'",
    "SELECT ended_by, count(*) FROM {view} WHERE knowledge_base = 'kb2' AND timeline_key = '{key}' GROUP BY 1",
)
"""Queries of the views of history: one timeline, those of a symbol, and an aggregate."""


@pytest.mark.parametrize("view", ["fact_history", "function_history", "instance_history"])
@pytest.mark.parametrize("question", HISTORY_OF_ONE)
def test_the_history_of_a_timeline_is_read_by_its_index_on_sqlite(sqlite, view, question):
    """A condition on `timeline_key` reads the timelines, and from there their rows; nothing is scanned."""
    plan = [step[3] for step in sqlite.execute(f"EXPLAIN QUERY PLAN {question.format(view=view, key='p1 o1')}")]
    table = f"{view.partition('_')[0]}s"
    for index in (f"ux_{table}_timeline", f"ix_{table}_retired"):
        assert f"SEARCH f USING INDEX {index} (kb_id=? AND timeline_id=?)" in plan
    assert [step for step in plan if step.startswith("SEARCH t USING INDEX ux_timelines_key (kb_id=? AND role=?")]
    # a subquery is gone through; it is that of one timeline
    assert not [step for step in plan if goes_through(step) and not re.fullmatch(r"SCAN (f|levels)", step)]
    assert "MATERIALIZE f" not in plan


# -- PostgreSQL -----------------------------------------------------------------------------------------------------

ON_LARGE_TABLES = [
    *(name for name in questions(["facts"]) if name.startswith("facts.")),
    *(f"{table}.{name}" for table in ALL for name in ("holding", "live", "by_key", "ended", "point")),
    *("pending", "pending_as_of", "due", "ahead", "revised"),
]


@pytest.mark.parametrize("name", dict.fromkeys(ON_LARGE_TABLES))
def test_large_tables_are_read_by_indexes_on_postgresql(long_postgresql, name):
    """No question scans a large table."""
    statement = questions(ALL)[name]
    values = values_of(statement, list)
    parameters = {name: values[name] for name in set(re.findall(r"%\((\w+)\)s", statement.postgresql))}
    plan = [row[0] for row in long_postgresql.execute(f"EXPLAIN {statement.postgresql}", parameters)]
    table = name.partition(".")[0]
    assert any("Index" in step for step in plan)
    assert not [step for step in plan if f"Seq Scan on {table}" in step]


@pytest.mark.parametrize("name", [name for name in READING if name != "running_as_of"])
def test_the_plan_for_an_empty_table_holds_when_it_is_full_on_postgresql(young_postgresql, name):
    """No statement planned while a table is empty scans all of a knowledge base later."""
    if young_postgresql.info.server_version < 160000:
        pytest.skip("plans for all values are shown by PostgreSQL 16 and later")
    statement = questions(ALL)[name].postgresql
    names = list(dict.fromkeys(re.findall(r"%\((\w+)\)s", statement)))
    numbered = re.sub(r"%\((\w+)\)s", lambda found: f"${names.index(found[1]) + 1}", statement)
    plan = [row[0] for row in young_postgresql.execute(f"EXPLAIN (GENERIC_PLAN, COSTS OFF) {numbered}".encode())]
    assert any("Scan" in step for step in plan)
    # the head of a knowledge base has no other key
    whole = [
        condition
        for scan, condition in pairwise(plan)
        if re.search(r"Index Cond: \(kb_id = \S+\)$", condition) and "using pk_heads on heads" not in scan
    ]
    assert not whole + [step for step in plan if "Seq Scan" in step]


def test_a_whole_state_is_read_by_indexes_on_postgresql(long_postgresql):
    """The one statement for a state reads the head by its key, and each table twice by the interval tree."""
    statement = whole_state(tuple(for_kind)).postgresql
    values = values_of(whole_state(tuple(for_kind)), list)
    parameters = {name: values[name] for name in set(re.findall(r"%\((\w+)\)s", statement))}
    plan = "\n".join(row[0] for row in long_postgresql.execute(f"EXPLAIN {statement}", parameters))
    assert all(f"ix_{table}_{index} on {table}" in plan for table in ALL for index in ("begin", "end"))
    assert not [table for table in ALL if f"Seq Scan on {table}" in plan]


@pytest.mark.parametrize("name", ["holding", "holding_as_of", "ended_since", "ended"])
def test_a_new_knowledge_base_is_read_by_indexes_beside_a_large_one_on_postgresql(long_postgresql, name):
    """A state is read by the interval tree also where PostgreSQL knows no row of the knowledge base yet."""
    statement = getattr(for_kind[KnowledgeType.FACT], name)
    values = values_of(statement, list) | {"kb": KB + 1000}
    parameters = {name: values[name] for name in set(re.findall(r"%\((\w+)\)s", statement.postgresql))}
    plan = [row[0] for row in long_postgresql.execute(f"EXPLAIN {statement.postgresql}", parameters)]
    used = {found[1] for step in plan if (found := re.search(r"using (\w+) on facts", step))}
    assert used <= {"ix_facts_begin", "ix_facts_end"}
    assert "ix_facts_end" in used


@pytest.mark.parametrize("question", HISTORY_OF_ONE)
def test_the_history_of_a_timeline_is_read_by_its_index_on_postgresql(long_postgresql, question):
    """The same on PostgreSQL."""
    text = question.format(view="fact_history", key="p1 o1")
    plan = [row[0] for row in long_postgresql.execute(f"EXPLAIN {text}")]
    assert any("ux_facts_timeline" in step for step in plan)
    assert not [step for step in plan if "Seq Scan on facts" in step]


@pytest.mark.parametrize("view", ["current_facts", "current_functions", "current_instances", "current_goals"])
def test_the_present_is_read_by_the_interval_tree_on_postgresql(long_postgresql, view):
    """The views of the present search an index once for each level, with any estimate of PostgreSQL's."""
    plan = [row[0] for row in long_postgresql.execute(f"EXPLAIN SELECT * FROM {view} WHERE knowledge_base = 'kb2'")]
    found = [
        condition for step, condition in pairwise(plan) if re.search(r"Index Scan (using|on) ix_\w+_(begin|end)", step)
    ]
    assert len(found) == (9 if view == "current_goals" else 3)
    assert all("(level = " in condition for condition in found)
    assert not [step for step in plan if re.search(rf"Seq Scan on ({'|'.join(ALL)})", step)]
