"""Exports for planners, for other stores and for other tools: ``export``."""

import json
import sys
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

import kbstore
from kbstore.cli import completion
from kbstore.cli.options import AsOf, At, Json, Kb, Now, Since, Until, Url, at_time, belief, reading, store
from kbstore.cli.output import answer, working
from kbstore.errors import InvalidKnowledge
from kbstore.knowledge_base import KnowledgeBase
from kbstore.model.plain import plain
from kbstore.model.results import Transaction
from kbstore.report.frames import parquet_bytes
from kbstore.report.perfetto import trace_text
from kbstore.report.relations import csv_text, relation
from kbstore.report.tables import printable

Output = Annotated[
    Path | None, typer.Option("--output", metavar="FILE", help="The file to create (default: standard output).")
]


class Format(StrEnum):
    """The formats that `export` writes."""

    PDDL = "pddl"
    JSON = "json"
    JSONL = "jsonl"
    PERFETTO = "perfetto"
    CSV = "csv"
    PARQUET = "parquet"


class Of(StrEnum):
    """The kinds of rows of a table."""

    FACTS = "facts"
    NUMBERS = "numbers"
    RUNS = "runs"
    TRANSACTIONS = "transactions"


TABLES = (Format.CSV, Format.PARQUET)
SPANS = (*TABLES, Format.PERFETTO)
"""The formats for a span of time; the others are for one time, or for everything."""


def export(
    pattern: Annotated[
        str | None,
        typer.Argument(
            help="Only these rows of csv or parquet: a fact, a function or an action; ? matches any object.",
            metavar="[PATTERN]",
            autocompletion=completion.patterns,
        ),
    ] = None,
    form: Annotated[
        Format,
        typer.Option(
            "--format",
            help="pddl for planners; json for the state; jsonl for everything; perfetto, csv, parquet for other tools.",
        ),
    ] = Format.PDDL,
    of: Annotated[Of | None, typer.Option("--of", help="The rows of csv or parquet (default: facts).")] = None,
    at: At = None,
    since: Since = None,
    until: Until = None,
    as_of: AsOf = None,
    domain: Annotated[bool, typer.Option("--domain", help="Write the domain instead, as it was loaded.")] = False,
    output: Output = None,
    url: Url = None,
    kb: Kb = None,
    now: Now = None,
    as_json: Json = False,
) -> None:
    """Write the planning problem of any time, the domain, the whole knowledge base, or its record for other tools.

    With --format jsonl, write the knowledge base with all its history as JSON Lines, which import restores exactly;
    so does json without a time. A trace of a span (perfetto) is for ui.perfetto.dev and chrome://tracing; tables of
    facts, numbers, runs or transactions (csv, parquet) have the columns of the views in SQL. With --json, report in
    JSON what was written to --output.

    Examples:
        kbstore export --at -5m > problem.pddl
        kbstore export --domain --output domain.pddl
        kbstore export --format jsonl --output kenny.jsonl
        kbstore export --format perfetto --since -1h --output kenny.json
        kbstore export --format csv "(robot_at kenny ?)" > places.csv
        kbstore export --format parquet --of numbers --output numbers.parquet
    """
    _refuse_what_does_not_apply(
        form, pattern=pattern, of=of, at=at, since=since, until=until, as_of=as_of, domain=domain
    )
    if form is Format.PARQUET and output is None and sys.stdout.isatty():
        raise InvalidKnowledge("parquet is not for a terminal to show; name a file with --output FILE")
    with reading(url, kb, now) as found:
        t, believed = at_time(at, found), belief(as_of, found)
        everything = form is Format.JSONL or (form is Format.JSON and t is None and believed is None)
        if everything and not domain:
            written = _export_all(store(url), found.name, output)
        elif form in SPANS:
            span = at_time(since, found), at_time(until, found)
            written = _write(_record(found, form, of or Of.FACTS, pattern, *span, believed), output)
        else:
            written = _write(_state(found, form, t, believed, domain=domain).encode(), output)
    if output is not None:
        report = {"file": str(output), **written}
        counts = ", ".join(f"{count:,} {what}" for what, count in written.items())
        answer(report, as_json=as_json, view=lambda: f"{printable(str(output))}: {counts}")


def _refuse_what_does_not_apply(form: Format, **given: object) -> None:
    """Raise `InvalidKnowledge` for an option that a format does not have, instead of ignoring it."""
    applies = {
        "pattern": TABLES,
        "of": TABLES,
        "since": SPANS,
        "until": SPANS,
        "at": (Format.PDDL, Format.JSON),
        "as_of": (Format.PDDL, Format.JSON, *SPANS),
        "domain": (Format.PDDL, Format.JSON),
    }
    for name, value in given.items():
        if value and form not in applies[name]:
            option = "a pattern" if name == "pattern" else f"--{name.replace('_', '-')}"
            formats = " or ".join(f"--format {each}" for each in applies[name])
            raise InvalidKnowledge(f"{option} is for {formats}, not for {form}; leave it out")


def _export_all(place: str, name: str, output: Path | None) -> dict[str, int]:
    if output is None:
        return {"rows": kbstore.export_knowledge_base(place, name, sys.stdout.buffer)}
    with working(f"exporting {name}") as progress:
        return {"rows": kbstore.export_knowledge_base(place, name, output, progress=progress)}


def _record(
    kb: KnowledgeBase,
    form: Format,
    of: Of,
    pattern: str | None,
    since: int | None,
    until: int | None,
    as_of: int | Transaction | None,
) -> bytes:
    if form is Format.PERFETTO:
        return trace_text(kb, since, until, as_of).encode()
    found = relation(kb, of, pattern, since, until, as_of)
    return parquet_bytes(found) if form is Format.PARQUET else csv_text(found).encode()


def _state(kb: KnowledgeBase, form: Format, at: int | None, as_of: int | Transaction | None, *, domain: bool) -> str:
    if domain:
        return kb.domain_to_pddl()
    if form is Format.PDDL:
        return kb.to_pddl(at, as_of)
    return json.dumps(plain(kb.state(at, as_of)), ensure_ascii=False, indent=2) + "\n"


def _write(data: bytes, output: Path | None) -> dict[str, int]:
    if output is None:
        sys.stdout.buffer.write(data)
    else:
        with output.open("xb") as file:
            file.write(data)
    return {"bytes": len(data)}
