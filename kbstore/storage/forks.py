"""Forks: a child process opens its own connections, and leaves its parent's alone.

Connections to SQLite must not even stay open. SQLite records per process which locks on a file it holds; a fork copies
this record, but not the locks. A connection opened next to an inherited one assumes that the process already holds its
locks; when the parent closes its own, it thinks it is the last user and deletes the log that the child writes to (see
section 2.6 of https://www.sqlite.org/howtocorrupt.html). So a child first of all closes the files that it inherits.

A connection can be closed only if no other thread of the parent was within SQLite at the fork: in the child that thread
does not exist any more, but the mutexes that it held are still locked. So a fork waits until other threads have left
SQLite: no time at all if none is in it, and `PATIENCE` at most. The parent does not wait for the child: to other
processes, the child's closing looks like that of any process that has the file open and idle.
"""

import os
import threading
import time
import weakref
from typing import Any, Protocol

from kbstore.errors import StoreUnavailable

PATIENCE = 1.0
"""Seconds that a fork waits for other threads to leave SQLite, before it goes on regardless."""


class ForkSafe(Protocol):
    """The connections to one database, with their handling in a fork."""

    def hold(self, deadline: float) -> bool:
        """Keep other threads out of SQLite, before a fork; return False if they don't leave it until a deadline."""

    def let_go(self) -> None:
        """Let other threads go on, in the parent, after a fork."""

    def forget_parent(self, *, is_quiet: bool) -> bool:
        """Leave the parent's connections, in the child; return False if inherited files could not be closed."""


inherited: list[Any] = []
"""In a forked child: the parent's connections, referred to here so that they are never collected and closed."""

_databases: "weakref.WeakSet[ForkSafe]" = weakref.WeakSet()
_one_at_a_time = threading.Lock()


class _Fork:
    """The outcome of the fork under way, or of the one that made this process."""

    is_quiet = True
    is_unsafe = False


def register(database: ForkSafe) -> None:
    """Register a database's connections, to be prepared when the process forks."""
    _databases.add(database)


def refuse_unsafe() -> None:
    """Raise `StoreUnavailable` in a process that was forked while another thread was within SQLite."""
    if _Fork.is_unsafe:
        raise StoreUnavailable(
            "this process was forked while its parent was within an SQLite store, so that none can be used safely "
            "here; fork when no other thread has a transaction open, or start processes by spawn or forkserver"
        )


def _before() -> None:
    _one_at_a_time.acquire()
    deadline = time.monotonic() + PATIENCE
    held = [database.hold(deadline) for database in list(_databases)]
    _Fork.is_quiet = all(held)


def _in_parent() -> None:
    for database in list(_databases):
        database.let_go()
    _one_at_a_time.release()


def _in_child() -> None:
    done = [database.forget_parent(is_quiet=_Fork.is_quiet) for database in list(_databases)]
    _Fork.is_unsafe = _Fork.is_unsafe or not all(done)
    _one_at_a_time.release()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(before=_before, after_in_parent=_in_parent, after_in_child=_in_child)
