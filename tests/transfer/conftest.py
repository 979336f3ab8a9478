"""One archive for many tests: a file holds the history of many knowledge bases, and takes time to make."""

import pytest


@pytest.fixture(scope="session")
def archive_path(tmp_path_factory):
    """The path of an archive."""
    return tmp_path_factory.mktemp("archives") / "archive.db"
