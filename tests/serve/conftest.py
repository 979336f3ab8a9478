"""Services on separate stores, asked in the same process."""

import threading

import pytest
from fastapi.testclient import TestClient

import kbstore
from kbstore.cli.demo.mission import record
from kbstore.serve.store import Store
from kbstore.serve.web import make_app

HERE = "http://127.0.0.1:8011"


@pytest.fixture(scope="session")
def recorded(tmp_path_factory):
    """A file with the mission of the demonstration, to be read only."""
    file = tmp_path_factory.mktemp("serve") / "kenny.db"
    record(f"sqlite:///{file}").close()
    return file


@pytest.fixture
def serve():
    """Serve stores to clients, and stop; no thread is left."""
    clients = []
    before = set(threading.enumerate())

    def serving(url, base=HERE, *, clock=None, patience=30, most=10_000_000, **options):
        clocks = {} if clock is None else {"clock": lambda _: clock}
        writes = options.get("allow_writes", False)
        store = Store(url, allow_writes=writes, patience=patience, most=most, **clocks)
        client = TestClient(make_app(store, **options), base_url=base)
        clients.append(client.__enter__())
        return client

    yield serving
    for client in clients:
        client.__exit__(None, None, None)
    assert set(threading.enumerate()) <= before


@pytest.fixture
def mission(serve, recorded):
    """A client of the recorded mission; an answer with 200 is returned decoded."""
    client = serve(recorded)

    def ask(path, **parameters):
        answer = client.get(f"/api/{path}", params=parameters)
        assert answer.status_code == 200, answer.text
        return answer.json()

    return ask


@pytest.fixture
def kb(recorded):
    """The knowledge base that `mission` serves."""
    with kbstore.open(recorded, "kenny", read_only=True) as opened:
        yield opened
