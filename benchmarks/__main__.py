"""``python -m benchmarks``: one run, one table for each kind of work."""

import argparse
import os
import tempfile
import time
from pathlib import Path

from rich.console import Console

from benchmarks import (
    commands,
    courses,
    growth,
    loads,
    memory,
    points,
    postgresql,
    questions,
    sizes,
    states,
    views,
    writes,
)
from benchmarks.page import filled
from benchmarks.peers import comparing
from benchmarks.report import Missing, Result, show
from benchmarks.settings import Settings

_TABLES = {
    "Asking": {
        "questions": questions.measure,
        "points": points.measure,
        "states": states.measure,
        "when": courses.measure,
        "views": views.measure,
        "commands": commands.measure,
    },
    "Writing": {"writes": writes.measure, "loads": loads.measure},
    "PostgreSQL": {"postgresql": postgresql.measure},
    "Growth": {"growth": growth.measure, "sizes": sizes.measure, "memory": memory.measure},
    "Peers": {"peers": comparing.measure},
}
"""The tables, and the parts that give their rows."""

_PARTS = [part for parts in _TABLES.values() for part in parts]


def main() -> None:
    """Run the benchmarks that are asked for, and print the tables."""
    arguments = _arguments()
    console = Console(width=None if Console().is_terminal else 140)
    began = time.monotonic()
    tables: dict[str, list[Result | Missing]] = {title: [] for title in _TABLES}
    with tempfile.TemporaryDirectory(prefix="kbstore-bench-", dir=arguments.directory) as directory:
        settings = _settings(Path(directory), arguments)
        for title, parts in _TABLES.items():
            for name, measure in parts.items():
                for result in measure(settings) if name in (arguments.only or _PARTS) else ():
                    console.print(f"{time.monotonic() - began:5.0f} s  {result}")
                    tables[title].append(result)
    for title, results in tables.items():
        if results:
            show(results, console, title)
    if arguments.page:
        page, missing = filled(arguments.page.read_text(), tables)
        arguments.page.write_text(page)
        for row in missing:
            console.print(f"not measured, so that its table was left as it is: {row}")
    loads_now = ", ".join(f"{load:.1f}" for load in os.getloadavg())
    console.print(f"{time.monotonic() - began:.0f} s; {os.cpu_count()} cores, load averages at the end {loads_now}")


def _settings(directory: Path, arguments: argparse.Namespace) -> Settings:
    if arguments.quick:
        return Settings(
            directory,
            size=arguments.size or 20_000,
            bulk=5_000,
            init=(1_000, 10_000),
            intervals=(10, 1_000, 10_000),
            seconds=0.2,
            peers=5_000,
            peers_bulk=1_000,
            grown=(2_000, 20_000),
            postgresql=arguments.postgresql,
        )
    return Settings(
        directory,
        size=arguments.size or 1_000_000,
        bulk=50_000,
        init=(1_000, 10_000, 100_000),
        intervals=(10, 100, 1_000, 10_000, 100_000),
        seconds=1.0,
        peers=100_000,
        peers_bulk=10_000,
        grown=(10_000, 100_000, 1_000_000, *((10_000_000,) if arguments.large else ())),
        postgresql=arguments.postgresql,
    )


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python -m benchmarks", description=__doc__)
    parser.add_argument("--quick", action="store_true", help="small sizes, less than a minute")
    parser.add_argument("--size", type=int, help="assertions in the histories that are asked about")
    parser.add_argument(
        "--large", action="store_true", help="growth up to ten million assertions (10 GB, half an hour)"
    )
    parser.add_argument("--postgresql", metavar="URL", help="a server to measure on; one is started if none is named")
    parser.add_argument("--directory", type=Path, help="where to make the stores (they are removed afterwards)")
    parser.add_argument("--page", type=Path, metavar="FILE", help="fill the tables of docs/performance.md")
    parser.add_argument("--only", nargs="+", choices=_PARTS, help="only these parts")
    return parser.parse_args()


if __name__ == "__main__":
    main()
