"""The mark of an archive in the header of its SQLite file: opening a store asks for it, and needs nothing else here."""

from typing import Final

import sqlalchemy as sa

from kbstore.storage.database import Database
from kbstore.storage.statements import Statement

ARCHIVE: Final = int.from_bytes(b"kbar")
"""The number in an SQLite file's header that marks it as an archive."""

mark_archive = Statement(sa.text(f"PRAGMA application_id = {ARCHIVE}"))

_application_id = Statement(sa.text("PRAGMA application_id"))


def is_archive(database: Database) -> bool:
    """Return whether a store is an archive, which ends at a time, and is not written to."""
    if database.dialect != "sqlite":
        return False
    return database.first(_application_id, {}) == (ARCHIVE,)
