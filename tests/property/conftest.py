"""How densely stores are compared with the reference."""

import pytest

from tests.property.test_model import EXAMPLES


@pytest.fixture
def every(store_url):
    """The step in which pairs of times are compared: each pair in memory, a third of them in a file and on a server.

    The stories are the same on each store, and so are the statements; what differs is their SQL. So a third of the
    times as of each moment, another third for the next moment, tries it on all that has been written.
    """
    return 1 if store_url == "sqlite://" or EXAMPLES else 3
