"""Questions about one time: ``state``, ``holds``, ``find``, ``wait``, ``value``, ``explain``, ``applicable``."""

import re
from typing import Annotated

import typer

from kbstore.cli import completion
from kbstore.cli.options import Arguments, AsOf, At, Condition, Json, Kb, Now, Operator, Url, at_time, belief, reading
from kbstore.cli.output import answer
from kbstore.cli.times import parse_duration, parse_time
from kbstore.clock import SECOND, isoformat
from kbstore.errors import InvalidKnowledge
from kbstore.knowledge_base import KnowledgeBase
from kbstore.messages import Truth, format_number
from kbstore.model.plain import Data, times
from kbstore.model.results import Transaction
from kbstore.names import bracketed
from kbstore.report import records, states
from kbstore.report.selection import Part, select
from kbstore.report.time_format import TimeFormat

EXIT_CODES = {Truth.TRUE: 0, Truth.FALSE: 1, Truth.UNKNOWN: 3}
"""The exit codes of ``holds``."""


def state(
    patterns: Annotated[
        list[str] | None,
        typer.Argument(
            help="Show what matches these facts, functions or objects; ? matches any object.",
            metavar="[PATTERN]...",
            show_default=False,
            autocompletion=completion.patterns,
        ),
    ] = None,
    about: Annotated[
        list[str] | None,
        typer.Option(
            "--about",
            metavar="OBJECT",
            help="Show what refers to this object. Repeatable.",
            autocompletion=completion.objects,
        ),
    ] = None,
    only: Annotated[list[Part] | None, typer.Option("--only", help="Show this part. Repeatable.")] = None,
    everything: Annotated[
        bool, typer.Option("--all", help="Show also the many facts and numbers that no action changes.")
    ] = False,
    at: At = None,
    as_of: AsOf = None,
    url: Url = None,
    kb: Kb = None,
    now: Now = None,
    as_json: Json = False,
) -> None:
    """Show everything that holds at a time: past, now, or expected.

    With --as-of, show what was believed at that time, with the expected effects of what was scheduled or running then.

    Examples:
        kbstore state
        kbstore state "(robot_at ? ?)" "(battery ?)"
        kbstore state --about kenny --only facts
        kbstore state --at 2026-05-04T09:02:00Z --kb kenny
        kbstore state --at +10m
        kbstore state --at now --as-of -5m --json
    """
    with reading(url, kb, now) as found:
        asking = found.state(at_time(at, found), belief(as_of, found))
        shown = select(asking, _patterns(patterns), about or [], only or [], folding=not (everything or as_json))
        answer(
            shown.to_dict(),
            as_json=as_json,
            view=lambda: states.state_view(shown, TimeFormat(asking.at if at is None else found.now())),
        )


def _patterns(given: list[str] | None) -> list[str]:
    """Return the patterns. Raises `InvalidKnowledge` for a bare name, which is probably an object."""
    for pattern in given or []:
        if re.fullmatch(r"[^\s()]+", pattern):
            raise InvalidKnowledge(f"{pattern} is not a pattern: write ({pattern}), or --about {pattern} for an object")
    return given or []


def _asked(at: str | None, as_of: str | None, kb: KnowledgeBase) -> tuple[int, int | Transaction | None, Data]:
    """Return the time and the belief to ask about, and both as they are shown: no state need be read for that."""
    now = kb.now()
    t = now if at is None else parse_time(at, now)
    believed = belief(as_of, kb)
    last = believed.time if isinstance(believed, Transaction) else believed
    return t, believed, times(at=t, as_of=None if last is None else min(last, now))


def holds(
    condition: Condition,
    at: At = None,
    as_of: AsOf = None,
    url: Url = None,
    kb: Kb = None,
    now: Now = None,
    as_json: Json = False,
) -> None:
    """Show whether a fact or a condition is true.

    Exits with 0 if it is true, 1 if it is false, 3 if it is unknown.

    Examples:
        kbstore holds "(robot_at kenny lab)"
        kbstore holds "(and (docked kenny) (>= (battery kenny) 20))" --at -10m
        kbstore holds "(exists (?w - waypoint) (robot_at kenny ?w))"
    """
    with reading(url, kb, now) as found:
        t, believed, shown = _asked(at, as_of, found)
        truth = found.truth(condition, t, believed)
        report = {"condition": condition, "truth": str(truth), **shown}
        answer(report, as_json=as_json, view=lambda: str(truth))
    raise typer.Exit(EXIT_CODES[truth])


def find(
    condition: Condition,
    at: At = None,
    as_of: AsOf = None,
    url: Url = None,
    kb: Kb = None,
    now: Now = None,
    as_json: Json = False,
) -> None:
    """List the objects for which a condition is true: one row for each binding of its ?variables.

    Exits with 0 if there is any, 1 if there is none.

    Examples:
        kbstore find "(robot_at ?robot ?place)"
        kbstore find "(and (robot_at ?r ?w) (> (battery ?r) 20))" --at -10m
        kbstore find "(not (delivered ?p - parcel lab))"
    """
    with reading(url, kb, now) as found:
        bindings = found.find(condition, at=at_time(at, found), as_of=belief(as_of, found))
        answer(bindings, as_json=as_json, view=lambda: records.bindings_table(bindings))
    raise typer.Exit(0 if bindings else 1)


def wait(
    condition: Condition,
    timeout: Annotated[
        str | None,
        typer.Option("--timeout", metavar="TIME", help="How long to wait at most: 30s, 5m (default: forever)."),
    ] = None,
    url: Url = None,
    kb: Kb = None,
    now: Now = None,
    as_json: Json = False,
) -> None:
    """Wait until a condition is true, and show since when.

    Exits with 0 as soon as it is true, 1 if it is not within the time-out.

    Examples:
        kbstore wait "(robot_at kenny lab)" --timeout 5m && echo arrived
        kbstore wait "(< (battery kenny) 20)"
    """
    patience = None if timeout is None else parse_duration(timeout) / SECOND
    with reading(url, kb, now) as found:
        came = found.wait_for(condition, patience)
    report = {"condition": condition, **times(time=came)}
    answer(report, as_json=as_json, view=lambda: "timed out" if came is None else isoformat(came))
    raise typer.Exit(1 if came is None else 0)


def value(
    expression: Annotated[
        str,
        typer.Argument(
            help="A numeric function or expression in PDDL.",
            metavar="EXPRESSION",
            autocompletion=completion.patterns,
        ),
    ],
    at: At = None,
    as_of: AsOf = None,
    url: Url = None,
    kb: Kb = None,
    now: Now = None,
    as_json: Json = False,
) -> None:
    """Show the value of a numeric function or expression.

    Examples:
        kbstore value "(battery kenny)"
        kbstore value "(- 100 (battery kenny))" --at -1h
    """
    with reading(url, kb, now) as found:
        t, believed, shown = _asked(at, as_of, found)
        number = found.value(expression, t, believed)
        report = {"expression": expression, "value": number, **shown}
        answer(report, as_json=as_json, view=lambda: format_number(number))


def explain(
    condition: Condition,
    at: At = None,
    as_of: AsOf = None,
    url: Url = None,
    kb: Kb = None,
    now: Now = None,
    as_json: Json = False,
) -> None:
    """Show why a fact or a condition is true, false or unknown, since when, and who made it so.

    Examples:
        kbstore explain "(open lab_door)"
        kbstore explain "(and (docked kenny) (open lab_door))" --at -10m
    """
    with reading(url, kb, now) as found:
        asking = found.state(at_time(at, found), belief(as_of, found))
        explanation = asking.explain(condition)
        answer(
            explanation,
            as_json=as_json,
            view=lambda: records.explanation_tree(explanation, TimeFormat(found.now())),
        )


def applicable(
    operator: Operator,
    arguments: Arguments = None,
    at: At = None,
    url: Url = None,
    kb: Kb = None,
    now: Now = None,
    as_json: Json = False,
) -> None:
    """Show whether an action can be applied, and if not, which conditions fail since when.

    Exits with 0 if it can, 1 if it cannot.

    Examples:
        kbstore applicable drive kenny home office
        kbstore applicable pass_door kenny lab_door corridor lab --at -10m
    """
    with reading(url, kb, now) as found:
        names = arguments or []
        judged = found.applicable(operator, *names, at=at_time(at, found))
        action = bracketed(operator, *names)
        answer(
            judged,
            as_json=as_json,
            view=lambda: records.applicability_view(action, judged, TimeFormat(found.now())),
        )
    raise typer.Exit(0 if judged else 1)
