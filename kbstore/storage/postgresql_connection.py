"""A connection to a PostgreSQL server, with settings for each transaction, so that it may go through a pooler.

Nothing is set for the session: behind a pooler in transaction mode the next transaction runs in another session, and
settings of this one would reach other clients. For the same reason the tables of a store with a schema of its own are
qualified with it, instead of setting a search path.
"""

import json
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from operator import attrgetter
from typing import Any

from kbstore.storage.caches import AnswerCache
from kbstore.storage.connection import Options, Parameters, SqlRow, StoreConnection
from kbstore.storage.notifications import ANNOUNCE, channel, committed, expect
from kbstore.storage.statements import Lookup, Statement

_ROWS = 2000
"""The number of rows of a stream that are fetched at once."""


_DATABASE = "SELECT oid, pg_postmaster_start_time() FROM pg_database WHERE datname = current_database()"

_READING = "BEGIN ISOLATION LEVEL REPEATABLE READ READ ONLY"

_WAITING = (
    "SELECT set_config('synchronous_commit', 'on', true) WHERE current_setting('synchronous_commit') <> 'remote_apply'"
)
"""Waits at the commit for the disk and a synchronous standby; leaves the stricter `remote_apply` as it is."""

_plain = attrgetter("postgresql")


def is_connected(driver: Any, error: type[Exception]) -> bool:
    """Return whether a connection can be used: whether no notice of its end has arrived by now."""
    try:
        # never waits; once for data of the server, and once more for the end of the connection
        driver.pgconn.consume_input()
        driver.pgconn.consume_input()
    except error:
        return False
    return True


def _gets_bytes(driver: Any) -> bool:
    """Return whether answers can come in binary format, to which psycopg's client-side cursors have no access."""
    from psycopg import ClientCursor

    return not issubclass(driver.cursor_factory, ClientCursor)


class PostgresqlConnection(StoreConnection):
    """A connection to a PostgreSQL server."""

    is_local = False

    def __init__(
        self, driver: Any, options: Options, error: type[Exception], *, borrowed: bool = False, lent: bool = False
    ) -> None:
        """`error` is the root of the driver's errors; `borrowed` says that the caller ends the transaction.

        `lent` says that the driver is to be taken back (`kbstore.storage.server_engine.lend`).
        """
        super().__init__(driver, options, error, _plain)
        self.lent = lent
        self._borrowed = borrowed
        self._is_waiting = False
        """Whether the transaction is to be begun together with the next statement."""
        self._announced: list[tuple[int, int]] = []
        """The transactions that are to be committed, by knowledge base and number."""
        self._unheard: set[int] = set()
        """The knowledge bases to which nobody listens, or will until this transaction ends."""
        self._patience: float | None = getattr(driver, "answer_timeout", None)
        self._is_binary = _gets_bytes(driver)
        self.lend(options)

    def lend(self, options: Options) -> None:
        """Serve a `Database` from here on."""
        self.options = options
        self._wait(self._patience)
        schema = options.schema
        self._text = _plain if schema is None else lambda statement: statement.in_schema(schema)

    def _wait(self, seconds: float | None) -> None:
        """Set how many seconds the server may be silent; without effect in a transaction of the caller's."""
        if self._patience is not None:
            self.driver.answer_timeout = seconds

    def be_patient(self) -> None:
        """Wait for the answers of this use without a deadline: for maintenance."""
        self._wait(None)

    def memory(self, kb: int) -> AnswerCache | None:
        """Return the cached answers while notifications arrive; None otherwise, and within a transaction."""
        subscription = self.options.subscription
        return None if subscription is None or self.in_transaction else subscription.answers()

    def announce(self, kb: int, number: int) -> None:
        """Notify the listeners of a knowledge base of a transaction, unless there are none, with its commit."""
        if self._borrowed:
            expect(kb, number)
        else:
            self._announced.append((kb, number))
        if kb not in self._unheard:
            try:
                self._execute(ANNOUNCE, {"channel": channel(kb), "number": str(number)})
            except self._error as error:
                raise self._failure(error) from error

    def lock_head(self, statement: Statement, parameters: Parameters) -> SqlRow | None:
        """Return the head's row, locked; its last column, whether there is no listener, is removed."""
        row = super().lock_head(statement, parameters)
        if row is None:
            return None
        if row[-1]:
            self._unheard.add(parameters["kb"])
        return row[:-1]

    def look_up(self, statement: Lookup, *parameters: int) -> SqlRow | None:
        """Return the first row of a look-up; None if there is none."""
        return self.first(statement, dict(zip(statement.names, parameters, strict=True)))

    def stream(self, statement: Statement, parameters: Parameters) -> Iterator[SqlRow]:
        """Yield the rows of a statement from a server-side cursor; within a transaction."""
        try:
            with self._cursor(name="kbstore_rows") as cursor:
                cursor.itersize = _ROWS
                yield from cursor.execute(self._text(statement), parameters)
        except self._error as error:
            raise self._failure(error) from error

    @contextmanager
    def together(self) -> Iterator[None]:
        """Send the block's statements, which return nothing, together; raise their errors at the end.

        COMMIT is not among them: after the last answer psycopg may send a Flush, with which a pooler begins the next
        transaction, and waits for its end.
        """
        try:
            with self.driver.pipeline():
                yield
        except self._error as error:
            raise self._failure(error) from error

    def array(self, values: Sequence[Any]) -> list[Any]:
        """Return an array parameter."""
        return list(values)

    def bounds(self, values: Sequence[int | None]) -> str:
        """Return an array parameter of numbers as text, to be made once and used by many statements."""
        return json.dumps(values).replace("[", "{").replace("]", "}")

    def database(self) -> object:
        """Return the database's number on the server, and the time at which the server was started."""
        try:
            return self._execute(_DATABASE).fetchone()
        except self._error as error:
            raise self._failure(error) from error

    def begin(self, *, write: bool) -> None:
        """Begin a transaction: for writing, or on one snapshot of the store.

        A transaction for reading is begun with its first statement, in one trip to the server.
        """
        if write or self._executing is not self.driver:
            super().begin(write=write)
            return
        self._has_written = False
        self.in_transaction = True
        self._is_waiting = True
        self._execute, self._cursor = self._begin_and_execute, self._begin_and_cursor

    def _begin_and_execute(self, text: str, parameters: Parameters) -> Any:
        self._has_begun()
        with self.driver.pipeline():
            self._execute(_READING)
            return self._execute(text, parameters)

    def _begin_and_cursor(self, name: str) -> Any:
        self._has_begun()
        self._execute(_READING)
        return self._cursor(name=name)

    def _has_begun(self) -> None:
        self._is_waiting = False
        self._execute, self._cursor = self.driver.execute, self.driver.cursor

    def _committing(self) -> None:
        """Do nothing: notifications are sent by the server, at the commit."""

    def _committed(self) -> None:
        super()._committed()
        for kb, number in self._announced:
            committed(kb, number)
        self._forget_transaction()

    def _forget_transaction(self) -> None:
        self._announced.clear()
        self._unheard.clear()

    def rollback(self) -> None:
        """Roll the transaction back; a connection that is lost has done so already."""
        self._forget_transaction()
        super().rollback()

    def _must_roll_back(self) -> bool:
        """Return whether the transaction has begun on the server."""
        was_waiting, self._is_waiting = self._is_waiting, False
        return not was_waiting

    def all_at_first(self, reads: Sequence[tuple[Statement, Parameters]]) -> list[list[SqlRow]]:
        """Return all rows of some statements, in one trip to the server.

        If the reading transaction has not begun, a single one does not begin it, and reads the latest commit.
        """
        if self._executing is not self.driver:
            return super().all_at_first(reads)
        texts = [(self._text(statement), parameters) for statement, parameters in reads]
        try:
            if len(texts) == 1 and self._is_waiting:
                return [self.driver.execute(*texts[0], binary=self._is_binary).fetchall()]
            with self.driver.pipeline():
                if self._is_waiting:
                    self._has_begun()
                    self._execute(_READING)
                answers = [self._execute(text, parameters, binary=self._is_binary) for text, parameters in texts]
            return [answer.fetchall() for answer in answers]
        except self._error as error:
            raise self._failure(error) from error

    def _beginning(self, *, write: bool) -> tuple[str, dict[str, Any]]:
        """Return the statement that begins a transaction, with the transaction's settings in the same message.

        A server that may not be written to (a standby, `default_transaction_read_only`) refuses the writes itself.
        """
        if not write:
            return _READING, {}
        if self.options.read_only:
            return "BEGIN ISOLATION LEVEL READ COMMITTED READ ONLY", {}
        # 0 would be for ever
        patience = max(1, int(self.options.busy_timeout * 1000))
        if self._patience is not None:
            # a wait for a lock is silent, too
            self._wait(self._patience + self.options.busy_timeout)
        waits = _WAITING if self.options.durability == "full" else "SET LOCAL synchronous_commit = off"
        text = f"BEGIN ISOLATION LEVEL READ COMMITTED; SET LOCAL lock_timeout = {patience}; {waits}"
        # several commands cannot be prepared
        return text, {"prepare": False}

    def _note(self, error: Exception) -> None:
        del error
        self.is_lost = self.is_lost or bool(self.driver.closed)

    def settle(self) -> None:
        """Roll back a transaction that an interrupt has left open; drop the connection if an answer is still to come.

        It would be taken for that of the next statement.
        """
        super().settle()
        protocol = self.driver.pgconn
        # both are 0 on a connection that is idle
        self.is_lost = self.is_lost or bool(protocol.transaction_status or protocol.pipeline_status)

    def is_alive(self) -> bool:
        """Return whether the connection can be used, as far as is known without waiting."""
        self.is_lost = self.is_lost or not is_connected(self.driver, self._error)
        return not self.is_lost
