"""A store can be distributed by its knowledge bases: every key has `kb_id`, and so has every access to a table.

Citus is not available here; PostgreSQL's own partitions replace its shards. With each table partitioned by a hash of
`kb_id`, the plan of every statement has to touch one partition of each table, and all keys have to be accepted.
"""

import re
from contextlib import contextmanager
from functools import cached_property

import psycopg
import pytest
import sqlalchemy as sa
from sqlalchemy.sql import visitors

from kbstore.storage import queries, tables
from kbstore.storage.assertion_queries import for_kind
from kbstore.storage.statements import BulkStatement, Statement
from kbstore.transfer import delta_queries
from kbstore.transfer import queries as transfer
from tests.conftest import fresh_schema
from tests.storage.test_plans import ARRAYS, KEYS, VALUES

PARTITIONS = 4

DIRECTORY = tables.knowledge_bases
"""On Citus a reference table: each node has all of it."""

DISTRIBUTED = [table for table in tables.metadata.sorted_tables if table is not DIRECTORY]

OWN = ("knowledge_base_names", "find_knowledge_base", "add_knowledge_base")
"""The statements about the directory."""


def statements():
    """All statements by name, without those about the directory, and those that are not about rows."""
    found = {}

    def collect(name, value):
        if isinstance(value, Statement):
            found[name] = value
        elif isinstance(value, tuple | list):
            for index, one in enumerate(value):
                collect(f"{name}[{index}]", one)
        elif isinstance(value, dict) and name.startswith("delta"):
            for key, one in value.items():
                collect(f"{name}[{key}]", one)
        elif isinstance(value, transfer.TableQueries):
            for one in ("read", "count", "add"):
                collect(f"{name}.{one}", getattr(value, one))

    for module in (queries, transfer):
        for name, value in vars(module).items():
            if not name.startswith("_"):
                collect(f"{module.__name__.split('.')[1]}.{name}", value)
    for name, value in vars(delta_queries).items():
        if not name.startswith("_"):
            collect(f"delta.{name}", value)
    for name, value in transfer.by_table.items():
        collect(f"transfer.{name}", value)
    for kind in for_kind.values():
        for name, value in vars(type(kind)).items():
            if isinstance(value, cached_property):
                collect(f"{kind.table}.{name}", getattr(kind, name))
    return {
        name: statement
        for name, statement in found.items()
        if not isinstance(construct(statement), sa.TextClause) and name.split(".")[-1] not in OWN
    }


def construct(statement, dialect="postgresql"):
    return statement.core(dialect)


ALL = statements()


def test_every_key_has_the_knowledge_base():
    """Primary keys, unique indexes and foreign keys contain `kb_id`, and indexes begin with it."""
    for table in DISTRIBUTED:
        assert "kb_id" in table.primary_key.columns, table.name
        assert not [found for found in table.constraints if isinstance(found, sa.UniqueConstraint)], table.name
        for index in table.indexes:
            assert next(iter(index.columns)).name == "kb_id", index.name
        for key in table.foreign_key_constraints:
            pairs = {(element.parent.name, element.column.name) for element in key.elements}
            assert pairs & {("kb_id", "kb_id"), ("kb_id", "id")}, key.name


def accesses(core):
    """The tables of a construct, and those whose `kb_id` it sets equal to the parameter or to another table's."""
    read, named = set(), set()
    for part in visitors.iterate(core):
        if isinstance(part, sa.Insert):
            # its own row names it
            named.add(part.table)
        if isinstance(part, sa.Table | sa.Alias) and "kb_id" in part.c:
            read.add(part)
        if isinstance(part, sa.BinaryExpression) and part.operator is sa.sql.operators.eq:
            for one, other in ((part.left, part.right), (part.right, part.left)):
                if getattr(one, "name", "") == "kb_id" and isinstance(other, sa.BindParameter) and other.key == "kb":
                    named.add(one.table)
    return read - {part.element for part in read if isinstance(part, sa.Alias)} - named


@pytest.mark.parametrize("name", ALL)
@pytest.mark.parametrize("dialect", ["sqlite", "postgresql"])
def test_every_access_names_the_knowledge_base(name, dialect):
    """For each table that a statement reads or writes, it has `kb_id = :kb`."""
    assert not accesses(construct(ALL[name], dialect))


def test_an_access_without_the_knowledge_base_is_found():
    """The test above can fail: a join on the number of a timeline alone is noticed."""
    facts, timelines = tables.facts, tables.timelines
    forgetful = sa.select(facts.c.seq).select_from(facts.join(timelines, timelines.c.id == facts.c.timeline_id))
    assert accesses(forgetful.where(facts.c.kb_id == sa.bindparam("kb"))) == {timelines}


@contextmanager
def connected(url):
    """A connection that commits each statement, of an engine of its own."""
    engine = sa.create_engine(url, isolation_level="AUTOCOMMIT")
    with engine.connect() as connection:
        yield connection
    engine.dispose()


@pytest.fixture(scope="module")
def partitioned(postgresql_url):
    """A connection of the driver to a schema in which each table has four partitions."""
    with fresh_schema(postgresql_url, "distributed") as url, connected(url) as connection:
        metadata = sa.MetaData()
        for table in tables.metadata.sorted_tables:
            copy = table.to_metadata(metadata)
            if table is not DIRECTORY:
                copy.dialect_options["postgresql"]["partition_by"] = "HASH (kb_id)"
        metadata.create_all(connection)
        for table in DISTRIBUTED:
            for remainder in range(PARTITIONS):
                connection.exec_driver_sql(
                    f"CREATE TABLE {table.name}_p{remainder} PARTITION OF {table.name}"
                    f" FOR VALUES WITH (MODULUS {PARTITIONS}, REMAINDER {remainder})"
                )
        yield connection.connection.driver_connection


def touched(driver, text, parameters=()):
    """The partitions of each table that a plan touches; a table that is written to is listed beside its partitions."""
    plan = driver.execute(f"EXPLAIN (FORMAT JSON) {text}", parameters).fetchone()[0]
    found = {}
    left = [plan]
    while left:
        node = left.pop()
        if isinstance(node, dict):
            table, found_partition, partition = node.get("Relation Name", "").rpartition("_p")
            if found_partition:
                found.setdefault(table, set()).add(partition)
            left += node.values()
        elif isinstance(node, list):
            left += node
    return found


def parameters_of(statement):
    """A value for each parameter of a statement with named ones."""
    others = {"timelines": 100, "gone": 10, "most": 10, "referred": [1], "history_from": 1}
    others |= {"open_runs": [1, 2]}
    values = VALUES | {name: list(value) for name, value in ARRAYS.items()} | others
    if "json_array_elements" in statement.postgresql:
        values |= {"keys": str(KEYS), "pairs": str(KEYS)}
    if statement in (queries.timelines_of_symbol,):
        values |= {"first": "p1", "last": "p1!"}
    names = set(re.findall(r"%\((\w+)\)s", statement.postgresql))
    return {name: values.get(name, 0) for name in names}


READING_OR_CHANGING = [name for name, found in ALL.items() if not found.postgresql.startswith("INSERT")]
"""Statements that insert rows, which go to one partition by their keys."""


@pytest.mark.parametrize("name", READING_OR_CHANGING)
def test_every_statement_touches_one_partition_of_each_table(partitioned, name):
    """The rows of one knowledge base are in one partition of each table."""
    statement = ALL[name]
    if isinstance(statement, BulkStatement):
        parameters = [VALUES["kb"] if column == "kb" else 1 for column in statement.columns]
    else:
        parameters = parameters_of(statement)
    found = touched(partitioned, statement.postgresql, parameters)
    assert found
    assert all(len(partitions) == 1 for partitions in found.values()), found


def test_a_statement_without_the_knowledge_base_touches_all_partitions(partitioned):
    """The test above can fail: the plan of a join without the knowledge base has all four partitions."""
    text = "SELECT * FROM facts f JOIN timelines t ON t.id = f.timeline_id WHERE f.kb_id = 2"
    found = touched(partitioned, text)
    assert len(found["facts"]) == 1
    assert len(found["timelines"]) == PARTITIONS


def test_keys_hold_across_partitions(partitioned):
    """A row without its timeline, and two rows that count at one time, are refused as in one table."""
    partitioned.execute("INSERT INTO knowledge_bases VALUES (7, 'seven', false)")
    partitioned.execute("INSERT INTO timelines VALUES (7, 0, 1, 1, 'p', NULL)")
    add = (
        "INSERT INTO facts (kb_id, seq, recorded_tx, timeline_id, initial_time, end_time, level, is_negative)"
        " VALUES (7, %s, 1, %s, 10, 20, 4, false)"
    )
    partitioned.execute(add, (0, 1))
    with pytest.raises(psycopg.errors.ForeignKeyViolation):
        partitioned.execute(add, (1, 2))
    with pytest.raises(psycopg.errors.UniqueViolation):
        partitioned.execute(add, (1, 1))
