"""The directory of a store: its knowledge bases by name."""

import secrets
from typing import NamedTuple

from kbstore.storage import queries
from kbstore.storage.connection import StoreConnection


class Entry(NamedTuple):
    """A knowledge base: its number in this store, and whether its world is open (`use_unknowns`)."""

    kb: int
    use_unknowns: bool


def names(connection: StoreConnection) -> list[str]:
    """Return the names of the knowledge bases in a store, in order."""
    return [row[0] for row in connection.all(queries.knowledge_base_names, {})]


def find(connection: StoreConnection, name: str) -> Entry | None:
    """Return the knowledge base with a name; None if there is none."""
    row = connection.first(queries.find_knowledge_base, {"name": name})
    return None if row is None else Entry(row[0], bool(row[1]))


def create(connection: StoreConnection, name: str, *, use_unknowns: bool) -> tuple[Entry, bool]:
    """Return the knowledge base with a name, created if there is none, and whether it is new.

    It has to be called in a write transaction.
    """
    while True:
        # random: unlikely to be that of another server's knowledge base, as rows move between servers
        wanted = {"id": secrets.randbelow(2**31 - 1) + 1, "name": name, "use_unknowns": use_unknowns}
        is_new = connection.run(queries.add_knowledge_base, wanted) == 1
        found = find(connection, name)
        if found is not None:
            if is_new:
                connection.run(queries.add_head, {"kb": found.kb})
            return found, is_new
