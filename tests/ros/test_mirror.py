"""A knowledge base that mirrors PlanSys2: snapshots, goals, types of objects, plans, and executions as runs."""

import pytest

import kbstore
from kbstore.clock import ManualClock, seconds
from kbstore.errors import ClockWentBackwards, InvalidKnowledge, UnknownSymbol
from kbstore.ros.mirror import Mirror
from tests.ros.plansys2_doubles import DOMAIN, hub, info, knowledge, node, param, plan

CONFIRM, FEEDBACK, FINISH, CANCEL = 3, 5, 6, 7
NOT_EXECUTED, EXECUTING, FAILED, SUCCEEDED, CANCELLED = range(1, 6)
FUNCTION = 6
MOVE = "(move r1 a b)"


@pytest.fixture
def clock():
    return ManualClock(seconds(100))


@pytest.fixture
def kb(clock):
    with kbstore.open("sqlite://", "mirror", clock=clock) as found:
        yield found


@pytest.fixture
def mirror(kb, clock):
    found = Mirror(kb, clock, domain=DOMAIN)
    found.give_types([param("r1", "robot"), param("a", "room"), param("b", "room"), param("cup", "item")])
    return found


def held(kb, at=None):
    """The facts that hold, as text."""
    return sorted(map(str, kb.propositions(at=at)))


def runs(kb):
    """The runs, with starts and ends in seconds."""
    return [
        (f"({' '.join((run.operator, *run.arguments))})", run.started / 1e9, run.ended and run.ended / 1e9, run.outcome)
        for run in kb.runs()
    ]


def notes(kb):
    return [change.transaction.note for change in kb.changes()]


# -- snapshots ------------------------------------------------------------------------------------------------


def test_the_state_is_that_of_the_snapshot(kb, mirror):
    """C13: facts that a snapshot does not list have ended; those that it lists again continue."""
    mirror.knowledge(knowledge("r1 a b", ["(robot_at r1 a)", "(free r1)"]), seconds(101))
    mirror.knowledge(knowledge("r1 a b", ["(robot_at r1 b)", "(free r1)"]), seconds(102))
    assert held(kb) == ["(free r1)", "(robot_at r1 b)"]
    assert held(kb, at=seconds(101)) == ["(free r1)", "(robot_at r1 a)"]
    (free,) = kb.history("(free r1)")
    assert (free.initial_time, free.end_time) == (seconds(101), None)


def test_an_unchanged_snapshot_is_not_recorded(kb, mirror):
    """C1: the same snapshot again is no transaction, its goal included; also for a new mirror."""
    first = knowledge("r1 a", ["(robot_at r1 a)"], goal="(and (robot_at r1 a)(not (free r1)))")
    number = mirror.knowledge(first, seconds(101)).number
    assert mirror.knowledge(first, seconds(102)).number == number
    assert Mirror(kb, mirror._clock).knowledge(first, seconds(103)).number == number


def test_writes_of_others_do_not_last(kb, mirror):
    """C13: a snapshot counts as a whole, also where another client has written since the last one."""
    snapshot = knowledge("r1 a b", ["(robot_at r1 a)"], goal="(and (free r1))")
    mirror.knowledge(snapshot, seconds(101))
    kb.add("(free r1)", "(= (battery r1) 3)", client="somebody")
    kb.remove("a - room", client="somebody")
    kb.add_goal("(robot_at r1 b)", client="somebody")
    mirror.knowledge(snapshot, seconds(102))
    assert held(kb) == ["(robot_at r1 a)"]
    assert kb.functions() == []
    assert [*map(str, kb.goals())] == ["(free r1)"]


def test_an_object_that_comes_back_with_another_type(kb, mirror):
    """C6, C9: its mentions end with it, and the snapshot's facts hold from then on."""
    mirror.knowledge(knowledge("r1 a", ["(robot_at r1 a)"]), seconds(101))
    mirror.give_types([param("a", "dock")])
    mirror.knowledge(knowledge("r1 a", ["(robot_at r1 a)"]), seconds(102))
    assert types(kb) == {"r1": "robot", "a": "dock"}
    assert [found.initial_time for found in kb.history("(robot_at r1 a)")] == [seconds(101), seconds(102) + 1]
    again = Mirror(kb, mirror._clock)
    again.give_types([param("a", "room")])
    again.knowledge(knowledge("r1 a", ["(robot_at r1 a)"]), seconds(103))
    assert types(kb) == {"r1": "robot", "a": "room"}


def test_the_goal_is_that_of_the_snapshot(kb, mirror):
    """A goal replaces the one before, and an empty one ends it, in the transaction of the snapshot."""
    mirror.knowledge(knowledge("r1 a b", goal="(and (robot_at r1 a)(free r1))"), seconds(101))
    assert [*map(str, kb.goals())] == ["(robot_at r1 a)", "(free r1)"]
    mirror.knowledge(knowledge("r1 a b", goal="(and (robot_at r1 b)(free r1))"), seconds(102))
    assert [*map(str, kb.goals())] == ["(free r1)", "(robot_at r1 b)"]
    mirror.knowledge(knowledge("r1 a b"), seconds(103))
    assert kb.goals() == []
    assert len(kb.goals(at=seconds(101))) == 2


@pytest.mark.parametrize(
    ("text", "condition"),
    [
        ("(or (free r1)(robot_at r1 a))", "(or (free r1) (robot_at r1 a))"),
        ("(exists (?1) (and (robot_at ?1 a)))", "(exists (?1 - object) (and (robot_at ?1 a)))"),
        ("(and (>=  (battery r1) 20.000000))", "(>= (battery r1) 20)"),
    ],
)
def test_goals_as_plansys2_writes_them(kb, mirror, text, condition):
    """PlanSys2 writes quantifiers without types, and numbers with six decimals."""
    mirror.knowledge(knowledge("r1 a", goal=text), seconds(101))
    assert [*map(str, kb.goals())] == [condition]


def test_derived_predicates_and_constants_are_not_added(kb, mirror):
    """PlanSys2 lists derived facts among the predicates, and constants among the instances (V9, C8)."""
    mirror.knowledge(knowledge("hub r1 cup", ["(holding r1 cup)", "(busy r1)", "(robot_at r1 hub)"]), seconds(101))
    assert held(kb) == ["(holding r1 cup)", "(robot_at r1 hub)"]
    assert sorted(item.instance_name for item in kb.instances()) == ["cup", "r1"]
    assert kb.holds("(busy r1)")


def test_functions_have_the_values_of_the_nodes(kb, mirror):
    """A `Knowledge` lists functions without values, which come beside it."""
    message = knowledge("r1", functions=["(battery r1)", "(trips)"])
    values = [node(FUNCTION, "battery", "r1", value=80.5), node(FUNCTION, "trips", value=2)]
    mirror.knowledge(message, seconds(101), values)
    assert [*map(str, kb.functions())] == ["(= (battery r1) 80.5)", "(= (trips) 2)"]


def test_functions_without_values_keep_the_recorded_ones(kb, mirror):
    """Without nodes a listed function keeps its value, one that is not listed ends, and a new one is undefined."""
    values = [node(FUNCTION, "battery", "r1", value=80.5), node(FUNCTION, "trips", value=2)]
    mirror.knowledge(knowledge("r1", functions=["(battery r1)", "(trips)"]), seconds(101), values)
    mirror.knowledge(knowledge("r1", functions=["(battery r1)"]), seconds(102))
    assert [*map(str, kb.functions())] == ["(= (battery r1) 80.5)"]
    mirror.knowledge(knowledge("r1", functions=["(battery r1)", "(trips)"]), seconds(103))
    assert [*map(str, kb.functions())] == ["(= (battery r1) 80.5)"]


def test_an_invalid_snapshot_changes_nothing(kb, mirror):
    """D1: an object that is not listed among the instances is refused, and nothing is stored."""
    mirror.knowledge(knowledge("r1 a", ["(robot_at r1 a)"]), seconds(101))
    with pytest.raises(InvalidKnowledge, match="b"):
        mirror.knowledge(knowledge("r1 a", ["(robot_at r1 b)"]), seconds(102))
    with pytest.raises(InvalidKnowledge, match="is not a predicate"):
        mirror.knowledge(knowledge("r1 a", ["(not (free r1))"]), seconds(103))
    assert held(kb) == ["(robot_at r1 a)"]


def test_a_restarted_clock_is_refused(kb, mirror):
    """T3: a message from before the latest recorded time is refused; the error says why."""
    mirror.knowledge(knowledge("r1"), seconds(101))
    with pytest.raises(ClockWentBackwards):
        mirror.knowledge(knowledge("r1 a"), 0)


def test_a_domain_is_needed(kb, clock):
    """Without a domain, given or stored, there are no types."""
    with pytest.raises(UnknownSymbol, match="domain"):
        Mirror(kb, clock)


# -- types of objects -----------------------------------------------------------------------------------------


def without_types(kb, clock, **options):
    return Mirror(kb, clock, domain=DOMAIN, **options)


def types(kb):
    return {item.instance_name: item.instance_type for item in kb.instances()}


def test_types_come_from_parameters_without_a_choice(kb, clock):
    """The robot of (free r1) can only be a robot, as that has no subtypes."""
    without_types(kb, clock).knowledge(knowledge("r1 cup", ["(holding r1 cup)"], ["(battery r1)"]), seconds(101))
    assert types(kb) == {"r1": "robot", "cup": "item"}


def test_types_with_a_choice_are_refused(kb, clock):
    """A room may be a dock: then the type comes from the problem, or the snapshot is refused with the choice."""
    message = knowledge("r1 a", ["(robot_at r1 a)"])
    with pytest.raises(InvalidKnowledge, match="the type of a is not given, and may be dock or room"):
        without_types(kb, clock).knowledge(message, seconds(101))
    problem = "(define (problem p) (:domain delivery) (:objects a - dock) (:init) (:goal (and)))"
    without_types(kb, clock, problem=problem).knowledge(message, seconds(102))
    assert types(kb) == {"r1": "robot", "a": "dock"}


def test_an_object_in_no_predicate_is_refused(kb, clock):
    """An object without facts may have any type."""
    with pytest.raises(InvalidKnowledge, match="type of thing"):
        without_types(kb, clock).knowledge(knowledge("thing"), seconds(101))


def test_later_snapshots_can_be_looked_at_first(kb, clock):
    """`learn` infers types without recording: for bags, in which objects come before their facts."""
    mirror = without_types(kb, clock)
    mirror.learn(knowledge("cup", ["(holding r1 cup)"]))
    mirror.knowledge(knowledge("cup"), seconds(101))
    assert types(kb) == {"cup": "item"}


def test_the_type_fits_all_facts_of_an_object(kb, clock):
    """The type has to fit all facts of an object; where none does, the error says so."""
    domain = """(define (domain d) (:types pet car - object dog cat - pet)
        (:predicates (barks ?x - (either dog car)) (eats ?x - pet) (drives ?x - car)))"""
    mirror = Mirror(kb, clock, domain=domain)
    mirror.knowledge(knowledge("rex", ["(barks rex)", "(eats rex)"]), seconds(101))
    assert types(kb) == {"rex": "dog"}
    mirror.learn(knowledge("it", ["(eats it)", "(drives it)"]))
    with pytest.raises(InvalidKnowledge, match="no type fits"):
        mirror.knowledge(knowledge("it"), seconds(102))


def test_types_are_known_after_a_restart(kb, clock, mirror):
    """The recorded types are used."""
    mirror.knowledge(knowledge("r1 a", ["(robot_at r1 a)"]), seconds(101))
    again = Mirror(kb, clock)
    assert again.missing_types(knowledge("r1 a cup hub")) == ["cup"]


# -- executions -----------------------------------------------------------------------------------------------


@pytest.fixture
def moving(mirror):
    """A mirror of a robot at `a`, at 101 s."""
    mirror.knowledge(knowledge("r1 a b", ["(robot_at r1 a)"]), seconds(101))
    return mirror


def test_an_execution_becomes_a_run(kb, moving):
    """`actions_hub` reports starts and ends as they happen; the reports of each second add nothing."""
    moving.actions_hub(hub(CONFIRM, MOVE), seconds(102))
    moving.action_execution_info(info(EXECUTING, seconds(102), MOVE, duration=seconds(12)), seconds(103))
    moving.actions_hub(hub(FEEDBACK, MOVE), seconds(104))
    moving.actions_hub(hub(FINISH, MOVE, success=True, status="arrived"), seconds(110))
    moving.action_execution_info(info(SUCCEEDED, seconds(102), MOVE), seconds(111))
    assert runs(kb) == [(MOVE, 102, 110, "ended")]
    assert notes(kb)[-1] == "(move r1 a b) succeeded; arrived"


def test_an_execution_is_known_from_its_reports_alone(kb, moving):
    """Without `actions_hub` a run is recorded when it is reported; the note has the time of its start."""
    move = info(NOT_EXECUTED, seconds(101), MOVE)
    moving.action_execution_info(move, seconds(102))
    moving.action_execution_info(info(EXECUTING, seconds(103), MOVE, duration=seconds(12)), seconds(104))
    moving.action_execution_info(info(EXECUTING, seconds(103), MOVE, duration=seconds(12)), seconds(105))
    assert [(run.duration, run.outcome) for run in kb.runs()] == [(seconds(12), "running")]
    moving.action_execution_info(info(FAILED, seconds(103), MOVE, message="stuck"), seconds(106))
    assert runs(kb) == [(MOVE, 104, 106, "aborted")]
    assert notes(kb)[-2:] == ["(move r1 a b):0 executing since 1970-01-01T00:01:43Z", "(move r1 a b):0 failed; stuck"]


def test_the_report_before_the_confirmation(kb, moving):
    """Topics are not ordered among each other: the first report is recorded, once."""
    moving.action_execution_info(info(EXECUTING, seconds(102), MOVE), seconds(102))
    moving.actions_hub(hub(CONFIRM, MOVE), seconds(102))
    moving.action_execution_info(info(SUCCEEDED, seconds(102), MOVE), seconds(107))
    moving.actions_hub(hub(FINISH, MOVE, success=True), seconds(107))
    moving.action_execution_info(info(EXECUTING, seconds(102), MOVE), seconds(107))
    assert runs(kb) == [(MOVE, 102, 107, "ended")]


@pytest.mark.parametrize(
    ("message", "outcome"),
    [
        (hub(FINISH, MOVE, success=True), "ended"),
        (hub(FINISH, MOVE, success=False), "aborted"),
        (hub(CANCEL, MOVE), "aborted"),
        (info(SUCCEEDED, seconds(102), MOVE), "ended"),
        (info(FAILED, seconds(102), MOVE), "aborted"),
        (info(CANCELLED, seconds(102), MOVE), "aborted"),
    ],
)
def test_failures_abort(kb, moving, message, outcome):
    """Only a success ends a run; a failure and a cancellation abort it."""
    moving.actions_hub(hub(CONFIRM, MOVE), seconds(102))
    if hasattr(message, "node_id"):
        moving.actions_hub(message, seconds(105))
    else:
        moving.action_execution_info(message, seconds(105))
    assert runs(kb) == [(MOVE, 102, 105, outcome)]


def test_effects_are_left_to_the_snapshots(kb, moving):
    """PlanSys2 applies effects itself, before a start is confirmed; a run changes no fact and no number."""
    moving.knowledge(knowledge("r1 a b", functions=["(battery r1)"]), seconds(102), [node(FUNCTION, "battery", "r1")])
    moving.actions_hub(hub(CONFIRM, MOVE), seconds(103))
    moving.actions_hub(hub(FINISH, MOVE, success=True), seconds(104))
    assert held(kb) == []
    assert kb.value("(battery r1)") == 0
    assert runs(kb) == [(MOVE, 103, 104, "ended")]


def test_the_same_action_again_is_another_run(kb, moving):
    """Executions of equal actions are distinguished by their starts."""
    for start in (102, 106):
        moving.actions_hub(hub(CONFIRM, MOVE), seconds(start))
        moving.action_execution_info(info(EXECUTING, seconds(start), MOVE), seconds(start + 1))
        moving.actions_hub(hub(FINISH, MOVE, success=True), seconds(start + 2))
        moving.action_execution_info(info(SUCCEEDED, seconds(start), MOVE), seconds(start + 3))
    assert runs(kb) == [(MOVE, 102, 104, "ended"), (MOVE, 106, 108, "ended")]


def test_an_execution_between_two_reports(kb, moving):
    """One that has ended at its first report is recorded as a run without length."""
    moving.action_execution_info(info(SUCCEEDED, seconds(102), MOVE), seconds(103))
    moving.action_execution_info(info(SUCCEEDED, seconds(102), MOVE), seconds(104))
    assert runs(kb) == [(MOVE, 103, 103, "ended")]


def test_a_restart_in_the_middle(kb, clock, moving):
    """A new mirror knows the recorded runs: they continue, and ended ones are not recorded again."""
    wait = "(wait)"
    moving.actions_hub(hub(CONFIRM, MOVE), seconds(102))
    moving.actions_hub(hub(CONFIRM, wait), seconds(103))
    moving.actions_hub(hub(FINISH, wait, success=True), seconds(104))
    again = Mirror(kb, clock)
    again.action_execution_info(info(EXECUTING, seconds(102), MOVE), seconds(105))
    again.action_execution_info(info(SUCCEEDED, seconds(103), wait), seconds(105))
    again.action_execution_info(info(SUCCEEDED, seconds(102), MOVE), seconds(106))
    assert runs(kb) == [(MOVE, 102, 106, "ended"), (wait, 103, 104, "ended")]


def test_an_end_that_was_missed(kb, clock, moving):
    """Where the same action executes again after a gap, the run before it is aborted, as its end is not known."""
    moving.actions_hub(hub(CONFIRM, MOVE), seconds(102))
    again = Mirror(kb, clock)
    again.action_execution_info(info(EXECUTING, seconds(150), MOVE), seconds(151))
    assert runs(kb) == [(MOVE, 102, 151, "aborted"), (MOVE, 151, None, "running")]


def test_stamps_of_another_clock(kb, moving):
    """A bag may have the wall clock's times, and stamps of a simulator that begins at 0."""
    wall = seconds(1_800_000_000)
    moving.actions_hub(hub(CONFIRM, MOVE), wall)
    moving.action_execution_info(info(EXECUTING, seconds(5), MOVE), wall + seconds(1))
    moving.action_execution_info(info(SUCCEEDED, seconds(5), MOVE), wall + seconds(3))
    assert runs(kb) == [(MOVE, 1_800_000_000, 1_800_000_003, "ended")]


def test_the_plan_is_a_note(kb, moving):
    """The first start after a plan has it as its note, and durations come from it where nothing else gives them."""
    steps = plan((0.0, MOVE, 12.5), (12.501, "(wait)", 1.0))
    moving.plan(steps)
    moving.actions_hub(hub(CONFIRM, MOVE), seconds(102))
    moving.plan(steps)
    moving.plan(plan())
    moving.actions_hub(hub(CONFIRM, "(wait)"), seconds(103))
    assert notes(kb)[-2:] == [
        "(move r1 a b) confirmed to move_performer; plan: 0.000: (move r1 a b) [12.500]; 12.501: (wait) [1.000]",
        "(wait) confirmed to move_performer",
    ]
    assert [run.duration for run in kb.runs()] == [seconds(12.5), seconds(1)]


def test_an_instantaneous_action_takes_time_where_it_is_executed(kb, mirror):
    """PlanSys2 executes actions that are instantaneous in PDDL: they are runs, too."""
    mirror.knowledge(knowledge("r1 a cup", ["(robot_at r1 a)"]), seconds(101))
    mirror.actions_hub(hub(CONFIRM, "(grab r1 cup a)"), seconds(102))
    mirror.actions_hub(hub(FINISH, "(grab r1 cup a)", success=True), seconds(103))
    assert runs(kb) == [("(grab r1 cup a)", 102, 103, "ended")]


def test_entries_that_are_not_executions(kb, moving):
    """The executor's entry for the initial state is skipped; an unknown action or object is an error."""
    moving.action_execution_info(info(SUCCEEDED, seconds(101), "(INIT)", name=":0"), seconds(102))
    with pytest.raises(UnknownSymbol):
        moving.actions_hub(hub(CONFIRM, "(fly r1 a b)"), seconds(102))
    with pytest.raises(InvalidKnowledge, match="cellar"):
        moving.actions_hub(hub(CONFIRM, "(move r1 a cellar)"), seconds(102))
    assert runs(kb) == []
