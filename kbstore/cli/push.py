"""Copies of knowledge bases in other stores: ``push``, ``db adopt``."""

from typing import Annotated

import typer

import kbstore
from kbstore.cli.options import Json, Kb, Url, named, reading, store
from kbstore.cli.output import answer, console, json_line, working
from kbstore.report.tables import plural, show
from kbstore.transfer.push import adopt as adopt_copy


def push(
    to: Annotated[
        str,
        typer.Option(
            "--to", metavar="URL", help="The store to push to: an SQLite file, or a SQLAlchemy URL.", show_default=False
        ),
    ],
    other: Annotated[
        str | None, typer.Option("--as", metavar="NAME", help="Its name there (default: the same).", show_default=False)
    ] = None,
    follow: Annotated[bool, typer.Option("--follow", help="Go on as it is written to, until Ctrl-C.")] = False,
    url: Url = None,
    kb: Kb = None,
    as_json: Json = False,
) -> None:
    """Continue a knowledge base in another store, exactly once: a robot's in a server for the fleet.

    From the first push on nothing else is written to the copy. If interrupted, run the command again to continue.
    With --follow, print a line for each push; a server that cannot be reached any more is tried again.

    Examples:
        kbstore push --url robot.db --to fleet.db
        kbstore push --url robot.db --to postgresql://server/fleet --follow
    """
    with reading(url, kb, None) as found:
        if follow:
            lines = _PushLines(found.name if other is None else other, as_json=as_json)
            kbstore.push(found, to, other, follow=True, progress=lines)
            return
        with working(f"pushing {found.name}") as progress:
            done = kbstore.push(found, to, other, progress=progress)
    sentence = (
        f"{done.name} is there up to transaction {done.number}: {plural(done.transactions, 'transaction')} pushed"
    )
    answer(done, as_json=as_json, view=lambda: sentence)


def adopt(url: Url = None, kb: Kb = None, as_json: Json = False) -> None:
    """Make a copy that kbstore push has written an original, which is written to here. Later pushes are refused.

    Examples:
        kbstore db adopt --url fleet.db --kb kenny
    """
    place = store(url)
    name = named(kb, kbstore.knowledge_bases(place), place)
    source = adopt_copy(place, name)
    sentence = f"{name} is written to here from now on; it was a copy of {source}"
    answer({"name": name, "source": source}, as_json=as_json, view=lambda: sentence)


class _PushLines:
    """A progress callback that prints a line whenever the last transaction of the copy, or of the source, changes."""

    def __init__(self, name: str, *, as_json: bool) -> None:
        self._name = name
        self._as_json = as_json
        self._last: tuple[int, int] | None = None

    def __call__(self, number: int, latest: int) -> None:
        if (number, latest) == self._last:
            return
        self._last = number, latest
        if self._as_json:
            json_line({"name": self._name, "number": number, "latest": latest})
        else:
            show(console(), f"{self._name}: transaction {number:,} of {latest:,}")
