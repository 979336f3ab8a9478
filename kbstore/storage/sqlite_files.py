"""The files of an SQLite store: their paths, and advice for files in folders that SQLite cannot write to."""

import sqlite3
from pathlib import Path
from urllib.parse import quote, unquote, urlsplit

from sqlalchemy.engine import URL

from kbstore.errors import StoreUnavailable, one_line
from kbstore.storage.driver_errors import sqlite_code

_UNWRITABLE = (sqlite3.SQLITE_READONLY, sqlite3.SQLITE_CANTOPEN)

_IMMUTABLE = {"immutable": "1", "uri": "true"}


def file_of(url: URL) -> Path | None:
    """Return the file of an SQLite database; None in memory and for other databases."""
    database = url.database
    if url.get_backend_name() != "sqlite" or database in (None, "", ":memory:") or url.query.get("mode") == "memory":
        return None
    return Path(unquote(urlsplit(database).path) if database.startswith("file:") else database)


def refuse_half(url: URL) -> None:
    """Raise `StoreUnavailable` for a file to be read as immutable although a part of it is in a write-ahead log."""
    path = file_of(url)
    if path is not None and url.query.get("immutable", "0") not in ("0", "no", "off", "false") and _has_log(path):
        raise StoreUnavailable(
            f"{one_line(str(path))}: the latest transactions are in {one_line(path.name)}-wal, which SQLite does not "
            "read with immutable=1; open it without, or copy both files to where SQLite can write, and open the copy"
        )


def way_out(url: URL, error: BaseException) -> str:
    """Return what to do about a file that SQLite cannot open as it cannot write beside it; empty for other errors."""
    path = file_of(url)
    if path is None or sqlite_code(error) not in _UNWRITABLE or not path.exists():
        return ""
    why = "SQLite writes beside a file in WAL mode even to read it"
    if _has_log(path):
        return f"{why}, and the latest transactions are in {one_line(path.name)}-wal: copy both files to where it can"
    found = url.set(database=f"file:{quote(str(path.absolute()))}").update_query_dict(_IMMUTABLE)
    return (
        f"{why}; where that cannot be, and nobody else writes to the file, open it with read_only=True as "
        f"{found.render_as_string()}"
    )


def _has_log(path: Path) -> bool:
    log = path.with_name(f"{path.name}-wal")
    return log.exists() and log.stat().st_size > 0
