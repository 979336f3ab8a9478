"""Processes that migrate: forked from a server that has everything imported, so that they start in milliseconds."""

import multiprocessing
import os
import signal

import sqlalchemy as sa

from kbstore.storage import schema

_context = multiprocessing.get_context("forkserver")
_context.set_forkserver_preload(["tests.migration.processes", "alembic.command", "psycopg"])


def upgrade(url, barrier=None):
    """Upgrade; with a barrier, when all are ready."""
    if barrier is not None:
        barrier.wait(60)
    schema.upgrade(url, backup=False)


def upgrade_killed_at(url, statement):
    """Upgrade, and be killed (as by kill -9) when the given statement, counted from 1, is about to be sent."""
    sent = 0

    def count(*_):
        nonlocal sent
        sent += 1
        if sent == statement:
            os.kill(os.getpid(), signal.SIGKILL)

    sa.event.listen(sa.Engine, "before_cursor_execute", count)
    schema.upgrade(url, backup=False)


def start(target, *arguments):
    """A started process."""
    process = _context.Process(target=target, args=arguments)
    process.start()
    return process


def barrier(parties):
    """A barrier for started processes."""
    return _context.Barrier(parties)
