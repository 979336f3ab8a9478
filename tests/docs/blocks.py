"""The fenced blocks of Markdown documents, and functions that run them.

The blocks of a document run in order, in one directory, as a reader would type them: Python in one namespace, and shell
commands with `export` lasting from block to block. Blocks in other languages than Python, shell and SQL are data.
"""

import contextlib
import io
import os
import re
import shlex
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

from typer.testing import CliRunner

from kbstore.cli.app import app

ROOT = Path(__file__).parents[2]
DOCUMENTS = sorted([*ROOT.glob("*.md"), *ROOT.glob("docs/**/*.md")])
RUN = {"python", "sh"}
DATA = {"sql", "pddl", "json", "text", "ini"}
"""The languages of blocks: those that are run, and those that are not (SQL has a separate test)."""

_FENCE = re.compile(r"^```(\w*)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
_SAVED = re.compile(r"[Ss]ave (?:this|it) as `([\w.-]+)`[^\n]*\n\n\Z")
_PRINTED = re.compile(r"^\s*print\(.*\)\s+# (.*)$", re.MULTILINE)
_OPERATORS = re.compile(r"[|<>&;$`*\n]")


@dataclass(frozen=True)
class Block:
    """A fenced block: its language, its text, the line of its fence, and the text before and after it."""

    language: str
    text: str
    line: int
    before: str
    after: str

    @property
    def file(self):
        """The file name under which the reader is asked to save it, if any."""
        found = _SAVED.search(self.before)
        return found and found[1]


def blocks(document):
    """The fenced blocks of a document, in order."""
    text = document.read_text(encoding="utf-8")
    return [
        Block(found[1], found[2], text.count("\n", 0, found.start()) + 1, text[: found.start()], text[found.end() :])
        for found in _FENCE.finditer(text)
    ]


def sql_under(document, heading):
    """The texts of the blocks of SQL under a heading, in order."""
    under = [block for block in blocks(document) if block.language == "sql"]
    return [block.text for block in under if re.findall(r"^## (.*)$", block.before, re.MULTILINE)[-1] == heading]


class Reader:
    """A reader who types the blocks of a document, and saves those to be saved.

    `replacing` are replacements of texts by the reader's own.
    """

    def __init__(self, directory, replacing=()):
        self.directory = directory
        self._replacing = dict(replacing)
        self._names = {"__name__": "__main__"}
        self._exported = {}

    def run(self, block):
        """Run a block, and return its output. A block to be saved is saved."""
        text = block.text
        for written, meant in self._replacing.items():
            text = text.replace(written, meant)
        if block.file:
            (self.directory / block.file).write_text(text, encoding="utf-8")
            return ""
        if block.language not in RUN:
            return ""
        return self._python(text) if block.language == "python" else self._shell(text)

    def _python(self, text):
        output = io.StringIO()
        with contextlib.redirect_stdout(output):
            exec(compile(text, "<block>", "exec"), self._names)
        printed = output.getvalue().splitlines(keepends=True)
        expected = _PRINTED.findall(text)
        assert [line.rstrip("\n") for line in printed[: len(expected)]] == expected, f"printed:\n{''.join(printed)}"
        return "".join(printed[len(expected) :])

    def _shell(self, text):
        output = ""
        for line in _commands(text):
            words = [] if _OPERATORS.search(line) else shlex.split(line)
            if words[:1] == ["export"]:
                self._exported |= dict(word.split("=", 1) for word in words[1:])
            elif words[:1] == ["kbstore"]:
                output += self._kbstore(words[1:])
            else:
                output += self._process(line)
        return output

    def _kbstore(self, arguments):
        """The command in this process, which saves starting one."""
        done = CliRunner().invoke(app, arguments, prog_name="kbstore", env=self._environment())
        assert done.exception is None or isinstance(done.exception, SystemExit), repr(done.exception)
        assert done.exit_code in (0, 1, 3), done.stderr
        return done.stdout

    def _process(self, line):
        make = "make() { command make --dry-run --directory " + shlex.quote(str(ROOT)) + ' "$@"; }\n'
        done = subprocess.run(
            ["sh", "-eu", "-c", make + line],
            cwd=self.directory,
            env=self._environment(),
            capture_output=True,
            text=True,
            check=False,
        )
        assert done.returncode == 0, f"{line}\n{done.stdout}{done.stderr}"
        return done.stdout

    def _environment(self):
        kept = {name: value for name, value in os.environ.items() if not name.startswith("KBSTORE_")}
        path = os.pathsep.join([str(Path(sys.executable).parent), kept.get("PATH", "")])
        return {**kept, "PATH": path, "PYTHONPATH": str(ROOT), **self._exported}


def _commands(text):
    """The commands of a shell block: lines, with continued ones joined."""
    joined = text.replace("\\\n", " ")
    return [line for line in joined.splitlines() if line.strip() and not line.lstrip().startswith("#")]


def shown(block):
    """The documented output of a block: the block of text right after it, if there is one."""
    found = re.match(r"\s*```text\n(.*?)^```$", block.after, re.MULTILINE | re.DOTALL)
    return None if found is None else found[1]


def same_text(printed, promised):
    """Whether a text is the documented one, except for spaces; a line of three dots matches any lines."""
    pattern = "\n".join(
        r"(?:.*\n)*?.*" if line.strip() == "..." else _flexible(line) for line in promised.strip().splitlines()
    )
    plain = "\n".join(" ".join(line.split()) for line in printed.strip().splitlines())
    return re.fullmatch(pattern, plain) is not None


def _flexible(line):
    return re.escape(" ".join(line.split())).replace(r"\.\.\.", ".*")
