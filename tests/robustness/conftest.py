"""Stores that several processes share."""

import itertools

import pytest
import sqlalchemy as sa

from kbstore.storage import schema

_names = itertools.count(1)


@pytest.fixture(params=["file", "postgresql"])
def shared_url(request, tmp_path):
    """The URL of a store that several processes can use at once."""
    if request.param == "file":
        return f"sqlite:///{tmp_path / 'shared.db'}"
    return str(request.getfixturevalue("postgresql_url"))


@pytest.fixture
def name():
    """A knowledge base's name that no other test uses."""
    return f"robust{next(_names)}"


@pytest.fixture
def path(tmp_path):
    """Where a store in a file is made."""
    return tmp_path / "store.db"


@pytest.fixture(params=["file", "postgresql"])
def untouched_url(request, tmp_path):
    """The URL of a database in which there is no store yet."""
    if request.param == "file":
        yield f"sqlite:///{tmp_path / 'untouched.db'}"
        return
    url, own = request.getfixturevalue("postgresql_url"), f"untouched{next(_names)}"
    engine = sa.create_engine(url, isolation_level="AUTOCOMMIT")
    with engine.connect() as connection:
        connection.exec_driver_sql(f"CREATE SCHEMA {own}")
    yield schema.in_schema(url, own).render_as_string(hide_password=False)
    with engine.connect() as connection:
        connection.exec_driver_sql(f"DROP SCHEMA {own} CASCADE")
    engine.dispose()
