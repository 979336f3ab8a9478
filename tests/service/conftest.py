"""One database for the service and for kbstore: an SQLite file, and PostgreSQL."""

from pathlib import Path

import pytest
import sqlalchemy as sa
from alembic import command
from alembic.config import Config

import kbstore
from kbstore.clock import ManualClock, seconds

DOMAIN = """
(define (domain post)
  (:types parcel place robot)
  (:predicates (parcel_at ?p - parcel ?w - place) (robot_at ?r - robot ?w - place))
  (:functions (battery ?r - robot)))
"""


@pytest.fixture(params=["file", "postgresql"])
def engine(request, tmp_path):
    """The service's engine, on an empty database."""
    url = (
        f"sqlite:///{tmp_path / 'service.db'}" if request.param == "file" else request.getfixturevalue("empty_database")
    )
    made = sa.create_engine(url)
    yield made
    made.dispose()


def alembic(engine, run):
    """Run a command of Alembic in the service's environment."""
    config = Config()
    config.set_main_option("script_location", str(Path(__file__).parent / "migrations"))
    with engine.begin() as connection:
        config.attributes["connection"] = connection
        return run(config)


@pytest.fixture
def service(engine):
    """The engine, with the service's tables in the database."""
    alembic(engine, lambda config: command.upgrade(config, "head"))
    return engine


@pytest.fixture
def kb(service):
    """A knowledge base beside the service's tables, on the service's engine."""
    with kbstore.open(service, "post", clock=ManualClock(seconds(1000))) as opened:
        opened.load(DOMAIN)
        opened.add("p1 - parcel", "p2 - parcel", "hall - place", "attic - place", "kenny - robot")
        opened.add("(parcel_at p1 hall)", "(parcel_at p2 attic)", "(robot_at kenny hall)", "(= (battery kenny) 80)")
        yield opened
