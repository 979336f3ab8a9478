"""Forks: a child process opens its own connections, and leaves its parent's alone.

Of SQLite it must not even keep them: SQLite remembers the locks on a file per process, in memory that a fork copies
and locks that it does not. Beside an inherited connection, a new one takes it that the process has its locks
already; the parent, closing its own, believes to be the last, and deletes the log that the child writes to (see
section 2.6 of https://www.sqlite.org/howtocorrupt.html). So a child first of all closes the files that it inherits.
That is safe only while nobody is within SQLite: the fork waits for other threads to leave it, and the parent goes on
when the child is done.
"""

import os
import select
import threading
import time
import weakref
from typing import Protocol

from kbstore.errors import StoreUnavailable

PATIENCE = 1.0
"""Seconds that a fork waits for what other threads do in SQLite, before it goes on without."""

_HANDSHAKE = 5.0
"""Seconds that the parent waits for the child to have closed what it inherited."""


class Connections(Protocol):
    """The connections to one database, as a fork has to do with them."""

    def hold(self, deadline: float) -> bool:
        """Before a fork: keep other threads out of SQLite; False if they don't leave it until a deadline."""

    def let_go(self) -> None:
        """After a fork, in the parent: other threads may go on."""

    def forget_parent(self, *, is_quiet: bool) -> bool:
        """In the child: leave the parent's connections; False if files that the parent has open could not be closed."""


_databases: "weakref.WeakSet[Connections]" = weakref.WeakSet()
_one_at_a_time = threading.Lock()


class _Fork:
    """The fork under way, and what came of it in this process."""

    pipe: tuple[int, int] | None = None
    is_quiet = True
    is_unsafe = False


def register(database: Connections) -> None:
    """Take care of a database's connections when the process forks."""
    _databases.add(database)


def refuse_unsafe() -> None:
    """Raise in a process that was forked while another thread was within SQLite."""
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
    _Fork.pipe = os.pipe() if held else None


def _in_parent() -> None:
    if _Fork.pipe is not None:
        reading, writing = _Fork.pipe
        os.close(writing)
        waiting = select.poll()
        # what comes is the end of the pipe: the child has closed it, or there is none
        waiting.register(reading, select.POLLIN)
        waiting.poll(_HANDSHAKE * 1000)
        os.close(reading)
    for database in list(_databases):
        database.let_go()
    _one_at_a_time.release()


def _in_child() -> None:
    done = [database.forget_parent(is_quiet=_Fork.is_quiet) for database in list(_databases)]
    _Fork.is_unsafe = _Fork.is_unsafe or not all(done)
    if _Fork.pipe is not None:
        for end in _Fork.pipe:
            os.close(end)
    _one_at_a_time.release()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(before=_before, after_in_parent=_in_parent, after_in_child=_in_child)
