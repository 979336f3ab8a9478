"""The directory of a store: its knowledge bases by name."""

import secrets
from typing import NamedTuple

from kbstore.storage import queries
from kbstore.storage.connection import StoreConnection


class Entry(NamedTuple):
    """A knowledge base: its number in this store, and what was chosen when it was created."""

    kb: int
    use_unknowns: bool


def names(connection: StoreConnection) -> list[str]:
    """The names of the knowledge bases in a store, in order."""
    return [row[0] for row in connection.all(queries.knowledge_base_names, {})]


def find(connection: StoreConnection, name: str) -> Entry | None:
    """The knowledge base of a name; None if there is none."""
    row = connection.first(queries.find_knowledge_base, {"name": name})
    return None if row is None else Entry(row[0], bool(row[1]))


def create(connection: StoreConnection, name: str, *, use_unknowns: bool) -> tuple[Entry, bool]:
    """The knowledge base of a name, made if there is none; and whether it is new. In a write transaction."""
    while True:
        # a number that another server's knowledge bases do not have either, as rows move between servers
        wanted = {"id": secrets.randbelow(2**31 - 1) + 1, "name": name, "use_unknowns": use_unknowns}
        is_new = connection.run(queries.add_knowledge_base, wanted) == 1
        found = find(connection, name)
        if found is not None:
            if is_new:
                connection.run(queries.add_head, {"kb": found.kb})
            return found, is_new
