"""Stores with a long history, filled row by row, on which the planners of both engines are tested."""

import itertools
import random

from kbstore.clock import OPEN
from kbstore.storage import tables
from kbstore.storage.assertion_queries import for_kind
from kbstore.storage.interval_tree import level, node

KB = 2
"""The number of the knowledge base under test; another one beside it is as large."""

SPAN = 10**12
"""The end of the history of each, which begins at 0."""

TIMELINES = 400

KINDS = {table.name: int(kind) for kind, table in tables.assertion_tables.items()}


def rows_of(table, kb, count, seed=0):
    """Rows of one knowledge base: closed intervals, some open, scheduled, cancelled and superseded.

    Each with its row in `schedules`, and its row in `revisions`, where it has one.
    """
    chance = random.Random(f"{table}{kb}{seed}")
    own = {
        "instances": {"instance_type": "place"},
        "facts": {},
        "functions": {"function_value": 1.5, "own_rate": 0.0, "rate": 0.0},
        "expressions": {"optimization": "", "expr": "(total-time)"},
        "inequalities": {"comparison_type": 0, "lhs": "", "rhs": "", "grounded": True},
    }[table]
    step = SPAN // (count // TIMELINES + 1)
    seqs = itertools.count(KINDS[table] * 1_000_000)
    for index in range(count):
        timeline = index % TIMELINES + 1
        start = (index // TIMELINES) * step + chance.randrange(step // 4)
        number = start // (SPAN // 1000) + 1
        last = index >= count - TIMELINES
        key = {"kb_id": kb, "recorded_tx": number, "seq": next(seqs)}
        row = {
            **key,
            "timeline_id": timeline,
            "initial_time": start,
            "end_time": OPEN if last else start + 1 + chance.randrange(step // 2),
            "is_negative": False,
            "ended_tx": None,
            "end_cause": None,
            "retired_tx": None,
            **own,
        }
        if not last:
            row["ended_tx"] = row["end_time"] // (SPAN // 1000) + 1
            row["end_cause"] = chance.choice((1, 2, 2, 2, 3))
        schedule = revision = None
        kind = KINDS[table]
        if index % 20 == 7:
            recorded = max(0, start - chance.randrange(1, step))
            schedule = {"recorded_time": recorded, "until_time": start, "node": node(recorded, start)}
        if index % 100 == 11:
            row |= {"end_time": start, "ended_tx": None, "end_cause": None, "retired_tx": number}
            recorded, until = max(0, start - 100), max(0, start - 50)
            schedule = {"recorded_time": recorded, "until_time": until, "node": node(recorded, until)}
            revision = {"tx": number, "end_before": OPEN, "what": tables.RevisionKind.CANCELLED}
        row["level"] = level(row["initial_time"], row["end_time"])
        if index % 50 == 23 and not last:
            row |= {"level": -1 - row["level"], "retired_tx": row["ended_tx"] + 1}
            revision = {"tx": row["retired_tx"], "end_before": row["end_time"], "what": tables.RevisionKind.SUPERSEDED}
        if schedule is not None:
            schedule |= {"timeline_id": timeline, "initial_time": start, "is_derived": False}
        yield row, *(None if side is None else {**key, "knowledge_type": kind, **side} for side in (schedule, revision))


def fill(connection, counts):
    """Fill an empty store with two knowledge bases; `counts` is how many rows of each table of assertions."""
    for kb in (1, KB):
        connection.execute(tables.knowledge_bases.insert(), {"id": kb, "name": f"kb{kb}", "use_unknowns": False})
        head = {"last_number": 1000, "last_time": SPAN, "last_token": 1000, "last_late": 1000, "last_run": 500}
        head |= {"last_timeline": TIMELINES, "history_from": 0, "domain_version": 0, "present": 63}
        connection.execute(tables.heads.insert(), {"kb_id": kb, **head})
        connection.execute(
            tables.transactions.insert(),
            [
                {
                    "kb_id": kb,
                    "number": n,
                    "recorded_time": (n - 1) * (SPAN // 1000),
                    "changes": 1,
                    "token": n,
                    "last_timeline": TIMELINES,
                }
                for n in range(1, 1001)
            ],
        )
        connection.execute(
            tables.timelines.insert(),
            [
                {"id": n, "kb_id": kb, "role": 0, "knowledge_type": 2, "key": f"p{n % 7} o{n}"}
                for n in range(1, TIMELINES + 1)
            ],
        )
        connection.execute(
            tables.mentions.insert(),
            [{"kb_id": kb, "object_id": n, "timeline_id": n} for n in range(1, TIMELINES + 1)],
        )
        step = SPAN // 500
        connection.execute(
            tables.runs.insert(),
            [
                {
                    "kb_id": kb,
                    "number": n,
                    "operator": "go",
                    "arguments": "kenny",
                    "initial_time": n * step,
                    "duration": step,
                    "duration_s": step / 1e9,
                    "end_time": n * step + step // 2,
                    "recorded_tx": 2 * n - 1,
                    "ended_tx": 2 * n,
                    "node": node(n * step, n * step + step // 2),
                }
                for n in range(1, 501)
            ],
        )
        for kind in for_kind.values():
            found = zip(*rows_of(kind.table, kb, counts[kind.table]), strict=True)
            for table, rows in zip((kind.table, "schedules", "revisions"), found, strict=True):
                connection.execute(tables.metadata.tables[table].insert(), [row for row in rows if row is not None])
