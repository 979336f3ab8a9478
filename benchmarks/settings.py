"""The size and length of a run, and the directory of its stores."""

from dataclasses import dataclass
from pathlib import Path

from benchmarks.filling import fill
from benchmarks.histories import History

_FILES = ("", "-wal", "-shm")


@dataclass(frozen=True)
class Settings:
    """One run.

    Attributes:
        directory: where the stores are made.
        size: assertions in the histories that are asked about.
        bulk: facts in a bulk update.
        init: init facts of the problems that are loaded.
        intervals: lengths of the history of the fact that `when` is asked about.
        seconds: how long each comparison goes on.
        peers: assertions in the histories that peers are told.
        peers_bulk: facts in a bulk update that peers do, too.
        grown: sizes of the histories that show growth; also how many items are ingested while memory is watched.
        postgresql: the URL of a server; None to start one.
    """

    directory: Path
    size: int
    bulk: int
    init: tuple[int, ...]
    intervals: tuple[int, ...]
    seconds: float
    peers: int
    peers_bulk: int
    grown: tuple[int, ...]
    postgresql: str | None

    def new(self, name: str) -> Path:
        """Return a path in the directory at which there is no database yet."""
        path = self.directory / f"{name}.db"
        for suffix in _FILES:
            path.with_name(path.name + suffix).unlink(missing_ok=True)
        return path

    def store(self, history: History) -> Path:
        """The store with a history; it is created once."""
        path = self.directory / f"{history.shape.replace(' ', '-')}-{history.size}.db"
        if not path.exists():
            fill(history, path)
        return path
