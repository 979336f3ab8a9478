"""SQL text: each statement is written once, and has a form for SQLite and one for PostgreSQL."""

import re

_NAMED = re.compile(r"(?<![:\w]):(\w+)")
_EACH = re.compile(r"EACH\((\w+) AS (\w+)\)")
_AMONG = re.compile(r"AMONG\((\w+), (\w+)\)")


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
