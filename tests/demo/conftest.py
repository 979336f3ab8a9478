"""The mission of the demonstration, recorded once."""

import pytest

from kbstore.cli.demo.mission import record


@pytest.fixture(scope="session")
def kenny():
    """The knowledge base at the mission's end, in memory."""
    with record("sqlite://") as kb:
        yield kb
