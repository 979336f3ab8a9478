"""One statement for the head of a knowledge base and all that holds at a time: one trip to a server, and one row.

A row for each assertion would take the server and psycopg a third of the time of the whole state. So the assertions of
a knowledge type come as one value of bytes: how many there are, the numbers of each in the server's binary format, and
column by column their texts, each ended by a zero, which no text has.
"""

from collections.abc import Sequence
from functools import cache, lru_cache
from struct import Struct
from typing import Any, NamedTuple

import sqlalchemy as sa

from kbstore.messages import KnowledgeType
from kbstore.storage import tables
from kbstore.storage.assertion_queries import HEAD_COLUMNS, for_kind
from kbstore.storage.connection import SqlRow
from kbstore.storage.statements import KB, Statement

Kinds = tuple[KnowledgeType, ...]

_COUNT = Struct(">q")

_FORMATS = (
    (sa.BigInteger, "q", sa.func.int8send),
    (sa.SmallInteger, "h", sa.func.int2send),
    (sa.Boolean, "?", sa.func.boolsend),
    (sa.Double, "d", sa.func.float8send),
)
"""How numbers are packed: the type of their column, its letter for `struct`, and the server's function."""


class _Layout(NamedTuple):
    """How the assertions of a knowledge type are packed.

    Attributes:
        columns: the names of all columns.
        senders: the server's function for each column of numbers.
        texts: the names of the other columns.
        numbers: the format of the numbers of an assertion.
    """

    columns: tuple[str, ...]
    senders: dict[str, Any]
    texts: tuple[str, ...]
    numbers: Struct


@cache
def _layout(kind: KnowledgeType) -> _Layout:
    table = tables.assertion_tables[kind]
    columns = ("timeline_id", "initial_time", "is_negative", *table.info[tables.OWN])
    formats = {
        name: (letter, sender)
        for name in columns
        for of_type, letter, sender in _FORMATS
        if isinstance(table.c[name].type, of_type)
    }
    return _Layout(
        columns,
        {name: sender for name, (_, sender) in formats.items()},
        tuple(name for name in columns if name not in formats),
        Struct(">" + "".join(letter for letter, _ in formats.values())),
    )


@lru_cache(maxsize=1 << len(KnowledgeType))
def whole_state(kinds: Kinds) -> Statement:
    """Return the statement for the head, and the assertions of some knowledge types that hold at :t, on PostgreSQL."""
    heads = tables.heads.c
    head = [heads[name] for name in HEAD_COLUMNS]
    # subqueries, not joins, which it would have to plan
    return Statement(
        lambda dialect: sa.select(*head, *(_packed(dialect, kind) for kind in kinds)).where(heads.kb_id == KB)
    )


def _packed(dialect: str, kind: KnowledgeType) -> Any:
    """Return the value for the assertions of a knowledge type; null if there are none."""
    layout = _layout(kind)
    rows = for_kind[kind].holding.core(dialect).subquery(f"holding_{int(kind)}").c
    numbers = [sender(rows[name]) for name, sender in layout.senders.items()]
    texts = [sa.func.textsend(rows[name]).concat(_bytes("\\x00")) for name in layout.texts]
    parts = [sa.func.int8send(sa.func.count()), _joined(_concatenated(numbers)), *map(_joined, texts)]
    return sa.select(_concatenated(parts)).scalar_subquery().label(f"packed_{int(kind)}")


def _joined(value: Any) -> Any:
    return sa.func.string_agg(value, _bytes(""))


def _concatenated(values: Sequence[Any]) -> Any:
    first, *others = values
    for value in others:
        first = first.concat(value)
    return first


def _bytes(text: str) -> Any:
    return sa.literal_column(f"CAST('{text}' AS bytea)")


def split(rows: Sequence[SqlRow], kinds: Kinds) -> tuple[SqlRow | None, dict[KnowledgeType, list[SqlRow]]]:
    """Return the head's row (None if there is none), and the rows of `AssertionQueries.holding` by knowledge type."""
    if not rows:
        return None, {kind: [] for kind in kinds}
    width = len(HEAD_COLUMNS)
    return rows[0][:width], {kind: _unpacked(data, kind) for kind, data in zip(kinds, rows[0][width:], strict=True)}


def _unpacked(data: bytes | None, kind: KnowledgeType) -> list[SqlRow]:
    if data is None:
        return []
    layout = _layout(kind)
    (count,) = _COUNT.unpack_from(data)
    end = _COUNT.size + count * layout.numbers.size
    rows = layout.numbers.iter_unpack(memoryview(data)[_COUNT.size : end])
    if not layout.texts:
        return list(rows)
    columns: dict[str, Sequence[Any]] = dict(zip(layout.senders, zip(*rows, strict=True), strict=True))
    texts = data[end:].decode().split("\0")
    columns |= {name: texts[place * count : (place + 1) * count] for place, name in enumerate(layout.texts)}
    return list(zip(*(columns[name] for name in layout.columns), strict=True))
