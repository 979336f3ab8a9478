"""The command line, run in this process on the mission of the demonstration."""

import json
import shutil
from dataclasses import dataclass

import pytest
from typer.testing import CliRunner

from kbstore.cli.app import app
from kbstore.cli.demo.mission import record


@dataclass(frozen=True)
class Done:
    """The result of a command."""

    code: int
    out: str
    err: str

    @property
    def json(self):
        return json.loads(self.out)

    @property
    def words(self):
        """The output with single spaces, line by line."""
        return [" ".join(line.split()) for line in self.out.splitlines()]


@pytest.fixture(scope="session")
def recorded(tmp_path_factory):
    """A file with the mission in it, to be read only."""
    file = tmp_path_factory.mktemp("cli") / "kenny.db"
    record(f"sqlite:///{file}").close()
    return file


@pytest.fixture
def store(recorded, tmp_path):
    """A copy of the mission's file, to be written to."""
    return shutil.copy(recorded, tmp_path / "kenny.db")


@pytest.fixture
def run(monkeypatch, recorded):
    """Run ``kbstore`` with arguments, on the recorded mission unless they name another store."""
    monkeypatch.setenv("KBSTORE_URL", str(recorded))
    monkeypatch.delenv("KBSTORE_KB", raising=False)

    def running(*arguments):
        done = CliRunner().invoke(app, [str(argument) for argument in arguments], prog_name="kbstore")
        if done.exception is not None and not isinstance(done.exception, SystemExit):
            raise done.exception
        return Done(done.exit_code, done.stdout, done.stderr)

    return running
