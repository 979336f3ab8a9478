"""Nodes on a ROS graph: ``ros rosplan``."""

from typing import Annotated

import typer

from kbstore.cli.options import Kb, Url

RosArguments = Annotated[
    list[str] | None,
    typer.Argument(
        metavar="ROS", help="What ROS reads: __name:=NODE, _parameter:=VALUE, /from:=/to.", show_default=False
    ),
]


def rosplan(arguments: RosArguments = None, url: Url = None, kb: Kb = None) -> None:
    """Serve a knowledge base as ROSPlan's, on ROS 1: the node rosplan_knowledge_base.

    It answers the services of ROSPlan's own node, by the node's clock, and records each caller as the client. Its
    parameters are domain_path, problem_path, use_unknowns, url and kb.

    Examples:
        kbstore ros rosplan --url robot.db _domain_path:=domain.pddl
        kbstore ros rosplan --url robot.db --kb kenny __name:=knowledge_base
    """
    from kbstore.ros.rosplan_node import run

    run(url, kb, arguments or ())
