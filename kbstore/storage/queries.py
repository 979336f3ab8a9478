"""The SQL statements for everything but assertions, by name: Core constructs over `kbstore.storage.tables`.

Each has a condition on the knowledge base for every table that it touches. The statements for assertions are in
`kbstore.storage.assertion_queries`.
"""

from typing import Any

import sqlalchemy as sa
from sqlalchemy import and_, select

from kbstore.clock import OPEN
from kbstore.storage import tables
from kbstore.storage.assertion_queries import HEAD_COLUMNS, ROW
from kbstore.storage.notifications import hears_nobody
from kbstore.storage.statements import KB, BulkStatement, Statement, among, between, constant, insert, parameter

_directory, _heads, _transactions = tables.knowledge_bases.c, tables.heads.c, tables.transactions.c
_domains, _symbols, _timelines, _mentions = tables.domains.c, tables.symbols.c, tables.timelines.c, tables.mentions.c
_schedules, _revisions, _runs = tables.schedules.c, tables.revisions.c, tables.runs.c

# -- the directory --------------------------------------------------------------------------------------------

knowledge_base_names = Statement(select(_directory.name).order_by(_directory.name))

find_knowledge_base = Statement(
    select(_directory.id, _directory.use_unknowns).where(_directory.name == parameter("name"))
)


def _add_knowledge_base(dialect: str) -> Any:
    following = select(sa.func.coalesce(sa.func.max(_directory.id), constant(0)) + constant(1)).scalar_subquery()
    number = following if dialect == "sqlite" else parameter("id")
    added = insert(dialect, tables.knowledge_bases).values(
        id=number, name=parameter("name"), use_unknowns=parameter("use_unknowns")
    )
    return added.on_conflict_do_nothing()


add_knowledge_base = Statement(_add_knowledge_base)
"""On SQLite, with the next number; elsewhere with the number :id, unless that or the name is taken."""

add_head = Statement(
    tables.heads.insert()
    .inline()
    .values({name: KB if name == "kb_id" else constant(0) for name in _heads.keys() if name != "source"})  # noqa: SIM118
)

# -- the record -----------------------------------------------------------------------------------------------

_head = select(*(_heads[name] for name in HEAD_COLUMNS)).where(_heads.kb_id == KB)

head = Statement(_head)


def _head_for_update(dialect: str) -> Any:
    locked = _head.with_for_update()
    return locked if dialect == "sqlite" else locked.add_columns(hears_nobody(_heads.kb_id))


head_for_update = Statement(_head_for_update)
"""The head; on PostgreSQL, also whether nobody listens to the knowledge base (`kbstore.storage.notifications`)."""

put_head = BulkStatement.changing(tables.heads, *HEAD_COLUMNS, key={"kb_id": "kb"})

last_token = Statement(select(_heads.last_token).where(_heads.kb_id == KB))

token = Statement(
    select(_transactions.token).where(_transactions.kb_id == KB, _transactions.number == parameter("number"))
)
"""The token of a transaction."""

add_transaction = BulkStatement.adding(tables.transactions)

_transaction = select(
    _transactions.number, _transactions.recorded_time, _transactions.changes, _transactions.client, _transactions.note
).where(_transactions.kb_id == KB)

transactions_between = Statement(_transaction.where(between(_transactions.number)).order_by(_transactions.number))

transactions_numbered = Statement(_transaction.where(among(_transactions.number, "numbers")))


def _first_transaction_from() -> Any:
    """Select the first transaction at :time or later, by bisection over the key: times never run backwards.

    So no index by time is needed.
    """
    ends = select(sa.cast(constant(1), sa.BIGINT).label("low"), (_heads.last_number + constant(1)).label("high"))
    span = ends.where(_heads.kb_id == KB).cte("span", recursive=True)
    middle = (span.c.low + span.c.high).op(">>")(constant(1))
    from_middle = _transaction.where(_transactions.number >= middle).order_by(_transactions.number).limit(constant(1))
    # missing numbers have been archived: the next number takes their place
    is_before = from_middle.with_only_columns(_transactions.recorded_time).scalar_subquery() < parameter("time")
    halves = select(
        sa.case((is_before, middle + constant(1)), else_=span.c.low),
        sa.case((is_before, span.c.high), else_=middle),
    ).where(span.c.low < span.c.high)
    span = span.union_all(halves)
    return (
        select(_transactions.number)
        .where(_transactions.kb_id == KB, _transactions.number >= select(sa.func.max(span.c.low)).scalar_subquery())
        .order_by(_transactions.number)
        .limit(constant(1))
    )


first_transaction_from = Statement(_first_transaction_from())

late_from = Statement(
    select(sa.func.min(_transactions.late_from))
    .with_hint(tables.transactions, "INDEXED BY ix_transactions_late", "sqlite")
    .where(_transactions.kb_id == KB, _transactions.number > parameter("number"), _transactions.late_from.is_not(None))
)
"""The earliest time about which late knowledge was recorded after the transaction :number."""

# -- domains and symbols --------------------------------------------------------------------------------------

domain_versions = Statement(
    select(_domains.version, _domains.initial_time, _domains.recorded_tx, _domains.source, _domains.sensed)
    .where(_domains.kb_id == KB, _domains.version > parameter("after"))
    .order_by(_domains.version)
)

add_domain = BulkStatement.adding(tables.domains)

symbols = Statement(
    select(_symbols.knowledge_type, _symbols.key, _symbols.name, _symbols.arity, _symbols.labels).where(
        _symbols.kb_id == KB
    )
)


def _put_symbol(dialect: str) -> Any:
    added = insert(dialect, tables.symbols).values({column.name: parameter(column.name) for column in _symbols})
    return added.on_conflict_do_update(
        index_elements=[_symbols.kb_id, _symbols.knowledge_type, _symbols.key],
        set_={"labels": added.excluded.labels},
    )


put_symbol = Statement(_put_symbol)

# -- timelines ------------------------------------------------------------------------------------------------

_timeline = select(_timelines.id, _timelines.role, _timelines.knowledge_type, _timelines.key, _timelines.spelling)
_of_kb = _timeline.where(_timelines.kb_id == KB)
_of_role = _of_kb.where(_timelines.role == parameter("role"), _timelines.knowledge_type == parameter("kind")).with_hint(
    tables.timelines, "INDEXED BY ux_timelines_key", "sqlite"
)

timelines_by_id = Statement(_of_kb.where(among(_timelines.id, "ids")))

timelines_by_key = Statement(_of_role.where(among(_timelines.key, "keys", "text")))

timeline_by_key = Statement(_of_role.where(_timelines.key == parameter("key")))

timelines_of_symbol = Statement(
    _of_role.where(_timelines.key >= parameter("first"), _timelines.key < parameter("last"))
)

timelines_of_kind = Statement(_of_role)

timelines_mentioning = Statement(
    _timeline.select_from(
        tables.mentions.join(tables.timelines, and_(_timelines.kb_id == KB, _timelines.id == _mentions.timeline_id))
    ).where(_mentions.kb_id == KB, among(_mentions.object_id, "ids"))
)

add_timeline = BulkStatement.adding(tables.timelines)

add_mention = BulkStatement.adding(tables.mentions, ignoring=True)

settle_rate = BulkStatement.changing(tables.functions, "rate", key=ROW)
"""Set the derived rate of a scheduled value: its own rate, and what runs add to it."""

# -- schedules and revisions ----------------------------------------------------------------------------------

_scheduled = select(_schedules.knowledge_type, _schedules.recorded_tx, _schedules.seq).where(_schedules.kb_id == KB)
_pending = _scheduled.with_hint(tables.schedules, "INDEXED BY ix_schedules_node", "sqlite").where(
    among(_schedules.node, "path"),
    _schedules.recorded_time <= parameter("t"),
    _schedules.until_time > parameter("t"),
    _schedules.is_derived.is_(False),
)
_uncancelled = _schedules.until_time == _schedules.initial_time

pending = Statement(_pending)
"""The rows that had been recorded by :t, were not cancelled at :t, and take effect after it."""

pending_as_of = Statement(
    sa.union_all(
        _pending.where(_schedules.recorded_tx <= parameter("number")),
        # derived rows are not among them: they are never cancelled, but deleted and derived again
        select(_revisions.knowledge_type, _revisions.recorded_tx, _revisions.seq).where(
            _revisions.kb_id == KB,
            between(_revisions.tx, "number", "latest"),
            _revisions.what == constant(tables.RevisionKind.CANCELLED),
            _revisions.recorded_tx <= parameter("number"),
        ),
    )
)
"""The rows of `pending` as they were after the transaction :number of :t, whose last transaction is :latest."""

due = Statement(_scheduled.where(between(_schedules.initial_time), _uncancelled))
"""The rows that were scheduled, and took effect after :after and up to :upto."""

ahead = Statement(
    select(_schedules.timeline_id).where(
        _schedules.kb_id == KB,
        _schedules.initial_time > parameter("t"),
        _schedules.knowledge_type == parameter("kind"),
        _uncancelled,
    )
)
"""The timelines of a knowledge type on which something lies ahead of :t."""

next_due = Statement(
    select(_schedules.initial_time)
    .where(_schedules.kb_id == KB, _schedules.initial_time > parameter("t"))
    .order_by(_schedules.initial_time)
    .limit(constant(1))
)
"""The initial time of the next scheduled row after :t, cancelled ones included."""

derived_ahead = Statement(
    select(_schedules.timeline_id).where(
        _schedules.kb_id == KB, _schedules.initial_time > parameter("t"), _schedules.is_derived.is_(True)
    )
)
"""The timelines of functions for which a rate has been derived from a time after :t on."""

revised = Statement(
    select(_revisions.knowledge_type, _revisions.recorded_tx, _revisions.seq)
    .where(_revisions.kb_id == KB, between(_revisions.tx), _revisions.what.in_([constant(what) for what in (1, 2, 3)]))
    .order_by(_revisions.tx, _revisions.recorded_tx, _revisions.seq)
)
"""The rows that the transactions after :after and up to :upto retired."""

revisions = Statement(
    select(_revisions.tx, _revisions.recorded_tx, _revisions.seq, _revisions.end_before)
    .where(_revisions.kb_id == KB, between(_revisions.tx), _revisions.knowledge_type == parameter("kind"))
    .order_by(_revisions.tx)
)
"""The changes of the transactions after :after and up to :upto to rows of a knowledge type."""

add_schedule = BulkStatement.adding(tables.schedules)

cancel_schedule = BulkStatement.changing(tables.schedules, "until_time", "node", key=ROW)

delete_schedule = BulkStatement.deleting(tables.schedules, key=ROW)
"""Delete the row in `schedules` of a derived assertion that lies ahead."""

add_revision = BulkStatement.adding(tables.revisions)

# -- runs -----------------------------------------------------------------------------------------------------

_run_columns = select(
    _runs.number,
    _runs.operator,
    _runs.arguments,
    _runs.initial_time,
    _runs.duration,
    _runs.duration_s,
    _runs.remembered,
    _runs.forced,
    _runs.end_time,
    _runs.outcome,
    _runs.recorded_tx,
    _runs.ended_tx,
).where(_runs.kb_id == KB)
_run = _run_columns.where(_runs.initial_time <= parameter("t"))
_closed_run = _run.with_hint(tables.runs, "INDEXED BY ix_runs_node", "sqlite").where(
    among(_runs.node, "path"), _runs.end_time > parameter("t")
)
_open_run = _run.where(_runs.end_time == constant(OPEN))

running = Statement(sa.union_all(_closed_run, _open_run))

_known_run = _runs.recorded_tx <= parameter("number")

running_as_of = Statement(
    sa.union_all(
        _closed_run.where(_known_run),
        _open_run.where(_known_run),
        _run.where(_runs.ended_tx > parameter("number"), _runs.end_time == parameter("t"), _known_run),
    )
)

run_from = Statement(
    select(_runs.number, _runs.initial_time)
    .where(_runs.kb_id == KB, _runs.number >= parameter("number"))
    .order_by(_runs.number)
    .limit(constant(1))
)
"""The first run with :number or a later one, and its start: numbers rise with the starts, and may have gaps."""

runs_numbered = Statement(
    _run_columns.where(_runs.number >= parameter("first"), _runs.number < parameter("end")).order_by(_runs.number)
)
"""The runs from :first on and before :end."""

run_numbered = Statement(_run_columns.where(_runs.number == parameter("number")))

add_run = BulkStatement.adding(tables.runs)

end_run = BulkStatement.changing(
    tables.runs, "end_time", "ended_tx", "node", "outcome", key={"kb_id": "kb", "number": "run"}
)
