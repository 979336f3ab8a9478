"""Processes that tests start: forked from a server that has everything imported, so that they start at once."""

import multiprocessing
import time

_context = multiprocessing.get_context("forkserver")
# modules that kbstore and its libraries import at first use are listed, too: each process would import them itself
_context.set_forkserver_preload(
    [
        "kbstore.api",
        "kbstore.transfer.push",
        "alembic.command",
        "psycopg",
        "sqlalchemy.dialects.sqlite",
        "sqlalchemy.dialects.postgresql.psycopg",
        "tests.migration.processes",
        "tests.robustness.crashes",
        "tests.robustness.processes",
        "tests.transfer.processes",
    ]
)

TOO_LONG = 120
"""Seconds after which something hangs."""


def start(target, *arguments):
    """A started process."""
    process = _context.Process(target=target, args=arguments)
    process.start()
    return process


def finish(*processes):
    """Wait for processes, all of which have to succeed."""
    deadline = time.monotonic() + TOO_LONG
    for process in processes:
        process.join(max(0.0, deadline - time.monotonic()))
    codes = [process.exitcode for process in processes]
    for process in processes:
        process.kill()
    assert codes == [0] * len(processes)


def barrier(parties):
    """A barrier at which started processes wait for each other."""
    return _context.Barrier(parties, timeout=TOO_LONG)


def queue():
    """A queue for the answers of started processes; it has room for a few thousand short ones."""
    return _context.SimpleQueue()


def answers(source):
    """The answers so far."""
    found = []
    while not source.empty():
        found.append(source.get())
    return found
