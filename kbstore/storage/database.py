"""A store's connections: one for each thread, with what the store needs of them.

SQLAlchemy gives the engine, the dialect and the pool. Statements go to the driver's own cursor, because a
statement compiled for each call costs five times what a point question costs.
"""

import os
import sqlite3
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from types import TracebackType
from typing import Any

from sqlalchemy import Engine
from sqlalchemy.engine import URL
from sqlalchemy.exc import DBAPIError
from sqlalchemy.exc import TimeoutError as PoolTimeout
from sqlalchemy.pool import SingletonThreadPool, StaticPool

from kbstore.errors import StoreUnavailable
from kbstore.storage import forks
from kbstore.storage.connection import AnswerCache, Parameters, SqlRow, StoreConnection, unavailable
from kbstore.storage.engine import BUSY_TIMEOUT, make_engine, refuse_others
from kbstore.storage.statements import Statement


class Database:
    """A store's connections. May be used from several threads, and after a fork.

    Each thread has a connection of its own, for as long as it lives; a store in memory has one, which threads use in
    turn. Of an engine of the caller's, connections are given back as they were when they came; meanwhile they are
    kbstore's.
    """

    def __init__(
        self,
        url: str | os.PathLike[str] | URL | Engine,
        *,
        durability: str = "full",
        read_only: bool = False,
        busy_timeout: float = BUSY_TIMEOUT,
    ) -> None:
        if durability not in ("full", "normal"):
            raise ValueError(f'durability is "full" or "normal", not {durability!r}')
        if not 0 <= busy_timeout <= 1_000_000:
            raise ValueError(f"busy_timeout is a number of seconds from 0 to a million, not {busy_timeout!r}")
        self._owns_engine = not isinstance(url, Engine)
        self.engine = url if isinstance(url, Engine) else make_engine(url, busy_timeout=busy_timeout)
        self.dialect = self.engine.dialect.name
        refuse_others(self.dialect)
        self._durability = durability
        self._read_only = read_only
        self._busy_timeout = busy_timeout
        self._has_one_connection = isinstance(self.engine.pool, StaticPool | SingletonThreadPool)
        self._file: tuple[int, int] | None = None
        # as its connections tell
        self._is_in_memory = False
        self._is_closed = False
        self._shared: StoreConnection | None = None
        self._local = threading.local()
        self._sessions: dict[int, tuple[threading.Thread, StoreConnection]] = {}
        self._opening = threading.RLock()
        """Held where sessions come and go."""
        self._held: list[Any] = []
        self._is_forking = False
        forks.register(self)

    # -- transactions -----------------------------------------------------------------------------------------

    @contextmanager
    def read(self) -> Iterator[StoreConnection]:
        """A session on one snapshot of the store; within a transaction of this thread, that transaction's."""
        with self.connect() as session, self.wrap_errors():
            if session.in_transaction:
                yield session
                return
            session.begin(write=False)
            try:
                yield session
            finally:
                session.rollback()

    @contextmanager
    def begin(self) -> Iterator[StoreConnection]:
        """A session with a write transaction: committed at the end, rolled back after an exception."""
        with self.connect() as session:
            session.begin(write=True)
            try:
                self._refuse_moved(session)
                yield session
                session.commit()
            except BaseException:
                session.rollback()
                raise

    def _refuse_moved(self, session: StoreConnection) -> None:
        """Raise where what is written would go to a file that nobody finds any more; SQLite would not notice."""
        if session.has_moved():
            raise self._moved()

    def _moved(self) -> StoreUnavailable:
        return StoreUnavailable(
            f"{self._name()} has been moved, deleted or replaced since it was opened; put the file back, or open "
            "what is there now with kbstore.open()"
        )

    def connect(self) -> "_Checkout":
        """This thread's session for single statements, each on the latest commit."""
        return _Checkout(self)

    def first(self, statement: Statement, parameters: Parameters) -> SqlRow | None:
        """The first row of one statement on its own."""
        with self.connect() as session:
            return session.first(statement, parameters)

    def recall(self) -> AnswerCache | None:
        """What this thread's connection remembers, outside of a transaction; None where another thread uses it."""
        session: StoreConnection | None = (
            self._shared if self._has_one_connection else getattr(self._local, "session", None)
        )
        if session is None or self._is_closed or self._is_forking or not session.lock.acquire(blocking=False):
            return None
        try:
            return None if session.in_transaction else session.memory()
        finally:
            session.lock.release()
            if self._is_closed:
                self._drop_unused(session)

    # -- sessions ---------------------------------------------------------------------------------------------

    def checkout(self) -> StoreConnection:
        """This thread's session, opened where there is none; to be given back."""
        while True:
            session: StoreConnection | None = (
                self._shared if self._has_one_connection else getattr(self._local, "session", None)
            )
            if session is None or self._is_closed:
                session = self._open()
            if self._is_forking and not session.uses:
                # after the fork, which would otherwise hardly get hold of what a busy thread takes again and again
                with self._opening:
                    pass
            # taken by another thread of a store in memory, by a fork, or by `close`
            lock = session.lock
            if not (lock.acquire(blocking=False) or lock.acquire(timeout=self._busy_timeout)):
                raise StoreUnavailable(
                    f"{self._name()} has been used by another thread for more than {self._busy_timeout:g} s; end its "
                    "transaction, or open the store with a longer busy_timeout"
                )
            session.uses += 1
            if not self._is_closed and (session.uses > 1 or session.is_local or session.is_alive()):
                return session
            self.checkin(session)

    def checkin(self, session: StoreConnection) -> None:
        """Done with a session; one that is lost, or of a store that was closed meanwhile, is dropped."""
        session.uses -= 1
        if session.is_lost and not session.uses:
            self._drop(session)
        session.lock.release()
        if self._is_closed:
            # not before: who closes at that very moment would find it locked, and leave it open
            self._drop_unused(session)

    def _drop_unused(self, session: StoreConnection) -> bool:
        """Drop a session that nobody uses; False if somebody does, who is to do so when done."""
        if not session.lock.acquire(blocking=False):
            return False
        try:
            if session.uses:
                return False
            self._drop(session)
            return True
        finally:
            session.lock.release()

    def _open(self) -> StoreConnection:
        """Connect."""
        with self._opening:
            if self._is_closed:
                raise StoreUnavailable("this knowledge base is closed; open it again with kbstore.open()")
            if self._shared is not None:
                return self._shared
            if self.dialect == "sqlite":
                forks.refuse_unsafe()
            with self.wrap_errors():
                connection = self.engine.connect().execution_options(isolation_level="AUTOCOMMIT")
            path = os.path.abspath(self.engine.url.database or "")
            session = StoreConnection(connection, self._name(), self._busy_timeout, path=path)
            try:
                session.configure(self._settings(), restore=not self._owns_engine)
                self._refuse_another_file(session)
                if session.path is not None and not self._read_only:
                    self._use_write_ahead_log(session.driver)
            except BaseException:
                session.close(give_back=not self._owns_engine)
                raise
            self._is_in_memory = session.is_local and session.path is None
            if self._has_one_connection:
                self._shared = session
            else:
                self._local.session = session
                self._drop_those_of_dead_threads()
                self._sessions[threading.get_ident()] = (threading.current_thread(), session)
            return session

    def _refuse_another_file(self, session: StoreConnection) -> None:
        """Raise where another store has taken the file's place: what is known of the first is not true of it."""
        if self._file is None:
            self._file = session.file
        if session.file != self._file:
            raise self._moved()

    @property
    def can_remember(self) -> bool:
        """Whether sessions can tell that nobody has committed: on SQLite, if none shares its connection with others."""
        return self.dialect == "sqlite" and (self._owns_engine or not self._has_one_connection)

    def _settings(self) -> dict[str, Any]:
        patience = int(self._busy_timeout * 1000)
        if self.dialect == "postgresql":
            settings: dict[str, Any] = {
                "synchronous_commit": "on" if self._durability == "full" else "off",
                # 0 would be for ever
                "lock_timeout": max(1, patience),
            }
            return settings | ({"default_transaction_read_only": "on"} if self._read_only else {})
        settings = {
            "busy_timeout": patience,
            "foreign_keys": 1,
            "synchronous": {"full": 2, "normal": 1}[self._durability],
            # on macOS only this waits for the disk itself
            "fullfsync": int(self._durability == "full"),
            "cache_size": -65536,
        }
        return settings | ({"query_only": 1} if self._read_only else {})

    def _use_write_ahead_log(self, driver: Any) -> None:
        """Readers and a writer don't wait for each other; a property of the file.

        Where several connections change it at once SQLite does not wait, whatever its time-out is.
        """
        deadline = time.monotonic() + self._busy_timeout
        with self.wrap_errors():
            while True:
                try:
                    driver.execute("PRAGMA journal_mode = WAL").fetchone()
                except sqlite3.OperationalError as error:
                    if error.sqlite_errorcode & 0xFF != sqlite3.SQLITE_BUSY or time.monotonic() >= deadline:
                        raise
                    time.sleep(0.01)
                else:
                    return

    def _drop_those_of_dead_threads(self) -> None:
        for thread, session in list(self._sessions.values()):
            if not thread.is_alive():
                self._drop(session)

    def _drop(self, session: StoreConnection) -> None:
        with self._opening:
            if self._shared is session:
                self._shared = None
            for ident, (_, known) in list(self._sessions.items()):
                if known is session:
                    del self._sessions[ident]
        if getattr(self._local, "session", None) is session:
            del self._local.session
        session.close(give_back=not self._owns_engine)

    def close(self) -> None:
        """Close the connections; what is asked afterwards is refused.

        A transaction that another thread, or the caller, has under way may go on to its end.
        """
        with self._opening:
            if self._is_closed:
                return
            self._is_closed = True
            sessions = self._open_sessions()
        dropped = [self._drop_unused(session) for session in sessions]
        if self._owns_engine and all(dropped):
            self.engine.dispose()

    def _open_sessions(self) -> list[StoreConnection]:
        sessions = [session for _, session in self._sessions.values()]
        return sessions if self._shared is None else [*sessions, self._shared]

    # -- forks ------------------------------------------------------------------------------------------------

    def hold(self, deadline: float) -> bool:
        """Before a fork: keep other threads out of SQLite; False if they don't leave it until a deadline."""

        def held(lock: Any) -> bool:
            found: bool = lock.acquire(timeout=max(0.0, deadline - time.monotonic()))
            if found:
                self._held.append(lock)
            return found

        if self.dialect != "sqlite":
            return True
        self._is_forking = True
        return held(self._opening) and all(held(session.lock) for session in self._open_sessions())

    def let_go(self) -> None:
        """After a fork: other threads may go on."""
        self._is_forking = False
        while self._held:
            self._held.pop().release()

    def forget_parent(self, *, is_quiet: bool) -> bool:
        """In a forked child: leave the parent's connections, and begin with none; what is in memory is a copy.

        Returns whether all files that the parent had open could be closed, which needs a fork that was quiet.
        """
        if self._is_in_memory:
            self.let_go()
            if not is_quiet:
                self._shared = None
            return is_quiet
        is_file = self.dialect == "sqlite"
        sessions = self._open_sessions()
        # rolling back what the parent has written would do so in the log that both have
        closing = is_quiet and is_file and not any(session.has_unsettled for session in sessions)
        for session in sessions:
            session.leave_to_parent(close=closing)
        # idle connections in a pool of the caller's: files are closed, too, a server is not spoken to
        self.engine.dispose(close=closing)
        self._local = threading.local()
        self._sessions = {}
        self._shared = None
        self._opening = threading.RLock()
        self._held = []
        self._is_forking = False
        return closing or not is_file

    # -- errors -----------------------------------------------------------------------------------------------

    @contextmanager
    def wrap_errors(self) -> Iterator[None]:
        """Errors of the driver itself, and of connecting, as `StoreUnavailable` with what to do."""
        try:
            yield
        except PoolTimeout as error:
            raise StoreUnavailable(
                f"{self._name()}: no connection is left in the pool of the engine, and kbstore keeps one for each "
                f"thread that uses it; give the engine a larger pool, or kbstore the URL ({error})"
            ) from error
        except DBAPIError as error:
            raise unavailable(error.orig or error, self._name(), self._busy_timeout) from error
        except self.engine.dialect.loaded_dbapi.Error as error:
            raise unavailable(error, self._name(), self._busy_timeout) from error

    def _name(self) -> str:
        return self.engine.url.render_as_string(hide_password=True)


class _Checkout:
    """`Database.connect`, as a class: a generator would cost as much as the statement."""

    __slots__ = ("_database", "_session")

    def __init__(self, database: Database) -> None:
        self._database = database

    def __enter__(self) -> StoreConnection:
        self._session = session = self._database.checkout()
        return session

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._database.checkin(self._session)
