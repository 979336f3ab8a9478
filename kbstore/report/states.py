"""A state, for reading: what exists, what is said, what is scheduled, what runs, what is wanted."""

from collections import defaultdict
from dataclasses import replace

from rich.console import RenderableType
from rich.text import Text

from kbstore.messages import Condition, Fact, KnowledgeItem, Truth, format_number
from kbstore.model.results import Run
from kbstore.names import key
from kbstore.reading.state import State
from kbstore.report.tables import DIM, FALSE, NUMBER, SCHEDULED, sections, table
from kbstore.report.time_format import TimeFormat, span


def state_view(state: State, moments: TimeFormat) -> RenderableType:
    """All of a state, in sections; those that would be empty are left out. What is "ago" is so as of its time."""
    moments, asked = replace(moments, now=state.at), moments
    return sections(
        heading(state, asked),
        objects(state),
        facts(state.facts, moments),
        numbers(state, moments),
        running(state.running, moments, state.at),
        scheduled(state, moments),
        statements(state, moments),
        goals(state, moments),
        Text(f"Metric: {state.metric}") if state.metric else None,
    )


def heading(state: State, moments: TimeFormat) -> RenderableType:
    """Whose state, at what time, and as believed when."""
    text = Text(state.name, "bold")
    text.append(f" at {moments.absolute(state.at)}", "not bold")
    if state.at != moments.now:
        text.append(f" ({moments.relative(state.at)})", DIM)
    if state.as_of is not None:
        text.append(f", as believed at {moments.absolute(state.as_of)}", "not bold")
    return text


def objects(state: State) -> RenderableType | None:
    """The objects by their types."""
    by_type: dict[str, list[str]] = defaultdict(list)
    for instance in state.instances:
        by_type[instance.instance_type].append(instance.instance_name)
    rows = [(type_name, " ".join(names)) for type_name, names in by_type.items()]
    return table("Objects", ("type", "names"), rows) if rows else None


def facts(found: list[Fact], moments: TimeFormat) -> RenderableType | None:
    """Facts of both signs by predicate, with since when they stand."""
    rows = [
        (
            Text(str(fact), FALSE if fact.is_negative else ""),
            moments.absolute(fact.initial_time),
            moments.relative(fact.initial_time),
        )
        for fact in sorted(found, key=lambda fact: key(fact.attribute_name))
    ]
    return table("Facts", ("fact", "since", ""), rows) if rows else None


def numbers(state: State, moments: TimeFormat) -> RenderableType | None:
    """The numeric functions with their values at the time, and how fast they change."""
    rows = [
        (
            item.atom,
            Text(format_number(item.function_value or 0.0), NUMBER),
            f"{item.rate:+g} per s" if item.rate else "",
            moments.absolute(item.initial_time),
            moments.relative(item.initial_time),
        )
        for item in sorted(state.functions, key=lambda item: key(item.attribute_name))
    ]
    return table("Numbers", ("function", ">value", "changes", "since", ""), rows) if rows else None


def running(runs: list[Run], moments: TimeFormat, at: int) -> RenderableType | None:
    """The actions that run, and when their ends are expected."""
    rows = [
        (
            f"({' '.join((run.operator, *run.arguments))})",
            moments.absolute(run.started),
            f"{span(at - run.started)} of {span(run.duration)}",
            moments.absolute(run.expected_end) + (" (late)" if run.expected_end <= at else ""),
        )
        for run in runs
    ]
    return table("Running", ("action", "started", "so far", "expected end"), rows) if rows else None


def scheduled(state: State, moments: TimeFormat) -> RenderableType | None:
    """Timed-initial knowledge that takes effect after the time."""
    rows = [
        (Text(str(item), SCHEDULED), moments.absolute(item.initial_time), moments.relative(item.initial_time))
        for item in state.timed_knowledge
    ]
    return table("Scheduled", ("knowledge", "takes effect", ""), rows) if rows else None


def statements(state: State, moments: TimeFormat) -> RenderableType | None:
    """Recorded inequalities."""
    rows = [(str(item), moments.absolute(item.initial_time)) for item in state.inequalities]
    return table("Recorded inequalities", ("inequality", "since"), rows) if rows else None


def goals(state: State, moments: TimeFormat) -> RenderableType | None:
    """The parts of the goal, each with whether it is reached."""
    rows = [(str(goal), reached(state, goal), moments.absolute(goal.initial_time)) for goal in state.goals]
    return table("Goals", ("goal", "reached", "wanted since"), rows) if rows else None


def reached(state: State, goal: KnowledgeItem | Condition) -> str:
    """Whether a goal is reached in a state."""
    return {Truth.TRUE: "yes", Truth.FALSE: "no", Truth.UNKNOWN: "unknown"}[state.truth(goal)]
