"""Lets kbstore write inside a transaction of the caller's, within a savepoint on its SQLAlchemy connection."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import sqlalchemy as sa

from kbstore.errors import StoreUnavailable
from kbstore.storage.connection import Options, StoreConnection
from kbstore.storage.driver_errors import sqlite_code
from kbstore.storage.postgresql_connection import PostgresqlConnection
from kbstore.storage.server_engine import lend, take_back
from kbstore.storage.sqlite_connection import SqliteConnection
from kbstore.storage.statement_events import ObservedDriver, is_observed

_LOCK = "UPDATE knowledge_bases SET name = name WHERE false"
"""Takes SQLite's write lock, and changes nothing."""


@contextmanager
def savepoint(connection: sa.Connection, options: Options, database: object) -> Iterator[StoreConnection]:
    """Use the caller's connection as a `StoreConnection`, which does not end the caller's transaction.

    An exception rolls back to a savepoint. `database` is the database that the connection has to be to; None skips the
    check. Raises `StoreUnavailable` if the caller has no transaction in which kbstore can write.
    """
    driver: Any = connection.connection.driver_connection
    is_sqlite = connection.dialect.name == "sqlite"
    found = _sqlite(driver, options) if is_sqlite else _postgresql(connection, driver, options)
    if is_observed(connection):
        found.execute_on(ObservedDriver(connection))
    if database is not None and found.database() != database:
        raise StoreUnavailable(
            f"the connection is to another database than {options.store}; give one of an engine on that, or open "
            "the knowledge base with the connection's engine"
        )
    lent = not found.is_local and lend(connection, None)
    try:
        with connection.begin_nested():
            found.in_transaction = True
            yield found
    finally:
        if lent:
            take_back(driver)


def _sqlite(driver: Any, options: Options) -> SqliteConnection:
    how = (
        "begin it for writing: connection.exec_driver_sql('BEGIN IMMEDIATE') before anything else is done on the "
        "connection, or on each 'begin' of the engine (see SQLAlchemy's page on SQLite and transactions)"
    )
    if not driver.in_transaction:
        raise StoreUnavailable(
            f"{options.store}: the connection has no transaction under way in SQLite, which sees none before the "
            f"first change; {how}"
        )
    found = SqliteConnection(driver, options)
    try:
        driver.execute(_LOCK)
    except driver.Error as error:
        # SQLite refuses the lock to a transaction whose snapshot is not the latest any more
        raise StoreUnavailable(
            f"{options.store}: the connection's transaction cannot write ({error}, {sqlite_code(error)}); {how}"
        ) from error
    return found


def _postgresql(connection: sa.Connection, driver: Any, options: Options) -> PostgresqlConnection:
    if driver.autocommit:
        raise StoreUnavailable(
            f"{options.store}: the connection is in autocommit, where there is no transaction to write in; give one "
            "of an engine, or with execution_options, without isolation_level='AUTOCOMMIT'"
        )
    isolation = connection.exec_driver_sql("SHOW transaction_isolation").scalar_one()
    if isolation != "read committed":
        raise StoreUnavailable(
            f"{options.store}: the connection's transaction is {isolation}, in which a knowledge base cannot wait for "
            "others and see what they wrote; give one with isolation_level='READ COMMITTED'"
        )
    return PostgresqlConnection(driver, options, connection.dialect.loaded_dbapi.Error, borrowed=True)
