"""Statements are Core constructs, compiled once for each engine to what its driver takes."""

import pytest
import sqlalchemy as sa

from kbstore.storage.statements import (
    BulkStatement,
    Lookup,
    Statement,
    among,
    constant,
    each,
    each_pair,
    insert,
    parameter,
)

T = sa.Table(
    "t",
    sa.MetaData(),
    sa.Column("a", sa.Integer, primary_key=True, autoincrement=False),
    sa.Column("b", sa.BigInteger),
    sa.Column("c", sa.Text),
)


def texts(statement):
    """Both texts, without line breaks."""
    return [" ".join(text.split()) for text in (statement.sqlite, statement.postgresql)]


def test_named_parameters():
    """SQLite takes :name, psycopg %(name)s, with the type of the column."""
    statement = Statement(sa.select(T.c.a).where(T.c.b == parameter("b"), T.c.c < parameter("c")))
    assert texts(statement) == [
        "SELECT t.a FROM t WHERE t.b = :b AND t.c < :c",
        "SELECT t.a FROM t WHERE t.b = %(b)s::BIGINT AND t.c < %(c)s::VARCHAR",
    ]


def test_a_statement_is_compiled_once():
    """The text is made at first use, for the engine that uses it, and cached."""
    made = []
    statement = Statement(lambda dialect: made.append(dialect) or sa.select(T.c.a))
    assert [statement.sqlite is statement.sqlite, made] == [True, ["sqlite"]]
    assert [statement.postgresql is statement.postgresql, made] == [True, ["sqlite", "postgresql"]]
    with pytest.raises(AttributeError):
        _ = statement.oracle


def test_an_unknown_column_is_noticed():
    """A misspelt column fails when the statement is made, not when it runs."""
    with pytest.raises(AttributeError, match="nothing"):
        _ = T.c.nothing


def test_each_is_a_table_of_the_values_of_an_array():
    """It is json_each on SQLite and unnest on PostgreSQL, each with the values and their positions from 0 on."""

    def select(dialect):
        table, value, place = each(dialect, "ids")
        return sa.select(value, place).select_from(table)

    assert texts(Statement(select)) == [
        'SELECT value.value, value."key" FROM json_each(:ids) AS value',
        "SELECT value.value, value.ordinality - 1 AS anon_1"
        " FROM unnest(CAST(%(ids)s AS bigint[])) WITH ORDINALITY AS value",
    ]


def test_each_pair_is_a_table_of_two_columns():
    """Pairs are JSON on both engines."""

    def select(dialect):
        table, first, second = each_pair(dialect, "keys")
        return sa.select(first.label("one"), second.label("two")).select_from(table)

    sqlite, postgresql = texts(Statement(select))
    assert sqlite.startswith("SELECT json_extract(value.value, '$[0]') AS one, json_extract(value.value, '$[1]')")
    assert "json_array_elements(CAST(%(keys)s AS json)) AS value" in postgresql


def test_among_is_not_a_join():
    """It is an IN on SQLite and = ANY on PostgreSQL."""
    assert texts(Statement(sa.select(T.c.a).where(among(T.c.b, "path"), sa.not_(among(T.c.c, "keys", "text"))))) == [
        "SELECT t.a FROM t WHERE t.b IN (SELECT value FROM json_each(:path))"
        " AND NOT t.c IN (SELECT value FROM json_each(:keys))",
        "SELECT t.a FROM t WHERE t.b = ANY(CAST(%(path)s AS bigint[])) AND NOT t.c = ANY(CAST(%(keys)s AS text[]))",
    ]


def test_clauses_of_one_engine():
    """SQLite has no FOR UPDATE; it joins in the written order, by the named index."""
    other = T.alias("u")
    statement = Statement(
        sa.select(T.c.a)
        .select_from(T.join(other, T.c.b == other.c.a))
        .with_hint(T, "INDEXED BY ix", "sqlite")
        .limit(constant(1))
        .with_for_update()
    )
    assert texts(statement) == [
        "SELECT t.a FROM t INDEXED BY ix CROSS JOIN t AS u ON t.b = u.a LIMIT 1",
        "SELECT t.a FROM t JOIN t AS u ON t.b = u.a LIMIT 1 FOR UPDATE",
    ]


def test_a_lookup_has_parameters_in_their_order():
    """The parameters are given in the order in which they occur, each as often as it does."""
    found = sa.select(T.c.a).where(T.c.a == parameter("kb"), T.c.b <= parameter("t"), T.c.b != parameter("kb"))
    assert texts(Lookup(found, "kb", "t", "kb")) == [
        "SELECT t.a FROM t WHERE t.a = ? AND t.b <= ? AND t.b != ?",
        "SELECT t.a FROM t WHERE t.a = %(kb)s::INTEGER AND t.b <= %(t)s::BIGINT AND t.b != %(kb)s::BIGINT",
    ]
    with pytest.raises(AssertionError):
        _ = Lookup(found, "t", "kb", "kb").sqlite


def test_an_insert_batch_takes_sequences():
    """Rows are given in the order of the table's columns."""
    adding = BulkStatement.adding(T, "c", "a")
    assert adding.columns == ("a", "c")
    assert texts(adding) == [
        "INSERT INTO t (a, c) VALUES (?, ?)",
        "INSERT INTO t (a, c) VALUES (%s::INTEGER, %s::VARCHAR)",
    ]
    assert texts(BulkStatement.adding(T, ignoring=True))[0].endswith("VALUES (?, ?, ?) ON CONFLICT DO NOTHING")


def test_an_update_batch_takes_the_values_and_then_the_key():
    """The changed values come in the order of the table, and then the key of the row."""
    changing = BulkStatement.changing(T, "c", "b", key={"a": "row"})
    assert changing.columns == ("b", "c", "row")
    assert texts(changing) == [
        "UPDATE t SET b=?, c=? WHERE t.a = ?",
        "UPDATE t SET b=%s::BIGINT, c=%s::VARCHAR WHERE t.a = %s::INTEGER",
    ]


def test_rows_can_be_replaced_on_both_engines():
    """An ON CONFLICT clause is made for each engine."""

    def put(dialect):
        added = insert(dialect, T).values(a=parameter("a"), c=parameter("c"))
        return added.on_conflict_do_update(index_elements=[T.c.a], set_={"c": added.excluded.c})

    assert all(text.endswith("ON CONFLICT (a) DO UPDATE SET c = excluded.c") for text in texts(Statement(put)))
