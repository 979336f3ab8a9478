"""Empty databases of their own for tests of the schema: an SQLite file, and a schema on the PostgreSQL server."""

import itertools

import pytest
import sqlalchemy as sa

from kbstore.storage import schema

_numbers = itertools.count(1)


@pytest.fixture
def sqlite_file(tmp_path):
    """The path of an SQLite file that does not exist yet."""
    return tmp_path / "store.db"


@pytest.fixture
def empty_schema(postgresql_url):
    """The URL of an empty schema on PostgreSQL."""
    name = f"empty{next(_numbers)}"
    engine = sa.create_engine(postgresql_url, isolation_level="AUTOCOMMIT")
    with engine.connect() as connection:
        connection.exec_driver_sql(f"CREATE SCHEMA {name}")
    yield schema.in_schema(postgresql_url, name).render_as_string(hide_password=False)
    with engine.connect() as connection:
        connection.exec_driver_sql(f"DROP SCHEMA {name} CASCADE")
    engine.dispose()


@pytest.fixture(params=["sqlite", "postgresql"])
def empty(request):
    """The URL of an empty database, on each engine."""
    if request.param == "sqlite":
        return f"sqlite:///{request.getfixturevalue('sqlite_file')}"
    return request.getfixturevalue("empty_schema")


@pytest.fixture
def engine(empty):
    """An engine on an empty database."""
    engine = sa.create_engine(empty)
    yield engine
    engine.dispose()
