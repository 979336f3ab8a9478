"""Errors are problems (RFC 9457) with kbstore's sentence and a fitting status."""

import threading

import pytest

import kbstore
from kbstore import errors, seconds
from kbstore.clock import ManualClock
from kbstore.serve.problems import STATUSES


@pytest.mark.parametrize(
    ("path", "parameters", "status", "error", "sentence"),
    [
        ("holds", {"condition": "(opne lab_door)"}, 422, "UnknownSymbol", "has no predicate opne"),
        ("holds", {"condition": "(open lab_door"}, 400, "PddlSyntaxError", "line 1, column"),
        ("holds", {"condition": "(open lab_door)", "at": "tomorrow"}, 400, "InvalidTime", "like -5m"),
        ("holds", {"condition": "(open lab_door)", "as_of": "tx99"}, 400, "InvalidTime", "no transaction 99"),
        ("value", {"expression": "(battery lab_door)"}, 422, "InvalidKnowledge", "lab_door"),
        ("value", {"expression": "(battery bob)"}, 404, "UndefinedFunction", "has no value"),
        ("value", {"expression": "(/ 1 0)"}, 422, "DivisionByZero", "0"),
        ("changes", {"after": 99}, 409, "StoreWentBack", "99"),
        ("find", {"condition": "(not (open ?d))"}, 422, "InvalidKnowledge", "type"),
    ],
)
def test_errors_are_problems(serve, recorded, path, parameters, status, error, sentence):
    """The status gives the kind, `error` the class, and `detail` the sentence for people."""
    answer = serve(recorded).get(f"/api/{path}", params=parameters)
    assert (answer.status_code, answer.headers["content-type"]) == (status, "application/problem+json")
    found = answer.json()
    assert (found["status"], found["error"]) == (status, error)
    assert sentence in found["detail"]


def test_each_error_has_a_status():
    """The list ends with the base class, and no error is hidden by an earlier one."""
    kinds = [kind for kind, _ in STATUSES]
    assert kinds[-1] is errors.KbStoreError
    assert not [kind for i, kind in enumerate(kinds) if any(issubclass(kind, earlier) for earlier in kinds[:i])]


def test_a_position_in_pddl_is_returned(serve, recorded):
    """Line and column are numbers, for programs that mark the position."""
    found = serve(recorded).get("/api/holds", params={"condition": "(and\n  (open lab_door)\n"}).json()
    assert (found["line"], found["column"]) == (1, 1)


def test_all_violations_are_returned(serve, recorded):
    """There is one sentence for each."""
    found = serve(recorded).get("/api/changes", params={"after": -1, "limit": 0}).json()
    assert found["status"] == 422
    assert [violation.partition(":")[0] for violation in found["violations"]] == ["query.after", "query.limit"]


@pytest.mark.parametrize(("path", "status"), [("/api/nothing", 404), ("/nothing", 404), ("/docs", 404)])
def test_unknown_paths_are_problems(serve, recorded, path, status):
    """Unknown paths are problems; there are no pages that load scripts from other hosts either."""
    answer = serve(recorded).get(path)
    assert (answer.status_code, answer.headers["content-type"]) == (status, "application/problem+json")


def test_history_that_was_archived_is_gone(serve, tmp_path):
    """Q7: 410."""
    clock = ManualClock(seconds(10))
    with kbstore.open(tmp_path / "k.db", clock=clock) as kb:
        for t in (10, 20, 30):
            clock.set(seconds(t))
            kb.add(f"(= (f) {t})")
        kb.archive(seconds(20), tmp_path / "archive.db")
    client = serve(tmp_path / "k.db", clock=clock)
    answer = client.get("/api/holds", params={"condition": "(p)", "at": str(seconds(15))})
    assert (answer.status_code, answer.json()["error"]) == (410, "HistoryUnavailable")
    # the kept history is answered without a span
    assert len(client.get("/api/history", params={"pattern": "(f)"}).json()) == 2
    assert client.get("/api/runs").json() == []
    assert client.get("/").status_code == 200


def test_a_large_answer_is_refused(serve, recorded):
    """The size of an answer has a limit, and the sentence says what to do."""
    client = serve(recorded, most=5000)
    assert client.get("/api/changes", params={"limit": 1, "after": 10}).status_code == 200
    for path in ("changes", "state"):
        answer = client.get(f"/api/{path}", params={"at": "2026-05-04T09:02:00Z"})
        assert answer.status_code == 422
        assert "at most 5,000 are sent" in answer.json()["detail"]


def test_a_slow_answer_is_given_up(serve, recorded, monkeypatch):
    """The time of an answer has a limit; others are answered meanwhile."""
    going_on = threading.Event()
    monkeypatch.setattr(kbstore.KnowledgeBase, "state", lambda *_: going_on.wait(30))
    client = serve(recorded, patience=0.2)
    answer = client.get("/api/state")
    assert (answer.status_code, "more than 0.2 s" in answer.json()["detail"]) == (503, True)
    assert client.get("/api/holds", params={"condition": "(open lab_door)"}).status_code == 200
    going_on.set()
