"""The SQL statements that read the rows of an import timeline by timeline, on the scratch file."""

from typing import Any

from sqlalchemy import Table, and_, select

from kbstore.messages import KnowledgeType
from kbstore.model.timelines import Role
from kbstore.storage import tables
from kbstore.storage.statements import KB, Statement, constant, parameter

_domains, _symbols, _timelines, _runs = tables.domains.c, tables.symbols.c, tables.timelines.c, tables.runs.c

domains = Statement(
    select(_domains.version, _domains.initial_time, _domains.name, _domains.source, _domains.sensed)
    .where(_domains.kb_id == KB)
    .order_by(_domains.version)
)

symbols = Statement(
    select(_symbols.knowledge_type, _symbols.key, _symbols.name, _symbols.arity, _symbols.labels)
    .where(_symbols.kb_id == KB)
    .order_by(_symbols.knowledge_type, _symbols.key)
)

timelines = Statement(
    select(_timelines.id, _timelines.role, _timelines.knowledge_type, _timelines.key, _timelines.spelling)
    .where(_timelines.kb_id == KB)
    .order_by(_timelines.id)
)


def _mentioned() -> Any:
    mentions, about = tables.mentions, tables.timelines
    joined = mentions.join(about, and_(about.c.kb_id == KB, about.c.id == mentions.c.object_id))
    rows = (mentions.c.kb_id == KB, mentions.c.timeline_id == parameter("timeline"))
    return select(about.c.key).select_from(joined).where(*rows)


mentioned = Statement(_mentioned())
"""The keys of the objects that :timeline mentions, by the lines of mentions."""


def _assertions(table: Table) -> Statement:
    columns = table.c
    key = (columns.recorded_tx, columns.seq, columns.initial_time, columns.end_time, columns.ended_tx)
    value = (columns.is_negative, *(columns[name] for name in table.info[tables.OWN]))
    return Statement(
        select(*key, columns.retired_tx, *value)
        .where(columns.kb_id == KB, columns.timeline_id == parameter("timeline"))
        .order_by(columns.initial_time)
    )


def _emptied(table: Table) -> Statement:
    columns = table.c
    rows = (columns.kb_id == KB, columns.timeline_id == parameter("timeline"))
    no_length = (columns.initial_time == columns.end_time, columns.ended_tx.is_not(None))
    return Statement(select(columns.initial_time).where(*rows, *no_length).order_by(columns.initial_time))


assertions = {kind: _assertions(table) for kind, table in tables.assertion_tables.items()}
"""The rows of :timeline, in the order of time."""

emptied = {kind: _emptied(table) for kind, table in tables.assertion_tables.items()}
"""The times at which something on :timeline ended as it began."""


def _began_and_retired(table: Table) -> Statement:
    columns = table.c
    rows = (columns.kb_id == KB, columns.timeline_id == parameter("timeline"), columns.initial_time == parameter("t"))
    return Statement(select(columns.seq).where(*rows, columns.retired_tx.is_not(None)).limit(constant(1)))


began_and_retired = {kind: _began_and_retired(table) for kind, table in tables.assertion_tables.items()}
"""The rows that began at :t on :timeline, and are not known any more."""


def _of_object() -> Any:
    instances, about = tables.instances.c, tables.timelines.c
    which = select(about.id).where(
        about.kb_id == KB,
        about.role == constant(Role.STATE),
        about.knowledge_type == constant(KnowledgeType.INSTANCE),
        about.key == parameter("key"),
    )
    return and_(instances.kb_id == KB, instances.timeline_id == which.scalar_subquery())


_instances = tables.instances.c

existences = Statement(
    select(_instances.initial_time, _instances.end_time, _instances.instance_type)
    .where(_of_object(), _instances.retired_tx.is_(None), _instances.is_negative.is_(False))
    .order_by(_instances.initial_time)
)
"""The lifespans of the object :key, with its types."""

ended_and_retired = Statement(
    select(_instances.seq)
    .where(_of_object(), _instances.retired_tx.is_not(None), _instances.end_time == parameter("t"))
    .limit(constant(1))
)
"""An existence of the object :key that ended at :t, and is not known any more."""

running = Statement(
    select(_runs.number)
    .where(_runs.kb_id == KB, _runs.initial_time <= parameter("t"), _runs.end_time >= parameter("t"))
    .limit(constant(1))
)
"""A run at :t."""

runs = Statement(
    select(_runs.number, _runs.recorded_tx, _runs.initial_time, _runs.end_time, _runs.operator, _runs.arguments)
    .where(_runs.kb_id == KB)
    .order_by(_runs.number)
)
