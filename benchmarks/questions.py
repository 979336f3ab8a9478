"""Questions that an executive asks in its loop: conditions, parts of the state, bindings."""

from collections.abc import Callable, Iterator
from itertools import count

import kbstore
from benchmarks import raw
from benchmarks.histories import START
from benchmarks.measuring import CPU, Way, side_by_side
from benchmarks.report import Result
from benchmarks.settings import Settings
from kbstore import KnowledgeBase, ManualClock, seconds

DOMAIN = """
(define (domain fetch)
  (:requirements :typing :fluents)
  (:types robot waypoint item - object)
  (:predicates (robot_at ?r - robot ?w - waypoint) (path ?a ?b - waypoint) (at ?i - item ?w - waypoint)
    (docked ?r - robot) (wanted ?i - item) (whole ?i - item))
  (:functions (battery ?r - robot) (load ?r - robot))
  (:action go :parameters (?r - robot ?a ?b - waypoint)
    :precondition (and (robot_at ?r ?a) (not (docked ?r)) (> (battery ?r) 10))
    :effect (and (not (robot_at ?r ?a)) (robot_at ?r ?b))))
"""
ROBOTS, WAYPOINTS, PATHS = 10, 100, 1000
"""With their facts, 1,110 objects and facts and a few more, of which a part asks for ten."""

STANDING = "(and (docked r1) (or (robot_at r1 w2) (not (docked r2))) (>= (load r1) 2))"
MOVING = "(and (docked r1) (>= (battery r1) 20))"
_TEXTS = 5000


def measure(settings: Settings) -> Iterator[Result]:
    """Measure a state at hand, conditions now, parts of the state, and `find`."""
    store = settings.new("questions")
    with kbstore.open(store, "bench", clock=ManualClock(START)) as kb:
        tell(kb)
        yield from _at_hand(settings, kb)
        points = _Points(store, kb)
        yield from _conditions(settings, kb, points)
        yield from _parts(settings, kb, points)
    yield from _find(settings)


def tell(kb: KnowledgeBase) -> None:
    """Tell what the questions are about."""
    robots, waypoints = [f"r{n}" for n in range(ROBOTS)], [f"w{n}" for n in range(WAYPOINTS)]
    kb.load(DOMAIN)
    kb.add(*(f"{name} - robot" for name in robots), *(f"{name} - waypoint" for name in waypoints))
    kb.add(*(f"(path w{n % WAYPOINTS} w{(n * 7 + n // WAYPOINTS) % WAYPOINTS})" for n in range(PATHS)))
    kb.add(*(f"(robot_at {name} w{n})" for n, name in enumerate(robots)), "(docked r1)")
    kb.add(*(f"(= (load {name}) 2)" for name in robots))
    kb.add("(= (battery r1) 80)", "(= (battery r2) 80)", "(increase (battery r1) (* #t -0.001))")
    kb.add_goal("(docked r3)", "(robot_at r1 w5)")
    kb.add_metric("minimize (total-time)")
    kb.add(*(f"(docked {name})" for name in robots), initial_time=START + seconds(3600))


class _Points:
    """The same store by plain `sqlite3`: one fact, and ten."""

    def __init__(self, store: object, kb: KnowledgeBase) -> None:
        self._connection = raw.connect(store)  # type: ignore[arg-type]
        self._writer = raw.connect(store, synchronous="OFF")  # type: ignore[arg-type]
        rows = self._connection.execute(
            "SELECT id FROM timelines WHERE key LIKE 'robot\\_at %' ESCAPE '\\' AND role = 0"
        )
        self._ids = [row[0] for row in rows]
        self._t = kb.now()
        known = "kb_id = 1 AND retired_tx IS NULL AND initial_time <= ? AND end_time > ?"
        self._ten = (
            "SELECT timeline_id, initial_time, is_negative FROM facts"
            f" WHERE timeline_id IN ({', '.join(map(str, self._ids))}) AND {known}"
        )
        self._one = (
            "SELECT is_negative, end_time FROM facts WHERE kb_id = 1 AND timeline_id = ? AND retired_tx IS NULL"
            " AND initial_time <= ? ORDER BY initial_time DESC LIMIT 1"
        )

    def ten(self) -> object:
        """Fetch ten rows."""
        return self._connection.execute(self._ten, (self._t, self._t)).fetchall()

    def one(self) -> object:
        """Fetch one row."""
        return self._connection.execute(self._one, (self._ids[0], self._t)).fetchone()

    def write_elsewhere(self) -> object:
        """Commit to the file, and to no knowledge base in it."""
        return self._writer.execute("UPDATE kbstore_alembic_version SET version_num = version_num").fetchone()

    def version(self) -> object:
        """Ask SQLite whether another connection has committed."""
        return self._connection.execute("PRAGMA data_version").fetchone()


def _at_hand(settings: Settings, kb: KnowledgeBase) -> Iterator[Result]:
    state, world = kb.state(), {"(docked r1)": True}
    texts = (f"(path w{n % WAYPOINTS} w{n // WAYPOINTS})" for n in count() if n < _TEXTS * WAYPOINTS)
    found = side_by_side(
        {
            "dict": lambda: world.get("(docked r1)"),
            "again": lambda: state.holds("(docked r1)"),
            "new": lambda: state.holds(next(texts)),
        },
        clock=CPU,
        seconds=settings.seconds / 2,
        minimum=20,
    )
    beside = "dict.get, in a function"
    yield Result("question on a state at hand, same text", beside, found["again"], found["dict"], 5)
    yield Result("question on a state at hand, new text each time", beside, found["new"], found["dict"])


def _conditions(settings: Settings, kb: KnowledgeBase, points: _Points) -> Iterator[Result]:
    times = count(kb.now())
    bound = "(exists (?w - waypoint) (robot_at r1 ?w))"
    ways: dict[str, Way] = {
        "version": points.version,
        "point": points.one,
        "standing": lambda: kb.holds(STANDING),
        "moving": lambda: kb.holds(MOVING),
        "write": points.write_elsewhere,
        "standing elsewhere": lambda: (points.write_elsewhere(), kb.holds(STANDING)),
        "moving elsewhere": lambda: (points.write_elsewhere(), kb.holds(MOVING)),
        "anew": lambda: kb.holds(STANDING, at=next(times)),
        "exists": lambda: kb.holds(bound),
        "exists anew": lambda: kb.holds(bound, at=next(times)),
        "pattern": lambda: kb.holds("(robot_at r1 ?)"),
    }
    found = side_by_side(ways, clock=CPU, seconds=settings.seconds)
    version, point = ("PRAGMA data_version", found["version"]), ("raw point query", found["point"])
    yield Result("condition now, nobody wrote", version[0], found["standing"], version[1], 3)
    yield Result("condition now, with a number that moves", point[0], found["moving"], point[1], 10)
    for name, what in (("standing", "condition"), ("moving", "condition with a number that moves")):
        duration = found[f"{name} elsewhere"] - found["write"]
        yield Result(f"{what}, after a write elsewhere in the store", point[0], duration, point[1], 10)
    yield Result("condition, after each write of somebody", point[0], found["anew"], point[1], 10)
    yield Result("exists, one argument bound, now", point[0], found["exists"], point[1], 5)
    yield Result("exists, one argument bound, after each write", point[0], found["exists anew"], point[1])
    yield Result("pattern, one argument bound, now", point[0], found["pattern"], point[1], 5)


def _parts(settings: Settings, kb: KnowledgeBase, points: _Points) -> Iterator[Result]:
    ways: dict[str, Callable[[], object]] = {
        "instances of a type": lambda: kb.instances("robot"),
        "propositions of a name": lambda: kb.propositions("robot_at"),
        "functions of a name": lambda: kb.functions("load"),
        "goals": kb.goals,
        "metric": kb.metric,
        "timed_knowledge of a name": lambda: kb.timed_knowledge("docked"),
        "query of three items": lambda: kb.query("(docked r1)", "(robot_at r1 w1)", "(>= (load r1) 2)"),
        "applicable": lambda: kb.applicable("go", "r2", "w2", "w3"),
    }
    times = count(kb.now())
    anew: dict[str, Callable[[], object]] = {
        "instances of a type": lambda: kb.instances("robot", at=next(times)),
        "propositions of a name": lambda: kb.propositions("robot_at", at=next(times)),
        "functions of a name": lambda: kb.functions("load", at=next(times)),
        "goals": lambda: kb.goals(at=next(times)),
        "metric": lambda: kb.metric(at=next(times)),
        "timed_knowledge of a name": lambda: kb.timed_knowledge("docked", at=next(times)),
        "query of three items": lambda: kb.query("(docked r1)", "(robot_at r1 w1)", at=next(times)),
        "applicable": lambda: kb.applicable("go", "r2", "w2", "w3", at=next(times)),
        "applicable, which it is not": lambda: kb.applicable("go", "r2", "w9", "w3", at=next(times)),
    }
    after = {f"{name}, after each write": way for name, way in anew.items()}
    found = side_by_side({"raw": points.ten, **ways, **after}, clock=CPU, seconds=settings.seconds)
    for name in (*ways, *after):
        bar = 3 if name in ways else None
        yield Result(f"{name}, of 1,110 rows", "raw fetch of ten rows", found[name], found["raw"], bar)


def _find(settings: Settings) -> Iterator[Result]:
    """Three atoms over more and more facts each, of which ten have an answer."""
    condition = "(and (wanted ?i) (whole ?i) (at ?i ?w))"
    sizes = [size for size in (100, 1_000, 10_000) if size <= settings.bulk]
    ways: dict[str, Way] = {}
    for size in sizes:
        kb = kbstore.open(settings.new(f"find{size}"), "bench", clock=ManualClock(START))
        kb.load(DOMAIN)
        kb.add("w1 - waypoint", *(f"i{n} - item" for n in range(2 * size)))
        kb.add(*(f"(wanted i{n})" for n in range(size)), *(f"(whole i{size - 10 + n})" for n in range(size)))
        kb.add(*(f"(at i{n} w1)" for n in range(size)))
        assert len(kb.find(condition)) == 10
        ways[f"{size:,}"] = lambda kb=kb: kb.find(condition)  # type: ignore[misc]
    found = side_by_side(ways, clock=CPU, seconds=settings.seconds)
    yield Result("find over three atoms, 1,000 facts each", "10 ms", found["1,000"], 0.01, 1)
    for small, large in zip(found, list(found)[1:], strict=False):
        yield Result(f"growth of find, {large} facts each", f"the same with {small}", found[large], found[small])
