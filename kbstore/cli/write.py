"""Commands that change a knowledge base: ``load``, ``add``, ``remove``, ``goal``, ``metric``."""

import re
from pathlib import Path
from typing import Annotated

import typer

from kbstore.cli.options import (
    Client,
    Json,
    Kb,
    LateSince,
    LateUntil,
    Note,
    Now,
    Starting,
    Url,
    at_time,
    reading,
    writing,
)
from kbstore.cli.output import answer, working
from kbstore.clock import isoformat
from kbstore.errors import InvalidKnowledge
from kbstore.model.results import Transaction
from kbstore.report.tables import plural

Items = Annotated[
    list[str], typer.Argument(help="Knowledge in PDDL, each item in quotes.", metavar="ITEM...", show_default=False)
]
Goals = Annotated[
    list[str], typer.Argument(help="Goals in PDDL, each in quotes.", metavar="GOAL...", show_default=False)
]


def load(
    files: Annotated[
        list[Path],
        typer.Argument(help="A domain, a problem, or both.", metavar="FILE...", exists=True, dir_okay=False),
    ],
    replace: Annotated[bool, typer.Option("--replace", help="Clear first, in the same transaction.")] = False,
    once: Annotated[
        bool, typer.Option("--once", help="Do nothing if these texts have ever been loaded: for start-up scripts.")
    ] = False,
    client: Client = "",
    note: Note = "",
    url: Url = None,
    kb: Kb = None,
    now: Now = None,
    as_json: Json = False,
) -> None:
    """Load a domain and a problem from PDDL files, in one transaction.

    A problem adds to what is known. Its timed-initial knowledge is relative to now.

    Examples:
        kbstore --url robot.db --kb kenny load domain.pddl problem.pddl
        kbstore load problem.pddl --replace --note "a new day"
        kbstore load domain.pddl problem.pddl --once && robot-service
    """
    domain, problem = _domain_and_problem(files)
    with writing(url, kb, now) as found, working(f"loading {' '.join(path.name for path in files)}"):
        done = found.load(domain, problem, replace=replace, once=once, client=client, note=note)
    recorded(done, as_json)


def add(
    items: Items,
    at: Starting = None,
    since: LateSince = None,
    until: LateUntil = None,
    client: Client = "",
    note: Note = "",
    url: Url = None,
    kb: Kb = None,
    now: Now = None,
    as_json: Json = False,
) -> None:
    """Add knowledge: objects, facts of both signs, values of functions. All or nothing.

    Knowledge that is added --at a later time is scheduled: it is recorded now, and takes effect then. With --since a
    time in the past it is late knowledge: it holds up to the next beginning or end, or --until a time.

    Examples:
        kbstore add "wp7 - waypoint" "(visited wp7)" --client mapper
        kbstore add "(= (battery kenny) 80)"
        kbstore add "(not (open lab_door))" --at +15m --note "closing time"
        kbstore add "(increase (battery kenny) 5)"
        kbstore add "(not (open lab_door))" --since -3h --note "the porter's"
    """
    with writing(url, kb, now) as found:
        span = {"since": at_time(since, found), "until": at_time(until, found)}
        done = found.add(*items, initial_time=at_time(at, found), **span, client=client, note=note)
    recorded(done, as_json)


def remove(
    items: Items,
    at: Starting = None,
    since: LateSince = None,
    until: LateUntil = None,
    client: Client = "",
    note: Note = "",
    url: Url = None,
    kb: Kb = None,
    now: Now = None,
    as_json: Json = False,
) -> None:
    """Remove what matches; ? matches any object. Removing an object removes what mentions it.

    To cancel scheduled knowledge, give exactly its time with --at. With --since a time in the past, what matched then
    is removed up to what began next, or --until a time.

    Examples:
        kbstore remove "(carries kenny ?)"
        kbstore remove "linen - parcel" --note "the patient was moved"
        kbstore remove "(not (open lab_door))" --at 2026-05-04T09:10:00Z
    """
    with writing(url, kb, now) as found:
        span = {"since": at_time(since, found), "until": at_time(until, found)}
        done = found.remove(*items, initial_time=at_time(at, found), **span, client=client, note=note)
    recorded(done, as_json)


def goal_add(
    goals: Goals,
    at: Starting = None,
    since: LateSince = None,
    until: LateUntil = None,
    client: Client = "",
    note: Note = "",
    url: Url = None,
    kb: Kb = None,
    now: Now = None,
    as_json: Json = False,
) -> None:
    """Add goals. A conjunction is split into its parts.

    Examples:
        kbstore goal add "(delivered blood lab)" "(docked kenny)"
        kbstore goal add "(>= (battery kenny) 80)" --at +1h
    """
    with writing(url, kb, now) as found:
        span = {"since": at_time(since, found), "until": at_time(until, found)}
        done = found.add_goal(*goals, initial_time=at_time(at, found), **span, client=client, note=note)
    recorded(done, as_json)


def goal_remove(
    goals: Goals,
    at: Starting = None,
    since: LateSince = None,
    until: LateUntil = None,
    client: Client = "",
    note: Note = "",
    url: Url = None,
    kb: Kb = None,
    now: Now = None,
    as_json: Json = False,
) -> None:
    """Remove goals; ? matches any object.

    Examples:
        kbstore goal remove "(delivered ? lab)"
    """
    with writing(url, kb, now) as found:
        span = {"since": at_time(since, found), "until": at_time(until, found)}
        done = found.remove_goal(*goals, initial_time=at_time(at, found), **span, client=client, note=note)
    recorded(done, as_json)


def metric(
    text: Annotated[
        str | None, typer.Argument(help="minimize or maximize, and an expression.", metavar="[METRIC]")
    ] = None,
    remove: Annotated[bool, typer.Option("--remove", help="Remove the metric.")] = False,
    at: Starting = None,
    client: Client = "",
    note: Note = "",
    url: Url = None,
    kb: Kb = None,
    now: Now = None,
    as_json: Json = False,
) -> None:
    """Show the metric, set it, or remove it.

    Examples:
        kbstore metric
        kbstore metric "minimize (total-time)"
        kbstore metric --remove
    """
    if text is None and not remove:
        with reading(url, kb, now) as found:
            current = found.metric(at=at_time(at, found))
        answer(current, as_json=as_json, view=lambda: str(current) if current else "there is no metric")
        return
    texts = [] if text is None else [text]
    with writing(url, kb, now) as found:
        change = found.remove_metric if remove else found.add_metric
        done = change(*texts, initial_time=at_time(at, found), client=client, note=note)
    recorded(done, as_json)


def recorded(done: Transaction, as_json: bool) -> None:
    """Report a transaction, or that nothing changed."""
    sentence = (
        f"transaction {done.number} at {isoformat(done.time)}: {plural(done.changes, 'change')}"
        if done.changes
        else f"nothing changed; the latest transaction is {done.number}"
    )
    answer(done, as_json=as_json, view=lambda: sentence)


def _domain_and_problem(files: list[Path]) -> tuple[Path | None, Path | None]:
    """Distinguish the domain and the problem among one or two files."""
    problems = [path for path in files if _is_problem(path)]
    domains = [path for path in files if path not in problems]
    if len(problems) > 1 or len(domains) > 1:
        kind = "problems" if len(problems) > 1 else "domains"
        raise InvalidKnowledge(f"{' and '.join(map(str, files))} are {kind}; load one domain and one problem at most")
    return next(iter(domains), None), next(iter(problems), None)


def _is_problem(path: Path) -> bool:
    """Return whether a file begins like a problem; the domain reader judges any other."""
    with path.open(encoding="utf-8", errors="replace") as file:
        start = re.sub(r";[^\n]*", "", file.read(100_000))
    return re.match(r"\s*\(\s*define\s*\(\s*problem\b", start, re.IGNORECASE) is not None
