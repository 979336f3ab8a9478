"""Questions over time: ``history``, ``when``, ``diff``, ``changes``, ``timeline``."""

from pathlib import Path
from typing import Annotated

import typer
from rich.text import Text

from kbstore.cli import completion
from kbstore.cli.options import TIMES, AsOf, Condition, Json, Kb, Now, Since, Until, Url, at_time, belief, reading
from kbstore.cli.output import answer, console, json_line
from kbstore.cli.times import parse_time
from kbstore.knowledge_base import KnowledgeBase
from kbstore.model.plain import each
from kbstore.report import records
from kbstore.report.tables import plural, printable, show
from kbstore.report.time_format import TimeFormat
from kbstore.report.timeline.data import timeline_data
from kbstore.report.timeline.page import page
from kbstore.report.timeline.text import TextTimeline


def history(
    pattern: Annotated[
        str,
        typer.Argument(
            help="A fact, function or object in PDDL; ? matches any object.", autocompletion=completion.patterns
        ),
    ],
    since: Since = None,
    until: Until = None,
    as_of: AsOf = None,
    url: Url = None,
    kb: Kb = None,
    now: Now = None,
    as_json: Json = False,
) -> None:
    """List all assertions that match: when each held, who recorded it, and who ended or cancelled it.

    Examples:
        kbstore history "(robot_at kenny ?)"
        kbstore history "(battery kenny)" --since -10m
        kbstore history "? - parcel"
    """
    with reading(url, kb, now) as found:
        listed = found.history(pattern, _beginning(since, found), at_time(until, found), belief(as_of, found))
        answer(each(listed), as_json=as_json, view=lambda: records.history_view(listed))


def when(
    condition: Condition,
    since: Since = None,
    until: Until = None,
    as_of: AsOf = None,
    url: Url = None,
    kb: Kb = None,
    now: Now = None,
    as_json: Json = False,
) -> None:
    """List the intervals in which a condition is true, exact to the nanosecond. The span ends now, or at --until.

    Examples:
        kbstore when "(open lab_door)"
        kbstore when "(< (battery kenny) 20)" --since -1h
        kbstore when "(open lab_door)" --since now --until +1h
    """
    with reading(url, kb, now) as found:
        last = at_time(until, found)
        last = found.now() if last is None else last
        spans = found.when(condition, _beginning(since, found), last, belief(as_of, found))
        answer(spans.to_dict(), as_json=as_json, view=lambda: records.intervals_table(spans, TimeFormat(found.now())))


def diff(
    before: Annotated[str, typer.Argument(help=f"The earlier time. {TIMES}", metavar="TIME", show_default=False)],
    after: Annotated[str, typer.Argument(help="The later time.", metavar="[TIME]")] = "now",
    as_of: AsOf = None,
    url: Url = None,
    kb: Kb = None,
    now: Now = None,
    as_json: Json = False,
) -> None:
    """List what became true, became false, was withdrawn, or changed between two times.

    Examples:
        kbstore diff -5m
        kbstore diff 2026-05-04T08:59:00Z 2026-05-04T09:06:00Z
    """
    with reading(url, kb, now) as found:
        t1, t2 = parse_time(before, found.now()), parse_time(after, found.now())
        differs = found.diff(t1, t2, belief(as_of, found))
        answer(differs, as_json=as_json, view=lambda: records.diff_view(differs))


def changes(
    about: Annotated[
        str | None,
        typer.Argument(
            help="Only changes of what matches this fact, function or object.",
            metavar="PATTERN",
            autocompletion=completion.patterns,
        ),
    ] = None,
    after: Annotated[
        int | None,
        typer.Option(
            "--after",
            metavar="N",
            help="Only changes after transaction N (default: all; with --follow, new ones).",
            min=0,
        ),
    ] = None,
    follow: Annotated[bool, typer.Option("--follow", help="Wait for more, until Ctrl-C.")] = False,
    url: Url = None,
    kb: Kb = None,
    now: Now = None,
    as_json: Json = False,
) -> None:
    """List the transactions in order, with everything that they did, and what took effect by the clock alone.

    A plus marks what was asserted, a minus what ended, an x what was cancelled before it took effect, a ~ what
    late knowledge superseded: what takes its place is asserted.
    With --json, print one line for each.

    Examples:
        kbstore changes
        kbstore changes "(robot_at kenny ?)" --after 100
        kbstore changes --follow --json
    """
    with reading(url, kb, now) as found:
        moments = TimeFormat(found.now())
        beginning = after if after is not None or follow else 0
        for change in found.watch(about, beginning, timeout=None if follow else 0):
            if as_json:
                json_line(change)
            else:
                show(console(), records.change_view(change, moments))


def timeline(
    about: Annotated[
        list[str] | None,
        typer.Argument(
            help="A page to write (FILE.html), and patterns: (robot_at kenny ?), or a word like battery or kenny.",
            metavar="[FILE.html] [PATTERN]...",
            show_default=False,
            autocompletion=completion.patterns,
        ),
    ] = None,
    since: Since = None,
    until: Until = None,
    as_of: AsOf = None,
    url: Url = None,
    kb: Kb = None,
    now: Now = None,
    as_json: Json = False,
) -> None:
    """Draw the history: as a page for a browser, or as lanes of text within the width of the terminal.

    The page shows facts, numbers, actions and goals over time, and has a slider for what was believed. It is one
    file, which needs no network.

    Examples:
        kbstore timeline kenny.html
        kbstore timeline robot_at "(open ?)" battery
        kbstore timeline kenny.html kenny --since -1h --as-of -5m
    """
    patterns = list(about or ())
    file = patterns.pop(0) if patterns and patterns[0].lower().endswith((".html", ".htm")) else None
    with reading(url, kb, now) as found:
        first, last = at_time(since, found), at_time(until, found)
        data = timeline_data(found, patterns, since=first, until=last, as_of=belief(as_of, found))
        if file is None:
            answer(data, as_json=as_json, view=lambda: TextTimeline(data))
            return
        path = Path(file).resolve()
        path.write_text(page(data), encoding="utf-8")
        written = {"file": str(path), "lanes": len(data["lanes"]), "transactions": len(data["transactions"])}
        text = f"{printable(str(path))} shows {plural(len(data['lanes']), 'lane')}; open it in a browser"
        answer(written, as_json=as_json, view=lambda: Text(text))


def _beginning(since: str | None, kb: KnowledgeBase) -> int:
    """Return the time of --since; without it, the beginning of the history."""
    return kb.history_from if since is None else parse_time(since, kb.now())
