"""Fills the tables of docs/performance.md: its rows sum up results in the words that a user decides by."""

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import NamedTuple

from benchmarks.report import Missing, Result, amount

Results = Sequence[Result | Missing]


class Row(NamedTuple):
    """A row of a table: what was measured, beside what, and the results that it sums up.

    `results` is a regular expression for all of the text "what; against" of a result.
    """

    what: str
    beside: str
    results: str


_RAW_FETCH = "fetching its 1,000 rows from a table of their own"
_POINT = "a prepared point query"
_TEN = "fetching ten rows"
_SAME = "the same"

TABLES: Mapping[str, Sequence[Row]] = {
    "Asking": (
        Row(
            "`holds` or `value` now, nobody wrote meanwhile",
            "`PRAGMA data_version`",
            r"(holds|value) now.*; PRAGMA data_version",
        ),
        Row("a condition now, nobody wrote meanwhile", _SAME, r"condition now, nobody wrote; .*"),
        Row("a condition now with a number that moves", _POINT, r"condition now, with a number that moves; .*"),
        Row(
            "a condition after a write to another knowledge base of the file",
            _SAME,
            r"condition.*, after a write elsewhere.*; .*",
        ),
        Row("a condition after a write to its own knowledge base", _SAME, r"condition, after each write.*; .*"),
        Row(
            "`exists`, or a pattern such as `(robot_at r1 ?)`, nobody wrote meanwhile",
            _SAME,
            r"(exists|pattern), .*, now; .*",
        ),
        Row("the same after each write", _SAME, r"(exists|pattern), .*, after each write; .*"),
        Row("`holds` at t, an item or text", f"{_POINT} that knows its row", r"holds at t, (prepared|PDDL).*; raw .*"),
        Row(
            "a question on a `State` at hand, same text",
            "`dict.get` in a function",
            r"question on a state.*, same text; .*",
        ),
        Row("state at t, and one question", _RAW_FETCH, r"state at t and one question, [a-z ]+, [\d,]+; raw .*"),
        Row("the same past state, asked again", _SAME, r"state at t .*, asked again, .*; raw .*"),
        Row("state at t, 1,000 facts as messages", _SAME, r"state at t, all of it as messages, .*; .*"),
        Row(
            "10 of 1,110 rows: `propositions(name)`, `instances(type)`, `goals()` and the like, nobody wrote",
            _TEN,
            r"(?!.*after each).*, of 1,110 rows; .*",
        ),
        Row("the same after each write", _SAME, r".*, after each write, of 1,110 rows; .*"),
        Row("`when`, a fact with 1,000 changes", "fetching its rows", r"when, 1,000 changes; .*"),
        Row("`when`, 3 of its 100,000 changes", "fetching all of its rows", r"when, three of 100,000 changes; .*"),
        Row("`import kbstore`", "`import sqlalchemy, pydantic`", r"import kbstore; .*"),
        Row("the command `kbstore holds`", "both imports, and one select", r"kbstore holds \(a select\); .*"),
    ),
    "Writing": (
        Row("single durable add", "the same rows by `sqlite3`, with the same settings", r"single durable add; raw, .*"),
        Row('the same, `durability="normal"`', _SAME, r'single add, durability="normal"; raw, .*'),
        Row(
            "replacing 200 of 1,000 values in a transaction",
            "the same rows, ready-made",
            r"replace 200 values .*1,000,000; .*",
        ),
        Row("replacing all 1,000", _SAME, r"replace 1,000 values .*1,000,000; .*"),
        Row(
            "50,000 new facts at once, as items",
            "`executemany` of the same rows, ready-made",
            r"bulk .* as items; .*rows",
        ),
        Row("the same, as PDDL text", _SAME, r"bulk .* as texts; .*rows"),
        Row("the same, as items", "`executemany` into one table with one index", r"bulk .* as items; .*one index"),
        Row(
            "loading a problem of 100,000 facts", "`executemany` of the same rows", r"load, 100,000 init facts; .*rows"
        ),
    ),
    "PostgreSQL": (
        Row("`holds` at t", _POINT, r"PostgreSQL: holds at t, .*; psycopg.*"),
        Row(
            "`holds` now, nobody wrote, with notifications",
            _SAME,
            r"PostgreSQL: holds now, nobody wrote, .*; psycopg.*",
        ),
        Row("state at t, and one question, 10^5", "fetching its rows", r"PostgreSQL: state at t and .*; psycopg.*"),
        Row("single durable add", "the same rows by psycopg", r"PostgreSQL: single durable add; psycopg.*"),
        Row("10,000 new facts at once", _SAME, r"PostgreSQL: bulk .*; psycopg.*"),
    ),
    "Growth": (
        Row("state at t and one question, 10^5 assertions", "10^4", r"growth of state at t, .*, 100,000; .*"),
        Row("the same, 10^6", "10^5", r"growth of state at t, .*, 1,000,000; .*"),
        Row("replacing 200 or 1,000 values, 10^6", "10^5, as it grows for the bare statements", r"growth of repl.*"),
        Row("memory while 10^6 facts are ingested", "after half of them", r"memory .*; when half.*"),
        Row(
            "bytes for each assertion with all indexes, facts that flip", "a goal of 160", r"bytes .*(uniform|skewed).*"
        ),
        Row("the same, objects that come and go, whose names are never used twice", _SAME, r"bytes .*passing.*"),
    ),
}
"""The tables of the page, by heading."""

PEERS = {
    "DuckDB": "DuckDB, a table of intervals",
    "SQLAlchemy-Continuum": "SQLAlchemy-Continuum, `validity`",
    "eventsourcing": "eventsourcing, snapshots every 500 events",
    "PostgreSQL's WITHOUT OVERLAPS": "PostgreSQL 18, `WITHOUT OVERLAPS`, beside kbstore on PostgreSQL",
}
"""The rows of the table of peers, by what results are against."""

_COMPARED = {
    "state at t": r"(PostgreSQL: )?state at t and one question, uniform, .*",
    "one fact at t": r"(PostgreSQL: )?holds at t(, uniform, .*)?",
    "single durable write": r"(PostgreSQL: )?single durable write",
    "10,000 new facts": r"(PostgreSQL: )?[\d,]+ new facts at once",
}
"""The columns of the table of peers, each with what its results measure."""


def filled(page: str, tables: Mapping[str, Results]) -> tuple[str, list[str]]:
    """Return a page in which the first table below each heading is new, and the rows that nothing was measured for.

    A table with such a row stays as it is.
    """
    found = [result for results in tables.values() for result in results if isinstance(result, Result)]
    missing: list[str] = []
    for title, rows in TABLES.items():
        lines = [_line(row, found) for row in rows]
        lacking = [f"{title}: {row.what}" for row, line in zip(rows, lines, strict=True) if line is None]
        if not lacking:
            page = _with_table(page, title, _markdown(("what", "beside", "kbstore", "ratio"), 2, lines))
        missing += lacking
    against = {result.with_what for result in found}
    if against >= PEERS.keys():
        page = _with_table(page, "Peers", _markdown(("", *_COMPARED), 1, _peers(found)))
    else:
        missing += [f"Peers: {name}" for name in PEERS if name not in against]
    return page, missing


def _line(row: Row, found: Iterable[Result]) -> tuple[str, ...] | None:
    summed = [result for result in found if re.fullmatch(row.results, f"{result.what}; {result.with_what}")]
    if not summed:
        return None
    figures = sorted((result.ours, result.unit) for result in summed)
    ours = [amount(figure, unit) for figure, unit in (figures[0], figures[-1])]
    ratios = sorted(result.ratio for result in summed)
    return row.what, row.beside, _span(*ours), _span(_ratio(ratios[0]), _ratio(ratios[-1]))


def _span(first: str, last: str) -> str:
    """Return a range of figures; the unit is given once if it is the same."""
    if first == last:
        return first
    number, _, unit = first.partition(" ")
    return f"{number} to {last}" if unit == last.partition(" ")[2] else f"{first} to {last}"


def _ratio(ratio: float) -> str:
    return (
        f"{ratio:.0f}"
        if ratio >= 10
        else f"{ratio:.1f}"
        if ratio >= 2
        else f"{ratio:.2f}"
        if ratio >= 0.1
        else f"{ratio:.1g}"
    )


def _peers(found: Iterable[Result]) -> Iterator[tuple[str, ...]]:
    found = list(found)
    for name, label in PEERS.items():
        ratios = (
            [result.ratio for result in found if result.with_what == name and re.fullmatch(what, result.what)]
            for what in _COMPARED.values()
        )
        yield label, *(_ratio(max(each)) if each else "-" for each in ratios)


def _markdown(headings: Sequence[str], left: int, rows: Iterable[Sequence[str] | None]) -> str:
    ruler = ["---" if place < left else "---:" for place in range(len(headings))]
    return "".join(f"| {' | '.join(row)} |\n" for row in (headings, ruler, *rows) if row is not None)


def _with_table(page: str, title: str, table: str) -> str:
    """Return the page with another first table below a heading."""
    there = re.compile(rf"(^## {title}\n(?:(?!\||## ).*\n)*)(?:\|.*\n)+", re.MULTILINE)
    return there.sub(lambda found: found[1] + table, page, count=1)
