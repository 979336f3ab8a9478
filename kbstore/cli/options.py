"""Options shared by all commands, and the knowledge base that they name."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Annotated

import typer

import kbstore
from kbstore.cli import completion
from kbstore.cli.commands import STORE
from kbstore.cli.times import parse_time
from kbstore.clock import Clock, ManualClock, SystemClock
from kbstore.errors import KbStoreError, StoreUnavailable
from kbstore.report.belief import named_transaction

if TYPE_CHECKING:
    from kbstore.knowledge_base import KnowledgeBase
    from kbstore.model.results import Transaction

TIMES = "TIME is ISO 8601 with an offset, now, -5m, +1h30m, or nanoseconds."


Url = Annotated[
    str | None,
    typer.Option(
        "--url",
        metavar="URL",
        help="The store: an SQLite file, or a SQLAlchemy URL. [KBSTORE_URL]",
        rich_help_panel=STORE,
        show_default=False,
    ),
]
Kb = Annotated[
    str | None,
    typer.Option(
        "--kb",
        metavar="NAME",
        help="The knowledge base; not needed if the store has only one. [KBSTORE_KB]",
        rich_help_panel=STORE,
        show_default=False,
        autocompletion=completion.names,
    ),
]
Now = Annotated[
    str | None,
    typer.Option(
        "--now",
        metavar="TIME",
        help="The time to take as now, for simulated clocks; last is the latest recorded time.",
        rich_help_panel=STORE,
        show_default=False,
    ),
]
Json = Annotated[bool, typer.Option("--json", help="Answer in JSON.", rich_help_panel=STORE, show_default=False)]

At = Annotated[str | None, typer.Option("--at", metavar="TIME", help=f"The time to ask about (default: now). {TIMES}")]
AsOf = Annotated[
    str | None,
    typer.Option("--as-of", metavar="TIME", help="Answer with what was believed at this time; after #12: tx12."),
]
Since = Annotated[
    str | None,
    typer.Option("--since", metavar="TIME", help=f"The beginning of the span (default: all history). {TIMES}"),
]
Until = Annotated[str | None, typer.Option("--until", metavar="TIME", help="The end of the span.")]
Starting = Annotated[
    str | None, typer.Option("--at", metavar="TIME", help=f"The time from which it holds (default: now). {TIMES}")
]
Operator = Annotated[
    str, typer.Argument(help="The name of an action of the domain.", autocompletion=completion.operators)
]
Arguments = Annotated[
    list[str] | None,
    typer.Argument(help="Its arguments, in order.", show_default=False, autocompletion=completion.arguments),
]
Condition = Annotated[
    str,
    typer.Argument(
        help="A fact or a condition in PDDL; ? matches any object.",
        metavar="CONDITION",
        autocompletion=completion.patterns,
    ),
]
LateSince = Annotated[
    str | None,
    typer.Option("--since", metavar="TIME", help="A time in the past since which it has held. " + TIMES),
]
LateUntil = Annotated[str | None, typer.Option("--until", metavar="TIME", help="With --since: until when it held.")]
Client = Annotated[str, typer.Option("--client", metavar="NAME", help="Who writes; recorded with the transaction.")]
Note = Annotated[str, typer.Option("--note", metavar="TEXT", help="Why; recorded with the transaction.")]


def store(url: str | None) -> str:
    """Return the store. Raises `StoreUnavailable` if none is named."""
    if not url:
        raise StoreUnavailable("which store? name it with --url FILE (or a SQLAlchemy URL), or set KBSTORE_URL")
    return url


@contextmanager
def reading(url: str | None, kb: str | None, now: str | None) -> Iterator["KnowledgeBase"]:
    """Open the knowledge base read-only. Raises `StoreUnavailable` if the store does not have it."""
    place = store(url)
    name = named(kb, kbstore.knowledge_bases(place), place)
    with kbstore.open(place, name, clock=clock_for(place, name, now), read_only=True) as found:
        yield found


@contextmanager
def writing(url: str | None, kb: str | None, now: str | None, *, creating: bool = True) -> Iterator["KnowledgeBase"]:
    """Open the knowledge base for writing, and create it if the store does not have it.

    Raises `StoreUnavailable` instead of `creating` it, and if the name is not clear.
    """
    place = store(url)
    try:
        names = kbstore.knowledge_bases(place)
    except KbStoreError:
        if not creating:
            raise
        # there is no store yet, or opening it for writing reports the error
        names = []
    name = kb if creating and kb else named(kb, names, place) if names or not creating else "default"
    with kbstore.open(place, name, clock=clock_for(place, name, now)) as found:
        yield found


def at_time(text: str | None, kb: "KnowledgeBase") -> int | None:
    """Return the time of an option in nanoseconds; None if it was not given."""
    return None if text is None else parse_time(text, kb.now())


def belief(text: str | None, kb: "KnowledgeBase") -> "int | Transaction | None":
    """Return the time, or the transaction (``tx12``), that --as-of names; None if it was not given."""
    return (None if text is None else named_transaction(text, kb)) or at_time(text, kb)


def named(name: str | None, names: list[str], place: str) -> str:
    """Return the name of a knowledge base of the store; without a name, of the only one. Raises `StoreUnavailable`."""
    if name is None and len(names) == 1:
        return names[0]
    if name in names:
        return name
    there = f"it has {', '.join(names)}" if names else "it has none yet"
    if name is None:
        raise StoreUnavailable(f"which knowledge base of {place}? {there}; name one with --kb, or set KBSTORE_KB")
    raise StoreUnavailable(f"there is no knowledge base {name!r} in {place}: {there}")


def clock_for(place: str, name: str, now: str | None) -> Clock:
    """Return the clock for --now: at that time, at the latest recorded time (last), or the system's."""
    if now is None:
        return SystemClock()
    if now != "last":
        return ManualClock(parse_time(now, SystemClock().now()))
    # with a clock at 0, now is the latest recorded time
    with kbstore.open(place, name, clock=ManualClock(), read_only=True) as kb:
        return ManualClock(kb.now())
