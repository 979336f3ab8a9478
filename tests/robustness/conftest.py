"""Stores that several processes share."""

import itertools

import pytest

from tests.conftest import fresh_schema

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
    with fresh_schema(request.getfixturevalue("postgresql_url"), f"untouched{next(_names)}") as url:
        yield url
