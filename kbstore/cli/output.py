"""Where answers go: tables for people, JSON for programs, and progress on standard error."""

import json
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.console import Console, RenderableType
from rich.progress import BarColumn, TaskProgressColumn, TextColumn, TimeElapsedColumn
from rich.progress import Progress as Bar

from kbstore.report import values
from kbstore.report.tables import show

Progress = Callable[[int, int], None]
"""Told how much is done, and of how much."""

_UNLIMITED = 100_000
"""The width where there is no terminal: no line is folded that another program is going to read."""


def console() -> Console:
    """Standard output: with colours and folded to its width if it is a terminal."""
    found = Console(highlight=False, soft_wrap=False)
    if not found.is_terminal:
        found.width = _UNLIMITED
    return found


def answer(found: object, *, as_json: bool, view: Callable[[], RenderableType | str]) -> None:
    """Print an answer: as JSON, or as its view."""
    if as_json:
        sys.stdout.write(json.dumps(values.plain(found), ensure_ascii=False, indent=2) + "\n")
    else:
        show(console(), view())


def json_line(found: object) -> None:
    """Print an answer as one line of JSON, at once."""
    sys.stdout.write(json.dumps(values.plain(found), ensure_ascii=False) + "\n")
    sys.stdout.flush()


@contextmanager
def working(what: str) -> Iterator[Progress]:
    """On a terminal, a bar while something is being done; what it yields is told how much is done, and of how much."""
    columns = (TextColumn("{task.description}"), BarColumn(), TaskProgressColumn(), TimeElapsedColumn())
    shown = Console(stderr=True)
    with Bar(*columns, console=shown, transient=True, disable=not shown.is_terminal) as bar:
        task = bar.add_task(what, total=None)
        yield lambda done, total: bar.update(task, completed=done, total=total)
