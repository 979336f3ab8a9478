"""Opens a knowledge base in a store, and continues it in another."""

import os
from typing import TYPE_CHECKING

from sqlalchemy import Engine
from sqlalchemy.engine import URL

from kbstore.clock import Clock, DurationLike, duration
from kbstore.knowledge_base import KnowledgeBase
from kbstore.names import check_knowledge_base
from kbstore.reading.resolver import MAX_STEP, TOLERANCE
from kbstore.storage import directory
from kbstore.storage.database import Database
from kbstore.storage.engine import BUSY_TIMEOUT

if TYPE_CHECKING:
    from kbstore.transfer.push import Pushed
    from kbstore.transfer.rows import Progress


def open(
    url: str | os.PathLike[str] | URL | Engine,
    name: str = "default",
    *,
    clock: Clock | None = None,
    use_unknowns: bool | None = None,
    durability: str = "full",
    validate: bool = True,
    read_only: bool = False,
    cache: bool = True,
    tolerance: DurationLike = TOLERANCE,
    max_step: DurationLike = MAX_STEP,
    busy_timeout: float = BUSY_TIMEOUT,
    schema: str | None = None,
    notifications: bool = False,
) -> KnowledgeBase:
    """Open a knowledge base, and create it if there is none of that name.

    Args:
        url: a SQLAlchemy URL, the path of an SQLite file, or an `Engine` of the caller's.
        name: the knowledge base: one robot, or one run of a simulation.
        clock: the time source; the wall clock if None.
        use_unknowns: whether absent reads as unknown (open world); stored when the knowledge base is created. None: as
            stored, and a closed world for a new knowledge base.
        durability: "full": every acknowledged transaction survives a loss of power; "normal": the last may be lost.
        validate: whether what is added must fit the domain.
        read_only: whether writing is refused.
        cache: whether answers are cached: those about now until something changes (on PostgreSQL only with
            `notifications`), and past states.
        tolerance: how far the clock may be behind the latest recorded time (a duration; rule T3).
        max_step: how far the system clock may get ahead of the time that the machine measures between two transactions,
            before `ClockJumped` is raised (a duration; rule T6).
        busy_timeout: seconds to wait for a lock that others hold, before `StoreUnavailable` is raised.
        schema: the schema of a PostgreSQL database in which the tables are; made if there is none. None: where the
            search path of the connection finds them.
        notifications: whether answers about now are cached until a PostgreSQL server notifies this process of a commit.
            A cached answer includes all commits of this process, and all others whose notification has arrived. Needs
            one more connection, directly to the server; SQLite does not need the setting.

    Raises:
        SchemaOutOfDate, SchemaTooNew, SchemaUnknown: the database's schema is not this kbstore's.
        StoreUnavailable: the database cannot be reached.
        InvalidKnowledge: it was created with another `use_unknowns`, or `name` is not acceptable.
    """
    check_knowledge_base(name)
    database = Database(
        url,
        durability=durability,
        read_only=read_only,
        busy_timeout=busy_timeout,
        schema=schema,
        notifications=notifications,
    )
    try:
        database.ensure_schema(read_only=read_only)
        return KnowledgeBase(
            database,
            name,
            clock=clock,
            use_unknowns=use_unknowns,
            validate=validate,
            read_only=read_only,
            cache=cache,
            tolerance=duration(tolerance),
            max_step=duration(max_step),
        )
    except BaseException:
        database.close()
        raise


def knowledge_bases(url: str | os.PathLike[str] | URL | Engine, *, schema: str | None = None) -> list[str]:
    """Return the names of the knowledge bases in a store; `url`, `schema` and errors are those of `open`."""
    database = Database(url, read_only=True, schema=schema)
    try:
        database.ensure_schema(read_only=True)
        with database.read() as connection:
            return directory.names(connection)
    finally:
        database.close()


def push(
    kb: KnowledgeBase,
    url: str | os.PathLike[str] | URL | Engine,
    name: str | None = None,
    *,
    follow: bool = False,
    progress: "Progress | None" = None,
) -> "Pushed":
    """Continue a knowledge base in another store, on either engine: everything that was recorded, exactly once.

    The copy has the same transactions with the same numbers, domains, schedules and runs. From the first push on
    nothing else may write to it. A push that is interrupted at any moment is continued by the next one; several robots
    may push to one server at once, and writers go on meanwhile.

    Args:
        kb: the source, open for reading or writing.
        url: the store to push to; an empty database is set up.
        name: the name of the knowledge base there; None: its own.
        follow: whether to go on as transactions are recorded, until `kb.close()` in another thread. A target that
            cannot be reached any more is tried again and again, with a warning in the log.
        progress: called repeatedly with the number of the last transaction that the copy has, and of the latest.

    Returns:
        The last transaction that the copy has, and how much was pushed.

    Raises:
        StoreUnavailable: the other store cannot be reached.
        Conflict: the other store has a knowledge base of that name that was written to by others.
        StoreWentBack: transactions that had been pushed are gone from this store.
        HistoryUnavailable: transactions that the copy lacks have been archived here.
        InvalidKnowledge: the copy was created with another `use_unknowns`, or one of the two is an archive.
    """
    from kbstore.transfer.push import pushing

    with pushing(kb._reader, url, name, progress) as push:
        if not follow:
            return push.catch_up()
        kb._watches.add(push)
        return push.follow()
