"""The schema of a store: set up in an empty database, checked at every opening, changed on request.

The revision of the schema, four digits, is in the database (`VERSION_TABLE`). Only the migrations change a schema; they
are run by alembic (see `migrations/env.py`). A database with data is migrated only on request.
"""

import re
import shlex
import sqlite3
import threading
import time
import weakref
from collections.abc import Iterator, Sequence
from contextlib import closing, contextmanager
from datetime import UTC, datetime
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import sqlalchemy as sa
from sqlalchemy.engine import URL
from sqlalchemy.exc import DBAPIError

from kbstore.errors import KbStoreError, SchemaOutOfDate, SchemaTooNew, SchemaUnknown, StoreUnavailable, one_line
from kbstore.storage import blank_store, schema_objects, tables
from kbstore.storage.connection import LOG
from kbstore.storage.engine import BUSY_TIMEOUT, make_engine, parsed_url, refuse_schema, schema_of
from kbstore.storage.schema_objects import VERSION_TABLE, VIEWS
from kbstore.storage.server_engine import answer_timeout, lend, take_back
from kbstore.storage.sqlite_files import file_of, refuse_half, way_out
from kbstore.storage.statement_events import begin_quietly

if TYPE_CHECKING:
    from alembic.config import Config

HEAD = "0002"
"""The revision of the schema that this kbstore reads and writes."""

StoreUrl = str | PathLike[str] | URL
"""A store's URL: a SQLAlchemy URL, or the path of an SQLite file."""

_SCRIPTS = ("migrations", "../migrations")
"""The folders of the migrations, relative to the package: in an installed kbstore, and in a checkout."""

_PATIENCE = 600.0
"""Seconds that an upgrade waits for another one to finish."""

# alembic has its state in global variables, so only one thread at a time can run it
_alembic = threading.Lock()


_checked: weakref.WeakKeyDictionary[sa.Engine, set[str | None]] = weakref.WeakKeyDictionary()
"""The schemas of PostgreSQL databases that have been compared, by engine: a pool asks once."""


class Migrated(NamedTuple):
    """The result of an upgrade or a downgrade: revisions before and after (None: no schema), and the copy if made."""

    before: str | None
    after: str | None
    copy: Path | None


class SchemaRevision(NamedTuple):
    """A revision of the schema: its number, and its title."""

    number: str
    title: str


def ensure(engine: sa.Engine, *, read_only: bool, schema: str | None = None) -> None:
    """Set up an empty database, and refuse one whose schema this kbstore does not read.

    `schema` is that of a PostgreSQL database in which the tables are.

    A database without any of kbstore's tables counts as empty. Raises `SchemaOutOfDate`
    (also for an empty database that is opened read-only), `SchemaTooNew` or `SchemaUnknown`.
    """
    with _translating(engine), connecting(engine, existing=read_only) as connection:
        stamps = _revisions(connection, schema)
        if stamps == [HEAD]:
            _refuse_another(connection, schema)
            return
        if stamps or read_only:
            raise _refusal(engine, stamps, schema)
        with _alembic:
            _set_up(connection, schema)


def current(url: StoreUrl, *, schema: str | None = None) -> str | None:
    """Return the revision of a store's schema; None if it has none yet."""
    schema = schema_of(parsed_url(url), schema)
    with _opened(url, schema) as engine, connecting(engine, existing=True) as connection:
        stamps = _revisions(connection, schema)
        if stamps and len(stamps) > 1:
            raise _refusal(engine, stamps, schema)
        return stamps[0] if stamps else None


def check(url: StoreUrl, *, wait: float = 0, schema: str | None = None) -> None:
    """Raise unless the store can be reached and its schema is the one that this kbstore reads.

    Waits up to `wait` seconds for a database that does not answer yet or is still to be upgraded by someone else.
    """
    schema = schema_of(parsed_url(url), schema)
    deadline = time.monotonic() + wait
    while True:
        try:
            with _opened(url, schema) as engine, connecting(engine, existing=True) as connection:
                stamps = _revisions(connection, schema)
                if stamps != [HEAD]:
                    raise _refusal(engine, stamps, schema)
                _refuse_another(connection, schema)
            return
        except (SchemaOutOfDate, StoreUnavailable):
            if time.monotonic() >= deadline:
                raise
        time.sleep(min(0.2, wait))


def history() -> list[SchemaRevision]:
    """Return the revisions of the schema that this kbstore knows, the oldest first."""
    from alembic.script import ScriptDirectory

    scripts = ScriptDirectory.from_config(_config()).walk_revisions()
    return [SchemaRevision(script.revision, script.doc) for script in scripts][::-1]


def upgrade(url: StoreUrl, revision: str = "head", *, backup: bool = True, schema: str | None = None) -> Migrated:
    """Bring the schema to a later revision, in one transaction.

    An SQLite file that holds a store is copied first, beside itself, unless `backup` is False; the copy is what the
    upgrade began with. On PostgreSQL, `schema` names the database's schema that kbstore lives in; it is created
    if it is missing. Raises `SchemaUnknown`, `SchemaTooNew` or `StoreUnavailable`, with nothing changed.
    """
    return _migrate(url, revision, schema, backup=backup, down=False)


def downgrade(url: StoreUrl, revision: str, *, backup: bool = True, schema: str | None = None) -> Migrated:
    """Bring the schema back to an earlier revision; otherwise like `upgrade`. "base" drops all data."""
    return _migrate(url, revision, schema, backup=backup, down=True)


def in_schema(url: StoreUrl, schema: str) -> URL:
    """Return a URL, for programs other than kbstore, whose connections have a PostgreSQL schema as search path."""
    engine = make_engine(url)
    refuse_schema(engine.url, schema)
    name = engine.dialect.identifier_preparer.quote_identifier(schema).replace("\\", "\\\\").replace(" ", "\\ ")
    given = engine.url.query.get("options", ())
    options = [given] if isinstance(given, str) else list(given)
    return engine.url.update_query_dict({"options": " ".join([*options, f"-csearch_path={name}"])})


@contextmanager
def connecting(engine: sa.Engine, *, existing: bool = False) -> Iterator[sa.Connection]:
    """Open a connection whose driver begins and ends no transactions by itself; with `existing`, create no file."""
    path = file_of(engine.url)
    if existing and path is not None and not path.exists():
        raise StoreUnavailable(
            f"there is no store at {one_line(str(path))}; kbstore.open() without read_only makes one"
        )
    refuse_half(engine.url)
    with engine.connect() as connection:
        driver: Any = connection.connection.dbapi_connection
        # a connection that has it already may be another one's, too (in memory), and is left as it is
        if not engine.dialect.detect_autocommit_setting(driver):
            connection.execution_options(isolation_level="AUTOCOMMIT")
        is_server = engine.dialect.name == "postgresql"
        lent = is_server and lend(connection, answer_timeout(engine.url, BUSY_TIMEOUT))
        try:
            begin_quietly(connection)
            yield connection
        finally:
            if lent:
                take_back(driver)


# -- what a database has ------------------------------------------------------------------------------------------


def _revisions(connection: sa.Connection, schema: str | None) -> list[str] | None:
    """Return the version table's rows: one revision, unless something is wrong; None if there is no table.

    Raises `SchemaUnknown` where another's tables have kbstore's names.
    """
    stamps = _stamps(connection, schema)
    if not stamps:
        taken = _taken(connection, schema)
        # looked at again: another process may have set the store up since the first look
        stamps = _stamps(connection, schema)
        if taken and not stamps:
            raise _taken_by_another(connection, taken)
    return stamps


def _stamps(connection: sa.Connection, schema: str | None) -> list[str] | None:
    """Return the version table's rows; None if there is no table."""
    read = sa.select(sa.table(VERSION_TABLE, sa.column("version_num"), schema=schema))
    try:
        return list(connection.execute(read).scalars())
    except DBAPIError as error:
        if error.connection_invalidated:
            raise
        # the table may have come just now; if there is another reason, it is raised again
        has_table = sa.inspect(connection).has_table(VERSION_TABLE, schema=schema)
        return list(connection.execute(read).scalars()) if has_table else None


def _taken(connection: sa.Connection, schema: str | None) -> list[str]:
    """Return the names of kbstore's tables and views that a database has."""
    inspector = sa.inspect(connection)
    names = {*inspector.get_table_names(schema=schema), *inspector.get_view_names(schema=schema)}
    return sorted(names & {*tables.metadata.tables, *VIEWS})


def _taken_by_another(connection: sa.Connection, taken: Sequence[str]) -> SchemaUnknown:
    """Return the error for a database without a version table in which kbstore's names are taken."""
    way_out = (
        "rename them, or give kbstore a file of its own"
        if connection.dialect.name == "sqlite"
        else "give kbstore a schema of its own in that database: kbstore.open(..., schema='kbstore'), or "
        "kbstore db upgrade --schema kbstore"
    )
    return SchemaUnknown(
        f"{_shown(connection.engine)} has tables of somebody else with names that kbstore needs: {', '.join(taken)}; "
        f"{way_out}"
    )


def _refuse_another(connection: sa.Connection, schema: str | None) -> None:
    """Raise `SchemaUnknown` if a database has our revision, but not the schema that the migrations make."""
    engine = connection.engine
    if engine.dialect.name == "sqlite":
        if schema_objects.is_as_migrated(connection):
            return
        found = schema_objects.in_sqlite(connection)
        blank = make_engine("sqlite://")
        with _alembic, connecting(blank) as made:
            _set_up(made, None)
            expected = schema_objects.in_sqlite(made)
        blank.dispose()
    else:
        if schema in _checked.setdefault(engine, set()):
            return
        found, expected = schema_objects.in_postgresql(connection, schema), schema_objects.for_postgresql()
    different = schema_objects.differences(found, expected)
    if different:
        raise SchemaUnknown(
            f"{_shown(engine)} has the revision {HEAD}, and not the schema of it: {different}; undo what was done to "
            "kbstore's tables, or import an export of its knowledge bases into a new store"
        )
    _checked.setdefault(engine, set()).add(schema)


def _refusal(engine: sa.Engine, stamps: Sequence[str] | None, schema: str | None) -> KbStoreError:
    """Return the error for a database without this kbstore's schema, with the command that helps."""
    store, command = _shown(engine), f"kbstore db upgrade --url {shlex.quote(_shown(engine))}"
    if schema is not None:
        command += f" --schema {shlex.quote(schema)}"
    if not stamps:
        return SchemaOutOfDate(f"{store} has no schema yet, this kbstore needs {HEAD}; set it up: {command}")
    stamp = ", ".join(stamps)
    if not re.fullmatch(r"\d{4}", stamp) or stamp == "0000":
        return SchemaUnknown(
            f"{store} has the schema {stamp!r}, which kbstore does not have (this kbstore's is {HEAD}); "
            "see those that it has: kbstore db history"
        )
    if stamp > HEAD:
        return SchemaTooNew(
            f"{store} has schema {stamp}, newer than this kbstore's {HEAD}; upgrade kbstore "
            f"(pip install --upgrade kbstore), or with the newer kbstore run: "
            f"kbstore db downgrade {HEAD} --url {shlex.quote(store)}"
        )
    return SchemaOutOfDate(f"{store} has schema {stamp}, this kbstore needs {HEAD}; upgrade it: {command}")


# -- migrations ---------------------------------------------------------------------------------------------------


def _set_up(connection: sa.Connection, schema: str | None) -> None:
    """Set up the schema in an empty database; on SQLite the migrations run only once in a process."""
    if connection.dialect.name != "sqlite":
        _run(connection, "head", schema)
        return
    driver: Any = connection.connection.driver_connection
    if blank_store.copy(driver, in_memory=file_of(connection.engine.url) is None):
        LOG.info("%s: schema changed from none to %s", _shown(connection.engine), HEAD)
        return
    was_empty = blank_store.is_empty(driver)
    _run(connection, "head", schema)
    if was_empty:
        blank_store.remember(driver, HEAD)


def _migrate(url: StoreUrl, revision: str, schema: str | None, *, backup: bool, down: bool) -> Migrated:
    schema = schema_of(parsed_url(url), schema)
    with _opened(url, schema) as engine, connecting(engine) as connection, _alembic:
        return _run(connection, revision, schema, backup=backup, down=down)


def _run(
    connection: sa.Connection, revision: str, schema: str | None = None, *, backup: bool = False, down: bool = False
) -> Migrated:
    """Have alembic run the migrations between the database's revision and another."""
    from alembic.runtime.environment import EnvironmentContext
    from alembic.runtime.migration import MigrationContext
    from alembic.script import ScriptDirectory
    from alembic.util import CommandError

    config = _config()
    config.attributes.update(connection=connection, schema=schema)
    scripts = ScriptDirectory.from_config(config)
    engine = connection.engine
    before: Sequence[str] = ()
    copy: Path | None = None

    def plan(stamps: Any, _: MigrationContext) -> Sequence[Any]:
        # called under the write lock: the steps will find the rows that are read and copied here
        nonlocal before, copy
        before = stamps
        if not stamps and (taken := _taken(connection, schema)):
            raise _taken_by_another(connection, taken)
        if not set(stamps) <= {f"{n:04}" for n in range(1, int(HEAD) + 1)}:
            raise _refusal(engine, stamps, schema)
        steps = scripts._downgrade_revs(revision, stamps) if down else scripts._upgrade_revs(revision, stamps)
        path = file_of(engine.url)
        if steps and stamps and backup and path is not None:
            copy = _copied(path, stamps[0])
        return steps

    try:
        with EnvironmentContext(config, scripts, fn=plan, destination_rev=revision):
            scripts.run_env()
    except CommandError as error:
        raise SchemaUnknown(f"{_shown(engine)} was left as it is: {error}") from error
    after = _stamps(connection, schema)
    if (before[0] if before else None) != (after[0] if after else None):
        found, made = (stamps[0] if stamps else "none" for stamps in (before, after))
        LOG.info("%s: schema changed from %s to %s", _shown(engine), found, made)
    return Migrated(before[0] if before else None, after[0] if after else None, copy)


def _config() -> "Config":
    from alembic.config import Config

    package = Path(__file__).parents[1]
    scripts = next(path for path in ((package / place).resolve() for place in _SCRIPTS) if path.is_dir())
    config = Config()
    config.set_main_option("script_location", str(scripts).replace("%", "%%"))
    config.set_main_option("path_separator", "os")
    return config


def _copied(path: Path, stamp: str) -> Path:
    """Copy an SQLite file to a file beside it, completely or not at all, and return its path."""
    copy = path.with_name(f"{path.name}.{stamp}.{datetime.now(UTC):%Y%m%dT%H%M%S.%fZ}.backup")
    partial = copy.with_name(copy.name + ".partial")
    try:
        with closing(sqlite3.connect(path)) as source, closing(sqlite3.connect(partial)) as target:
            source.backup(target)
        return partial.replace(copy)
    finally:
        partial.unlink(missing_ok=True)


# -- engines ------------------------------------------------------------------------------------------------------


@contextmanager
def _opened(url: StoreUrl, schema: str | None) -> Iterator[sa.Engine]:
    """Open an engine for a while that waits `_PATIENCE` seconds for locks."""
    engine = make_engine(url, busy_timeout=_PATIENCE)
    refuse_schema(engine.url, schema)
    try:
        with _translating(engine):
            yield engine
    finally:
        engine.dispose()


@contextmanager
def _translating(engine: sa.Engine) -> Iterator[None]:
    """Raise the driver's errors, and those of the file system, as `StoreUnavailable`."""
    try:
        yield
    except (DBAPIError, sqlite3.Error, OSError) as error:
        if isinstance(error, KbStoreError):
            raise
        reason = str(getattr(error, "orig", None) or error).strip() or type(error).__name__
        what_to_do = way_out(engine.url, getattr(error, "orig", error))
        if what_to_do:
            raise StoreUnavailable(f"{_shown(engine)}: {reason}. {what_to_do}") from error
        raise StoreUnavailable(f"{_shown(engine)}: {reason}; nothing has been changed") from error


def _shown(engine: sa.Engine) -> str:
    return engine.url.render_as_string(hide_password=True)
