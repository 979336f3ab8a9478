"""The results as tables."""

from collections.abc import Sequence
from dataclasses import dataclass

from rich.console import Console
from rich.table import Table


@dataclass(frozen=True)
class Result:
    """One comparison.

    Attributes:
        what: what was measured.
        with_what: what it is compared with.
        ours: kbstore's figure, in `unit`.
        theirs: the other's.
        bar: the greatest acceptable ratio; None if there is none.
    """

    what: str
    with_what: str
    ours: float
    theirs: float
    bar: float | None = None
    unit: str = "s"

    @property
    def ratio(self) -> float:
        """The figure of kbstore divided by the other's."""
        return self.ours / self.theirs

    @property
    def verdict(self) -> str:
        """Whether the bar is met."""
        if self.bar is None:
            return ""
        return "yes" if self.ratio <= self.bar else "NO"

    def __str__(self) -> str:
        ours, theirs = amount(self.ours, self.unit), amount(self.theirs, self.unit)
        return f"{self.what}: {ours}, {self.with_what}: {theirs}, ratio {self.ratio:.2f}"


@dataclass(frozen=True)
class Missing:
    """A comparison that could not be made, and why."""

    what: str
    why: str

    def __str__(self) -> str:
        return f"{self.what}: {self.why}"


_HEADINGS = ("what", "against", "kbstore", "other", "ratio", "bar", "met")


def show(results: Sequence[Result | Missing], console: Console, title: str) -> None:
    """Print one table."""
    table = Table(title=f"{title}: lower quartiles of one run, side by side")
    for heading in _HEADINGS:
        table.add_column(heading, justify="left" if heading in _HEADINGS[:2] else "right", overflow="fold")
    for result in results:
        table.add_row(*_cells(result))
    console.print(table)


def _cells(result: Result | Missing) -> tuple[str, ...]:
    if isinstance(result, Missing):
        return (result.what, result.why, "", "", "", "", "")
    return (
        result.what,
        result.with_what,
        amount(result.ours, result.unit),
        amount(result.theirs, result.unit),
        f"{result.ratio:.2f}" if result.ratio >= 0.1 else f"{result.ratio:.3f}",
        "" if result.bar is None else f"{result.bar:g}",
        result.verdict,
    )


def amount(figure: float, unit: str) -> str:
    """Format a figure with a unit that suits its size.

    >>> amount(0.00042, "s"), amount(163.2, "bytes")
    ('420 us', '163 bytes')
    """
    if unit != "s":
        return f"{figure:,.0f} {unit}" if figure >= 10 else f"{figure:.2f} {unit}"
    for name, factor in (("s", 1.0), ("ms", 1e3), ("us", 1e6)):
        if figure * factor >= 1:
            return f"{figure * factor:.3g} {name}"
    return f"{figure * 1e9:.3g} ns"
