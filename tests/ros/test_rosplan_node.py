"""ROSPlan's node on a real graph of ROS 1, on loopback: `make test-ros1` runs this with Debian's ROS.

The messages are made by genpy from the definitions in this directory.
"""

import os
import socket
import subprocess
import sys
import threading
import time
from contextlib import contextmanager
from io import BytesIO
from pathlib import Path

import pytest

import kbstore
from kbstore import seconds
from kbstore.ros.rosplan import SERVICES
from tests.ros.call_costs import medians, show
from tests.ros.rosplan_items import Items, values

rospy = pytest.importorskip("rospy", reason="ROS 1 is not here: make test-ros1 brings it, as root on Debian")

# what rospy itself does in the old way is not ours
pytestmark = pytest.mark.filterwarnings("ignore::DeprecationWarning:rospy.*", "ignore:unclosed:ResourceWarning")

HERE = Path(__file__).parent
KBSTORE = sys.executable, "-c", "from kbstore.cli import main; main()"
NODE = "rosplan_knowledge_base"
ADD, ADD_GOAL, REMOVE, REMOVE_GOAL, ADD_METRIC, REMOVE_METRIC = range(6)

DOMAIN = """
(define (domain delivery)
  (:requirements :typing :fluents :durative-actions)
  (:types place robot - object room - place)
  (:constants home - place)
  (:predicates (at ?r - robot ?p - place) (busy ?r - robot))
  (:functions (battery ?r - robot))
  (:durative-action drive
    :parameters (?r - robot ?a ?b - place)
    :duration (= ?duration 10)
    :condition (and (at start (at ?r ?a)) (over all (> (battery ?r) 5)))
    :effect (and (at start (not (at ?r ?a))) (at end (at ?r ?b)) (at end (decrease (battery ?r) 2)))))
"""
PROBLEM = """
(define (problem one) (:domain delivery)
  (:objects kenny - robot hall - room dock - place)
  (:init (at kenny hall) (= (battery kenny) 80))
  (:goal (at kenny dock))
  (:metric minimize (total-time)))
"""
AT_HALL = (("r", "kenny"), ("p", "hall"))
BATTERY = (("r", "kenny"),)


def free_port():
    with socket.socket() as found:
        found.bind(("127.0.0.1", 0))
        return found.getsockname()[1]


@pytest.fixture(scope="module")
def graph(tmp_path_factory):
    """A master on loopback, with this process as a node on it: /tester."""
    place = tmp_path_factory.mktemp("graph")
    messages = place / "messages"
    subprocess.run([sys.executable, HERE / "ros1_messages.py", messages], check=True)
    port = free_port()
    os.environ |= {
        "ROS_MASTER_URI": f"http://127.0.0.1:{port}",
        "ROS_IP": "127.0.0.1",
        "ROS_LOG_DIR": str(place),
        "PYTHONPATH": os.pathsep.join([str(messages), os.environ.get("PYTHONPATH", "")]),
    }
    sys.path.insert(0, str(messages))
    with open(place / "master.log", "w") as log:
        master = subprocess.Popen(["rosmaster", "--core", "-p", str(port)], stdout=log, stderr=log)
    until(lambda: is_listening(port))
    rospy.init_node("tester", disable_signals=True, disable_rosout=True)
    yield
    rospy.signal_shutdown("done")
    master.terminate()
    master.wait(10)


def is_listening(port):
    with socket.socket() as found:
        return found.connect_ex(("127.0.0.1", port)) == 0


def until(is_so, limit=30):
    """Wait until a condition is true."""
    end = time.monotonic() + limit
    while not is_so():
        assert time.monotonic() < end, "this has not come"
        time.sleep(0.02)


def command(store, *arguments):
    return [*KBSTORE, "ros", "rosplan", "--url", str(store), "--kb", "kenny", *arguments]


@contextmanager
def serving(store, *arguments, node=NODE, by_parameters=False):
    """A node in a separate process, ready to answer, and stopped as by a launch file."""
    log = store.with_suffix(".log")
    words = [*command(store, *arguments), f"__name:={node}"]
    if by_parameters:
        words = [*KBSTORE, "ros", "rosplan", *arguments, f"__name:={node}", f"_url:={store}", "_kb:=kenny"]
    with open(log, "a") as output:
        process = subprocess.Popen(words, stdout=output, stderr=output)
    try:
        until(lambda: process.poll() is not None or is_ready(node))
        yield log
    finally:
        process.terminate()
        assert process.wait(30) == 0, log.read_text()


def is_ready(node):
    """Whether the service that is advertised last exists."""
    try:
        rospy.wait_for_service(f"/{node}/state/metric", timeout=0.1)
    except rospy.ROSException:
        return False
    return True


class Caller:
    """Calls services of a node by rospy."""

    def __init__(self, node):
        self.node = node

    def proxy(self, service):
        types = __import__("std_srvs.srv" if service == "clear" else "rosplan_knowledge_msgs.srv", fromlist=["srv"])
        return rospy.ServiceProxy(f"/{self.node}/{service}", getattr(types, SERVICES[service]))

    def __call__(self, service, **request):
        proxy = self.proxy(service)
        try:
            return proxy(**request)
        finally:
            proxy.close()


call, other = Caller(NODE), Caller("other")


def make(name):
    for package in ("rosplan_knowledge_msgs.msg", "diagnostic_msgs.msg"):
        found = getattr(__import__(package, fromlist=["msg"]), name, None)
        if found is not None:
            return found()
    raise LookupError(name)


ITEMS = Items(make)


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    place = tmp_path_factory.mktemp("files")
    (place / "domain.pddl").write_text(DOMAIN)
    (place / "problem.pddl").write_text(PROBLEM)
    return [f"_domain_path:={place / 'domain.pddl'}", f"_problem_path:={place / 'problem.pddl'}"]


@pytest.fixture(scope="module")
def store(graph, files, tmp_path_factory):
    """The file behind a node that serves for all tests that take it."""
    found = tmp_path_factory.mktemp("store") / "robot.db"
    with serving(found, *files):
        yield found


def recorded(store):
    """The knowledge base as another process reads it."""
    return kbstore.open(store, "kenny", read_only=True)


def facts(ask=call):
    return {str(kbstore.item(found)) for found in ask("state/propositions", predicate_name="").attributes}


def test_the_services_are_there(store):
    """All 19, below the node's name, beside those that every node has."""
    listed = subprocess.run(["rosservice", "list"], capture_output=True, text=True, check=True).stdout.split()
    assert {f"/{NODE}/{name}" for name in SERVICES} <= set(listed)


def test_the_domain(store):
    """Name, types, symbols and operators, by real messages."""
    assert call("domain/name").domain_name == "delivery"
    assert call("domain/types").types == ["place", "robot", "room"]
    assert call("domain/types").super_types == ["object", "object", "place"]
    assert [found.name for found in call("domain/predicates").items] == ["at", "busy"]
    assert [found.name for found in call("domain/functions").items] == ["battery"]
    assert [values(found) for found in call("domain/operators").operators] == [
        [("r", "robot"), ("a", "place"), ("b", "place")]
    ]
    op = call("domain/operator_details", name="drive").op
    assert [found.name for found in op.at_end_add_effects] == ["at"]
    assert op.at_end_assign_effects[0].RHS.tokens[0].constant == 2.0
    assert op.over_all_comparison[0].LHS.tokens[0].function.name == "battery"
    assert not call("domain/predicate_details", name="busy").is_sensed
    assert call("update_sensed_predicates", name="busy", value=True).success
    assert call("domain/predicate_details", name="busy").is_sensed


def test_the_state(store):
    """The state of the problem, and the answers about it."""
    assert call("state/instances", type_name="place").instances == ["dock"]
    assert sorted(
        call("state/instances", type_name="place", include_constants=True, include_subtypes=True).instances
    ) == ["dock", "hall", "home"]
    (battery,) = call("state/functions", predicate_name="battery").attributes
    assert (battery.function_value, values(battery)) == (80.0, list(BATTERY))
    assert [str(kbstore.item(goal)) for goal in call("state/goals", predicate_name="x").attributes] == [
        "(at kenny dock)"
    ]
    assert call("state/metric").metric.optimization == "minimize"
    asked = [ITEMS.fact("at", AT_HALL), ITEMS.fact("busy", BATTERY), ITEMS.comparison(0, "battery", BATTERY, 79.0)]
    found = call("query_state", knowledge=asked)
    assert (found.all_true, list(found.results)) == (False, [True, False, True])
    assert [item.attribute_name for item in found.false_knowledge] == ["busy"]


def test_updates(store):
    """One and several, scheduled and cancelled, with success where the store has them, and not otherwise."""
    assert call("update", update_type=ADD, knowledge=ITEMS.fact("busy", BATTERY)).success
    assert "(busy kenny)" in facts()
    assert call("update", update_type=REMOVE, knowledge=ITEMS.fact("busy", BATTERY)).success
    assert "(busy kenny)" not in facts()
    for kind, item in (
        (ADD, ITEMS.fact("flying", BATTERY)),
        (9, ITEMS.fact("busy", BATTERY)),
        (ADD, ITEMS.fact("at", (("r", "kenny"), ("p", "moon")))),
    ):
        assert not call("update", update_type=kind, knowledge=item).success
    later = ITEMS.fact("busy", BATTERY, initial_time=rospy.Time.now() + rospy.Duration(3600))
    assert call("update_array", update_type=[ADD, ADD], knowledge=[later, ITEMS.instance("attic", "room")]).success
    (found,) = call("state/timed_knowledge", predicate_name="busy").attributes
    assert found.initial_time == later.initial_time
    both = call("update_array", update_type=[REMOVE, REMOVE], knowledge=[later, ITEMS.instance("attic", "room")])
    assert both.success
    assert call("state/timed_knowledge", predicate_name="").attributes == []
    assert not call("update_array", update_type=[ADD], knowledge=[later, later]).success
    # a closed world has no room for it
    assert not call("update_constraints_oneof", update_type=[], knowledge=[ITEMS.fact("busy", BATTERY)]).success


def test_the_caller_is_the_client(store):
    """ROS 1 gives the caller's name, for any program: it is the client of the transaction."""
    call("update", update_type=ADD, knowledge=ITEMS.fact("busy", BATTERY))
    request = "{update_type: 2, knowledge: {knowledge_type: 1, attribute_name: busy, values: [{key: r, value: kenny}]}}"
    done = subprocess.run(
        ["rosservice", "call", f"/{NODE}/update", request], capture_output=True, text=True, check=True
    )
    assert "success: True" in done.stdout
    with recorded(store) as kb:
        *_, added, removed = kb.changes()
    assert added.transaction.client == "/tester"
    assert removed.transaction.client.startswith("/rosservice_")


def test_the_topic(store):
    """An array is published with its caller and time; a single update is not."""
    from rosplan_knowledge_msgs.msg import StatusUpdate

    heard = []
    subscriber = rospy.Subscriber(f"/{NODE}/status/update", StatusUpdate, heard.append)
    until(lambda: subscriber.get_num_connections() == 1)
    call("update", update_type=ADD, knowledge=ITEMS.fact("busy", BATTERY))
    call("update_array", update_type=[REMOVE], knowledge=[ITEMS.fact("busy", BATTERY)])
    until(lambda: heard)
    subscriber.unregister()
    (status,) = heard
    assert status.last_update_client == "/tester"
    with recorded(store) as kb:
        assert list(kb.changes())[-1].transaction.time == status.last_update_time.to_nsec()


def test_an_error_reaches_the_caller(store):
    """The error of the service has kbstore's sentence."""
    with pytest.raises(rospy.ServiceException, match="no operator fly"):
        call("domain/operator_details", name="fly")
    with pytest.raises(rospy.ServiceException, match="flying"):
        call("query_state", knowledge=[ITEMS.fact("flying", BATTERY)])


def test_many_callers_at_once(store):
    """200 calls from 4 threads: each is recorded, and numbers have no gaps."""
    with recorded(store) as kb:
        before = list(kb.changes())[-1].number
    failed = []

    def work(thread):
        for index in range(50):
            item = ITEMS.instance(f"w{thread}_{index}", "room")
            if not call("update", update_type=ADD, knowledge=item).success:
                failed.append(item)

    threads = [threading.Thread(target=work, args=(number,)) for number in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert failed == []
    with recorded(store) as kb:
        assert [change.number for change in kb.changes(after=before)] == list(range(before + 1, before + 201))


def test_clear_goes_last(store):
    """The state is empty, its past is not."""
    call("clear")
    assert facts() == set()
    with recorded(store) as kb:
        assert [str(found.item) for found in kb.history("(at kenny ?)")] == ["(at kenny hall)"]


def test_a_restart_continues(graph, files, tmp_path):
    """The problem is loaded once; later changes are there after a restart, and so are parameters."""
    store = tmp_path / "robot.db"
    with serving(store, *files, "_use_unknowns:=true", node=other.node):
        other("update", update_type=REMOVE, knowledge=ITEMS.fact("at", AT_HALL))
        asked = [ITEMS.fact("busy", BATTERY), ITEMS.fact("busy", BATTERY, is_negative=True)]
        assert list(other("query_state", knowledge=asked).results) == [False, False]
        either = [ITEMS.fact("at", AT_HALL), ITEMS.fact("at", (("r", "kenny"), ("p", "dock")))]
        assert other("update_constraints_oneof", knowledge=either).success
    with serving(store, *files, node=other.node, by_parameters=True):
        assert facts(other) == set()
        assert [str(kbstore.item(goal)) for goal in other("state/goals").attributes] == ["(at kenny dock)"]
    with recorded(store) as kb:
        assert kb.constraints() == ["(oneof (at kenny hall) (at kenny dock))"]
        assert next(kb.changes()).transaction.client == "/other"


def test_a_simulated_clock(graph, files, tmp_path):
    """Now is /clock with use_sim_time, to the nanosecond; one that restarts at 0 is an error, and stores nothing."""
    from rosgraph_msgs.msg import Clock

    shown = [rospy.Time(100, 500_000_007)]
    publisher = rospy.Publisher("/clock", Clock, queue_size=1)
    stop = threading.Event()

    def tick():
        while not stop.wait(0.02):
            publisher.publish(Clock(shown[-1]))

    rospy.set_param("/use_sim_time", True)
    ticking = threading.Thread(target=tick)
    ticking.start()
    store = tmp_path / "robot.db"
    try:
        with serving(store, *files, node=other.node) as log:
            assert other("update", update_type=ADD, knowledge=ITEMS.fact("busy", BATTERY)).success
            (busy,) = other("state/propositions", predicate_name="busy").attributes
            assert busy.initial_time == shown[0]
            shown.append(rospy.Time(1))

            def is_refused():
                return not other("update", update_type=REMOVE, knowledge=ITEMS.fact("busy", BATTERY)).success

            # an update before the node has read the new time is a removal; it is added again at the old time
            until(lambda: is_refused() or not other("update", update_type=ADD, knowledge=ITEMS.fact("busy", BATTERY)))
            with pytest.raises(rospy.ServiceException, match="a knowledge base name of its own"):
                other("clear")
            assert "begins anew (a simulation at 0)" in log.read_text()
    finally:
        stop.set()
        ticking.join()
        rospy.delete_param("/use_sim_time")
    with recorded(store) as kb:
        assert next(found.initial_time for found in kb.history("(busy kenny)")) == seconds(100) + 500_000_007


@contextmanager
def empty_service():
    """A node in a separate process that answers at once: the cost of a call without computing an answer."""
    code = (
        "import rospy; from std_srvs.srv import Empty, EmptyResponse as Done; rospy.init_node('nothing'); "
        "rospy.Service('nothing', Empty, lambda _: Done()); rospy.spin()"
    )
    process = subprocess.Popen([sys.executable, "-c", code])
    try:
        rospy.wait_for_service("/nothing", 30)
        yield
    finally:
        process.terminate()
        process.wait(30)


def test_the_cost_of_a_call(graph, files, tmp_path, capsys):
    """Printed, not judged: an ordinary call beside the same question in Python and an empty service call.

    For many items genpy's own part is printed, too: writing them, and reading them again.
    """
    from std_srvs.srv import Empty

    store = tmp_path / "robot.db"
    at_hall = kbstore.item("(at kenny hall)")
    with serving(store, *files, node=other.node), empty_service(), kbstore.open(store, "kenny") as kb:
        kb.add(*(f"r{number} - robot" for number in range(100)), *(f"(busy r{number})" for number in range(100)))
        nothing = rospy.ServiceProxy("/nothing", Empty)
        predicates, query, propositions, update = map(
            other.proxy, ("domain/predicates", "query_state", "state/propositions", "update")
        )
        fact, many = ITEMS.fact("at", AT_HALL), propositions(predicate_name="busy")
        found = {
            name: medians(call, python, nothing, number=100)
            for name, call, python in (
                ("domain/predicates", predicates, lambda: kb.domain.predicates),
                ("query_state", lambda: query(knowledge=[fact]), lambda: kb.query(at_hall)),
                (
                    "state/propositions, 100 facts",
                    lambda: propositions(predicate_name="busy"),
                    lambda: kb.propositions("busy"),
                ),
                ("update", lambda: update(update_type=ADD, knowledge=fact), lambda: kb.add(at_hall)),
            )
        }

        def through_genpy():
            buffer = BytesIO()
            many.serialize(buffer)
            type(many)().deserialize(buffer.getvalue())

        (genpy,) = medians(through_genpy, number=100)
    assert len(many.attributes) == 100
    with capsys.disabled():
        show(found)
        print(f"genpy takes {genpy:.2f} ms to write and read the 100 facts")


def test_a_failed_start_names_the_reason(graph, tmp_path):
    """One line, and exit code 2: no store, a missing domain."""
    for arguments, sentence in (
        (["_domain_path:=nowhere.pddl"], "nowhere.pddl"),
        (["_kb:=kenny", "_url:="], "which store? name it with --url FILE"),
    ):
        words = command(tmp_path / "robot.db", *arguments)
        if "which store" in sentence:
            del words[5:9]
            assert "--url" not in words
        done = subprocess.run(words, capture_output=True, text=True, check=False, timeout=60)
        assert done.returncode == 2
        assert sentence in done.stderr.splitlines()[-1]
