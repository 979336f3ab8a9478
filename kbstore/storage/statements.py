"""SQL statements: SQLAlchemy Core constructs, compiled once for each dialect to the text that its driver takes.

Statements run on the driver's own cursor (`kbstore.storage.connection`): executing a Core construct takes about 70
microseconds, where looking one row up takes three. Constructs that Core lacks are here: arrays as parameters, and
hints that name the index for SQLite.
"""

from collections.abc import Callable, Mapping
from typing import Any, Final

import sqlalchemy as sa
from sqlalchemy.dialects import postgresql, sqlite
from sqlalchemy.dialects.postgresql.base import PGTypeCompiler
from sqlalchemy.dialects.sqlite.base import SQLiteCompiler
from sqlalchemy.ext.compiler import compiles
from sqlalchemy.sql.compiler import SQLCompiler
from sqlalchemy.sql.elements import ColumnElement
from sqlalchemy.sql.functions import FunctionElement


class _Compiler(SQLiteCompiler):
    """Makes SQLite join in the order in which joins are written, and use the index that a hint names."""

    # SQLite's own would write OFFSET, too
    limit_clause = SQLCompiler.limit_clause

    def get_from_hint_text(self, table: Any, text: Any) -> Any:
        return text

    def visit_join(self, join: Any, asfrom: bool = False, from_linter: Any = None, **options: Any) -> str:
        left, right = (self.process(side, asfrom=True, **options) for side in (join.left, join.right))
        words = "LEFT JOIN" if join.isouter else "CROSS JOIN"
        return f"{left} {words} {right} ON {self.process(join.onclause, **options)}"


class _TypeCompiler(PGTypeCompiler):
    """Writes types as SQLAlchemy does, but without the host's compile rules: parameters are cast to generic types."""

    def process(self, type_: Any, **options: Any) -> str:
        meant = type_._variant_mapping.get(self.dialect.name, type_)
        return str(getattr(self, f"visit_{meant.__visit_name__}")(meant, **options))


def _dialects(sqlite_style: Any, postgresql_style: Any) -> dict[str, sa.Dialect]:
    own: sa.Dialect = sqlite.dialect(paramstyle=sqlite_style)
    own.statement_compiler = _Compiler
    other: sa.Dialect = postgresql.dialect(paramstyle=postgresql_style)  # type: ignore[no-untyped-call]
    other.type_compiler_instance = _TypeCompiler(other)
    return {"sqlite": own, "postgresql": other}


_NAMED: Final = _dialects("named", "pyformat")
_POSITIONAL: Final = _dialects("qmark", "format")

Construct = sa.ClauseElement | Callable[[str], Any]
"""A Core construct; or, if the dialects need different ones, a function from the name of the dialect to one."""


class Statement:
    """One SQL statement, with named parameters; compiled for a dialect when it is first used.

    Attributes:
        sqlite: the text for sqlite3.
        postgresql: the text for psycopg.
    """

    __slots__ = ("_construct", "_in_schemas", "postgresql", "sqlite")

    sqlite: str
    postgresql: str

    def __init__(self, construct: Construct) -> None:
        self._construct = construct
        self._in_schemas: dict[str, str] = {}

    def __getattr__(self, name: str) -> str:
        # a slot that is not filled yet
        if name not in _NAMED:
            raise AttributeError(name)
        text = str(self._compiled(name))
        setattr(self, name, text)
        return text

    def in_schema(self, schema: str) -> str:
        """Return the text for psycopg, on the tables of a schema."""
        text = self._in_schemas.get(schema)
        if text is None:
            place = {"schema_translate_map": {None: schema}, "render_schema_translate": True}
            text = self._in_schemas[schema] = str(self._compiled("postgresql", **place))
        return text

    def _compiled(self, dialect: str, **place: Any) -> Any:
        return self.core(dialect).compile(dialect=_NAMED[dialect], **place)

    def core(self, dialect: str) -> Any:
        """Return the construct for a dialect."""
        made = self._construct
        return made if isinstance(made, sa.ClauseElement) else made(dialect)


class Lookup(Statement):
    """A statement whose parameters are given in the order in which they occur: the shortest way to one row.

    Attributes:
        names: the parameters in that order, as often as they occur.
    """

    __slots__ = ("names",)

    def __init__(self, construct: Construct, *names: str) -> None:
        super().__init__(construct)
        self.names = names

    def _compiled(self, dialect: str, **place: Any) -> Any:
        compiled = self.core(dialect).compile(dialect=_POSITIONAL[dialect])
        assert tuple(compiled.positiontup) == self.names
        return compiled if dialect == "sqlite" else super()._compiled(dialect, **place)


class BulkStatement(Statement):
    """A statement that is run for many rows, given as sequences, which takes less time than a name for each value.

    Attributes:
        columns: the names of a row's values in their order: first the columns that the statement sets, in the order of
            the table, then those by which it finds the row.
    """

    __slots__ = ("columns",)

    def __init__(self, construct: Construct, *columns: str) -> None:
        super().__init__(construct)
        self.columns = columns

    @classmethod
    def adding(cls, table: sa.Table, *columns: str, ignoring: bool = False) -> "BulkStatement":
        """Return a statement that adds rows with some columns, or all; with `ignoring`, existing rows are skipped."""
        return cls(
            lambda dialect: insert(dialect, table).on_conflict_do_nothing() if ignoring else table.insert().inline(),
            *(column.name for column in table.columns if not columns or column.name in columns),
        )

    @classmethod
    def changing(cls, table: sa.Table, *columns: str, key: Mapping[str, str]) -> "BulkStatement":
        """Return a statement that sets columns of the rows with a key; `key` maps its columns to parameters."""
        which = sa.and_(*(table.c[column] == sa.bindparam(name) for column, name in key.items()))
        return cls(
            table.update().where(which).values({name: sa.bindparam(name) for name in columns}),
            *(column.name for column in table.columns if column.name in columns),
            *key.values(),
        )

    @classmethod
    def deleting(cls, table: sa.Table, *, key: Mapping[str, str]) -> "BulkStatement":
        """Return a statement that deletes the rows with a key, which is as in `changing`."""
        which = sa.and_(*(table.c[column] == sa.bindparam(name) for column, name in key.items()))
        return cls(table.delete().where(which), *key.values())

    def _compiled(self, dialect: str, **place: Any) -> Any:
        compiled = self.core(dialect).compile(dialect=_POSITIONAL[dialect], column_keys=self.columns, **place)
        assert tuple(compiled.positiontup) == self.columns
        return compiled


def insert(dialect: str, table: sa.Table) -> Any:
    """Return an INSERT that can have an ON CONFLICT."""
    return (sqlite if dialect == "sqlite" else postgresql).insert(table).inline()


def parameter(name: str) -> sa.BindParameter[Any]:
    """Return a named parameter of a statement."""
    return sa.bindparam(name)


KB: Final = parameter("kb")
"""The knowledge base that a statement is about."""


def between(column: Any, after: str = "after", upto: str = "upto") -> ColumnElement[bool]:
    """Return the condition that a column is after one parameter, and up to another."""
    return sa.and_(column > parameter(after), column <= parameter(upto))


def constant(number: int) -> ColumnElement[Any]:
    """Return a number as text in the statement: databases match the condition of a partial index by it."""
    return sa.literal_column(str(number))


class _Array(FunctionElement[Any]):
    """An array parameter as a table. On SQLite it is JSON."""

    inherit_cache = True
    name = "array"

    def __init__(self, name: str) -> None:
        super().__init__(sa.bindparam(name))


@compiles(_Array, "sqlite")
def _json_each(element: _Array, compiler: Any, **options: Any) -> str:
    return f"json_each({compiler.process(element.clauses, **options)})"


@compiles(_Array, "postgresql")
def _unnest(element: _Array, compiler: Any, **options: Any) -> str:
    ordinality = " WITH ORDINALITY" if element._with_ordinality else ""
    return f"unnest(CAST({compiler.process(element.clauses, **options)} AS bigint[])){ordinality}"


def each(dialect: str, name: str) -> Any:
    """Return an array parameter of numbers as a table, and its columns: the value, and the place from 0 on."""
    if dialect == "sqlite":
        found = _Array(name).table_valued("value", "key", name="value")
        return found, found.c.value, found.c.key
    # PostgreSQL names the column of a function like its table
    found = _Array(name).table_valued("value", with_ordinality="ordinality", name="value")
    return found, found.c.value, found.c.ordinality - constant(1)


class _Keys(FunctionElement[Any]):
    """An array parameter of pairs of numbers as a table, in JSON on both engines."""

    inherit_cache = True
    name = "keys"

    def __init__(self, name: str) -> None:
        super().__init__(sa.bindparam(name))


@compiles(_Keys, "sqlite")
def _json_pairs(element: _Keys, compiler: Any, **options: Any) -> str:
    return f"json_each({compiler.process(element.clauses, **options)})"


@compiles(_Keys, "postgresql")
def _json_pairs_unnested(element: _Keys, compiler: Any, **options: Any) -> str:
    return f"json_array_elements(CAST({compiler.process(element.clauses, **options)} AS json))"


def each_pair(dialect: str, name: str) -> Any:
    """Return a parameter, a JSON array of pairs of numbers, as a table, and its two columns."""
    found = _Keys(name).table_valued("value", name="value")
    if dialect == "sqlite":
        return found, *(sa.func.json_extract(found.c.value, sa.literal_column(f"'$[{n}]'")) for n in (0, 1))
    return found, *(sa.cast(found.c.value.op("->>")(constant(n)), sa.BIGINT) for n in (0, 1))


class among(ColumnElement[bool]):
    """The condition that a column has one of the values of an array parameter.

    On SQLite it is an IN on purpose: for a join SQLite would, after ANALYZE, build a Bloom filter and scan the index.
    """

    inherit_cache = False
    type = sa.Boolean()
    # SQLite has no booleans, and would compare it with 1
    _is_implicitly_boolean = True

    def __init__(self, column: Any, name: str, element: str = "bigint") -> None:
        self.column = column
        self.values = parameter(name)
        self.element = element

    @property
    def _from_objects(self) -> Any:
        return self.column._from_objects


@compiles(among, "sqlite")
def _in_json(element: among, compiler: Any, **options: Any) -> str:
    column, values = (compiler.process(part, **options) for part in (element.column, element.values))
    return f"{column} IN (SELECT value FROM json_each({values}))"


@compiles(among, "postgresql")
def _is_any(element: among, compiler: Any, **options: Any) -> str:
    column, values = (compiler.process(part, **options) for part in (element.column, element.values))
    return f"{column} = ANY(CAST({values} AS {element.element}[]))"


class vacuum(sa.ClauseElement):
    """A VACUUM ANALYZE of some tables on PostgreSQL: frees the space of deleted rows, and renews the statistics."""

    def __init__(self, *on: sa.Table) -> None:
        self.tables = on


@compiles(vacuum)
def _vacuum(element: vacuum, compiler: Any, **options: Any) -> str:
    return f"VACUUM ANALYZE {', '.join(compiler.process(table, asfrom=True, **options) for table in element.tables)}"
