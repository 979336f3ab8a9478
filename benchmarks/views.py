"""Questions in SQL on the views, in a long history."""

from collections.abc import Iterator

from benchmarks import raw
from benchmarks.histories import PASSING, UNIFORM, History
from benchmarks.measuring import CPU, once, side_by_side
from benchmarks.report import Result
from benchmarks.settings import Settings

_KEY, _FIRST, _AFTER = "reachable wp3 wp4", "seen item50 ", "seen item50!"
_FACT = "SELECT * FROM fact_history WHERE knowledge_base = 'bench' AND "
_FLAPPED = """
SELECT t.key AS fact, n.times
FROM (SELECT kb_id, timeline_id, count(*) AS times FROM facts
      WHERE retired_tx IS NULL GROUP BY kb_id, timeline_id HAVING count(*) > 1) n
JOIN timelines t ON t.kb_id = n.kb_id AND t.id = n.timeline_id AND t.role = 0
ORDER BY times DESC, fact
"""
_VANISHED = """
SELECT i.key AS object, t.key AS and_with_it
FROM instances o
JOIN timelines i ON i.kb_id = o.kb_id AND i.id = o.timeline_id
JOIN mentions m ON m.kb_id = o.kb_id AND m.object_id = o.timeline_id
CROSS JOIN facts f
JOIN timelines t ON t.kb_id = f.kb_id AND t.id = f.timeline_id AND t.role = 0
WHERE o.end_cause = 1 AND o.retired_tx IS NULL AND f.kb_id = m.kb_id AND f.timeline_id = m.timeline_id
  AND f.end_time = o.end_time AND f.end_cause = 3 AND f.retired_tx IS NULL
"""


def measure(settings: Settings) -> Iterator[Result]:
    """Measure one fact's history, a predicate's with its first argument, and two statements of docs/sql.md."""
    for shape, what, query, parameters in (
        (UNIFORM, "one fact's history", f"{_FACT}timeline_key = ?", (_KEY,)),
        (
            PASSING,
            "a predicate's, with its first argument",
            f"{_FACT}timeline_key >= ? AND timeline_key < ?",
            (_FIRST, _AFTER),
        ),
    ):
        connection = raw.connect(settings.store(History(shape, settings.size)))
        ask = lambda: connection.execute(query, parameters).fetchall()  # noqa: B023, E731 - called at once
        found = side_by_side({"view": ask}, clock=CPU, seconds=settings.seconds / 2)
        yield Result(f"SQL views: {what}, {settings.size:,}", "20 ms", found["view"], 0.02, 1)
        connection.close()
    for shape, what, query in ((UNIFORM, "which facts flapped", _FLAPPED), (PASSING, "what vanished", _VANISHED)):
        connection = raw.connect(settings.store(History(shape, settings.size)))
        lasting = once(lambda: connection.execute(query).fetchall(), CPU)  # noqa: B023 - called at once
        yield Result(f"SQL: {what}, {settings.size:,}", "1 s", lasting, 1.0, 1)
        connection.close()
