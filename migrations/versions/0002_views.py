"""The views for people who read SQL.

Times are ISO 8601 text in UTC with nine decimals, so that text sorts by time; the nanoseconds stand beside them.
What is open has no end. What holds "currently" holds at the latest recorded time of its knowledge base: there is no
clock in the database, and a simulated one may be decades away from it. A condition on `timeline_key` ("robot_at kenny
wp0") is answered by an index, however long the history.

In each view an inner SELECT finds the assertions, and outer ones compute and format their columns. Both engines merge
them, so that a column which nobody asks for is not computed. SQLite does not where the question is an aggregate, but
moves conditions to the inner one; therefore a UNION stands around joins, and never within one. The text is short
because SQLite parses it on every new connection.
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

COMPARISON = "CASE f.comparison_type WHEN 0 THEN '>' WHEN 1 THEN '>=' WHEN 2 THEN '<' WHEN 3 THEN '<=' ELSE '=' END"

GOALS = {
    "facts": "'(' || f.about || ')'",
    "inequalities": f"'(' || {COMPARISON} || ' ' || f.lhs || ' ' || f.rhs || ')'",
    "expressions": "f.expr",
}
"""The tables of assertions that can be goals, and the goal as PDDL text."""

COMMON = (
    "f.knowledge_base, f.kb_id, f.timeline_key, f.timeline_id, f.is_negative, f.initial_time, f.end_time,"
    " f.recorded_tx, f.told_tx"
)
"""The columns that the views of goals need from each table."""

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
    atom = "'(' || a.about || ')'"
    fact = f"{signed(atom)} AS fact, {symbol()}, a.is_negative AS is_negative"
    function = f"{atom} AS function, {symbol()}"
    value_at_last = "a.function_value + a.rate * ((a.last_time - a.initial_time) / 1000000000.0)"
    instance = "a.about AS name, a.instance_type AS type"
    goal = f"{signed('a.goal')} AS goal"
    ended, lasting = f"{COMMON}, f.level, f.end_cause, f.ended_tx, f.retired_tx", f"{COMMON}, f.last_time"
    create("transaction_log", transactions())
    create("fact_history", history(fact, asserted("facts")))
    create("current_facts", current(fact, holding("facts")))
    create("function_history", history(f"{function}, a.function_value AS value, a.rate AS rate", asserted("functions")))
    create("current_functions", current(f"{function}, {value_at_last} AS value, a.rate AS rate", holding("functions")))
    create("instance_history", history(f"{instance}, a.is_negative AS is_negative", asserted("instances")))
    create("current_instances", current(instance, holding("instances")) + "\nWHERE NOT a.is_negative")
    create(
        "goal_history",
        history(goal, *(asserted(table, GOAL, f"{ended}, {text} AS goal") for table, text in GOALS.items())),
    )
    create(
        "current_goals",
        current(goal, *(holding(table, GOAL, f"{lasting}, {text} AS goal") for table, text in GOALS.items())),
    )
    create("run_history", runs())


def downgrade() -> None:
    """Drop the views."""
    for name in reversed(VIEWS):
        op.execute(f"DROP VIEW {name}")


def create(name: str, select: str) -> None:
    """Create one view."""
    op.execute(f"CREATE VIEW {name} AS\n{select}")


def is_sqlite() -> bool:
    """Whether the views are for SQLite; otherwise they are for PostgreSQL."""
    return op.get_context().dialect.name == "sqlite"


def history(own: str, *found: str) -> str:
    """All assertions, cancelled and superseded ones included, with the transactions that made them so.

    An end that nobody had to write is the beginning of the next assertion, or the end of an object. It is computed
    again only where the transaction that did it has been archived.
    """
    return f"""SELECT a.knowledge_base AS knowledge_base, {own},
  {iso("a.initial_time")} AS initial_time,
  {iso("a.end_ns")} AS end_time,
  a.ended_by AS ended_by, a.first_tx AS recorded_tx,
  {iso("p.recorded_time")} AS recorded_time,
  p.client AS recorded_client, coalesce(e.number, a.ender_tx) AS ended_tx, e.client AS ended_client,
  a.cancelled_tx AS cancelled_tx,
  {iso("c.recorded_time")} AS cancelled_time,
  c.client AS cancelled_client, a.superseded_tx AS superseded_tx,
  {iso("r.recorded_time")} AS known_from,
  {iso("s.recorded_time")} AS known_until,
  a.initial_time AS initial_ns, a.end_ns AS end_ns, a.timeline_key AS timeline_key, a.timeline_id AS timeline_id
FROM (
  SELECT f.*, nullif(f.end_time, {OPEN}) AS end_ns, coalesce(f.told_tx, f.recorded_tx) AS first_tx,
    CASE WHEN f.is_cancelled THEN f.retired_tx END AS cancelled_tx,
    CASE WHEN f.level <> {EMPTY} THEN f.retired_tx END AS superseded_tx,
    CASE WHEN f.is_cancelled THEN 'cancelled' WHEN f.end_cause = 1 THEN 'removed' WHEN f.end_cause = 2 THEN 'replaced'
      WHEN f.end_cause = 3 THEN 'object' WHEN f.end_cause = 4 THEN 'cleared' WHEN f.end_cause = 5 THEN 'run'
      WHEN f.end_time = {OPEN} THEN NULL WHEN f.next_tx IS NULL THEN 'object' ELSE 'replaced' END AS ended_by,
    CASE WHEN f.end_time < {OPEN} AND NOT f.is_cancelled
      THEN coalesce(f.ended_tx, f.next_tx, ({object_end()})) END AS ender_tx
  FROM ({" UNION ALL".join(found)}) f
) a
LEFT JOIN transactions r ON r.kb_id = a.kb_id AND r.number = a.recorded_tx
LEFT JOIN transactions p ON p.kb_id = a.kb_id AND p.number = a.first_tx
LEFT JOIN transactions e ON e.kb_id = a.kb_id AND e.number = a.ender_tx
LEFT JOIN transactions c ON c.kb_id = a.kb_id AND c.number = a.cancelled_tx
LEFT JOIN transactions s ON s.kb_id = a.kb_id AND s.number = a.superseded_tx"""


def asserted(table: str, role: int = STATE, own: str = "f.*") -> str:
    """The assertions of a table, each with the first transaction that recorded what begins when it ends.

    The others that begin then are of no length, or late knowledge took them away, or put them there later.
    """
    next_tx = (
        f"SELECT recorded_tx FROM {table}"
        " WHERE kb_id = f.kb_id AND timeline_id = f.timeline_id AND initial_time = f.end_time AND retired_tx"
    )
    # what was retired has an index of its own; joined in this order, whatever SQLite guesses
    hint = " INDEXED BY ux_timelines_key" if is_sqlite() else ""
    arms = " UNION ALL".join(
        f"""
    SELECT k.name AS knowledge_base, t.key AS timeline_key, coalesce(t.spelling, t.key) AS about, f.*
    FROM knowledge_bases k CROSS JOIN timelines t{hint} CROSS JOIN {table} f
    WHERE t.kb_id = k.id AND t.role = {role} AND t.knowledge_type = {TYPES[table]}
      AND f.kb_id = k.id AND f.timeline_id = t.id AND f.retired_tx IS {retired}"""
        for retired in ("NULL", "NOT NULL")
    )
    return f"""
  SELECT {own}, f.level = {EMPTY} AND f.ended_tx IS NULL AS is_cancelled,
    (SELECT min(recorded_tx) FROM ({next_tx} IS NULL UNION ALL
      {next_tx} > f.recorded_tx AND NOT (level = {EMPTY} AND ended_tx IS NULL)) q) AS next_tx
  FROM ({arms}) f"""


def object_end() -> str:
    """The transaction that recorded the end of an object, and with it that of an assertion which mentions the object.

    What begins at a time is found by the index of beginnings, on each level; the negative ones have what is superseded,
    the lowest what was cancelled, or removed at the same time.
    """
    levels = (
        f"WITH RECURSIVE levels(h) AS (SELECT {EMPTY} UNION ALL SELECT h + 1 FROM levels"
        f" WHERE h < {OPEN_LEVEL}) SELECT h FROM levels"
    )
    among, hint = f"= ANY(ARRAY({levels}))", ""
    if is_sqlite():
        among, hint = f"IN ({levels})", " INDEXED BY ix_instances_begin"
    return f"""
      SELECT min(o.recorded_tx) FROM instances o{hint} CROSS JOIN mentions m
      WHERE o.kb_id = f.kb_id AND o.level {among}
        AND o.initial_time = f.end_time AND o.is_negative AND NOT (o.level = {EMPTY} AND o.ended_tx IS NULL)
        AND (o.retired_tx IS NULL OR o.retired_tx > f.recorded_tx)
        AND m.kb_id = f.kb_id AND m.object_id = o.timeline_id AND m.timeline_id = f.timeline_id"""


def current(own: str, *found: str) -> str:
    """What holds at the latest recorded time."""
    return f"""SELECT a.knowledge_base AS knowledge_base, {own},
  {iso("a.initial_time")} AS initial_time,
  {iso(f"nullif(a.end_time, {OPEN})")} AS end_time,
  coalesce(a.told_tx, a.recorded_tx) AS recorded_tx, r.client AS recorded_client,
  a.initial_time AS initial_ns, nullif(a.end_time, {OPEN}) AS end_ns, a.last_time AS as_of_ns,
  a.timeline_key AS timeline_key, a.timeline_id AS timeline_id
FROM ({" UNION ALL".join(found)}) a
LEFT JOIN transactions r ON r.kb_id = a.kb_id AND r.number = coalesce(a.told_tx, a.recorded_tx)"""


def holding(table: str, role: int = STATE, own: str = "f.*") -> str:
    """The assertions of a table that hold then, found by the interval tree, however long the history."""
    # on each level, the latest time is in a block of times; counted as the tree does
    levels = f"""(
      WITH RECURSIVE levels(h, width) AS (SELECT 0, CAST(1 AS bigint) UNION ALL
        SELECT h + 1, width * 2 FROM levels WHERE h < {OPEN_LEVEL - 1}) SELECT h, width FROM levels) l CROSS JOIN """
    block, past = "(h.last_time + 1) / l.width * l.width", "((h.last_time + 1) / l.width + 1) * l.width"
    within = (
        f"f.level = l.h AND f.initial_time >= {block} - 1 AND f.initial_time <= h.last_time AND f.end_time >= {past}",
        # the last condition is the index's own
        f"f.level = l.h AND f.end_time > h.last_time AND f.end_time < {past} AND f.end_time < {OPEN}",
        f"f.level = {OPEN_LEVEL} AND f.initial_time <= h.last_time",
    )
    arms = " UNION ALL".join(
        f"""
    SELECT k.name AS knowledge_base, t.key AS timeline_key, coalesce(t.spelling, t.key) AS about, h.last_time, f.*
    FROM knowledge_bases k CROSS JOIN heads h CROSS JOIN {levels if "l.h" in holds else ""}{among(table, holds)}
    JOIN timelines t ON t.kb_id = f.kb_id AND t.id = f.timeline_id AND t.role = {role}
    WHERE h.kb_id = k.id AND f.kb_id = k.id{f" AND {holds}" if is_sqlite() else ""}"""
        for holds in within
    )
    return f"""
  SELECT {own} FROM ({arms}) f"""


def among(table: str, holds: str) -> str:
    """A table in a join; on PostgreSQL with the condition, so that it goes down its index once for each level."""
    if is_sqlite():
        return f"{table} f"
    return f"LATERAL (SELECT * FROM {table} f WHERE f.kb_id = k.id AND {holds} OFFSET 0) f"


def transactions() -> str:
    """All transactions."""
    return f"""SELECT k.name AS knowledge_base, x.number AS number,
  {iso("x.recorded_time")} AS recorded_time,
  x.client AS client, x.note AS note, x.changes AS changes, x.recorded_time AS recorded_ns
FROM transactions x JOIN knowledge_bases k ON k.id = x.kb_id"""


def runs() -> str:
    """The durative actions, with the transactions that started and ended each (rule Q8)."""
    return f"""SELECT k.name AS knowledge_base,
  '(' || r.operator || CASE WHEN r.arguments <> '' THEN ' ' || r.arguments ELSE '' END || ')' AS action,
  r.operator AS operator, r.arguments AS arguments,
  {iso("r.initial_time")} AS started,
  {iso("(r.initial_time + r.duration)")} AS expected_end,
  {iso(f"nullif(r.end_time, {OPEN})")} AS ended,
  coalesce(r.outcome, 'running') AS outcome, r.duration_s AS duration_s, r.forced AS forced,
  r.recorded_tx AS started_tx, s.client AS started_client, r.ended_tx AS ended_tx, e.client AS ended_client,
  r.initial_time AS started_ns, r.initial_time + r.duration AS expected_end_ns, nullif(r.end_time, {OPEN}) AS ended_ns
FROM knowledge_bases k JOIN runs r ON r.kb_id = k.id
LEFT JOIN transactions s ON s.kb_id = k.id AND s.number = r.recorded_tx
LEFT JOIN transactions e ON e.kb_id = k.id AND e.number = r.ended_tx"""


def symbol() -> str:
    """The name and the arguments of a fact or a function."""
    place = f"{'instr' if is_sqlite() else 'strpos'}(a.about || ' ', ' ')"
    return f"substr(a.about, 1, {place} - 1) AS name, substr(a.about, {place} + 1) AS arguments"


def signed(text: str) -> str:
    """PDDL text, negated where the assertion is."""
    return f"CASE WHEN a.is_negative THEN '(not ' || {text} || ')' ELSE {text} END"


def iso(column: str) -> str:
    """A time as text; NULL of NULL."""
    seconds = f"{column} / 1000000000"
    if is_sqlite():
        return f"strftime('%Y-%m-%dT%H:%M:%S', {seconds}, 'unixepoch') || printf('.%09dZ', {column} % 1000000000)"
    return (
        f"to_char(to_timestamp({seconds}) AT TIME ZONE 'UTC', 'YYYY-MM-DD\"T\"HH24:MI:SS')"
        f" || '.' || lpad(mod({column}, 1000000000)::text, 9, '0') || 'Z'"
    )
