"""A connection to an SQLite store: its settings, its locks, and the file behind it."""

import json
import os
import sqlite3
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from operator import attrgetter
from typing import Any

from kbstore.storage import queries
from kbstore.storage.caches import AnswerCache
from kbstore.storage.connection import Options, Parameters, SqlRow, StoreConnection
from kbstore.storage.driver_errors import LASTING, sqlite_code
from kbstore.storage.statements import Lookup, Statement

_LOG_LIMIT = 64 * 1024 * 1024
"""Bytes to which the write-ahead log is cut back once its pages are in the file."""


_NOTHING = nullcontext()

_LOOK_AGAIN = 0.02
"""The most seconds for which a file that was deleted or replaced may still be read; it is never written to."""


class SqliteConnection(StoreConnection):
    """A connection to an SQLite store; with `lent`, one of the caller's, whose settings are restored."""

    is_local = True

    def __init__(self, driver: Any, options: Options, *, lent: bool = False, path: str | None = None) -> None:
        """`path` is that of the store's URL."""
        super().__init__(driver, options, sqlite3.Error, attrgetter("sqlite"))
        self._lent = lent
        self._before: dict[str, Any] = {}
        self._memory = AnswerCache()
        self._data_version = -1
        self._look_again = 0.0
        opened = self._open_file()
        self.file = file_at(opened)
        # a path that is relative, or a URI, may mean another file here; a link is to lead to this one from now on
        self.path = path if opened is not None and file_at(path) == self.file else opened

    # -- settings ---------------------------------------------------------------------------------------------

    def configure(self) -> None:
        """Set what kbstore needs; on a lent connection, the settings for writing follow when a writer begins."""
        settings: dict[str, Any] = {"busy_timeout": int(self.options.busy_timeout * 1000)}
        if self.options.read_only:
            settings["query_only"] = 1
        if not self._lent:
            # trusted_schema: views of a file from elsewhere must not run functions
            settings |= self._for_writing() | {"cache_size": -65536, "trusted_schema": 0}
            settings["journal_size_limit"] = _LOG_LIMIT
        self._set(settings)

    def _for_writing(self) -> dict[str, Any]:
        is_full = self.options.durability == "full"
        # on macOS only fullfsync waits for the disk itself
        return {"foreign_keys": 1, "synchronous": 2 if is_full else 1, "fullfsync": int(is_full)}

    def _set(self, settings: Mapping[str, Any]) -> None:
        try:
            for name, value in settings.items():
                if self._lent and name not in self._before:
                    self._before[name] = self._execute(f"PRAGMA {name}").fetchone()[0]
                self._execute(f"PRAGMA {name} = {value}").fetchone()
        except self._error as error:
            raise self._failure(error) from error

    def restore(self) -> None:
        """Restore the settings that were changed on a lent connection."""
        try:
            for name, value in self._before.items():
                self._execute(f"PRAGMA {name} = {value}").fetchone()
        except self._error:
            self.is_lost = True

    def use_write_ahead_log(self) -> None:
        """Put the file into WAL mode, in which readers and a writer don't wait for each other.

        If several connections do so at once, SQLite does not wait, in spite of its time-out; so it is tried again.
        """
        deadline = time.monotonic() + self.options.busy_timeout
        while True:
            try:
                self._execute("PRAGMA journal_mode = WAL").fetchone()
            except sqlite3.OperationalError as error:
                if sqlite_code(error) != sqlite3.SQLITE_BUSY or time.monotonic() >= deadline:
                    raise self._failure(error) from error
                time.sleep(0.01)
            else:
                return

    # -- statements -------------------------------------------------------------------------------------------

    def memory(self, kb: int) -> AnswerCache | None:
        """Return the answers cached on this connection, cleared first if another one has committed to `kb` since.

        None within a transaction. Only valid if nobody else writes on this very connection. Source:
        https://www.sqlite.org/pragma.html#pragma_data_version
        """
        if self.in_transaction:
            return None
        try:
            version: int = self._execute("PRAGMA data_version").fetchone()[0]
        except self._error as error:
            raise self._failure(error) from error
        if version != self._data_version:
            row = self.first(queries.last_token, {"kb": kb})
            token = 0 if row is None else row[0]
            if token != self._memory.token:
                self._memory.clear()
                self._memory.token = token
            self._data_version = version
        return self._memory

    lock_head = StoreConnection.first
    """Return the head's row: a writer has SQLite's single write lock already."""

    def announce(self, kb: int, number: int) -> None:
        """Do nothing: caches of answers detect commits by SQLite's `data_version`."""

    def be_patient(self) -> None:
        """Do nothing: a file has no deadline."""

    def look_up(self, statement: Lookup, *parameters: int) -> SqlRow | None:
        """Return the first row of a look-up; None if there is none."""
        try:
            row: SqlRow | None = self._execute(statement.sqlite, parameters).fetchone()
        except self._error as error:
            raise self._failure(error) from error
        return row

    def stream(self, statement: Statement, parameters: Parameters) -> Iterator[SqlRow]:
        """Yield the rows of a statement without holding all of them in memory; within a transaction."""
        try:
            yield from self._execute(statement.sqlite, parameters)
        except self._error as error:
            raise self._failure(error) from error

    def together(self) -> AbstractContextManager[None]:
        """Do nothing: there is no server to which statements would be sent together."""
        return _NOTHING

    def array(self, values: Sequence[Any]) -> str:
        """Return a JSON array, which ``json_each`` reads."""
        return json.dumps(values)

    def bounds(self, values: Sequence[int | None]) -> str:
        """Return a JSON array of numbers."""
        return json.dumps(values)

    # -- transactions -----------------------------------------------------------------------------------------

    def _beginning(self, *, write: bool) -> tuple[str, dict[str, Any]]:
        """Return the statement that begins a transaction; for writing, it takes SQLite's single write lock."""
        if write and self._lent:
            self._set(self._for_writing())
        return "BEGIN IMMEDIATE" if write else "BEGIN", {}

    def _committing(self) -> None:
        # data_version does not change by this connection's own commits
        self._memory.clear()
        self._memory.token = None

    def _must_roll_back(self) -> bool:
        # after some errors (a full disk) SQLite has rolled back by itself
        return bool(self.driver.in_transaction)

    def _note(self, error: Exception) -> None:
        self.is_lost = self.is_lost or sqlite_code(error) in LASTING

    def _has_rolled_back(self) -> bool:
        return not self.driver.in_transaction

    # -- the file ---------------------------------------------------------------------------------------------

    def _open_file(self) -> str | None:
        """Return the path of the file that SQLite has open; None in memory."""
        try:
            files = {name: path for _, name, path in self._execute("PRAGMA database_list").fetchall()}
        except self._error as error:
            raise self._failure(error) from error
        return files["main"] or None

    def database(self) -> object:
        """Return the file, by device and inode; in memory, the identity of the connection."""
        return self.file or id(self.driver)

    def has_moved(self) -> bool:
        """Return whether its file is not any more at the path where it was opened, which SQLite does not notice."""
        return self.file is not None and self.file != file_at(self.path)

    def was_moved(self) -> bool:
        """Return the same as `has_moved`, looking at the file at most every `_LOOK_AGAIN` seconds to save time."""
        now = time.monotonic()
        if now < self._look_again:
            return False
        if self.has_moved():
            return True
        self._look_again = now + _LOOK_AGAIN
        return False

    def abandon(self, *, close: bool) -> None:
        """Leave the connection to the parent, in a forked child; with `close`, close its file in this process.

        Closing must not checkpoint the write-ahead log, which is the parent's.
        """
        if close and hasattr(self.driver, "setconfig"):
            # from Python 3.12 on
            self.driver.setconfig(sqlite3.SQLITE_DBCONFIG_NO_CKPT_ON_CLOSE, True)  # type: ignore[attr-defined,unused-ignore]
        super().abandon(close=close)


def file_at(path: str | None) -> tuple[int, int] | None:
    """Return the file at a path, by device and inode; None if there is none."""
    if path is None:
        return None
    try:
        found = os.stat(path)
    except OSError:
        return None
    return found.st_dev, found.st_ino
