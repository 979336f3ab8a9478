"""Writing through a service: a POST for each change, which is one transaction."""

import pytest

import kbstore
from kbstore import seconds
from kbstore.clock import ManualClock, isoformat

DOMAIN = """
(define (domain d) (:types robot place)
  (:predicates (at ?r - robot ?p - place) (tidy))
  (:functions (battery ?r - robot))
  (:action jump :parameters (?r - robot) :precondition (tidy) :effect (not (tidy)))
  (:durative-action go :parameters (?r - robot ?p - place) :duration (>= ?duration 1)
    :condition (at start (tidy)) :effect (at end (at ?r ?p))))
"""


@pytest.fixture
def clock():
    return ManualClock(seconds(1000))


@pytest.fixture
def service(serve, tmp_path, clock):
    """A client of a knowledge base that may be written to, and the knowledge base."""
    with kbstore.open(tmp_path / "k.db", "kenny", clock=clock) as kb:
        kb.load(DOMAIN)
        kb.add("k - robot", "hall - place")
        client = serve(tmp_path / "k.db", clock=clock, allow_writes=True)
        yield (lambda path, **body: client.post(f"/api/{path}", json=body)), kb


def test_knowledge_is_added_and_removed(service):
    """The answer is the transaction, with client and note."""
    post, kb = service
    added = post("add", items=["(at k hall)", "(= (battery k) 80)"], client="web", note="a test")
    assert added.status_code == 200
    assert added.json() == {
        "number": 3,
        "time": isoformat(seconds(1000)),
        "client": "web",
        "note": "a test",
        "changes": 2,
    }
    assert kb.value("(battery k)") == 80
    assert post("remove", items=["(at k ?)"]).json()["changes"] == 1
    assert post("remove", items=["(at k ?)"]).json() == {
        "number": 4,
        "time": isoformat(seconds(1000)),
        "client": "",
        "note": "",
        "changes": 0,
    }


def test_times_of_knowledge(service, clock):
    """T4, L1: scheduled, or late."""
    post, kb = service
    clock.set(seconds(2000))
    assert post("add", items=["(tidy)"], initial_time="+60s").status_code == 200
    assert post("add", items=["(= (battery k) 1)"], since=str(seconds(1500)), until="1970-01-01T00:30:00Z").json()[
        "changes"
    ]
    assert kb.holds("(tidy)", seconds(2060))
    assert not kb.holds("(tidy)", seconds(2059))
    assert kb.value("(battery k)", seconds(1600)) == 1


def test_goals_metric_and_replacement(service):
    """C10, C11, C13: as by the methods of these names."""
    post, kb = service
    assert post("add-goal", items=["(and (tidy) (at k hall))"]).json()["changes"] == 2
    assert post("remove-goal", items=["(tidy)"]).json()["changes"] == 1
    assert [str(goal) for goal in kb.goals()] == ["(at k hall)"]
    assert post("set-metric", metric="minimize (total-time)").json()["changes"] == 1
    assert str(kb.metric()) == "minimize (total-time)"
    assert post("replace", items=["k - robot", "hall - place", "(tidy)"]).json()["changes"] == 1
    assert kb.holds("(tidy)")


def test_actions(service, clock):
    """O1 to O3: started, ended or aborted by the number of the run."""
    post, kb = service
    refused = post("start", operator="go", arguments=["k", "hall"], seconds=5)
    assert (refused.status_code, refused.json()["error"]) == (409, "NotApplicable")
    kb.add("(tidy)")
    run = post("start", operator="go", arguments=["k", "hall"], seconds=2.5, client="web").json()
    assert (run["operator"], run["seconds"], run["outcome"]) == ("go", 2.5, "running")
    clock.advance(seconds(2))
    ended = post("end", run=run["number"]).json()
    assert (ended["failing"], ended["broken"], kb.holds("(at k hall)")) == ([], [], True)
    gone = post("end", run=run["number"])
    assert (gone.status_code, "no action with the number 1 runs" in gone.json()["detail"]) == (404, True)
    second = post("start", operator="go", arguments=["k", "hall"], seconds=5).json()
    assert post("abort", run=second["number"]).json()["changes"] == 1
    assert [each.outcome for each in kb.runs()] == ["ended", "aborted"]
    assert post("apply", operator="jump", arguments=["k"]).json()["changes"] == 1
    assert not kb.holds("(tidy)")


@pytest.mark.parametrize(
    ("path", "body", "status"),
    [
        ("add", {"items": ["(at k nowhere)", "(sunny)"]}, 422),
        ("add", {"items": ["(at k hall"]}, 400),
        ("add", {"items": []}, 422),
        ("add", {"items": "(at k hall)"}, 422),
        ("add", {"items": ["(tidy)"], "surprise": 1}, 422),
        ("add", {"items": ["(tidy)"], "initial_time": "soon"}, 400),
        ("add", {"items": ["(tidy)"], "client": "\x00"}, 422),
        ("set-metric", {"metric": "(tidy)"}, 422),
        ("start", {"operator": "fly"}, 422),
        ("start", {"operator": "go", "arguments": ["k", "hall"], "seconds": -1}, 422),
    ],
)
def test_an_invalid_request_stores_nothing(service, path, body, status):
    """C1, D1: all or nothing, with a problem for each error."""
    post, kb = service
    answer = post(path, **body)
    assert (answer.status_code, answer.headers["content-type"]) == (status, "application/problem+json")
    assert kb.add("(tidy)").number == 3


def test_all_violations_of_a_request_are_returned(service):
    """D1: there is one sentence for each."""
    post, _ = service
    found = post("add", items=["(at k nowhere)", "(= (battery hall) 1)"]).json()
    assert len(found["violations"]) == 2
