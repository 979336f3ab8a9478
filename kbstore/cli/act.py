"""Commands about actions: ``apply``, ``start``, ``end``, ``abort``, ``runs``."""

from typing import Annotated

import typer

from kbstore.cli import completion
from kbstore.cli.options import (
    Arguments,
    AsOf,
    Client,
    Json,
    Kb,
    Note,
    Now,
    Operator,
    Since,
    Until,
    Url,
    at_time,
    belief,
    reading,
    writing,
)
from kbstore.cli.output import answer
from kbstore.cli.times import parse_duration
from kbstore.cli.write import recorded
from kbstore.clock import isoformat
from kbstore.errors import NotApplicable
from kbstore.knowledge_base import KnowledgeBase
from kbstore.model.plain import each, plain
from kbstore.model.results import Run
from kbstore.names import bracketed, key
from kbstore.report import records


def apply(
    operator: Operator,
    arguments: Arguments = None,
    client: Client = "",
    note: Note = "",
    url: Url = None,
    kb: Kb = None,
    now: Now = None,
    as_json: Json = False,
) -> None:
    """Apply an instantaneous action: all of its effects, in one transaction.

    Examples:
        kbstore apply pick_up kenny blood office --client mission
    """
    with writing(url, kb, now, creating=False) as found:
        done = found.apply(operator, *(arguments or []), client=client, note=note)
    recorded(done, as_json)


def start(
    operator: Operator,
    arguments: Arguments = None,
    duration: Annotated[
        str | None,
        typer.Option(
            "--duration", metavar="TIME", help="How long it will take: 30s, 1m30s. Not needed if it is fixed."
        ),
    ] = None,
    force: Annotated[
        bool, typer.Option("--force", help="Start it even if the domain does not allow the duration.")
    ] = False,
    client: Client = "",
    note: Note = "",
    url: Url = None,
    kb: Kb = None,
    now: Now = None,
    as_json: Json = False,
) -> None:
    """Start a durative action: its at-start effects happen, and its continuous effects begin.

    Examples:
        kbstore start drive kenny home office
        kbstore start charge kenny --duration 5m --client charger
    """
    lasting = None if duration is None else parse_duration(duration)
    with writing(url, kb, now, creating=False) as found:
        with found.transaction(client=client, note=note) as tx:
            run = tx.start(operator, *(arguments or []), duration=lasting, force=force)
        done = tx.result
    report = {"run": plain(run), "transaction": plain(done)}
    sentence = f"transaction {done.number} at {isoformat(done.time)}: {run.action} started"
    sentence += f", its end is expected at {isoformat(run.expected_end)}"
    if run.forced:
        sentence += f"; forced against {', '.join(run.forced)}"
    answer(report, as_json=as_json, view=lambda: sentence)


def end(
    operator: Operator,
    arguments: Arguments = None,
    client: Client = "",
    note: Note = "",
    url: Url = None,
    kb: Kb = None,
    now: Now = None,
    as_json: Json = False,
) -> None:
    """End a running action: its at-end effects happen, and its continuous effects stop.

    Shows which at-end conditions failed, and which invariants were broken. The arguments may be left out if only one
    such action is running.

    Examples:
        kbstore end drive
        kbstore end drive kenny home office --note "arrived"
    """
    with writing(url, kb, now, creating=False) as found:
        run = _running(found, operator, arguments)
        done = found.end(run, client=client, note=note)
    failing, broken = each(done.failing), each(done.broken)
    report = {"run": plain(run), "transaction": plain(done), "failing": failing, "broken": broken}
    lines = [f"transaction {done.number} at {isoformat(done.time)}: {run.action} ended"]
    lines += [f"at its end, {failing.condition} is {failing.verdict}" for failing in done.failing]
    lines += [f"over all, {broken}" for broken in done.broken]
    answer(report, as_json=as_json, view=lambda: "\n".join(lines))


def abort(
    operator: Operator,
    arguments: Arguments = None,
    client: Client = "",
    note: Note = "",
    url: Url = None,
    kb: Kb = None,
    now: Now = None,
    as_json: Json = False,
) -> None:
    """Abort a running action: its continuous effects stop, and nothing else happens.

    The arguments may be left out if only one such action is running.

    Examples:
        kbstore abort charge --note "called away"
    """
    with writing(url, kb, now, creating=False) as found:
        run = _running(found, operator, arguments)
        done = found.abort(run, client=client, note=note)
    report = {"run": plain(run), "transaction": plain(done)}
    sentence = f"transaction {done.number} at {isoformat(done.time)}: {run.action} aborted"
    answer(report, as_json=as_json, view=lambda: sentence)


def runs(
    pattern: Annotated[
        str | None,
        typer.Argument(
            help='An operator, or an action in PDDL: "(drive kenny ? ?)".',
            metavar="[PATTERN]",
            autocompletion=completion.operators,
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
    """List the durative actions that ran in a span: when, how they ended, and which invariants were broken.

    Examples:
        kbstore runs
        kbstore runs drive --since -1h
        kbstore runs "(drive kenny ? ?)" --json
    """
    with reading(url, kb, now) as found:
        listed = found.runs(pattern, at_time(since, found), at_time(until, found), belief(as_of, found))
        answer(each(listed), as_json=as_json, view=lambda: records.runs_view(listed))


def _running(kb: KnowledgeBase, operator: str, arguments: list[str] | None) -> Run:
    """Return the run of an action. Raises `NotApplicable` if there is none, or more than one."""
    kb.domain.operator(operator)
    wanted = [key(name) for name in arguments or []]
    running = [run for run in kb.state().running if key(run.operator) == key(operator)]
    if wanted:
        running = [run for run in running if [key(name) for name in run.arguments] == wanted]
    if not running:
        raise NotApplicable(f"{bracketed(operator, *(arguments or ()))} is not running; see kbstore state")
    if len(running) > 1:
        raise NotApplicable(
            f"which {operator}? {', '.join(run.action for run in running)} are running; give the arguments"
        )
    return running[0]
