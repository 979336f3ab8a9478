"""Compares the objects of kbstore's schema in a database with those that the migrations make.

A store may come from elsewhere: a trigger would run in everybody's writes, a view in everybody's reads, and without an
index answers would take too long. On SQLite the statements that made the schema are compared by a hash, in one query;
only if that differs, columns, keys, indexes and views are compared one by one. On PostgreSQL the catalogue is read.
Objects that do not belong to kbstore's tables are ignored.
"""

import re
from collections.abc import Iterator
from hashlib import sha256
from typing import Any

import sqlalchemy as sa
from sqlalchemy.dialects import postgresql

from kbstore.storage import tables

VERSION_TABLE = "kbstore_alembic_version"
"""Not alembic's own default: a service that shares its database with kbstore may have migrations of its own."""

version_table = sa.Table(
    VERSION_TABLE,
    sa.MetaData(),
    sa.Column("version_num", sa.VARCHAR(32), nullable=False),
    sa.PrimaryKeyConstraint("version_num", name=f"{VERSION_TABLE}_pkc"),
)
"""As alembic makes it, with a type for which the host has no compile rule."""

VIEWS = (
    "transaction_log",
    "fact_history",
    "function_history",
    "instance_history",
    "goal_history",
    "current_facts",
    "current_functions",
    "current_instances",
    "current_goals",
    "run_history",
)
"""The views of the schema at its head."""

_NAMES = frozenset((*tables.metadata.tables, *VIEWS, VERSION_TABLE))

_HASH = "cdc20b245e33ed1c3982e187348f7339386cc254f546b33fcdb3ec6c6a31c896"
"""The hash of the statements that the migrations leave in an SQLite file."""


def statements_hash(connection: sa.Connection) -> str:
    """Return a hash of the statements that made kbstore's tables in an SQLite file, and all that belongs to them."""
    rows = sorted("\0".join(map(str, row)) for row in _of_sqlite(connection))
    return sha256("\0".join(rows).encode()).hexdigest()


def is_as_migrated(connection: sa.Connection) -> bool:
    """Return whether an SQLite file has, to the letter, the schema that the migrations make."""
    return statements_hash(connection) == _HASH


def _of_sqlite(connection: sa.Connection) -> list[Any]:
    found = connection.exec_driver_sql("SELECT type, name, tbl_name, sql FROM sqlite_master").all()
    return [row for row in found if row[2].lower() in _NAMES or row[1].lower() in _NAMES]


def in_sqlite(connection: sa.Connection) -> set[str]:
    """Return the objects of kbstore's schema in an SQLite file, each in a phrase."""
    return set(_phrases(connection))


def _phrases(connection: sa.Connection) -> Iterator[str]:
    for kind, name, table, sql in _of_sqlite(connection):
        quoted = name.replace("'", "''")
        if kind == "table":
            yield from (f"table {name} with a {word}" for word in ("CHECK", "COLLATE") if word in sql.upper())
            columns = connection.exec_driver_sql(f"SELECT * FROM pragma_table_xinfo('{quoted}')")
            for _, column, type_name, required, default, key, hidden in columns:
                more = f"{' NOT NULL' * required}{'' if default is None else f' DEFAULT {default}'}{' hidden' * hidden}"
                yield f"column {name}.{column} {type_name}{more}{f' in place {key} of the key' if key else ''}"
            references = connection.exec_driver_sql(f"SELECT * FROM pragma_foreign_key_list('{quoted}')")
            for _, _, other, column, referred, _, on_delete, _ in references:
                yield f"foreign key {name}.{column} to {other}.{referred} ON DELETE {on_delete}"
        elif kind == "index" and sql is not None:
            columns = connection.exec_driver_sql(
                f"SELECT name, \"desc\", coll FROM pragma_index_xinfo('{quoted}') WHERE key"
            )
            unique = " UNIQUE" * bool(re.match(r"\s*CREATE\s+UNIQUE", sql, re.IGNORECASE))
            _, _, where = sql.partition(" WHERE ")
            yield f"index {name} ON {table} {[tuple(column) for column in columns]}{unique} {where}".strip()
        elif kind == "view":
            yield f"view {name} AS {sha256(' '.join(sql.split()).encode()).hexdigest()[:12]}"
        elif kind == "trigger":
            yield f"trigger {name} on {table}"


# -- PostgreSQL ---------------------------------------------------------------------------------------------------

_CATALOGUE = sa.text(
    """
    WITH place AS (
      SELECT relnamespace FROM pg_class WHERE oid = to_regclass(:place)
    ), own AS (
      SELECT c.oid, c.relname, c.relkind, c.relpersistence, c.relrowsecurity
      FROM pg_class c JOIN place p ON c.relnamespace = p.relnamespace
      WHERE c.relname = ANY(:names)
    )
    SELECT CASE WHEN relpersistence <> 'p' THEN 'unlogged ' ELSE '' END
      || CASE WHEN relkind IN ('r', 'p') THEN 'table ' WHEN relkind = 'v' THEN 'view ' ELSE 'relation ' END || relname
      || CASE WHEN relrowsecurity AND row_security_active(oid) THEN ' of which this role sees some rows' ELSE '' END
    FROM own
    UNION ALL
    SELECT 'column ' || o.relname || '.' || a.attname || ' ' || format_type(a.atttypid, a.atttypmod)
      || CASE WHEN l.oid IS NULL THEN '' ELSE ' COLLATE "' || l.collname || '"' END
      || CASE WHEN a.attnotnull THEN ' NOT NULL' ELSE '' END || CASE WHEN a.atthasdef THEN ' DEFAULT' ELSE '' END
    FROM own o JOIN pg_attribute a ON a.attrelid = o.oid
    LEFT JOIN pg_collation l ON l.oid = a.attcollation AND l.collname <> 'default'
    WHERE a.attnum > 0 AND NOT a.attisdropped AND o.relkind <> 'v'
    UNION ALL
    SELECT 'index ' || i.relname || ' ON ' || o.relname || ' ('
      || (SELECT string_agg(coalesce(a.attname, '?'), ', ' ORDER BY k.place)
          FROM unnest(x.indkey::int[]) WITH ORDINALITY AS k(attnum, place)
          LEFT JOIN pg_attribute a ON a.attrelid = x.indrelid AND a.attnum = k.attnum AND k.attnum > 0)
      || ')' || CASE WHEN x.indisunique THEN ' UNIQUE' ELSE '' END
      || CASE WHEN x.indpred IS NULL THEN '' ELSE ' WHERE' END
      || CASE WHEN x.indisvalid AND x.indimmediate THEN '' ELSE ' that is invalid or deferred' END
    FROM own o JOIN pg_index x ON x.indrelid = o.oid JOIN pg_class i ON i.oid = x.indexrelid
    -- those that REINDEX CONCURRENTLY is building, or has left
    WHERE x.indisvalid OR i.relname !~ '_cc(new|old)[0-9]*$'
    UNION ALL
    SELECT CASE k.contype WHEN 'f' THEN 'foreign key ' ELSE 'constraint ' END || k.conname || ' of ' || o.relname
      || CASE WHEN k.contype = 'f' THEN ' to ' || coalesce(f.relname, 'another table') ELSE '' END
      || CASE WHEN k.confdeltype IN ('c', 'n', 'd') THEN ' that deletes or changes rows' ELSE '' END
    FROM own o JOIN pg_constraint k ON k.conrelid = o.oid LEFT JOIN own f ON f.oid = k.confrelid
    WHERE k.contype IN ('c', 'f', 'x')
    UNION ALL
    SELECT 'trigger ' || t.tgname || ' on ' || o.relname
    FROM own o JOIN pg_trigger t ON t.tgrelid = o.oid WHERE NOT t.tgisinternal
    UNION ALL
    SELECT 'rule ' || r.rulename || ' on ' || o.relname
    FROM own o JOIN pg_rewrite r ON r.ev_class = o.oid WHERE r.rulename <> '_RETURN'
    UNION ALL
    SELECT DISTINCT 'view ' || o.relname || ' that reads ' || coalesce(c.relname, f.proname, '?')
    FROM own o JOIN pg_rewrite r ON r.ev_class = o.oid
    JOIN pg_depend d ON d.classid = 'pg_rewrite'::regclass AND d.objid = r.oid
    LEFT JOIN pg_class c ON d.refclassid = 'pg_class'::regclass AND c.oid = d.refobjid
    LEFT JOIN pg_proc f ON d.refclassid = 'pg_proc'::regclass AND f.oid = d.refobjid
    WHERE o.relkind = 'v' AND (f.oid IS NOT NULL OR (c.oid IS NOT NULL AND c.oid NOT IN (SELECT oid FROM own)))
    """
)


def in_postgresql(connection: sa.Connection, schema: str | None) -> set[str]:
    """Return the objects of kbstore's schema in a PostgreSQL database, each in a phrase."""
    place = VERSION_TABLE if schema is None else f"{_quoted(schema)}.{VERSION_TABLE}"
    return set(connection.execute(_CATALOGUE, {"place": place, "names": sorted(_NAMES)}).scalars())


def for_postgresql() -> set[str]:
    """Return the objects that the migrations make on PostgreSQL, each in a phrase."""
    return set(_declared())


def _declared() -> Iterator[str]:
    yield from (f"view {name}" for name in VIEWS)
    for table in (version_table, *tables.metadata.sorted_tables):
        yield f"table {table.name}"
        for column in table.columns:
            yield f"column {table.name}.{column.name} {_type(column)}{'' if column.nullable else ' NOT NULL'}"
        keys = [
            found for found in table.constraints if isinstance(found, sa.PrimaryKeyConstraint | sa.UniqueConstraint)
        ]
        for key in keys:
            yield f"index {key.name} ON {table.name} ({', '.join(key.columns.keys())}) UNIQUE"
        for index in table.indexes:
            partial = index.dialect_options["postgresql"]["where"] is not None
            more = " UNIQUE" * bool(index.unique) + " WHERE" * partial
            yield f"index {index.name} ON {table.name} ({', '.join(index.columns.keys())}){more}"
        for reference in table.foreign_key_constraints:
            yield f"foreign key {reference.name} of {table.name} to {reference.referred_table.name}"


def _type(column: sa.Column[object]) -> str:
    name = column.type.compile(dialect=postgresql.dialect()).lower()  # type: ignore[no-untyped-call]
    name = re.sub(" collate .*", ' COLLATE "C"', name)
    return re.sub("^varchar", "character varying", name)


def _quoted(schema: str) -> str:
    return '"' + schema.replace('"', '""') + '"'


def differences(found: set[str], expected: set[str]) -> str:
    """Return in words which objects are missing or unexpected; empty if none are."""
    missing, more = sorted(expected - found), sorted(found - expected)
    parts = [f"it lacks {_listed(missing)}"] if missing else []
    parts += [f"it has {_listed(more)}"] if more else []
    return ", and ".join(parts)


def _listed(phrases: list[str], most: int = 3) -> str:
    shown = [" ".join(phrase.split(" ")[:2]) if phrase.startswith(("view", "index")) else phrase for phrase in phrases]
    return ", ".join(shown[:most]) + (f" and {len(shown) - most} more" if len(shown) > most else "")
