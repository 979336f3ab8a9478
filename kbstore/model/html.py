"""Tables in HTML, as notebooks show answers."""

from collections.abc import Iterable, Sequence
from html import escape
from itertools import islice

LONGEST = 200
"""Rows of a part that are shown; the number of the others follows."""

Row = Sequence[object]


def table(title: str, header: Sequence[str], parts: Iterable[tuple[str, Sequence[Row]]]) -> str:
    """Return a table of rows in parts, each under its name; empty parts are left out."""
    lines = ["<table>", f"<caption>{escape(title)}</caption>"]
    lines += ["<thead>", _row("th", header), "</thead>"]
    for name, rows in parts:
        if not rows:
            continue
        lines.append("<tbody>")
        if name:
            lines.append(f'<tr><th colspan="{len(header)}">{escape(name)} ({len(rows)})</th></tr>')
        lines += [_row("td", row) for row in islice(rows, LONGEST)]
        if len(rows) > LONGEST:
            lines.append(f'<tr><td colspan="{len(header)}">and {len(rows) - LONGEST} more</td></tr>')
        lines.append("</tbody>")
    lines.append("</table>")
    return "\n".join(lines)


def _row(cell: str, values: Iterable[object]) -> str:
    shown = ("" if value is None else escape(str(value)) for value in values)
    return "<tr>" + "".join(f"<{cell}>{value}</{cell}>" for value in shown) + "</tr>"
