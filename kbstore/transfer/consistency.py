"""Checks that the rows of an import fit each other, as in every store, by SQL on the scratch file.

Each rule is a condition that no row of a store fulfils, with the end of the sentence that refuses one that does. All
rules about one table are one statement. Rows that were archived, before `history_from`, are not missed.
"""

from collections.abc import Iterator, Sequence
from itertools import groupby
from typing import Any, NamedTuple

import sqlalchemy as sa
from sqlalchemy import Table, and_, case, exists, func, not_, or_, select

from kbstore.clock import OPEN
from kbstore.messages import KnowledgeType
from kbstore.model.timelines import Role
from kbstore.storage import tables
from kbstore.storage.statements import KB, Statement, constant, parameter
from kbstore.storage.tables import RevisionKind
from kbstore.transfer.scratch import Scratch

Rule = tuple[Any, str]
"""A contradiction to look for, and the end of the sentence that begins with its line."""

_T, _GONE = parameter("since"), parameter("gone")

_RETIRING = (RevisionKind.CANCELLED, RevisionKind.SUPERSEDED, RevisionKind.EMPTIED)
"""The revisions after which a row is not known any more; they have the lowest numbers of all."""


class Contradiction(NamedTuple):
    """A row that no store has: its table, its key, and its problem."""

    table: str
    key: Sequence[Any]
    problem: str


def contradictions(scratch: Scratch, since: int, gone: int) -> Iterator[Contradiction]:
    """Yield the contradictions, the first of each table and kind.

    `since` is the time from which on the file has history, `gone` the last transaction before that time.
    """
    archived = {"since": since, "gone": gone}
    for table, (statement, rules) in _checks.items():
        for *key, rule in scratch.rows(statement, **archived):
            yield Contradiction(table, key, rules[rule][1])
    for number, token in scratch.rows(_doubled_tokens):
        yield Contradiction("transactions", [number], f"has the token {token} of another transaction")
    for number, found in scratch.rows(_places, **archived):
        yield Contradiction(
            "transactions", [number], f"has rows whose places (seq) are not 0 to {found - 1}, once each"
        )
    yield from _revised(scratch)


# -- assertions ---------------------------------------------------------------------------------------------------


def _same(left: Any, right: Any, *names: str) -> Any:
    """Return the condition that two tables are equal in some columns, or in columns of other names: ``left=right``."""
    pairs = [name.split("=") * 2 for name in ("kb_id", *names)]
    return and_(*(left.c[pair[0]] == right.c[pair[1]] for pair in pairs))


def _check(core: Any, key: Sequence[Any], rules: Sequence[Rule]) -> tuple[Statement, Sequence[Rule]]:
    """Return the statement for the first row that breaks a rule, with the rule's number, and the rules."""
    broken = case(*((condition, constant(number)) for number, (condition, _) in enumerate(rules)))
    found = core.with_only_columns(*key, broken.label("rule")).where(broken.is_not(None))
    return Statement(found.order_by(*key).limit(constant(1))), rules


def _of_assertions(kind: KnowledgeType, table: Table) -> tuple[Statement, Sequence[Rule]]:
    row = table.c
    recorded, ended, retired = (tables.transactions.alias(name) for name in ("recorded", "ended", "retired"))
    schedule = tables.schedules
    joined = (
        table.join(recorded, _same(table, recorded, "recorded_tx=number"))
        .outerjoin(ended, _same(table, ended, "ended_tx=number"))
        .outerjoin(retired, _same(table, retired, "retired_tx=number"))
        .outerjoin(schedule, _same(table, schedule, "recorded_tx", "seq"))
    )
    now = recorded.c.recorded_time
    is_late, is_ahead, is_retired = row.initial_time < now, row.initial_time > now, row.retired_tx.is_not(None)
    has_no_length = row.end_time == row.initial_time
    is_cancelled = and_(is_retired, has_no_length, row.ended_tx.is_(None))
    is_emptied = and_(is_retired, has_no_length, row.ended_tx.is_not(None))
    is_superseded = and_(is_retired, not_(has_no_length))
    until = case((is_cancelled, retired.c.recorded_time), else_=row.initial_time)
    has_schedule = schedule.c.recorded_tx.is_not(None)
    revised = exists().where(
        _same(tables.revisions, table, "tx=retired_tx", "recorded_tx", "seq"),
        tables.revisions.c.what <= constant(max(_RETIRING)),
    )
    other = table.alias("other")
    first_recorded = exists().where(_same(other, table, "recorded_tx=told_tx", "timeline_id"))
    until_late = func.min(row.end_time, retired.c.late_from)
    kept = exists().where(
        _same(other, table, "recorded_tx=retired_tx", "timeline_id", "initial_time"),
        other.c.told_tx == func.coalesce(row.told_tx, row.recorded_tx),
        other.c.end_time >= until_late,
        *(other.c[name] == row[name] for name in ("is_negative", *table.info[tables.OWN])),
    )
    rules: list[Rule] = [
        (row.end_time < row.initial_time, "ends before it begins"),
        (row.timeline_id > recorded.c.last_timeline, "is on a timeline that is newer than its transaction"),
        (and_(has_no_length, not_(is_retired)), "has no length and is not retired; retired_tx is expected"),
        (row.ended_tx.is_(None) != row.end_cause.is_(None), "has ended_tx without end_cause, or the reverse"),
        (and_(is_retired, row.retired_tx <= row.recorded_tx), "was retired by a transaction before its own"),
        (
            and_(row.ended_tx <= row.recorded_tx, not_(is_late)),
            "was ended by a transaction before its own",
        ),
        (
            and_(row.end_time != ended.c.recorded_time, or_(not_(is_late), row.end_time > ended.c.recorded_time)),
            "ends at another time than that of the transaction which ended it",
        ),
        (
            and_(is_late, recorded.c.late_from.is_(None)),
            "begins before its transaction, which recorded no late knowledge (late_from)",
        ),
        (
            and_(is_late, row.told_tx.is_(None), row.initial_time < recorded.c.late_from),
            "begins before the late_from of its transaction",
        ),
        (
            and_(row.told_tx.is_not(None), or_(not_(is_late), row.told_tx >= row.recorded_tx)),
            "has a told_tx, and is not what late knowledge left of an earlier row",
        ),
        (and_(row.told_tx > _GONE, not_(first_recorded)), "has a told_tx that recorded nothing on its timeline"),
        (
            and_(is_cancelled, or_(not_(is_ahead), retired.c.recorded_time >= row.initial_time)),
            "was cancelled when it had taken effect",
        ),
        (and_(is_emptied, row.retired_tx != row.ended_tx), "has no length, and was not retired by what ended it"),
        (
            and_(is_superseded, retired.c.late_from.is_(None)),
            "was superseded by a transaction that recorded no late knowledge (late_from)",
        ),
        (
            and_(is_superseded, row.initial_time < retired.c.late_from, until_late >= _T, not_(kept)),
            "was superseded, and what is left of it before that is not there",
        ),
        (and_(is_retired, row.retired_tx > _GONE, not_(revised)), "was retired, and has no line in revisions"),
        (
            and_(is_ahead, not_(has_schedule), not_(and_(until < _T, row.recorded_tx <= _GONE))),
            "was recorded ahead of its time, and has no line in schedules",
        ),
        (and_(has_schedule, not_(is_ahead)), "was not recorded ahead of its time, and has a line in schedules"),
        (
            and_(
                has_schedule,
                or_(
                    schedule.c.knowledge_type != constant(kind),
                    schedule.c.timeline_id != row.timeline_id,
                    schedule.c.recorded_time != now,
                    schedule.c.initial_time != row.initial_time,
                    schedule.c.until_time != until,
                ),
            ),
            "contradicts its line in schedules",
        ),
    ]
    if kind is not KnowledgeType.FUNCTION:
        rules.append((schedule.c.is_derived, "is derived in schedules, which only a function can be"))
    else:
        runs = tables.runs
        moving = exists().where(
            runs.c.kb_id == KB, runs.c.initial_time <= row.initial_time, runs.c.end_time >= row.initial_time
        )
        moved = and_(row.own_rate != row.rate, not_(is_retired), row.initial_time >= _T)
        rules.append((and_(moved, not_(moving)), "moves at a rate that no run adds to its own"))
    if kind in (KnowledgeType.FUNCTION, KnowledgeType.EXPRESSION):
        rules.append((row.is_negative, "is negative, which it cannot be"))
    return _check(select(row.seq).select_from(joined).where(row.kb_id == KB), (row.recorded_tx, row.seq), rules)


# -- what else there is -------------------------------------------------------------------------------------------

_row_keys = [
    select(
        table.c.recorded_tx,
        table.c.seq,
        constant(kind).label("kind"),
        table.c.end_time,
        table.c.initial_time,
        table.c.ended_tx,
        table.c.retired_tx,
    ).where(table.c.kb_id == KB)
    for kind, table in tables.assertion_tables.items()
]
_rows = sa.union_all(*_row_keys).subquery("row")


def _of_runs() -> tuple[Statement, Sequence[Rule]]:
    runs, recorded, ended = tables.runs, tables.transactions.alias("recorded"), tables.transactions.alias("ended")
    row = runs.c
    joined = runs.join(recorded, _same(runs, recorded, "recorded_tx=number")).outerjoin(
        ended, _same(runs, ended, "ended_tx=number")
    )
    rules = [
        (row.initial_time != recorded.c.recorded_time, "starts at another time than its transaction's"),
        (
            or_(
                row.ended_tx.is_(None) != (row.end_time == constant(OPEN)),
                row.ended_tx.is_(None) != row.outcome.is_(None),
            ),
            "has not all of ended_tx, end_time and outcome, or none of them",
        ),
        (or_(row.ended_tx < row.recorded_tx, row.end_time < row.initial_time), "ends before it starts"),
        (row.end_time != ended.c.recorded_time, "ends at another time than that of the transaction which ended it"),
    ]
    return _check(select(row.number).select_from(joined).where(row.kb_id == KB), (row.number,), rules)


def _of_domains() -> tuple[Statement, Sequence[Rule]]:
    domains, recorded = tables.domains, tables.transactions
    joined = domains.join(recorded, _same(domains, recorded, "recorded_tx=number"))
    rules = [(domains.c.initial_time != recorded.c.recorded_time, "has another time than its transaction")]
    return _check(
        select(domains.c.version).select_from(joined).where(domains.c.kb_id == KB), (domains.c.version,), rules
    )


def _without_row(table: Table) -> Any:
    """Return the condition that a row of a side table is about an assertion that is not in the file."""
    columns = table.c
    return not_(
        exists().where(
            _rows.c.recorded_tx == columns.recorded_tx,
            _rows.c.seq == columns.seq,
            _rows.c.kind == columns.knowledge_type,
        )
    )


def _of_side_rows(table: Table) -> tuple[Statement, Sequence[Rule]]:
    keys = [column for column in table.primary_key.columns if column.name != "kb_id"]
    rules = [(_without_row(table), "is about a row that is not in the file")]
    return _check(select(*keys).where(table.c.kb_id == KB), keys, rules)


def _of_mentions() -> tuple[Statement, Sequence[Rule]]:
    mentions, about = tables.mentions, tables.timelines
    joined = mentions.join(about, _same(mentions, about, "object_id=id"))
    is_object = and_(about.c.role == constant(Role.STATE), about.c.knowledge_type == constant(KnowledgeType.INSTANCE))
    key = (mentions.c.object_id, mentions.c.timeline_id)
    rules = [(not_(is_object), "mentions a timeline that is not that of an object")]
    return _check(select(*key).select_from(joined).where(mentions.c.kb_id == KB), key, rules)


def _of_timelines() -> tuple[Statement, Sequence[Rule]]:
    timelines, other = tables.timelines, tables.timelines.alias("other")
    rules = [
        (
            exists().where(_same(other, timelines, "role", "knowledge_type", "key"), other.c.id < timelines.c.id),
            "is a timeline that an earlier line has",
        )
    ]
    return _check(select(timelines.c.id).where(timelines.c.kb_id == KB), (timelines.c.id,), rules)


_checks: dict[str, tuple[Statement, Sequence[Rule]]] = {
    "timelines": _of_timelines(),
    "mentions": _of_mentions(),
    "domains": _of_domains(),
    **{table.name: _of_assertions(kind, table) for kind, table in tables.assertion_tables.items()},
    "schedules": _of_side_rows(tables.schedules),
    "revisions": _of_side_rows(tables.revisions),
    "runs": _of_runs(),
}

_transactions = tables.transactions.c

_doubled_tokens = Statement(
    select(func.max(_transactions.number), _transactions.token)
    .where(_transactions.kb_id == KB)
    .group_by(_transactions.token)
    .having(func.count() > constant(1))
    .limit(constant(1))
)


def _derived() -> Any:
    schedules = tables.schedules.c
    return exists().where(
        schedules.kb_id == KB,
        schedules.recorded_tx == _rows.c.recorded_tx,
        schedules.seq == _rows.c.seq,
        schedules.is_derived,
    )


def _wrong_places() -> Any:
    """Select transactions whose rows have a position twice, or leave one out although none of them was archived.

    Derived rows are the last ones of their transaction, and may have been deleted.
    """
    counted = func.sum(case((_derived(), constant(0)), else_=constant(1)))
    last = func.max(case((_derived(), constant(-1)), else_=_rows.c.seq))
    number = _rows.c.recorded_tx
    return (
        select(number, func.count())
        .group_by(number)
        .having(
            or_(
                func.count(_rows.c.seq.distinct()) < func.count(),
                and_(number > _GONE, counted != last + constant(1)),
            )
        )
        .order_by(number)
        .limit(constant(1))
    )


_places = Statement(_wrong_places())


# -- revisions ----------------------------------------------------------------------------------------------------


def _revisions() -> Any:
    revisions = tables.revisions
    columns = revisions.c
    joined = revisions.join(_rows, and_(_rows.c.recorded_tx == columns.recorded_tx, _rows.c.seq == columns.seq))
    return (
        select(
            columns.recorded_tx,
            columns.seq,
            columns.tx,
            columns.what,
            columns.end_before,
            _rows.c.initial_time,
            _rows.c.end_time,
            _rows.c.ended_tx,
            _rows.c.retired_tx,
        )
        .select_from(joined)
        .where(columns.kb_id == KB)
        .order_by(columns.recorded_tx, columns.seq, columns.tx)
    )


_all_revisions = Statement(_revisions())


def _revised(scratch: Scratch) -> Iterator[Contradiction]:
    """Yield revisions that contradict the row that they revise."""
    for key, found in groupby(scratch.rows(_all_revisions), key=lambda row: row[:2]):
        revisions = list(found)
        start, end, ended, retired = revisions[-1][5:]
        expected = None
        if retired is not None:
            expected = RevisionKind.SUPERSEDED
            if end == start:
                expected = RevisionKind.CANCELLED if ended is None else RevisionKind.EMPTIED
        for place, (*_, tx, what, before) in enumerate(row[:5] for row in revisions):
            is_last = place + 1 == len(revisions)
            after = end if is_last else revisions[place + 1][4]
            if tx <= key[0]:
                problem = "is not after the row that it revises"
            elif before <= start:
                problem = "has an end_before that is not after the begin of its row"
            elif what in _RETIRING and (not is_last or what != expected or tx != retired):
                problem = "retires a row otherwise than the row says"
            elif what == RevisionKind.SUPERSEDED and before != end:
                problem = f"has the end_before {before}, where its row has the end {end}"
            elif what == RevisionKind.CUT_SHORT and (tx != ended or before <= end):
                problem = "cuts a row short that did not end with its transaction before end_before"
            elif what == RevisionKind.SETTLED and after == before and ended is None:
                problem = "settles an end that is the same as before"
            else:
                continue
            yield Contradiction("revisions", [tx, *key], problem)
            return
