"""Reads the record as relations: facts, numbers, runs and transactions, with the column names of the SQL views."""

import csv
import io
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import TYPE_CHECKING

from kbstore.clock import SECOND, TimeLike, isoformat
from kbstore.errors import InvalidKnowledge
from kbstore.messages import Fact, Function
from kbstore.model.results import AsOf, Assertion, Run, Transaction
from kbstore.model.timelines import moved

if TYPE_CHECKING:
    from kbstore.report.source import RecordSource

Cell = str | int | float | bool | None
Row = tuple[Cell, ...]


class Kind(StrEnum):
    """The kind of a column's cells; a `TIME` is nanoseconds since 1970."""

    TEXT = "text"
    INTEGER = "integer"
    NUMBER = "number"
    FLAG = "flag"
    TIME = "time"


@dataclass(frozen=True)
class DataTable:
    """Named columns, each of one kind, and rows; an empty cell is None."""

    columns: tuple[tuple[str, Kind], ...]
    rows: Sequence[Row]


_ATOM = (("name", Kind.TEXT), ("arguments", Kind.TEXT))
_RECORD = (
    ("initial_time", Kind.TIME),
    ("end_time", Kind.TIME),
    ("recorded_tx", Kind.INTEGER),
    ("recorded_time", Kind.TIME),
    ("recorded_client", Kind.TEXT),
    ("ended_tx", Kind.INTEGER),
    ("ended_client", Kind.TEXT),
    ("cancelled_tx", Kind.INTEGER),
    ("cancelled_client", Kind.TEXT),
    ("superseded_tx", Kind.INTEGER),
    ("superseded_client", Kind.TEXT),
)
COLUMNS = {
    "facts": (("fact", Kind.TEXT), *_ATOM, ("is_negative", Kind.FLAG), *_RECORD),
    "numbers": (
        ("function", Kind.TEXT),
        *_ATOM,
        ("value", Kind.NUMBER),
        ("rate", Kind.NUMBER),
        ("end_value", Kind.NUMBER),
        *_RECORD,
    ),
    "runs": (
        ("action", Kind.TEXT),
        ("operator", Kind.TEXT),
        ("arguments", Kind.TEXT),
        ("started", Kind.TIME),
        ("expected_end", Kind.TIME),
        ("ended", Kind.TIME),
        ("outcome", Kind.TEXT),
        ("duration_s", Kind.NUMBER),
        ("forced", Kind.TEXT),
        ("broken", Kind.TEXT),
        ("started_tx", Kind.INTEGER),
        ("ended_tx", Kind.INTEGER),
    ),
    "transactions": (
        ("number", Kind.INTEGER),
        ("recorded_time", Kind.TIME),
        ("client", Kind.TEXT),
        ("note", Kind.TEXT),
        ("changes", Kind.INTEGER),
    ),
}
"""The columns of each relation."""


def relation(
    kb: "RecordSource",
    of: str,
    pattern: str | None = None,
    since: TimeLike | None = None,
    until: TimeLike | None = None,
    as_of: AsOf | None = None,
) -> DataTable:
    """Read facts, numbers, runs or transactions of a span; arguments and errors are those of `KnowledgeBase.frame`."""
    if of not in COLUMNS:
        raise InvalidKnowledge(f"there is no table {of!r:.80}; give one of {', '.join(COLUMNS)}")
    since = kb.history_from if since is None else since
    rows: Iterator[Row]
    if of == "transactions":
        if pattern is not None:
            raise InvalidKnowledge(f"transactions have no pattern, but {pattern!r:.80} was given; leave it out")
        rows = map(_transaction, kb.transactions(since, until, as_of))
    elif of == "runs":
        rows = map(_run, kb.runs(pattern, since, until, as_of))
    else:
        found = kb.history(pattern, since, until, as_of)
        rows = _facts(found) if of == "facts" else _numbers(found)
        if pattern is not None:
            _refuse_others(pattern, found, of)
    return DataTable(COLUMNS[of], list(rows))


def csv_text(found: DataTable) -> str:
    """Return a relation as CSV (RFC 4180) with headings: times as ISO 8601 with nine decimals, nothing for None."""
    file = io.StringIO()
    out = csv.writer(file)
    kinds = [kind for _, kind in found.columns]
    out.writerow(name for name, _ in found.columns)
    out.writerows([_text(cell, kind) for cell, kind in zip(row, kinds, strict=True)] for row in found.rows)
    return file.getvalue()


def nine_decimals(t: int) -> str:
    """Write a time in nanoseconds as ISO 8601 in UTC with nine decimals, so that texts sort by time.

    >>> nine_decimals(1_500_000_000)
    '1970-01-01T00:00:01.500000000Z'
    """
    return f"{isoformat(t // SECOND * SECOND)[:-1]}.{t % SECOND:09d}Z"


def end_value(found: Assertion) -> float | None:
    """Return the value of a number at the end of its assertion (rule C7); None while that is open."""
    item = found.item
    if not isinstance(item, Function) or found.end_time is None:
        return None
    return moved(item.function_value or 0.0, item.rate, found.end_time - found.initial_time)


def _text(cell: Cell, kind: Kind) -> str:
    if cell is None:
        return ""
    if kind is Kind.TIME:
        return nine_decimals(int(cell))
    return str(cell).lower() if kind is Kind.FLAG else str(cell)


def _refuse_others(pattern: str, found: Sequence[Assertion], of: str) -> None:
    kind = Fact if of == "facts" else Function
    other = next((each.item for each in found if not isinstance(each.item, kind)), None)
    if other is not None:
        advice = (
            "of='numbers'" if isinstance(other, Function) else "of='facts'" if isinstance(other, Fact) else "kb.history"
        )
        raise InvalidKnowledge(f"{pattern} matches {other}, which is not among the {of}; ask with {advice}")


def _facts(found: Sequence[Assertion]) -> Iterator[Row]:
    for each in found:
        item = each.item
        if isinstance(item, Fact):
            yield str(item), item.attribute_name, " ".join(item.arguments), bool(item.is_negative), *_record(each)


def _numbers(found: Sequence[Assertion]) -> Iterator[Row]:
    for each in found:
        item = each.item
        if isinstance(item, Function):
            values = (item.function_value, item.rate, end_value(each))
            yield str(item.atom), item.attribute_name, " ".join(item.arguments), *values, *_record(each)


def _record(found: Assertion) -> Row:
    by = (found.ended, found.cancelled, found.superseded)
    ends = [cell for tx in by for cell in ((None, None) if tx is None else (tx.number, tx.client))]
    recorded = found.recorded
    return found.initial_time, found.end_time, recorded.number, recorded.time, recorded.client, *ends


def _run(run: Run) -> Row:
    return (
        run.action,
        run.operator,
        " ".join(run.arguments),
        run.started,
        run.expected_end,
        run.ended,
        run.outcome,
        run.seconds,
        "; ".join(run.forced) or None,
        "; ".join(map(str, run.broken)) or None,
        run.started_by,
        run.ended_by,
    )


def _transaction(found: Transaction) -> Row:
    return found.number, found.time, found.client, found.note, found.changes
