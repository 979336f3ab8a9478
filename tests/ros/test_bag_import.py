"""Bags become knowledge bases: an hour of a mission in rosbag1, and in rosbag2 with SQLite and MCAP."""

import sqlite3
from contextlib import closing
from pathlib import Path

import pytest

import kbstore
from kbstore.clock import SECOND
from kbstore.ros.bags.importing import import_bag
from tests.ros.bag_files import BEGIN, DOMAIN, HOUR, drives, mission, rosplan_hour, write

KINDS = ("1", "sqlite3", "mcap")


def bag_path(place, kind):
    return place / ("tour.bag" if kind == "1" else "tour")


@pytest.fixture(scope="module", params=KINDS)
def bag(request, tmp_path_factory):
    """An hour of PlanSys2 in a bag of each kind."""
    return write(bag_path(tmp_path_factory.mktemp("bags"), request.param), request.param, mission)


@pytest.fixture(scope="module")
def imported(bag):
    """The bag in a store, and the result of the import."""
    store = bag.parent / "robot.db"
    return store, import_bag(bag, store, "tour", domain=DOMAIN)


def opened(store, name="tour"):
    return kbstore.open(store, name, read_only=True)


def expected_places():
    """The places of the robot, by the drives alone: intervals in nanoseconds."""
    found, since, place = {room: [] for room in "abc"}, BEGIN, "a"
    for start, end, origin, to, succeeds in drives():
        found[place].append((since, start))
        since, place = end, to if succeeds else origin
    found[place].append((since, BEGIN + 2 * HOUR))
    return found


def test_an_hour_is_exact_to_the_nanosecond(imported):
    """Facts hold from the bag's times on, runs start and end at their reported times, and goals are there."""
    store, done = imported
    with opened(store) as kb:
        for room, intervals in expected_places().items():
            clipped = kb.when(f"(robot_at r1 {room})", BEGIN, BEGIN + 2 * HOUR)
            assert clipped == intervals
        expected = [
            (("r1", place, to), start, end, "ended" if succeeds else "aborted")
            for start, end, place, to, succeeds in drives()
        ]
        assert [(run.arguments, run.started, run.ended, run.outcome) for run in kb.runs("move")] == expected
        assert kb.when("(open a)", BEGIN, BEGIN + HOUR) == [(BEGIN, BEGIN + HOUR)]
        assert [str(goal) for goal in kb.goals()] == ["(robot_at r1 c)"]
        assert {str(item) for item in kb.instances()} == {"r1 - robot", "a - room", "b - room", "c - room"}
        planned = [tx.time for tx in kb.transactions() if "plan: 0.000: (move r1 " in tx.note]
        assert planned == [start for start, *_ in drives()][::10]
    assert (done.name, done.since) == ("tour", BEGIN)
    assert done.until == max(end for _, end, *_ in drives()) + SECOND
    assert done.messages == {"/problem_expert/knowledge": 361, "/action_execution_info": 120 * 22, "/planner/plan": 12}
    assert done.left_out == ("/rosout_text",)


def test_importing_again_changes_nothing(bag, imported):
    """The same bag into the same knowledge base records no transaction; the domain need not be given again."""
    store, done = imported
    with opened(store) as kb:
        before = list(kb.changes())
    assert len(before) == done.transactions
    for domain in (DOMAIN, None):
        again = import_bag(bag, store, "tour", domain=domain)
        assert (again.transactions, again.until) == (0, done.until)
    with opened(store) as kb:
        assert list(kb.changes()) == before


def history(kb):
    """Everything that is on record, without the numbers of transactions."""
    return [
        (change.transaction.time, change.transaction.client, change.transaction.note, len(change.asserted))
        for change in kb.changes()
    ]


class Interrupted(Exception):
    pass


def stopping(after):
    """A progress callback that interrupts an import."""

    def progress(done, total):
        assert 0 < done <= total
        if done >= after:
            raise Interrupted

    return progress


def test_an_interrupted_import_can_be_continued(bag, imported, tmp_path):
    """Interrupted twice, it has the same result as one import."""
    store = tmp_path / "robot.db"
    for after in (500, 1700):
        with pytest.raises(Interrupted):
            import_bag(bag, store, "tour", domain=DOMAIN, progress=stopping(after))
    import_bag(bag, store, "tour", domain=DOMAIN)
    with opened(store) as kb, opened(imported[0]) as whole:
        assert history(kb) == history(whole)
        assert [run.to_dict() for run in kb.runs()] == [run.to_dict() for run in whole.runs()]


@pytest.mark.parametrize("kind", KINDS)
def test_an_hour_of_rosplan(kind, tmp_path):
    """Problems give the state, actions run between their feedback with simple effects; a second import is no change."""
    bag, store = write(bag_path(tmp_path, kind), kind, rosplan_hour, sender="/dispatcher"), tmp_path / "robot.db"
    with pytest.raises(Interrupted):
        import_bag(bag, store, "tour", domain=DOMAIN, progress=stopping(150))
    import_bag(bag, store, "tour", domain=DOMAIN)
    with opened(store) as kb:
        for room, intervals in expected_by_problems().items():
            assert kb.when(f"(robot_at r1 {room})", BEGIN, BEGIN + 2 * HOUR) == intervals
        assert [(run.started, run.ended, run.outcome) for run in kb.runs("move")] == [
            (start, end, "ended" if succeeds else "aborted") for start, end, _, _, succeeds in drives()
        ]
        assert [str(goal) for goal in kb.goals()] == ["(robot_at r1 c)"]
        before = list(kb.changes())
    assert {change.transaction.client for change in before[1:]} == {"/dispatcher" if kind == "1" else "rosplan"}
    assert import_bag(bag, store, "tour", domain=DOMAIN).transactions == 0


def expected_by_problems():
    """The places of the robot: after a failed drive, only the next problem has its place."""
    found, since = {room: [] for room in "abc"}, BEGIN + SECOND - 5
    for start, end, origin, _, succeeds in drives():
        found[origin].append((since, start))
        since = end if succeeds else end + (10 * SECOND - 7) + 1 - 5
    assert not succeeds
    return found


# -- types of objects ---------------------------------------------------------------------------------------------

AMBIGUOUS = """
(define (domain tour)
  (:types robot room - thing)
  (:predicates (robot_at ?r - robot ?p - room) (dusty ?t - thing)))
"""
PROBLEM = "(define (problem one) (:domain tour) (:objects x - room) (:init) (:goal ()))"


def dusty(messages):
    yield 7, "/problem_expert/knowledge", messages.knowledge(["r1", "x"], ["(dusty x)"])
    yield 9, "/problem_expert/knowledge", messages.knowledge(["r1", "x", "a"], ["(robot_at r1 a)"])


def test_types_come_from_the_problem_or_from_predicates(tmp_path):
    """A later part of the bag gives the type of r1; that of x is open, until the problem is given."""
    bag, store = write(tmp_path / "tour", "mcap", dusty), tmp_path / "robot.db"
    with pytest.raises(kbstore.InvalidKnowledge) as caught:
        import_bag(bag, store, domain=AMBIGUOUS)
    (sentence,) = caught.value.violations
    assert sentence.startswith(f"{bag}: /problem_expert/knowledge at 1970-01-01T00:00:00.000000007Z: the type of x ")
    assert "robot or room or thing" in sentence
    import_bag(bag, store, domain=AMBIGUOUS, problem=PROBLEM)
    with opened(store) as kb:
        assert {str(item) for item in kb.instances()} == {"r1 - robot", "a - room", "x - room"}
        assert kb.when("(dusty x)", 0, 20) == [(7, 9)]
        assert kb.when("(robot_at r1 a)", 0, 20) == [(9, 20)]


def reported_on_the_hub(messages):
    def report(kind, success):
        return messages(
            "plansys2_msgs/msg/ActionExecution",
            type=kind,
            node_id="mover",
            action="move",
            arguments=["r1", "a", "b"],
            success=success,
            completion=0.0,
            status="",
        )

    yield 5, "/problem_expert/knowledge", messages.knowledge(["r1", "a", "b"], [])
    yield 7, "/actions_hub", report(3, False)
    yield 20, "/actions_hub", report(6, True)


@pytest.mark.parametrize("kind", KINDS)
def test_runs_and_types_come_from_the_hub(kind, tmp_path):
    """A confirmation starts a run, and a finish ends it; the parameters of an action give types, too."""
    bag, store = write(bag_path(tmp_path, kind), kind, reported_on_the_hub), tmp_path / "robot.db"
    import_bag(bag, store, "tour", domain=DOMAIN)
    assert import_bag(bag, store, "tour").transactions == 0
    with opened(store) as kb:
        assert [(run.started, run.ended, run.outcome) for run in kb.runs("(move r1 a b)")] == [(7, 20, "ended")]
        assert {str(item) for item in kb.instances()} == {"r1 - robot", "a - room", "b - room"}


def twice(messages):
    yield 5, "/problem_expert/knowledge", messages.knowledge(["a"], ["(open a)"])
    yield 5, "/problem_expert/knowledge", messages.knowledge(["a"], [])
    yield 5, "/problem_expert/knowledge", messages.knowledge(["a", "b"], ["(open b)"])


@pytest.mark.parametrize("kind", KINDS)
def test_the_last_snapshot_of_a_time_counts(kind, tmp_path):
    """Two snapshots of one nanosecond leave no trace of the first, and a second import is no change."""
    bag, store = write(bag_path(tmp_path, kind), kind, twice), tmp_path / "robot.db"
    for new in (2, 0):
        assert import_bag(bag, store, "tour", domain=DOMAIN).transactions == new
    with opened(store) as kb:
        assert [str(found.item) for found in kb.history("(open ?)")] == ["(open b)"]


def test_a_bag_without_definitions(tmp_path):
    """Bags of ROS 2 before Iron do not have the definitions of their messages; those of PlanSys2 are built in."""
    bag, store = write(tmp_path / "tour", "sqlite3", mission), tmp_path / "robot.db"
    with closing(sqlite3.connect(next(bag.glob("*.db3")))) as file:
        assert file.execute("DELETE FROM message_definitions").rowcount > 0
        file.commit()
    import_bag(bag, store, "tour", domain=DOMAIN)
    with opened(store) as kb:
        assert [(run.started, run.ended) for run in kb.runs("move")] == [(start, end) for start, end, *_ in drives()]
        assert kb.when("(robot_at r1 b)", BEGIN, BEGIN + 2 * HOUR) == expected_places()["b"]


def one_snapshot(messages):
    yield 5, "/problem_expert/knowledge", messages.knowledge(["a"], ["(open a)"])


def test_the_name_of_the_bag(tmp_path, monkeypatch):
    """The name of its directory, also from within and with dots in it, or of its file without the ending."""
    bag = write(tmp_path / "tour_2026.11.30", "mcap", one_snapshot)
    monkeypatch.chdir(bag)
    (file,) = bag.glob("*.mcap")
    file.rename("monday.mcap")
    store = tmp_path / "robot.db"
    assert import_bag("monday.mcap", store, domain=DOMAIN).name == "monday"
    Path("monday.mcap").rename(file.name)
    for path in (".", bag):
        assert import_bag(path, store, domain=DOMAIN).name == "tour_2026.11.30"


# -- what cannot be imported --------------------------------------------------------------------------------------


def other_topics(messages):
    yield 5, "/chatter", messages.text("hello")


def two_worlds(messages):
    for name in ("/r1", "/r2"):
        yield 5, f"{name}/problem_expert/knowledge", messages.knowledge(["a"], [])


def two_planners(messages):
    yield 5, "/problem_expert/knowledge", messages.knowledge(["a"], [])
    yield 6, "/problem_instance", messages.text("(define (problem p))")


def unknown_predicate(messages):
    yield 5, "/problem_expert/knowledge", messages.knowledge(["a"], ["(open a)"])
    yield 6, "/problem_expert/knowledge", messages.knowledge(["a"], ["(flying a)"])


def unknown_predicate_of_a_new_object(messages):
    yield 5, "/problem_expert/knowledge", messages.knowledge(["a"], ["(open a)"])
    yield 6, "/problem_expert/knowledge", messages.knowledge(["a", "b"], ["(flying b)"])


def unknown_action(messages):
    yield 5, "/problem_expert/knowledge", messages.knowledge(["a"], ["(open a)"])
    yield 6, "/action_execution_info", messages.info(2, 6, "(fly a)", 6)


@pytest.mark.parametrize(
    ("made", "why"),
    [
        (other_topics, r"no topic of PlanSys2 or of ROSPlan: it has /chatter"),
        (two_worlds, r"several worlds, /r1/problem_expert/knowledge and /r2/"),
        (two_planners, r"topics of PlanSys2 and of ROSPlan, /problem_expert/knowledge, /problem_instance; make a bag"),
        (unknown_predicate, r"/problem_expert/knowledge at 1970-01-01T00:00:00.000000006Z: .*flying"),
        (unknown_predicate_of_a_new_object, r"/knowledge at 1970-01-01T00:00:00.000000006Z: .*flying"),
        (unknown_action, r"/action_execution_info at 1970-01-01T00:00:00.000000006Z: .*no operator fly"),
    ],
)
def test_messages_that_do_not_fit_are_refused(tmp_path, made, why):
    """The error names the bag, and the topic and time of a message; earlier messages are recorded."""
    bag, store = write(tmp_path / "tour", "sqlite3", made), tmp_path / "robot.db"
    with pytest.raises(kbstore.KbStoreError, match=why):
        import_bag(bag, store, "tour", domain=DOMAIN)
    if made.__name__.startswith("unknown"):
        with opened(store) as kb:
            assert kb.when("(open a)", 0, 100) == [(5, 100)]


def test_another_knowledge_base_is_left_alone(bag, tmp_path):
    """A knowledge base that was not made from this bag is not written to."""
    store = tmp_path / "robot.db"
    with kbstore.open(store, "tour") as kb:
        kb.load(DOMAIN)
    with pytest.raises(kbstore.InvalidKnowledge, match=r"tour has another history, .* import it under another name"):
        import_bag(bag, store, "tour", domain=DOMAIN)
    with opened(store) as kb:
        assert len(list(kb.changes())) == 1


def test_files_that_are_not_bags(tmp_path):
    """A missing file, and one of another format."""
    with pytest.raises(FileNotFoundError):
        import_bag(tmp_path / "none.bag", tmp_path / "robot.db", domain=DOMAIN)
    for name in ("text.bag", "text.mcap", "text.db3", "text.txt", "directory"):
        path = tmp_path / name
        path.mkdir() if name == "directory" else path.write_text("not a bag")
        with pytest.raises(kbstore.InvalidKnowledge, match="cannot be read as a bag"):
            import_bag(path, tmp_path / "robot.db", domain=DOMAIN)
    with pytest.raises(kbstore.InvalidKnowledge, match=r"no metadata.yaml, .* give the .mcap or .db3 file in it"):
        import_bag(tmp_path / "directory", tmp_path / "robot.db", domain=DOMAIN)
    assert not (tmp_path / "robot.db").exists()


def test_a_domain_is_required(bag, tmp_path):
    """A bag does not have the domain."""
    with pytest.raises(kbstore.InvalidKnowledge, match="does not have the domain; give it once"):
        import_bag(bag, tmp_path / "robot.db", "tour")
