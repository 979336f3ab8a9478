"""Access control: hosts, origins, tokens, and writing."""

import hmac
import json

import pytest

import kbstore
from kbstore import InvalidKnowledge
from kbstore.serve import guard
from kbstore.serve.store import Store
from kbstore.serve.web import make_app
from tests.serve.conftest import HERE

TOKEN = "0123456789abcdef-secret"
OTHER = "https://dashboard.example"
WRITES = ("add", "remove", "add-goal", "remove-goal", "set-metric", "replace", "apply", "start", "end", "abort")


@pytest.fixture
def store(tmp_path):
    with kbstore.open(tmp_path / "k.db", "kenny") as kb:
        kb.add("(p)")
    return tmp_path / "k.db"


def asked(client, **headers):
    return client.get("/api/holds", params={"condition": "(p)"}, headers=headers)


@pytest.mark.parametrize("host", ["127.0.0.1", "127.0.0.1:8011", "localhost:8011", "[::1]:8011"])
def test_this_machine_is_answered(serve, store, host):
    """By its names, with any port."""
    assert asked(serve(store), host=host).json()["holds"]


@pytest.mark.parametrize("host", ["evil.example", "evil.example:8011", "127.0.0.1.evil.example", "", "[::2]:8011"])
def test_another_host_is_refused(serve, store, host):
    """A host name of another site that resolves to here (DNS rebinding) is refused, also for the page."""
    client = serve(store)
    assert asked(client, host=host).status_code == 421
    assert client.get("/", headers={"host": host}).status_code == 421


@pytest.mark.parametrize("host", ["0.0.0.0", "::", "192.168.1.7", "robot.example"])
def test_others_are_served_with_a_token_only(store, host):
    """An address other than this machine's needs a token that is hard to guess; else the server does not start."""
    for token in (None, "", "short", "not ascii ä aaaaaaaaaaaa", "a" * 15):
        with pytest.raises(InvalidKnowledge, match=r"KBSTORE_TOKEN|openssl rand"):
            make_app(Store(store), host=host, token=token)
    make_app(Store(store), host=host, token=TOKEN)


@pytest.mark.parametrize("host", ["127.0.0.1", "127.0.0.2", "::1", "localhost"])
def test_this_machine_needs_no_token(store, host):
    """On loopback addresses of both kinds."""
    make_app(Store(store), host=host)


def test_a_token_is_required(serve, store):
    """For the page, the questions, and the description."""
    client = serve(store, token=TOKEN, host="0.0.0.0")
    for path in ("/", "/api/state", "/api/changes/stream", "/timeline/stream?known=0", "/openapi.json", "/nothing"):
        answer = client.get(path)
        assert (answer.status_code, answer.headers["www-authenticate"]) == (401, "Bearer")
        assert "Authorization: Bearer" in answer.json()["detail"]
    for wrong in (f"Bearer {TOKEN}x", f"Bearer {TOKEN[:-1]}", f"Basic {TOKEN}", TOKEN, "Bearer", "Bearer é"):
        assert asked(client, authorization=wrong.encode()).status_code == 401
    assert asked(client, authorization=f"Bearer {TOKEN}", host="robot.example").json()["holds"]


def test_a_token_is_compared_in_constant_time(serve, store, monkeypatch):
    """The time of the answer does not depend on how much of the token is right."""
    compared, compare_digest = [], hmac.compare_digest

    def compare(a, b):
        compared.append((a, b))
        return compare_digest(a, b)

    monkeypatch.setattr(guard.hmac, "compare_digest", compare)
    client = serve(store, token=TOKEN)
    assert asked(client, authorization="Bearer wrong").status_code == 401
    assert (b"wrong", TOKEN.encode()) in compared


def test_a_browser_gets_a_cookie_for_the_token(serve, store):
    """The address with the token redirects to one without; the cookie is not the token, and does not allow writing."""
    client = serve(store, token=TOKEN, allow_writes=True)
    answer = client.get("/", params={"kb": "kenny", "token": TOKEN}, follow_redirects=False)
    assert (answer.status_code, answer.headers["location"]) == (303, "?kb=kenny")
    assert TOKEN not in answer.headers["set-cookie"]
    assert {"HttpOnly", "SameSite=strict"} <= set(answer.headers["set-cookie"].split("; "))
    assert client.get("/", params={"kb": "kenny"}).text.startswith("<!doctype html>")
    assert asked(client).json()["holds"]
    assert client.post("/api/add", json={"items": ["(q)"]}).status_code == 401
    done = client.post("/api/add", json={"items": ["(q)"]}, headers={"authorization": f"Bearer {TOKEN}"})
    assert done.status_code == 200
    client.cookies.clear()
    assert client.get("/", params={"token": "wrong"}).status_code == 401
    assert asked(client, cookie="kbstore_token=wrong").status_code == 401


def test_pages_of_other_sites_may_not_ask(serve, store):
    """Their requests are refused, and browsers may not read answers (no CORS)."""
    client = serve(store, allow_writes=True)
    for origin in (OTHER, "http://127.0.0.1:9999", "null"):
        answer = asked(client, origin=origin)
        assert answer.status_code == 403
        assert "access-control-allow-origin" not in answer.headers
        refused = client.post("/api/add", json={"items": ["(q)"]}, headers={"origin": origin})
        assert refused.status_code == 403
    assert asked(client, origin=HERE, host="127.0.0.1:8011").status_code == 200
    assert not client.get("/api/holds", params={"condition": "(q)"}).json()["holds"]


def test_other_sites_are_allowed_by_name(serve, store):
    """With the origin: the preflight request, and the answer itself; other sites still may not."""
    client = serve(store, allow_origins=[OTHER], token=TOKEN)
    before = client.options(
        "/api/holds",
        headers={
            "origin": OTHER,
            "access-control-request-method": "GET",
            "access-control-request-headers": "authorization",
        },
    )
    assert (before.status_code, before.headers["access-control-allow-origin"]) == (200, OTHER)
    answer = asked(client, origin=OTHER, authorization=f"Bearer {TOKEN}")
    assert (answer.json()["holds"], answer.headers["access-control-allow-origin"]) == (True, OTHER)
    # a refusal can be read, too, as it is a sentence for people
    assert asked(client, origin=OTHER).headers["access-control-allow-origin"] == OTHER
    other = asked(client, origin="https://evil.example", authorization=f"Bearer {TOKEN}")
    assert (other.status_code, "access-control-allow-origin" in other.headers) == (403, False)


@pytest.mark.parametrize("path", WRITES)
def test_a_service_that_reads_does_not_write(serve, store, path):
    """Without --allow-writes every request that would change something is refused, and nothing changes."""
    client = serve(store)
    for method in ("POST", "PUT", "PATCH", "DELETE"):
        answer = client.request(method, f"/api/{path}", json={"items": ["(q)"], "run": 1, "operator": "go"})
        assert answer.status_code == 403
        assert "--allow-writes" in answer.json()["detail"]
    with kbstore.open(store, "kenny") as kb:
        assert kb.add("(r)").number == 2
    assert not [path for path in client.get("/openapi.json").json()["paths"] if path.endswith("/add")]


def test_a_read_only_service_does_not_change_the_file(serve, store):
    """The knowledge base itself is opened read-only: not a byte of the file changes."""
    before = store.read_bytes()
    client = serve(store)
    for path in ("state", "changes", "runs", "problem.pddl"):
        assert client.get(f"/api/{path}").status_code == 200
    assert client.get("/").status_code == 200
    assert store.read_bytes() == before


def test_security_headers_are_sent(serve, store):
    """Answers, and refusals, may not be cached, framed, or read as another type."""
    client = serve(store)
    for answer in (client.get("/"), asked(client), asked(client, host="evil.example")):
        assert answer.headers["x-content-type-options"] == "nosniff"
        assert answer.headers["x-frame-options"] == "DENY"
        assert answer.headers["cache-control"] == "no-store"


def test_a_form_of_another_page_is_not_taken_for_json(serve, store):
    """A body that a page can send without a preflight (no origin, as old browsers do) is not read."""
    client = serve(store, allow_writes=True)
    body = json.dumps({"items": ["(q)"]})
    for headers in ({"content-type": "text/plain"}, {"content-type": "application/x-www-form-urlencoded"}, {}):
        assert client.post("/api/add", content=body.encode(), headers=headers).status_code == 422
    assert not client.get("/api/holds", params={"condition": "(q)"}).json()["holds"]


def test_a_large_request_is_refused(serve, store, monkeypatch):
    """The size of a request has a limit."""
    client = serve(store, allow_writes=True)
    answer = client.post("/api/add", json={"items": ["(q)"], "note": "x" * 30_000_000})
    assert answer.status_code == 413
