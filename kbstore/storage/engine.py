"""Connections to a store: one for each thread, transactions begun and ended by hand, errors translated in one place.

SQLAlchemy gives the engine, the dialect and the pool. Statements go to the driver's own cursor, because a
statement compiled for each call costs five times what a point question costs.
"""

import json
import os
import re
import sqlite3
import threading
from collections.abc import Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext
from pathlib import Path
from types import TracebackType
from typing import Any, Final

import sqlalchemy
from sqlalchemy import Engine, create_engine
from sqlalchemy.engine import URL, make_url
from sqlalchemy.exc import ArgumentError, DBAPIError, NoSuchModuleError
from sqlalchemy.pool import StaticPool

from kbstore.errors import StoreUnavailable

Row = tuple[Any, ...]
Parameters = Mapping[str, Any]

_NAMED = re.compile(r"(?<![:\w]):(\w+)")
_EACH = re.compile(r"EACH\((\w+) AS (\w+)\)")
_AMONG = re.compile(r"AMONG\((\w+), (\w+)\)")
_TRANSIENT: Final = ("locked", "busy")


class Statement:
    """One SQL statement in both dialects, with parameters written ``:name``.

    ``EACH(names AS text)`` is a table with the column ``value`` of what the array parameter holds, and
    ``AMONG(node, path)`` says that a column has one of the numbers of the array parameter. On SQLite that is an IN
    on purpose: a join gets a Bloom filter after ANALYZE, and the whole index is scanned.
    """

    __slots__ = ("postgresql", "sqlite")

    def __init__(self, sql: str) -> None:
        sqlite = _AMONG.sub(r"\1 IN (SELECT value FROM json_each(:\2))", sql)
        sql = _AMONG.sub(r"\1 = ANY(CAST(:\2 AS bigint[]))", sql)
        self.sqlite = _EACH.sub(r"json_each(:\1)", sqlite)
        self.sqlite = self.sqlite.replace(" FOR UPDATE", "")
        self.postgresql = _NAMED.sub(r"%(\1)s", _EACH.sub(r"unnest(CAST(:\1 AS \2[])) AS each_row(value)", sql))


class Lookup(Statement):
    """A statement whose parameters are given in an order, for the shortest way to one row."""

    __slots__ = ("names",)

    def __init__(self, sql: str, *names: str) -> None:
        super().__init__(sql)
        self.names = names
        self.sqlite = _NAMED.sub(lambda found: f"?{names.index(found[1]) + 1}", self.sqlite)


class Insertion(Statement):
    """Adds rows, given as sequences in the order of the columns: a name for each value would cost half the time."""

    __slots__ = ()

    def __init__(self, table: str, *columns: str) -> None:
        sql = f"INSERT INTO {table} ({', '.join(columns)}) VALUES "
        self.sqlite = f"{sql}({', '.join('?' * len(columns))})"
        self.postgresql = f"{sql}({', '.join(['%s'] * len(columns))})"


class Session:
    """One thread's connection. Statements outside of a transaction see the latest commit."""

    def __init__(self, connection: sqlalchemy.Connection, dialect: str) -> None:
        self._connection = connection
        driver: Any = connection.connection.driver_connection
        self.driver = driver
        self._sqlite = dialect == "sqlite"
        self._execute = driver.execute
        self.in_transaction = False
        self._answers: dict[int, dict[Any, Any]] = {}
        self._data_version = -1

    def answers(self, kb: int) -> dict[Any, Any]:
        """What is remembered of a knowledge base; forgotten whenever any connection has committed (SQLite only)."""
        version = self._execute("PRAGMA data_version").fetchone()[0]
        if version != self._data_version:
            self._data_version = version
            self._answers.clear()
        answers = self._answers.get(kb)
        if answers is None:
            answers = self._answers[kb] = {}
        return answers

    def all(self, statement: Statement, parameters: Parameters) -> list[Row]:
        """All rows."""
        text = statement.sqlite if self._sqlite else statement.postgresql
        rows: list[Row] = self._execute(text, parameters).fetchall()
        return rows

    def stream(self, statement: Statement, parameters: Parameters) -> Iterator[Row]:
        """The rows one after another, without holding all of them in memory; within a transaction."""
        if self._sqlite:
            yield from self._execute(statement.sqlite, parameters)
            return
        with self.driver.cursor(name="kbstore_rows") as cursor:
            cursor.itersize = 2000
            yield from cursor.execute(statement.postgresql, parameters)

    def first(self, statement: Statement, parameters: Parameters) -> Row | None:
        """The first row, if any."""
        text = statement.sqlite if self._sqlite else statement.postgresql
        row: Row | None = self._execute(text, parameters).fetchone()
        return row

    def look_up(self, statement: Lookup, *parameters: int) -> Row | None:
        """The first row of a look-up, if any."""
        if self._sqlite:
            row: Row | None = self._execute(statement.sqlite, parameters).fetchone()
            return row
        return self.first(statement, dict(zip(statement.names, parameters, strict=True)))

    def run(self, statement: Statement, parameters: Parameters) -> int:
        """Run a statement that returns no rows; the number of rows that it changed."""
        text = statement.sqlite if self._sqlite else statement.postgresql
        return int(self._execute(text, parameters).rowcount)

    def many(self, statement: Statement, rows: Sequence[Parameters | Sequence[Any]]) -> None:
        """Run a statement once for each set of parameters."""
        if rows:
            text = statement.sqlite if self._sqlite else statement.postgresql
            self.driver.cursor().executemany(text, rows)

    def array(self, values: Sequence[Any]) -> Any:
        """An array parameter for a statement with ``EACH``."""
        return json.dumps(values) if self._sqlite else list(values)

    def timeline_ids(self, count: int) -> Sequence[int]:
        """Numbers for new timelines; on SQLite the writer is alone, so they follow the last."""
        if self._sqlite:
            row = self._execute("SELECT coalesce(max(id), 0) FROM timelines").fetchone()
            return range(row[0] + 1, row[0] + 1 + count)
        sequence = "SELECT nextval(pg_get_serial_sequence('timelines', 'id')) FROM generate_series(1, %s)"
        return [row[0] for row in self._execute(sequence, (count,)).fetchall()]

    def begin(self, *, write: bool) -> None:
        """Begin a transaction: for writing with SQLite's only write lock; for reading, on one snapshot."""
        if self._sqlite:
            self._execute("BEGIN IMMEDIATE" if write else "BEGIN")
        else:
            self._execute("BEGIN" if write else "BEGIN ISOLATION LEVEL REPEATABLE READ READ ONLY")
        self.in_transaction = True

    def commit(self) -> None:
        """Commit the transaction."""
        self._execute("COMMIT")
        self.in_transaction = False
        # data_version does not tell of this connection's own commits
        self._answers.clear()

    def rollback(self) -> None:
        """Roll the transaction back; a connection that is lost has done so already."""
        self.in_transaction = False
        # after some errors (a full disk) SQLite has rolled back by itself
        if not self._sqlite or self.driver.in_transaction:
            self._execute("ROLLBACK")

    def close(self) -> None:
        """Give the connection back to the pool."""
        self._connection.close()

    def discard(self) -> None:
        """Drop a connection that does not work any more."""
        self._connection.invalidate()
        self._connection.close()


class Database:
    """A store's connections. May be used from several threads, and after a fork."""

    def __init__(
        self,
        url: str | os.PathLike[str] | URL | Engine,
        *,
        durability: str = "full",
        read_only: bool = False,
        busy_timeout: float = 30.0,
    ) -> None:
        if durability not in ("full", "normal"):
            raise ValueError(f'durability is "full" or "normal", not {durability!r}')
        self._owns_engine = not isinstance(url, Engine)
        self.engine = url if isinstance(url, Engine) else make_engine(url, busy_timeout=busy_timeout)
        self.dialect = self.engine.dialect.name
        if self.dialect not in ("sqlite", "postgresql"):
            raise StoreUnavailable(f"kbstore keeps its store in SQLite or PostgreSQL, not in {self.dialect}")
        self._durability = durability
        self._read_only = read_only
        self._busy_timeout = busy_timeout
        self._closed = False
        self._sessions: dict[int, tuple[threading.Thread, Session]] = {}
        self._local = threading.local()
        self._process = os.getpid()
        shared = isinstance(self.engine.pool, StaticPool)
        self._shared_session: Session | None = None
        self._shared = shared
        self.guard: AbstractContextManager[Any] = threading.RLock() if shared else nullcontext()

    # -- transactions -----------------------------------------------------------------------------------------

    @contextmanager
    def reading(self) -> Iterator[Session]:
        """A session on one snapshot of the store; within a transaction of this thread, that transaction's."""
        with self.guard, self.translating():
            session = self.session()
            if session.in_transaction:
                yield session
                return
            session.begin(write=False)
            try:
                yield session
            finally:
                session.rollback()

    @contextmanager
    def writing(self) -> Iterator[Session]:
        """A session with a write transaction: committed at the end, rolled back after an exception."""
        with self.guard:
            with self.translating():
                session = self.session()
                session.begin(write=True)
            try:
                with self.translating():
                    yield session
                    session.commit()
            except BaseException:
                with self.translating():
                    self._roll_back(session)
                raise

    def asking(self) -> "_Asking":
        """This thread's session for single statements, each on the latest commit."""
        return _Asking(self)

    def first(self, statement: Statement, parameters: Parameters) -> Row | None:
        """The first row of one statement on its own."""
        with self.asking() as session:
            return session.first(statement, parameters)

    def _roll_back(self, session: Session) -> None:
        try:
            session.rollback()
        except Exception as error:
            if not self._is_driver_error(error):
                raise
            self._discard()

    # -- sessions ---------------------------------------------------------------------------------------------

    def session(self) -> Session:
        """This thread's session; opened when there is none."""
        if self._closed:
            raise StoreUnavailable("this knowledge base is closed; open it again with kbstore.open()")
        if self._process != os.getpid():
            self._forget_parent()
        session: Session | None = self._shared_session if self._shared else getattr(self._local, "session", None)
        return session or self._open_session()

    def _open_session(self) -> Session:
        connection = self.engine.connect().execution_options(isolation_level="AUTOCOMMIT")
        session = Session(connection, self.dialect)
        for setting in self._settings():
            session.driver.execute(setting)
        if self._shared:
            self._shared_session = session
            return session
        self._local.session = session
        self._release_dead_threads()
        self._sessions[threading.get_ident()] = (threading.current_thread(), session)
        return session

    def _settings(self) -> list[str]:
        if self.dialect == "postgresql":
            level = "on" if self._durability == "full" else "off"
            return [
                f"SET synchronous_commit = {level}",
                *(["SET default_transaction_read_only = on"] * self._read_only),
            ]
        return [
            f"PRAGMA busy_timeout = {int(self._busy_timeout * 1000)}",
            "PRAGMA foreign_keys = ON",
            *(["PRAGMA journal_mode = WAL"] * (not self._read_only)),
            f"PRAGMA synchronous = {self._durability.upper()}",
            "PRAGMA cache_size = -65536",
            *(["PRAGMA query_only = ON"] * self._read_only),
        ]

    def _release_dead_threads(self) -> None:
        for ident, (thread, session) in list(self._sessions.items()):
            if not thread.is_alive():
                del self._sessions[ident]
                session.close()

    def _forget_parent(self) -> None:
        """After a fork: leave the parent's connections alone, and begin with none."""
        self.engine.dispose(close=False)
        self._process = os.getpid()
        self._local = threading.local()
        self._sessions = {}
        self._shared_session = None

    def _discard(self) -> None:
        session = getattr(self._local, "session", None)
        if session is not None:
            self._local.session = None
            self._sessions.pop(threading.get_ident(), None)
            session.discard()

    def close(self) -> None:
        """Close the connections; what is asked afterwards is refused."""
        if self._closed:
            return
        self._closed = True
        if self._process != os.getpid():
            return
        for _, session in self._sessions.values():
            session.close()
        if self._shared_session is not None:
            self._shared_session.close()
        if self._owns_engine:
            self.engine.dispose()

    # -- errors -----------------------------------------------------------------------------------------------

    @contextmanager
    def translating(self) -> Iterator[None]:
        """The driver's errors, as `StoreUnavailable` with what to do."""
        try:
            yield
        except DBAPIError as error:
            raise self._translated(error.orig or error) from error
        except Exception as error:
            if not self._is_driver_error(error):
                raise
            raise self._translated(error) from error

    def _is_driver_error(self, error: BaseException) -> bool:
        return isinstance(error, self.engine.dialect.loaded_dbapi.Error)

    def _translated(self, error: BaseException) -> StoreUnavailable:
        store = self.engine.url.render_as_string(hide_password=True)
        reason = str(error).strip() or type(error).__name__
        if isinstance(error, sqlite3.Error):
            if any(word in reason for word in _TRANSIENT):
                return StoreUnavailable(
                    f"{store} has been locked by another process for more than {self._busy_timeout:g} s; "
                    "try again, or find out who holds the lock"
                )
            return StoreUnavailable(f"{store}: {reason}; what was committed before is intact")
        self._discard()
        return StoreUnavailable(f"{store}: {reason}; the next call connects anew")


class _Asking:
    """`Database.asking`, as a class: a generator would cost as much as the statement."""

    __slots__ = ("_database",)

    def __init__(self, database: Database) -> None:
        self._database = database

    def __enter__(self) -> Session:
        database = self._database
        database.guard.__enter__()
        try:
            return database.session()
        except BaseException as error:
            database.guard.__exit__(type(error), error, error.__traceback__)
            raise

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._database.guard.__exit__(kind, error, trace)
        if error is not None:
            with self._database.translating():
                raise error


def make_engine(url: str | os.PathLike[str] | URL, *, busy_timeout: float = 30.0) -> Engine:
    """An engine for a SQLAlchemy URL, or for the path of an SQLite file."""
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
    if parsed.drivername == "postgresql":
        parsed = parsed.set(drivername="postgresql+psycopg")
    try:
        if parsed.get_backend_name() != "sqlite":
            return create_engine(parsed)
        arguments = {"timeout": busy_timeout, "check_same_thread": False}
        if parsed.database in (None, "", ":memory:"):
            return create_engine(parsed, connect_args=arguments, poolclass=StaticPool)
        return create_engine(parsed, connect_args=arguments)
    except NoSuchModuleError as error:
        raise StoreUnavailable(f"{parsed.drivername} is not a kind of database that is installed: {error}") from None
    except ModuleNotFoundError as error:
        raise StoreUnavailable(
            f"the driver {error.name} is not installed; for PostgreSQL: pip install 'kbstore[postgresql]'"
        ) from None
