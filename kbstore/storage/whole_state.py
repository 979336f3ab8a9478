"""One statement for the head of a knowledge base and all that holds at a time: one trip to a server."""

import json
from collections.abc import Iterable
from functools import lru_cache
from itertools import groupby
from operator import itemgetter
from typing import Any

import sqlalchemy as sa

from kbstore.messages import KnowledgeType
from kbstore.storage import tables
from kbstore.storage.assertion_queries import HEAD_COLUMNS, for_kind
from kbstore.storage.connection import SqlRow
from kbstore.storage.statements import KB, Statement, constant

Kinds = tuple[KnowledgeType, ...]

_HEAD = -1
"""The value in the place of the knowledge type that marks the head's row."""

_kind_of = itemgetter(0)


@lru_cache(maxsize=1 << len(KnowledgeType))
def whole_state(kinds: Kinds) -> Statement:
    """Return the statement for the head, and the assertions of some knowledge types that hold at :t, on PostgreSQL."""
    return Statement(lambda dialect: _union(dialect, kinds))


def _union(dialect: str, kinds: Kinds) -> Any:
    heads = tables.heads.c
    head = sa.cast(sa.func.json_build_array(*(heads[name] for name in HEAD_COLUMNS)), sa.TEXT)
    branches = [
        sa.select(
            constant(_HEAD), heads.last_number, heads.last_time, sa.false(), *_own(kinds, None, None), head
        ).where(heads.kb_id == KB)
    ]
    for kind in kinds:
        rows = for_kind[kind].holding.core(dialect).subquery(f"holding_{int(kind)}")
        common = (rows.c.timeline_id, rows.c.initial_time, rows.c.is_negative)
        branches.append(sa.select(constant(int(kind)), *common, *_own(kinds, kind, rows), sa.cast(sa.null(), sa.TEXT)))
    return sa.union_all(*branches)


def _own(kinds: Kinds, of: KnowledgeType | None, rows: Any) -> list[Any]:
    """Return the own columns of all knowledge types, one after another; only those of the type `of` have values."""
    return [
        rows.c[column] if kind is of else sa.cast(sa.null(), tables.assertion_tables[kind].c[column].type)
        for kind in kinds
        for column in tables.assertion_tables[kind].info[tables.OWN]
    ]


def split(rows: Iterable[SqlRow], kinds: Kinds) -> tuple[SqlRow | None, dict[KnowledgeType, list[SqlRow]]]:
    """Return the head's row (None if there is none), and the rows of `AssertionQueries.holding` by knowledge type."""
    getters = _getters(kinds)
    head: SqlRow | None = None
    found: dict[KnowledgeType, list[SqlRow]] = {kind: [] for kind in kinds}
    # the server may give the parts in any order
    for kind, part in groupby(rows, _kind_of):
        if kind == _HEAD:
            head = tuple(json.loads(next(part)[-1]))
        else:
            found[kind].extend(map(getters[kind], part))
    return head, found


@lru_cache(maxsize=1 << len(KnowledgeType))
def _getters(kinds: Kinds) -> dict[KnowledgeType, "itemgetter[Any]"]:
    """Return for each knowledge type a function that picks its columns from a row."""
    getters, place = {}, 4
    for kind in kinds:
        width = len(tables.assertion_tables[kind].info[tables.OWN])
        getters[kind] = itemgetter(1, 2, 3, *range(place, place + width))
        place += width
    return getters
