"""Whole knowledge bases: ``kbs``, ``export``, ``import``, ``backup``, ``archive``, ``demo``."""

import json
import sys
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

import kbstore
from kbstore.cli.demo import mission, tour
from kbstore.cli.options import TIMES, AsOf, At, Json, Kb, Now, Url, asked, at_time, belief, store, told
from kbstore.cli.output import answer, json_line, working
from kbstore.cli.times import parse_time
from kbstore.clock import ManualClock, isoformat
from kbstore.knowledge_base import KnowledgeBase
from kbstore.model.plain import plain, times
from kbstore.model.results import Transaction
from kbstore.report.tables import plural, table
from kbstore.report.time_format import TimeFormat

NewFile = Annotated[Path, typer.Argument(help="The file to create; it must not exist yet.", metavar="FILE")]
Output = Annotated[
    Path | None, typer.Option("--output", metavar="FILE", help="The file to create (default: standard output).")
]


class Format(StrEnum):
    """The formats that `export` writes."""

    PDDL = "pddl"
    JSON = "json"


def kbs(url: Url = None, now: Now = None, as_json: Json = False) -> None:
    """List the knowledge bases of the store.

    Examples:
        kbstore kbs --url robot.db
    """
    place = store(url)
    found = []
    for name in kbstore.knowledge_bases(place):
        # a clock at 0: now is the latest recorded time
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


def export(
    form: Annotated[
        Format, typer.Option("--format", help="pddl for planners; json for the state, or for everything.")
    ] = Format.PDDL,
    at: At = None,
    as_of: AsOf = None,
    domain: Annotated[bool, typer.Option("--domain", help="Write the domain instead, as it was loaded.")] = False,
    output: Output = None,
    url: Url = None,
    kb: Kb = None,
    now: Now = None,
    as_json: Json = False,
) -> None:
    """Write the planning problem of any time, the domain, or the whole knowledge base.

    With --format json and no time, write the knowledge base with all its history as JSON Lines, which import restores
    exactly; with a time, the state at that time. With --json, report in JSON what was written to --output.

    Examples:
        kbstore export --at -5m > problem.pddl
        kbstore export --domain --output domain.pddl
        kbstore export --format json --output kenny.jsonl
    """
    with asked(url, kb, now) as found:
        t, believed = at_time(at, found), belief(as_of, found)
        if form is Format.JSON and t is None and believed is None and not domain:
            written = _export_all(store(url), found.name, output)
        else:
            text = _exported(found, form, t, believed, domain=domain)
            written = _write(text, output)
    if output is not None:
        report = {"file": str(output), **written}
        said = ", ".join(f"{count:,} {what}" for what, count in written.items())
        answer(report, as_json=as_json, view=lambda: f"{output}: {said}")


def import_(
    file: Annotated[Path, typer.Argument(help="A file written by export --format json.", metavar="FILE", exists=True)],
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
    with told(url, kb, now) as found, working(f"archiving to {file.name}") as progress:
        done = found.archive(parse_time(before, found.now()), file, progress=progress)
    report = {"file": str(done.path), "rows": done.rows, **times(history_from=done.history_from)}
    said = (
        f"{file}: {plural(done.rows, 'row')} moved; the history in the store begins at {isoformat(done.history_from)}"
        if done.rows
        else f"there was nothing to archive; the history in the store begins at {isoformat(done.history_from)}"
    )
    answer(report, as_json=as_json, view=lambda: said)


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


def _export_all(place: str, name: str, output: Path | None) -> dict[str, int]:
    if output is None:
        return {"rows": kbstore.export_knowledge_base(place, name, sys.stdout.buffer)}
    with working(f"exporting {name}") as progress:
        return {"rows": kbstore.export_knowledge_base(place, name, output, progress=progress)}


def _exported(kb: KnowledgeBase, form: Format, at: int | None, as_of: int | Transaction | None, *, domain: bool) -> str:
    if domain:
        return kb.domain_to_pddl()
    if form is Format.PDDL:
        return kb.to_pddl(at, as_of)
    return json.dumps(plain(kb.state(at, as_of)), ensure_ascii=False, indent=2) + "\n"


def _write(text: str, output: Path | None) -> dict[str, int]:
    if output is None:
        sys.stdout.write(text)
    else:
        with output.open("x", encoding="utf-8") as file:
            file.write(text)
    return {"bytes": len(text.encode())}
