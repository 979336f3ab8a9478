"""The command line application: all commands, their groups, and the options that may come before them."""

from collections.abc import Callable, Mapping
from importlib.metadata import version
from inspect import cleandoc
from typing import Annotated, Any

import typer

from kbstore.cli import act, admin, history, migrations, query, write
from kbstore.cli.errors import OneLineErrors
from kbstore.cli.options import STORE

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
WRITE, MAINTAIN = "Write", "Maintain"

goal = typer.Typer(invoke_without_command=True, help="Add goals, or remove them.")
db = typer.Typer(invoke_without_command=True, help="Upgrade or check the schema of the store.")


app.add_typer(goal, name="goal", rich_help_panel=WRITE)
app.add_typer(db, name="db", rich_help_panel=MAINTAIN)

Commands = dict[str, Callable[..., None]]

COMMANDS: list[tuple[typer.Typer, str | None, Commands]] = [
    (
        app,
        WRITE,
        {"load": write.load, "add": write.add, "remove": write.remove, "metric": write.metric},
    ),
    (app, "Act", {"apply": act.apply, "start": act.start, "end": act.end, "abort": act.abort}),
    (
        app,
        "Ask about one time",
        {
            "state": query.state,
            "holds": query.holds,
            "find": query.find,
            "wait": query.wait,
            "value": query.value,
            "explain": query.explain,
            "applicable": query.applicable,
        },
    ),
    (
        app,
        "Ask over time",
        {
            "history": history.history,
            "when": history.when,
            "runs": act.runs,
            "diff": history.diff,
            "changes": history.changes,
            "timeline": history.timeline,
        },
    ),
    (
        app,
        MAINTAIN,
        {
            "kbs": admin.kbs,
            "export": admin.export,
            "import": admin.import_,
            "backup": admin.backup,
            "archive": admin.archive,
            "demo": admin.demo,
        },
    ),
    (goal, None, {"add": write.goal_add, "remove": write.goal_remove}),
    (
        db,
        None,
        {
            "upgrade": migrations.upgrade,
            "downgrade": migrations.downgrade,
            "current": migrations.current,
            "check": migrations.check,
            "history": migrations.history,
        },
    ),
]
"""Every command: its group, its panel in the help, and its function by name."""

for _group, _panel, _functions in COMMANDS:
    for _name, _function in _functions.items():
        # keep the lines of examples; let diff take a relative time like -5m, which looks like an option
        _help = cleandoc(_function.__doc__ or "").replace("Examples:\n", "\b\nExamples:\n")
        _settings = {"ignore_unknown_options": _name == "diff"}
        _group.command(_name, help=_help, rich_help_panel=_panel, context_settings=_settings)(_function)


@goal.callback()
@db.callback()
def show_help(ctx: typer.Context) -> None:
    """Show the help if no command follows."""
    if ctx.invoked_subcommand is None:
        typer.echo(ctx.get_help())
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
    show_version: Annotated[bool, typer.Option("--version", help="Show the version and exit.")] = False,
) -> None:
    """Pass the options before a command on to it, as defaults."""
    if show_version:
        typer.echo(f"kbstore {version('kbstore')}")
        raise typer.Exit
    show_help(ctx)
    given = {"url": url, "kb": kb, "now": now, "as_json": as_json or None}
    ctx.default_map = _for_each(ctx.command, {name: value for name, value in given.items() if value is not None})


def _for_each(command: Any, given: Mapping[str, Any]) -> dict[str, Any]:
    """The same defaults for every command of a group."""
    below: Mapping[str, Any] = getattr(command, "commands", {})
    return {name: _for_each(part, given) if hasattr(part, "commands") else dict(given) for name, part in below.items()}


def main() -> None:
    """The console script ``kbstore``."""
    app(prog_name="kbstore")
