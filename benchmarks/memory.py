"""Memory of a process while it ingests, which should be flat."""

import json
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

from benchmarks.report import Missing, Result
from benchmarks.settings import Settings

_STATUS = Path("/proc/self/statm")


def measure(settings: Settings) -> Iterator[Result | Missing]:
    """Measure a process when all is ingested, against half of it and a tenth."""
    if not _STATUS.exists():
        yield Missing("memory while ingesting", f"needs Linux ({_STATUS})")
        return
    count = settings.grown[-1]
    command = [sys.executable, "-m", "benchmarks.ingesting", str(settings.new("ingest")), str(count)]
    output = subprocess.run(command, check=True, capture_output=True, text=True).stdout
    held = {int(part): size for part, size in json.loads(output).items()}
    what = f"memory when {count:,} facts are ingested"
    yield Result(what, "when half of them were", held[count], held[count // 2], 1.1, "MB")
    yield Result(what, "when a tenth of them were", held[count], held[count // 10], None, "MB")
