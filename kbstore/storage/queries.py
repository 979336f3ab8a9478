"""Every SQL statement of kbstore, by name.

Statements are written once for SQLite and PostgreSQL (see `Statement`). Rows of the five tables of assertions are
read by the same statements with each table's own columns; `for_kind` has them by knowledge type.
"""

from kbstore.clock import OPEN
from kbstore.messages import KnowledgeType
from kbstore.model.timelines import EndCause
from kbstore.storage.statements import Insertion, Lookup, Statement

# -- knowledge bases and transactions -------------------------------------------------------------------------

knowledge_base_names = Statement("SELECT name FROM knowledge_bases ORDER BY name")

find_knowledge_base = Statement("SELECT id, use_unknowns FROM knowledge_bases WHERE name = :name")

add_knowledge_base = Statement(
    "INSERT INTO knowledge_bases"
    " (name, use_unknowns, last_number, last_time, history_from, domain_version, last_run)"
    " VALUES (:name, :use_unknowns, 0, 0, 0, 0, 0) ON CONFLICT (name) DO NOTHING"
)

_HEAD = "SELECT last_number, last_time, history_from, domain_version, last_run FROM knowledge_bases WHERE id = :kb"

head = Statement(_HEAD)

head_for_update = Statement(_HEAD + " FOR UPDATE")

advance_head = Statement(
    "UPDATE knowledge_bases SET last_number = :number, last_time = :time,"
    " domain_version = :domain_version, last_run = :last_run WHERE id = :kb"
)

add_transaction = Statement(
    "INSERT INTO transactions (kb_id, number, recorded_time, changes, client, note)"
    " VALUES (:kb, :number, :time, :changes, :client, :note)"
)

_TRANSACTION = "SELECT number, recorded_time, changes, client, note FROM transactions WHERE kb_id = :kb"

transactions_between = Statement(_TRANSACTION + " AND number > :after AND number <= :upto ORDER BY number")

transactions_numbered = Statement(_TRANSACTION + " AND AMONG(number, numbers)")

first_transaction_from = Statement(
    "SELECT number FROM transactions WHERE kb_id = :kb AND recorded_time >= :time ORDER BY number LIMIT 1"
)

last_transaction_at = Statement(
    "SELECT number FROM transactions WHERE kb_id = :kb AND number >= :number AND recorded_time = :time"
    " ORDER BY number DESC LIMIT 1"
)

# -- domains and symbols --------------------------------------------------------------------------------------

domain_versions = Statement(
    "SELECT version, initial_time, recorded_tx, source, sensed FROM domains"
    " WHERE kb_id = :kb AND version > :after ORDER BY version"
)

add_domain = Statement(
    "INSERT INTO domains (kb_id, version, initial_time, recorded_tx, name, source, sensed)"
    " VALUES (:kb, :version, :time, :number, :name, :source, :sensed)"
)

symbols = Statement("SELECT knowledge_type, key, name, arity, labels FROM symbols WHERE kb_id = :kb")

put_symbol = Statement(
    "INSERT INTO symbols (kb_id, knowledge_type, key, name, arity, labels)"
    " VALUES (:kb, :kind, :key, :name, :arity, :labels)"
    " ON CONFLICT (kb_id, knowledge_type, key) DO UPDATE SET labels = excluded.labels"
)

# -- timelines ------------------------------------------------------------------------------------------------

_TIMELINE = "SELECT id, role, knowledge_type, key, spelling FROM timelines WHERE kb_id = :kb"

timelines_by_id = Statement(
    "SELECT t.id, t.role, t.knowledge_type, t.key, t.spelling FROM EACH(ids AS bigint) CROSS JOIN timelines t"
    " WHERE t.id = value",
    "SELECT id, role, knowledge_type, key, spelling FROM timelines WHERE AMONG(id, ids)",
)

timelines_by_key = Statement(
    "SELECT t.id, t.role, t.knowledge_type, t.key, t.spelling FROM EACH(keys AS text) CROSS JOIN timelines t"
    " WHERE t.kb_id = :kb AND t.role = :role AND t.knowledge_type = :kind AND t.key = value"
)

timeline_by_key = Statement(_TIMELINE + " AND role = :role AND knowledge_type = :kind AND key = :key")

timelines_of_symbol = Statement(
    _TIMELINE + " AND role = :role AND knowledge_type = :kind AND (key = :name OR (key >= :first AND key < :last))"
)

timelines_of_kind = Statement(_TIMELINE + " AND role = :role AND knowledge_type = :kind")

timelines_mentioning = Statement(
    "SELECT t.id, t.role, t.knowledge_type, t.key, t.spelling"
    " FROM mentions m CROSS JOIN timelines t"
    " WHERE m.kb_id = :kb AND AMONG(m.object_id, ids) AND t.id = m.timeline_id"
)

add_timeline = Insertion("timelines", "kb_id", "id", "role", "knowledge_type", "key", "spelling")

add_mention = Insertion(
    "mentions", "kb_id", "object_id", "timeline_id", conflict="(kb_id, object_id, timeline_id) DO NOTHING"
)


def _in_tree(table: str, columns: str, recorded: str = "") -> tuple[str, str]:
    """What stands at :t, in both dialects: on each level one range of beginnings or of ends, and what is open.

    `recorded` is the parameter that says up to which transaction rows had been recorded.
    """
    within = {
        ("begin", "begins"): "initial_time >= value AND initial_time <= :t",
        ("end", "ends"): "end_time > :t AND end_time < value",
    }
    known = f" AND recorded_tx <= {recorded}" if recorded else ""
    still = (
        f"SELECT {columns} FROM {table} BY(ix_{table}_open)"
        f" WHERE kb_id = :kb AND end_time = {OPEN} AND initial_time <= :t{known}"
    )
    sqlite = [
        f"SELECT {columns} FROM EACH({bounds} AS bigint) CROSS JOIN {table} BY(ix_{table}_{index})"
        f" WHERE kb_id = :kb AND level = json_each.key AND {range}{known}"
        for (index, bounds), range in within.items()
    ]
    # as a subquery of its own, or the plan for a small table would read all of it, and be kept; and with the condition
    # that names the index
    postgresql = [
        f"SELECT found.* FROM unnest(CAST(:{bounds} AS bigint[])) WITH ORDINALITY AS bounds(value, place) CROSS JOIN"
        f" LATERAL (SELECT {columns} FROM {table} WHERE kb_id = :kb AND level = place - 1 AND {range}{known}"
        f" AND {range.partition(' ')[0]} >= 0 OFFSET 0) found"
        for (_, bounds), range in within.items()
    ]
    return " UNION ALL ".join((*sqlite, still)), " UNION ALL ".join((*postgresql, still))


def _ended(table: str, columns: str, after: str, upto: str) -> str:
    """What the transactions after a number and up to another ended, but for what they replaced."""
    return (
        f"SELECT {columns} FROM {table} WHERE kb_id = :kb AND end_cause <> {int(EndCause.REPLACED)}"
        f" AND ended_tx > {after} AND ended_tx <= {upto}"
    )


def _replaced(table: str, columns: str, after: str, upto: str, also: str = "") -> str:
    """What they replaced: on its timeline the last before the new row, or one of no length beside it."""
    previous = (
        f"SELECT q.id FROM {table} q WHERE q.kb_id = n.kb_id AND q.timeline_id = n.timeline_id"
        " AND q.initial_time < n.initial_time AND q.end_time > q.initial_time"
        " ORDER BY q.initial_time DESC LIMIT 1"
    )
    beside = (
        "p.kb_id = n.kb_id AND p.timeline_id = n.timeline_id"
        " AND p.initial_time = n.initial_time AND p.end_time <= p.initial_time"
    )
    named = ", ".join(f"p.{column}" for column in columns.split(", "))
    source = f"SELECT {named} FROM {table} n BY(ix_{table}_recorded) CROSS JOIN {table} p"
    where = (
        f"n.kb_id = :kb AND n.recorded_tx > {after} AND n.recorded_tx <= {upto}"
        f" AND p.end_cause = {int(EndCause.REPLACED)} AND p.ended_tx = n.recorded_tx{also}"
    )
    return (
        f"{source} WHERE {where} AND p.id = ({previous})"
        f" UNION ALL {source} BY(ix_{table}_empty) WHERE {where} AND {beside}"
    )


class AssertionQueries:
    """The statements for one of the five tables of assertions."""

    def __init__(self, table: str, *own: str) -> None:
        self.table = table
        value = ", ".join(("is_negative", *own))
        standing = f"timeline_id, initial_time, {value}"
        stored = f"id, timeline_id, initial_time, end_time, recorded_time, {value}"
        recorded = f"timeline_id, initial_time, end_time, recorded_tx, ended_tx, cancelled_tx, end_cause, {value}"
        kb = "kb_id = :kb"

        self.standing = Statement(*_in_tree(table, standing))
        """What stands at :t."""

        ended_since = (
            f" UNION ALL {_ended(table, standing, ':number', ':latest')}"
            " AND end_time = :t AND initial_time <= :t AND recorded_tx <= :number"
            f" UNION ALL {_replaced(table, standing, ':number', ':latest', ' AND p.recorded_tx <= :number')}"
        )
        still = _in_tree(table, standing, ":number")
        self.standing_as_of = Statement(*(text + ended_since for text in still))
        """What stood at :t after the transaction :number, when :latest is the last transaction of that time."""

        pending = (
            f"SELECT {standing} FROM {table} BY(ix_{table}_pending) WHERE {kb} AND AMONG(pending_node, path)"
            " AND recorded_time <= :t AND initial_time > :t AND (cancelled_time IS NULL OR cancelled_time > :t)"
        )
        self.pending = Statement(pending)
        """What had been recorded by :t, was not cancelled at :t, and takes effect after :t."""

        self.pending_as_of = Statement(
            f"{pending} AND recorded_tx <= :number UNION ALL SELECT {standing} FROM {table} WHERE {kb}"
            " AND cancelled_tx > :number AND cancelled_tx <= :latest AND recorded_tx <= :number"
        )
        """The same after the transaction :number."""

        scheduled = f"FROM {table} WHERE {kb} AND recorded_time IS NOT NULL AND cancelled_tx IS NULL"
        self.ahead = Statement(f"SELECT timeline_id {scheduled} AND initial_time > :t")
        """The timelines on which something lies ahead of :t."""

        self.due = Statement(f"SELECT {recorded} {scheduled} AND initial_time > :after AND initial_time <= :upto")
        """What was scheduled, and took effect after :after and up to :upto."""

        latest = (
            f"SELECT max(g.initial_time) FROM {table} g WHERE g.{kb} AND g.timeline_id = value"
            " AND g.initial_time <= :t AND g.end_time > g.initial_time"
        )
        live = f"SELECT {', '.join('f.' + column for column in stored.split(', '))}"
        on_timeline = (
            f"{table} f WHERE f.{kb} AND f.timeline_id = value AND f.end_time > f.initial_time"
            f" AND f.initial_time >= coalesce(({latest}), 0)"
        )
        self.live = Statement(
            f"{live} FROM EACH(ids AS bigint) CROSS JOIN {on_timeline}",
            # while the table is small, PostgreSQL would plan a join that reads all of it, and go on with that plan
            f"SELECT f.* FROM EACH(ids AS bigint) CROSS JOIN LATERAL ({live} FROM {on_timeline} OFFSET 0) f",
        )
        """For each timeline the latest row that is not after :t, ended or not, and all that lie ahead of :t."""

        self.point = Lookup(
            "SELECT k.last_number, k.last_time, k.history_from, k.domain_version, k.last_run,"
            f" f.end_time, f.initial_time, {', '.join('f.' + column for column in value.split(', '))}"
            f" FROM knowledge_bases k LEFT JOIN {table} f ON f.id = (SELECT g.id FROM {table} g"
            " WHERE g.kb_id = :kb AND g.timeline_id = :timeline AND g.initial_time <= :t"
            " AND g.end_time > g.initial_time ORDER BY g.initial_time DESC LIMIT 1) WHERE k.id = :kb",
            "kb",
            "timeline",
            "t",
        )
        """The head of the knowledge base, and the latest row of one timeline that is not after :t."""

        self.next_start = Statement(
            f"SELECT initial_time FROM {table} WHERE {kb} AND timeline_id = :timeline AND initial_time > :t"
            " AND end_time > initial_time ORDER BY initial_time LIMIT 1"
        )
        """When the next assertion on a timeline begins."""

        self.history = Statement(
            f"SELECT {recorded} FROM {table} WHERE {kb}"
            " AND AMONG(timeline_id, ids) AND end_time > initial_time"
            " AND initial_time < :until AND initial_time >= :first"
            f" UNION ALL SELECT {recorded} FROM {table} WHERE {kb}"
            " AND AMONG(timeline_id, ids) AND end_time <= initial_time"
            " AND initial_time < :until AND initial_time >= :first"
        )
        """All rows of some timelines that begin in [:first, :until), those of no length and cancelled ones included."""

        self.latest_start = Statement(
            f"SELECT coalesce(max(initial_time), 0) FROM {table} WHERE {kb} AND timeline_id = :timeline"
            " AND initial_time <= :t AND end_time > initial_time"
        )
        """When the latest row of a timeline that is not after :t begins; 0 if there is none."""

        self.recorded = Statement(
            f"SELECT {recorded} FROM {table} WHERE {kb} AND recorded_tx > :after AND recorded_tx <= :upto ORDER BY id"
        )
        self.ended = Statement(
            f"{_ended(table, recorded, ':after', ':upto')} UNION ALL {_replaced(table, recorded, ':after', ':upto')}"
        )
        self.cancelled = Statement(
            f"SELECT {recorded} FROM {table} WHERE {kb} AND cancelled_tx > :after AND cancelled_tx <= :upto ORDER BY id"
        )
        """The rows that the transactions after :after and up to :upto recorded, ended and cancelled."""

        columns = ("timeline_id", "initial_time", "end_time", "recorded_time", "level", "pending_node", "is_negative")
        self.add = Insertion(table, "kb_id", "recorded_tx", *columns, *own)
        self.end = Statement(
            f"UPDATE {table} SET end_time = :end_time, level = :level, ended_tx = :number, end_cause = :cause"
            f" WHERE id = :id AND {kb}"
        )
        """End a row at a transaction's own time."""

        self.cancel = Statement(
            f"UPDATE {table} SET end_time = initial_time, level = NULL, pending_node = :pending_node,"
            f" cancelled_tx = :number, cancelled_time = :time WHERE id = :id AND {kb}"
        )
        self.settle = Statement(f"UPDATE {table} SET end_time = :end_time, level = :level WHERE id = :id AND {kb}")
        """Give a row the end that is derived for it."""


for_kind: dict[KnowledgeType, AssertionQueries] = {
    KnowledgeType.INSTANCE: AssertionQueries("instances", "instance_type"),
    KnowledgeType.FACT: AssertionQueries("facts"),
    KnowledgeType.FUNCTION: AssertionQueries("functions", "function_value", "own_rate", "rate"),
    KnowledgeType.EXPRESSION: AssertionQueries("expressions", "optimization", "expr"),
    KnowledgeType.INEQUALITY: AssertionQueries("inequalities", "comparison_type", "lhs", "rhs", "grounded"),
}


def _exists(table: str, index: str, first: str, also: str = "") -> str:
    # the order makes PostgreSQL take the index: it would look through the rows of other knowledge bases for one
    return (
        f"(SELECT {first} FROM {table} BY(ix_{table}_{index}) WHERE kb_id = :kb{also} ORDER BY {first} LIMIT 1)"
        " IS NOT NULL"
    )


present = Statement(
    "SELECT "
    + ", ".join(
        f"{_exists(kind.table, 'recorded', 'recorded_tx')},"
        f" {_exists(kind.table, 'scheduled', 'initial_time', ' AND recorded_time IS NOT NULL')}"
        for kind in for_kind.values()
    )
)
"""For each knowledge type whether there are any assertions, and any that were scheduled."""

settle_rate = Statement("UPDATE functions SET rate = :rate WHERE id = :id AND kb_id = :kb")
"""Give a scheduled value the rate that is derived for it: its own, and what runs adds."""

# -- runs -----------------------------------------------------------------------------------------------------

_RUN = "SELECT number, operator, arguments, initial_time, duration, remembered FROM runs WHERE kb_id = :kb"
_RUN_IN_TREE = _RUN.replace(" WHERE", " BY(ix_runs_node) WHERE")

running = Statement(
    f"{_RUN_IN_TREE} AND AMONG(node, path) AND initial_time <= :t AND end_time > :t"
    f" UNION ALL {_RUN} AND end_time = {OPEN} AND initial_time <= :t"
)

running_as_of = Statement(
    f"{_RUN_IN_TREE} AND AMONG(node, path) AND initial_time <= :t AND end_time > :t AND recorded_tx <= :number"
    f" UNION ALL {_RUN} AND end_time = {OPEN} AND initial_time <= :t AND recorded_tx <= :number"
    f" UNION ALL {_RUN} AND ended_tx > :number AND end_time = :t AND initial_time <= :t AND recorded_tx <= :number"
)

run_rates = Statement(
    "SELECT run_number, timeline_id, rate FROM run_rates WHERE kb_id = :kb"
    " AND AMONG(run_number, numbers) ORDER BY run_number"
)

add_run = Statement(
    "INSERT INTO runs (kb_id, number, operator, arguments, initial_time, duration, remembered, end_time, recorded_tx)"
    f" VALUES (:kb, :run, :operator, :arguments, :time, :duration, :remembered, {OPEN}, :number)"
)

add_run_rate = Statement(
    "INSERT INTO run_rates (kb_id, run_number, timeline_id, rate) VALUES (:kb, :run, :timeline, :rate)"
)

end_run = Statement(
    "UPDATE runs SET end_time = :time, node = :node, outcome = :outcome, ended_tx = :number"
    " WHERE kb_id = :kb AND number = :run"
)
