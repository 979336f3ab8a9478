"""The arguments of facts and functions, one by one, as expressions of SQLAlchemy."""

from typing import Any

from sqlalchemy import ColumnElement, FromClause, Text
from sqlalchemy.ext.compiler import compiles
from sqlalchemy.sql.compiler import SQLCompiler
from sqlalchemy.sql.functions import GenericFunction


class _Word(GenericFunction[str]):
    """The word of a text at a position, counted from 0."""

    type = Text()
    inherit_cache = True
    name = "kbstore_word"


@compiles(_Word, "sqlite")
def _word_on_sqlite(element: _Word, compiler: SQLCompiler, **options: Any) -> str:
    # no name has a quote or a backslash in it (rule D3), so that the words are a JSON array
    text, position = (compiler.process(part, **options) for part in element.clauses)
    return f"""json_extract('["' || replace({text}, ' ', '","') || '"]', '$[' || {position} || ']')"""


@compiles(_Word, "postgresql")
def _word_on_postgresql(element: _Word, compiler: SQLCompiler, **options: Any) -> str:
    text, position = (compiler.process(part, **options) for part in element.clauses)
    return f"nullif(split_part({text}, ' ', {position} + 1), '')"


def argument(of: FromClause, position: int) -> ColumnElement[str]:
    """Return one argument of the facts or functions of a view or of `timelines`.

    In the views it is spelled as it was first written, in `timelines` as it is compared: in lower case.

    Args:
        of: `fact_history`, `function_history`, `current_facts`, `current_functions`, `timelines`, or an alias of one.
        position: 1 for the first argument; the result is NULL if there are fewer arguments.

    Raises `ValueError` for a table without arguments, and for a position that is not a number from 1 on.
    """
    if not isinstance(position, int) or position < 1:
        raise ValueError(f"the position of an argument is 1 for the first and 2 for the second, not {position!r}")
    if "arguments" in of.c:
        return _Word(of.c.arguments, position - 1)
    # the key of `symbols` is a name
    if "key" in of.c and "arity" not in of.c:
        return _Word(of.c.key, position)
    name = getattr(of, "name", "this selectable")
    raise ValueError(
        f"{name} has no arguments: join sql.timelines (kb_id = timelines.kb_id and timeline_id = timelines.id), which "
        "has them, or read a view such as sql.fact_history"
    )
