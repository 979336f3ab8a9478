"""What processes that migrate do."""

import os
import signal

import sqlalchemy as sa

from kbstore.storage import schema


def upgrade(url, barrier=None):
    """Upgrade; with a barrier, when all are ready."""
    if barrier is not None:
        barrier.wait()
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
