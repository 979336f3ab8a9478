"""Bags made by rosbags, of both versions, and an hour of a mission to put into them."""

from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from kbstore.clock import SECOND

KNOWLEDGE = "string[] instances\nstring[] predicates\nstring[] functions\nstring goal\n"
PLAN_ITEM = "float32 time\nstring action\nfloat32 duration\n"
INFO = """
int8 status
{time} start_stamp
{time} status_stamp
string action_full_name
string action
string[] arguments
{duration} duration
float32 completion
string message_status
"""
HUB = "int16 type\nstring node_id\nstring action\nstring[] arguments\nbool success\nfloat32 completion\nstring status\n"
DISPATCH = """
int32 action_id
int32 plan_id
string name
diagnostic_msgs/KeyValue[] parameters
float32 duration
float32 dispatch_time
"""
FEEDBACK = "int32 action_id\nint32 plan_id\nint32 status\ndiagnostic_msgs/KeyValue[] information\n"


def typestore(*, is_ros1=False):
    """The types of the messages, with the stamps of a version of ROS."""
    store = get_typestore(Stores.ROS1_NOETIC if is_ros1 else Stores.ROS2_HUMBLE)
    stamps = {"time": "time", "duration": "duration"} if is_ros1 else {}
    stamps = stamps or {"time": "builtin_interfaces/Time", "duration": "builtin_interfaces/Duration"}
    for name, text in {
        "plansys2_msgs/msg/Knowledge": KNOWLEDGE,
        "plansys2_msgs/msg/PlanItem": PLAN_ITEM,
        "plansys2_msgs/msg/Plan": "PlanItem[] items\n",
        "plansys2_msgs/msg/ActionExecutionInfo": INFO.format(**stamps),
        "plansys2_msgs/msg/ActionExecution": HUB,
        "rosplan_dispatch_msgs/msg/ActionDispatch": DISPATCH,
        "rosplan_dispatch_msgs/msg/ActionFeedback": FEEDBACK,
    }.items():
        store.register(get_types_from_msg(text, name))
    return store


class Messages:
    """Makes messages of one version of ROS."""

    def __init__(self, store):
        self._store = store

    def __call__(self, name, /, **fields):
        return self._store.types[name](**fields)

    def stamp(self, nanoseconds, name="Time"):
        return self(f"builtin_interfaces/msg/{name}", sec=nanoseconds // SECOND, nanosec=nanoseconds % SECOND)

    def knowledge(self, instances, predicates, functions=(), goal=""):
        return self(
            "plansys2_msgs/msg/Knowledge",
            instances=list(instances),
            predicates=list(predicates),
            functions=list(functions),
            goal=goal,
        )

    def plan(self, *steps):
        """A plan of (time, action, duration), in seconds."""
        items = [
            self("plansys2_msgs/msg/PlanItem", time=t, action=action, duration=lasting) for t, action, lasting in steps
        ]
        return self("plansys2_msgs/msg/Plan", items=items)

    def info(self, status, start, action, at, duration=0):
        words = action.strip("()").split()
        return self(
            "plansys2_msgs/msg/ActionExecutionInfo",
            status=status,
            start_stamp=self.stamp(start),
            status_stamp=self.stamp(at),
            action_full_name=f"{action}:{start}",
            action=words[0],
            arguments=words[1:],
            duration=self.stamp(duration, "Duration"),
            completion=0.0,
            message_status="",
        )

    def text(self, text):
        return self("std_msgs/msg/String", data=text)

    def values(self, **labelled):
        return [self("diagnostic_msgs/msg/KeyValue", key=key, value=value) for key, value in labelled.items()]


def write(path, kind, made, *, sender="/planner"):
    """Write a bag of a kind: "1", "sqlite3" or "mcap".

    `made` takes `Messages`, and yields times in nanoseconds, topics and messages.
    """
    is_ros1 = kind == "1"
    store = typestore(is_ros1=is_ros1)
    writer = Writer1(path) if is_ros1 else Writer2(path, version=9, storage_plugin=StoragePlugin[kind.upper()])
    connections = {}
    with writer:
        for time, topic, message in made(Messages(store)):
            name = message.__msgtype__
            if topic not in connections:
                options = {"callerid": sender} if is_ros1 else {}
                connections[topic] = writer.add_connection(topic, name, typestore=store, **options)
            serialize = store.serialize_ros1 if is_ros1 else store.serialize_cdr
            writer.write(connections[topic], time, serialize(message, name))
    return path


# -- an hour of PlanSys2 ------------------------------------------------------------------------------------------

DOMAIN = """
(define (domain tour)
  (:requirements :typing :durative-actions)
  (:types robot room)
  (:predicates (robot_at ?r - robot ?p - room) (open ?p - room))
  (:durative-action move
    :parameters (?r - robot ?from ?to - room)
    :duration (= ?duration 20)
    :condition (at start (robot_at ?r ?from))
    :effect (and (at start (not (robot_at ?r ?from))) (at end (robot_at ?r ?to)))))
"""

HOUR = 3600 * SECOND
BEGIN = 1_700_000_000 * SECOND + 123_456_789
CYCLE, DRIVE = 30 * SECOND, 20 * SECOND + 7
"""A drive begins each half minute, and takes 20 s and 7 ns."""
ROOMS = "abc"


def drives():
    """Each drive: when it starts and ends, and between which places; every tenth fails, and ends where it began."""
    place = "a"
    for number in range(HOUR // CYCLE):
        start = BEGIN + number * CYCLE + SECOND + number
        to = ROOMS[(ROOMS.index(place) + 1) % 3]
        yield start, start + DRIVE, place, to, number % 10 != 9
        place = to if number % 10 != 9 else place


def mission(messages):
    """An hour: snapshots every 10 s and at each change, executions every second, and unrelated topics."""

    def snapshot(place):
        facts = ["(open a)", *([f"(robot_at r1 {place})"] if place else [])]
        return messages.knowledge(["r1", *ROOMS], facts, goal="(and (robot_at r1 c))")

    events = [(BEGIN, "/problem_expert/knowledge", snapshot("a"))]
    for number, (start, end, place, to, succeeds) in enumerate(drives()):
        action = f"(move r1 {place} {to})"
        if number % 10 == 0:
            events.append(
                (
                    start - SECOND,
                    "/planner/plan",
                    messages.plan((0.0, action, 20.0), (30.0 + number, "(move r1 x y)", 20.0)),
                )
            )

        def info(status, at, action=action, start=start):
            return at, "/action_execution_info", messages.info(status, start, action, at, DRIVE)

        events.append((start, "/problem_expert/knowledge", snapshot("")))
        events += [info(2, start + second * SECOND) for second in range(21)]
        events.append(info(4 if succeeds else 3, end))
        events.append((end, "/problem_expert/knowledge", snapshot(to if succeeds else place)))
        events.append((end + SECOND, "/problem_expert/knowledge", snapshot(to if succeeds else place)))
        events.append((end + SECOND, "/rosout_text", messages.text("not ours")))
    return sorted(events, key=lambda event: event[0])


# -- ROSPlan ------------------------------------------------------------------------------------------------------

PROBLEM = """
(define (problem {name}) (:domain tour)
  (:objects r1 - robot a b c - room)
  (:init (robot_at r1 {place}) (open a))
  (:goal (robot_at r1 c)))
"""
PROBLEMS, DISPATCHED, DONE = (
    "/rosplan_problem_interface/problem_instance",
    "/dispatcher/dispatch",
    "/dispatcher/feedback",
)


def rosplan_hour(messages):
    """The same drives as ROSPlan publishes them: a problem at each plan, dispatches and feedback."""
    place = "a"
    for number, (start, end, origin, to, succeeds) in enumerate(drives()):
        if number % 10 == 0:
            yield start - 5, PROBLEMS, messages.text(PROBLEM.format(name=f"p{number}", place=place))
        dispatch = messages(
            "rosplan_dispatch_msgs/msg/ActionDispatch",
            action_id=number,
            plan_id=number // 10,
            name="move",
            parameters=messages.values(to=to, r="r1", **{"from": origin}),
            duration=20.0,
            dispatch_time=0.0,
        )

        def feedback(status, number=number):
            return messages(
                "rosplan_dispatch_msgs/msg/ActionFeedback",
                action_id=number,
                plan_id=number // 10,
                status=status,
                information=[],
            )

        yield start - 3, DISPATCHED, dispatch
        yield start, DONE, feedback(1)
        yield end, DONE, feedback(2 if succeeds else 10)
        place = to if succeeds else place
