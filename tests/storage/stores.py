"""Stores with a long history, filled row by row: what the planners of both engines are tried on."""

import random

from kbstore.clock import OPEN
from kbstore.storage import queries, tables
from kbstore.storage.interval_tree import level, node

KB = 2
"""The knowledge base that is asked; another one beside it is as large."""

SPAN = 10**12
"""The history of each reaches from 0 to here."""

TIMELINES = 400


def rows_of(table, kb, count, seed=0):
    """Rows of one knowledge base: closed intervals, some open, scheduled, cancelled and of no length."""
    chance = random.Random(f"{table}{kb}{seed}")
    own = {
        "instances": {"instance_type": "place"},
        "facts": {},
        "functions": {"function_value": 1.5, "own_rate": 0.0, "rate": 0.0},
        "expressions": {"optimization": "", "expr": "(total-time)"},
        "inequalities": {"comparison_type": 0, "lhs": "", "rhs": "", "grounded": True},
    }[table]
    step = SPAN // (count // TIMELINES + 1)
    for index in range(count):
        timeline = (kb - 1) * TIMELINES + index % TIMELINES + 1
        start = (index // TIMELINES) * step + chance.randrange(step // 4)
        number = start // (SPAN // 1000) + 1
        last = index >= count - TIMELINES
        row = {
            "kb_id": kb,
            "timeline_id": timeline,
            "initial_time": start,
            "end_time": OPEN if last else start + 1 + chance.randrange(step // 2),
            "is_negative": False,
            "recorded_tx": number,
            "recorded_time": None,
            "ended_tx": None,
            "end_cause": None,
            "cancelled_tx": None,
            "cancelled_time": None,
            "pending_node": None,
            **own,
        }
        if not last:
            row["ended_tx"] = row["end_time"] // (SPAN // 1000) + 1
            row["end_cause"] = chance.choice((1, 2, 2, 2, 3))
        if index % 20 == 7:
            row["recorded_time"] = max(0, start - chance.randrange(1, step))
            row["pending_node"] = node(row["recorded_time"], start)
        if index % 100 == 11:
            row |= {"end_time": start, "ended_tx": None, "end_cause": None, "cancelled_tx": number}
            row |= {"recorded_time": max(0, start - 100), "cancelled_time": max(0, start - 50)}
            row["pending_node"] = node(row["recorded_time"], row["cancelled_time"])
        row["level"] = level(row["initial_time"], row["end_time"])
        yield row


def fill(connection, counts):
    """Fill an empty store with two knowledge bases; `counts` is how many rows of each table of assertions."""
    for kb in (1, KB):
        head = {"last_number": 1000, "last_time": SPAN, "history_from": 0, "domain_version": 0, "last_run": 500}
        connection.execute(tables.knowledge_bases.insert(), {"id": kb, "name": f"kb{kb}", "use_unknowns": False} | head)
        connection.execute(
            tables.transactions.insert(),
            [
                {"kb_id": kb, "number": n, "recorded_time": (n - 1) * (SPAN // 1000), "changes": 1}
                for n in range(1, 1001)
            ],
        )
        connection.execute(
            tables.timelines.insert(),
            [
                {"id": (kb - 1) * TIMELINES + n, "kb_id": kb, "role": 0, "knowledge_type": 2, "key": f"p{n % 7} o{n}"}
                for n in range(1, TIMELINES + 1)
            ],
        )
        connection.execute(
            tables.mentions.insert(),
            [{"kb_id": kb, "object_id": n, "timeline_id": (kb - 1) * TIMELINES + n} for n in range(1, TIMELINES + 1)],
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
                    "end_time": n * step + step // 2,
                    "recorded_tx": 2 * n - 1,
                    "ended_tx": 2 * n,
                    "node": node(n * step, n * step + step // 2),
                }
                for n in range(1, 501)
            ],
        )
        for kind in queries.for_kind.values():
            found = list(rows_of(kind.table, kb, counts[kind.table]))
            connection.execute(tables.metadata.tables[kind.table].insert(), found)
