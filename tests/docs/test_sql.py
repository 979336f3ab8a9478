"""Every statement of docs/sql.md, run on the demonstration's data on both engines, has the documented answer."""

import re

import pytest
import sqlalchemy as sa

from kbstore.cli.demo.mission import record
from kbstore.storage import schema
from tests.docs.blocks import ROOT, blocks

STATEMENTS = [block for block in blocks(ROOT / "docs" / "sql.md") if block.language == "sql"]
TITLES = [re.findall(r"^## (.*)$", block.before, re.MULTILINE)[-1] for block in STATEMENTS]


@pytest.fixture(scope="module", params=["sqlite", "postgresql"])
def connection(request, tmp_path_factory):
    """A plain connection to a store with the mission in it, on each engine."""
    if request.param == "sqlite":
        url = f"sqlite:///{tmp_path_factory.mktemp('sql') / 'kenny.db'}"
    else:
        server = request.getfixturevalue("postgresql_url")
        schema.upgrade(server, schema="sql_page")
        url = schema.in_schema(server, "sql_page")
    record(url).close()
    engine = sa.create_engine(url)
    with engine.connect() as connected:
        yield connected
    engine.dispose()


@pytest.mark.parametrize("statement", STATEMENTS, ids=TITLES)
def test_the_answer_is_on_the_page(connection, statement):
    """The table after each statement is its answer: columns, rows, order."""
    # psycopg reads a percent sign as the beginning of a parameter
    text = statement.text.replace("%", "%%") if _is_postgresql(connection) else statement.text
    result = connection.exec_driver_sql(text)
    headings, *rows = _table(statement.after)
    assert list(result.keys()) == headings
    assert [[_cell(value) for value in row] for row in result] == rows


def test_there_are_a_dozen_questions():
    """At least twelve, each under a title of its own."""
    assert len(STATEMENTS) >= 12
    assert len(set(TITLES)) == len(TITLES)


def test_every_view_is_described(connection):
    """The page names every view that the schema has."""
    page = (ROOT / "docs" / "sql.md").read_text(encoding="utf-8")
    schema_name = None if not _is_postgresql(connection) else "sql_page"
    views = sa.inspect(connection).get_view_names(schema=schema_name)
    assert views
    assert not [view for view in views if f"`{view}`" not in page]


def _is_postgresql(connection):
    return connection.dialect.name == "postgresql"


def _table(text):
    """The rows of the Markdown table that a text begins with, without the line below the headings."""
    lines = re.match(r"\s*((?:\|.*\|\n?)+)", text)[1].splitlines()
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in lines if not line.startswith("| ---")]


def _cell(value):
    if value is None:
        return ""
    return str(value) if isinstance(value, str) else f"{float(value):g}"
