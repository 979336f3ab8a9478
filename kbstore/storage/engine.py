"""Makes SQLAlchemy engines for the URLs of stores."""

import os
from pathlib import Path
from typing import Any

from sqlalchemy import Engine, create_engine
from sqlalchemy.engine import URL, make_url
from sqlalchemy.exc import ArgumentError, NoSuchModuleError
from sqlalchemy.pool import StaticPool

from kbstore.errors import StoreUnavailable
from kbstore.storage.server_engine import server_engine

BUSY_TIMEOUT = 30.0
"""Seconds to wait for a lock that others hold, by default."""


def make_engine(url: str | os.PathLike[str] | URL, *, busy_timeout: float = BUSY_TIMEOUT) -> Engine:
    """Return an engine for a SQLAlchemy URL, or for the path of an SQLite file.

    A `Database` has its own pools; the engine's pool only hands it the connection by which the schema of a file was
    checked, as SQLite takes 5 ms to read the schema on a new one. `kbstore.storage.server_engine` has kbstore's own
    parameters of a server's URL. Raises `StoreUnavailable` for a backend or driver that cannot be used.
    """
    parsed = parsed_url(url)
    refuse_others(parsed.get_backend_name())
    try:
        if parsed.get_backend_name() != "sqlite":
            return server_engine(parsed, busy_timeout)
        arguments = {"timeout": busy_timeout, "check_same_thread": False}
        in_memory = parsed.database in (None, "", ":memory:") or parsed.query.get("mode") == "memory"
        pool: dict[str, Any] = {"poolclass": StaticPool} if in_memory else {"pool_size": 1, "max_overflow": -1}
        return create_engine(parsed, connect_args=arguments, **pool)
    except NoSuchModuleError as error:
        raise StoreUnavailable(f"{parsed.drivername} is not a kind of database that is installed: {error}") from None
    except ModuleNotFoundError as error:
        raise StoreUnavailable(
            f"the driver {error.name} is not installed; for PostgreSQL: pip install 'kbstore[postgresql]'"
        ) from None


def parsed_url(url: str | os.PathLike[str] | URL) -> URL:
    """Return the URL of a store that is given as a URL, or as the path of an SQLite file."""
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
    return parsed.set(drivername="postgresql+psycopg") if parsed.drivername == "postgresql" else parsed


def refuse_schema(url: URL, schema: str | None) -> None:
    """Raise `StoreUnavailable` for a schema in a database that is not PostgreSQL."""
    if schema is not None and url.get_backend_name() != "postgresql":
        shown = url.render_as_string(hide_password=True)
        raise StoreUnavailable(f"schemas are PostgreSQL's; {shown} can't have the schema {schema!r}")


def schema_of(url: URL, schema: str | None) -> str | None:
    """Return the PostgreSQL schema of a store: the one that is given, or else that of its URL (``?schema=...``)."""
    named = url.query.get("schema")
    if schema is None and named is not None:
        schema = named if isinstance(named, str) else named[-1]
    refuse_schema(url, schema)
    return schema


def refuse_others(backend: str) -> None:
    """Raise `StoreUnavailable` for a backend that kbstore has no SQL for."""
    if backend not in ("sqlite", "postgresql"):
        raise StoreUnavailable(f"kbstore keeps its store in SQLite or PostgreSQL, not in {backend}")
