"""The one look of all tables: a heading, a line, aligned columns, nothing cut off."""

from collections.abc import Iterable

from rich import box
from rich.console import Console, Group, RenderableType
from rich.table import Table
from rich.text import Text

Cell = str | Text

TITLE, DIM, FALSE, SCHEDULED, NUMBER = "bold", "dim", "red", "cyan", "green"
"""Styles by what they mean; what they say must be in the words, too, as colours are for terminals only."""


def table(title: str, headings: Iterable[str], rows: Iterable[Iterable[Cell]]) -> RenderableType:
    """A table with a title; headings that begin with ``>`` are of columns set to the right."""
    grid = Table(box=box.SIMPLE_HEAD, pad_edge=False, show_edge=False, header_style=DIM)
    for heading in headings:
        right = heading.startswith(">")
        grid.add_column(heading.removeprefix(">"), justify="right" if right else "left", overflow="fold")
    for row in rows:
        grid.add_row(*(cell if isinstance(cell, Text) else Text(cell) for cell in row))
    return Group(Text(title, TITLE), grid) if title else grid


def sections(*found: RenderableType | None) -> Group:
    """Several parts, one below the other with an empty line between; None is left out."""
    parts = [part for part in found if part is not None]
    return Group(*(piece for index, part in enumerate(parts) for piece in ((Text(), part) if index else (part,))))


def printable(text: str) -> str:
    r"""Free text on one line, without anything that a terminal would obey.

    >>> printable("a\x1b[31m\n b")
    'a\\x1b[31m b'
    """
    words = " ".join(text.split())
    return words if words.isprintable() else "".join(c if c.isprintable() else repr(c)[1:-1] for c in words)


def plural(count: int, noun: str, many: str = "") -> str:
    """A count with its noun.

    >>> plural(1, "fact"), plural(2, "fact"), plural(0, "entry", "entries")
    ('1 fact', '2 facts', '0 entries')
    """
    return f"{count:,} {noun if count == 1 else many or noun + 's'}"


def show(console: Console, *found: RenderableType) -> None:
    """Print, without the blanks that fill up lines: what is piped into a file or another program has none to strip."""
    with console.capture() as capture:
        console.print(*found, sep="\n")
    console.file.write("\n".join(line.rstrip() for line in capture.get().split("\n")))
