"""A store: single statements, reads on one snapshot, and write transactions, for several threads and after a fork."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from types import TracebackType

import sqlalchemy as sa
from sqlalchemy import Engine
from sqlalchemy.engine import URL
from sqlalchemy.exc import DBAPIError
from sqlalchemy.exc import TimeoutError as PoolTimeout

from kbstore.errors import StoreUnavailable
from kbstore.storage.borrowing import savepoint
from kbstore.storage.connection import Options, Parameters, SqlRow, StoreConnection
from kbstore.storage.connections import ThreadConnections
from kbstore.storage.engine import BUSY_TIMEOUT, make_engine, parsed_url, refuse_others, schema_of
from kbstore.storage.pools import LentConnections, PooledConnections, ServerConnections, ServerPool
from kbstore.storage.schema import ensure
from kbstore.storage.server_engine import wants_notifications
from kbstore.storage.sqlite_connection import SqliteConnection
from kbstore.storage.statements import Statement


class Database:
    """A store.

    SQLite files that kbstore opens itself have a connection for each thread (`ThreadConnections`). On PostgreSQL, and
    on an engine of the caller's, one is checked out for each operation (`ServerConnections`, `LentConnections`).
    """

    def __init__(
        self,
        url: str | os.PathLike[str] | URL | Engine,
        *,
        durability: str = "full",
        read_only: bool = False,
        busy_timeout: float = BUSY_TIMEOUT,
        schema: str | None = None,
        notifications: bool = False,
    ) -> None:
        if durability not in ("full", "normal"):
            raise ValueError(f'durability is "full" or "normal", not {durability!r}')
        if not 0 <= busy_timeout <= 1_000_000:
            raise ValueError(f"busy_timeout is a number of seconds from 0 to a million, not {busy_timeout!r}")
        parsed = url.url if isinstance(url, Engine) else parsed_url(url)
        schema = schema_of(parsed, schema)
        shown = parsed.render_as_string(hide_password=True)
        self._options = Options(shown, busy_timeout, durability, read_only, schema)
        self._connections = _opened(url if isinstance(url, Engine) else parsed, self._options)
        if notifications and isinstance(self._connections, LentConnections) and parsed.get_backend_name() != "sqlite":
            raise StoreUnavailable(
                f"{shown}: notifications need a connection of their own, which kbstore does not take from an engine of "
                "yours; open the knowledge base by its URL"
            )
        self._notifies = notifications or wants_notifications(parsed)
        self.schema = schema
        self.engine = self._connections.engine
        self.dialect = self.engine.dialect.name
        self.errors = DBAPIError, PoolTimeout, self.engine.dialect.loaded_dbapi.Error
        self.is_local = self.can_cache = isinstance(self._connections, ThreadConnections)
        """Whether a question waits for no server; and whether connections can detect that nobody has committed."""
        self.checkout = self._connections.checkout
        self.checkin = self._connections.checkin
        self.close = self._connections.close
        self.failure = self._connections.failure

    def listen(self, kb: int) -> None:
        """Cache answers about a knowledge base on a server while it notifies, if notifications were asked for.

        Raises `StoreUnavailable` if the server cannot be listened to.
        """
        if self._notifies and isinstance(self._connections, ServerConnections):
            self._connections.subscribe(kb)
            self.can_cache = True

    def forget_answers(self) -> None:
        """Forget the answers cached by notifications, as the store has gone back."""
        if isinstance(self._connections, ServerConnections):
            self._connections.forget_answers()

    def ensure_schema(self, *, read_only: bool) -> None:
        """Set up an empty store, and refuse one whose schema this kbstore does not read (see `schema.ensure`)."""
        # what is connected to a file meanwhile is kept for the thread, and a fork waits for it
        with self.wrap_errors(), self._connections.opening:
            ensure(self.engine, read_only=read_only, schema=self.schema)

    def connect(self) -> "_Checkout":
        """Return a context manager of a connection for single statements, each on the latest commit."""
        return _Checkout(self)

    def first(self, statement: Statement, parameters: Parameters) -> SqlRow | None:
        """Return the first row of one statement on its own; None if there is none."""
        with self.connect() as connection:
            return connection.first(statement, parameters)

    def read(self) -> "_ReadSnapshot":
        """Return a context manager of a connection on one snapshot; in a transaction of this thread, on that."""
        return _ReadSnapshot(self)

    def begin(self) -> "_Transaction":
        """Return a context manager of a connection in a write transaction, committed at its end.

        An exception rolls back.
        """
        return _Transaction(self)

    def refuse_moved(self, connection: StoreConnection) -> None:
        """Raise `StoreUnavailable` if a file is not at its path any more, where writes would be lost."""
        if isinstance(connection, SqliteConnection) and connection.has_moved():
            raise self._connections.moved()

    @contextmanager
    def savepoint(self, borrowed: sa.Connection) -> Iterator[StoreConnection]:
        """Use a connection of the caller's, in whose transaction a savepoint is; an exception rolls back to it."""
        if not isinstance(borrowed, sa.Connection):
            raise TypeError(
                f"connection is a SQLAlchemy Connection, not {type(borrowed).__name__}; of an ORM session it is "
                "session.connection()"
            )
        if borrowed.dialect.name != self.dialect:
            raise StoreUnavailable(
                f"the connection is to {borrowed.dialect.name}, the knowledge base in {self._options.store}"
            )
        expected = None
        if borrowed.engine.pool is not self.engine.pool:
            with self.connect() as own:
                expected = own.database()
        with self.wrap_errors(), savepoint(borrowed, self._options, expected) as connection:
            yield connection

    @contextmanager
    def wrap_errors(self) -> Iterator[None]:
        """Raise errors of SQLAlchemy and of the driver as `StoreUnavailable` with what to do."""
        try:
            yield
        except self.errors as error:
            raise self.failure(error) from error


def _opened(place: URL | Engine, options: Options) -> ThreadConnections | PooledConnections:
    if isinstance(place, Engine):
        refuse_others(place.dialect.name)
        return LentConnections(place, options)
    if place.get_backend_name() == "postgresql":
        return ServerConnections(ServerPool.shared(place, options.busy_timeout), options)
    return ThreadConnections(make_engine(place, busy_timeout=options.busy_timeout), options)


class _Checkout:
    """`Database.connect`, as a class.

    A generator would cost as much as the statement, and an interrupt could leave it suspended.
    """

    __slots__ = ("_connection", "_database")

    def __init__(self, database: Database) -> None:
        self._database = database

    def __enter__(self) -> StoreConnection:
        self._connection = connection = self._database.checkout()
        return connection

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._database.checkin(self._connection)


class _ReadSnapshot(_Checkout):
    """`Database.read`, as a class for the same reason."""

    __slots__ = ("_has_begun",)

    def __enter__(self) -> StoreConnection:
        connection = super().__enter__()
        self._has_begun = False
        try:
            if not connection.in_transaction:
                connection.begin(write=False)
                self._has_begun = True
        except BaseException as error:
            self.__exit__(type(error), error, error.__traceback__)
            raise
        return connection

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        try:
            if self._has_begun:
                self._connection.rollback()
        finally:
            # without super(): an interrupt may come when it has returned
            self._database.checkin(self._connection)
        if isinstance(error, self._database.errors):
            raise self._database.failure(error) from error


class _Transaction(_Checkout):
    """`Database.begin`, as a class for the same reasons."""

    __slots__ = ()

    def __enter__(self) -> StoreConnection:
        connection = super().__enter__()
        try:
            connection.begin(write=True)
            self._database.refuse_moved(connection)
        except BaseException as error:
            self.__exit__(type(error), error, error.__traceback__)
            raise
        return connection

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        try:
            if kind is None:
                self._connection.commit()
            else:
                self._connection.rollback()
        except BaseException:
            self._connection.rollback()
            raise
        finally:
            # without super(): an interrupt may come when it has returned
            self._database.checkin(self._connection)
