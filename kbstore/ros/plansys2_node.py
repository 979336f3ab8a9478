"""PlanSys2's two experts as lifecycle nodes of ROS 2, which answer from a store.

Needs rclpy and PlanSys2's messages (`plansys2_msgs`), which a ROS 2 distribution brings; a command imports it.
"""

import threading
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import rclpy
from plansys2_msgs import msg, srv
from rclpy.executors import SingleThreadedExecutor
from rclpy.lifecycle import LifecycleNode, TransitionCallbackReturn
from rclpy.qos import DurabilityPolicy, QoSProfile
from std_msgs.msg import Empty

import kbstore
from kbstore.errors import InvalidKnowledge, KbStoreError, StoreUnavailable
from kbstore.knowledge_base import KnowledgeBase
from kbstore.ros.joint_domain import joint_domain
from kbstore.ros.plansys2_domain import DomainExpert
from kbstore.ros.plansys2_problem import ProblemExpert
from kbstore.ros.plansys2_service import Expert
from kbstore.ros.ros2_node import Ros2Clock, quick_executor, spin

DEPTH = 100
"""The number of messages of a topic that wait for a slow subscriber."""

PLANNER, VALIDATION = 3.0, 1.0
"""Seconds to wait for PlanSys2's planner, and for it to validate a domain."""


def run(url: str | None, kb: str | None, arguments: Sequence[str] = ()) -> None:
    """Start both nodes, and serve until they are shut down.

    Args:
        url: the store; None: the parameter `url`.
        kb: the knowledge base; None: the parameter `kb`, or "default".
        arguments: what ROS reads from a command line: ``--ros-args -p problem_file:=... -r __ns:=/robot``.
    """
    rclpy.init(args=["kbstore", *arguments])
    nodes = [DomainExpertNode(url, kb), ProblemExpertNode(url, kb)]
    executor = quick_executor()
    for node in nodes:
        executor.add_node(node)
    try:
        spin(executor)
    finally:
        executor.shutdown()
        for node in nodes:
            node.close()
            node.destroy_node()
        rclpy.try_shutdown()


class ExpertNode(LifecycleNode, ABC):  # type: ignore[misc]
    """A lifecycle node that opens a knowledge base when it is configured, and answers an expert's services from it."""

    TYPES: dict[str, str]

    def __init__(self, name: str, url: str | None, kb: str | None) -> None:
        super().__init__(name)
        self.declare_parameter("url", url or "")
        self.declare_parameter("kb", kb or "default")
        self.declare_parameter("model_file", "")
        self._kb: KnowledgeBase | None = None
        self._expert: Expert | None = None
        for service, type_name in self.TYPES.items():
            kind = getattr(srv, type_name, None)
            # older PlanSys2 has not all of them
            if kind is not None:
                self.create_service(kind, f"{name}/{service}", self._handler(service))

    def _handler(self, service: str) -> Callable[[Any, Any], Any]:
        def answer(request: Any, response: Any) -> Any:
            expert = self._expert
            if expert is None:
                return Expert.refuse(response, f"{self.get_name()} is not configured; configure the node first")
            expert.answer(service, request, response)
            self._after(service, response)
            return response

        return answer

    def _after(self, service: str, response: Any) -> None:
        """Called after each answer; does nothing unless a node overrides it."""

    # -- transitions ------------------------------------------------------------------------------------------

    def on_configure(self, state: Any) -> Any:
        """Open the knowledge base and load the files that the parameters name; log the error of a failure."""
        try:
            self._kb = self._open()
            self._expert = self._make(self._kb)
        except KbStoreError as error:
            self.close()
            self.get_logger().error(str(error))
            return TransitionCallbackReturn.FAILURE
        self.get_logger().info(f"configured: {self._kb}")
        return super().on_configure(state)

    def on_cleanup(self, state: Any) -> Any:
        """Close the knowledge base."""
        self.close()
        return super().on_cleanup(state)

    def on_shutdown(self, state: Any) -> Any:
        """Close the knowledge base."""
        self.close()
        return super().on_shutdown(state)

    def close(self) -> None:
        """Close the knowledge base, if it is open."""
        self._expert = None
        if self._kb is not None:
            self._kb.close()
            self._kb = None

    def text(self, name: str) -> str:
        """Return a parameter's value."""
        return str(self.get_parameter(name).value)

    def _open(self) -> KnowledgeBase:
        if not self.text("url"):
            raise StoreUnavailable("which store? name it with --url FILE (or a SQLAlchemy URL), or the parameter url")
        clock = Ros2Clock(self)
        clock.wait()
        kb = kbstore.open(self.text("url"), self.text("kb"), clock=clock)
        if self.text("model_file"):
            kb.load(joint_domain(self.text("model_file")), client=self.get_name(), note="model_file")
        return kb

    @abstractmethod
    def _make(self, kb: KnowledgeBase) -> Expert:
        """Return the expert that answers from a knowledge base. Raises `KbStoreError` if it cannot."""


class DomainExpertNode(ExpertNode):
    """The node `domain_expert`."""

    TYPES = DomainExpert.TYPES

    def __init__(self, url: str | None, kb: str | None) -> None:
        super().__init__("domain_expert", url, kb)
        self.declare_parameter("validate_using_planner_node", False)

    def _make(self, kb: KnowledgeBase) -> Expert:
        domain = kb.domain_to_pddl()
        if self.get_parameter("validate_using_planner_node").value:
            self._validate(domain)
        return DomainExpert(kb, msg)

    def _validate(self, domain: str) -> None:
        """Raise `InvalidKnowledge` if PlanSys2's planner refuses the domain, `StoreUnavailable` without an answer."""
        # a node of its own, as this one waits for the answer within a callback
        asking = rclpy.create_node(f"{self.get_name()}_validation", namespace=self.get_namespace())
        executor = SingleThreadedExecutor()
        try:
            client = asking.create_client(srv.ValidateDomain, "planner/validate_domain")
            if not client.wait_for_service(timeout_sec=PLANNER):
                raise StoreUnavailable("planner/validate_domain is not there; start the planner first")
            answer = client.call_async(srv.ValidateDomain.Request(domain=domain))
            rclpy.spin_until_future_complete(asking, answer, executor, VALIDATION)
            if not answer.done():
                raise StoreUnavailable(f"planner/validate_domain has not answered within {VALIDATION:g} s")
            if not answer.result().success:
                raise InvalidKnowledge(f"the planner does not accept the domain: {answer.result().error_info}")
        finally:
            executor.shutdown()
            asking.destroy_node()


class ProblemExpertNode(ExpertNode):
    """The node `problem_expert`, with its topics."""

    TYPES = ProblemExpert.TYPES

    def __init__(self, url: str | None, kb: str | None) -> None:
        super().__init__("problem_expert", url, kb)
        self.declare_parameter("problem_file", "")
        latched = QoSProfile(depth=DEPTH, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self._updates = self.create_lifecycle_publisher(Empty, "problem_expert/update_notify", DEPTH)
        self._knowledge = self.create_lifecycle_publisher(msg.Knowledge, "problem_expert/knowledge", latched)
        self._publishing = threading.Lock()
        self._publisher = ThreadPoolExecutor(1, thread_name_prefix="knowledge")
        self._is_due = False

    def _make(self, kb: KnowledgeBase) -> ProblemExpert:
        if self.text("problem_file"):
            kb.load(None, self.text("problem_file"), once=True, client=self.get_name(), note="problem_file")
        # raises an error, as without a domain nothing can be answered
        _ = kb.domain
        return ProblemExpert(kb, msg, client=self.get_name())

    def on_activate(self, state: Any) -> Any:
        """Publish the state, for which subscribers would otherwise have to wait until the first change."""
        result = super().on_activate(state)
        self._publish()
        return result

    def close(self) -> None:
        """Close the knowledge base, if it is open, once nothing is read from it."""
        with self._publishing:
            super().close()

    def _after(self, service: str, response: Any) -> None:
        if service in ProblemExpert.CHANGING and response.success and self._knowledge.is_activated:
            self._updates.publish(Empty())
            # the caller need not wait, and changes in a row need one message
            if service not in ProblemExpert.QUIET and not self._is_due:
                self._is_due = True
                self._publisher.submit(self._publish)

    def _publish(self) -> None:
        """Publish the state as a `Knowledge`."""
        with self._publishing:
            # changes from here on may not be in the message, and need another one
            self._is_due = False
            expert = self._expert
            if not isinstance(expert, ProblemExpert):
                return
            try:
                self._knowledge.publish(expert.knowledge())
            except KbStoreError as error:
                self.get_logger().error(f"the knowledge is not published: {error}")
