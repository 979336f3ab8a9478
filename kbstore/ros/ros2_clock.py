"""The clock of a ROS 2 node."""

import time
from typing import Any

WAIT = 5.0
"""Seconds to wait for the first message of a simulator's clock."""


class NodeClock:
    """The clock of a ROS 2 node: with `use_sim_time` the simulator's, otherwise the machine's."""

    def __init__(self, node: Any) -> None:
        self._node = node

    def now(self) -> int:
        """Return the node's time in nanoseconds."""
        return int(self._node.get_clock().now().nanoseconds)

    def wait(self) -> None:
        """Wait until a simulator tells a time, at most for `WAIT`: before, the time is 0."""
        if self._node.get_parameter("use_sim_time").value and not self.now():
            self._node.get_logger().info("waiting for the first message on /clock, as use_sim_time is set")
            deadline = time.monotonic() + WAIT
            while not self.now() and time.monotonic() < deadline:
                time.sleep(0.01)
