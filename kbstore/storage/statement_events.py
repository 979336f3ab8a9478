"""Shows kbstore's statements to the listeners of an engine, and to its `echo`.

kbstore runs statements on the driver's cursor, which takes 3 us where SQLAlchemy takes 44. They run through SQLAlchemy
only on an engine or connection that has listeners for cursors, or logs its statements.
"""

import logging
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any

import sqlalchemy as sa
from sqlalchemy.exc import DBAPIError

if TYPE_CHECKING:
    from kbstore.storage.connection import StoreConnection

_TRANSACTION = ("BEGIN", "COMMIT", "ROLLBACK")
"""Statements that go to the driver in any case, as SQLAlchemy has methods of its own for them."""


def is_observed(place: sa.Engine | sa.Connection) -> bool:
    """Return whether an engine, or a connection, has listeners or logging for its statements."""
    listeners: Any = place.dispatch
    return bool(
        listeners.before_cursor_execute
        or listeners.after_cursor_execute
        or place.engine.echo
        or logging.getLogger("sqlalchemy.engine").isEnabledFor(logging.INFO)
    )


def begin_quietly(connection: sa.Connection) -> None:
    """Have SQLAlchemy begin its transaction on a connection in autocommit, unseen by the engine's listeners.

    SQLAlchemy's page on SQLite recommends a listener that begins a transaction then, for writing perhaps; kbstore
    begins its own.
    """
    unheard: Any = connection
    listeners = unheard.dispatch
    # SQLAlchemy makes another one, without the engine's listeners
    del unheard.dispatch
    try:
        connection.begin()
    finally:
        unheard.dispatch = listeners


def show_own(connection: "StoreConnection", engine: sa.Engine) -> None:
    """Run the statements of a connection of kbstore's own through SQLAlchemy, if its engine is observed.

    Asked once for each connection, as a question takes little longer than asking.
    """
    if is_observed(engine):
        connection.handle = handle = sa.Connection(engine, connection.handle)
        begin_quietly(handle)
        connection.execute_on(ObservedDriver(handle))


class ObservedDriver:
    """Replaces a driver's connection for executing statements, which then run through SQLAlchemy."""

    def __init__(self, connection: sa.Connection) -> None:
        """`connection` is in a transaction of SQLAlchemy's, or would begin one with the first statement."""
        self._connection = connection
        self._driver: Any = connection.connection.driver_connection

    def execute(self, text: str, parameters: Any = None, **how: Any) -> Any:
        """Execute a statement, and return the driver's cursor."""
        if text.startswith(_TRANSACTION):
            return self._driver.execute(text, **how)
        return self._run(text, _row(parameters) if parameters else None)

    def cursor(self, **how: Any) -> Any:
        """Return a cursor for `executemany`; with options, a server-side one of the driver's."""
        return self._driver.cursor(**how) if how else self

    def executemany(self, text: str, rows: Sequence[Any]) -> None:
        """Execute a statement once for each set of parameters."""
        self._run(text, [_row(row) for row in rows])

    def _run(self, text: str, parameters: Any) -> Any:
        try:
            result = self._connection.exec_driver_sql(text, parameters)
        except DBAPIError as error:
            raise error.orig or error from error
        return result.cursor if result.returns_rows else _Done(result.rowcount)


def _row(parameters: Any) -> Any:
    """Return the parameters of one row as SQLAlchemy takes them: by name, or in a tuple."""
    return parameters if isinstance(parameters, dict) else tuple(parameters)


class _Done:
    """The result of a statement without rows."""

    def __init__(self, rowcount: int) -> None:
        self.rowcount = rowcount

    def fetchone(self) -> None:
        """Return None: there is no row."""

    def fetchall(self) -> list[Any]:
        """Return no rows."""
        return []

    def __iter__(self) -> Iterator[Any]:
        return iter(())
