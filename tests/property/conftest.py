"""A longer time-out: a random story takes a minute on PostgreSQL, and more where several workers share two cores."""

from pathlib import Path

import pytest

TIMEOUT = 600
"""Seconds."""


def pytest_collection_modifyitems(items):
    """Give the tests of this directory more time before they count as hanging."""
    for item in items:
        if item.path.is_relative_to(Path(__file__).parent):
            item.add_marker(pytest.mark.timeout(TIMEOUT))
