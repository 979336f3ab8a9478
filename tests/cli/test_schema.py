"""A store in a schema of PostgreSQL, named in the URL: every command uses it, and creates nothing elsewhere."""

import psycopg
import sqlalchemy as sa

from kbstore.cli.demo.mission import record
from tests.cli.test_help import EXAMPLES


def test_every_command_takes_a_schema_in_the_url(run, empty_database, tmp_path, monkeypatch):
    """`?schema=...` works for all commands that take a URL; those without an example here open stores alike."""
    monkeypatch.chdir(tmp_path)
    url = sa.make_url(empty_database).update_query_dict({"schema": "fleet"}).render_as_string(hide_password=False)
    record(url).close()
    # the examples before it have undocked the robot
    for name, arguments in (EXAMPLES | {"wait": ["(docked kenny)", "--timeout", "1ms"]}).items():
        if arguments is None or name in ("demo", "db history"):
            continue
        done = run(*name.split(), *arguments, "--url", url)
        assert (done.code, done.err) in ((0, ""), (1, "")), (name, done)
        if name == "db downgrade":
            assert run("db", "upgrade", "--url", url).code == 0
    with psycopg.connect(empty_database.replace("+psycopg", "")) as connection:
        found = connection.execute("SELECT DISTINCT schemaname FROM pg_tables WHERE schemaname !~ '^(pg_|info)'")
        assert found.fetchall() == [("fleet",)]
