"""Whole knowledge bases: ``kbs``, ``import``, ``backup``, ``archive``, ``demo``."""

from pathlib import Path
from typing import Annotated

import typer

import kbstore
from kbstore.cli.demo import mission, tour
from kbstore.cli.options import TIMES, Json, Kb, Now, Url, store, writing
from kbstore.cli.output import answer, json_line, working
from kbstore.cli.times import parse_time
from kbstore.clock import ManualClock, isoformat
from kbstore.model.plain import times
from kbstore.report.tables import plural, table
from kbstore.report.time_format import TimeFormat

NewFile = Annotated[Path, typer.Argument(help="The file to create; it must not exist yet.", metavar="FILE")]


def kbs(url: Url = None, now: Now = None, as_json: Json = False) -> None:
    """List the knowledge bases of the store.

    Examples:
        kbstore kbs --url robot.db
    """
    place = store(url)
    found = []
    for name in kbstore.knowledge_bases(place):
        # with a clock at 0, now is the latest recorded time
        with kbstore.open(place, name, clock=ManualClock(), read_only=True) as kb:
            latest = kb.state()
            domain = None if latest.domain is None else latest.domain.name
            found.append(
                {
                    "name": name,
                    "domain": domain,
                    "use_unknowns": kb.use_unknowns,
                    **times(last_time=latest.at, history_from=kb.history_from),
                    "objects": len(latest.instances),
                    "facts": len(latest.facts),
                }
            )
    moments = TimeFormat(parse_time(now or "now", kbstore.SystemClock().now()))
    headings = ("name", "domain", "world", "last written", "", ">objects", ">facts")
    rows = [
        (
            str(kb["name"]),
            str(kb["domain"] or "none"),
            "open" if kb["use_unknowns"] else "closed",
            moments.absolute(kb["last_ns"]) if kb["last_ns"] else "never",
            moments.relative(kb["last_ns"]) if kb["last_ns"] else "",
            str(kb["objects"]),
            str(kb["facts"]),
        )
        for kb in found
    ]
    answer(
        found, as_json=as_json, view=lambda: table("", headings, rows) if found else "there is no knowledge base yet"
    )


def import_(
    file: Annotated[Path, typer.Argument(help="A file written by export --format jsonl.", metavar="FILE", exists=True)],
    url: Url = None,
    kb: Kb = None,
    as_json: Json = False,
) -> None:
    """Restore an exported knowledge base exactly, with all its history. --kb gives it another name.

    Examples:
        kbstore import kenny.jsonl --url robot.db
        kbstore import kenny.jsonl --url postgresql://server/fleet --kb ken
    """
    with working(f"importing {file.name}") as progress:
        name = kbstore.import_knowledge_base(store(url), file, kb, progress=progress)
    answer({"name": name, "file": str(file)}, as_json=as_json, view=lambda: f"{name} was restored from {file}")


def backup(file: NewFile, url: Url = None, as_json: Json = False) -> None:
    """Copy the whole store to a new SQLite file. The copy is consistent while writers go on.

    Examples:
        kbstore backup robot-2026-05-04.db --url robot.db
    """
    with working(f"copying to {file.name}") as progress:
        kbstore.backup(store(url), file, progress=progress)
    size = file.stat().st_size
    answer({"file": str(file), "bytes": size}, as_json=as_json, view=lambda: f"{file}: {size:,} bytes")


def archive(
    file: Annotated[
        Path, typer.Argument(help="The SQLite file for the history; a new one, or the last archive.", metavar="FILE")
    ],
    before: Annotated[
        str,
        typer.Option(
            "--before", metavar="TIME", help=f"Archive the history before this time. {TIMES}", show_default=False
        ),
    ],
    url: Url = None,
    kb: Kb = None,
    now: Now = None,
    as_json: Json = False,
) -> None:
    """Move the history before a time into a file, which can be asked like any other store.

    From then on, questions that need this history are refused. If interrupted, run the command again to continue.

    Examples:
        kbstore archive --before -90d kenny-history.db
    """
    with writing(url, kb, now) as found, working(f"archiving to {file.name}") as progress:
        done = found.archive(parse_time(before, found.now()), file, progress=progress)
    report = {"file": str(done.path), "rows": done.rows, **times(history_from=done.history_from)}
    sentence = (
        f"{file}: {plural(done.rows, 'row')} moved; the history in the store begins at {isoformat(done.history_from)}"
        if done.rows
        else f"there was nothing to archive; the history in the store begins at {isoformat(done.history_from)}"
    )
    answer(report, as_json=as_json, view=lambda: sentence)


def demo(
    file: Annotated[Path | None, typer.Argument(help="The SQLite file to create (default: a new one here).")] = None,
    as_json: Json = False,
) -> None:
    """Record a robot's morning in a new file, and ask questions about it.

    Examples:
        kbstore demo
        kbstore demo /tmp/kenny.db
    """
    if not as_json:
        tour.run(file)
        return
    path = tour.unused(file)
    with mission.record(f"sqlite:///{path}") as kb:
        report = {"file": str(path), "name": kb.name, **times(last_time=kb.now())}
    json_line(report)
