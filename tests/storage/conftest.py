"""Stores with a long history, on both engines."""

from contextlib import contextmanager

import pytest

from kbstore.storage import schema
from kbstore.storage.engine import make_engine
from tests.conftest import fresh_schema
from tests.storage import stores

ROWS = dict.fromkeys(("functions", "instances", "expressions", "inequalities"), 2000) | {"facts": 8000}


@pytest.fixture(scope="module")
def long_sqlite(tmp_path_factory):
    """A connection of the driver to an SQLite file with a long history, without statistics."""
    engine = make_engine(tmp_path_factory.mktemp("plans") / "long.db")
    schema.ensure(engine, read_only=False)
    with engine.begin() as connection:
        stores.fill(connection, ROWS)
    with engine.connect() as connection:
        yield connection.connection.driver_connection


@pytest.fixture(scope="module")
def long_postgresql(postgresql_url):
    """A connection of the driver to a schema on PostgreSQL, with a long history that it has analysed."""
    with _schema(postgresql_url, "plans_long") as engine:
        with engine.begin() as connection:
            stores.fill(connection, ROWS)
        with engine.connect().execution_options(isolation_level="AUTOCOMMIT") as connection:
            connection.exec_driver_sql("ANALYZE")
            yield connection.connection.driver_connection


@pytest.fixture(scope="module")
def young_postgresql(postgresql_url):
    """A connection of the driver to an empty store on PostgreSQL, without statistics."""
    with (
        _schema(postgresql_url, "plans_young") as engine,
        engine.connect().execution_options(isolation_level="AUTOCOMMIT") as connection,
    ):
        yield connection.connection.driver_connection


@contextmanager
def _schema(url, name):
    """An engine on a store in a schema of its own in a PostgreSQL database, inside the block."""
    with fresh_schema(url, name) as place:
        engine = make_engine(place)
        schema.ensure(engine, read_only=False)
        yield engine
