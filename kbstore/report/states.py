"""Shows a state as tables: objects, facts, numbers, runs, schedule, goals."""

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import replace

from rich.console import RenderableType
from rich.text import Text

from kbstore.messages import (
    Condition,
    Fact,
    Function,
    Goal,
    Inequality,
    Instance,
    KnowledgeItem,
    Truth,
    format_number,
)
from kbstore.model.results import Run
from kbstore.names import key
from kbstore.reading.state import State
from kbstore.report.selection import Selection
from kbstore.report.tables import DIM, FALSE, NUMBER, SCHEDULED, sections, table
from kbstore.report.time_format import TimeFormat, span


def state_view(shown: Selection, moments: TimeFormat) -> RenderableType:
    """Show a selection of a state, in sections without the empty ones. "Ago" is relative to the time of the state."""
    state = shown.state
    moments, asked = replace(moments, now=state.at), moments
    found = (
        objects(shown.instances),
        facts(shown.facts, moments),
        numbers(shown.functions, moments),
        folded(shown),
        running(shown.running, moments, state.at),
        scheduled(shown.timed_knowledge, moments),
        statements(shown.inequalities, moments),
        goals(state, shown.goals, moments),
        Text(f"Metric: {shown.metric}") if shown.metric else None,
    )
    return sections(heading(state, asked), *found, None if any(found) else Text("nothing", DIM))


def heading(state: State, moments: TimeFormat) -> RenderableType:
    """Show the knowledge base, the time, and the time of the belief."""
    text = Text(state.name, "bold")
    text.append(f" at {moments.absolute(state.at)}", "not bold")
    if state.at != moments.now:
        text.append(f" ({moments.relative(state.at)})", DIM)
    if state.as_of is not None:
        text.append(f", as believed at {moments.absolute(state.as_of)}", "not bold")
    return text


def objects(found: Sequence[Instance]) -> RenderableType | None:
    """Show the objects by type; None if there are none, as below."""
    by_type: dict[str, list[str]] = defaultdict(list)
    for instance in found:
        by_type[instance.instance_type].append(instance.instance_name)
    rows = [(type_name, " ".join(names)) for type_name, names in by_type.items()]
    return table("Objects", ("type", "names"), rows) if rows else None


def facts(found: Sequence[Fact], moments: TimeFormat) -> RenderableType | None:
    """Show facts of both signs by predicate, and since when they hold."""
    rows = [
        (
            Text(str(fact), FALSE if fact.is_negative else ""),
            moments.absolute(fact.initial_time),
            moments.relative(fact.initial_time),
        )
        for fact in sorted(found, key=lambda fact: key(fact.attribute_name))
    ]
    return table("Facts", ("fact", "since", ""), rows) if rows else None


def numbers(found: Sequence[Function], moments: TimeFormat) -> RenderableType | None:
    """Show the numeric functions with their values, and how fast they change."""
    rows = [
        (
            item.atom,
            Text(format_number(item.function_value or 0.0), NUMBER),
            f"{item.rate:+g} per s" if item.rate else "",
            moments.absolute(item.initial_time),
            moments.relative(item.initial_time),
        )
        for item in sorted(found, key=lambda item: key(item.attribute_name))
    ]
    return table("Numbers", ("function", ">value", "changes", "since", ""), rows) if rows else None


def folded(shown: Selection) -> RenderableType | None:
    """Show the number of facts and numbers that are left out, by name."""
    if not shown.folded:
        return None
    counts = ", ".join(f"{name} ({count:,})" for name, count in shown.folded)
    return Text(f"Not shown, as no action changes them: {counts}; --all shows them", DIM)


def running(runs: Sequence[Run], moments: TimeFormat, at: int) -> RenderableType | None:
    """Show the running actions, and their expected ends."""
    rows = [
        (
            run.action,
            moments.absolute(run.started),
            f"{span(at - run.started)} of {span(run.duration)}",
            moments.absolute(run.expected_end) + (" (overdue)" if run.expected_end <= at else ""),
        )
        for run in runs
    ]
    return table("Running", ("action", "started", "so far", "expected end"), rows) if rows else None


def scheduled(found: Sequence[KnowledgeItem], moments: TimeFormat) -> RenderableType | None:
    """Show scheduled knowledge, which takes effect after the time of the state."""
    rows = [
        (Text(str(item), SCHEDULED), moments.absolute(item.initial_time), moments.relative(item.initial_time))
        for item in found
    ]
    return table("Scheduled", ("knowledge", "takes effect", ""), rows) if rows else None


def statements(found: Sequence[Inequality], moments: TimeFormat) -> RenderableType | None:
    """Show recorded inequalities."""
    rows = [(str(item), moments.absolute(item.initial_time)) for item in found]
    return table("Recorded inequalities", ("inequality", "since"), rows) if rows else None


def goals(state: State, found: Sequence[Goal], moments: TimeFormat) -> RenderableType | None:
    """Show goals, and whether each is reached in the state."""
    rows = [(str(goal), reached(state, goal), moments.absolute(goal.initial_time)) for goal in found]
    return table("Goals", ("goal", "reached", "wanted since"), rows) if rows else None


def reached(state: State, goal: KnowledgeItem | Condition) -> str:
    """Return whether a goal is reached in a state: yes, no or unknown."""
    return {Truth.TRUE: "yes", Truth.FALSE: "no", Truth.UNKNOWN: "unknown"}[state.truth(goal)]
