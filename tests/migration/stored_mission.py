"""A short mission, written by hand, and its answers at many times: the content of every stored database file.

Each file was written by the kbstore that had its schema; ``python -m tests.migration.stored_mission`` writes today's.
"""

import gzip
import tempfile
from pathlib import Path

import kbstore
from kbstore import ManualClock, seconds
from kbstore.storage import schema

STORED = Path(__file__).parent / "stored"
"""The directory of the files: one for each revision, compressed."""

NAME = "kenny"

DOMAIN = """
(define (domain delivery)
  (:requirements :typing :fluents :durative-actions :negative-preconditions)
  (:types place robot - object)
  (:predicates (at ?r - robot ?p - place) (open ?p - place))
  (:functions (battery ?r - robot))
  (:durative-action go :parameters (?r - robot ?from ?to - place)
    :duration (and (>= ?duration 1) (<= ?duration 100))
    :condition (at start (at ?r ?from))
    :effect (and (at start (not (at ?r ?from))) (at end (at ?r ?to)) (decrease (battery ?r) (* #t 0.5)))))
"""

EVERYBODY = ["Kenny - robot", "wp0 - place", "wp1 - place"]

STATES = {
    99: {},
    105: {"instances": EVERYBODY},
    115: {
        "instances": EVERYBODY,
        "facts": ["(at Kenny wp0)"],
        "functions": ["(= (battery Kenny) 80)"],
        "goals": ["(at Kenny wp1)"],
        "metric": ["maximize (battery kenny)"],
    },
    130: {
        "instances": EVERYBODY,
        "functions": ["(= (battery Kenny) 75)"],
        "goals": ["(at Kenny wp1)"],
        "metric": ["maximize (battery kenny)"],
        "running": ["(go Kenny wp0 wp1)"],
    },
    145: {
        "instances": EVERYBODY,
        "facts": ["(at Kenny wp1)"],
        "functions": ["(= (battery Kenny) 70)"],
        "metric": ["maximize (battery kenny)"],
    },
    152: {
        "instances": EVERYBODY,
        "facts": ["(at Kenny wp1)"],
        "functions": ["(= (battery Kenny) 70)"],
        "metric": ["maximize (battery kenny)"],
        "timed_knowledge": ["160 (open wp0)", "170 (not (open wp0))"],
    },
    158: {
        "instances": EVERYBODY,
        "facts": ["(at Kenny wp1)"],
        "functions": ["(= (battery Kenny) 70)"],
        "inequalities": ["(> (battery kenny) 20)"],
        "metric": ["maximize (battery kenny)"],
        "timed_knowledge": ["160 (open wp0)"],
    },
    162: {
        "instances": EVERYBODY,
        "facts": ["(at Kenny wp1)", "(open wp0)"],
        "functions": ["(= (battery Kenny) 70)"],
        "inequalities": ["(> (battery kenny) 20)"],
        "metric": ["maximize (battery kenny)"],
    },
    170: {
        "instances": ["Kenny - robot", "wp1 - place"],
        "facts": ["(at Kenny wp1)", "(not (open wp1))"],
        "functions": ["(= (battery Kenny) 70)"],
        "inequalities": ["(> (battery kenny) 20)"],
        "metric": ["maximize (battery kenny)"],
    },
    190: {},
}
"""The state at a second; a part that is not named is empty then."""

BELIEVED_AT_152_ABOUT_175 = ["(at Kenny wp1)", "(not (open wp0))"]
OPEN_WP0 = [("(open wp0)", 160, 165, False), ("(not (open wp0))", 170, 170, True)]
CLIENTS = ["", "mapper", "", "driver", "driver", "planner", "planner", "", "mapper", ""]


def play(url):
    """Play the mission: ten transactions."""
    clock = ManualClock(seconds(100))
    with kbstore.open(url, NAME, clock=clock) as kb:
        kb.load(DOMAIN)
        kb.add("Kenny - robot", "wp0 - place", "wp1 - place", client="mapper", note="first round")
        clock.set(seconds(110))
        with kb.transaction() as tx:
            tx.add("(at Kenny wp0)", "(= (battery Kenny) 80)")
            tx.add_goal("(at Kenny wp1)")
            tx.add_metric("maximize (battery kenny)")
        clock.set(seconds(120))
        run = kb.start("go", "Kenny", "wp0", "wp1", duration=seconds(20), client="driver")
        clock.set(seconds(140))
        with kb.transaction(client="driver") as tx:
            tx.end(run)
            tx.remove_goal("(at Kenny wp1)")
        clock.set(seconds(150))
        with kb.transaction(client="planner") as tx:
            tx.add("(open wp0)", initial_time=seconds(160))
            tx.add("(not (open wp0))", initial_time=seconds(170))
        clock.set(seconds(155))
        kb.remove("(not (open wp0))", initial_time=seconds(170), client="planner")
        kb.add("(> (battery kenny) 20)")
        clock.set(seconds(165))
        kb.update([(2, "wp0 - place"), (0, "(not (open wp1))")], client="mapper")
        clock.set(seconds(180))
        kb.clear()


def check_answers(kb):
    """Check the answers of a knowledge base at many times."""
    for second, expected in STATES.items():
        assert shown(kb.state(at=seconds(second))) == {name: expected.get(name, []) for name in SHOWN}, second
    assert texts(kb.state(at=seconds(175), as_of=seconds(152)).facts) == BELIEVED_AT_152_ABOUT_175
    assert [
        (str(found.item), found.initial_time // 10**9, found.end_time // 10**9, found.cancelled is not None)
        for found in kb.history("(open wp0)")
    ] == OPEN_WP0
    assert kb.when("(< (battery kenny) 75)", seconds(100), seconds(180)) == [(seconds(130) + 1, seconds(180))]
    assert [change.transaction.client for change in kb.changes()][: len(CLIENTS)] == CLIENTS
    assert kb.domain.name == "delivery"


SHOWN = ("instances", "facts", "functions", "inequalities", "goals", "metric", "timed_knowledge", "running")


def shown(state):
    """A state as sorted texts; formulas in lower case, as older files have names in them as typed."""
    return {
        "instances": texts(state.instances),
        "facts": texts(state.facts),
        "functions": texts(state.functions),
        "inequalities": [text.lower() for text in texts(state.inequalities)],
        "goals": texts(state.goals),
        "metric": [str(state.metric).lower()] if state.metric else [],
        "timed_knowledge": sorted(f"{item.initial_time // 10**9} {item}" for item in state.timed_knowledge),
        "running": [f"({' '.join((run.operator, *run.arguments))})" for run in state.running],
    }


def texts(items):
    """Items as sorted text."""
    return sorted(map(str, items))


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "store.db"
        play(path)
        (STORED / f"{schema.HEAD}.db.gz").write_bytes(gzip.compress(path.read_bytes(), mtime=0))
