"""One archive for many tests: a file has the history of many knowledge bases, and is slow to create."""

import pytest


@pytest.fixture(scope="session")
def archive_path(tmp_path_factory):
    """The path of an archive."""
    return tmp_path_factory.mktemp("archives") / "archive.db"
