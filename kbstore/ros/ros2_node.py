"""Shared by kbstore's ROS 2 nodes: their clock, and an executor that answers quickly. Needs rclpy."""

from collections.abc import Callable
from typing import Any

import rclpy
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.qos import qos_profile_sensor_data
from rclpy.wait_for_message import wait_for_message
from rosgraph_msgs.msg import Clock

LOOK = 0.5
"""Seconds between two checks whether to stop, while nothing happens."""

WAIT = 5.0
"""Seconds to wait for the first message of a simulator's clock."""


def quick_executor() -> Any:
    """Return rclpy's event-driven executor; a `SingleThreadedExecutor` if this rclpy has none.

    Other executors look through all entities of a node after each event, which takes longer than most answers.
    """
    try:
        from rclpy.experimental import EventsExecutor
    except ImportError:
        return SingleThreadedExecutor()
    return EventsExecutor()


def spin(executor: Any, is_done: Callable[[], bool] = lambda: False) -> None:
    """Serve until a signal shuts ROS down, or `is_done` returns true; an executor's own `spin` may miss a signal."""
    try:
        while rclpy.ok() and not is_done():
            executor.spin_once(timeout_sec=LOOK)
    except (KeyboardInterrupt, ExternalShutdownException):
        pass


class Ros2Clock:
    """The clock of a ROS 2 node: with `use_sim_time` the simulator's, otherwise the machine's."""

    def __init__(self, node: Any) -> None:
        self._node = node
        self._first = 0

    def now(self) -> int:
        """Return the node's time in nanoseconds."""
        found = int(self._node.get_clock().now().nanoseconds)
        if found:
            self._first = 0
        return found or self._first

    def wait(self) -> None:
        """Wait for a simulator's first time, at most `WAIT` seconds; on a node of its own, as callbacks get none."""
        if not self._node.get_parameter("use_sim_time").value or self.now():
            return
        self._node.get_logger().info("waiting for the first message on /clock, as use_sim_time is set")
        asking = rclpy.create_node(f"{self._node.get_name()}_clock")
        try:
            quality = qos_profile_sensor_data
            is_there, message = wait_for_message(Clock, asking, "/clock", qos_profile=quality, time_to_wait=WAIT)
        finally:
            asking.destroy_node()
        if is_there:
            self._first = message.clock.sec * 10**9 + message.clock.nanosec
