"""The schema of a store: ``db upgrade``, ``downgrade``, ``current``, ``check``, ``history``."""

from typing import Annotated

import typer

from kbstore.cli.options import Json, Url, store
from kbstore.cli.output import answer, working
from kbstore.report.tables import table
from kbstore.storage import schema as schemas

Schema = Annotated[
    str | None,
    typer.Option(
        "--schema",
        metavar="NAME",
        help="The schema of a PostgreSQL database that kbstore uses.",
        show_default=False,
    ),
]
NoBackup = Annotated[bool, typer.Option("--no-backup", help="Do not copy an SQLite file first.", show_default=False)]


def upgrade(
    revision: Annotated[str, typer.Argument(help="The revision to upgrade to.", metavar="[REVISION]")] = "head",
    no_backup: NoBackup = False,
    schema: Schema = None,
    url: Url = None,
    as_json: Json = False,
) -> None:
    """Upgrade the schema to that of this kbstore, in one transaction. An SQLite file is first copied, next to itself.

    Examples:
        kbstore db upgrade --url robot.db
        kbstore db upgrade --url postgresql://server/fleet --schema kbstore
    """
    with working("upgrading"):
        done = schemas.upgrade(store(url), revision, backup=not no_backup, schema=schema)
    _migrated(done, as_json)


def downgrade(
    revision: Annotated[str, typer.Argument(help="The revision to go back to; base drops everything.")],
    no_backup: NoBackup = False,
    schema: Schema = None,
    url: Url = None,
    as_json: Json = False,
) -> None:
    """Go back to an earlier revision of the schema, for an earlier kbstore.

    Examples:
        kbstore db downgrade 0001 --url robot.db
    """
    with working("downgrading"):
        done = schemas.downgrade(store(url), revision, backup=not no_backup, schema=schema)
    _migrated(done, as_json)


def current(schema: Schema = None, url: Url = None, as_json: Json = False) -> None:
    """Show the revision of the store's schema, and the one that this kbstore needs.

    Examples:
        kbstore db current --url robot.db
    """
    revision = schemas.current(store(url), schema=schema)
    report = {"revision": revision, "needed": schemas.HEAD}
    sentence = "no schema yet" if revision is None else f"schema {revision}"
    answer(report, as_json=as_json, view=lambda: f"{sentence}; this kbstore needs {schemas.HEAD}")


def check(
    wait: Annotated[
        float, typer.Option("--wait", metavar="SECONDS", help="Wait up to this long for the store to be ready.", min=0)
    ] = 0,
    schema: Schema = None,
    url: Url = None,
    as_json: Json = False,
) -> None:
    """Succeed if the store can be reached and has the required schema; for start-up scripts.

    Examples:
        kbstore db check --url robot.db
        kbstore db check --wait 30 && robot-service
    """
    schemas.check(store(url), wait=wait, schema=schema)
    answer({"revision": schemas.HEAD}, as_json=as_json, view=lambda: f"ready: schema {schemas.HEAD}")


def history(as_json: Json = False) -> None:
    """List the revisions of the schema that this kbstore knows.

    Examples:
        kbstore db history
    """
    revisions = [revision._asdict() for revision in schemas.history()]
    rows = [(revision["number"], revision["title"]) for revision in revisions]
    answer(revisions, as_json=as_json, view=lambda: table("", ("revision", "change"), rows))


def _migrated(done: schemas.Migrated, as_json: bool) -> None:
    copy = None if done.copy is None else str(done.copy)
    report = {"before": done.before, "after": done.after, "copy": copy}
    if done.before == done.after:
        sentence = f"schema {done.after or 'none'}, unchanged"
    elif done.before is None:
        sentence = f"schema {done.after} was created"
    elif done.after is None:
        sentence = f"schema {done.before} was removed"
    else:
        sentence = f"schema {done.before} was changed to {done.after}"
    if copy:
        sentence += f"; the store as it was before is in {copy}"
    answer(report, as_json=as_json, view=lambda: sentence)
