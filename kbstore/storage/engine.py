"""SQLAlchemy engines for the stores that kbstore can be kept in."""

import os
from pathlib import Path

from sqlalchemy import Engine, create_engine
from sqlalchemy.engine import URL, make_url
from sqlalchemy.exc import ArgumentError, NoSuchModuleError
from sqlalchemy.pool import NullPool, StaticPool

from kbstore.errors import StoreUnavailable

BUSY_TIMEOUT = 30.0
"""Seconds to wait for a lock that others hold, unless told otherwise."""


def make_engine(url: str | os.PathLike[str] | URL, *, busy_timeout: float = BUSY_TIMEOUT) -> Engine:
    """An engine for a SQLAlchemy URL, or for the path of an SQLite file.

    It pools nothing: a `Database` keeps a connection for each thread, however many there are.
    """
    if isinstance(url, URL):
        parsed = url
    else:
        text = os.fspath(url)
        if text == ":memory:":
            text = "sqlite://"
        try:
            parsed = make_url(text) if "://" in text else URL.create("sqlite", database=str(Path(text)))
        except ArgumentError as error:
            raise StoreUnavailable(f"{text!r} is neither a database URL nor a path: {error}") from None
    refuse_others(parsed.get_backend_name())
    if parsed.drivername == "postgresql":
        parsed = parsed.set(drivername="postgresql+psycopg")
    try:
        if parsed.get_backend_name() != "sqlite":
            # a host that does not answer would be waited for as long as its network stack likes
            patience = {} if "connect_timeout" in parsed.query else {"connect_timeout": max(2, int(busy_timeout))}
            return create_engine(parsed, connect_args=patience, poolclass=NullPool)
        arguments = {"timeout": busy_timeout, "check_same_thread": False}
        in_memory = parsed.database in (None, "", ":memory:") or parsed.query.get("mode") == "memory"
        return create_engine(parsed, connect_args=arguments, poolclass=StaticPool if in_memory else NullPool)
    except NoSuchModuleError as error:
        raise StoreUnavailable(f"{parsed.drivername} is not a kind of database that is installed: {error}") from None
    except ModuleNotFoundError as error:
        raise StoreUnavailable(
            f"the driver {error.name} is not installed; for PostgreSQL: pip install 'kbstore[postgresql]'"
        ) from None


def refuse_others(backend: str) -> None:
    """Raise for a backend that kbstore has no SQL for."""
    if backend not in ("sqlite", "postgresql"):
        raise StoreUnavailable(f"kbstore keeps its store in SQLite or PostgreSQL, not in {backend}")
