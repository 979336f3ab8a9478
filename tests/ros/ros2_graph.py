"""A graph of ROS 2 on loopback for the tests: nodes of kbstore in separate processes, and clients in this one."""

import os
import signal
import subprocess
import sys
import threading
import time
from contextlib import contextmanager

import rclpy
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState, GetState
from rclpy.callback_groups import ReentrantCallbackGroup

from kbstore.ros.ros2_node import quick_executor, spin

KBSTORE = sys.executable, "-c", "from kbstore.cli import main; main()"
PATIENCE = 60
"""Timeout in seconds for events that should come at once; the machine may be busy."""

CONFIGURE, CLEANUP = Transition.TRANSITION_CONFIGURE, Transition.TRANSITION_CLEANUP
ACTIVATE, DEACTIVATE = Transition.TRANSITION_ACTIVATE, Transition.TRANSITION_DEACTIVATE
SHUTDOWN = Transition.TRANSITION_UNCONFIGURED_SHUTDOWN


def until(is_so, limit=PATIENCE):
    """Wait until a function returns something true, and return it."""
    end = time.monotonic() + limit
    while not (found := is_so()):
        assert time.monotonic() < end, "this has not come"
        time.sleep(0.02)
    return found


@contextmanager
def graph(name="tester"):
    """A node of this process, which is spun in a thread; it ends before ROS does."""
    rclpy.init()
    node, executor, is_over = rclpy.create_node(name), quick_executor(), threading.Event()
    executor.add_node(node)
    thread = threading.Thread(target=spin, args=[executor, is_over.is_set])
    thread.start()
    try:
        yield Tester(node)
    finally:
        is_over.set()
        thread.join()
        executor.shutdown()
        node.destroy_node()
        rclpy.shutdown()


class Tester:
    """Calls services, and stores the messages of topics."""

    def __init__(self, node):
        self.node = node
        self.group = ReentrantCallbackGroup()
        self._clients = {}

    def client(self, kind, name):
        """The client of a service, once it is there."""
        if name not in self._clients:
            self._clients[name] = self.node.create_client(kind, name, callback_group=self.group)
        found = self._clients[name]
        assert found.wait_for_service(PATIENCE), f"{name} is not there"
        return found

    def gone(self, node):
        """Wait until a lifecycle node is gone: a killed one stays known for a while."""
        until(lambda: not self.node.count_services(f"/{node}/get_state"))

    def call(self, kind, name, **fields):
        """The response of a service."""
        found = self.client(kind, name).call(kind.Request(**fields), timeout_sec=PATIENCE)
        assert found is not None, f"{name} has not answered"
        return found

    def change(self, node, transition):
        """Whether a lifecycle node makes a transition."""
        request = ChangeState.Request()
        request.transition.id = transition
        return self.call(ChangeState, f"{node}/change_state", transition=request.transition).success

    def state(self, node):
        """The name of a lifecycle node's state."""
        return self.call(GetState, f"{node}/get_state").current_state.label

    def received(self, kind, topic, quality=100):
        """A list that grows with the messages of a topic."""
        found = []
        self.node.create_subscription(kind, topic, found.append, quality, callback_group=self.group)
        return found


@contextmanager
def running(log, *arguments):
    """A command of kbstore in a separate process; stopped by SIGINT, as by a launch file."""
    with open(log, "a") as output:
        process = subprocess.Popen(
            [*KBSTORE, *map(str, arguments)], stdout=output, stderr=output, env={**os.environ, "PYTHONUNBUFFERED": "1"}
        )
    try:
        yield process
    finally:
        if process.poll() is None:
            process.send_signal(signal.SIGINT)
            try:
                assert process.wait(PATIENCE / 3) == 0, log.read_text()
            finally:
                process.kill()


@contextmanager
def empty_service(kind, name):
    """A node in a separate process that answers at once: the cost of a call without computing an answer."""
    process = subprocess.Popen([sys.executable, "-m", __spec__.name, kind, name])
    try:
        yield
    finally:
        process.send_signal(signal.SIGINT)
        process.wait(PATIENCE)


def serve_nothing(kind, name):
    """Answer a service of PlanSys2 with an empty response, until interrupted."""
    from plansys2_msgs import srv

    rclpy.init()
    node = rclpy.create_node("nothing")
    node.create_service(getattr(srv, kind), name, lambda request, response: response)
    executor = quick_executor()
    executor.add_node(node)
    spin(executor)


if __name__ == "__main__":
    serve_nothing(*sys.argv[1:])
