"""The views for people who read SQL.

Times are ISO 8601 text in UTC with nine decimals, so that text sorts by time; the nanoseconds stand beside them.
What is open has no end. What stands "currently" stands at the latest recorded time of its knowledge base: there is
no clock in the database, and a simulated one may be decades away from it.
"""

from alembic import op

revision = "0002"
down_revision = "0001"
branch_labels = None
depends_on = None

OPEN = 9223372036854775807
STATE, GOAL = 0, 1

TEXT = "coalesce(t.spelling, t.key)"
"""What a timeline is about, as it was first written: "robot_at kenny wp0"."""

ATOM = f"'(' || {TEXT} || ')'"
VALUE_AT_LAST = "f.function_value + f.rate * ((k.last_time - f.initial_time) / 1000000000.0)"
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


def downgrade() -> None:
    """Drop the views."""
    for name in reversed(VIEWS):
        op.execute(f"DROP VIEW {name}")


def create(name: str, select: str) -> None:
    """Create one view."""
    op.execute(f"CREATE VIEW {name} AS {select}")


def history(table: str, own: Columns, role: int = STATE) -> str:
    """All assertions of a table, cancelled ones included, with the transactions that recorded and ended them.

    An end that nobody had to write is the beginning of the next assertion, or the end of an object.
    """
    # the transaction that ended it, or that recorded what ended it by the clock: the next one, or an object's end
    ender = (
        "CASE WHEN f.cancelled_tx IS NULL THEN coalesce(f.ended_tx, n.recorded_tx, (SELECT min(o.recorded_tx)"
        " FROM mentions m JOIN instances o ON o.kb_id = m.kb_id AND o.timeline_id = m.object_id"
        " WHERE m.kb_id = f.kb_id AND m.timeline_id = f.timeline_id AND o.initial_time = f.end_time"
        " AND o.end_time > o.initial_time AND o.is_negative)) END"
    )
    columns: Columns = {
        "knowledge_base": "k.name",
        **own,
        "initial_time": iso("f.initial_time"),
        "end_time": f"CASE WHEN f.end_time < {OPEN} THEN {iso('f.end_time')} END",
        "ended_by": (
            "CASE WHEN f.cancelled_tx IS NOT NULL THEN 'cancelled'"
            " WHEN f.end_cause = 1 THEN 'removed' WHEN f.end_cause = 2 THEN 'replaced'"
            " WHEN f.end_cause = 3 THEN 'object' WHEN f.end_cause = 4 THEN 'cleared' WHEN f.end_cause = 5 THEN 'run'"
            f" WHEN f.end_time = {OPEN} THEN NULL WHEN n.id IS NOT NULL THEN 'replaced' ELSE 'object' END"
        ),
        "recorded_tx": "f.recorded_tx",
        "recorded_time": iso("r.recorded_time"),
        "recorded_client": "r.client",
        "ended_tx": ender,
        "ended_client": "e.client",
        "cancelled_tx": "f.cancelled_tx",
        "cancelled_time": iso("f.cancelled_time"),
        "cancelled_client": "c.client",
        "initial_ns": "f.initial_time",
        "end_ns": f"CASE WHEN f.end_time < {OPEN} THEN f.end_time END",
    }
    # of several that begin when it ends, the first to be recorded; all but the last of them are of no length
    next_one = (
        f"SELECT min(q.id) FROM {table} q"
        " WHERE q.kb_id = f.kb_id AND q.timeline_id = f.timeline_id AND q.initial_time = f.end_time"
    )
    return (
        f"SELECT {listed(columns)} FROM {table} f"
        f" JOIN timelines t ON t.id = f.timeline_id AND t.role = {role}"
        " JOIN knowledge_bases k ON k.id = f.kb_id"
        f" LEFT JOIN {table} n ON f.ended_tx IS NULL AND f.cancelled_tx IS NULL"
        f" AND n.id = coalesce(({next_one} AND q.end_time <= q.initial_time AND q.cancelled_tx IS NULL),"
        f" ({next_one} AND q.end_time > q.initial_time))"
        " LEFT JOIN transactions r ON r.kb_id = f.kb_id AND r.number = f.recorded_tx"
        f" LEFT JOIN transactions e ON e.kb_id = f.kb_id AND e.number = {ender}"
        " LEFT JOIN transactions c ON c.kb_id = f.kb_id AND c.number = f.cancelled_tx"
    )


def current(table: str, own: Columns, role: int = STATE, also: str = "") -> str:
    """What stands at the latest recorded time; found by the interval tree, however long the history."""
    columns: Columns = {
        "knowledge_base": "k.name",
        **own,
        "initial_time": iso("f.initial_time"),
        "end_time": f"CASE WHEN f.end_time < {OPEN} THEN {iso('f.end_time')} END",
        "recorded_tx": "f.recorded_tx",
        "recorded_client": "r.client",
        "initial_ns": "f.initial_time",
        "end_ns": f"CASE WHEN f.end_time < {OPEN} THEN f.end_time END",
        "as_of_ns": "k.last_time",
    }
    levels = (
        "(WITH RECURSIVE level(h) AS (SELECT 0 UNION ALL SELECT h + 1 FROM level WHERE h < 61) SELECT h FROM level)"
    )
    # the block of times on a level in which the latest one is, counted as the tree does
    block = "(((k.last_time + 1) >> l.h) << l.h)"
    past = f"({block} + (CAST(1 AS bigint) << l.h))"
    # where this is asked for, PostgreSQL takes the index that has it as its condition
    by_index = "" if op.get_context().dialect.name == "sqlite" else " AND f.{} >= 0"
    within = (
        f"f.level = l.h AND f.initial_time >= {block} - 1 AND f.initial_time <= k.last_time AND f.end_time >= {past}"
        + by_index.format("initial_time"),
        f"f.level = l.h AND f.end_time > k.last_time AND f.end_time < {past}" + by_index.format("end_time"),
        f"f.end_time = {OPEN} AND f.initial_time <= k.last_time",
    )
    return " UNION ALL ".join(
        f"SELECT {listed(columns)} FROM knowledge_bases k{f' CROSS JOIN {levels} l' if 'l.h' in stands else ''}"
        f" CROSS JOIN {table} f JOIN timelines t ON t.id = f.timeline_id AND t.role = {role}"
        " LEFT JOIN transactions r ON r.kb_id = f.kb_id AND r.number = f.recorded_tx"
        f" WHERE f.kb_id = k.id AND {stands} {also}".rstrip()
        for stands in within
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
