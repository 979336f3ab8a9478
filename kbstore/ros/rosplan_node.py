"""ROSPlan's knowledge base as a ROS 1 node: its services and its topic, served from a store.

Needs rospy and the messages of ROSPlan (`rosplan_knowledge_msgs`), which a ROS 1 distribution brings.
"""

import gc
import importlib
import struct
from collections.abc import Callable, Sequence
from io import BytesIO
from typing import Any

import kbstore
from kbstore.errors import KbStoreError, MissingLibrary, StoreUnavailable
from kbstore.knowledge_base import KnowledgeBase
from kbstore.ros.rosplan import SERVICES, RosplanServices

NAME = "rosplan_knowledge_base"
"""The node's default name, which ROSPlan's own nodes expect; ``__name:=`` gives another."""

QUEUE = 100
"""The number of messages that wait for a slow subscriber."""

ANSWER = "GetAttributeServiceResponse"
"""The type of the responses with many items."""

_MESSAGES = ("rosplan_knowledge_msgs.msg", "rosplan_knowledge_msgs.srv", "diagnostic_msgs.msg", "std_srvs.srv")


class Ros1Clock:
    """The clock of a ROS 1 node: the simulator's with ``use_sim_time``, otherwise the machine's."""

    def __init__(self, rospy: Any) -> None:
        self._rospy = rospy

    def now(self) -> int:
        """Return the node's time in nanoseconds."""
        return int(self._rospy.get_rostime().to_nsec())

    def wait(self) -> None:
        """Wait until the clock has a time; a simulated clock has none before its first message."""
        if not self._rospy.is_shutdown() and not self.now():
            self._rospy.loginfo("waiting for the first message on /clock, as use_sim_time is set")
        while not self._rospy.is_shutdown() and not self.now():
            self._rospy.rostime.wallsleep(0.01)


def run(url: str | None, kb: str | None, arguments: Sequence[str] = ()) -> None:
    """Start the node, and serve until it is shut down.

    Args:
        url: the store; None: the parameter ``~url``.
        kb: the knowledge base; None: the parameter ``~kb``, or "default".
        arguments: what ROS reads from a command line: ``__name:=...``, ``_problem_path:=...``, ``/from:=/to``.

    Raises:
        MissingLibrary: rospy or ROSPlan's messages cannot be imported.
        StoreUnavailable: no store is named, or it cannot be reached.
        KbStoreError: the domain or the problem cannot be loaded.
    """
    rospy, *packages = map(_library, ("rospy", *_MESSAGES))
    rospy.init_node(NAME, argv=[NAME, *arguments])
    place = url or rospy.get_param("~url", "")
    if not place:
        raise StoreUnavailable("which store? name it with --url FILE (or a SQLAlchemy URL), or the parameter ~url")
    clock = Ros1Clock(rospy)
    clock.wait()
    name, use_unknowns = kb or rospy.get_param("~kb", "default"), rospy.get_param("~use_unknowns", None)
    with kbstore.open(place, name, clock=clock, use_unknowns=use_unknowns) as opened:
        _load(rospy, opened)
        _serve(rospy, opened, _Types(packages))
        gc.freeze()  # so that the garbage collector does not go through all imported objects again and again
        rospy.loginfo("ready: %s in %s", name, opened)
        rospy.spin()


def _load(rospy: Any, kb: KnowledgeBase) -> None:
    """Load the files that the parameters name, unless they were loaded before: a restart continues with the state."""
    domain = rospy.get_param("~domain_path", rospy.get_param("/rosplan/domain_path", ""))
    problem = rospy.get_param("~problem_path", "")
    if domain or problem:
        kb.load(domain or None, problem or None, once=True, client=rospy.get_name(), note="loaded at the start")


class _Types:
    """The types of messages and services, by name."""

    def __init__(self, packages: Sequence[Any]) -> None:
        self._packages = packages
        self._found: dict[str, Any] = {}
        item, answer = self("KnowledgeItem"), self(ANSWER)
        self._found |= {"KnowledgeItem": _item(item), ANSWER: _answer(answer)}

    def __call__(self, name: str) -> Any:
        found = self._found.get(name)
        if found is None:
            found = next(getattr(package, name) for package in self._packages if hasattr(package, name))
            self._found[name] = found
        return found

    def make(self, name: str) -> Any:
        return self(name)()


def _item(kind: Any) -> Any:
    """Return a subclass of KnowledgeItem that is serialized once; an item must not be changed after that."""

    class Item(kind):  # type: ignore[misc]
        serialized = b""

        def serialize(self, buff: Any) -> None:
            if not self.serialized:
                own = BytesIO()
                super().serialize(own)
                self.serialized = own.getvalue()
            buff.write(self.serialized)

    return Item


def _answer(kind: Any) -> Any:
    """Return a subclass of a response that serializes item by item; genpy's writes all their fields each time."""

    class ServiceAnswer(kind):  # type: ignore[misc]
        def serialize(self, buff: Any) -> None:
            buff.write(struct.pack("<I", len(self.attributes)))
            for item in self.attributes:
                item.serialize(buff)

    return ServiceAnswer


def _serve(rospy: Any, kb: KnowledgeBase, types: _Types) -> None:
    """Advertise the services and the topic."""
    status = rospy.Publisher("~status/update", types("StatusUpdate"), queue_size=QUEUE)
    services = RosplanServices(kb, types.make, publish=status.publish, report=rospy.logerr)

    def handler(service: str) -> Callable[[Any], Any]:
        def answer(request: Any) -> Any:
            try:
                return services.call(service, request, request._connection_header["callerid"])
            except KbStoreError as error:
                # the caller gets the message; `from None` keeps a traceback out of the log
                raise rospy.ServiceException(str(error)) from None

        return answer

    for service, type_name in SERVICES.items():
        rospy.Service(f"~{service}", types(type_name), handler(service))


def _library(name: str) -> Any:
    try:
        return importlib.import_module(name)
    except ImportError as error:
        raise MissingLibrary(
            f"ROSPlan's node needs {name}, which cannot be imported ({error}); set up the shell for ROS 1 and for "
            "ROSPlan's workspace (source devel/setup.bash), and install kbstore for the same Python"
        ) from None
