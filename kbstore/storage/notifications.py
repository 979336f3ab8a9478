"""Notifications: a server notifies a process of each commit; until then, answers about now are cached.

LISTEN needs a session of its own on the server, so each pool has one more connection, with a thread that waits on it.
Writers notify only if somebody listens, as NOTIFY takes a lock of the whole database at the commit. A listener to a
knowledge base holds a shared advisory lock on it; a writer that gets this lock exclusively, for its transaction and
together with the head, need not notify. A listener trusts its cache only once it has the lock: by then every writer
that does not notify has committed. The lock is released with the connection.

A commit of this process clears the cache at once, a commit of another process when its notification arrives. Nobody
reports when a transaction of the caller's is committed: nothing is cached until its notification arrives. In case no
notification ever comes (a restore within the tables, a network that is cut), the cache is cleared every `HEARTBEAT`
seconds, and is not used when the server has not answered for `TRUST` seconds.
"""

import logging
import selectors
import socket
import threading
import time
from collections.abc import Callable
from contextlib import closing, suppress
from typing import Any

import sqlalchemy as sa

from kbstore.errors import StoreUnavailable, one_line
from kbstore.storage.caches import AnswerCache
from kbstore.storage.forks import inherited

LOG = logging.getLogger("kbstore")

HEARTBEAT = 5.0
"""The most seconds for which an answer is cached."""

TRUST = 2 * HEARTBEAT
"""Seconds for which notifications are relied on after the server's last answer."""

_LOCK = 0x6B62
"""The class of the listeners' advisory locks: "kb" in ASCII."""

_AGAIN = 0.05
"""Seconds until a lock that a writer holds is tried again."""

_PAUSE = 1.0
"""Seconds until a lost connection is replaced."""

ANNOUNCE = "SELECT CAST(pg_notify(%(channel)s, %(number)s) AS text)"
"""The statement that notifies of a transaction."""

_SESSION = "SELECT pg_backend_pid(), pg_is_in_recovery(), EXISTS (SELECT FROM pg_extension WHERE extname = 'citus')"

_guard = threading.Lock()
"""The lock on the subscriptions and their caches, in all pools of the process."""

_subscriptions: dict[int, tuple["Subscription", ...]] = {}
"""The subscriptions of the process, by knowledge base, whose numbers are random and so hardly ever equal."""


def hears_nobody(kb: Any) -> Any:
    """Return the SQL expression for whether there is no listener, nor will be until the transaction ends."""
    return sa.func.pg_try_advisory_xact_lock(sa.literal_column(str(_LOCK)), kb)


def channel(kb: int) -> str:
    """Return the name of a knowledge base's channel."""
    return f"kbstore_{kb}"


def committed(kb: int, number: int) -> None:
    """Clear the cached answers after a transaction of this process."""
    _for_each_subscription(kb, lambda subscription: subscription.arrived(number))


def expect(kb: int, number: int) -> None:
    """Cache nothing until the notification of the caller's transaction arrives."""
    _for_each_subscription(kb, lambda subscription: subscription.expect(number))


def _for_each_subscription(kb: int, what: Callable[["Subscription"], None]) -> None:
    if kb in _subscriptions:
        with _guard:
            for subscription in _subscriptions.get(kb, ()):
                what(subscription)


def refuse_shared(driver: Any, store: str) -> None:
    """Raise `StoreUnavailable` if a connection cannot listen: through a pooler, to a standby, to Citus."""
    # the process number of a pooler's client is invented, or that of its first session: hence two queries
    for _ in range(2):
        pid, is_standby, is_distributed = driver.execute(_SESSION).fetchone()
        if pid != driver.info.backend_pid:
            raise StoreUnavailable(
                f"{store}: notifications need a session of the server's own, and there is a pooler between; give the "
                "server's own address, or open without notifications"
            )
    if is_standby:
        raise StoreUnavailable(
            f"{store}: a standby has no notifications; open it without, or give the address of the primary"
        )
    if is_distributed:
        # locks and notifications are local to one machine
        raise StoreUnavailable(f"{store}: notifications do not go through Citus; open it without")


class Subscription:
    """The cached answers about now of one opened knowledge base, while they are known to be valid."""

    def __init__(self, listener: "Listener", kb: int) -> None:
        self._kb = kb
        self._listener = listener
        self._answers: AnswerCache | None = None
        self._awaited = self._latest = 0
        self._patient_until = 0.0

    def begin(self) -> None:
        """Listen from now on."""
        with _guard:
            _subscriptions[self._kb] = (*_subscriptions.get(self._kb, ()), self)
        self._listener.wake()

    def end(self) -> None:
        """Stop listening."""
        with _guard:
            left = tuple(other for other in _subscriptions.get(self._kb, ()) if other is not self)
            if left:
                _subscriptions[self._kb] = left
            else:
                _subscriptions.pop(self._kb, None)
        self._answers = None
        self._listener.wake()

    def answers(self) -> AnswerCache | None:
        """Return the cache of answers; None while nothing may be cached."""
        answers = self._answers
        if answers is not None and time.monotonic() < self._listener.trusted_until:
            return answers
        self._listener.ensure()
        return None

    def belongs_to(self, listener: "Listener") -> bool:
        """Return whether the subscription is a listener's."""
        return self._listener is listener

    def drop(self) -> None:
        """Clear the cache, and go on caching."""
        with _guard:
            self._latest = 0
            if self._answers is not None:
                self._answers = AnswerCache()

    # -- with `_guard` held ---------------------------------------------------------------------------------------

    def expect(self, number: int) -> None:
        """Cache nothing until a transaction arrives; or for `HEARTBEAT` seconds, as it may be rolled back."""
        self._awaited, self._answers = number, None
        self._patient_until = time.monotonic() + HEARTBEAT

    def arrived(self, number: int) -> None:
        """Clear the cache after a commit. A transaction of this process arrives twice, and counts once."""
        if number != self._latest and number >= self._awaited:
            self._latest, self._awaited = number, 0
            self._answers = AnswerCache() if self._listener.hears(self._kb) else None

    def renew(self) -> None:
        """Clear the cache, and cache from now on, unless a transaction is still waited for."""
        if not self._awaited or time.monotonic() >= self._patient_until:
            self._awaited = 0
            self._answers = AnswerCache()

    def forget(self) -> None:
        """Clear the cache, and cache nothing from now on."""
        self._answers = None


class Listener:
    """The connection of one pool that listens for all its subscriptions, and the thread that waits on it."""

    def __init__(self, store: str, connect: Callable[[], Any], errors: tuple[type[Exception], ...]) -> None:
        """`store` is its name in messages, `connect` opens a connection, `errors` are those of the driver."""
        self.trusted_until = 0.0
        self._store = store
        self._connect = connect
        self._errors: tuple[type[Exception], ...] = (*errors, StoreUnavailable)
        self._thread: threading.Thread | None = None
        self._waker: socket.socket | None = None
        self._driver: Any = None
        self._held: set[int] = set()
        """The knowledge bases whose lock is held."""

    def ensure(self) -> None:
        """Start the thread if it does not run, as after a fork."""
        if self._thread is None:
            with _guard:
                if self._thread is None and self._wanted():
                    self._waker, woken = socket.socketpair()
                    self._thread = threading.Thread(
                        target=self._run, args=(woken,), name="kbstore notifications", daemon=True
                    )
                    self._thread.start()

    def wake(self) -> None:
        """Have the thread look at the subscriptions; if there are none left, wait a moment for its end."""
        self.ensure()
        thread, waker = self._thread, self._waker
        if thread is None or waker is None:
            return
        with suppress(OSError):
            # the thread may have ended just now
            waker.send(b".")
        if not self._wanted():
            thread.join(_PAUSE)

    def forget_parent(self) -> None:
        """Leave the connection to the parent, in a forked child; the thread is started again when it is needed."""
        global _guard  # noqa: PLW0603 - a thread of the parent may have held it
        _guard = threading.Lock()
        inherited.append(self._driver)
        self._driver = self._thread = self._waker = None
        self._forget()

    def hears(self, kb: int) -> bool:
        """Return whether every writer of a knowledge base notifies this listener."""
        return kb in self._held

    def _wanted(self) -> set[int]:
        return {kb for kb, found in list(_subscriptions.items()) if any(each.belongs_to(self) for each in found)}

    def _each(self, kbs: set[int], what: Callable[[Subscription], None]) -> None:
        with _guard:
            for kb in kbs:
                for subscription in _subscriptions.get(kb, ()):
                    if subscription.belongs_to(self):
                        what(subscription)

    def _forget(self) -> None:
        self.trusted_until = 0.0
        self._held = set()
        self._each(self._wanted(), Subscription.forget)

    # -- the thread -----------------------------------------------------------------------------------------------

    def _run(self, woken: socket.socket) -> None:
        with woken:
            has_failed = False
            while True:
                with _guard:
                    if not self._wanted() and self._waker is not None:
                        self._waker.close()
                        self._waker = self._thread = None
                        return
                try:
                    with closing(self._connect()) as self._driver:
                        refuse_shared(self._driver, self._store)
                        has_failed = False
                        self._listen(self._driver, woken)
                except self._errors as error:
                    if not has_failed:
                        LOG.warning(
                            "%s: no notifications (%s); every question is asked of the server until they are back",
                            self._store,
                            one_line(str(error).strip()),
                        )
                    has_failed = True
                self._forget()
                if has_failed:
                    _wait(_PAUSE, woken)

    def _listen(self, driver: Any, woken: socket.socket) -> None:
        """Listen to all knowledge bases with subscriptions, until there are none."""
        held = self._held = set()
        # for notifications that arrive together with the answer to a statement
        driver.add_notify_handler(lambda found: self._arrived(found.channel, found.payload))
        next_beat = 0.0
        while wanted := self._wanted():
            for kb in held - wanted:
                held.remove(kb)
                driver.execute(f"UNLISTEN {channel(kb)}")
                driver.execute("SELECT pg_advisory_unlock_shared(%s, %s)", (_LOCK, kb))
            for kb in wanted - held:
                driver.execute(f"LISTEN {channel(kb)}")
                if driver.execute("SELECT pg_try_advisory_lock_shared(%s, %s)", (_LOCK, kb)).fetchone()[0]:
                    held.add(kb)
                    next_beat = 0.0
            now = time.monotonic()
            if now >= next_beat:
                driver.execute("SELECT 1")
                self._each(held, Subscription.renew)
                self.trusted_until = now + TRUST
                next_beat = now + HEARTBEAT
            patience = next_beat - now if held == wanted else _AGAIN
            if _wait(patience, woken, driver):
                next_beat = 0.0
            # never waits
            driver.pgconn.consume_input()
            while (found := driver.pgconn.notifies()) is not None:
                self._arrived(found.relname.decode(), found.extra.decode())

    def _arrived(self, name: str, payload: str) -> None:
        kb = name.rpartition("_")[2]
        # anybody may notify on the channel, with any text
        if kb.isdecimal() and payload.isdecimal():
            number = int(payload)
            self._each({int(kb)}, lambda subscription: subscription.arrived(number))


def _wait(seconds: float, woken: socket.socket, *others: Any) -> bool:
    """Wait until something can be read, or for some seconds; return whether the thread was woken."""
    # not `select.select`, which takes no file descriptors from 1024 on
    with selectors.DefaultSelector() as selector:
        for file in (woken, *others):
            selector.register(file, selectors.EVENT_READ)
        is_woken = any(key.fileobj is woken for key, _ in selector.select(seconds))
    if is_woken:
        woken.recv(4096)
    return is_woken
