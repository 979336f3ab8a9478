"""The roles of docs/operations.md, created by its own statements: each has its documented rights, and no others."""

import re

import psycopg
import pytest
import sqlalchemy as sa

import kbstore
from kbstore.storage import schema, tables
from tests.docs.blocks import ROOT, sql_under

ROLES = ("kbstore_owner", "kbstore_robot", "kbstore_service", "kbstore_analyst")


@pytest.fixture
def server(empty_database):
    """The URLs of a database, by role, on which the statements of the page have been run."""
    url = sa.make_url(empty_database)
    by_role = {role: url.set(username=role) for role in ROLES}
    before, after = sql_under(ROOT / "docs" / "operations.md", "Roles on PostgreSQL")
    with psycopg.connect(_driver(url), autocommit=True) as admin:
        for statements in (before, None, after):
            if statements is None:
                schema.upgrade(by_role["kbstore_owner"], schema="kbstore")
            else:
                admin.execute(statements)
        yield by_role
        for role in ROLES:
            admin.execute(f"DROP OWNED BY {role} CASCADE")
            admin.execute(f"DROP ROLE {role}")


def _driver(url):
    return url.set(drivername="postgresql").render_as_string(hide_password=False)


def test_each_role_has_its_rights(server):
    """A robot creates a knowledge base and writes, a service reads it, an analyst reads the views."""
    with kbstore.open(server["kbstore_robot"], "kenny", schema="kbstore") as kb:
        kb.add("hall - room", "(open hall)", client="kenny")
        kb.remove("(open hall)")
        kb.clear()
    with kbstore.open(server["kbstore_service"], "kenny", schema="kbstore", read_only=True) as kb:
        assert [str(found.item) for found in kb.history("(open ?)")] == ["(open hall)"]
    with psycopg.connect(_driver(server["kbstore_analyst"])) as connection:
        assert connection.execute("SELECT fact FROM kbstore.fact_history").fetchall() == [("(open hall)",)]
        for view in schema.VIEWS:
            connection.execute(f"SELECT * FROM kbstore.{view}")


def test_no_role_has_other_rights(server):
    """A service cannot write, an analyst cannot read tables, a robot cannot change the schema or its revision."""
    with (
        pytest.raises(kbstore.StoreUnavailable, match="permission denied"),
        kbstore.open(server["kbstore_service"], "kenny", schema="kbstore") as kb,
    ):
        kb.add("(open hall)")
    for role, statement in (
        ("kbstore_analyst", "SELECT * FROM kbstore.facts"),
        ("kbstore_analyst", "DELETE FROM kbstore.facts"),
        ("kbstore_robot", "DROP TABLE kbstore.facts"),
        ("kbstore_robot", "UPDATE kbstore.kbstore_alembic_version SET version_num = '0001'"),
        ("kbstore_robot", "CREATE TABLE kbstore.other (id integer)"),
    ):
        with (
            psycopg.connect(_driver(server[role])) as connection,
            pytest.raises(psycopg.errors.InsufficientPrivilege),
        ):
            connection.execute(statement)


def test_a_role_that_sees_some_rows_only(server):
    """Row security on a table would make answers wrong for its users, and is refused to them."""
    owner, robot = (server[role] for role in ("kbstore_owner", "kbstore_robot"))
    with kbstore.open(robot, "kenny", schema="kbstore") as kb:
        kb.add("(open hall)")
    with psycopg.connect(_driver(owner), autocommit=True) as connection:
        connection.execute("ALTER TABLE kbstore.facts ENABLE ROW LEVEL SECURITY")
    with pytest.raises(kbstore.SchemaUnknown, match="it has table facts of which this role sees some rows"):
        kbstore.open(robot, "kenny", schema="kbstore")
    with kbstore.open(owner, "kenny", schema="kbstore", read_only=True) as kb:
        assert kb.holds("(open hall)")


def test_every_table_is_distributed():
    """The statements for Citus name each table, distributed by the knowledge base, except the directory."""
    page = (ROOT / "docs" / "operations.md").read_text(encoding="utf-8")
    distributed = re.findall(r"create_distributed_table\('(\w+)', 'kb_id'", page)
    references = re.findall(r"create_reference_table\('(\w+)'\)", page)
    assert references == ["knowledge_bases"]
    assert sorted([*distributed, *references]) == sorted(tables.metadata.tables)
