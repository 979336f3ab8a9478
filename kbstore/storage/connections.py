"""The connections of a `Database`: what all kinds have in common, and one connection for each thread (SQLite)."""

import os
import threading
import time
from abc import ABC, abstractmethod
from typing import Any

from sqlalchemy import Engine
from sqlalchemy.exc import DBAPIError
from sqlalchemy.exc import TimeoutError as PoolTimeout
from sqlalchemy.pool import StaticPool

from kbstore.errors import StoreUnavailable
from kbstore.storage import forks
from kbstore.storage.connection import Options, StoreConnection
from kbstore.storage.driver_errors import unavailable
from kbstore.storage.sqlite_connection import SqliteConnection
from kbstore.storage.statement_events import show_own


class Connections(ABC):
    """The connections of one `Database`.

    `checkout` returns the calling thread's connection, the same one throughout an operation; `checkin` ends its use.
    After `close` no connection is checked out; one in use is closed when its use ends.
    """

    def __init__(self, engine: Engine, options: Options) -> None:
        self.engine = engine
        self.is_closed = False
        self._options = options
        self._is_sqlite = engine.dialect.name == "sqlite"
        self._file: tuple[int, int] | None = None
        self._local = threading.local()
        self._open: set[StoreConnection] = set()
        self.opening = threading.RLock()
        """Held while a thread gets its first connection, and during a fork."""
        self._held: list[Any] = []
        self._is_forking = False
        forks.register(self)

    @abstractmethod
    def checkout(self) -> StoreConnection:
        """Return this thread's connection; it has to be checked in."""

    @abstractmethod
    def checkin(self, connection: StoreConnection) -> None:
        """End a use of a connection."""

    @abstractmethod
    def close(self) -> None:
        """Close the unused connections, and refuse every checkout from now on."""

    def _refuse_closed(self) -> None:
        if self.is_closed:
            raise StoreUnavailable("this knowledge base is closed; open it again with kbstore.open()")

    def _wait_for(self, lock: Any) -> None:
        """Wait for the lock of a connection. Raises `StoreUnavailable` after `busy_timeout` seconds."""
        if not lock.acquire(timeout=self._options.busy_timeout):
            raise StoreUnavailable(
                f"{self._options.store} has been used by another thread for more than "
                f"{self._options.busy_timeout:g} s; end its transaction, or open the store with a longer busy_timeout"
            )

    def refuse_another_file(self, connection: StoreConnection) -> None:
        """Raise where another store has taken the file's place: the caches of the first do not apply to it."""
        if self._file is None:
            self._file = connection.file
        if connection.file != self._file:
            raise self.moved()

    def moved(self) -> StoreUnavailable:
        """Return the error for a path at which there is another file now, or none."""
        return StoreUnavailable(
            f"{self._options.store} has been moved, deleted or replaced since it was opened; put the file back, or "
            "open what is there now with kbstore.open()"
        )

    def failure(self, error: Exception) -> StoreUnavailable:
        """Return the error to raise for an error of SQLAlchemy or of the driver, also of connecting."""
        if isinstance(error, PoolTimeout):
            return StoreUnavailable(
                f"{self._options.store}: all connections of the pool are in use ({error}); end transactions sooner, "
                "or make the pool larger: pool_size in the URL, or of the engine"
            )
        original = error.orig if isinstance(error, DBAPIError) and error.orig is not None else error
        return unavailable(original, self._options.store, self._options.busy_timeout)

    # -- forks ------------------------------------------------------------------------------------------------

    def _locks(self) -> list[Any]:
        """Return the locks held by threads that are within SQLite."""
        return [connection.lock for connection in self._open]

    def hold(self, deadline: float) -> bool:
        """Keep other threads out of SQLite, before a fork; return False if they don't leave it until a deadline."""

        def held(lock: Any) -> bool:
            found: bool = lock.acquire(timeout=max(0.0, deadline - time.monotonic()))
            if found:
                self._held.append(lock)
            return found

        if not self._is_sqlite:
            # a server's connections have no locks that a child would miss: it leaves them alone
            return True
        self._is_forking = True
        return held(self.opening) and all(map(held, self._locks()))

    def let_go(self) -> None:
        """Let other threads go on, after a fork."""
        self._is_forking = False
        while self._held:
            self._held.pop().release()

    def forget_parent(self, *, is_quiet: bool) -> bool:
        """Leave the parent's connections to the parent, in a forked child, and begin with none.

        Returns whether all files that the parent had open could be closed, which they can if the fork was quiet: no
        other thread was within SQLite.
        """
        # closing would roll back the parent's writes, in the log that both processes share
        closing = is_quiet and self._is_sqlite and not any(connection.has_unsettled for connection in self._open)
        for connection in self._open:
            # otherwise the pool would close it when the handle is collected
            connection.handle.detach()
            connection.abandon(close=closing)
        # idle connections in a pool: those to files are closed, too; those to a server stay open for the parent
        if not closing:
            forks.inherited.append(self.engine.pool)
        self.engine.dispose(close=closing)
        self._open = set()
        self._local = threading.local()
        self.opening = threading.RLock()
        self._held = []
        self._is_forking = False
        return closing or not self._is_sqlite


def release_taken(lock: Any) -> None:
    """Release a lock after an exception while it was acquired: an interrupt may come when it has been."""
    if lock._is_owned():
        lock.release()


class ThreadConnections(Connections):
    """The connections of an SQLite engine of kbstore's own: one for each thread, for as long as the thread lives.

    A new thread takes over the connection of a thread that has ended, since SQLite reads the whole schema for each new
    connection (5 ms). A store in memory has one connection, which threads use in turn.
    """

    def __init__(self, engine: Engine, options: Options) -> None:
        super().__init__(engine, options)
        self._has_one = isinstance(engine.pool, StaticPool)
        self._one: SqliteConnection | None = None
        self._threads: dict[Any, threading.Thread] = {}
        self._is_in_memory = False

    def checkout(self) -> SqliteConnection:
        """Return this thread's connection, opened if there is none; it has to be checked in."""
        while True:
            # as few calls as possible: each takes a hundredth of the time of a question
            connection: SqliteConnection | None = (
                self._one if self._has_one else getattr(self._local, "connection", None)
            )
            if connection is None or self.is_closed:
                connection = self._connect()
            if self._is_forking and not connection.uses:
                # wait for the fork, which otherwise might never get the lock that a busy thread takes again and again
                with self.opening:
                    pass
            if not connection.uses and connection.was_moved():
                raise self.moved()
            lock = connection.lock
            try:
                # taken by another thread of a store in memory, by a fork, or by `close`
                if not lock.acquire(blocking=False):
                    self._wait_for(lock)
            except BaseException:
                release_taken(lock)
                raise
            connection.uses += 1
            if not self.is_closed:
                return connection
            self.checkin(connection)

    def checkin(self, connection: StoreConnection) -> None:
        """End a use of a connection; one that is lost, or of a store that was closed meanwhile, is closed."""
        connection.uses -= 1
        if not connection.uses and (connection.in_transaction or connection.is_lost):
            connection.settle()
            if connection.is_lost:
                self._drop(connection)
        connection.lock.release()
        if self.is_closed:
            # only after the release: `close` in another thread may just have found it locked, and left it open
            self._drop_unused(connection)

    def _connect(self) -> SqliteConnection:
        with self.opening:
            self._refuse_closed()
            if self._one is not None:
                return self._one
            forks.refuse_unsafe()
            connection = self._left_behind() or self._opened()
            if self._has_one:
                self._one = connection
            else:
                self._local.connection = connection
                self._threads[connection] = threading.current_thread()
            return connection

    def _opened(self) -> SqliteConnection:
        """Open a new connection."""
        try:
            handle = self.engine.raw_connection()
        except DBAPIError as error:
            raise self.failure(error) from error
        driver: Any = handle.driver_connection
        driver.isolation_level = None
        path = os.path.abspath(self.engine.url.database or "")
        connection = SqliteConnection(driver, self._options, path=path)
        connection.handle = handle
        show_own(connection, self.engine)
        try:
            connection.configure()
            self.refuse_another_file(connection)
            if connection.path is not None and not self._options.read_only:
                connection.use_write_ahead_log()
        except BaseException:
            connection.handle.invalidate()
            raise
        self._is_in_memory = connection.path is None
        self._open.add(connection)
        return connection

    def _left_behind(self) -> SqliteConnection | None:
        """Return the usable connection of a thread that has ended, if any; other such connections are closed."""
        found: SqliteConnection | None = None
        for connection, thread in list(self._threads.items()):
            if thread.is_alive():
                continue
            if found is None and not connection.uses and not connection.is_lost:
                found = connection
            else:
                self._drop(connection)
        return found

    def _drop_unused(self, connection: StoreConnection) -> bool:
        """Close an unused connection; return False if a thread uses it, which closes it afterwards."""
        if not connection.lock.acquire(blocking=False):
            return False
        try:
            if connection.uses:
                return False
            self._drop(connection)
            return True
        finally:
            connection.lock.release()

    def _drop(self, connection: StoreConnection) -> None:
        with self.opening:
            if connection not in self._open:
                return
            self._open.remove(connection)
            self._threads.pop(connection, None)
            if self._one is connection:
                self._one = None
        if getattr(self._local, "connection", None) is connection:
            del self._local.connection
        connection.handle.invalidate()

    def close(self) -> None:
        """Close the connections; a transaction that a thread has under way may go on to its end."""
        with self.opening:
            if self.is_closed:
                return
            self.is_closed = True
            connections = list(self._open)
        dropped = [self._drop_unused(connection) for connection in connections]
        if all(dropped):
            self.engine.dispose()

    def forget_parent(self, *, is_quiet: bool) -> bool:
        """Leave the parent's connections to the parent, in a forked child; a store in memory is copied by the fork."""
        if not self._is_in_memory:
            self._one = None
            self._threads = {}
            return super().forget_parent(is_quiet=is_quiet)
        self.let_go()
        if not is_quiet:
            self._one = None
            self._open = set()
        return is_quiet
