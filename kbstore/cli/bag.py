"""Bags: ``bag import``, ``bag export``."""

from pathlib import Path
from typing import Annotated

import typer

from kbstore.cli.options import AsOf, Json, Kb, Now, Since, Until, Url, at_time, belief, reading, store
from kbstore.cli.output import answer, working
from kbstore.clock import isoformat
from kbstore.report.tables import plural

Name = Annotated[
    str | None, typer.Option("--kb", metavar="NAME", help="The knowledge base (default: the name of the bag).")
]


def import_(
    file: Annotated[Path, typer.Argument(help="A rosbag1 file, the directory of a rosbag2, or its only file.")],
    domain: Annotated[
        Path | None, typer.Option("--domain", metavar="FILE", help="The PDDL domain, which a bag does not have.")
    ] = None,
    problem: Annotated[
        Path | None, typer.Option("--problem", metavar="FILE", help="A PDDL problem that declares the objects.")
    ] = None,
    url: Url = None,
    kb: Name = None,
    as_json: Json = False,
) -> None:
    """Record what a bag of PlanSys2 or ROSPlan says in a knowledge base of its own, with the bag's times.

    The same bag again changes nothing, and an import that was interrupted goes on. Needs the extra bags, and no ROS.

    Examples:
        kbstore bag import mission.bag --url robot.db --domain domain.pddl
        kbstore bag import mission.mcap --url robot.db --kb monday
    """
    from kbstore.ros.bags.importing import import_bag

    with working(f"Reading {file}") as show:
        done = import_bag(file, store(url), kb, domain=domain, problem=problem, progress=show)
    read, recorded = plural(done.messages.total(), "message"), plural(done.transactions, "new transaction")
    sentence = f"{done.name}: {recorded} from {read} of {isoformat(done.since)} to {isoformat(done.until)}"
    answer(done.to_dict(), as_json=as_json, view=lambda: sentence)


def export(
    file: Annotated[Path, typer.Argument(help="The MCAP file to create.")],
    since: Since = None,
    until: Until = None,
    as_of: AsOf = None,
    url: Url = None,
    kb: Kb = None,
    now: Now = None,
    as_json: Json = False,
) -> None:
    """Write the record as MCAP with JSON messages, for Foxglove and Lichtblick.

    The State Transitions panel shows /facts/robot_at/kenny.value and /runs/drive/kenny.value, the Plot panel
    /numbers/battery/kenny.value. Needs the extra bags, and no ROS.

    Examples:
        kbstore bag export kenny.mcap
        kbstore bag export morning.mcap --since -4h --until -1h
    """
    from kbstore.ros.bags.mcap_file import export_mcap

    with reading(url, kb, now) as found:
        done = export_mcap(found, file, at_time(since, found), at_time(until, found), belief(as_of, found))
    sentence = f"{file} has {plural(done.messages, 'message')} on {plural(done.topics, 'topic')}"
    answer({"file": str(file), **done.to_dict()}, as_json=as_json, view=lambda: sentence)
