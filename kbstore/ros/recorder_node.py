"""A ROS 2 node that records a running PlanSys2 in a knowledge base, and changes nothing in PlanSys2.

Received messages are queued; of several snapshots in the queue only the latest is recorded. Needs rclpy and PlanSys2's
messages (`plansys2_msgs`), which a ROS 2 distribution brings; a command imports it.
"""

import threading
import time
from collections import deque
from collections.abc import Callable, Sequence
from typing import Any

import rclpy
from plansys2_msgs import msg, srv
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from std_msgs.msg import Empty

import kbstore
from kbstore.clock import ManualClock
from kbstore.errors import ClockJumped, ClockWentBackwards, KbStoreError, StoreUnavailable, UnknownSymbol
from kbstore.knowledge_base import KnowledgeBase
from kbstore.ros.joint_domain import joint_domain
from kbstore.ros.mirror import Mirror
from kbstore.ros.ros2_node import Ros2Clock, quick_executor, spin

NAME = "kbstore_recorder"

DEPTH = 100
"""The number of messages of a topic that wait to be received."""

ANSWER = 1.0
"""Seconds that PlanSys2's experts have to answer a question."""

SETTLED = 0.05
"""Seconds to wait after `update_notify` for a `Knowledge`, which makes it needless to ask for the functions."""

HISTORY = 0.3
"""Seconds without another `Knowledge` after which the first one counts as the latest: a late subscriber gets older
ones first."""

LATEST = 1.0
"""Seconds after which it counts as the latest even if others keep coming."""

AGAIN = 1.0
"""Seconds between two attempts to record while the store cannot be reached."""

FATAL = (ClockJumped, ClockWentBackwards)
"""The errors after which no later message could be recorded either."""


def run(url: str, kb: str, domain: str | None, problem: str | None, arguments: Sequence[str] = ()) -> None:
    """Record until the node is shut down.

    Args:
        url: the store.
        kb: the knowledge base; it is created if there is none.
        domain: path of the domain; None: what the domain expert answers, or the knowledge base has.
        problem: path of a problem that declares objects; None: the problem expert is asked for their types.
        arguments: what ROS reads from a command line: ``--ros-args -r __ns:=/robot``.

    Raises:
        ClockWentBackwards, ClockJumped: the node's clock is before, or far after, what has been recorded.
        StoreUnavailable: the store cannot be reached at the start.
    """
    rclpy.init(args=["kbstore", *arguments])
    node = Node(NAME)
    executor = quick_executor()
    executor.add_node(node)
    clock = ManualClock()
    try:
        with kbstore.open(url, kb, clock=clock) as opened:
            recorder = MessageRecorder(node, opened, clock, domain, problem)
            worker = threading.Thread(target=recorder.work, args=[executor.wake], name="recorder")
            worker.start()
            try:
                spin(executor, lambda: recorder.failure is not None)
            finally:
                recorder.stop()
                worker.join()
            if recorder.failure is not None:
                raise recorder.failure
    finally:
        executor.shutdown()
        node.destroy_node()
        rclpy.try_shutdown()


class MessageRecorder:
    """Receives messages in the executor's thread, and records them in a thread of its own (`work`)."""

    def __init__(
        self, node: Any, kb: KnowledgeBase, clock: ManualClock, domain: str | None, problem: str | None
    ) -> None:
        self.failure: Exception | None = None
        self._node, self._kb, self._clock = node, kb, clock
        self._domain, self._problem = domain, problem
        self._log = node.get_logger()
        self._time = Ros2Clock(node)
        self._ready = threading.Condition()
        self._waiting: deque[tuple[str, Any, int]] = deque()
        self._is_stopping = False
        self._logged = ""
        self._instances: frozenset[str] = frozenset()
        self._is_latest = False
        self._snapshots = 0
        latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        for topic, kind, quality, handler in (
            ("problem_expert/knowledge", msg.Knowledge, latched, "knowledge"),
            ("problem_expert/update_notify", Empty, DEPTH, "notify"),
            ("executing_plan", msg.Plan, latched, "plan"),
            ("action_execution_info", msg.ActionExecutionInfo, DEPTH, "info"),
            ("actions_hub", msg.ActionExecution, DEPTH, "hub"),
        ):
            node.create_subscription(kind, topic, self._receiver(handler), quality)
        self._ask_domain = node.create_client(srv.GetDomain, "domain_expert/get_domain")
        self._ask_instances = node.create_client(srv.GetProblemInstances, "problem_expert/get_problem_instances")
        self._ask_functions = node.create_client(srv.GetStates, "problem_expert/get_problem_functions")

    def _receiver(self, kind: str) -> Callable[[Any], None]:
        def receive(message: Any) -> None:
            with self._ready:
                if kind in ("knowledge", "notify"):
                    # only the latest counts, in its own place
                    self._waiting = deque(entry for entry in self._waiting if entry[0] not in (kind, "notify"))
                self._snapshots += kind == "knowledge"
                self._waiting.append((kind, message, self._time.now()))
                self._ready.notify()

        return receive

    def stop(self) -> None:
        """End `work` once it has recorded the current message."""
        with self._ready:
            self._is_stopping = True
            self._ready.notify()

    # -- recording --------------------------------------------------------------------------------------------

    def work(self, wake: Callable[[], Any]) -> None:
        """Record what is received until `stop`, or until an error that no later message can mend; then call `wake`."""
        try:
            mirror = self._open_mirror()
            while mirror is not None and (entry := self._next()) is not None:
                try:
                    self._record(mirror, *entry)
                except FATAL:
                    raise
                except StoreUnavailable as error:
                    self._warn(f"waiting for the store: {error}")
                    self._put_back(entry)
                except KbStoreError as error:
                    self._warn(f"not recorded: {error}")
        except Exception as error:
            # any error at all: a recorder that does not record must not look as if it did
            self.failure = error
        wake()

    def _next(self) -> tuple[str, Any, int] | None:
        with self._ready:
            self._ready.wait_for(lambda: self._waiting or self._is_stopping)
            if not self._is_stopping and len(self._waiting) == 1 and self._waiting[0][0] == "notify":
                # a Knowledge that follows has the functions, too
                self._ready.wait_for(lambda: len(self._waiting) > 1 or self._is_stopping, SETTLED)
            end = time.monotonic() + LATEST
            while not self._is_stopping and not self._is_latest and self._waiting[0][0] == "knowledge":
                has_newer = self._ready.wait_for(self._is_newer(self._snapshots), HISTORY)
                self._is_latest = not has_newer or time.monotonic() > end
            return None if self._is_stopping else self._waiting.popleft()

    def _put_back(self, entry: tuple[str, Any, int]) -> None:
        """Put an entry back at the front, unless a later snapshot has replaced it, and wait before the next attempt."""
        with self._ready:
            if entry[0] not in ("knowledge", "notify") or all(kind != "knowledge" for kind, *_ in self._waiting):
                self._waiting.appendleft(entry)
            self._ready.wait_for(lambda: self._is_stopping, AGAIN)

    def _is_newer(self, before: int) -> Callable[[], bool]:
        return lambda: self._snapshots > before or self._is_stopping

    def _open_mirror(self) -> Mirror | None:
        """Wait until the domain is known, and return the mirror; None if `stop` comes first."""
        while not self._is_stopping:
            if not self._time.now():
                self._warn("waiting for the first message on /clock, as use_sim_time is set")
                time.sleep(SETTLED)
                continue
            domain = None if self._domain is None else joint_domain(self._domain)
            if domain is None and (answer := self._ask(self._ask_domain, srv.GetDomain.Request(), ANSWER)):
                domain = answer.domain
            try:
                self._clock.set(self._time.now())
                return Mirror(self._kb, self._clock, domain=domain, problem=self._problem)
            except UnknownSymbol:
                self._warn("waiting for domain_expert/get_domain; --domain names the domain without it")
                time.sleep(SETTLED)
        return None

    def _record(self, mirror: Mirror, kind: str, message: Any, received: int) -> None:
        # a message received before the first time of a simulator's clock has the time 0
        now = received or self._time.now()
        match kind:
            case "knowledge":
                self._snapshot(mirror, message, now)
            case "notify":
                answer = self._ask(self._ask_functions, srv.GetStates.Request())
                if answer is not None:
                    mirror.functions(answer.states, now)
            case "plan":
                mirror.plan(message)
            case "info":
                mirror.action_execution_info(message, now)
            case "hub":
                mirror.actions_hub(message, now)

    def _snapshot(self, mirror: Mirror, message: Any, now: int) -> None:
        names = frozenset(message.instances)
        if not names <= self._instances:
            answer = self._ask(self._ask_instances, srv.GetProblemInstances.Request())
            if answer is not None:
                mirror.give_types(answer.instances)
        values = self._ask(self._ask_functions, srv.GetStates.Request()) if message.functions else None
        mirror.knowledge(message, now, () if values is None else values.states)
        self._instances = names

    def _ask(self, client: Any, request: Any, patience: float = 0.0) -> Any:
        """Return the answer of a PlanSys2 expert; None if it is not there, refuses, or is slower than `ANSWER`."""
        try:
            if not client.service_is_ready() and not (patience and client.wait_for_service(timeout_sec=patience)):
                return None
            future = client.call_async(request)
        except RuntimeError:
            if rclpy.ok():
                raise
            # a signal has shut ROS down, and `stop` follows
            return None
        done = threading.Event()
        future.add_done_callback(lambda _: done.set())
        if not done.wait(ANSWER) or not future.result().success:
            client.remove_pending_request(future)
            return None
        return future.result()

    def _warn(self, text: str) -> None:
        """Log a warning, unless it is the same as the last one."""
        if text != self._logged:
            self._logged = text
            self._log.warning(text)
