"""SQLAlchemy engines for PostgreSQL: kbstore's own parameters of a URL, and a deadline for silent servers.

=====================  =========  ============================================================================
parameter              default    what
=====================  =========  ============================================================================
``pool_size``          15         the most connections of a process to the server
``answer_timeout``     30 s       how long a server may not answer before the connection is given up; the
                                  default follows `busy_timeout`, and is 5 s at least; ``none`` waits for ever
``schema``             none       the schema in which the tables are, as in ``kbstore.open(schema=...)``
``notifications``      false      whether answers about now are cached, as in ``kbstore.open(notifications=True)``
``prepare_threshold``  5          executions after which psycopg prepares a statement; ``none`` prepares nothing, which
                                  is the default behind a pooler
=====================  =========  ============================================================================

A server that is stopped, or behind a firewall that drops packets, never answers, and the network stack may wait for
hours. TCP keepalives and ``tcp_user_timeout`` find a host that is gone; a process that is stopped on a host that is
not is found only by a deadline that the client keeps itself.

Prepared statements belong to a session. A pooler that gives each transaction another session may run what another
client has prepared under the same name, which is another statement.
"""

import time
from collections.abc import Generator
from functools import cache
from typing import Any

from sqlalchemy import Connection, Engine, create_engine, event
from sqlalchemy.engine import URL
from sqlalchemy.pool import NullPool

from kbstore.errors import StoreUnavailable

_POOL_SIZE = 15
_LEAST_PATIENCE = 5.0
_POOLED = "kbstore_is_pooled"
"""The key of a connection's `info` under which the answer of `_is_pooled` is cached."""

_SESSION = "SELECT pg_backend_pid(), CAST(current_setting('extra_float_digits') AS int)"

_OWN = ("answer_timeout", "notifications", "pool_size", "prepare_threshold", "schema")


def server_engine(url: URL, busy_timeout: float) -> Engine:
    """Return an engine for a server; it pools nothing."""
    arguments: dict[str, Any] = {"connect_timeout": connect_timeout(busy_timeout), "client_encoding": "utf8"}
    patience = answer_timeout(url, busy_timeout)
    if patience is not None:
        seconds = max(1, int(patience))
        arguments |= {"keepalives_idle": seconds, "keepalives_interval": max(1, seconds // 3), "keepalives_count": 3}
        arguments["tcp_user_timeout"] = int(patience * 1000)
    arguments = {name: value for name, value in arguments.items() if name not in url.query}
    if "prepare_threshold" in url.query:
        arguments["prepare_threshold"] = _number(url, "prepare_threshold", 0)
    engine = create_engine(url.difference_update_query(_OWN), connect_args=arguments, poolclass=NullPool)

    @event.listens_for(engine, "do_connect")
    def connect(_dialect: Any, _record: Any, positional: Any, named: Any) -> Any:
        connection = _patient().connect(*positional, **named)
        connection.answer_timeout = patience
        try:
            refuse_bytes(connection, engine.url.render_as_string(hide_password=True))
            connection.autocommit = True
            if _is_pooled(connection) and "prepare_threshold" not in url.query:
                connection.prepare_threshold = None
            connection.autocommit = False
        except BaseException:
            connection.close()
            raise
        return connection

    return engine


def _is_pooled(driver: Any) -> bool:
    """Return whether a connection goes through a pooler: another session answers than the one that accepted it.

    Raises `StoreUnavailable` if the server rounds the numbers that it returns.
    """
    pid, digits = driver.execute(_SESSION, prepare=False).fetchone()
    if digits < 1:
        raise StoreUnavailable(
            f"the database {driver.info.dbname} has extra_float_digits = {digits}, with which numbers come back "
            f"rounded; set it to 1: ALTER DATABASE {driver.info.dbname} SET extra_float_digits = 1"
        )
    return bool(pid != driver.info.backend_pid)


def refuse_bytes(driver: Any, store: str) -> None:
    """Raise `StoreUnavailable` for a database without an encoding, or a connection whose encoding is not UTF-8."""
    if driver.info.parameter_status("server_encoding") == "SQL_ASCII":
        raise StoreUnavailable(
            f"{store} has the encoding SQL_ASCII, in which text comes back as bytes; create a database for kbstore "
            "with ENCODING 'UTF8' (and TEMPLATE template0)"
        )
    if driver.info.encoding != "utf-8":
        raise StoreUnavailable(
            f"{store}: the connection has the encoding {driver.info.encoding}, in which not every text can be written; "
            "connect with client_encoding=utf8"
        )


def connect_timeout(busy_timeout: float) -> int:
    """Return the seconds to wait for a connection, which the network stack would otherwise choose."""
    return max(2, int(busy_timeout))


def answer_timeout(url: URL, busy_timeout: float) -> float | None:
    """Return the seconds for which a server may be silent; None: without a limit."""
    if "answer_timeout" in url.query:
        return _number(url, "answer_timeout", 1)
    return max(_LEAST_PATIENCE, busy_timeout)


def pool_size(url: URL) -> int:
    """Return the most connections that a process has to a server."""
    return (_number(url, "pool_size", 1, or_none=False) if "pool_size" in url.query else None) or _POOL_SIZE


def wants_notifications(url: URL) -> bool:
    """Return whether a URL asks for notifications."""
    text = url.query.get("notifications", "false")
    if text not in ("true", "false"):
        raise StoreUnavailable(f"notifications={text} in the URL of a store: it is true or false")
    return text == "true"


def _number(url: URL, name: str, least: int, *, or_none: bool = True) -> int | None:
    """Return a number in a URL's query; None for ``none``. Raises `StoreUnavailable` for anything else."""
    text = url.query[name]
    if or_none and text == "none":
        return None
    if isinstance(text, str) and text.isdecimal() and int(text) >= least:
        return int(text)
    expected = f"a number from {least} on" + (", or none" if or_none else "")
    raise StoreUnavailable(f"{name}={text} in the URL of a store: it is {expected}")


def lend(connection: Connection, seconds: float | None) -> bool:
    """Make a connection of the caller's wait and prepare statements as kbstore's own do, until `take_back`.

    `seconds` is the deadline, None for none. Returns whether `take_back` has to be called; it has not if the connection
    was lent already. Raises `StoreUnavailable` if the server rounds numbers, and the driver's errors.
    """
    driver: Any = connection.connection.driver_connection

    def wait(gen: Any, *arguments: Any, **named: Any) -> Any:
        return type(driver).wait(driver, _watched(driver, gen), *arguments, **named)

    if hasattr(driver, "answer_timeout"):
        return False
    driver.answer_timeout, driver.wait, driver.lent_threshold = seconds, wait, driver.prepare_threshold
    try:
        if _POOLED not in connection.info:
            connection.info[_POOLED] = _is_pooled(driver)
    except BaseException:
        take_back(driver)
        raise
    if connection.info[_POOLED]:
        driver.prepare_threshold = None
    return True


def take_back(driver: Any) -> None:
    """Restore the settings that a caller's connection had before `lend`."""
    driver.prepare_threshold = driver.lent_threshold
    del driver.answer_timeout, driver.wait, driver.lent_threshold


def _watched(driver: Any, gen: Any) -> Generator[Any, Any, Any]:
    """Wrap one of psycopg's waits, to raise an `OperationalError` when nothing has come for `answer_timeout` seconds.

    Only silence counts, however long an answer takes to arrive: psycopg wakes the wait after each 0.1 s of silence.
    """
    patience = driver.answer_timeout
    if patience is None:
        return (yield from gen)
    try:
        waits_for = next(gen)
        deadline = 0.0
        while True:
            ready = yield waits_for
            if ready:
                deadline = 0.0
            elif not deadline:
                deadline = time.monotonic() + patience
            elif time.monotonic() > deadline:
                import psycopg

                driver.close()
                raise psycopg.OperationalError(f"the server has not answered for {patience:g} s")
            waits_for = gen.send(ready)
    except StopIteration as done:
        return done.value


@cache
def _patient() -> Any:
    """Return the class of psycopg connections that give up a silent server; made late, since psycopg is an extra."""
    import psycopg

    class PatientConnection(psycopg.Connection):
        """Closes itself after `answer_timeout` seconds without an answer of the server."""

        answer_timeout: float | None = None

        def wait(self, gen: Any, *arguments: Any, **named: Any) -> Any:
            return super().wait(gen if self.answer_timeout is None else _watched(self, gen), *arguments, **named)

    return PatientConnection
