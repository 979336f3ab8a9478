"""One connection to a store: statements, transactions, and the driver's errors raised as `StoreUnavailable`.

Statements run on the driver's own cursor: a look-up takes 2.6 us there, 44 us as SQLAlchemy's `exec_driver_sql` and
73 us as a cached `select`, and a question about one fact is one look-up. Opening and migrations run through
SQLAlchemy; so do all statements on an engine that has listeners or logging for them
(`kbstore.storage.statement_events`).
"""

import logging
import threading
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager
from typing import Any, NamedTuple

from kbstore.errors import StoreUnavailable
from kbstore.storage.caches import AnswerCache
from kbstore.storage.driver_errors import unavailable
from kbstore.storage.forks import inherited
from kbstore.storage.notifications import Subscription
from kbstore.storage.statements import Lookup, Statement

SqlRow = tuple[Any, ...]
Parameters = Mapping[str, Any]

LOG = logging.getLogger("kbstore")

LONG_WAIT = 1.0
"""Seconds of waiting for a lock after which a warning is logged."""


class Options(NamedTuple):
    """Settings of the connections of a `Database`.

    Attributes:
        store: the store's name in messages.
        busy_timeout: seconds to wait for a lock, or for a connection.
        durability: "full" or "normal".
        read_only: whether nothing may be written.
        schema: the PostgreSQL schema of the tables; None: the search path decides.
        subscription: the answers that are cached while a server sends notifications, if it was asked to.
    """

    store: str
    busy_timeout: float
    durability: str
    read_only: bool
    schema: str | None = None
    subscription: Subscription | None = None


class StoreConnection(ABC):
    """A connection, used by one thread at a time.

    =========  ==============  =======  ================================================================
    state      in_transaction  is_lost  a statement
    =========  ==============  =======  ================================================================
    idle       no              no       sees the latest commit
    begun      yes             no       belongs to the transaction, until `commit` or `rollback`
    aborted    yes             no       is refused: the database has rolled back by itself; `rollback`
    lost       either          yes      is refused; the connection is dropped when it is checked in
    =========  ==============  =======  ================================================================

    Attributes:
        driver: the DBAPI connection, in autocommit.
        handle: SQLAlchemy's object for it, by which it is returned to its pool.
        lock: held by the thread that uses it.
        uses: how many uses of that thread are nested.
        in_transaction, is_lost: see above.
    """

    is_local: bool
    """Whether there is no server that could have gone away."""

    file: tuple[int, int] | None = None
    """The file that it has open, by device and inode; None for a server and in memory."""

    def __init__(self, driver: Any, options: Options, error: type[Exception], text: Callable[[Statement], str]) -> None:
        """`error` is the root of the driver's errors, `text` gives a statement's SQL."""
        self.driver = driver
        self.options = options
        self.lock = threading.RLock()
        self.handle: Any = None
        self.uses = 0
        self.is_lost = False
        self.in_transaction = False
        self._has_written = False
        self._error = error
        self._text = text
        self._executing: Any = driver
        self._execute = driver.execute
        self._cursor = driver.cursor

    def execute_on(self, executing: Any) -> None:
        """Execute statements on another object with the methods of the driver's connection."""
        self._executing = executing
        self._execute, self._cursor = executing.execute, executing.cursor

    # -- statements -------------------------------------------------------------------------------------------

    def all(self, statement: Statement, parameters: Parameters) -> list[SqlRow]:
        """Return all rows of a statement. Raises `StoreUnavailable`, as all methods do that execute statements."""
        try:
            rows: list[SqlRow] = self._execute(self._text(statement), parameters).fetchall()
        except self._error as error:
            raise self._failure(error) from error
        return rows

    def first(self, statement: Statement, parameters: Parameters) -> SqlRow | None:
        """Return the first row of a statement; None if there is none."""
        try:
            row: SqlRow | None = self._execute(self._text(statement), parameters).fetchone()
        except self._error as error:
            raise self._failure(error) from error
        return row

    def all_at_first(self, reads: Sequence[tuple[Statement, Parameters]]) -> list[list[SqlRow]]:
        """Return all rows of some statements, in one trip to a server.

        A single one may run before its reading transaction begins, on the latest commit.
        """
        return [self.all(statement, parameters) for statement, parameters in reads]

    def lock_head(self, statement: Statement, parameters: Parameters) -> SqlRow | None:
        """Return the head's row, locked; it may have to wait for other writers, and logs a long wait."""
        started = time.monotonic()
        row = self.first(statement, parameters)
        self._log_wait(started)
        return row

    @abstractmethod
    def memory(self, kb: int) -> AnswerCache | None:
        """Return the cached answers about a knowledge base, which are valid now.

        None within a transaction, and if commits of other connections would not be noticed.
        """

    @abstractmethod
    def announce(self, kb: int, number: int) -> None:
        """Notify the listeners of a knowledge base of a transaction; called before it is committed."""

    @abstractmethod
    def look_up(self, statement: Lookup, *parameters: int) -> SqlRow | None:
        """Return the first row of a look-up; None if there is none."""

    @abstractmethod
    def stream(self, statement: Statement, parameters: Parameters) -> Iterator[SqlRow]:
        """Yield the rows of a statement without holding all of them in memory; within a transaction."""

    def run(self, statement: Statement, parameters: Parameters) -> int:
        """Run a statement that returns no rows, and return the number of rows that it changed."""
        self._refuse_read_only()
        try:
            return int(self._execute(self._text(statement), parameters).rowcount)
        except self._error as error:
            raise self._failure(error) from error

    def many(self, statement: Statement, rows: Sequence[Parameters | Sequence[Any]]) -> None:
        """Run a statement once for each set of parameters."""
        if rows:
            self._refuse_read_only()
            try:
                if len(rows) == 1:
                    self._execute(self._text(statement), rows[0])
                else:
                    self._cursor().executemany(self._text(statement), rows)
            except self._error as error:
                raise self._failure(error) from error

    def _refuse_read_only(self) -> None:
        """Raise `StoreUnavailable` if nothing may be written: the database itself refuses only within a transaction."""
        if self.options.read_only:
            raise StoreUnavailable(f"{self.options.store} was opened with read_only=True; open it without to write")
        self._has_written = True

    @abstractmethod
    def together(self) -> AbstractContextManager[None]:
        """Send the block's statements, which return nothing, to a server together; raise their errors at the end."""

    @abstractmethod
    def array(self, values: Sequence[Any]) -> Any:
        """Return an array parameter for a statement with `each` or `among`."""

    @abstractmethod
    def bounds(self, values: Sequence[int | None]) -> str:
        """Return an array parameter of numbers as text, to be made once and used by many statements."""

    # -- transactions -----------------------------------------------------------------------------------------

    def begin(self, *, write: bool) -> None:
        """Begin a transaction: for writing, or on one snapshot of the store."""
        text, how = self._beginning(write=write)
        started = time.monotonic()
        try:
            self._execute(text, **how)
            self._has_written = False
            self.in_transaction = True
            if write:
                self._log_wait(started)
        except self._error as error:
            raise self._failure(error) from error
        except BaseException:
            # an interrupt takes effect after the wait for a lock, when the transaction has begun
            self.rollback()
            raise

    @abstractmethod
    def _beginning(self, *, write: bool) -> tuple[str, dict[str, Any]]:
        """Return the statement that begins a transaction, and the driver's options for executing it."""

    def _log_wait(self, started: float) -> None:
        waited = time.monotonic() - started
        if waited > LONG_WAIT:
            LOG.warning("%s: waited %.1f s for a lock that another writer held", self.options.store, waited)

    def commit(self) -> None:
        """Commit the transaction."""
        self._committing()
        try:
            self._execute("COMMIT")
        except self._error as error:
            failure = self._failure(error)
            if self.is_lost and not self.is_local:
                raise StoreUnavailable(
                    f"{failure}; whether the transaction was stored is not known: see what the latest one is"
                ) from error
            raise failure from error
        self._committed()

    @abstractmethod
    def _committing(self) -> None:
        """Do before a commit what must not be missed if an interrupt comes right after it."""

    def _committed(self) -> None:
        self.in_transaction = False

    def rollback(self) -> None:
        """Roll the transaction back; a connection that is lost has done so already."""
        if not self.is_lost:
            self._execute, self._cursor = self._executing.execute, self._executing.cursor
            try:
                if self._must_roll_back():
                    self._execute("ROLLBACK")
            except self._error:
                # for any reason: a dropped connection has no transaction any more
                self.is_lost = True
        self.in_transaction = False

    def _must_roll_back(self) -> bool:
        """Return whether the database still has the transaction."""
        return True

    @property
    def has_unsettled(self) -> bool:
        """Whether a transaction is under way that has written something."""
        return self.in_transaction and self._has_written

    # -- errors -----------------------------------------------------------------------------------------------

    def _failure(self, error: Exception) -> StoreUnavailable:
        """Return the error to raise for one of the driver; refuse further statements if the transaction has ended."""
        failure = unavailable(error, self.options.store, self.options.busy_timeout)
        self._note(error)
        if self.is_lost:
            self.refuse(str(failure))
        elif self.in_transaction and self._has_rolled_back():
            self.refuse(f"{failure}; the transaction was rolled back")
        return failure

    @abstractmethod
    def _note(self, error: Exception) -> None:
        """Set `is_lost` if the connection is of no use after an error."""

    def _has_rolled_back(self) -> bool:
        """Return whether the database has ended the transaction by itself."""
        return False

    def refuse(self, why: str) -> None:
        """Refuse every statement from here on, so that none takes effect on its own."""

        def refuse(*_: object, **__: object) -> Any:
            raise StoreUnavailable(why)

        self._execute = self._cursor = refuse

    # -- the connection ---------------------------------------------------------------------------------------

    def settle(self) -> None:
        """Roll back a transaction that an interrupt has left open; called at the end of the last use."""
        if self.in_transaction:
            self.rollback()

    def is_alive(self) -> bool:
        """Return whether the connection can be used, as far as is known without waiting."""
        return not self.is_lost

    @abstractmethod
    def be_patient(self) -> None:
        """Wait for the answers of this use without a deadline: for maintenance."""

    @abstractmethod
    def database(self) -> object:
        """Return a value that is equal for connections to the same database only."""

    def abandon(self, *, close: bool) -> None:
        """Leave the connection to the parent, in a forked child; with `close`, close its file in this process.

        A file may be closed only if no thread was within SQLite at the fork.
        """
        self.is_lost = True
        self.refuse("this process was forked with this transaction open, which stays with the parent; begin another")
        if close:
            self.driver.close()
        else:
            inherited.append(self.driver)
