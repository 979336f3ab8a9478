"""Empty databases of their own for tests of the schema: an SQLite file, and a schema on the PostgreSQL server."""

import itertools

import pytest
import sqlalchemy as sa

from tests.conftest import fresh_schema

_numbers = itertools.count(1)


@pytest.fixture
def sqlite_file(tmp_path):
    """The path of an SQLite file that does not exist yet."""
    return tmp_path / "store.db"


@pytest.fixture
def empty_schema(postgresql_url):
    """The URL of an empty schema on PostgreSQL."""
    with fresh_schema(postgresql_url, f"empty{next(_numbers)}") as url:
        yield url


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
