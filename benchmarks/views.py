"""Questions in SQL on the views, in a long history."""

from collections.abc import Callable, Iterator
from typing import Any

from benchmarks import raw
from benchmarks.histories import PASSING, UNIFORM, History
from benchmarks.measuring import CPU, once, side_by_side
from benchmarks.report import Result
from benchmarks.settings import Settings

_FACT = "SELECT * FROM fact_history WHERE knowledge_base = '{name}' AND timeline_key "

HISTORIES = (
    (UNIFORM, "one fact's history", _FACT + "= 'reachable wp3 wp4'"),
    (PASSING, "a predicate's, with its first argument", _FACT + ">= 'seen item50' AND timeline_key < 'seen item50!'"),
)
"""Questions to the views: which shape of history, in words, and the statement for a knowledge base."""

_FLAPPED = """
SELECT t.key AS fact, n.times
FROM (SELECT f.kb_id, f.timeline_id, count(*) AS times FROM knowledge_bases k JOIN facts f ON f.kb_id = k.id
      WHERE k.name = '{name}' AND f.retired_tx IS NULL GROUP BY f.kb_id, f.timeline_id HAVING count(*) > 1) n
JOIN timelines t ON t.kb_id = n.kb_id AND t.id = n.timeline_id AND t.role = 0
ORDER BY times DESC, fact
"""
_VANISHED = """
SELECT i.key AS object, x.client AS removed_by, t.key AS and_with_it
FROM knowledge_bases k
JOIN timelines i ON i.kb_id = k.id AND i.role = 0 AND i.knowledge_type = 0 {which}
JOIN instances o ON o.kb_id = i.kb_id AND o.timeline_id = i.id AND o.end_cause = 1 AND o.retired_tx IS NULL
JOIN transactions x ON x.kb_id = o.kb_id AND x.number = o.ended_tx
JOIN mentions m ON m.kb_id = o.kb_id AND m.object_id = o.timeline_id
CROSS JOIN facts f
JOIN timelines t ON t.kb_id = f.kb_id AND t.id = f.timeline_id AND t.role = 0
WHERE k.name = '{name}' AND f.kb_id = m.kb_id AND f.timeline_id = m.timeline_id AND f.end_time = o.end_time
  AND f.end_cause = 3 AND f.retired_tx IS NULL
"""

STATEMENTS = (
    (UNIFORM, "which facts flapped", _FLAPPED),
    (PASSING, "what vanished with one object", _VANISHED.replace("{which}", "AND i.key = 'item50'")),
    (PASSING, "what vanished with all objects", _VANISHED.replace("{which}", "")),
)
"""The same for statements of docs/sql.md about all history."""


def measure(settings: Settings) -> Iterator[Result]:
    """Measure one fact's history, a predicate's with its first argument, and two statements of docs/sql.md."""
    for shape, what, query in HISTORIES:
        connection = raw.connect(settings.store(History(shape, settings.size)))
        ask = asking(connection, query.format(name="bench"))
        found = side_by_side({"view": ask}, clock=CPU, seconds=settings.seconds / 2)
        yield Result(f"SQL views: {what}, {settings.size:,}", "20 ms", found["view"], 0.02, 1)
        connection.close()
    for shape, what, query in STATEMENTS:
        connection = raw.connect(settings.store(History(shape, settings.size)))
        lasting = once(asking(connection, query.format(name="bench")), CPU)
        yield Result(f"SQL: {what}, {settings.size:,}", "1 s", lasting, 1.0, 1)
        connection.close()


def asking(connection: Any, query: str) -> Callable[[], None]:
    """Return what asks a statement, and raises unless it is answered with rows."""

    def ask() -> None:
        if not connection.execute(query).fetchall():
            raise AssertionError(f"nothing was found by {query}")

    return ask
