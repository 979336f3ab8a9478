"""Errors on the command line: one line on standard error, and exit code 2."""

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, NoReturn

import typer

from kbstore.cli.groups import LazyGroup
from kbstore.errors import InvalidKnowledge, KbStoreError, PddlSyntaxError

FAILED = 2
"""The exit code of every error."""

INTERRUPTED = 130
"""The exit code after Ctrl-C, as in shells."""


IN_PYTHON = {
    "; load one first: kb.load('domain.pddl')": "; load one first: kbstore load domain.pddl",
    "; load one: kb.load('domain.pddl')": "; load one: kbstore load domain.pddl",
    ": ask for it by kb.value(...)": ": ask for it with kbstore value",
    "; kbstore.open() without read_only makes one": "; kbstore load, or kbstore add, creates one",
    "; start() it, and end() it when it is done": "; kbstore start it, and kbstore end it when it is done",
    "; give one, as: duration=kbstore.seconds(30)": "; give one, for instance --duration 30s",
    "; apply() does the whole of it": "; kbstore apply does all of it",
    "; ask when() it was true": "; ask kbstore when",
    "; abort() it": "; kbstore abort it",
    ", or abort() it": ", or kbstore abort it",
}
"""Advice of messages in Python, and the same as a command."""


def one_line(error: BaseException) -> str:
    """Return the message of an error, on one line, with advice in commands instead of Python."""
    message = _one_line(error)
    for python, command in IN_PYTHON.items():
        message = message.replace(python, command)
    return message


def _one_line(error: BaseException) -> str:
    if isinstance(error, PddlSyntaxError):
        # the message begins with line and column; leave out the quoted line and the mark below it
        return str(error).partition("\n")[0]
    if isinstance(error, InvalidKnowledge) and len(error.violations) > 1:
        return f"{len(error.violations)} violations: {'; '.join(map(_joined, error.violations))}"
    if isinstance(error, OSError) and error.strerror and error.filename:
        return f"{error.filename}: {error.strerror}"
    return _joined(str(error) or type(error).__name__)


def _joined(text: str) -> str:
    lines = [line.strip().removeprefix("- ") for line in text.splitlines() if line.strip()]
    joined = lines[:1]
    for line in lines[1:]:
        joined.append((" " if joined[-1].endswith((":", ",", ";")) else "; ") + line)
    return "".join(joined)


class OneLineErrors(LazyGroup):
    """A group of commands that reports every error on one line: kbstore's, the file system's, and those of usage."""

    def main(self, *args: Any, **options: Any) -> NoReturn:
        """Run the command line and exit."""
        options["standalone_mode"] = False
        with _failing():
            code = super().main(*args, **options)
            sys.stdout.flush()
        sys.exit(code if isinstance(code, int) else 0)


@contextmanager
def _failing() -> Iterator[None]:
    try:
        yield
    except typer.Abort:
        sys.exit(INTERRUPTED)
    except BrokenPipeError:
        # the reader has closed the pipe, as `head` does; keep the interpreter from flushing into it at exit
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.exit(0)
    except typer.TyperException as error:
        # Pydantic's prefix for a wrong value
        _fail(error.format_message().replace("Value error, ", ""))
    except (KbStoreError, OSError) as error:
        _fail(one_line(error))


def _fail(message: str) -> NoReturn:
    from kbstore.report.tables import printable

    sys.stderr.write(f"kbstore: {printable(message)}\n")
    sys.exit(FAILED)
