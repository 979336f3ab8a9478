"""A real server on this machine: many clients at once, streams, and stopping."""

import json
import os
import signal
import socket
import subprocess
import sys
import threading
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager

import httpx2
import pytest
from typer.testing import CliRunner

import kbstore
from kbstore.cli.app import app
from kbstore.cli.demo.mission import record
from kbstore.serve.server import Server, listen
from kbstore.serve.store import Store
from kbstore.serve.web import make_app

CLIENTS = 50


@contextmanager
def running(url, **options):
    """A server of a store in a thread; its address."""
    ready, addresses = threading.Event(), []

    def report(address):
        addresses.append(address)
        ready.set()

    served = make_app(Store(url, allow_writes=options.get("allow_writes", False)), **options)
    server = Server(served, ready=report)
    thread = threading.Thread(target=server.run, args=[[listen("127.0.0.1", 0)]])
    before = set(threading.enumerate())
    thread.start()
    assert ready.wait(30)
    try:
        yield addresses[0]
    finally:
        server.should_exit = True
        thread.join(30)
        assert not thread.is_alive()
    assert set(threading.enumerate()) <= before


@pytest.fixture
def store(tmp_path):
    with kbstore.open(tmp_path / "k.db", "kenny") as kb:
        kb.add("(p)", "(= (f) 0)")
    return tmp_path / "k.db"


def events(lines):
    """The events of a stream, each as its fields."""
    found = {}
    for line in lines:
        if line:
            name, _, text = line.partition(": ")
            found[name] = text
        elif found:
            yield found
            found = {}


def test_fifty_clients_at_once(store):
    """Each gets the state of some time during its request, with any writes meanwhile; no thread is left."""
    asking, wrong = threading.Event(), []

    with kbstore.open(store, "kenny") as kb, running(store) as address:

        def ask(number):
            with httpx2.Client(base_url=address, timeout=60) as client:
                for _ in range(5):
                    low = kb.value("(f)")
                    found = client.get("/api/value", params={"expression": "(f)"}).json()["value"]
                    if not low <= found <= kb.value("(f)"):
                        wrong.append((low, found))
                    if number % 10 == 0 and client.get("/api/state").status_code != 200:
                        wrong.append("state")
                    asking.set()
            return True

        with ThreadPoolExecutor(CLIENTS) as clients:
            answers = [clients.submit(ask, number) for number in range(CLIENTS)]
            while not all(answer.done() for answer in answers):
                kb.add("(increase (f) 1)")
                asking.wait(0.01)
            assert all(answer.result() for answer in answers)
    assert wrong == []


def test_changes_are_streamed(store):
    """Q6: as events of a separate type, with the transaction's number as id, from which a client can continue."""
    with kbstore.open(store, "kenny") as kb, running(store) as address, httpx2.Client(base_url=address) as client:
        with client.stream("GET", "/api/changes/stream", params={"after": 1}) as answer:
            assert answer.headers["content-type"].startswith("text/event-stream")
            added = kb.add("(q)", client="somebody")
            event = next(events(answer.iter_lines()))
            change = json.loads(event["data"])
            assert (event["event"], event["id"]) == ("change", str(added.number))
            assert change["transaction"]["client"] == "somebody"
            assert [each["item"]["pddl"] for each in change["asserted"]] == ["(q)"]
        kb.add("(r)")
        kb.remove("(p)")
        headers = {"Last-Event-ID": event["id"]}
        with client.stream("GET", "/api/changes/stream", headers=headers, params={"after": 1}) as answer:
            found = events(answer.iter_lines())
            assert [int(next(found)["id"]) for _ in range(2)] == [added.number + 1, added.number + 2]
        with client.stream("GET", "/api/changes/stream", params={"after": 0, "pattern": "(p)"}) as answer:
            found = events(answer.iter_lines())
            assert [int(next(found)["id"]) for _ in range(2)] == [1, added.number + 2]


def test_an_invalid_stream_is_refused(store):
    """The answer is a problem, before the stream begins."""
    with running(store) as address:
        for parameters, status in (({"pattern": "(and (p) (q))"}, 422), ({"pattern": "(p"}, 400), ({"kb": "x"}, 404)):
            answer = httpx2.get(f"{address}api/changes/stream", params=parameters)
            assert (answer.status_code, answer.headers["content-type"]) == (status, "application/problem+json")


def test_the_end_of_the_server_ends_its_streams(store):
    """Clients do not have to disconnect first."""
    with httpx2.Client(timeout=20) as client:
        with running(store) as address:
            stream = client.stream("GET", f"{address}api/changes/stream")
            answer = stream.__enter__()
            assert answer.status_code == 200
        assert list(answer.iter_lines()) == []
        stream.__exit__(None, None, None)


def test_the_page_gets_patches(store):
    """The stream of the page: patches from its version to the latest, and the time."""
    with kbstore.open(store, "kenny") as kb, running(store) as address, httpx2.Client(base_url=address) as client:
        text = client.get("/").text
        data = json.loads(text.partition('<script id="data" type="application/json">')[2].partition("</script>")[0])
        assert data["latest"] == 1
        with client.stream("GET", f"/{data['stream']}") as answer:
            following = events(answer.iter_lines())
            assert next(following)["event"] == "now"  # the page is up to date, and gets new changes
            added = kb.add("(q)", note="new")
            found = next(event for event in following if event["event"] == "patch")
            patch = json.loads(found["data"])
            assert patch["latest"] == added.number
            length, [[index, transaction]] = patch["transactions"]
            assert (length, index, transaction[3]) == (2, 1, "new")
            assert patch["rows"][0] == len(data["rows"]) + 1
        with client.stream("GET", f"/{data['stream']}") as answer:
            # a page that is behind gets everything
            assert json.loads(next(events(answer.iter_lines()))["data"])["latest"] == added.number


@pytest.mark.parametrize("way", [signal.SIGINT, signal.SIGTERM])
def test_the_command_serves_until_it_is_stopped(tmp_path, way):
    """``kbstore serve`` prints its address, answers, and ends without output."""
    record(f"sqlite:///{tmp_path / 'k.db'}").close()
    command = [sys.executable, "-c", "from kbstore.cli import main; main()"]
    command += ["serve", "--url", "k.db", "--port", "0", "--now", "last"]
    environment = {name: value for name, value in os.environ.items() if not name.startswith("KBSTORE_")}
    with subprocess.Popen(command, cwd=tmp_path, env=environment, stderr=subprocess.PIPE, text=True) as process:
        line = process.stderr.readline()
        assert line.startswith("k.db is served at http://127.0.0.1:")
        address = line.split()[-1]
        found = httpx2.get(f"{address}api/state").json()
        assert found["at"] == "2026-05-04T09:09:10Z"
        process.send_signal(way)
        assert process.wait(30) in (0, -way, 128 + way)
        assert process.stderr.read() == ""


def test_a_port_that_is_taken_is_an_error(run_serve):
    """The error is one line, with what to do."""
    with socket.create_server(("127.0.0.1", 0)) as taken:
        done = run_serve("--port", str(taken.getsockname()[1]))
    assert done.returncode == 2
    (line,) = done.stderr.splitlines()
    assert line.startswith("kbstore: cannot listen at 127.0.0.1, port")


def test_a_missing_store_is_an_error(tmp_path):
    """At the start of the service, not at the first question; no store is created, even with writing allowed."""
    for writes in ([], ["--allow-writes"]):
        done = CliRunner().invoke(app, ["serve", "--url", str(tmp_path / "no.db"), *writes], prog_name="kbstore")
        assert (done.exit_code, "there is no store" in done.stderr) == (2, True)
    assert list(tmp_path.iterdir()) == []


def test_other_hosts_are_refused_without_a_token(run_serve):
    """The server does not start."""
    done = run_serve("--host", "0.0.0.0")
    assert (done.returncode, "KBSTORE_TOKEN" in done.stderr, len(done.stderr.splitlines())) == (2, True, 1)


@pytest.fixture
def run_serve(store):
    def run(*arguments):
        command = [
            sys.executable,
            "-c",
            "from kbstore.cli import main; main()",
            "serve",
            "--url",
            str(store),
            *arguments,
        ]
        environment = {name: value for name, value in os.environ.items() if not name.startswith("KBSTORE_")}
        return subprocess.run(
            [*command, *arguments], env=environment, capture_output=True, text=True, timeout=60, check=False
        )

    return run


@pytest.mark.parametrize("library", ["fastapi", "uvicorn"])
def test_a_missing_library_is_named(store, monkeypatch, library):
    """The error is one line that names the extra."""
    for name in [name for name in sys.modules if name.startswith(("kbstore.serve.", library))]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, library, None)
    done = CliRunner().invoke(app, ["serve", "--url", str(store)], prog_name="kbstore")
    assert done.exit_code == 2
    (line,) = done.stderr.splitlines()
    assert "pip install 'kbstore[web]'" in line
