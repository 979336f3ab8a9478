"""Showing statements to those who look at an engine of the caller's: its listeners, and its `echo`.

kbstore runs statements on the driver's cursor, where SQLAlchemy would take 44 us for what takes 3 there. Only where
somebody looks, on an engine with listeners for cursors or with its logging on, do they run through SQLAlchemy.
"""

import logging
from collections.abc import Iterator, Sequence
from typing import Any

import sqlalchemy as sa
from sqlalchemy.exc import DBAPIError

_TRANSACTION = ("BEGIN", "COMMIT", "ROLLBACK")
"""Statements that go to the driver all the same: SQLAlchemy has calls of its own for them."""


def is_observed(engine: sa.Engine) -> bool:
    """Return whether somebody looks at the statements of an engine."""
    listeners: Any = engine.dispatch
    return bool(
        listeners.before_cursor_execute
        or listeners.after_cursor_execute
        or engine.echo
        or logging.getLogger("sqlalchemy.engine").isEnabledFor(logging.INFO)
    )


def begin_quietly(connection: sa.Connection) -> None:
    """Have SQLAlchemy begin on a connection in autocommit.

    A listener may begin a transaction of the database then, as SQLAlchemy's page on SQLite has it; kbstore begins its
    own.
    """
    connection.begin()
    driver: Any = connection.connection.driver_connection
    if connection.dialect.name == "sqlite" and driver.in_transaction:
        driver.execute("ROLLBACK")


class ObservedDriver:
    """Stands in the place of a driver's connection for executing statements."""

    def __init__(self, connection: sa.Connection) -> None:
        self._connection = connection
        self._driver: Any = connection.connection.driver_connection
        begin_quietly(connection)

    def execute(self, text: str, parameters: Any = None, **how: Any) -> Any:
        """Execute a statement; returns the driver's cursor."""
        if text.startswith(_TRANSACTION):
            return self._driver.execute(text, **how)
        try:
            result = self._connection.exec_driver_sql(text, parameters or None)
        except DBAPIError as error:
            raise error.orig or error from error
        return result.cursor if result.returns_rows else _Done(result.rowcount)

    def cursor(self, **how: Any) -> Any:
        """Return a cursor for `executemany`; the driver's own where it is a server-side one."""
        return self._driver.cursor(**how) if how else self

    def executemany(self, text: str, rows: Sequence[Any]) -> None:
        """Execute a statement once for each set of parameters."""
        self.execute(text, [row if isinstance(row, dict) else tuple(row) for row in rows])


class _Done:
    """The result of a statement without rows."""

    def __init__(self, rowcount: int) -> None:
        self.rowcount = rowcount

    def fetchone(self) -> None:
        """No row."""

    def fetchall(self) -> list[Any]:
        """No rows."""
        return []

    def __iter__(self) -> Iterator[Any]:
        return iter(())
