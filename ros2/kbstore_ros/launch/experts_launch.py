"""PlanSys2's problem expert and domain expert from a store: include it instead of the launch files of the two."""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

ARGUMENTS = {
    "url": ("The store: an SQLite file, or a SQLAlchemy URL", "robot.db"),
    "kb": ("The knowledge base", "default"),
    "model_file": ("The domain; several files with colons between", ""),
    "problem_file": ("The problem to load at the first start", ""),
    "namespace": ("The namespace of both nodes", ""),
    "use_sim_time": ("Whether the simulator tells the time", "false"),
}


def generate_launch_description():
    """Start one process with both lifecycle nodes, which PlanSys2's bringup configures and activates."""
    value = {name: LaunchConfiguration(name) for name in ARGUMENTS}
    parameters = {name: value[name] for name in ("model_file", "problem_file", "use_sim_time")}
    return LaunchDescription(
        [
            *(
                DeclareLaunchArgument(name, description=text, default_value=default)
                for name, (text, default) in ARGUMENTS.items()
            ),
            Node(
                package="kbstore_ros",
                executable="experts",
                namespace=value["namespace"],
                output="screen",
                arguments=["--url", value["url"], "--kb", value["kb"]],
                parameters=[parameters],
            ),
        ]
    )
