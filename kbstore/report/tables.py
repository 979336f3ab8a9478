"""Tables for a terminal: a heading, a line, aligned columns; on a narrow one, lines. Nothing is cut off."""

from collections.abc import Iterable, Iterator, Sequence

from rich import box
from rich.cells import cell_len
from rich.console import Console, ConsoleOptions, Group, JustifyMethod, RenderableType, RenderResult
from rich.padding import Padding
from rich.table import Table
from rich.text import Text

Cell = str | Text

_GAP = 3
"""Characters between two columns."""

_NARROWEST = 20
"""The width in characters to which a column may be folded."""

_FOLDED = 2
"""The number of columns, the widest first, that may be folded."""

TITLE, DIM, FALSE, SCHEDULED, NUMBER = "bold", "dim", "red", "cyan", "green"
"""Styles by their meaning, which the words must have, too, as colours are for terminals only."""


class _Rows:
    """Rows under headings, as wide as there is room for: as a table, or each row on lines of its own."""

    def __init__(self, headings: Sequence[str], rows: Sequence[Sequence[Text]]) -> None:
        self._headings = headings
        self._rows = rows

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        widths = [
            max(cell_len(heading.removeprefix(">")), *(cell.cell_len for cell in column), 0)
            for heading, column in zip(self._headings, zip(*self._rows, strict=True), strict=True)
        ]
        widest = sorted(range(len(widths)), key=lambda index: -widths[index])
        for count in range(1, _FOLDED + 1):
            folded = widest[:count]
            narrowest = sum(min(width, _NARROWEST) if index in folded else width for index, width in enumerate(widths))
            if narrowest + _GAP * (len(widths) - 1) <= options.max_width:
                yield self._table(folded)
                return
        yield from self._stacked()

    def _table(self, folded: Sequence[int]) -> Table:
        """Return the rows in columns, some of which may be folded."""
        grid = Table(box=box.SIMPLE_HEAD, pad_edge=False, show_edge=False, header_style=DIM)
        for index, heading in enumerate(self._headings):
            right = heading.startswith(">")
            justify: JustifyMethod = "right" if right else "left"
            grid.add_column(heading.removeprefix(">"), justify=justify, overflow="fold", no_wrap=index not in folded)
        for row in self._rows:
            grid.add_row(*row)
        return grid

    def _stacked(self) -> Iterator[RenderableType]:
        """Yield each row: its first cell on a line, and below it the others that are not empty, with headings."""
        for first, *others in self._rows:
            yield first
            line = Text()
            for heading, cell in zip(self._headings[1:], others, strict=True):
                if cell:
                    line.append(", " if line else "").append(heading.removeprefix(">"), DIM)
                    line.append(" " if heading else "").append_text(cell)
            yield Padding(line, (0, 0, 0, 4), expand=False)


def table(title: str, headings: Sequence[str], rows: Iterable[Iterable[Cell]]) -> RenderableType:
    """Return rows with a title; a heading that begins with ``>`` sets its column to the right."""
    texts = [[cell if isinstance(cell, Text) else Text(cell) for cell in row] for row in rows]
    shown = _Rows(headings, texts)
    return Group(Text(title, TITLE), shown) if title else shown


def sections(*found: RenderableType | None) -> Group:
    """Join parts, one below the other with an empty line between; None is left out."""
    parts = [part for part in found if part is not None]
    return Group(*(piece for index, part in enumerate(parts) for piece in ((Text(), part) if index else (part,))))


def printable(text: str) -> str:
    r"""Return free text on one line, with escapes for everything that a terminal would obey.

    >>> printable("a\x1b[31m\n b")
    'a\\x1b[31m b'
    """
    words = " ".join(text.split())
    return words if words.isprintable() else "".join(c if c.isprintable() else repr(c)[1:-1] for c in words)


def plural(count: int, noun: str, many: str = "") -> str:
    """Return a count with its noun.

    >>> plural(1, "fact"), plural(2, "fact"), plural(0, "entry", "entries")
    ('1 fact', '2 facts', '0 entries')
    """
    return f"{count:,} {noun if count == 1 else many or noun + 's'}"


def show(console: Console, *found: RenderableType) -> None:
    """Print without the blanks that fill up lines, so that files and other programs need not strip them."""
    with console.capture() as capture:
        console.print(*found, sep="\n")
    console.file.write("\n".join(line.rstrip() for line in capture.get().split("\n")))
