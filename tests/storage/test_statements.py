"""Statements are written once, and translated for both engines."""

from kbstore.storage.statements import Insertion, Lookup, Statement


def test_named_parameters():
    """SQLite takes parameters as they are written, psycopg as %(name)s; a cast with :: is none."""
    statement = Statement("SELECT a FROM t WHERE b = :b AND c < :c2 AND d = '1'::text AND e = :b")
    assert statement.sqlite == "SELECT a FROM t WHERE b = :b AND c < :c2 AND d = '1'::text AND e = :b"
    assert statement.postgresql == "SELECT a FROM t WHERE b = %(b)s AND c < %(c2)s AND d = '1'::text AND e = %(b)s"


def test_each_is_a_table_of_the_values_of_an_array():
    """EACH is json_each on SQLite and unnest on PostgreSQL, each with the column `value`."""
    statement = Statement("SELECT value FROM EACH(names AS text)")
    assert statement.sqlite == "SELECT value FROM json_each(:names)"
    assert statement.postgresql == "SELECT value FROM unnest(CAST(%(names)s AS text[])) AS each_row(value)"


def test_among_is_no_join():
    """AMONG is an IN on SQLite and = ANY on PostgreSQL, also of a column with its table's name."""
    statement = Statement("SELECT 1 FROM t WHERE AMONG(t.node, path)")
    assert statement.sqlite == "SELECT 1 FROM t WHERE t.node IN (SELECT value FROM json_each(:path))"
    assert statement.postgresql == "SELECT 1 FROM t WHERE t.node = ANY(CAST(%(path)s AS bigint[]))"


def test_what_only_one_engine_has():
    """SQLite has one write lock and no FOR UPDATE; it can be told which index to take."""
    statement = Statement("SELECT 1 FROM t BY(ix_t_a) WHERE a = :a FOR UPDATE")
    assert statement.sqlite == "SELECT 1 FROM t INDEXED BY ix_t_a WHERE a = :a"
    assert statement.postgresql == "SELECT 1 FROM t WHERE a = %(a)s FOR UPDATE"


def test_other_words_for_postgresql():
    """A second text, where there is one, is PostgreSQL's, and translated likewise."""
    statement = Statement("SELECT 1", "SELECT :two FROM EACH(ids AS bigint)")
    assert statement.sqlite == "SELECT 1"
    assert statement.postgresql == "SELECT %(two)s FROM unnest(CAST(%(ids)s AS bigint[])) AS each_row(value)"


def test_a_lookup_has_numbered_parameters():
    """A look-up's parameters are numbered in the order in which they are given, however often each occurs."""
    lookup = Lookup("SELECT a FROM t WHERE k = :kb AND t <= :t AND u = :kb", "kb", "t")
    assert lookup.sqlite == "SELECT a FROM t WHERE k = ?1 AND t <= ?2 AND u = ?1"
    assert lookup.postgresql == "SELECT a FROM t WHERE k = %(kb)s AND t <= %(t)s AND u = %(kb)s"


def test_an_insertion_takes_sequences():
    """Rows are given in the order of the columns."""
    insertion = Insertion("t", "a", "b")
    assert insertion.sqlite == "INSERT INTO t (a, b) VALUES (?, ?)"
    assert insertion.postgresql == "INSERT INTO t (a, b) VALUES (%s, %s)"
