"""PlanSys2's problem expert on a knowledge base: PlanSys2's own expectations, and answers compared with the state."""

import pytest

import kbstore
from kbstore.clock import ManualClock, seconds
from kbstore.interop.plansys2 import NodeType
from kbstore.ros.plansys2_problem import ProblemExpert
from tests.ros.plansys2_calls import Messages, call, function, node, param, predicate, text, tree

DOMAIN = """
(define (domain simple)
  (:requirements :strips :typing :fluents :derived-predicates)
  (:types Person message robot room - object
          teleporter_room - room)
  (:constants hall - teleporter_room)
  (:predicates (Robot_At ?r - robot ?p - room) (person_at ?p - person ?r - room) (talked ?r - robot ?p - person)
               (enabled ?r - teleporter_room) (quiet) (inferred_at ?r - robot ?p - room))
  (:functions (distance ?a ?b - room) (speed ?r - robot))
  (:derived (inferred_at ?r - robot ?p - room) (robot_at ?r ?p)))
"""

PROBLEM = """
(define (problem p) (:domain simple)
  (:objects leia - robot jack - person kitchen bedroom - room)
  (:init (robot_at leia kitchen) (person_at jack bedroom) (= (distance kitchen bedroom) 10))
  (:goal (and (talked leia jack))))
"""


@pytest.fixture
def kb():
    with kbstore.open("sqlite://", "experts", clock=ManualClock(seconds(100))) as found:
        found.load(DOMAIN)
        yield found


@pytest.fixture
def expert(kb):
    return ProblemExpert(kb, Messages(), client="problem_expert")


@pytest.fixture
def filled(expert):
    for name, type_name in (("leia", "robot"), ("jack", "person"), ("kitchen", "room"), ("bedroom", "teleporter_room")):
        assert call(expert, "add_problem_instance", param=param(name, type_name)).success
    return expert


def succeeds(expert, service, **fields):
    response = call(expert, service, **fields)
    assert (response.success, response.error_info) == (True, "")
    return response


def fails(expert, service, **fields):
    """The reason of a refusal, which leaves the knowledge base as it was."""
    before = [change.number for change in expert._kb.changes()]
    response = call(expert, service, **fields)
    assert response.success is False
    assert response.error_info
    assert [change.number for change in expert._kb.changes()] == before
    return response.error_info


def instances(expert):
    return {found.name: found.type for found in call(expert, "get_problem_instances").instances}


def states(expert, service):
    return sorted(map(text, call(expert, service).states))


# -- instances ------------------------------------------------------------------------------------------------


def test_an_instance_is_added_once(expert, kb):
    """Adding it again succeeds and changes nothing; types are found in any case."""
    succeeds(expert, "add_problem_instance", param=param("Paco", "person"))
    succeeds(expert, "add_problem_instance", param=param("Paco", "PERSON"))
    assert [change.number for change in kb.changes()] == [1, 2]
    assert instances(expert) == {"Paco": "person", "hall": "teleporter_room"}
    assert [item.instance_name for item in kb.instances()] == ["Paco"]


@pytest.mark.parametrize(
    ("instance", "reason"),
    [
        (param("jack", "room"), "room"),
        (param("r2d2", "scientific"), "no type scientific"),
        (param("r2d2"), "without a type"),
        (param("", "robot"), "empty"),
        (param("?x", "robot"), "?x"),
        (param("two words", "robot"), "white space"),
        (param("hall", "robot"), "constant"),
    ],
)
def test_instances_that_are_refused(filled, instance, reason):
    """Another type, an unknown one, none, and names that PDDL cannot have."""
    assert reason in fails(filled, "add_problem_instance", param=instance)


def test_a_constant_exists_already(expert, kb):
    """PlanSys2 takes a constant for an instance; here it always exists (C8), and cannot be removed."""
    succeeds(expert, "add_problem_instance", param=param("hall", "Teleporter_Room"))
    assert "constant" in fails(expert, "remove_problem_instance", param=param("hall"))
    assert call(expert, "get_problem_instance", instance="HALL").instance.name == "hall"
    assert kb.instances() == []


def test_an_instance_has_its_type_and_subtypes(filled):
    """`Param` has the type and its subtypes."""
    found = succeeds(filled, "get_problem_instance", instance="Kitchen").instance
    assert (found.name, found.type, found.sub_types) == ("kitchen", "room", ["teleporter_room"])
    assert "no object yoda" in fails(filled, "get_problem_instance", instance="yoda")


def test_removing_an_instance_ends_its_mentions(filled, kb):
    """Facts, functions and parts of the goal that mention it end with it (C9); its type need not be given."""
    succeeds(filled, "add_problem_predicate", node=predicate("robot_at", "leia", "kitchen"))
    succeeds(filled, "add_problem_predicate", node=predicate("person_at", "jack", "bedroom"))
    succeeds(filled, "add_problem_function", node=function("distance", "kitchen", "bedroom", value=3))
    goal = tree(
        node(NodeType.AND, children=[1, 2]),
        predicate("robot_at", "leia", "kitchen"),
        predicate("person_at", "jack", "bedroom"),
    )
    succeeds(filled, "add_problem_goal", tree=goal)
    succeeds(filled, "remove_problem_instance", param=param("kitchen", "robot"))
    assert states(filled, "get_problem_predicates") == ["(person_at jack bedroom)"]
    assert states(filled, "get_problem_functions") == []
    assert text(call(filled, "get_problem_goal").tree) == "(and (person_at jack bedroom))"
    assert kb.holds("(robot_at leia kitchen)") is False


@pytest.mark.parametrize("name", ["yoda", "", "?", "?r"])
def test_an_unknown_instance_cannot_be_removed(filled, name):
    """PlanSys2 refuses it, too; a ``?`` does not remove everything."""
    assert "no object" in fails(filled, "remove_problem_instance", param=param(name))
    assert len(instances(filled)) == 5


# -- predicates -----------------------------------------------------------------------------------------------


def test_a_predicate_is_added_and_found(filled, kb):
    """It exists, is listed, is found by its text, and holds; twice adds nothing. Symbols are in lower case."""
    at = predicate("robot_at", "leia", "kitchen")
    assert call(filled, "exist_problem_predicate", node=at).exist is False
    succeeds(filled, "add_problem_predicate", node=at)
    number = kb.add().number
    succeeds(filled, "add_problem_predicate", node=predicate("ROBOT_AT", "Leia", "kitchen"))
    assert kb.add().number == number
    assert call(filled, "exist_problem_predicate", node=at).exist is True
    found = succeeds(filled, "get_problem_predicate", expression="(robot_at leia kitchen)").node
    assert (found.node_type, found.name) == (NodeType.PREDICATE, "robot_at")
    assert [(p.name, p.type) for p in found.parameters] == [("leia", "robot"), ("kitchen", "room")]
    assert kb.holds("(robot_at leia kitchen)")


@pytest.mark.parametrize(
    ("wrong", "reason"),
    [
        (predicate("flies", "leia"), "no predicate flies"),
        (predicate("robot_at", "leia"), "1 argument"),
        (predicate("robot_at", "kitchen", "leia"), "kitchen"),
        (predicate("robot_at", "leia", "cellar"), "cellar"),
        (predicate("enabled", "kitchen"), "kitchen"),
        (predicate("robot_at", "leia", "?p"), "?p"),
        (function("robot_at", "leia", "kitchen"), "node_type 6"),
        (node(NodeType.AND), "node_type 1"),
    ],
)
def test_predicates_that_are_refused(filled, wrong, reason):
    """Unknown symbols, wrong numbers and types of arguments, objects that do not exist; to remove, too."""
    assert reason in fails(filled, "add_problem_predicate", node=wrong)
    fails(filled, "remove_problem_predicate", node=wrong)


def test_subtypes_fit(filled):
    """A room may be a teleporter room, but not the reverse."""
    succeeds(filled, "add_problem_predicate", node=predicate("robot_at", "leia", "bedroom"))
    succeeds(filled, "add_problem_predicate", node=predicate("robot_at", "leia", "hall"))
    succeeds(filled, "add_problem_predicate", node=predicate("enabled", "bedroom"))
    fails(filled, "add_problem_predicate", node=predicate("enabled", "kitchen"))


def test_a_predicate_is_removed(filled, kb):
    """A fact that does not hold may be removed. A delete effect's node has `negate` set, and removes the fact."""
    at = predicate("robot_at", "leia", "kitchen")
    succeeds(filled, "add_problem_predicate", node=at)
    succeeds(filled, "remove_problem_predicate", node=predicate("robot_at", "leia", "kitchen", negate=True))
    assert kb.propositions() == []
    succeeds(filled, "remove_problem_predicate", node=at)


def test_a_wildcard_removes_nothing(filled, kb):
    """A ``?`` is not an object for PlanSys2: it must not remove all matches, as it does in `kb.remove`."""
    succeeds(filled, "add_problem_predicate", node=predicate("robot_at", "leia", "kitchen"))
    assert "no object ?" in fails(filled, "remove_problem_predicate", node=predicate("robot_at", "leia", "?"))
    assert kb.holds("(robot_at leia kitchen)")


def test_derived_predicates(filled):
    """They exist and are listed, and cannot be added or removed (V9)."""
    derived = predicate("inferred_at", "leia", "kitchen")
    fails(filled, "add_problem_predicate", node=derived)
    succeeds(filled, "add_problem_predicate", node=predicate("robot_at", "leia", "kitchen"))
    assert call(filled, "exist_problem_predicate", node=derived).exist is True
    assert states(filled, "get_problem_predicates") == ["(inferred_at leia kitchen)", "(robot_at leia kitchen)"]
    fails(filled, "add_problem_predicate", node=derived)
    fails(filled, "remove_problem_predicate", node=derived)


def test_an_explicitly_false_fact_is_not_listed(filled, kb):
    """`negate` makes it false (V2); a list of predicates has the true ones."""
    succeeds(filled, "add_problem_predicate", node=predicate("quiet", negate=True))
    assert [*map(str, kb.propositions())] == ["(not (quiet))"]
    assert states(filled, "get_problem_predicates") == []
    assert call(filled, "exist_problem_predicate", node=predicate("quiet")).exist is False
    assert "does not hold" in fails(filled, "get_problem_predicate", expression="(quiet)")


def test_an_invalid_node_does_not_exist(filled):
    """`ExistNode` has no field for a reason."""
    assert call(filled, "exist_problem_predicate", node=predicate("flies", "leia")).exist is False
    assert call(filled, "exist_problem_function", node=function("height", "leia")).exist is False
    assert "no predicate flies" in fails(filled, "get_problem_predicate", expression="(flies leia)")
    assert "(robot_at leia kitchen)" in fails(filled, "get_problem_predicate", expression="")


# -- functions ------------------------------------------------------------------------------------------------


def test_a_function_is_added_updated_and_removed(filled, kb):
    """Adding sets it, also where it has a value; it is listed with it, and may be removed twice."""
    for value in (1.5, 2.5):
        succeeds(filled, "add_problem_function", node=function("distance", "kitchen", "bedroom", value=value))
    succeeds(filled, "update_problem_function", node=function("distance", "kitchen", "bedroom", value=4))
    assert kb.value("(distance kitchen bedroom)") == 4
    found = succeeds(filled, "get_problem_function", expression="(distance kitchen bedroom)").node
    assert (found.node_type, found.value, text(found)) == (NodeType.FUNCTION, 4, "(distance kitchen bedroom)")
    assert [(text(f), f.value) for f in call(filled, "get_problem_functions").states] == [(text(found), 4)]
    for _ in range(2):
        succeeds(filled, "remove_problem_function", node=function("distance", "kitchen", "bedroom", value=7))
    assert call(filled, "exist_problem_function", node=found).exist is False
    assert kb.functions() == []


def test_functions_that_are_refused(filled):
    """An update needs a value; symbols, objects and types are checked, and numbers are finite."""
    assert "no value" in fails(filled, "update_problem_function", node=function("speed", "leia", value=1))
    assert "no value" in fails(filled, "get_problem_function", expression="(speed leia)")
    fails(filled, "add_problem_function", node=function("speed", "kitchen", value=1))
    fails(filled, "add_problem_function", node=function("speed", "leia", "jack", value=1))
    fails(filled, "add_problem_function", node=function("speed", "leia", value=float("nan")))
    assert "no object yoda" in fails(filled, "remove_problem_function", node=function("speed", "yoda"))
    fails(filled, "remove_problem_function", node=function("speed", "kitchen"))


# -- goals ----------------------------------------------------------------------------------------------------


def conjunction(*parts):
    return tree(node(NodeType.AND, children=range(1, len(parts) + 1)), *parts)


def test_a_goal_replaces_the_goal(filled, kb):
    """`add_problem_goal` sets it; the answer is a conjunction with its negations before atoms."""
    succeeds(filled, "add_problem_goal", tree=conjunction(predicate("robot_at", "leia", "kitchen")))
    goal = tree(
        node(NodeType.AND, children=[1, 2]),
        predicate("robot_at", "leia", "bedroom"),
        node(NodeType.NOT, children=[3]),
        predicate("person_at", "jack", "kitchen", negate=True),
    )
    succeeds(filled, "add_problem_goal", tree=goal)
    assert [*map(str, kb.goals())] == ["(Robot_At leia bedroom)", "(not (person_at jack kitchen))"]
    found = call(filled, "get_problem_goal").tree
    assert text(found) == "(and (robot_at leia bedroom) (not (person_at jack kitchen)))"
    assert [n.negate for n in found.nodes] == [False, False, False, True]


def test_a_goal_may_be_a_disjunction_or_a_comparison(filled, kb):
    """The returned goal has the same meaning."""
    goal = tree(
        node(NodeType.OR, children=[1, 2]),
        predicate("robot_at", "leia", "kitchen"),
        node(NodeType.EXPRESSION, children=[3, 4], expression_type=15),
        function("speed", "leia"),
        node(NodeType.NUMBER, value=2.0),
    )
    succeeds(filled, "add_problem_goal", tree=goal)
    assert text(call(filled, "get_problem_goal").tree) == "(and (or (robot_at leia kitchen) (> (speed leia) 2.0)))"


@pytest.mark.parametrize(
    ("goal", "reason"),
    [
        (tree(), "empty"),
        (tree(node(NodeType.AND)), "empty"),
        (tree(node(NodeType.AND, children=[1]), predicate("flies", "leia")), "flies"),
        (tree(node(NodeType.AND, children=[1]), predicate("robot_at", "leia", "cellar")), "cellar"),
        (tree(node(NodeType.AND, children=[3]), predicate("quiet")), "children"),
        (tree(node(NodeType.NUMBER, value=1.0)), "NUMBER"),
    ],
)
def test_goals_that_are_refused(filled, goal, reason):
    """A goal that is refused leaves the one before in place."""
    succeeds(filled, "add_problem_goal", tree=conjunction(predicate("quiet")))
    assert reason in fails(filled, "add_problem_goal", tree=goal)
    assert text(call(filled, "get_problem_goal").tree) == "(and (quiet))"


def test_the_goal_is_removed(filled):
    """Without a goal the tree has no nodes; it may be removed twice."""
    succeeds(filled, "add_problem_goal", tree=conjunction(predicate("quiet")))
    for _ in range(2):
        succeeds(filled, "remove_problem_goal")
    assert succeeds(filled, "get_problem_goal").tree.nodes == []


def test_whether_a_goal_is_satisfied(filled):
    """The goal of the request is evaluated, not the stored one; an empty one is satisfied."""
    goal = conjunction(predicate("robot_at", "leia", "kitchen"))
    assert succeeds(filled, "is_problem_goal_satisfied", tree=goal).satisfied is False
    succeeds(filled, "add_problem_predicate", node=predicate("robot_at", "leia", "kitchen"))
    assert succeeds(filled, "is_problem_goal_satisfied", tree=goal).satisfied is True
    assert succeeds(filled, "is_problem_goal_satisfied", tree=tree()).satisfied is True
    unknown = conjunction(predicate("robot_at", "yoda", "kitchen"))
    assert succeeds(filled, "is_problem_goal_satisfied", tree=unknown).satisfied is False
    assert "flies" in fails(filled, "is_problem_goal_satisfied", tree=conjunction(predicate("flies")))


# -- problems -------------------------------------------------------------------------------------------------


def test_a_problem_is_added_to_the_state(expert, kb):
    """Its goal replaces the goal; a repeated item is added once."""
    succeeds(expert, "add_problem_instance", param=param("r2d2", "robot"))
    succeeds(expert, "add_problem_goal", tree=conjunction(predicate("quiet")))
    for _ in range(2):
        succeeds(expert, "add_problem", problem=PROBLEM)
    assert sorted(instances(expert)) == ["bedroom", "hall", "jack", "kitchen", "leia", "r2d2"]
    assert states(expert, "get_problem_functions") == ["(distance kitchen bedroom)"]
    assert [*map(str, kb.goals())] == ["(talked leia jack)"]


def test_a_problem_without_a_goal_keeps_the_goal(filled, kb):
    """As in PlanSys2, which refuses an empty goal."""
    succeeds(filled, "add_problem_goal", tree=conjunction(predicate("quiet")))
    text_without = "(define (problem p) (:domain simple) (:objects) (:init) (:goal (and)))"
    succeeds(filled, "add_problem", problem=text_without)
    assert [*map(str, kb.goals())] == ["(quiet)"]


@pytest.mark.parametrize(
    ("problem", "reason"),
    [
        ("", "PDDL text"),
        ("/etc/hostname", "PDDL text"),
        ("(define (problem p) (:domain other) (:objects) (:init) (:goal (and)))", "other"),
        ("(define (problem p) (:domain simple) (:init (quiet", "line 1"),
        ("(define (problem p) (:domain simple) (:init (robot_at leia cellar)) (:goal (and)))", "cellar"),
    ],
)
def test_problems_that_are_refused(expert, problem, reason):
    """Nothing of them is stored, and no file is read."""
    assert reason in fails(expert, "add_problem", problem=problem)


def test_the_problem_is_written_for_planners(expert):
    """It reads back as the same state, constants and derived facts left out."""
    succeeds(expert, "add_problem", problem=PROBLEM)
    written = succeeds(expert, "get_problem").problem
    with kbstore.open("sqlite://", "again", clock=ManualClock(seconds(1))) as again:
        again.load(DOMAIN, written)
        assert sorted(map(str, again.propositions())) == ["(Robot_At leia kitchen)", "(person_at jack bedroom)"]
        assert [*map(str, again.functions())] == ["(= (distance kitchen bedroom) 10)"]
        assert [*map(str, again.goals())] == ["(talked leia jack)"]
    assert "hall" not in written


def test_everything_is_cleared(expert, kb):
    """State and goal end; constants remain, and so does history."""
    succeeds(expert, "add_problem", problem=PROBLEM)
    succeeds(expert, "clear_problem_knowledge")
    assert instances(expert) == {"hall": "teleporter_room"}
    assert states(expert, "get_problem_predicates") == states(expert, "get_problem_functions") == []
    assert succeeds(expert, "get_problem_goal").tree.nodes == []
    assert len(kb.history("(robot_at ? ?)")) == 1


def test_the_published_knowledge(expert):
    """Objects with constants, facts with derived ones, functions without values, and the goal as PDDL."""
    empty = expert.knowledge()
    assert (empty.instances, empty.predicates, empty.functions, empty.goal) == (["hall"], [], [], "")
    succeeds(expert, "add_problem", problem=PROBLEM)
    found = expert.knowledge()
    assert sorted(found.instances) == ["bedroom", "hall", "jack", "kitchen", "leia"]
    assert sorted(found.predicates) == [
        "(inferred_at leia kitchen)",
        "(person_at jack bedroom)",
        "(robot_at leia kitchen)",
    ]
    assert found.functions == ["(distance kitchen bedroom)"]
    assert found.goal == "(and (talked leia jack))"


def test_transactions_record_the_client_and_the_service(filled, kb):
    """Each service changes the knowledge base in one transaction."""
    succeeds(filled, "add_problem_predicate", node=predicate("quiet"))
    last = [*kb.changes()][-1].transaction
    assert (last.client, last.note, last.changes) == ("problem_expert", "add_problem_predicate", 1)


def test_a_restarted_clock_is_refused(filled, kb):
    """A simulation that restarts at 0 is refused; the error says why (T3)."""
    kb._clock.set(0)
    assert "clock" in fails(filled, "add_problem_predicate", node=predicate("quiet"))


def test_which_services_publish():
    """All changes notify; two of them, as in PlanSys2, publish no `Knowledge`."""
    assert sorted(ProblemExpert.CHANGING) == [
        "add_problem",
        "add_problem_function",
        "add_problem_goal",
        "add_problem_instance",
        "add_problem_predicate",
        "clear_problem_knowledge",
        "remove_problem_function",
        "remove_problem_goal",
        "remove_problem_instance",
        "remove_problem_predicate",
        "update_problem_function",
    ]
    assert {"remove_problem_function", "update_problem_function"} == ProblemExpert.QUIET
