"""Reads PlanSys2's and ROSPlan's messages in a bag: rosbag1, or rosbag2 in SQLite or MCAP. Needs the extra `bags`."""

import errno
import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from kbstore.clock import isoformat
from kbstore.errors import InvalidKnowledge, MissingLibrary
from kbstore.ros.bags import definitions

try:
    from rosbags.highlevel import AnyReader, AnyReaderError
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore
except ImportError as error:
    raise MissingLibrary(
        f"bags need the library rosbags, which cannot be imported ({error});"
        " install it with: pip install 'kbstore[bags]'"
    ) from None

KINDS = {
    "plansys2_msgs/msg/Knowledge": "knowledge",
    "plansys2_msgs/msg/Plan": "plan",
    "plansys2_msgs/msg/ActionExecutionInfo": "info",
    "plansys2_msgs/msg/ActionExecution": "hub",
    "rosplan_dispatch_msgs/msg/ActionDispatch": "dispatch",
    "rosplan_dispatch_msgs/msg/ActionFeedback": "feedback",
}
"""The kinds of messages that report states or actions, by their types."""

PLANSYS2 = frozenset(kind for name, kind in KINDS.items() if name.startswith("plansys2"))
"""The kinds of messages that PlanSys2 publishes; ROSPlan publishes the others."""

PROBLEM = "problem_instance"
"""The last part of the name of the topic on which ROSPlan publishes problems as text."""


@dataclass(frozen=True, slots=True)
class Recorded:
    """A message of a bag: when it was recorded, in nanoseconds, on which topic, by which node where that is known."""

    time: int
    kind: str
    message: Any
    topic: str
    sender: str


class Bag:
    """An open bag."""

    def __init__(self, path: Path, reader: Any) -> None:
        self.path = path
        self._reader = reader
        kinds = {connection.topic: _kind(connection) for connection in reader.connections}
        self.topics = {topic: kind for topic, kind in kinds.items() if kind}
        """The topics that are read, with the kinds of their messages."""
        self.others = sorted(set(kinds) - set(self.topics))
        """The topics that are not."""
        if not self.topics:
            there = f"it has {', '.join(self.others)}" if self.others else "it is empty"
            raise InvalidKnowledge(f"{path} has no topic of PlanSys2 or of ROSPlan: {there}")
        if len({kind in PLANSYS2 for kind in self.topics.values()}) > 1:
            raise InvalidKnowledge(
                f"{path} has topics of PlanSys2 and of ROSPlan, {', '.join(sorted(self.topics))}; make a bag of each"
            )
        for kind in ("knowledge", "problem"):
            same = sorted(topic for topic, found in self.topics.items() if found == kind)
            if len(same) > 1:
                raise InvalidKnowledge(
                    f"{path} has several worlds, {' and '.join(same)}; a knowledge base has one, so make a bag of each"
                )

    @property
    def count(self) -> int:
        """The number of messages of these topics."""
        return sum(found.msgcount for found in self._reader.connections if found.topic in self.topics)

    def messages(self) -> Iterator[Recorded]:
        """The messages of these topics in the order of their times.

        Raises `InvalidKnowledge` for one that cannot be read.
        """
        connections = [found for found in self._reader.connections if found.topic in self.topics]
        for connection, time, data in self._reader.messages(connections=connections):
            try:
                message = self._reader.deserialize(data, connection.msgtype)
            except Exception as error:  # a damaged message may raise any error in its reader
                raise InvalidKnowledge(
                    f"{self.path}: the message on {connection.topic} at {isoformat(time)} cannot be read: {error}"
                ) from error
            sender = getattr(connection.ext, "callerid", None) or ""
            yield Recorded(time, self.topics[connection.topic], message, connection.topic, sender)


@contextmanager
def opened(path: str | os.PathLike[str]) -> Iterator[Bag]:
    """Open a bag: a rosbag1 file, the directory of a rosbag2, or its only file.

    Raises:
        FileNotFoundError: there is no such file.
        InvalidKnowledge: it is not a bag, or has neither PlanSys2's nor ROSPlan's topics.
    """
    file = Path(path)
    if not file.exists():
        raise FileNotFoundError(errno.ENOENT, os.strerror(errno.ENOENT), str(path))
    if file.is_dir() and not (file / "metadata.yaml").exists():
        # a recorder that is killed does not write it
        raise InvalidKnowledge(
            f"{path} cannot be read as a bag: it has no metadata.yaml, which the directory of a rosbag2 has once it is "
            "closed; give the .mcap or .db3 file in it"
        )
    types = get_typestore(Stores.ROS2_HUMBLE)
    for name, text in definitions.PLANSYS2.items():
        types.register(get_types_from_msg(text, name))
    try:
        reader = AnyReader([file], default_typestore=types)
        reader.open()
    except (AnyReaderError, OSError, ValueError, AssertionError) as error:
        raise InvalidKnowledge(f"{path} cannot be read as a bag: {error}") from error
    try:
        yield Bag(file, reader)
    finally:
        reader.close()


def _kind(connection: Any) -> str:
    """Return the kind of a topic's messages; empty for a topic that is not read."""
    if connection.msgtype == "std_msgs/msg/String" and connection.topic.rpartition("/")[2] == PROBLEM:
        return "problem"
    return KINDS.get(connection.msgtype, "")
