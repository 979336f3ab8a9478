"""Answers as a few lines of text for a language model.

Knowledge is PDDL, times are ISO 8601. An answer has a bounded length; where something is left out, a line says how
much, and how to ask for less. Texts of clients are on the line of what they belong to, without line breaks.
"""

from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence

from kbstore.clock import isoformat
from kbstore.evaluation.intervals import Intervals
from kbstore.messages import Condition, Fact, Function, Instance, KnowledgeItem, format_number
from kbstore.model.domain import Domain, Signature
from kbstore.model.results import Applicability, Assertion, Diff, Explanation, Run, Transaction
from kbstore.names import bracketed
from kbstore.reading.state import State
from kbstore.report.selection import Selection
from kbstore.report.tables import plural, printable
from kbstore.report.time_format import span

MOST_LINES = 40
"""Lines of an answer that are shown."""

FEWEST_LINES = 5
"""Lines of a part of an answer that are shown, however many parts there are."""

MOST_NAMES = 20
"""Objects of a type whose names are shown."""

LONGEST_LINE = 360
"""Characters of a line that are shown."""

LONGEST_TEXT = 4000
"""Characters of a domain's symbols, or of an error, that are shown."""


def vocabulary(domain: Domain | None) -> str:
    """Write the symbols of a domain, as an agent has to write them."""
    if domain is None:
        return "No domain is loaded: any predicate and function may be used."
    actions = [Signature(action.name, action.parameters) for action in domain.actions.values()]
    parts = (
        ("Types", [f"{name} - {parent}" for name, parent in domain.types.items()]),
        ("Constants", [f"{name} - {kind}" for name, kind in domain.constants.items()]),
        ("Predicates", domain.predicate_signatures.values()),
        ("Functions", domain.function_signatures.values()),
        ("Operators", actions),
    )
    text = "\n".join(f"{title}: {' '.join(_spaced(map(str, found)))}" for title, found in parts if found)
    return f"Domain {domain.name}.\n{cut(text, LONGEST_TEXT)}"


def state_text(shown: Selection) -> str:
    """Write a selection of a state, in parts without the empty ones."""
    state = shown.state
    scheduled = [f"{item} at {isoformat(item.initial_time)}" for item in shown.timed_knowledge]
    found: list[tuple[str, Sequence[str]]] = [
        ("running", [*map(_run, shown.running)]),
        ("scheduled", scheduled),
        ("goals", [f"{goal} is {state.truth(goal)}" for goal in shown.goals]),
        ("metric", [str(shown.metric)] if shown.metric else []),
        ("objects", [*_objects(shown.instances)]),
        ("numbers", [*map(_number, shown.functions)]),
        ("facts", [*map(_since, shown.facts)]),
        ("recorded inequalities", [*map(_since, shown.inequalities)]),
    ]
    parts = [part for part in found if part[1]]
    kinds = {"scheduled": shown.timed_knowledge, "numbers": shown.functions, "facts": shown.facts}

    def narrower(name: str, begin: int) -> str:
        counts = Counter(map(_pattern, kinds.get(name, ())[begin:])).most_common(10)
        listed = ", ".join(f"{pattern} {count:,}" for pattern, count in counts)
        return f"ask with patterns, or about=[an object]{f' ({listed})' if listed else ''}"

    lines = [f"{state.name} {moment(state)}", *_parts(parts, narrower)]
    if shown.folded:
        counts = ", ".join(f"{name} ({count:,})" for name, count in shown.folded[:20])
        lines.append(f"not shown, as no action changes them: {counts}; ask for them by patterns")
    return "\n".join(lines if parts or shown.folded else [*lines, "nothing matches"])


def moment(state: State) -> str:
    """Write the time of a state, and of the belief."""
    believed = "" if state.as_of is None else f", as believed at {isoformat(state.as_of)}"
    return f"at {isoformat(state.at)}{believed}"


def bindings_text(bindings: Sequence[Mapping[str, str]]) -> str:
    """Write bindings of variables, one per line."""
    if not bindings or not bindings[0]:
        return "true, and it has no variables" if bindings else "none"
    lines = [", ".join(f"?{name} = {value}" for name, value in row.items()) for row in bindings]
    return _listed(lines, "binding", "add to the condition what you look for, or put an object for a variable")


def history_text(assertions: Sequence[Assertion]) -> str:
    """Write assertions in order of time; if there are many, the latest."""
    lines = [_assertion(found) for found in assertions]
    return _latest(lines, [found.initial_time for found in assertions], "assertion") or "nothing is recorded of it"


def intervals_text(found: Intervals) -> str:
    """Write the intervals in which a condition is true; if there are many, the latest."""
    if not found:
        return "never true in that span"
    lines = [f"{isoformat(start)} until {isoformat(end)} ({span(end - start)})" for start, end in found]
    total = f"true for {span(found.total)} altogether, in {plural(len(found), 'interval')}"
    return f"{_latest(lines, [start for start, _ in found], 'interval')}\n{total}"


def diff_text(diff: Diff) -> str:
    """Write the differences between two times, in parts: became true, became false, and so on."""
    metric = [] if diff.metric is None else [f"{diff.metric[0] or 'none'} -> {diff.metric[1] or 'none'}"]
    numbers = [f"{item.atom} {_value(before)} -> {_value(after)}" for item, before, after in diff.numbers]
    found: list[tuple[str, Sequence[object]]] = [
        ("became true", diff.became_true),
        ("became false", diff.became_false),
        ("withdrawn", diff.withdrawn),
        ("numbers changed", numbers),
        ("goals added", diff.goals_added),
        ("goals removed", diff.goals_removed),
        ("metric", metric),
    ]
    parts = [(name, [*map(str, items)]) for name, items in found if items]
    return "\n".join(_parts(parts, lambda name, left: "ask for times that are closer together")) or "no difference"


def runs_text(runs: Sequence[Run]) -> str:
    """Write runs in the order of their starts; if there are many, the latest."""
    lines = [_run(run) for run in runs]
    return _latest(lines, [run.started for run in runs], "run") or "nothing ran in that span"


def explanation_text(explanation: Explanation) -> str:
    """Write why a condition is true, false or unknown, with the parts that decide it below."""
    lines = list(_explained(explanation))
    return _listed(lines, "line", "explain a part of the condition")


def applicability_text(action: str, answer: Applicability) -> str:
    """Write whether an action can be applied, and which conditions fail since when."""
    if answer:
        return f"{action} is applicable"
    return "\n".join([f"{action} is not applicable:", *(_line(str(failing)) for failing in answer.failing)])


def recorded_text(done: Transaction) -> str:
    """Write the result of a transaction."""
    if not done.changes:
        return f"nothing changed: it is known already, or does not hold; the latest transaction is tx{done.number}"
    return f"recorded as tx{done.number} at {isoformat(done.time)}: {plural(done.changes, 'change')}"


# -- lines ----------------------------------------------------------------------------------------------------


def _parts(parts: Sequence[tuple[str, Sequence[str]]], narrower: Callable[[str, int], str]) -> Iterator[str]:
    """Yield parts, each under its name; `narrower` returns how to see the lines of a part from a number on."""
    sizes = [len(found) for _, found in parts]
    # a short part leaves its lines to the others
    shares = range(MOST_LINES, FEWEST_LINES, -1)
    most = next((most for most in shares if sum(min(size, most) for size in sizes) <= MOST_LINES), FEWEST_LINES)
    for name, found in parts:
        yield f"{name} ({len(found):,}):"
        yield from map(_line, found[:most])
        if len(found) > most:
            yield f"... {len(found) - most:,} more: to see them, {narrower(name, most)}"


def _listed(lines: Sequence[str], what: str, narrower: str) -> str:
    shown = [_line(line) for line in lines[:MOST_LINES]]
    if len(lines) > MOST_LINES:
        shown.append(f"... {plural(len(lines) - MOST_LINES, f'more {what}')}: to see them, {narrower}")
    return "\n".join(shown)


def _latest(lines: Sequence[str], times: Sequence[int], what: str) -> str:
    shown = [_line(line) for line in lines[-MOST_LINES:]]
    left = len(lines) - len(shown)
    if left:
        # if the last that is left out begins together with the first that is shown, `until` would leave both out
        earlier = (
            f'ask with until="{isoformat(times[left])}"' if times[left - 1] < times[left] else "narrow the pattern"
        )
        shown.insert(0, f"... {plural(left, f'earlier {what}')}: to see them, {earlier}")
    return "\n".join(shown)


def _line(text: str) -> str:
    # the indentation of an explanation's parts stays
    inside = text.lstrip(" ")
    return " " * (len(text) - len(inside)) + cut(printable(inside), LONGEST_LINE)


def cut(text: str, longest: int) -> str:
    """Cut a text to a length, and append how much was cut."""
    return text if len(text) <= longest else f"{text[:longest]} ... ({len(text) - longest:,} more characters)"


def _spaced(texts: Iterable[str]) -> Iterator[str]:
    """Yield texts with commas between them where they are not in brackets."""
    *first, last = texts
    yield from (text if text.endswith(")") else f"{text}," for text in first)
    yield last


def _pattern(item: KnowledgeItem) -> str:
    """Return a pattern that matches an item and others of its predicate, function or type."""
    if isinstance(item, Fact | Function):
        return bracketed(item.attribute_name, *"?" * len(item.arguments))
    return f"? - {item.instance_type}" if isinstance(item, Instance) else str(item)


def _objects(instances: Sequence[Instance]) -> Iterator[str]:
    by_type: dict[str, list[str]] = defaultdict(list)
    for instance in instances:
        by_type[instance.instance_type].append(instance.instance_name)
    for kind, names in by_type.items():
        left = len(names) - MOST_NAMES
        more = f" and {left:,} more: find those for which a condition is true" if left > 0 else ""
        yield f"{len(names):,} of type {kind}: {' '.join(names[:MOST_NAMES])}{more}"


def _since(item: KnowledgeItem | Condition) -> str:
    return f"{item} since {isoformat(item.initial_time)}"


def _number(item: Function) -> str:
    rate = f", changing by {format_number(item.rate)} per s" if item.rate else ""
    return f"{_since(item)}{rate}"


def _value(number: float | None) -> str:
    return "undefined" if number is None else format_number(number)


def _by(transaction: Transaction) -> str:
    client = f" by {transaction.client}" if transaction.client else ""
    note = f" ({transaction.note})" if transaction.note else ""
    return f"tx{transaction.number} at {isoformat(transaction.time)}{client}{note}"


def _assertion(found: Assertion) -> str:
    end = "on" if found.end_time is None else f"until {isoformat(found.end_time)}"
    text = f"{'goal ' if found.is_goal else ''}{found.item} from {isoformat(found.initial_time)} {end}"
    text += f"; recorded by {_by(found.recorded)}"
    for how, by in (("ended", found.ended), ("cancelled", found.cancelled), ("superseded", found.superseded)):
        if by is not None:
            text += f"; {how} by {_by(by)}"
    return text


def _run(run: Run) -> str:
    text = f"{run.action} {run.outcome}, started {isoformat(run.started)}"
    if run.ended is None:
        text += f", expected to end {isoformat(run.expected_end)}"
    else:
        text += f", {run.outcome} {isoformat(run.ended)} after {span(run.ended - run.started)}"
    broken = [f"; broken: {found}" for found in run.broken]
    return text + "".join(broken) + (f"; forced against {', '.join(run.forced)}" if run.forced else "")


def _explained(explanation: Explanation) -> Iterator[str]:
    waiting = [(explanation, 0)]
    while waiting:
        part, depth = waiting.pop()
        since = "" if part.since is None else f" since {isoformat(part.since)}"
        by = "" if part.transaction is None else f", {_by(part.transaction)}"
        yield f"{'  ' * depth}{part.subject} is {part.truth}: {part.reason}{since}{by}"
        waiting += [(inner, depth + 1) for inner in reversed(part.parts)]
