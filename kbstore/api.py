"""Opening a knowledge base in a store."""

import os

from sqlalchemy import Engine
from sqlalchemy.engine import URL

from kbstore.clock import Clock, DurationLike, duration
from kbstore.errors import InvalidKnowledge
from kbstore.knowledge_base import KnowledgeBase
from kbstore.reading.resolver import MAX_STEP, TOLERANCE
from kbstore.storage import directory
from kbstore.storage import schema as schemas
from kbstore.storage.database import Database
from kbstore.storage.engine import BUSY_TIMEOUT


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
) -> KnowledgeBase:
    """Open a knowledge base, and create it if there is none of that name.

    Args:
        url: a SQLAlchemy URL, the path of an SQLite file, or an `Engine` of the caller's.
        name: which world in the store: one robot, or one run.
        clock: the time source; the wall clock if None.
        use_unknowns: whether absent reads as unknown (open world); set at creation and stored. None: as stored, and
            a closed world for a new knowledge base.
        durability: "full" keeps every acknowledged transaction through a loss of power; "normal" may lose the last.
        validate: whether what is added must fit the domain.
        read_only: whether writing is refused.
        cache: whether answers are remembered: those about now until something changes (SQLite only), and the states of
            the past that were asked for last.
        tolerance: how far the clock may be behind the latest recorded time (a duration; rule T3).
        max_step: how far the system clock may get ahead of what the machine measures, between two transactions, before
            it is `ClockJumped` (a duration; rule T6).
        busy_timeout: seconds to wait for a lock that others hold, before it is `StoreUnavailable`.
        schema: the schema of a PostgreSQL database in which the tables are; made if there is none. None: where the
            search path of the connection finds them.

    Raises:
        SchemaOutOfDate, SchemaTooNew, SchemaUnknown: the database's schema is not this kbstore's.
        StoreUnavailable: the database cannot be reached.
        InvalidKnowledge: it was created with another `use_unknowns`, or the name cannot be one.
    """
    if not isinstance(name, str) or not name.strip() or not name.isprintable():
        raise InvalidKnowledge(
            f"{name!r:.80} cannot be the name of a knowledge base; give printable text, like 'kenny'"
        )
    database = Database(url, durability=durability, read_only=read_only, busy_timeout=busy_timeout, schema=schema)
    try:
        with database.wrap_errors():
            schemas.ensure(database.engine, read_only=read_only, schema=schema)
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
    """The names of the knowledge bases in a store; `schema` as in `open`."""
    database = Database(url, read_only=True, schema=schema)
    try:
        with database.wrap_errors():
            schemas.ensure(database.engine, read_only=True, schema=schema)
        with database.read() as connection:
            return directory.names(connection)
    finally:
        database.close()
