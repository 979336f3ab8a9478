"""What a shell waits for: the CPU time of whole processes."""

import os
import resource
import subprocess
import sys
from collections.abc import Iterator, Mapping
from statistics import median

import kbstore
from benchmarks.histories import START
from benchmarks.report import Result
from benchmarks.settings import Settings
from kbstore import ManualClock

_LIBRARIES = "import sqlalchemy, pydantic"
_QUESTION = """
import sqlalchemy
from pydantic import BaseModel
heads = sqlalchemy.table("heads", sqlalchemy.column("kb_id"), sqlalchemy.column("last_time"))
with sqlalchemy.create_engine("sqlite:///{store}").connect() as connection:
    print(connection.execute(sqlalchemy.select(heads.c.last_time).where(heads.c.kb_id > 0)).scalar_one())
"""
_COMMAND = "import sys; from kbstore.cli import main; sys.argv[0] = 'kbstore'; main()"
_BAR = 0.25
"""Seconds."""


def measure(settings: Settings) -> Iterator[Result]:
    """Measure importing kbstore, and the commands that a shell calls."""
    store = settings.new("commands")
    with kbstore.open(store, "bench", clock=ManualClock(START)) as kb:
        kb.add("(robot_at kenny lab)")
    completing = {"_KBSTORE_COMPLETE": "complete_bash", "COMP_WORDS": "kbstore sta", "COMP_CWORD": "1"}
    ways: dict[str, tuple[list[str], Mapping[str, str]]] = {
        "libraries": ([_LIBRARIES], {}),
        "question": ([_QUESTION.format(store=store)], {}),
        "kbstore": (["import kbstore"], {}),
        "open": ([f"import kbstore; kbstore.open({str(store)!r}, 'bench').close()"], {}),
        "version": ([_COMMAND, "--version"], {}),
        "help": ([_COMMAND, "--help"], {}),
        "completion": ([_COMMAND], completing),
        "holds": ([_COMMAND, "holds", "(robot_at kenny lab)", "--url", str(store)], {}),
    }
    durations: dict[str, list[float]] = {name: [] for name in ways}
    for _ in range(max(3, int(9 * settings.seconds))):
        for name, (arguments, environment) in ways.items():
            durations[name].append(_cpu_time(arguments, environment))
    found = {name: median(lasting) for name, lasting in durations.items()}
    yield Result("import kbstore", _LIBRARIES, found["kbstore"], found["libraries"], 1.3)
    yield Result("import kbstore, and open a store", _LIBRARIES, found["open"], found["libraries"])
    beside = f"{_LIBRARIES}, and one select"
    yield Result("import kbstore, and open a store (a select)", beside, found["open"], found["question"])
    yield Result("kbstore holds", _LIBRARIES, found["holds"], found["libraries"], 1.3)
    yield Result("kbstore holds (a select)", beside, found["holds"], found["question"], 1.3)
    for name, what in (("version", "--version"), ("help", "--help"), ("completion", "completion of a command")):
        yield Result(f"kbstore {what}", "0.25 s", found[name], _BAR, 1)


def _cpu_time(arguments: list[str], environment: Mapping[str, str]) -> float:
    """Seconds of CPU that a Python program takes, its start included."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    command = [sys.executable, "-c", *arguments]
    subprocess.run(command, env={**_environment(), **environment}, stdout=subprocess.DEVNULL, check=False)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def _environment() -> dict[str, str]:
    """Ours, but bytecode may be written: kbstore would be compiled each time, where pip has compiled the libraries."""
    return {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
