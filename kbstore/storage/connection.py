"""One connection to a store: statements, transactions, and the driver's errors translated in one place."""

import json
import os
import sqlite3
import threading
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any, Final

import sqlalchemy

from kbstore.caches import ANSWERS, LRU
from kbstore.errors import StoreUnavailable
from kbstore.storage.statements import Lookup, Statement

SqlRow = tuple[Any, ...]
Parameters = Mapping[str, Any]

_LOCKED: Final = (sqlite3.SQLITE_BUSY, sqlite3.SQLITE_LOCKED, sqlite3.SQLITE_PROTOCOL)
_DAMAGED: Final = (sqlite3.SQLITE_CORRUPT, sqlite3.SQLITE_NOTADB)
_LASTING: Final = (*_DAMAGED, sqlite3.SQLITE_IOERR, sqlite3.SQLITE_CANTOPEN, sqlite3.SQLITE_PROTOCOL)
"""Errors after which a new connection has better chances than the old one."""

_inherited: list[Any] = []
"""In a forked child: connections of the parent's that must not even be collected."""

_LOCK_NOT_AVAILABLE: Final = "55P03"
"""PostgreSQL's error when `lock_timeout` is over."""


class AnswerCache:
    """What has been answered about now since the last commit: truths and values, by question."""

    __slots__ = ("truths", "values")

    def __init__(self) -> None:
        self.truths: LRU[Any, Any] = LRU(ANSWERS)
        self.values: LRU[Any, Any] = LRU(ANSWERS)

    def clear(self) -> None:
        """Forget everything."""
        self.truths.clear()
        self.values.clear()


class StoreConnection:
    """A connection, used by one thread at a time. Statements outside of a transaction see the latest commit.

    Every error of the driver is raised as `StoreUnavailable`. After one that has ended the transaction under way,
    further statements are refused until it is rolled back, so that none takes effect on its own.

    Attributes:
        lock: held by the thread that uses the session.
        uses: how many times over that thread does so.
        is_lost: whether the connection does not work any more.
        is_local: whether there is no server that could have gone away.
        path: of the file that it has open; None where there is none.
        file: which file that is, where that can be told.
    """

    def __init__(self, connection: sqlalchemy.Connection, store: str, busy_timeout: float, *, path: str | None) -> None:
        """`path` is that of the store's URL."""
        self._connection = connection
        driver: Any = connection.connection.driver_connection
        self.driver = driver
        self.lock = threading.RLock()
        self.uses = 0
        self.is_lost = False
        self.in_transaction = False
        self._has_written = False
        self._store = store
        self._busy_timeout = busy_timeout
        self.is_local = self._sqlite = connection.dialect.name == "sqlite"
        self._error: type[Exception] = connection.dialect.loaded_dbapi.Error
        self._execute = driver.execute
        self._cursor = driver.cursor
        self._memory = AnswerCache()
        self._data_version = -1
        self._settings_before: dict[str, Any] = {}
        self._is_closed = False
        opened = self._open_file() if self._sqlite else None
        self.file = _file_at(opened)
        # a path that is relative, or a URI, may mean another file here; a link is to lead to this one from now on
        self.path = path if opened is not None and _file_at(path) == self.file else opened

    # -- statements -------------------------------------------------------------------------------------------

    def memory(self) -> AnswerCache:
        """The answers remembered on this connection, dropped first if another one has committed since.

        Right on SQLite, outside of transactions, and only where nobody else writes on this very connection. Source:
        https://www.sqlite.org/pragma.html#pragma_data_version
        """
        try:
            version: int = self._execute("PRAGMA data_version").fetchone()[0]
        except self._error as error:
            raise self._failure(error) from error
        if version != self._data_version:
            self._data_version = version
            self._memory.clear()
        return self._memory

    def all(self, statement: Statement, parameters: Parameters) -> list[SqlRow]:
        """All rows."""
        text = statement.sqlite if self._sqlite else statement.postgresql
        try:
            rows: list[SqlRow] = self._execute(text, parameters).fetchall()
        except self._error as error:
            raise self._failure(error) from error
        return rows

    def stream(self, statement: Statement, parameters: Parameters) -> Iterator[SqlRow]:
        """The rows one after another, without holding all of them in memory; within a transaction."""
        try:
            if self._sqlite:
                yield from self._execute(statement.sqlite, parameters)
                return
            with self._cursor(name="kbstore_rows") as cursor:
                cursor.itersize = 2000
                yield from cursor.execute(statement.postgresql, parameters)
        except self._error as error:
            raise self._failure(error) from error

    def first(self, statement: Statement, parameters: Parameters) -> SqlRow | None:
        """The first row, if any."""
        text = statement.sqlite if self._sqlite else statement.postgresql
        try:
            row: SqlRow | None = self._execute(text, parameters).fetchone()
        except self._error as error:
            raise self._failure(error) from error
        return row

    def look_up(self, statement: Lookup, *parameters: int) -> SqlRow | None:
        """The first row of a look-up, if any."""
        if not self._sqlite:
            return self.first(statement, dict(zip(statement.names, parameters, strict=True)))
        try:
            row: SqlRow | None = self._execute(statement.sqlite, parameters).fetchone()
        except self._error as error:
            raise self._failure(error) from error
        return row

    def run(self, statement: Statement, parameters: Parameters) -> int:
        """Run a statement that returns no rows; the number of rows that it changed."""
        self._has_written = True
        text = statement.sqlite if self._sqlite else statement.postgresql
        try:
            return int(self._execute(text, parameters).rowcount)
        except self._error as error:
            raise self._failure(error) from error

    def many(self, statement: Statement, rows: Sequence[Parameters | Sequence[Any]]) -> None:
        """Run a statement once for each set of parameters."""
        if rows:
            self._has_written = True
            text = statement.sqlite if self._sqlite else statement.postgresql
            try:
                self._cursor().executemany(text, rows)
            except self._error as error:
                raise self._failure(error) from error

    @contextmanager
    def together(self) -> Iterator[None]:
        """Statements that need no answer are sent to a server at once; what goes wrong with one is raised then."""
        if self._sqlite:
            yield
            return
        try:
            with self.driver.pipeline():
                yield
        except self._error as error:
            raise self._failure(error) from error

    def array(self, values: Sequence[Any]) -> Any:
        """An array parameter for a statement with ``EACH`` or ``AMONG``."""
        return json.dumps(values) if self._sqlite else list(values)

    def bounds(self, values: Sequence[int | None]) -> str:
        """The same for numbers, as text: to be made once and used by many statements."""
        text = json.dumps(values)
        return text if self._sqlite else text.replace("[", "{").replace("]", "}")

    def timeline_ids(self, count: int) -> Sequence[int]:
        """Numbers for new timelines; on SQLite the writer is alone, so they follow the last."""
        try:
            if self._sqlite:
                row = self._execute("SELECT coalesce(max(id), 0) FROM timelines").fetchone()
                return range(row[0] + 1, row[0] + 1 + count)
            sequence = "SELECT nextval(pg_get_serial_sequence('timelines', 'id')) FROM generate_series(1, %s)"
            return [row[0] for row in self._execute(sequence, (count,)).fetchall()]
        except self._error as error:
            raise self._failure(error) from error

    # -- transactions -----------------------------------------------------------------------------------------

    def begin(self, *, write: bool) -> None:
        """Begin a transaction: for writing with SQLite's only write lock; for reading, on one snapshot."""
        if self._sqlite:
            text = "BEGIN IMMEDIATE" if write else "BEGIN"
        else:
            text = f"BEGIN ISOLATION LEVEL {'READ COMMITTED' if write else 'REPEATABLE READ READ ONLY'}"
        try:
            self._execute(text)
        except self._error as error:
            raise self._failure(error) from error
        self._has_written = False
        self.in_transaction = True

    def commit(self) -> None:
        """Commit the transaction."""
        try:
            self._execute("COMMIT")
        except self._error as error:
            failure = self._failure(error)
            if self.is_lost and not self._sqlite:
                raise StoreUnavailable(
                    f"{failure}; whether the transaction was stored is not known: see what the latest one is"
                ) from error
            raise failure from error
        self.in_transaction = False
        # data_version does not tell of this connection's own commits
        self._memory.clear()

    def rollback(self) -> None:
        """Roll the transaction back; a connection that is lost has done so already."""
        self.in_transaction = False
        if self.is_lost:
            return
        self._execute, self._cursor = self.driver.execute, self.driver.cursor
        try:
            # after some errors (a full disk) SQLite has rolled back by itself
            if not self._sqlite or self.driver.in_transaction:
                self._execute("ROLLBACK")
        except self._error:
            # whatever the reason is: a connection that is dropped has no transaction any more
            self.is_lost = True

    # -- errors -----------------------------------------------------------------------------------------------

    def _failure(self, error: Exception) -> StoreUnavailable:
        """What to raise for an error of the driver."""
        failure = unavailable(error, self._store, self._busy_timeout)
        if self._sqlite:
            self.is_lost = self.is_lost or _code(error) in _LASTING
            if self.in_transaction and not self.is_lost and not self.driver.in_transaction:
                self._refuse(f"{failure}; the transaction was rolled back")
        elif self.driver.closed:
            self.is_lost = True
        if self.is_lost:
            self._refuse(str(failure))
        return failure

    def _refuse(self, why: str) -> None:
        """From here on refuse every statement."""

        def refuse(*_: object, **__: object) -> Any:
            raise StoreUnavailable(why)

        self._execute = self._cursor = refuse

    # -- the connection ---------------------------------------------------------------------------------------

    def configure(self, settings: Mapping[str, Any], *, restore: bool) -> None:
        """Change settings of the connection; with `restore`, they are as before when it is given back."""
        try:
            for name, value in settings.items():
                if restore:
                    self._settings_before[name] = self._setting(name)
                self._set(name, value)
        except self._error as error:
            raise self._failure(error) from error

    def _setting(self, name: str) -> Any:
        if self._sqlite:
            return self._execute(f"PRAGMA {name}").fetchone()[0]
        return self._execute("SELECT current_setting(%s)", (name,)).fetchone()[0]

    def _set(self, name: str, value: Any) -> None:
        if self._sqlite:
            self._execute(f"PRAGMA {name} = {value}").fetchone()
        else:
            self._execute("SELECT set_config(%s, %s, false)", (name, str(value)))

    def _open_file(self) -> str | None:
        """The path of the file that SQLite has open; None where it has none."""
        try:
            files = {name: path for _, name, path in self._execute("PRAGMA database_list").fetchall()}
        except self._error as error:
            raise self._failure(error) from error
        return files["main"] or None

    def has_moved(self) -> bool:
        """Whether its file is not to be found any more where it was opened; SQLite would not notice."""
        return self.file is not None and self.file != _file_at(self.path)

    def is_alive(self) -> bool:
        """Whether the connection can be used: what a server says unasked, or that it is gone, has arrived by now."""
        if self._sqlite or self.in_transaction:
            return True
        try:
            # never waits; once for what the server said, and once more for the end of the connection
            self.driver.pgconn.consume_input()
            self.driver.pgconn.consume_input()
        except self._error:
            self.is_lost = True
        return not self.is_lost

    def close(self, *, give_back: bool) -> None:
        """Close the connection, or give it back to the pool of the caller's engine as it was."""
        if self._is_closed:
            return
        self._is_closed = True
        if give_back and not self.is_lost:
            try:
                for name, value in self._settings_before.items():
                    self._set(name, value)
            except self._error:
                self.is_lost = True
        if not give_back or self.is_lost:
            self._connection.invalidate()
        self._connection.close()

    @property
    def has_unsettled(self) -> bool:
        """Whether a transaction is under way that has written something."""
        return self.in_transaction and self._has_written

    def leave_to_parent(self, *, close: bool) -> None:
        """In a forked child: never speak to the parent's server; `close` a file that nobody uses in this process."""
        self._is_closed = self.is_lost = True
        self._refuse("this process was forked with this transaction open, which stays with the parent; begin another")
        # otherwise the pool would close it when it is collected
        self._connection.detach()
        if close:
            self.driver.close()
        else:
            _inherited.append(self.driver)


def _file_at(path: str | None) -> tuple[int, int] | None:
    """Which file is at a path now."""
    if path is None:
        return None
    try:
        found = os.stat(path)
    except OSError:
        return None
    return found.st_dev, found.st_ino


def unavailable(error: BaseException, store: str, busy_timeout: float) -> StoreUnavailable:
    """What to raise for an error of a driver: what happened, in which store, and what to do."""
    # PostgreSQL's have several lines
    reason = " ".join(str(error).split()) or type(error).__name__
    code = _code(error)
    if code in _LOCKED or getattr(error, "sqlstate", None) == _LOCK_NOT_AVAILABLE:
        return StoreUnavailable(
            f"{store} has been locked by others for more than {busy_timeout:g} s ({reason}); try again, find out who "
            "holds the lock, or open it with a longer busy_timeout"
        )
    if code in _DAMAGED:
        return StoreUnavailable(f"{store} is damaged, or no SQLite database ({reason}); restore it from a backup")
    if code == sqlite3.SQLITE_READONLY:
        return StoreUnavailable(f"{store}: {reason}; to ask it without writing, open it with read_only=True")
    if isinstance(error, sqlite3.Error):
        return StoreUnavailable(f"{store}: {reason}; what was committed before is intact")
    return StoreUnavailable(f"{store}: {reason}; what was committed before is intact, the next call goes on")


def _code(error: BaseException) -> int:
    """SQLite's primary result code; 0 for other errors."""
    extended: int = getattr(error, "sqlite_errorcode", 0)
    return extended & 0xFF
