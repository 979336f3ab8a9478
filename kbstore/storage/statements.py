"""SQL text: each statement is written once, and has a form for SQLite and one for PostgreSQL."""

import re

_NAMED = re.compile(r"(?<![:\w]):(\w+)")
_EACH = re.compile(r"EACH\((\w+) AS (\w+)\)")
_AMONG = re.compile(r"AMONG\(([\w.]+), (\w+)\)")
_BY = re.compile(r" BY\((\w+)\)")


class Statement:
    """One SQL statement in both dialects, with parameters written ``:name``.

    ``EACH(names AS text)`` is a table with the column ``value`` of what the array parameter holds, and
    ``AMONG(node, path)`` says that a column has one of the numbers of the array parameter. On SQLite that is an IN
    on purpose: a join gets a Bloom filter after ANALYZE, and the whole index is scanned. ``BY(index)`` after a table
    names the index that SQLite takes whatever it guesses. ``postgresql`` is given where it needs other words.
    """

    __slots__ = ("postgresql", "sqlite")

    def __init__(self, sql: str, postgresql: str | None = None) -> None:
        sqlite = _AMONG.sub(r"\1 IN (SELECT value FROM json_each(:\2))", sql)
        sqlite = _EACH.sub(r"json_each(:\1)", sqlite).replace(" FOR UPDATE", "")
        self.sqlite = _BY.sub(r" INDEXED BY \1", sqlite)
        other = _AMONG.sub(r"\1 = ANY(CAST(:\2 AS bigint[]))", sql if postgresql is None else postgresql)
        other = _EACH.sub(r"unnest(CAST(:\1 AS \2[])) AS each_row(value)", other)
        self.postgresql = _NAMED.sub(r"%(\1)s", _BY.sub("", other))


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

    def __init__(self, table: str, *columns: str, conflict: str = "") -> None:
        sql = f"INSERT INTO {table} ({', '.join(columns)}) VALUES "
        also = conflict and f" ON CONFLICT {conflict}"
        self.sqlite = f"{sql}({', '.join('?' * len(columns))}){also}"
        self.postgresql = f"{sql}({', '.join(['%s'] * len(columns))}){also}"
