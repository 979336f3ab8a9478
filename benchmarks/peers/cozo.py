"""CozoDB: a relation whose key ends with a `Validity`, read with ``@``, as its chapter on time travel advises."""

from collections.abc import Iterable
from itertools import islice
from pathlib import Path
from typing import Any

from cozo_embedded import CozoDbPy  # type: ignore[import-untyped]

from benchmarks.peers.peer import Change, Standing

_BATCH = 20_000
"""Rows in one import."""

_PUT = "?[key, at, is_negative] <- $rows :put facts {key, at => is_negative}"


class Cozo:
    """Facts by key and validity; Cozo's times are microseconds."""

    def __init__(self, path: Path, engine: str) -> None:
        # by strace: the engine rocksdb makes no system call that waits for the disk when it commits
        self.durable = engine == "sqlite"
        self._database: Any = CozoDbPy(engine, str(path), "{}")
        self._run(":create facts {key: String, at: Validity => is_negative: Bool}", {})

    def _run(self, script: str, parameters: dict[str, Any], *, reading: bool = False) -> list[list[Any]]:
        rows: list[list[Any]] = self._database.run_script(script, parameters, reading)["rows"]
        return rows

    def tell(self, changes: Iterable[Change]) -> None:
        """By the import that bypasses the query language."""
        rows = (_row(change) for change in changes)
        while batch := list(islice(rows, _BATCH)):
            relation = {"headers": ["key", "at", "is_negative"], "rows": batch}
            self._database.import_relations({"facts": relation})

    def state(self, t: int) -> Standing:
        """The relation at a time."""
        found = self._run("?[key, is_negative] := *facts{key, is_negative @ $t}", {"t": t // 1000}, reading=True)
        return dict(found)

    def point(self, key: str, t: int) -> bool:
        """One key at a time."""
        script = "?[is_negative] := *facts{key: $key, is_negative @ $t}"
        found = self._run(script, {"key": key, "t": t // 1000}, reading=True)
        return bool(found) and not found[0][0]

    def write(self, change: Change) -> None:
        """A row that asserts from a time on."""
        self._run(_PUT, {"rows": [_row(change)]})

    def bulk(self, keys: list[str], t: int) -> None:
        """All rows in one statement."""
        self._run(_PUT, {"rows": [[key, [t // 1000, True], False] for key in keys]})

    def close(self) -> None:
        """Close the database."""
        self._database.close()


def _row(change: Change) -> list[Any]:
    return [change.key, [change.time // 1000, change.is_negative is not None], bool(change.is_negative)]
