"""Translates the drivers' errors to `StoreUnavailable`, with what happened and what to do."""

import sqlite3
from typing import Final

from kbstore.errors import StoreUnavailable

_LOCKED: Final = (sqlite3.SQLITE_BUSY, sqlite3.SQLITE_LOCKED, sqlite3.SQLITE_PROTOCOL)
_DAMAGED: Final = (sqlite3.SQLITE_CORRUPT, sqlite3.SQLITE_NOTADB)
LASTING: Final = (*_DAMAGED, sqlite3.SQLITE_IOERR, sqlite3.SQLITE_CANTOPEN, sqlite3.SQLITE_PROTOCOL)
"""SQLite's errors after which a connection is replaced by a new one."""

_LOCK_NOT_AVAILABLE: Final = "55P03"
"""PostgreSQL's error when `lock_timeout` is over."""

_PREPARED_ELSEWHERE: Final = ("26000", "42P05")
"""PostgreSQL's errors for a prepared statement that is not there, and for one that is there already."""


def unavailable(error: BaseException, store: str, busy_timeout: float) -> StoreUnavailable:
    """Return the error to raise for one of a driver: what happened, in which store, and what to do."""
    # PostgreSQL's messages have several lines
    reason = " ".join(str(error).split()) or type(error).__name__
    code = sqlite_code(error)
    if code in _LOCKED or getattr(error, "sqlstate", None) == _LOCK_NOT_AVAILABLE:
        return StoreUnavailable(
            f"{store} has been locked by others for more than {busy_timeout:g} s ({reason}); try again, find out who "
            "holds the lock, or open it with a longer busy_timeout"
        )
    if getattr(error, "sqlstate", None) in _PREPARED_ELSEWHERE:
        return StoreUnavailable(
            f"{store}: {reason}; a pooler between does not keep the prepared statements of its clients apart: leave "
            "prepare_threshold out of the URL"
        )
    if code in _DAMAGED:
        return StoreUnavailable(f"{store} is damaged, or not an SQLite database ({reason}); restore it from a backup")
    if code == sqlite3.SQLITE_READONLY:
        return StoreUnavailable(f"{store}: {reason}; to read it without writing, open it with read_only=True")
    if isinstance(error, sqlite3.Error):
        return StoreUnavailable(f"{store}: {reason}; what was committed before is intact")
    return StoreUnavailable(f"{store}: {reason}; what was committed before is intact, the next call goes on")


def sqlite_code(error: BaseException) -> int:
    """Return SQLite's primary result code of an error; 0 for other errors."""
    extended: int = getattr(error, "sqlite_errorcode", 0)
    return extended & 0xFF
