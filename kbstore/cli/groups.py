"""Groups of commands that import the function of a command when it is called."""

import gc
from importlib import import_module
from inspect import cleandoc
from typing import Any

import typer
from typer.core import TyperCommand, TyperGroup

from kbstore.cli.commands import COMMANDS


class LazyGroup(TyperGroup):
    """A group of `COMMANDS`; until one is called, each has only a name and a line, for help and completion."""

    def __init__(self, *, name: str, commands: dict[str, Any], **settings: Any) -> None:
        own = {command.name.split()[-1]: command for command in COMMANDS if command.group == name}
        lines = {
            called: TyperCommand(called, help=command.line, rich_help_panel=command.panel)
            for called, command in own.items()
        }
        super().__init__(name=name, commands={**lines, **commands}, **settings)
        self._functions = {called: command.function for called, command in own.items()}

    def resolve_command(self, ctx: Any, args: list[str]) -> tuple[str | None, Any, list[str]]:
        """Return the command that is called, with its options and its function."""
        name, command, rest = super().resolve_command(ctx, args)
        return name, _imported(name, self._functions[name]) if name in self._functions else command, rest


_PASSING_ON = frozenset({"history.diff", "ros.plansys2", "ros.record"})
"""Commands with arguments that look like options: a relative time like -5m, and what ROS 2 reads."""


def _imported(name: str, place: str) -> Any:
    module, _, function = place.partition(".")
    called = getattr(import_module(f"kbstore.cli.{module}"), function)
    gc.freeze()
    gc.enable()
    # keep the lines of examples
    help_text = cleandoc(called.__doc__ or "").replace("Examples:\n", "\b\nExamples:\n")
    single = typer.Typer(add_completion=False, pretty_exceptions_enable=False)
    single.command(name, help=help_text, context_settings={"ignore_unknown_options": place in _PASSING_ON})(called)
    return typer.main.get_command(single)
