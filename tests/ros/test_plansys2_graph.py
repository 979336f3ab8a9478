"""PlanSys2's experts and the recorder on a real graph of ROS 2, on loopback: `make test-ros2` runs this.

The messages are generated and compiled from the definitions in this directory (`plansys2_build.py`).
"""

import itertools
import os
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager

import pytest

os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
os.environ["ROS_DOMAIN_ID"] = str(os.getpid() % 100 + 1)

pytest.importorskip("rclpy", reason="ROS 2 is not here: make test-ros2 brings it")

import rclpy
from plansys2_msgs import msg, srv
from rclpy.qos import DurabilityPolicy, QoSProfile
from rosgraph_msgs.msg import Clock
from std_msgs.msg import Empty

import kbstore
from kbstore.clock import ManualClock, seconds
from kbstore.ros.plansys2_domain import DomainExpert
from kbstore.ros.plansys2_problem import ProblemExpert
from kbstore.ros.recorder_node import MessageRecorder
from tests.ros.call_costs import medians, show
from tests.ros.plansys2_calls import text
from tests.ros.plansys2_doubles import DOMAIN
from tests.ros.ros2_graph import (
    ACTIVATE,
    CLEANUP,
    CONFIGURE,
    DEACTIVATE,
    PATIENCE,
    SHUTDOWN,
    empty_service,
    graph,
    running,
    until,
)

# what ROS's own libraries do in the old way is not ours
pytestmark = pytest.mark.filterwarnings("ignore::DeprecationWarning")

LATCHED = QoSProfile(depth=100, durability=DurabilityPolicy.TRANSIENT_LOCAL)
PREDICATE, FUNCTION, AND, NUMBER = 5, 6, 1, 9
CONFIRM, FINISH, CANCEL = 3, 6, 7
EXECUTING, SUCCEEDED = 2, 4

PROBLEM = """
(define (problem p) (:domain delivery)
  (:objects r1 - robot a b - room cup - item)
  (:init (robot_at r1 a) (free r1) (item_at cup b) (= (battery r1) 80))
  (:goal (and (robot_at r1 b))))
"""


def param(name, type_name=""):
    return msg.Param(name=name, type=type_name)


def node(kind, name, *arguments, **fields):
    return msg.Node(node_type=kind, name=name, parameters=[param(argument) for argument in arguments], **fields)


def tree(*nodes):
    for number, found in enumerate(nodes):
        found.node_id = number
    return msg.Tree(nodes=list(nodes))


def at(place):
    return node(PREDICATE, "robot_at", "r1", place)


def battery(value):
    return node(FUNCTION, "battery", "r1", value=float(value))


@pytest.fixture(scope="module")
def tester():
    with graph() as found:
        yield found


@pytest.fixture
def place(tmp_path):
    (tmp_path / "domain.pddl").write_text(DOMAIN)
    (tmp_path / "problem.pddl").write_text(PROBLEM)
    return tmp_path


def parameters(place, *more, **values):
    given = {"model_file": place / "domain.pddl", **values}
    return ["--ros-args", *more, *(part for name, value in given.items() for part in ("-p", f"{name}:={value}"))]


@pytest.fixture
def experts(tester, place):
    """Start the process of both experts, neither of them configured, and wait for its end."""

    @contextmanager
    def starting(*arguments):
        log = place / "experts.log"
        with running(log, "ros", "plansys2", "--url", place / "robot.db", "--kb", "kenny", *arguments) as process:
            yield process
        for name in ("domain_expert", "problem_expert"):
            tester.gone(name)

    return starting


class Calls:
    """Calls services of the two experts by their names."""

    def __init__(self, tester, namespace=""):
        self._tester = tester
        self._namespace = namespace

    def __call__(self, service, **fields):
        expert, owner = (DomainExpert, "domain_expert") if "_domain" in service else (ProblemExpert, "problem_expert")
        kind = getattr(srv, expert.TYPES[service])
        return self._tester.call(kind, f"{self._namespace}{owner}/{service}", **fields)

    def succeeds(self, service, **fields):
        response = self(service, **fields)
        assert (response.success, response.error_info) == (True, "")
        return response

    def fails(self, service, **fields):
        response = self(service, **fields)
        assert not response.success
        assert response.error_info
        return response.error_info

    def start(self):
        """Configure and activate both, as PlanSys2's bringup does."""
        for transition in (CONFIGURE, ACTIVATE):
            for name in ("domain_expert", "problem_expert"):
                assert self._tester.change(f"{self._namespace}{name}", transition)


@pytest.fixture
def calls(tester):
    return Calls(tester)


def opened(place, **options):
    return kbstore.open(place / "robot.db", "kenny", **options)


# -- the experts ----------------------------------------------------------------------------------------------


def test_the_lifecycle(tester, calls, place, experts):
    """Unconfigured it refuses with a reason; inactive it answers without publishing; cleaned up it closes the store."""
    known = tester.received(msg.Knowledge, "problem_expert/knowledge", LATCHED)
    with experts(*parameters(place, problem_file=place / "problem.pddl")):
        assert "not configured" in calls.fails("add_problem_instance", param=param("r9", "robot"))
        assert calls("exist_problem_predicate", node=at("a")).exist is False
        assert "not configured" in calls.fails("get_domain_name")
        for name in ("domain_expert", "problem_expert"):
            assert tester.state(name) == "unconfigured"
            assert tester.change(name, CONFIGURE)
            assert tester.state(name) == "inactive"
        calls.succeeds("add_problem_instance", param=param("r9", "robot"))
        assert known == []
        assert tester.change("problem_expert", ACTIVATE)
        until(lambda: known)
        assert "r9" in known[-1].instances
        assert tester.change("problem_expert", DEACTIVATE)
        calls.succeeds("remove_problem_instance", param=param("r9"))
        assert tester.change("problem_expert", CLEANUP)
        assert "not configured" in calls.fails("get_problem")
        assert tester.change("problem_expert", CONFIGURE)
        assert "r1 - robot" in calls.succeeds("get_problem").problem
        assert tester.change("problem_expert", CLEANUP)
        assert tester.change("problem_expert", SHUTDOWN)
        assert tester.state("problem_expert") == "finalized"
    assert len(known) == 1


def test_configuration_fails_with_a_reason(tester, calls, place, experts):
    """Without a domain, and with invalid files, the transition fails and the log says why."""
    with experts():
        assert not tester.change("domain_expert", CONFIGURE)
        assert tester.state("domain_expert") == "unconfigured"
        assert not tester.change("problem_expert", CONFIGURE)
    assert "has no domain; load one" in (place / "experts.log").read_text()
    (place / "problem.pddl").write_text(PROBLEM.replace("(free r1)", "(flies r1)"))
    with experts(*parameters(place, problem_file=place / "problem.pddl")):
        assert tester.change("domain_expert", CONFIGURE)
        assert not tester.change("problem_expert", CONFIGURE)
        assert calls.succeeds("get_domain_name").name == "delivery"
    assert "no predicate flies" in (place / "experts.log").read_text()


def test_every_service_with_good_and_bad_arguments(tester, calls, place, experts):
    """Answers and refusals cross the graph; the client of each transaction is the node's name."""
    asked = set()

    def good(service, **fields):
        asked.add(service)
        return calls.succeeds(service, **fields)

    def bad(service, word, **fields):
        assert word in calls.fails(service, **fields)

    with experts(*parameters(place)):
        calls.start()
        good("add_problem", problem=PROBLEM)
        bad("add_problem", "other", problem=PROBLEM.replace("delivery", "other"))
        good("add_problem_instance", param=param("r2", "robot"))
        bad("add_problem_instance", "no type", param=param("r3", "ship"))
        good("get_problem_instance", instance="r2")
        bad("get_problem_instance", "no object r3", instance="r3")
        assert {p.name for p in good("get_problem_instances").instances} == {"r1", "r2", "a", "b", "cup", "hub"}
        good("remove_problem_instance", param=param("r2", "robot"))
        bad("remove_problem_instance", "no object r2", param=param("r2", "robot"))
        good("add_problem_predicate", node=at("hub"))
        bad("add_problem_predicate", "cellar", node=at("cellar"))
        good("remove_problem_predicate", node=at("hub"))
        bad("remove_problem_predicate", "flies", node=node(PREDICATE, "flies", "r1"))
        good("get_problem_predicate", expression="(robot_at r1 a)")
        bad("get_problem_predicate", "does not hold", expression="(robot_at r1 b)")
        states = good("get_problem_predicates").states
        assert sorted(map(text, states)) == ["(free r1)", "(item_at cup b)", "(robot_at r1 a)"]
        assert calls("exist_problem_predicate", node=at("a")).exist is True
        assert calls("exist_problem_predicate", node=at("b")).exist is False
        good("add_problem_function", node=battery(50))
        bad("add_problem_function", "no function", node=node(FUNCTION, "height", "r1"))
        good("update_problem_function", node=battery(40))
        bad("update_problem_function", "no value", node=node(FUNCTION, "trips"))
        assert good("get_problem_function", expression="(battery r1)").node.value == 40
        bad("get_problem_function", "no value", expression="(trips)")
        assert [(text(f), f.value) for f in good("get_problem_functions").states] == [("(battery r1)", 40)]
        assert calls("exist_problem_function", node=battery(0)).exist is True
        good("remove_problem_function", node=battery(0))
        bad("remove_problem_function", "no object r3", node=node(FUNCTION, "battery", "r3"))
        assert calls("exist_problem_function", node=battery(0)).exist is False
        goal = tree(node(AND, "", children=[1]), at("a"))
        good("add_problem_goal", tree=goal)
        bad("add_problem_goal", "empty", tree=tree())
        assert text(good("get_problem_goal").tree) == "(and (robot_at r1 a))"
        assert good("is_problem_goal_satisfied", tree=goal).satisfied is True
        bad("is_problem_goal_satisfied", "flies", tree=tree(node(PREDICATE, "flies", "r1")))
        good("remove_problem_goal")
        assert len(good("get_problem_goal").tree.nodes) == 0
        assert "(robot_at r1 a)" in good("get_problem").problem
        good("clear_problem_knowledge")
        assert good("get_domain_name").name == "delivery"
        assert list(good("get_domain_types").types) == ["object", "robot", "item", "room", "dock"]
        assert list(good("get_domain_constants", type="dock").constants) == ["hub"]
        bad("get_domain_constants", "no type", type="ship")
        assert list(good("get_domain_actions").actions) == ["grab"]
        assert list(good("get_domain_durative_actions").actions) == ["move", "wait"]
        action = good("get_domain_action_details", action="grab", parameters=["r1", "cup"]).action
        assert [p.name for p in action.parameters] == ["r1", "cup", "?2"]
        bad("get_domain_action_details", "no operator", action="fly")
        move = good("get_domain_durative_action_details", durative_action="move").durative_action
        assert text(move.at_end_effects) == "(and (robot_at ?0 ?2) (decrease (battery ?0) 5.0))"
        bad("get_domain_durative_action_details", "takes no time", durative_action="grab")
        assert len(good("get_domain_predicates").states) == 5
        assert len(good("get_domain_functions").states) == 2
        found = good("get_domain_predicate_details", expression="item_at").node
        assert [(p.name, p.type, list(p.sub_types)) for p in found.parameters] == [
            ("?item0", "item", []),
            ("?room1", "room", ["dock"]),
        ]
        bad("get_domain_predicate_details", "no predicate", expression="flies")
        good("get_domain_function_details", expression="battery")
        bad("get_domain_function_details", "no function", expression="height")
        assert len(good("get_domain_derived_predicates").states) == 1
        good("get_domain_derived_predicate_details", predicate="busy")
        bad("get_domain_derived_predicate_details", "no rule", predicate="free")
        assert "(:durative-action move" in good("get_domain").domain
    left = (ProblemExpert.TYPES.keys() | DomainExpert.TYPES.keys()) - asked
    assert left == {"exist_problem_function", "exist_problem_predicate"}
    with opened(place, read_only=True) as kb:
        assert {change.transaction.client for change in kb.changes()} == {"domain_expert", "problem_expert"}


def test_changes_are_published(tester, calls, place, experts):
    """Each change notifies, and all but two publish the knowledge; a late subscriber gets the last message."""
    with experts(*parameters(place, problem_file=place / "problem.pddl")):
        calls.start()
        updates = tester.received(Empty, "problem_expert/update_notify")
        known = tester.received(msg.Knowledge, "problem_expert/knowledge", LATCHED)
        until(lambda: known)
        until(lambda: tester.node.count_publishers("problem_expert/update_notify"))
        time.sleep(1)
        calls.succeeds("add_problem_predicate", node=at("b"))
        calls.succeeds("update_problem_function", node=battery(7))
        calls.succeeds("remove_problem_function", node=battery(7))
        calls.fails("add_problem_predicate", node=at("cellar"))
        until(lambda: len(updates) == 3 and len(known) == 2)
        late = tester.received(msg.Knowledge, "problem_expert/knowledge", LATCHED)
        until(lambda: late)
        time.sleep(0.5)
        assert (len(updates), len(known)) == (3, 2)
        # of changes in quick succession at least the state after the last
        for number in range(20):
            calls.succeeds("add_problem_predicate" if number % 2 else "remove_problem_predicate", node=at("b"))
        calls.succeeds("add_problem_instance", param=param("r2", "robot"))
        until(lambda: "r2" in known[-1].instances)
    assert sorted(known[-1].predicates) == ["(free r1)", "(item_at cup b)", "(robot_at r1 a)", "(robot_at r1 b)"]
    assert sorted(late[0].instances) == ["a", "b", "cup", "hub", "r1"]
    assert late[0].goal == "(and (robot_at r1 b))"


def test_a_restart_continues(calls, place, experts):
    """Killed and started again with the same files, it has its acknowledged changes, and loads nothing again."""
    arguments = parameters(place, problem_file=place / "problem.pddl")
    with experts(*arguments) as process:
        calls.start()
        calls.succeeds("remove_problem_predicate", node=at("a"))
        calls.succeeds("add_problem_predicate", node=at("b"))
        process.kill()
        process.wait(PATIENCE)
    with experts(*arguments):
        calls.start()
        states = sorted(map(text, calls.succeeds("get_problem_predicates").states))
    assert states == ["(free r1)", "(item_at cup b)", "(robot_at r1 b)"]
    with opened(place, read_only=True) as kb:
        notes = [change.transaction.note for change in kb.changes()]
    assert notes == ["model_file", "problem_file", "remove_problem_predicate", "add_problem_predicate"]


def test_calls_from_four_threads(calls, place, experts):
    """200 calls at a time, changes among them, are all answered, and each is in the state."""
    with experts(*parameters(place)):
        calls.start()

        def work(thread):
            for number in range(25):
                calls.succeeds("add_problem_instance", param=param(f"r{thread}-{number}", "robot"))
                assert calls("exist_problem_predicate", node=at("hub")).exist is False

        with ThreadPoolExecutor(4) as pool:
            list(pool.map(work, range(4)))
    with opened(place, read_only=True) as kb:
        assert len(kb.instances("robot")) == 100


def test_a_simulated_clock(tester, calls, place, experts):
    """With use_sim_time a transaction has the simulator's time; for a clock that restarts at 0 the error says so."""
    clock = tester.node.create_publisher(Clock, "/clock", 10)
    now = [seconds(50)]
    stop = threading.Event()

    def tick():
        while not stop.wait(0.02):
            message = Clock()
            message.clock.sec = now[0] // 10**9
            clock.publish(message)

    ticking = threading.Thread(target=tick)
    ticking.start()
    try:
        with experts(*parameters(place, use_sim_time="true")):
            calls.start()
            calls.succeeds("add_problem_instance", param=param("r1", "robot"))
            now[0] = seconds(60)
            time.sleep(1)
            calls.succeeds("add_problem_instance", param=param("r2", "robot"))
            now[0] = 0
            time.sleep(1)
            refused = calls.fails("add_problem_instance", param=param("r3", "robot"))
    finally:
        stop.set()
        ticking.join()
        tester.node.destroy_publisher(clock)
    assert "clock" in refused
    with opened(place, clock=ManualClock()) as kb:
        times = [kb.history(f"{name} - robot")[0].initial_time for name in ("r1", "r2")]
    assert times == [seconds(50), seconds(60)]


def test_the_planner_may_validate_the_domain(tester, place, experts):
    """With validate_using_planner_node the planner is asked, and its refusal is a failure to configure."""
    answers = [False, True]

    def validate(request, response):
        assert "(define (domain delivery)" in request.domain
        response.success, response.error_info = answers.pop(0), "too hard"
        return response

    service = tester.node.create_service(srv.ValidateDomain, "planner/validate_domain", validate)
    with experts(*parameters(place, validate_using_planner_node="true")):
        assert not tester.change("domain_expert", CONFIGURE)
        assert tester.change("domain_expert", CONFIGURE)
    tester.node.destroy_service(service)
    assert "the planner does not accept the domain: too hard" in (place / "experts.log").read_text()


def test_the_cost_of_a_call(tester, calls, place, capsys, experts):
    """Printed, not judged: a call beside the same question in Python and an empty service call."""
    arguments = parameters(place, problem_file=place / "problem.pddl")
    with experts(*arguments), empty_service("ExistNode", "nothing"), opened(place) as kb:
        calls.start()
        question, other = (kbstore.Fact(attribute_name="robot_at", values=["r1", place]) for place in "ab")
        services, changes = itertools.cycle(("remove", "add")), itertools.cycle((kb.add, kb.remove))

        def nothing():
            tester.call(srv.ExistNode, "nothing", node=at("a"))

        found = {
            name: medians(call, python, nothing, number=200)
            for name, call, python in (
                (
                    "exist_problem_predicate",
                    lambda: calls("exist_problem_predicate", node=at("a")),
                    lambda: kb.holds(question),
                ),
                (
                    "get_problem_function",
                    lambda: calls("get_problem_function", expression="(battery r1)"),
                    lambda: kb.value("(battery r1)"),
                ),
                (
                    # PlanSys2 asks for derived facts, too
                    "get_problem_predicates",
                    lambda: calls("get_problem_predicates"),
                    lambda: [kb.propositions(), kb.find("(busy ?r)")],
                ),
                ("get_problem", lambda: calls("get_problem"), kb.to_pddl),
                (
                    # the knowledge is published, too
                    "remove_problem_predicate and add_problem_predicate, in turns",
                    lambda: calls(f"{next(services)}_problem_predicate", node=at("a")),
                    lambda: next(changes)(other),
                ),
                ("get_domain", lambda: calls("get_domain"), kb.domain_to_pddl),
            )
        }
    with capsys.disabled():
        show(found)


# -- the recorder ---------------------------------------------------------------------------------------------


class Script:
    """A PlanSys2 without planning: the topics and the services of its nodes, as they publish and answer."""

    def __init__(self, tester):
        self._node = tester.node
        group = {"callback_group": tester.group}
        self.instances, self.predicates, self.functions, self.goal = {}, [], {}, ""
        self._knowledge = self._node.create_publisher(msg.Knowledge, "problem_expert/knowledge", LATCHED)
        self._updates = self._node.create_publisher(Empty, "problem_expert/update_notify", 100)
        self._plan = self._node.create_publisher(msg.Plan, "executing_plan", LATCHED)
        self._info = self._node.create_publisher(msg.ActionExecutionInfo, "action_execution_info", 100)
        self._hub = self._node.create_publisher(msg.ActionExecution, "actions_hub", 100)
        self._publishers = (self._knowledge, self._updates, self._plan, self._info, self._hub)
        self._services = [
            self._node.create_service(kind, name, answer, **group)
            for kind, name, answer in (
                (srv.GetDomain, "domain_expert/get_domain", self._get_domain),
                (srv.GetProblemInstances, "problem_expert/get_problem_instances", self._get_instances),
                (srv.GetStates, "problem_expert/get_problem_functions", self._get_functions),
            )
        ]

    def close(self):
        for publisher in self._publishers:
            self._node.destroy_publisher(publisher)
        for service in self._services:
            self._node.destroy_service(service)

    def _get_domain(self, request, response):
        response.success, response.domain = True, DOMAIN
        return response

    def _get_instances(self, request, response):
        response.success, response.instances = True, [param(*found) for found in self.instances.items()]
        return response

    def _get_functions(self, request, response):
        response.success = True
        response.states = [
            node(FUNCTION, *function.strip("()").split(), value=float(value))
            for function, value in self.functions.items()
        ]
        return response

    def publish(self):
        """Notify, and publish the knowledge, as PlanSys2 does at each change."""
        self.notify()
        self._knowledge.publish(
            msg.Knowledge(
                instances=list(self.instances),
                predicates=self.predicates,
                functions=list(self.functions),
                goal=self.goal,
            )
        )

    def notify(self):
        """Notify alone, as PlanSys2 does when a function is updated."""
        self._updates.publish(Empty())

    def plan(self, *steps):
        items = [msg.PlanItem(time=start, action=action, duration=length) for start, action, length in steps]
        self._plan.publish(msg.Plan(items=items))

    def hub(self, kind, action, **fields):
        name, *arguments = action.strip("()").split()
        self._hub.publish(msg.ActionExecution(type=kind, action=name, arguments=arguments, **fields))

    def info(self, status, start, action):
        name, *arguments = action.strip("()").split()
        message = msg.ActionExecutionInfo(status=status, action_full_name=f"{action}:0", action=name)
        message.arguments, message.start_stamp = arguments, start
        message.duration.sec = 10
        self._info.publish(message)

    def heard(self):
        """Wait until the recorder is subscribed to every topic."""
        until(lambda: all(publisher.get_subscription_count() for publisher in self._publishers))


@pytest.fixture
def script(tester):
    found = Script(tester)
    yield found
    found.close()


@pytest.fixture
def recorder(tester, place):
    """Start the recorder, and wait for its end."""

    @contextmanager
    def starting(*arguments):
        with running(
            place / "recorder.log", "ros", "record", "--url", place / "robot.db", "--kb", "kenny", *arguments
        ) as process:
            yield process
        until(lambda: "kbstore_recorder" not in tester.node.get_node_names())

    return starting


@contextmanager
def watched(script, place):
    """The knowledge base being recorded, once the recorder is subscribed."""
    script.heard()
    with opened(place, read_only=True) as kb:
        yield kb


def facts(kb):
    return sorted(map(str, kb.propositions()))


MOVE = "(move r1 a b)"


def test_a_mission_is_recorded_through_a_kill(tester, script, recorder, place):
    """Snapshots, goals, functions, the plan and a run; killed in the middle and started again, nothing is lost."""
    script.instances = {"hub": "dock", "r1": "robot", "a": "room", "b": "room"}
    script.predicates, script.functions = ["(robot_at r1 a)", "(free r1)"], {"(battery r1)": 80}
    script.goal = "(and (robot_at r1 b))"
    script.publish()
    with recorder() as process, watched(script, place) as kb:
        until(lambda: facts(kb) == ["(free r1)", "(robot_at r1 a)"])
        assert [*map(str, kb.goals())] == ["(robot_at r1 b)"]
        assert kb.value("(battery r1)") == 80
        script.functions["(battery r1)"] = 75
        script.notify()
        until(lambda: kb.value("(battery r1)") == 75)
        script.plan((0.0, MOVE, 10.0))
        script.predicates = ["(free r1)"]
        script.publish()
        until(lambda: facts(kb) == ["(free r1)"])
        script.hub(CONFIRM, MOVE, node_id="move_1")
        start = tester.node.get_clock().now().to_msg()
        until(lambda: kb.state().running)
        process.kill()
        process.wait(PATIENCE)
    # meanwhile PlanSys2 continues
    script.predicates, script.functions["(battery r1)"] = ["(free r1)", "(robot_at r1 b)"], 70
    script.publish()
    with recorder(), watched(script, place) as kb:
        until(lambda: facts(kb) == ["(free r1)", "(robot_at r1 b)"])
        script.info(EXECUTING, start, MOVE)
        script.hub(FINISH, MOVE, success=True, status="arrived")
        until(lambda: not kb.state().running)
        script.info(SUCCEEDED, start, MOVE)
        script.predicates = ["(robot_at r1 b)"]
        script.publish()
        until(lambda: facts(kb) == ["(robot_at r1 b)"])
        (run,) = kb.runs()
        assert (run.outcome, run.duration) == ("ended", seconds(10))
        assert kb.value("(battery r1)") == 70
        notes = [change.transaction.note for change in kb.changes()]
        assert "(move r1 a b) confirmed to move_1; plan: 0.000: (move r1 a b) [10.000]" in notes
        assert "(move r1 a b) succeeded; arrived" in notes
        assert len(kb.history("(robot_at r1 ?)")) == 2
    assert "not recorded" not in (place / "recorder.log").read_text()


def few_move(turn, item):
    """Of 1,000 items 20 are in one room, and in each turn another 20: 40 facts change."""
    return "hub" if (item + turn) % 50 == 0 else "r0"


def all_move(turn, item):
    """They are in another room in each turn."""
    return f"r{turn % 10}"


def test_snapshots_of_a_thousand_facts(tester, script, recorder, place, capsys):
    """At 10 a second the recorder keeps up, and of a burst it takes the latest. The figures are printed."""
    script.instances = {f"r{number}": "room" for number in range(10)} | {f"i{number}": "item" for number in range(1000)}
    script.instances["hub"] = "dock"
    lines = []

    def publish(turn, room):
        script.predicates = [f"(item_at i{item} {room(turn, item)})" for item in range(1000)]
        script.publish()

    def recorded(act, *arguments):
        """The number of recorded snapshots, and the time from the last publication to the last recording."""
        before = len(kb.transactions())
        act(*arguments)
        end = time.monotonic()
        until(lambda: facts(kb) == sorted(script.predicates))
        lag = time.monotonic() - end
        return len(kb.transactions()) - before, lag

    def ten_a_second(room):
        begin = time.monotonic()
        for turn in range(1, 41):
            publish(turn, room)
            time.sleep(max(0, begin + turn / 10 - time.monotonic()))

    def burst():
        for turn in range(100):
            publish(turn, all_move)

    with recorder(), watched(script, place) as kb:
        recorded(publish, 0, few_move)
        for changed, room in ((40, few_move), (1000, all_move)):
            number, lag = recorded(ten_a_second, room)
            lines.append(f"{number} of 40 with {changed} facts changed in each, the last after {lag:.2f} s")
        number, _ = recorded(burst)
    with capsys.disabled():
        print(f"\nsnapshots of 1,000 facts at 10 a second: {'; '.join(lines)}; {number} of 100 at once")
    assert 1 <= number < 100


def test_a_simulation_that_starts_again_ends_the_recorder(tester, script, recorder, place):
    """The recorder says in one line that the clock is behind its latest time, and exits with 2."""
    (place / "domain.pddl").write_text(DOMAIN)
    with kbstore.open(place / "robot.db", "kenny", clock=ManualClock(2 * time.time_ns() // 10**9 * 10**9)) as kb:
        kb.load(DOMAIN)
    script.publish()
    log = place / "recorder.log"
    with recorder() as process:
        assert process.wait(PATIENCE) == 2
    assert "clock" in log.read_text().splitlines()[-1]


def test_a_recorder_that_waits_can_be_stopped(recorder, place):
    """Interrupted while it waits for a domain, it prints nothing."""
    log = place / "recorder.log"
    with recorder():
        until(lambda: "waiting for domain_expert/get_domain" in log.read_text())
    assert "Traceback" not in log.read_text()


@pytest.fixture
def recorder_here(tester, place):
    """A recorder in this process, without its thread."""
    node, clock = rclpy.create_node("here"), ManualClock()
    with opened(place, clock=clock) as kb:
        yield MessageRecorder(node, kb, clock, None, None)
    node.destroy_node()


def test_a_recorder_that_cannot_go_on_ends(recorder_here, monkeypatch):
    """Any error that ends the recording ends the recorder: it must not seem to record."""

    def broken(self):
        raise ZeroDivisionError

    monkeypatch.setattr(MessageRecorder, "_open_mirror", broken)
    woken = []
    recorder_here.work(lambda: woken.append(True))
    assert isinstance(recorder_here.failure, ZeroDivisionError)
    assert woken


def test_messages_while_the_store_is_away_are_recorded_later(recorder_here, monkeypatch):
    """In their order; of snapshots only the latest."""
    recorded, refused, follows = [], ["start", "first", "third"], {"first": "second", "second": "third"}

    def record(self, mirror, kind, message, received):
        if message in follows:
            self._receiver("knowledge")(follows.pop(message))
        if message in refused:
            refused.remove(message)
            raise kbstore.StoreUnavailable("the store is away")
        recorded.append(message)
        if message == "third":
            self.stop()

    monkeypatch.setattr(MessageRecorder, "_open_mirror", lambda self: "a mirror")
    monkeypatch.setattr(MessageRecorder, "_record", record)
    monkeypatch.setattr("kbstore.ros.recorder_node.AGAIN", 0.01)
    recorder_here._receiver("hub")("start")
    recorder_here._receiver("knowledge")("first")
    recorder_here.work(lambda: None)
    assert (recorder_here.failure, recorded) == (None, ["start", "second", "third"])


def test_a_recorder_that_begins_among_snapshots_does_not_wait_for_their_end(recorder_here, monkeypatch):
    """A late subscriber gets older snapshots first, at once; it records while they keep coming."""
    recorded, most = [], 200

    def record(self, mirror, kind, message, received):
        recorded.append(message)
        self.stop()

    def publish():
        for number in range(most):
            recorder_here._receiver("knowledge")(number)
            if recorded:
                return
            time.sleep(0.01)

    monkeypatch.setattr(MessageRecorder, "_open_mirror", lambda self: "a mirror")
    monkeypatch.setattr(MessageRecorder, "_record", record)
    monkeypatch.setattr("kbstore.ros.recorder_node.LATEST", 0.1, raising=False)
    publishing = threading.Thread(target=publish)
    publishing.start()
    recorder_here.work(lambda: None)
    publishing.join()
    assert recorded[0] not in (0, most - 1)


def test_an_error_is_logged_and_the_recorder_continues(script, recorder, place):
    """A message that cannot be recorded is logged with the reason; the next snapshot is recorded."""
    script.instances = {"r1": "robot", "a": "room"}
    script.predicates = ["(robot_at r1 cellar)"]
    script.publish()
    with recorder(), watched(script, place) as kb:
        until(lambda: "not recorded" in (place / "recorder.log").read_text())
        script.predicates = ["(robot_at r1 a)"]
        script.publish()
        until(lambda: facts(kb) == ["(robot_at r1 a)"])
    assert "cellar" in (place / "recorder.log").read_text()
