"""The command line application: the groups of its commands, and the options that may come before a command."""

import gc
from collections.abc import Mapping
from typing import Annotated, Any

import typer

from kbstore.cli.commands import MAINTAIN, SERVE, STORE, WRITE
from kbstore.cli.errors import OneLineErrors
from kbstore.cli.groups import LazyGroup

app = typer.Typer(
    name="kbstore",
    cls=OneLineErrors,
    help=(
        "A bitemporal knowledge base for robot planning: what holds at any time, and what was believed of it.\n\n"
        "The options of the store may be given before the command or after it."
    ),
    invoke_without_command=True,
    pretty_exceptions_enable=False,
)

goal = typer.Typer(cls=LazyGroup, invoke_without_command=True, help="Add goals, or remove them.")
nodes = typer.Typer(cls=LazyGroup, invoke_without_command=True, help="Serve a knowledge base on a ROS graph.")
bag = typer.Typer(cls=LazyGroup, invoke_without_command=True, help="Import bags of ROS, and export for their viewers.")
db = typer.Typer(cls=LazyGroup, invoke_without_command=True, help="Upgrade or check the schema of the store.")

app.add_typer(goal, name="goal", rich_help_panel=WRITE)
app.add_typer(nodes, name="ros", rich_help_panel=SERVE)
app.add_typer(bag, name="bag", rich_help_panel=MAINTAIN)
app.add_typer(db, name="db", rich_help_panel=MAINTAIN)


@goal.callback()
@nodes.callback()
@bag.callback()
@db.callback()
def show_help(ctx: typer.Context) -> None:
    """Show the help if no command follows."""
    if ctx.invoked_subcommand is None:
        typer.echo(ctx.get_help())
        raise typer.Exit


def show_version(asked: bool) -> None:
    """Show the version and exit, before other options are read."""
    if asked:
        from importlib.metadata import version

        typer.echo(f"kbstore {version('kbstore')}")
        raise typer.Exit


@app.callback()
def before(
    ctx: typer.Context,
    url: Annotated[
        str | None,
        typer.Option(
            metavar="URL",
            envvar="KBSTORE_URL",
            help="The store: an SQLite file, or a SQLAlchemy URL.",
            rich_help_panel=STORE,
        ),
    ] = None,
    kb: Annotated[
        str | None,
        typer.Option(metavar="NAME", envvar="KBSTORE_KB", help="The knowledge base.", rich_help_panel=STORE),
    ] = None,
    now: Annotated[
        str | None, typer.Option(metavar="TIME", help="The time to take as now, or last.", rich_help_panel=STORE)
    ] = None,
    as_json: Annotated[
        bool, typer.Option("--json", help="Answer in JSON.", rich_help_panel=STORE, show_default=False)
    ] = False,
    version: Annotated[
        bool, typer.Option("--version", help="Show the version and exit.", callback=show_version, is_eager=True)
    ] = False,
) -> None:
    """Pass the options before a command on to it, as defaults."""
    show_help(ctx)
    given = {"url": url, "kb": kb, "now": now, "as_json": as_json or None}
    ctx.default_map = _for_each(ctx.command, {name: value for name, value in given.items() if value is not None})


def _for_each(command: Any, given: Mapping[str, Any]) -> dict[str, Any]:
    """Return the same defaults for every command of a group."""
    below: Mapping[str, Any] = getattr(command, "commands", {})
    return {name: _for_each(part, given) if hasattr(part, "commands") else dict(given) for name, part in below.items()}


def main() -> None:
    """Run the console script ``kbstore``."""
    # a third of a short command's time would go into looking for garbage among modules, while they are imported and
    # when the process ends; what a command makes itself is collected as ever (`kbstore.cli.groups`)
    gc.disable()
    app(prog_name="kbstore")
