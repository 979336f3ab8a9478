"""Plain `alembic` works in a checkout as usual."""

import io
import logging
import sqlite3
import subprocess
import sys
from argparse import Namespace
from pathlib import Path

import pytest
import sqlalchemy as sa
from alembic import command
from alembic.config import Config
from alembic.util import CommandError

from kbstore.storage import schema
from tests.migration import rows_0001

INI = str(Path(__file__).parents[2] / "alembic.ini")


@pytest.fixture
def alembic():
    """Run a command of alembic with `-x` arguments, and return its output."""

    def run(x, name, *arguments, **options):
        output = io.StringIO()
        config = Config(INI, stdout=output, output_buffer=output, cmd_opts=Namespace(x=x))
        getattr(command, name)(config, *arguments, **options)
        return output.getvalue()

    return run


def test_the_usual_commands(alembic, empty):
    """`upgrade`, `current`, `check`, `history` and `downgrade` work with a database named by -x url=..."""
    x = [f"url={empty}"]
    alembic(x, "upgrade", "head")
    assert schema.current(empty) == schema.HEAD
    assert alembic(x, "current").strip() == f"{schema.HEAD} (head)"
    assert "No new upgrade operations" in alembic(x, "check")
    assert "<base> -> 0001" in alembic(x, "history")
    alembic(x, "downgrade", "-1")
    assert schema.current(empty) == schema.history()[-2].number
    alembic(x, "downgrade", "base")
    assert schema.current(empty) is None


def test_the_command_itself(tmp_path):
    """`alembic` as a process, in another directory, sets a database up."""
    call = [sys.executable, "-m", "alembic", "-c", INI, "-x", f"url={tmp_path / 'store.db'}", "upgrade", "head"]
    done = subprocess.run(call, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")
    schema.check(tmp_path / "store.db")


def test_check_leaves_an_empty_database_empty(alembic, empty, engine):
    """`check` on an empty database says that it is not up to date, and writes nothing."""
    with pytest.raises(CommandError, match="not up to date"):
        alembic([f"url={empty}"], "check")
    assert not rows_0001.objects(engine)


def test_the_database_from_the_environment(alembic, tmp_path, monkeypatch):
    """KBSTORE_URL names the database; `%` in it is no interpolation, and it may be a path."""
    monkeypatch.setenv("KBSTORE_URL", f"sqlite:///{tmp_path}/%(here)s 100%25.db")
    alembic([], "upgrade", "head")
    monkeypatch.setenv("KBSTORE_URL", f"{tmp_path}/plain%s.db")
    alembic([], "upgrade", "head")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["%(here)s 100%.db", "plain%s.db"]


def test_a_database_must_be_named(alembic, monkeypatch):
    """Without a database, alembic says in one line how to name one."""
    monkeypatch.delenv("KBSTORE_URL", raising=False)
    with pytest.raises(CommandError, match=r"-x url=.*KBSTORE_URL"):
        alembic([], "upgrade", "head")


def test_sql_for_sqlite(alembic, tmp_path):
    """The script of `--sql`, run by SQLite, gives the same schema as the migrations, in one transaction."""
    script = alembic(["url=sqlite://"], "upgrade", "head", sql=True)
    assert script.startswith("BEGIN;")
    assert script.rstrip().endswith("COMMIT;")
    by_hand = sqlite3.connect(tmp_path / "script.db")
    by_hand.executescript(script)
    by_hand.close()
    schema.upgrade(tmp_path / "migrated.db")
    scripted, migrated = (sa.create_engine(f"sqlite:///{tmp_path / name}.db") for name in ("script", "migrated"))
    assert rows_0001.objects(scripted) == rows_0001.objects(migrated)
    schema.check(tmp_path / "script.db")
    for engine in (scripted, migrated):
        engine.dispose()


def test_sql_for_postgresql(alembic, postgresql_url):
    """The script of `--sql` with a schema, run by PostgreSQL, creates a store in it; the downgrade empties it."""
    engine = sa.create_engine(postgresql_url)
    for name, revision in (("upgrade", "head"), ("downgrade", f"{schema.HEAD}:base")):
        script = alembic(["url=postgresql://", "schema=scripted"], name, revision, sql=True)
        with schema.connecting(engine) as connection:
            connection.connection.driver_connection.execute(script)
        if name == "upgrade":
            schema.check(postgresql_url, schema="scripted")
    with engine.begin() as connection:
        assert sa.inspect(connection).get_table_names(schema="scripted") == [schema.VERSION_TABLE]
        connection.exec_driver_sql("DROP SCHEMA scripted CASCADE")
    engine.dispose()


def test_the_hosts_logging_is_left_alone(empty):
    """Migrating changes neither levels nor handlers, and writes nothing to the root logger's handlers."""
    root, own = logging.getLogger(), logging.getLogger("alembic")
    before = (root.level, list(root.handlers), own.level, list(own.handlers), own.disabled)
    schema.upgrade(empty)
    assert (root.level, list(root.handlers), own.level, list(own.handlers), own.disabled) == before
