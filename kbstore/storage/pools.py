"""Pooled connections, one for each operation: to a PostgreSQL server, or on an engine of the caller's."""

import os
import threading
import weakref
from abc import abstractmethod
from queue import Empty, SimpleQueue
from typing import Any, ClassVar

from sqlalchemy import Connection, Engine, event
from sqlalchemy.engine import URL
from sqlalchemy.exc import DBAPIError
from sqlalchemy.exc import TimeoutError as PoolTimeout
from sqlalchemy.pool import StaticPool

from kbstore.errors import StoreUnavailable
from kbstore.storage import forks
from kbstore.storage.connection import LOG, Options, StoreConnection
from kbstore.storage.connections import Connections
from kbstore.storage.engine import make_engine
from kbstore.storage.notifications import Listener, Subscription, refuse_shared
from kbstore.storage.postgresql_connection import PostgresqlConnection, is_connected
from kbstore.storage.server_engine import (
    answer_timeout,
    connect_timeout,
    lend,
    pool_size,
    refuse_bytes,
    take_back,
)
from kbstore.storage.sqlite_connection import SqliteConnection
from kbstore.storage.statement_events import ObservedDriver, begin_quietly, is_observed, show_own


class PooledConnections(Connections):
    """One connection for each operation; a thread has at most one at a time, also for operations within operations."""

    def checkout(self) -> StoreConnection:
        """Return a connection from the pool, or the one that this thread has already; it has to be checked in."""
        connection: StoreConnection | None = getattr(self._local, "connection", None)
        if connection is None:
            self._refuse_closed()
            connection = self._local.connection = self._take()
            self._open.add(connection)
        elif self.is_closed:
            self._refuse_closed()
        connection.uses += 1
        return connection

    def checkin(self, connection: StoreConnection) -> None:
        """End a use of a connection; after the last it goes back to the pool."""
        connection.uses -= 1
        # not one of the parent's, in a forked child
        if not connection.uses and connection in self._open:
            try:
                self._open.remove(connection)
                connection.settle()
            finally:
                self._local.connection = None
                self._return(connection)

    @abstractmethod
    def _take(self) -> StoreConnection:
        """Take a connection from the pool."""

    @abstractmethod
    def _return(self, connection: StoreConnection) -> None:
        """Return a connection to the pool, or close one that is lost."""


class ServerConnections(PooledConnections):
    """The connections of one `Database` to a PostgreSQL server."""

    def __init__(self, pool: "ServerPool", options: Options) -> None:
        super().__init__(pool.engine, options)
        self._pool = pool

    def subscribe(self, kb: int) -> None:
        """Cache answers about now while the server notifies. Raises `StoreUnavailable` if it cannot."""
        connection = self.checkout()
        try:
            refuse_shared(connection.driver, self._options.store)
        except self.engine.dialect.loaded_dbapi.Error as error:
            raise self.failure(error) from error
        finally:
            self.checkin(connection)
        subscription = Subscription(self._pool.listener, kb)
        self._options = self._options._replace(subscription=subscription)
        subscription.begin()

    def forget_answers(self) -> None:
        """Clear the cached answers."""
        if self._options.subscription is not None:
            self._options.subscription.drop()

    def _take(self) -> StoreConnection:
        try:
            return self._pool.get(self._options)
        except (DBAPIError, self.engine.dialect.loaded_dbapi.Error) as error:
            # SQLAlchemy does not wrap the driver's errors from kbstore's own function that connects
            raise self.failure(error) from error

    def _return(self, connection: StoreConnection) -> None:
        assert isinstance(connection, PostgresqlConnection)
        self._pool.put(connection)

    def close(self) -> None:
        """Refuse every checkout from now on; the last user of the pool closes it."""
        with self.opening:
            if self.is_closed:
                return
            self.is_closed = True
        if self._options.subscription is not None:
            self._options.subscription.end()
        self._pool.release()

    def forget_parent(self, *, is_quiet: bool) -> bool:
        """Leave the parent's connections to the parent, in a forked child, without a word to the server."""
        self._pool.forget_parent()
        super().forget_parent(is_quiet=is_quiet)
        return True


class ServerPool:
    """At most `size` connections to a server, in autocommit, shared by all knowledge bases and threads of a process.

    The connection returned last is taken first, so that no more are opened than are used at a time. A checkout takes
    3 us, and 20 us from SQLAlchemy's QueuePool, where a question about one fact takes 60.
    """

    _lock = threading.Lock()
    _shared: ClassVar[dict[tuple[str, int], "ServerPool"]] = {}

    def __init__(self, engine: Engine, url: URL) -> None:
        self.engine = engine
        self._url = url
        self._size = pool_size(url)
        self._users = 0
        self._idle: list[PostgresqlConnection] = []
        self._room = self._all_room()
        errors = DBAPIError, engine.dialect.loaded_dbapi.Error, OSError
        self.listener = Listener(url.render_as_string(hide_password=True), self._connect_alone, errors)

    @classmethod
    def shared(cls, url: URL, busy_timeout: float) -> "ServerPool":
        """Return the pool of this process for a URL; it has to be released."""
        key = url.render_as_string(hide_password=False), connect_timeout(busy_timeout)
        with ServerPool._lock:
            pool = cls._shared.get(key)
            if pool is None:
                pool = cls._shared[key] = cls(make_engine(url, busy_timeout=busy_timeout), url)
            pool._users += 1
        return pool

    def release(self) -> None:
        """Give up a use of the pool; the last one closes it. The counterpart of `shared`."""
        with ServerPool._lock:
            self._users -= 1
            if self._users:
                return
            for key in [key for key, pool in self._shared.items() if pool is self]:
                del self._shared[key]
        self._close_idle()

    def _all_room(self) -> SimpleQueue[None]:
        """Return a semaphore; one of `threading` would stay locked after an interrupt within it."""
        room: SimpleQueue[None] = SimpleQueue()
        for _ in range(self._size):
            room.put(None)
        return room

    def get(self, options: Options) -> PostgresqlConnection:
        """Return a connection for one user. Raises `StoreUnavailable` if all are in use for over `busy_timeout` s."""
        try:
            self._room.get(timeout=options.busy_timeout)
        except Empty:
            raise StoreUnavailable(
                f"{options.store}: all {self._size} connections of this process have been in use for more than "
                f"{options.busy_timeout:g} s; end transactions sooner, or allow more: pool_size=... in the URL"
            ) from None
        try:
            while self._idle:
                connection = self._idle.pop()
                connection.lend(options)
                if connection.is_alive():
                    return connection
                LOG.warning("%s: the connection was lost; connecting again", options.store)
                connection.handle.invalidate()
            return self._connect(options)
        except BaseException:
            self._room.put(None)
            raise

    def _connect(self, options: Options) -> PostgresqlConnection:
        handle: Any = self.engine.raw_connection()
        handle.driver_connection.autocommit = True
        connection = PostgresqlConnection(handle.driver_connection, options, self.engine.dialect.loaded_dbapi.Error)
        connection.handle = handle
        show_own(connection, self.engine)
        return connection

    def _connect_alone(self) -> Any:
        """Return a new connection of the driver's, outside of the pool."""
        handle: Any = self.engine.raw_connection()
        driver = handle.driver_connection
        handle.detach()
        driver.autocommit = True
        return driver

    def put(self, connection: PostgresqlConnection) -> None:
        """Return a connection to the pool, or close it if it is lost."""
        try:
            if connection.is_lost:
                connection.handle.invalidate()
            else:
                self._idle.append(connection)
                if not self._users:
                    self._close_idle()
        finally:
            self._room.put(None)

    def _close_idle(self) -> None:
        while self._idle:
            try:
                self._idle.pop().handle.invalidate()
            except IndexError:
                # another thread was first
                return

    def forget_parent(self) -> None:
        """Begin with no connection, in a forked child; the parent's must not even be collected."""
        ServerPool._lock = threading.Lock()
        forks.inherited.extend(self._idle)
        self._idle = []
        self._room = self._all_room()
        self.listener.forget_parent()


class LentConnections(PooledConnections):
    """The connections of one `Database` on an engine of the caller's; each is returned with the settings that it had.

    If the pool has one connection for all threads (`StaticPool`), threads use it in turn.
    """

    def __init__(self, engine: Engine, options: Options) -> None:
        super().__init__(engine, options)
        if not self._is_sqlite and not event.contains(engine, "connect", _refuse_bytes):
            # before SQLAlchemy asks for the version of the server, and cannot read the answer
            event.listen(engine, "connect", _refuse_bytes, insert=True)
        self._turn = _turns.setdefault(engine.pool, threading.RLock()) if _has_one(engine) else None
        self._thread_locks: weakref.WeakSet[Any] = weakref.WeakSet()
        self._is_prepared = False

    def _take(self) -> StoreConnection:
        lock = self._turn or getattr(self._local, "lock", None) or self._new_lock()
        if not lock.acquire(blocking=False):
            self._wait_for(lock)
        try:
            return self._connect(lock)
        except BaseException:
            lock.release()
            raise

    def _new_lock(self) -> Any:
        """Make the lock of this thread, which it holds while it uses the database."""
        with self.opening:
            lock = self._local.lock = threading.RLock()
            self._thread_locks.add(lock)
        return lock

    def _connect(self, lock: Any) -> StoreConnection:
        if self._is_sqlite:
            forks.refuse_unsafe()
        while True:
            self._refuse_shared_transaction()
            try:
                handle = self.engine.connect().execution_options(isolation_level="AUTOCOMMIT")
            except (DBAPIError, PoolTimeout) as error:
                raise self.failure(error) from error
            driver: Any = handle.connection.driver_connection
            connection = self._sqlite(driver) if self._is_sqlite else self._postgresql(driver, handle)
            connection.handle = handle
            connection.lock = lock
            if connection.is_alive():
                if is_observed(self.engine):
                    begin_quietly(handle)
                    connection.execute_on(ObservedDriver(handle))
                break
            LOG.warning("%s: the connection was lost; connecting again", self._options.store)
            self._close(connection)
        try:
            if isinstance(connection, SqliteConnection):
                self._prepare(connection)
        except BaseException:
            self._close(connection)
            raise
        return connection

    def _refuse_shared_transaction(self) -> None:
        """Raise `StoreUnavailable` if the caller has a transaction open on the pool's one connection.

        kbstore would end it.
        """
        if self._turn is None or not self._is_sqlite:
            return
        pool: Any = self.engine.pool
        driver = pool.connection.driver_connection
        if driver is not None and driver.in_transaction:
            raise StoreUnavailable(
                f"{self._options.store}: a transaction is under way on the engine's one connection; end it first, or "
                "take part in it: kb.transaction(connection=...)"
            )

    def _sqlite(self, driver: Any) -> StoreConnection:
        return SqliteConnection(driver, self._options, lent=True, path=os.path.abspath(self.engine.url.database or ""))

    def _postgresql(self, driver: Any, handle: Connection) -> StoreConnection:
        error_of_driver = self.engine.dialect.loaded_dbapi.Error
        try:
            lent = is_connected(driver, error_of_driver) and lend(
                handle, answer_timeout(self.engine.url, self._options.busy_timeout)
            )
        except StoreUnavailable:
            handle.close()
            raise
        except error_of_driver as error:
            handle.invalidate()
            handle.close()
            raise self.failure(error) from error
        return PostgresqlConnection(driver, self._options, error_of_driver, lent=lent)

    def _prepare(self, connection: SqliteConnection) -> None:
        connection.configure()
        self.refuse_another_file(connection)
        if not self._is_prepared and connection.path is not None and not self._options.read_only:
            connection.use_write_ahead_log()
        self._is_prepared = True

    def _return(self, connection: StoreConnection) -> None:
        self._close(connection)
        connection.lock.release()

    @staticmethod
    def _close(connection: StoreConnection) -> None:
        if isinstance(connection, SqliteConnection) and not connection.is_lost:
            connection.restore()
        if isinstance(connection, PostgresqlConnection) and connection.lent:
            take_back(connection.driver)
        if connection.is_lost:
            connection.handle.invalidate()
        connection.handle.close()

    def close(self) -> None:
        """Refuse every checkout from now on; the engine and its connections are the caller's."""
        self.is_closed = True

    def _locks(self) -> list[Any]:
        return list(self._thread_locks) if self._turn is None else [self._turn]


def _refuse_bytes(driver: Any, _record: Any) -> None:
    refuse_bytes(driver, f"the database {driver.info.dbname}")


_turns: "weakref.WeakKeyDictionary[Any, Any]" = weakref.WeakKeyDictionary()
"""For each pool that has one connection for all threads, the lock of the thread whose turn it is."""


def _has_one(engine: Engine) -> bool:
    return isinstance(engine.pool, StaticPool)
