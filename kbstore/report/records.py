"""Shows the record as tables and trees: histories, transactions, differences, intervals, explanations."""

from collections.abc import Iterable, Mapping, Sequence

from rich.console import Group, RenderableType
from rich.text import Text
from rich.tree import Tree

from kbstore.clock import isoformat
from kbstore.evaluation.intervals import Intervals
from kbstore.messages import Condition, KnowledgeItem, format_number
from kbstore.model.results import Applicability, Assertion, Change, Diff, Explanation, Run, Transaction
from kbstore.report.tables import DIM, FALSE, TITLE, plural, printable, table
from kbstore.report.time_format import DAY, TimeFormat, span


def history_view(assertions: Sequence[Assertion]) -> RenderableType:
    """Show assertions as a table; if all times are of one day, that is a heading, and the table fits 100 columns."""
    if not assertions:
        return Text("nothing is recorded of it in that span")
    times = [
        t
        for found in assertions
        for t in (found.initial_time, found.end_time, *(by.time for by in (found.recorded, found.ended) if by))
        if t is not None
    ]
    times += [found.cancelled.time for found in assertions if found.cancelled]
    moments = TimeFormat(times[0], brief=len({t // DAY for t in times}) == 1)
    shown = history_table(assertions, moments)
    return Group(Text(f"Times of {isoformat(times[0])[:10]}, UTC", DIM), shown) if moments.brief else shown


def history_table(assertions: Sequence[Assertion], moments: TimeFormat) -> RenderableType:
    """Show assertions in order of time: when each held, who recorded it, and who ended or cancelled it."""
    rows = [
        (
            item_text(found.item),
            moments.absolute(found.initial_time),
            moments.absolute(found.end_time) if found.cancelled is None else Text("cancelled", FALSE),
            span(found.end_time - found.initial_time) if found.end_time is not None and not found.cancelled else "",
            by(found.recorded, moments, found.initial_time),
            outcome(found, moments),
        )
        for found in assertions
    ]
    return table("", ("knowledge", "from", "until", ">for", "recorded", "ended or cancelled"), rows)


def bindings_table(bindings: Sequence[Mapping[str, str]]) -> RenderableType:
    """Show bindings of variables, with a column for each variable."""
    if not bindings:
        return Text("none")
    if not bindings[0]:
        return Text("true, without variables")
    return table("", tuple(f"?{name}" for name in bindings[0]), [tuple(row.values()) for row in bindings])


def runs_view(runs: Sequence[Run]) -> RenderableType:
    """Show runs as a table, and below it the invariants that were broken."""
    if not runs:
        return Text("nothing ran in that span")
    times = [t for run in runs for t in (run.started, run.expected_end, run.ended) if t is not None]
    moments = TimeFormat(times[0], brief=len({t // DAY for t in times}) == 1)
    rows = [
        (
            run.action,
            moments.absolute(run.started),
            moments.absolute(run.expected_end),
            moments.absolute(run.ended),
            "" if run.ended is None else span(run.ended - run.started),
            run.outcome,
        )
        for run in runs
    ]
    found = [table("", ("action", "started", "expected end", "ended", ">after", "outcome"), rows)]
    if moments.brief:
        found.insert(0, Text(f"Times of {isoformat(times[0])[:10]}, UTC", DIM))
    found += [
        Text(f"{run.action}: {broken.condition} was {broken.truth} {moments.interval(broken.since, broken.until)}")
        for run in runs
        for broken in run.broken
    ]
    found += [Text(f"{run.action} was forced against {', '.join(run.forced)}") for run in runs if run.forced]
    return Group(*found)


def outcome(found: Assertion, moments: TimeFormat) -> str:
    """Return which transaction ended an assertion, cancelled it before it took effect, or superseded it."""
    if found.superseded is not None:
        return f"superseded by {by(found.superseded, moments)}"
    if found.cancelled is not None:
        return by(found.cancelled, moments)
    return "" if found.ended is None else by(found.ended, moments, found.end_time)


def by(transaction: Transaction, moments: TimeFormat, beside: int | None = None) -> str:
    """Return a transaction in a few words: its number, its client, and its time unless that is `beside` it already."""
    client = f" by {printable(transaction.client)}" if transaction.client else ""
    time = "" if transaction.time == beside else f" at {moments.absolute(transaction.time)}"
    return f"#{transaction.number}{client}{time}"


def log_table(transactions: Iterable[Transaction], moments: TimeFormat) -> RenderableType:
    """Show transactions, one per line."""
    rows = [
        (f"#{tx.number}", moments.absolute(tx.time), printable(tx.client), printable(tx.note), str(tx.changes))
        for tx in transactions
    ]
    return table("", (">", "time", "client", "note", ">changes"), rows)


def change_view(change: Change, moments: TimeFormat) -> RenderableType:
    """Show the changes of one transaction, or those by the clock.

    ``+`` asserted, ``-`` ended, ``x`` cancelled, ``~`` superseded.
    """
    if change.time != change.transaction.time:
        title = Text(f"{moments.absolute(change.time)} by the clock", TITLE)
    else:
        title = Text(by(change.transaction, moments), TITLE)
        if change.transaction.note:
            title.append(f"  {printable(change.transaction.note)}", "not bold")
    lines = [title]
    for sign, found in (("+", change.asserted), ("-", change.ended), ("x", change.cancelled), ("~", change.superseded)):
        for assertion in found:
            line = Text(f"  {sign} {'goal ' if assertion.is_goal else ''}").append_text(item_text(assertion.item))
            if sign != "-" and assertion.initial_time > change.time:
                line.append(f"  for {moments.absolute(assertion.initial_time)}", DIM)
            elif sign in "+~" and assertion.initial_time < change.time:
                line.append(f"  since {moments.absolute(assertion.initial_time)}", DIM)
            lines.append(line)
    return Group(*lines)


def diff_view(diff: Diff) -> RenderableType:
    """Show the differences between two times, one per line."""
    rows: list[tuple[str, Text | str]] = []
    for what, items in (
        ("became true", diff.became_true),
        ("became false", diff.became_false),
        ("withdrawn", diff.withdrawn),
        ("goal added", diff.goals_added),
        ("goal removed", diff.goals_removed),
    ):
        rows += [(what, item_text(item)) for item in items]
    rows += [
        ("changed", f"{function.atom} from {_number(before)} to {_number(after)}")
        for function, before, after in diff.numbers
    ]
    if diff.metric:
        before, after = diff.metric
        rows.append(("metric", f"from {before or 'none'} to {after or 'none'}"))
    return table("", ("what", "knowledge"), rows) if rows else Text("no difference")


def intervals_table(found: Intervals, moments: TimeFormat) -> RenderableType:
    """Show the intervals in which a condition is true, and for how long altogether."""
    if not found:
        return Text("never true in that span")
    rows = [(moments.absolute(start), moments.absolute(end), span(end - start)) for start, end in found]
    total = Text(f"true for {span(found.total)} altogether, in {plural(len(found), 'interval')}", DIM)
    return Group(table("", ("from", "until", ">for"), rows), total)


def explanation_tree(explanation: Explanation, moments: TimeFormat) -> RenderableType:
    """Show an explanation, with the parts that decide it below."""
    root = Tree(_explanation_line(explanation, moments))
    waiting = [(root, part) for part in reversed(explanation.parts)]
    while waiting:
        above, part = waiting.pop()
        node = above.add(_explanation_line(part, moments))
        waiting += [(node, inner) for inner in reversed(part.parts)]
    return root


def _explanation_line(explanation: Explanation, moments: TimeFormat) -> Text:
    line = Text(f"{explanation.subject} is {explanation.truth}: ")
    if [part.reason for part in explanation.parts] == [explanation.reason]:
        return line.append("because", TITLE)
    line.append(explanation.reason, TITLE)
    if explanation.since is not None:
        line.append(f" since {moments.absolute(explanation.since)} ({moments.relative(explanation.since)})")
    if explanation.transaction is not None:
        line.append(f", {by(explanation.transaction, moments, explanation.since)}")
        if explanation.transaction.note:
            line.append(f" ({printable(explanation.transaction.note)})")
    return line


def applicability_view(action: str, answer: Applicability, moments: TimeFormat) -> RenderableType:
    """Show whether an action can be applied, and which conditions fail."""
    if answer:
        return Text(f"{action} is applicable")
    lines = [Text(f"{action} is not applicable:")]
    for failing in answer.failing:
        since = "" if failing.since is None else f" since {moments.absolute(failing.since)}"
        ago = "" if failing.since is None else f" ({moments.relative(failing.since)})"
        lines.append(Text(f"  {failing.condition} is {failing.verdict}{since}{ago}"))
    return Group(*lines)


def item_text(item: KnowledgeItem | Condition) -> Text:
    """Return an item in PDDL, coloured if it is explicitly false."""
    return Text(str(item), FALSE if getattr(item, "is_negative", False) else "")


def _number(value: float | None) -> str:
    return "undefined" if value is None else format_number(value)
