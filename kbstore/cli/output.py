"""Output: tables for people, JSON for programs, progress on standard error."""

import io
import json
import os
import pydoc
import re
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from rich.console import Console, RenderableType
from rich.progress import BarColumn, TaskProgressColumn, TextColumn, TimeElapsedColumn
from rich.progress import Progress as Bar

from kbstore.model.plain import plain
from kbstore.report.tables import show

if TYPE_CHECKING:
    from kbstore.transfer.rows import Progress

_NOT_SHOWN = re.compile(r"[^\n -~]")
"""Characters that may not be printable; JSON itself has escaped the other control characters."""

_UNLIMITED = 100_000
"""The width without a terminal, so that no line that a program reads is folded."""


def console() -> Console:
    """Return standard output; on a terminal it has colours, and is folded to its width."""
    found = Console(highlight=False, soft_wrap=False)
    if not found.is_terminal:
        found.width = _UNLIMITED
    return found


def answer(found: object, *, as_json: bool, view: Callable[[], RenderableType | str]) -> None:
    """Print an answer: as JSON, or as its view."""
    if as_json:
        sys.stdout.write(_dumps(found, indent=2) + "\n")
    else:
        _page(view())


def _page(view: RenderableType | str) -> None:
    """Print for people; if a terminal has too few lines, through the pager."""
    target = console()
    if not (target.is_terminal and sys.stdin.isatty()):
        show(target, view)
        return
    target.file = text = io.StringIO()
    show(target, view)
    if text.getvalue().count("\n") < target.height:
        sys.stdout.write(text.getvalue())
    else:
        os.environ.setdefault("LESS", "-R")  # colours are shown, not spelled
        pydoc.pager(text.getvalue())


def json_line(found: object) -> None:
    """Print an answer as one line of JSON, at once."""
    sys.stdout.write(_dumps(found) + "\n")
    sys.stdout.flush()


def _dumps(found: object, indent: int | None = None) -> str:
    """Write JSON with escapes for everything that a terminal would obey; letters of all scripts stay readable."""
    text = json.dumps(plain(found), ensure_ascii=False, indent=indent)
    return _NOT_SHOWN.sub(lambda found: found[0] if found[0].isprintable() else json.dumps(found[0])[1:-1], text)


@contextmanager
def working(what: str) -> Iterator["Progress"]:
    """Show a progress bar on a terminal, and yield its progress callback."""
    columns = (TextColumn("{task.description}"), BarColumn(), TaskProgressColumn(), TimeElapsedColumn())
    shown = Console(stderr=True)
    with Bar(*columns, console=shown, transient=True, disable=not shown.is_terminal) as bar:
        task = bar.add_task(what, total=None)
        yield lambda done, total: bar.update(task, completed=done, total=total)
