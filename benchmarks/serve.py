"""``python -m benchmarks.serve``: what `holds` takes by HTTP under many clients, beside a handler that does nothing.

Both are asked of one server in the same run, in turns, by as many clients at once; each asks again as soon as it is
answered. The server is a process of its own, the clients are the tasks of this one.
"""

import argparse
import asyncio
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import kbstore
from kbstore.serve.server import Server, listen
from kbstore.serve.store import Store
from kbstore.serve.web import make_app

QUESTION = "/api/holds?condition=%28robot_at%20kenny%20hall%29"
EMPTY = "/empty"


def main() -> None:
    """Measure, and print a table."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.serve", description=__doc__)
    parser.add_argument("--clients", type=int, default=50, help="how many ask at once (50)")
    parser.add_argument("--rounds", type=int, default=10, help="how often each of the two is asked in turn (10)")
    parser.add_argument("--requests", type=int, default=40, help="how many requests of a client in a round (40)")
    parser.add_argument("--serve", metavar="FILE", help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.serve:
        _serve(arguments.serve)
        return
    with tempfile.TemporaryDirectory(prefix="kbstore-bench-") as directory:
        store = Path(directory) / "serve.db"
        with kbstore.open(store, "kenny") as kb:
            kb.add("(robot_at kenny hall)", "(= (battery kenny) 80)")
        command = [sys.executable, "-m", "benchmarks.serve", "--serve", str(store)]
        with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as server:
            assert server.stdout is not None
            port = int(server.stdout.readline())
            try:
                _report(asyncio.run(_measure(port, arguments)))
            finally:
                server.terminate()


def _serve(store: str) -> None:
    app = make_app(Store(store))

    @app.get(EMPTY)
    async def empty() -> dict[str, bool]:
        return {}

    socket = listen("127.0.0.1", 0)
    Server(app, ready=lambda _: print(socket.getsockname()[1], flush=True)).run([socket])


async def _measure(port: int, arguments: argparse.Namespace) -> dict[str, list[float]]:
    """The seconds of each request, by what was asked; the first round is not counted."""
    found: dict[str, list[float]] = {EMPTY: [], QUESTION: []}
    for number in range(arguments.rounds + 1):
        for path, taken in found.items():
            clients = [_ask(port, path, arguments.requests) for _ in range(arguments.clients)]
            asked = [each for client in await asyncio.gather(*clients) for each in client]
            if number:
                taken.extend(asked)
    return found


async def _ask(port: int, path: str, count: int) -> list[float]:
    """One client, on one connection: the seconds of each of its requests."""
    reader, writer = await asyncio.open_connection("127.0.0.1", port)
    request = f"GET {path} HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n".encode()
    found = []
    for _ in range(count):
        begin = time.perf_counter()
        writer.write(request)
        head = await reader.readuntil(b"\r\n\r\n")
        assert head.startswith(b"HTTP/1.1 200"), head
        length = next(line for line in head.lower().split(b"\r\n") if line.startswith(b"content-length:"))
        await reader.readexactly(int(length.partition(b":")[2]))
        found.append(time.perf_counter() - begin)
    writer.close()
    await writer.wait_closed()
    return found


def _report(found: dict[str, list[float]]) -> None:
    print(f"{'':12}{'requests':>10}{'p50 ms':>10}{'p99 ms':>10}")
    ends = {}
    for path, taken in found.items():
        quantiles = statistics.quantiles(taken, n=100)
        ends[path] = quantiles[98]
        name = "holds" if path == QUESTION else "empty"
        print(f"{name:12}{len(taken):>10}{1000 * quantiles[49]:>10.2f}{1000 * quantiles[98]:>10.2f}")
    print(f"p99 of holds is {ends[QUESTION] / ends[EMPTY]:.2f} times that of the empty handler")


if __name__ == "__main__":
    main()
