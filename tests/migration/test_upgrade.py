"""Upgrades and downgrades without loss."""

import os
import shutil
import signal
import sqlite3
from pathlib import Path

import pytest
import sqlalchemy as sa
from alembic import command
from alembic.config import Config
from alembic.util import CommandError

from kbstore.errors import SchemaUnknown, StoreUnavailable
from kbstore.storage import schema
from tests.migration import rows_0001
from tests.migration.processes import upgrade, upgrade_killed_at
from tests.processes import barrier, start

MIGRATIONS = Path(__file__).parents[2] / "migrations"

ROUNDS = 6
KILLS = int(os.environ.get("KBSTORE_TEST_KILLS", "15"))

LATER = '''"""A later revision."""

from alembic import op

revision = "{revision}"
down_revision = "{after}"


def upgrade():
    op.execute("CREATE TABLE extra (id INTEGER)")
    {body}


def downgrade():
    op.execute("DROP TABLE extra")
'''


def later(tmp_path, body, after=schema.HEAD):
    """The migrations up to a revision, with one more that creates a table and then runs `body`."""
    scripts = tmp_path / "migrations"
    shutil.copytree(MIGRATIONS, scripts, ignore=shutil.ignore_patterns("__pycache__"))
    for path in (scripts / "versions").iterdir():
        if path.name[:4] > after:
            path.unlink()
    revision = f"{int(after) + 1:04d}"
    (scripts / "versions" / f"{revision}_later.py").write_text(LATER.format(revision=revision, after=after, body=body))
    config = Config()
    config.set_main_option("script_location", str(scripts))
    config.set_main_option("path_separator", "os")
    return config


def upgrade_with(config, engine):
    """Upgrade with other migrations, through plain alembic."""
    with schema.connecting(engine) as connection:
        config.attributes["connection"] = connection
        command.upgrade(config, "head")


def test_data_survives_up_and_down(engine):
    """An upgrade and a downgrade keep every row, and a downgrade to nothing leaves nothing."""
    url = engine.url
    assert schema.upgrade(url, "0001") == (None, "0001", None)
    filled = rows_0001.fill(engine)
    at_first = rows_0001.objects(engine)
    for _ in range(2):
        done = schema.upgrade(url, backup=False)
        assert (done.before, done.after) == ("0001", schema.HEAD)
        assert rows_0001.digest(engine) == filled
        assert schema.downgrade(url, "0001", backup=False)[:2] == (schema.HEAD, "0001")
        assert rows_0001.digest(engine) == filled
        assert rows_0001.objects(engine) == at_first
    schema.downgrade(url, "base", backup=False)
    assert rows_0001.objects(engine) <= {schema.VERSION_TABLE, f"{schema.VERSION_TABLE}_pkc"} | {
        "sqlite_autoindex_kbstore_alembic_version_1"
    }


def test_upgrading_a_current_schema_does_nothing(engine):
    """An upgrade without steps makes no copy and answers with the same revision twice."""
    schema.upgrade(engine.url)
    assert schema.upgrade(engine.url) == (schema.HEAD, schema.HEAD, None)


def test_an_unknown_revision_is_refused(engine):
    """Asking for a revision that does not exist is refused, and nothing changes."""
    with pytest.raises(SchemaUnknown, match="0777"):
        schema.upgrade(engine.url, "0777")
    assert not rows_0001.objects(engine)


def test_an_sqlite_file_is_copied_first(sqlite_file):
    """Before a file with a store is changed, it is copied: the copy has the old schema and all rows."""
    schema.upgrade(sqlite_file, "0001")
    engine = sa.create_engine(f"sqlite:///{sqlite_file}")
    filled = rows_0001.fill(engine)
    engine.dispose()
    copy = schema.upgrade(sqlite_file).copy
    assert copy is not None
    assert copy.parent == sqlite_file.parent
    assert schema.current(copy) == "0001"
    copied = sa.create_engine(f"sqlite:///{copy}")
    assert rows_0001.digest(copied) == filled
    copied.dispose()
    assert sorted(path.name for path in copy.parent.iterdir()) == [sqlite_file.name, copy.name]


def test_no_copy_of_an_empty_database_or_without_backup(sqlite_file):
    """An empty database is not copied, nor is one with `backup=False`."""
    assert schema.upgrade(sqlite_file, "0001").copy is None
    assert schema.upgrade(sqlite_file, backup=False).copy is None
    assert list(sqlite_file.parent.iterdir()) == [sqlite_file]


def test_nothing_is_changed_where_the_copy_fails(sqlite_file, monkeypatch):
    """Without room for the copy there is no upgrade, and no partial copy."""

    def full(*_):
        raise sqlite3.OperationalError("database or disk is full")

    schema.upgrade(sqlite_file, "0001")
    monkeypatch.setattr(Path, "replace", full)
    with pytest.raises(StoreUnavailable, match="disk is full; nothing has been changed"):
        schema.upgrade(sqlite_file)
    assert schema.current(sqlite_file) == "0001"
    assert list(sqlite_file.parent.iterdir()) == [sqlite_file]


def test_a_migration_that_fails_leaves_nothing(engine, tmp_path):
    """An exception in a migration rolls it back, and all earlier migrations of the same run."""
    schema.upgrade(engine.url, "0001")
    filled = rows_0001.fill(engine)
    before = rows_0001.objects(engine)
    with pytest.raises(RuntimeError, match="in the middle"):
        upgrade_with(later(tmp_path, 'raise RuntimeError("in the middle")'), engine)
    assert rows_0001.objects(engine) == before
    assert rows_0001.digest(engine) == filled
    assert schema.upgrade(engine.url, backup=False).after == schema.HEAD


def test_a_migration_that_loses_rows_is_undone(engine, tmp_path):
    """Rows are counted: where a table has fewer of them afterwards, all is rolled back."""
    schema.upgrade(engine.url)
    filled = rows_0001.fill(engine)
    with pytest.raises(CommandError, match="facts: 1, mentions: 1"):
        upgrade_with(
            later(
                tmp_path,
                'op.execute("DELETE FROM facts WHERE seq = 1 AND recorded_tx = 1"); op.execute("DELETE FROM mentions")',
            ),
            engine,
        )
    assert rows_0001.digest(engine) == filled
    assert schema.current(engine.url) == schema.HEAD


def test_a_migration_that_orphans_rows_is_undone_on_sqlite(sqlite_file, tmp_path):
    """Foreign keys are off during migrations on SQLite, and checked before the end."""
    schema.upgrade(sqlite_file)
    engine = sa.create_engine(f"sqlite:///{sqlite_file}")
    filled = rows_0001.fill(engine)
    with pytest.raises(CommandError, match="facts to timelines"):
        upgrade_with(later(tmp_path, 'op.execute("UPDATE timelines SET id = 7 WHERE id = 2")'), engine)
    assert rows_0001.digest(engine) == filled
    engine.dispose()


def test_a_recreated_table_keeps_its_children_on_sqlite(sqlite_file, tmp_path):
    """SQLite alters a table by creating it again, which with foreign keys on would delete or orphan its children."""
    schema.upgrade(sqlite_file, "0001")
    body = 'with op.batch_alter_table("timelines") as batch: batch.alter_column("spelling", new_column_name="shown")'
    engine = sa.create_engine(f"sqlite:///{sqlite_file}")
    rows_0001.fill(engine)
    with engine.connect() as connection:
        facts = connection.exec_driver_sql("SELECT * FROM facts").all()
    upgrade_with(later(tmp_path, body, after="0001"), engine)
    with engine.connect() as connection:
        assert connection.exec_driver_sql("SELECT * FROM facts").all() == facts
        assert connection.exec_driver_sql("SELECT shown FROM timelines ORDER BY id").scalars().first() == "WP0"
        assert connection.exec_driver_sql("PRAGMA foreign_key_check").all() == []
    engine.dispose()


def test_several_processes_upgrade_at_once(empty):
    """In 6 rounds of 4 processes that upgrade one database at once, none fails, and the data is there."""
    engine = sa.create_engine(empty)
    for number in range(ROUNDS):
        filled = fill_old(empty, engine) if number % 2 else None
        together = barrier(4)
        started = [start(upgrade, empty, together) for _ in range(4)]
        for process in started:
            process.join(60)
        assert [process.exitcode for process in started] == [0] * 4
        assert schema.current(empty) == schema.HEAD
        assert filled is None or rows_0001.digest(engine) == filled
        schema.downgrade(empty, "base", backup=False)
    engine.dispose()


@pytest.mark.parametrize("old", [False, True], ids=["empty", "0001"])
def test_killed_at_any_statement(empty, old):
    """Killed at any of its statements, an upgrade leaves the old schema, and the next one succeeds with all data."""
    engine = sa.create_engine(empty)
    filled = fill_old(empty, engine) if old else None
    before = rows_0001.objects(engine)
    kills = 0
    for statement in range(1, 1000, 1 if old else max(1, 100 // KILLS)):
        process = start(upgrade_killed_at, empty, statement)
        process.join(60)
        assert filled is None or rows_0001.digest(engine) == filled
        if rows_0001.objects(engine) != before:
            # it has sent COMMIT
            break
        assert process.exitcode == -signal.SIGKILL
        kills += 1
    assert kills > 10
    assert schema.current(empty) == schema.HEAD
    schema.upgrade(empty)
    engine.dispose()


def fill_old(url, engine):
    """Set up revision 0001 and write some rows; their digest."""
    schema.upgrade(url, "0001")
    return rows_0001.fill(engine)
