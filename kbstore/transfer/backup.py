"""Copies a whole store, consistently while writers go on, to an SQLite file, which can be opened and asked."""

import os
import sqlite3
from contextlib import closing
from pathlib import Path
from typing import Any

from kbstore.storage import directory
from kbstore.storage.database import Database
from kbstore.transfer.rows import Progress, RowSource, RowTarget, Steps, StoreLike, copy, new_file, opened

_PAGES = 2000
"""The number of pages of an SQLite file copied between two calls of the progress callback."""


def backup(url: StoreLike, path: str | os.PathLike[str], *, progress: Progress | None = None) -> Path:
    """Copy a store to a new SQLite file, as it is at one moment, while others go on reading and writing.

    An SQLite file is copied whole; from a PostgreSQL database, all knowledge bases are copied. The copy is a store like
    any other: open it, or restore a knowledge base from it with `export_knowledge_base` and `import_knowledge_base`.

    Args:
        url: the store.
        path: the new file, which must not exist yet; it appears when it is complete and on the disk, or not at all.
        progress: called repeatedly with how much is copied, and of how much (pages of an SQLite file, else rows).

    Returns:
        The path.

    Raises:
        StoreUnavailable: the store cannot be reached, or the file cannot be written.
        InvalidKnowledge: the file exists.
    """
    target = Path(path)
    with opened(url) as database, new_file(target) as partial:
        if database.dialect == "sqlite":
            _copy_file(database, partial, progress)
        else:
            _copy_rows(database, partial, progress)
    return target


def _copy_file(database: Database, path: Path, progress: Progress | None) -> None:
    def report(_status: int, left: int, total: int) -> None:
        if progress is not None:
            progress(total - left, total)

    # within a transaction all steps copy the same snapshot; without one, a writer would make the copy begin again
    with database.read() as session, closing(sqlite3.connect(path)) as copied:
        try:
            session.driver.execute("SELECT count(*) FROM sqlite_master").fetchone()
            session.driver.backup(copied, pages=_PAGES, progress=report)
            _make_single_file(copied)
        except sqlite3.Error as error:
            # mostly the disk of the new file is full
            raise OSError(str(error)) from error


def _copy_rows(database: Database, path: Path, progress: Progress | None) -> None:
    copied = Database(path)
    try:
        copied.ensure_schema(read_only=False)
        with database.read() as source, copied.begin() as target:
            source.be_patient()
            sources = [RowSource(source, name) for name in directory.names(source)]
            steps = Steps(progress, sum(sum(found.counts().values()) for found in sources))
            for found in sources:
                made = RowTarget(target, found.name, use_unknowns=found.use_unknowns)
                copy(found, made, steps)
                # the original remains the copy that pushes continue
                made.put_head(found.head._replace(source=None))
        with copied.connect() as session, copied.wrap_errors():
            _make_single_file(session.driver)
    finally:
        copied.close()


def _make_single_file(connection: Any) -> None:
    """Leave WAL mode, so that the copy is one file, and can be opened from a medium that is read-only."""
    connection.execute("PRAGMA journal_mode = DELETE").fetchone()
