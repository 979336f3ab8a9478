"""The recorder beside a running PlanSys2."""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

ARGUMENTS = {
    "url": ("The store: an SQLite file, or a SQLAlchemy URL", "robot.db"),
    "kb": ("The knowledge base that is to follow PlanSys2", "default"),
    "namespace": ("The namespace of PlanSys2", ""),
    "use_sim_time": ("Whether the simulator tells the time", "false"),
}


def generate_launch_description():
    """Start the recorder, and start it again if it ends."""
    value = {name: LaunchConfiguration(name) for name in ARGUMENTS}
    return LaunchDescription(
        [
            *(
                DeclareLaunchArgument(name, description=text, default_value=default)
                for name, (text, default) in ARGUMENTS.items()
            ),
            Node(
                package="kbstore_ros",
                executable="record",
                namespace=value["namespace"],
                output="screen",
                respawn=True,
                respawn_delay=5.0,
                arguments=["--url", value["url"], "--kb", value["kb"]],
                parameters=[{"use_sim_time": value["use_sim_time"]}],
            ),
        ]
    )
