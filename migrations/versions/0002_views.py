"""The views for people who read SQL.

Times are ISO 8601 text in UTC with nine decimals, so that text sorts by time; the nanoseconds stand beside them.
What is open has no end. What holds "currently" holds at the latest recorded time of its knowledge base: there is no
clock in the database, and a simulated one may be decades away from it. A condition on `timeline_key` ("robot_at kenny
wp0") is answered by an index, however long the history.
"""

from alembic import op

revision = "0002"
down_revision = "0001"
branch_labels = None
depends_on = None

OPEN = 9223372036854775807
STATE, GOAL = 0, 1
OPEN_LEVEL, EMPTY = 62, -64
"""The levels of what is open, and of what is cancelled or has no length."""

TYPES = {"instances": 0, "facts": 1, "functions": 2, "expressions": 3, "inequalities": 4}
"""The knowledge types of the tables of assertions."""

TEXT = "coalesce(t.spelling, t.key)"
"""What a timeline is about, as it was first written: "robot_at kenny wp0"."""

ATOM = f"'(' || {TEXT} || ')'"
VALUE_AT_LAST = "f.function_value + f.rate * ((h.last_time - f.initial_time) / 1000000000.0)"
COMPARISON = "CASE f.comparison_type WHEN 0 THEN '>' WHEN 1 THEN '>=' WHEN 2 THEN '<' WHEN 3 THEN '<=' ELSE '=' END"

Columns = dict[str, str]
"""The columns of a view: name to SQL."""

GOALS: dict[str, str] = {
    "facts": ATOM,
    "inequalities": f"'(' || {COMPARISON} || ' ' || f.lhs || ' ' || f.rhs || ')'",
    "expressions": "f.expr",
}
"""The tables of assertions that can be goals, and the goal as PDDL text."""

VIEWS = (
    "transaction_log",
    "fact_history",
    "function_history",
    "instance_history",
    "goal_history",
    "current_facts",
    "current_functions",
    "current_instances",
    "current_goals",
    "run_history",
)


def upgrade() -> None:
    """Create the views."""
    create(
        "transaction_log",
        f"SELECT k.name AS knowledge_base, x.number AS number, {iso('x.recorded_time')} AS recorded_time,"
        " x.client AS client, x.note AS note, x.changes AS changes, x.recorded_time AS recorded_ns"
        " FROM transactions x JOIN knowledge_bases k ON k.id = x.kb_id",
    )
    fact = {"fact": signed(ATOM), **symbol(), "is_negative": "f.is_negative"}
    function = {"function": ATOM, **symbol()}
    instance = {"name": TEXT, "type": "f.instance_type", "is_negative": "f.is_negative"}
    create("fact_history", history("facts", fact))
    create("current_facts", current("facts", fact))
    create("function_history", history("functions", function | {"value": "f.function_value", "rate": "f.rate"}))
    create("current_functions", current("functions", function | {"value": VALUE_AT_LAST, "rate": "f.rate"}))
    create("instance_history", history("instances", instance))
    del instance["is_negative"]
    create("current_instances", current("instances", instance, also="AND NOT f.is_negative"))
    goals = [(table, {"goal": signed(text)}) for table, text in GOALS.items()]
    create("goal_history", " UNION ALL ".join(history(table, goal, GOAL) for table, goal in goals))
    create("current_goals", " UNION ALL ".join(current(table, goal, GOAL) for table, goal in goals))
    create("run_history", runs())


def downgrade() -> None:
    """Drop the views."""
    for name in reversed(VIEWS):
        op.execute(f"DROP VIEW {name}")


def create(name: str, select: str) -> None:
    """Create one view."""
    op.execute(f"CREATE VIEW {name} AS {select}")


def history(table: str, own: Columns, role: int = STATE) -> str:
    """All assertions of a table, cancelled and superseded ones included, with the transactions that made them so.

    An end that nobody had to write is the beginning of the next assertion, or the end of an object.
    """
    # of those that begin when it ends, the first to be recorded: the others are of no length, or late knowledge took
    # them away, or put them there later
    beginning_then = (
        f"SELECT q.recorded_tx FROM {table} q"
        " WHERE q.kb_id = f.kb_id AND q.timeline_id = f.timeline_id AND q.initial_time = f.end_time"
    )
    next_tx = (
        f"(SELECT min(q.recorded_tx) FROM ({beginning_then} AND q.retired_tx IS NULL"
        f" UNION ALL {beginning_then} AND q.retired_tx IS NOT NULL AND q.retired_tx > f.recorded_tx"
        f" AND NOT (q.level = {EMPTY} AND q.ended_tx IS NULL)) q)"
    )
    is_cancelled = f"f.level = {EMPTY} AND f.ended_tx IS NULL"
    # the transaction that ended it, or that recorded what ended it by the clock: the next one, or an object's end
    # what began at a time is found by the index of beginnings, on each level; what was superseded, on the negative ones
    levels = ", ".join(map(str, range(-1 - OPEN_LEVEL, OPEN_LEVEL + 1)))
    sqlite = op.get_context().dialect.name == "sqlite"
    by_begin, by_key = (f" INDEXED BY {name}" if sqlite else "" for name in ("ix_instances_begin", "ux_timelines_key"))
    ender = (
        f"CASE WHEN {is_cancelled} THEN NULL ELSE coalesce(f.ended_tx, {next_tx}, (SELECT min(o.recorded_tx)"
        f" FROM instances o{by_begin} CROSS JOIN mentions m"
        f" WHERE o.kb_id = f.kb_id AND o.level IN ({levels}) AND o.initial_time = f.end_time AND o.is_negative"
        " AND (o.retired_tx IS NULL OR o.retired_tx > f.recorded_tx)"
        " AND m.kb_id = f.kb_id AND m.object_id = o.timeline_id AND m.timeline_id = f.timeline_id)) END"
    )
    columns: Columns = {
        "knowledge_base": "k.name",
        **own,
        "initial_time": iso("f.initial_time"),
        "end_time": f"CASE WHEN f.end_time < {OPEN} THEN {iso('f.end_time')} END",
        "ended_by": (
            f"CASE WHEN {is_cancelled} THEN 'cancelled'"
            " WHEN f.end_cause = 1 THEN 'removed' WHEN f.end_cause = 2 THEN 'replaced'"
            " WHEN f.end_cause = 3 THEN 'object' WHEN f.end_cause = 4 THEN 'cleared' WHEN f.end_cause = 5 THEN 'run'"
            f" WHEN f.end_time = {OPEN} THEN NULL WHEN {next_tx} IS NOT NULL THEN 'replaced' ELSE 'object' END"
        ),
        "recorded_tx": "coalesce(f.told_tx, f.recorded_tx)",
        "recorded_time": f"CASE WHEN f.told_tx IS NULL THEN {iso('r.recorded_time')} ELSE {iso('p.recorded_time')} END",
        "recorded_client": "CASE WHEN f.told_tx IS NULL THEN r.client ELSE p.client END",
        # it is computed again only where that transaction has been archived
        "ended_tx": f"coalesce(e.number, {ender})",
        "ended_client": "e.client",
        "cancelled_tx": f"CASE WHEN {is_cancelled} THEN f.retired_tx END",
        "cancelled_time": f"CASE WHEN {is_cancelled} THEN {iso('c.recorded_time')} END",
        "cancelled_client": f"CASE WHEN {is_cancelled} THEN c.client END",
        "superseded_tx": f"CASE WHEN f.level <> {EMPTY} THEN f.retired_tx END",
        "known_from": iso("r.recorded_time"),
        "known_until": f"CASE WHEN f.level <> {EMPTY} THEN {iso('c.recorded_time')} END",
        "initial_ns": "f.initial_time",
        "end_ns": f"CASE WHEN f.end_time < {OPEN} THEN f.end_time END",
        "timeline_key": "t.key",
        "timeline_id": "f.timeline_id",
    }
    kind = TYPES[table]
    # in two parts, as each has an index of its own
    return " UNION ALL ".join(
        f"SELECT {listed(columns)} FROM knowledge_bases k"
        # in this order, whatever SQLite guesses
        f" CROSS JOIN timelines t{by_key} JOIN {table} f"
        f" ON t.kb_id = k.id AND t.role = {role} AND t.knowledge_type = {kind}"
        f" AND f.kb_id = k.id AND f.timeline_id = t.id AND f.retired_tx IS {retired}"
        " LEFT JOIN transactions r ON r.kb_id = f.kb_id AND r.number = f.recorded_tx"
        # of a part that late knowledge left
        " LEFT JOIN transactions p ON p.kb_id = f.kb_id AND p.number = f.told_tx"
        f" LEFT JOIN transactions e ON e.kb_id = f.kb_id AND e.number = {ender}"
        " LEFT JOIN transactions c ON c.kb_id = f.kb_id AND c.number = f.retired_tx"
        for retired in ("NULL", "NOT NULL")
    )


def current(table: str, own: Columns, role: int = STATE, also: str = "") -> str:
    """What holds at the latest recorded time; found by the interval tree, however long the history."""
    columns: Columns = {
        "knowledge_base": "k.name",
        **own,
        "initial_time": iso("f.initial_time"),
        "end_time": f"CASE WHEN f.end_time < {OPEN} THEN {iso('f.end_time')} END",
        "recorded_tx": "coalesce(f.told_tx, f.recorded_tx)",
        "recorded_client": "r.client",
        "initial_ns": "f.initial_time",
        "end_ns": f"CASE WHEN f.end_time < {OPEN} THEN f.end_time END",
        "as_of_ns": "h.last_time",
        "timeline_key": "t.key",
        "timeline_id": "f.timeline_id",
    }
    levels = (
        "(WITH RECURSIVE level(h) AS (SELECT 0 UNION ALL SELECT h + 1 FROM level WHERE h < 61) SELECT h FROM level)"
    )
    # the block of times on a level in which the latest one is, counted as the tree does
    block = "(((h.last_time + 1) >> l.h) << l.h)"
    past = f"({block} + (CAST(1 AS bigint) << l.h))"
    within = (
        f"f.level = l.h AND f.initial_time >= {block} - 1 AND f.initial_time <= h.last_time AND f.end_time >= {past}",
        # the last condition is the index's own
        f"f.level = l.h AND f.end_time > h.last_time AND f.end_time < {past} AND f.end_time < {OPEN}",
        f"f.level = {OPEN_LEVEL} AND f.initial_time <= h.last_time",
    )
    return " UNION ALL ".join(
        f"SELECT {listed(columns)} FROM knowledge_bases k CROSS JOIN heads h"
        f"{f' CROSS JOIN {levels} l' if 'l.h' in holds else ''} CROSS JOIN {table} f"
        f" JOIN timelines t ON t.kb_id = f.kb_id AND t.id = f.timeline_id AND t.role = {role}"
        " LEFT JOIN transactions r ON r.kb_id = f.kb_id AND r.number = coalesce(f.told_tx, f.recorded_tx)"
        f" WHERE h.kb_id = k.id AND f.kb_id = k.id AND {holds} {also}".rstrip()
        for holds in within
    )


def runs() -> str:
    """The durative actions, with the transactions that started and ended each (rule Q8)."""
    columns: Columns = {
        "knowledge_base": "k.name",
        "action": "'(' || r.operator || CASE WHEN r.arguments <> '' THEN ' ' || r.arguments ELSE '' END || ')'",
        "operator": "r.operator",
        "arguments": "r.arguments",
        "started": iso("r.initial_time"),
        "expected_end": iso("(r.initial_time + r.duration)"),
        "ended": f"CASE WHEN r.end_time < {OPEN} THEN {iso('r.end_time')} END",
        "outcome": "coalesce(r.outcome, 'running')",
        "duration_s": "r.duration_s",
        "forced": "r.forced",
        "started_tx": "r.recorded_tx",
        "started_client": "s.client",
        "ended_tx": "r.ended_tx",
        "ended_client": "e.client",
        "started_ns": "r.initial_time",
        "expected_end_ns": "r.initial_time + r.duration",
        "ended_ns": f"CASE WHEN r.end_time < {OPEN} THEN r.end_time END",
    }
    return (
        f"SELECT {listed(columns)} FROM knowledge_bases k JOIN runs r ON r.kb_id = k.id"
        " LEFT JOIN transactions s ON s.kb_id = k.id AND s.number = r.recorded_tx"
        " LEFT JOIN transactions e ON e.kb_id = k.id AND e.number = r.ended_tx"
    )


def symbol() -> Columns:
    """The name and the arguments of a fact or a function."""
    position = "instr" if op.get_context().dialect.name == "sqlite" else "strpos"
    place = f"{position}({TEXT} || ' ', ' ')"
    return {"name": f"substr({TEXT}, 1, {place} - 1)", "arguments": f"substr({TEXT}, {place} + 1)"}


def signed(text: str) -> str:
    """PDDL text, negated where the assertion is."""
    return f"CASE WHEN f.is_negative THEN '(not ' || {text} || ')' ELSE {text} END"


def iso(column: str) -> str:
    """A time as text."""
    seconds = f"{column} / 1000000000"
    if op.get_context().dialect.name == "sqlite":
        return f"strftime('%Y-%m-%dT%H:%M:%S', {seconds}, 'unixepoch') || printf('.%09dZ', {column} % 1000000000)"
    return (
        f"to_char(to_timestamp({seconds}) AT TIME ZONE 'UTC', 'YYYY-MM-DD\"T\"HH24:MI:SS')"
        f" || '.' || lpad(mod({column}, 1000000000)::text, 9, '0') || 'Z'"
    )


def listed(columns: Columns) -> str:
    """The columns as SQL lists them."""
    return ", ".join(f"{sql} AS {name}" for name, sql in columns.items())
