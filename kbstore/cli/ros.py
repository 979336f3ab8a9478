"""Nodes on a ROS graph: ``ros plansys2``, ``ros record``, ``ros rosplan``."""

from typing import Annotated

import typer

from kbstore.cli.options import Kb, Url, store
from kbstore.errors import MissingLibrary

Ros2Arguments = Annotated[
    list[str] | None,
    typer.Argument(metavar="ROS", help="What ROS reads: --ros-args -p NAME:=VALUE -r FROM:=TO.", show_default=False),
]

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


def plansys2(arguments: Ros2Arguments = None, url: Url = None, kb: Kb = None) -> None:
    """Take the place of PlanSys2's problem expert and domain expert, on ROS 2.

    Both are lifecycle nodes, which PlanSys2's bringup configures and activates. Their parameters are model_file,
    problem_file, url and kb. Started again, they go on where they were.

    Examples:
        kbstore ros plansys2 --url robot.db --kb kenny
        kbstore ros plansys2 --ros-args -p model_file:=domain.pddl
    """
    given = _of_ros(arguments)
    try:
        from kbstore.ros.plansys2_node import run
    except ImportError as error:
        raise _needs("PlanSys2's experts need", error) from None
    run(url, kb, given)


def record(
    arguments: Ros2Arguments = None,
    domain: Annotated[
        str | None, typer.Option(metavar="FILE", help="The domain (default: what PlanSys2's domain expert says).")
    ] = None,
    problem: Annotated[
        str | None, typer.Option(metavar="FILE", help="A problem that declares objects with their types.")
    ] = None,
    url: Url = None,
    kb: Kb = None,
) -> None:
    """Record a running PlanSys2, on ROS 2: what it knows, its goals, plans, and the actions that it executes.

    It listens beside PlanSys2 and changes nothing of it. Stopped and started again, it goes on. Do not write anything
    else to this knowledge base: it becomes what PlanSys2 says.

    Examples:
        kbstore ros record --url robot.db --kb kenny
        kbstore ros record --url robot.db --ros-args -r __ns:=/kenny
    """
    given, place = _of_ros(arguments), store(url)
    try:
        from kbstore.ros.recorder_node import run
    except ImportError as error:
        raise _needs("the recorder needs", error) from None
    run(place, kb or "default", domain, problem, given)


def _of_ros(arguments: list[str] | None) -> list[str]:
    """Return ROS's own arguments. Anything before --ros-args is a mistake, which ROS would not notice."""
    if arguments and arguments[0] != "--ros-args":
        raise typer.BadParameter(f"there is no option {arguments[0]}; what ROS reads comes after --ros-args")
    return arguments or []


def _needs(who: str, error: ImportError) -> MissingLibrary:
    return MissingLibrary(
        f"{who} rclpy and plansys2_msgs, of which one cannot be imported ({error}); set up the shell for ROS 2 and "
        "for PlanSys2's workspace (source install/setup.bash), and install kbstore for the same Python"
    )
