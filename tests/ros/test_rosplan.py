"""ROSPlan's 19 services and its topic, by doubles of its messages: each answer compared with the state."""

import pytest

import kbstore
from kbstore import Truth, seconds
from kbstore.clock import ManualClock
from kbstore.ros.rosplan import SERVICES, RosplanServices
from tests.ros.doubles import HERE, given, make
from tests.ros.rosplan_items import Items, values

START = seconds(1000)

ADD, ADD_GOAL, REMOVE, REMOVE_GOAL, ADD_METRIC, REMOVE_METRIC = range(6)

DOMAIN = """
(define (domain delivery)
  (:requirements :typing :fluents :durative-actions :negative-preconditions)
  (:types place robot - object
          room - place
          kitchen - room)
  (:constants home - place)
  (:predicates (at ?r - robot ?p - place)
               (linked ?from ?to - place)
               (busy ?r - robot)
               (closed ?p - place))
  (:functions (battery ?r - robot) (cost))
  (:durative-action drive
    :parameters (?v - robot ?a ?b - place)
    :duration (= ?duration 10)
    :condition (and (at start (at ?v ?a)) (at start (not (busy ?v))) (over all (linked ?a ?b))
                    (over all (not (closed ?b))) (at end (linked ?b home)) (at end (not (busy ?v)))
                    (at start (> (battery ?v) 20)) (over all (>= (battery ?v) 5)) (at end (< (cost) 100)))
    :effect (and (at start (not (at ?v ?a))) (at start (busy ?v)) (at end (at ?v ?b)) (at end (not (busy ?v)))
                 (at start (decrease (battery ?v) 1)) (at end (increase (cost) (* 2 ?duration)))))
  (:action lock :parameters (?p - place) :precondition (not (closed ?p)) :effect (closed ?p)))
"""

ITEMS = Items(make)
AT_HALL = (("r", "kenny"), ("p", "hall"))
BATTERY = (("r", "kenny"),)


class Rosplan:
    """The services as a client of them, with published messages and reported errors."""

    def __init__(self, kb):
        self.kb, self.published, self.reported = kb, [], []
        self.services = RosplanServices(kb, make, publish=self.published.append, report=self.reported.append)

    def __call__(self, service, client="/mapper", **request):
        return self.services.call(service, given(f"{SERVICES[service]}Request", **request), client)

    def update(self, kind, item, **options):
        return self("update", update_type=kind, knowledge=item, **options).success

    def update_array(self, *pairs, **options):
        kinds, items = zip(*pairs, strict=True)
        return self("update_array", update_type=bytes(kinds), knowledge=list(items), **options).success

    def query(self, *items):
        return self("query_state", knowledge=list(items))


@pytest.fixture
def clock():
    return ManualClock(START)


@pytest.fixture
def opened(clock):
    """Open a knowledge base in memory with the domain and some objects."""
    made = []

    def opening(**options):
        kb = kbstore.open("sqlite://", "kenny", clock=clock, **options)
        made.append(kb)
        kb.load(DOMAIN)
        kb.add("kenny - robot", "hall - room", "galley - kitchen", "dock - place", "(at kenny hall)")
        return Rosplan(kb)

    yield opening
    for kb in made:
        kb.close()


@pytest.fixture
def rosplan(opened):
    return opened()


def texts(items):
    """Returned items as PDDL."""
    return [str(kbstore.item(item)) for item in items]


# -- the domain ---------------------------------------------------------------------------------------------------


def test_every_service_has_a_definition():
    """The 19 services of ROSPlan for PDDL, each of a type whose definition the tests have."""
    assert len(SERVICES) == 19
    assert {f"{name}.srv" for name in SERVICES.values()} == {path.name for path in HERE.glob("[rs]*_*/srv/*.srv")}


def test_name_and_types(rosplan):
    """The domain's name, and each type with the one above it."""
    assert rosplan("domain/name").domain_name == "delivery"
    found = rosplan("domain/types")
    assert dict(zip(found.types, found.super_types, strict=True)) == {
        "place": "object",
        "robot": "object",
        "room": "place",
        "kitchen": "room",
    }


def test_predicates_functions_and_operators(rosplan):
    """The declarations, in order, each with labels and types."""
    predicates = rosplan("domain/predicates").items
    assert [found.name for found in predicates] == ["at", "linked", "busy", "closed"]
    assert values(predicates[1]) == [("from", "place"), ("to", "place")]
    functions = rosplan("domain/functions").items
    assert [(found.name, values(found)) for found in functions] == [("battery", [("r", "robot")]), ("cost", [])]
    operators = rosplan("domain/operators").operators
    assert [(found.name, values(found)) for found in operators] == [
        ("drive", [("v", "robot"), ("a", "place"), ("b", "place")]),
        ("lock", [("p", "place")]),
    ]


def test_operator_details_have_every_field(rosplan):
    """Each list of a DomainOperator: labels are the operator's variables, and values their types."""
    op = rosplan("domain/operator_details", name="DRIVE").op
    assert (op.formula.name, values(op.formula)) == ("drive", [("v", "robot"), ("a", "place"), ("b", "place")])
    a, b, v = ("a", "place"), ("b", "place"), ("v", "robot")
    atoms = {
        "at_start_add_effects": [("busy", [v])],
        "at_start_del_effects": [("at", [v, a])],
        "at_end_add_effects": [("at", [v, b])],
        "at_end_del_effects": [("busy", [v])],
        "at_start_simple_condition": [("at", [v, a])],
        "over_all_simple_condition": [("linked", [a, b])],
        "at_end_simple_condition": [("linked", [b, ("home", "place")])],
        "at_start_neg_condition": [("busy", [v])],
        "over_all_neg_condition": [("closed", [b])],
        "at_end_neg_condition": [("busy", [v])],
    }
    for field, expected in atoms.items():
        assert [(found.name, values(found)) for found in getattr(op, field)] == expected, field
    assert op.probabilistic_effects == []
    for field, comparison, function, number in (
        ("at_start_comparison", 0, "battery", 20),
        ("over_all_comparison", 1, "battery", 5),
        ("at_end_comparison", 2, "cost", 100),
    ):
        (found,) = getattr(op, field)
        assert (found.comparison_type, found.grounded) == (comparison, False)
        assert found.LHS.tokens[0].function.name == function
        assert found.RHS.tokens[0].constant == number
    (start,), (end,) = op.at_start_assign_effects, op.at_end_assign_effects
    assert (start.assign_type, start.LHS.name, values(start.LHS)) == (2, "battery", [v])
    assert (end.assign_type, end.LHS.name) == (1, "cost")
    # (* 2 ?duration): an operator, a constant, a special
    assert [(token.expr_type, token.op, token.constant, token.special_type) for token in end.RHS.tokens] == [
        (2, 2, 0.0, 0),
        (0, 0, 2.0, 0),
        (3, 0, 0.0, 2),
    ]


def test_an_action_without_duration_is_at_start(rosplan):
    """ROSPlan lists conditions and effects of an instantaneous action as at start."""
    op = rosplan("domain/operator_details", name="lock").op
    assert [found.name for found in op.at_start_neg_condition] == ["closed"]
    assert [found.name for found in op.at_start_add_effects] == ["closed"]


def test_predicate_details_mark_sensed_predicates(rosplan):
    """A predicate is sensed once it was marked so, by a transaction of the caller."""
    found = rosplan("domain/predicate_details", name="busy")
    assert (found.predicate.name, values(found.predicate), found.is_sensed) == ("busy", [("r", "robot")], False)
    assert rosplan("update_sensed_predicates", name="busy", value=True).success
    assert rosplan("domain/predicate_details", name="busy").is_sensed
    assert rosplan.kb.domain.is_sensed("busy")
    assert list(rosplan.kb.changes())[-1].transaction.client == "/mapper"
    assert rosplan("update_sensed_predicates", name="busy", value=False).success
    assert not rosplan("domain/predicate_details", name="busy").is_sensed


def test_unknown_symbols_are_errors(rosplan):
    """V8: an operator, predicate or type that the domain lacks is named, with those that it has."""
    for service, name in (("operator_details", "fly"), ("predicate_details", "battery")):
        with pytest.raises(kbstore.UnknownSymbol, match=f"no (operator|predicate) {name}"):
            rosplan(f"domain/{service}", name=name)
    with pytest.raises(kbstore.UnknownSymbol, match="no type boat"):
        rosplan("state/instances", type_name="boat")
    with pytest.raises(kbstore.UnknownSymbol, match="no predicate or function flying"):
        rosplan("state/propositions", predicate_name="flying")
    assert not rosplan("update_sensed_predicates", name="flying", value=True).success
    assert "flying" in rosplan.reported[-1]


# -- the state ----------------------------------------------------------------------------------------------------


def test_instances_by_type(rosplan):
    """Objects of exactly a type; with subtypes, at any depth; constants on demand."""

    def names(type_name, constants=False, subtypes=False):
        found = rosplan(
            "state/instances", type_name=type_name, include_constants=constants, include_subtypes=subtypes
        ).instances
        return set(found)

    assert names("place") == {"dock"}
    assert names("place", subtypes=True) == {"dock", "hall", "galley"}
    assert names("place", constants=True) == {"dock", "home"}
    assert names("place", constants=True, subtypes=True) == {"dock", "hall", "galley", "home"}
    assert names("room", constants=True, subtypes=True) == {"hall", "galley"}
    assert names("") == {"kenny", "hall", "galley", "dock"}
    assert names("", constants=True) == {"kenny", "hall", "galley", "dock", "home"}


def test_propositions_and_functions(rosplan, clock):
    """Items of one symbol or all, with labels, sign, value, and initial time, to the nanosecond."""
    clock.set(START + 1_500_000_007)
    rosplan.kb.add("(not (busy kenny))", "(= (battery kenny) 80.25)", "(= (cost) 0)")
    busy, at = sorted(rosplan("state/propositions").attributes, key=lambda item: -item.is_negative)
    assert (busy.knowledge_type, busy.attribute_name, values(busy)) == (1, "busy", [("r", "kenny")])
    assert (busy.initial_time.secs, busy.initial_time.nsecs) == (1001, 500_000_007)
    assert (at.attribute_name, values(at), at.is_negative) == ("at", list(AT_HALL), False)
    assert texts(rosplan("state/propositions", predicate_name="AT").attributes) == ["(at kenny hall)"]
    (battery,) = rosplan("state/functions", predicate_name="battery").attributes
    assert (battery.knowledge_type, battery.function_value, battery.assign_op) == (2, 80.25, 0)
    assert len(rosplan("state/functions").attributes) == 2


def test_the_message_of_a_fact_is_made_once(rosplan, clock):
    """An unchanged fact is the same message; with another time or sign it is another. Numbers are made each time."""

    def ask(service):
        (found,) = rosplan(service, predicate_name="").attributes
        return found

    first = ask("state/propositions")
    assert ask("state/propositions") is first
    rosplan.kb.remove("(at kenny hall)")
    clock.set(START + 7)
    rosplan.kb.add("(at kenny hall)")
    assert (ask("state/propositions").initial_time.nsecs, first.initial_time.nsecs) == (7, 0)
    rosplan.kb.add("(not (at kenny hall))")
    assert (ask("state/propositions").is_negative, first.is_negative) == (True, False)
    rosplan.kb.add("(= (battery kenny) 0)")
    zero = ask("state/functions")
    assert ask("state/functions") is not zero


def test_a_predicate_is_not_a_function(rosplan):
    """ROSPlan asks for the values of a predicate and expects none, and the other way round."""
    assert rosplan("state/functions", predicate_name="linked").attributes == []
    assert rosplan("state/propositions", predicate_name="battery").attributes == []


def test_timed_knowledge(rosplan, clock):
    """Scheduled items are listed with their time, and no longer once it has come."""
    later = given("KnowledgeItem").initial_time
    later.secs, later.nsecs = 1010, 7
    assert rosplan.update(ADD, ITEMS.fact("at", (*AT_HALL[:1], ("p", "dock")), initial_time=later))
    (found,) = rosplan("state/timed_knowledge", predicate_name="at").attributes
    assert (found.initial_time.secs, found.initial_time.nsecs, str(kbstore.item(found))) == (1010, 7, "(at kenny dock)")
    assert rosplan("state/timed_knowledge", predicate_name="busy").attributes == []
    assert len(rosplan("state/timed_knowledge").attributes) == 1
    assert not rosplan.kb.holds("(at kenny dock)")
    clock.set(seconds(1010) + 7)
    assert rosplan("state/timed_knowledge").attributes == []
    assert rosplan.query(ITEMS.fact("at", (*AT_HALL[:1], ("p", "dock")))).all_true


def test_scheduled_knowledge_is_cancelled_at_its_time(rosplan):
    """C5: removing with the time of a scheduled item cancels it, and leaves the current one alone."""
    soon = given("KnowledgeItem").initial_time
    soon.secs = 1010
    item = ITEMS.fact("at", AT_HALL, initial_time=soon)
    assert rosplan.update(ADD, item)
    assert len(rosplan.kb.timed_knowledge()) == 1
    assert rosplan.update(REMOVE, item)
    assert rosplan.kb.timed_knowledge() == []
    assert rosplan.kb.holds("(at kenny hall)")


def test_goals_and_metric(rosplan):
    """Facts, negative facts and comparisons as goals, for any requested name; and the metric."""
    empty = rosplan("state/metric").metric
    assert (empty.knowledge_type, empty.optimization, empty.expr.tokens) == (0, "", [])
    assert rosplan.update(ADD_GOAL, ITEMS.fact("at", (("r", "kenny"), ("p", "dock"))))
    assert rosplan.update(ADD_GOAL, ITEMS.fact("busy", BATTERY, is_negative=True))
    assert rosplan.update(ADD_GOAL, ITEMS.comparison(1, "battery", BATTERY, 30.0))
    assert rosplan.update(ADD_METRIC, ITEMS.metric("minimize", "battery", BATTERY))
    expected = ["(at kenny dock)", "(not (busy kenny))", "(>= (battery kenny) 30)"]
    assert texts(rosplan("state/goals").attributes) == expected == [str(goal) for goal in rosplan.kb.goals()]
    assert texts(rosplan("state/goals", predicate_name="dgfhfhjfgh").attributes) == expected
    assert texts([rosplan("state/metric").metric]) == ["minimize (battery kenny)"]


def test_a_goal_beyond_messages_is_an_error(rosplan):
    """A disjunction fits no KnowledgeItem: a planner must not plan for the rest of the goal alone."""
    rosplan.kb.add_goal("(or (at kenny hall) (at kenny dock))")
    with pytest.raises(kbstore.InvalidKnowledge, match=r"no KnowledgeItem can carry: \(or "):
        rosplan("state/goals")


def test_query(rosplan):
    """One answer for each item, in order, and the false ones as they were asked."""
    rosplan.kb.add("(= (battery kenny) 80)")
    asked = [
        ITEMS.instance("kenny", "robot"),
        ITEMS.instance("Jonas", "robot"),
        ITEMS.instance("home", "place"),
        ITEMS.fact("at", AT_HALL),
        ITEMS.fact("at", AT_HALL, is_negative=True),
        ITEMS.fact("at", (("r", "kenny"), ("p", ""))),
        ITEMS.function("battery", BATTERY, 80.0),
        ITEMS.function("battery", BATTERY, 79.0),
        ITEMS.comparison(0, "battery", BATTERY, 79.5),
        ITEMS.comparison(4, "battery", BATTERY, 79.5),
    ]
    found = rosplan.query(*asked)
    assert found.results == [True, False, True, True, False, True, True, False, True, False]
    assert not found.all_true
    assert found.false_knowledge == [asked[index] for index in (1, 4, 7, 9)]
    assert found.results == [rosplan.kb.holds(item) for item in asked]
    assert rosplan.query(asked[0]).all_true
    assert rosplan.query().all_true


def test_a_question_about_an_unknown_predicate_is_an_error(rosplan):
    """V8: it is an error, and not answered with false."""
    with pytest.raises(kbstore.UnknownSymbol, match="flying"):
        rosplan.query(ITEMS.fact("flying", BATTERY))


# -- changes ------------------------------------------------------------------------------------------------------


def test_adding_twice_and_removing_an_absent_item(rosplan):
    """C2, C4: both are a success, and change nothing."""
    for kind, item in (
        (ADD, ITEMS.fact("at", AT_HALL)),
        (ADD, ITEMS.instance("kenny", "robot")),
        (REMOVE, ITEMS.fact("busy", BATTERY)),
        (REMOVE, ITEMS.instance("ghost", "robot")),
        (REMOVE, ITEMS.function("battery", BATTERY, 0.0)),
        (REMOVE_GOAL, ITEMS.fact("at", AT_HALL)),
        (REMOVE_METRIC, make("KnowledgeItem")),
    ):
        before = list(rosplan.kb.changes())
        assert rosplan.update(kind, item)
        assert list(rosplan.kb.changes()) == before
    assert rosplan.reported == []


def test_the_other_sign_replaces_a_fact(rosplan, clock):
    """C3: a negative fact replaces a positive one; removing one sign leaves the other."""
    clock.advance(5)
    assert rosplan.update(ADD, ITEMS.fact("at", AT_HALL, is_negative=True))
    assert [str(fact) for fact in rosplan.kb.propositions("at")] == ["(not (at kenny hall))"]
    assert rosplan.update(REMOVE, ITEMS.fact("at", AT_HALL))
    assert [str(fact) for fact in rosplan.kb.propositions("at")] == ["(not (at kenny hall))"]
    assert rosplan.update(REMOVE, ITEMS.fact("at", AT_HALL, is_negative=True))
    assert rosplan.kb.propositions("at") == []


def test_labels_in_any_order(rosplan):
    """D1: arguments are assigned by their labels."""
    assert rosplan.update(ADD, ITEMS.fact("at", (("p", "dock"), ("r", "kenny"))))
    assert rosplan.kb.holds("(at kenny dock)")


def test_functions_are_assigned_and_changed(rosplan):
    """C7: the operations 0 to 5 by their meaning, where ROSPlan adds for a scale-up and ignores a rate."""
    for op, number, expected in ((0, 10.0, 10.0), (1, 5.0, 15.0), (2, 3.0, 12.0), (3, 2.0, 24.0), (4, 4.0, 6.0)):
        assert rosplan.update(ADD, ITEMS.function("battery", BATTERY, number, op))
        assert rosplan.kb.value("(battery kenny)") == expected
    assert rosplan.update(ADD, ITEMS.function("battery", BATTERY, -0.5, 5))
    assert rosplan.kb.value("(battery kenny)", at=START + seconds(4)) == 4.0
    assert rosplan.update(REMOVE, ITEMS.function("battery", BATTERY, 0.0))
    assert rosplan.kb.functions() == []


def test_an_undefined_function_is_not_increased(rosplan):
    """C7: it is not a success, and the reason is reported, where ROSPlan answers with success and does nothing."""
    assert not rosplan.update(ADD, ITEMS.function("battery", BATTERY, 5.0, 1))
    assert "battery" in rosplan.reported[-1]
    assert "update by /mapper changed nothing" in rosplan.reported[-1]


def test_patterns_are_removed(rosplan):
    """C4: an empty value matches any object; an instance without a name, all of its type."""
    rosplan.kb.add("(at kenny dock)", "(closed dock)")
    assert rosplan.update(REMOVE, ITEMS.fact("at", (("r", "kenny"), ("p", ""))))
    assert [str(fact) for fact in rosplan.kb.propositions()] == ["(closed dock)"]
    assert rosplan.update(REMOVE, ITEMS.instance("", "place"))
    assert [str(item) for item in rosplan.kb.instances()] == ["kenny - robot"]
    assert rosplan.kb.propositions() == []


def test_the_last_goal_and_metric_go(rosplan):
    """The update types 1, 3, 4 and 5; an empty item is enough to remove the metric."""
    goal = ITEMS.fact("at", AT_HALL)
    for metric in (make("KnowledgeItem"), ITEMS.metric("minimize", "battery", BATTERY)):
        assert rosplan.update(ADD_GOAL, goal)
        assert rosplan.update(ADD_METRIC, ITEMS.metric("minimize", "battery", BATTERY))
        assert (len(rosplan.kb.goals()), str(rosplan.kb.metric())) == (1, "minimize (battery kenny)")
        assert rosplan.update(REMOVE_GOAL, goal)
        assert rosplan.update(REMOVE_METRIC, metric)
        assert (rosplan.kb.goals(), rosplan.kb.metric()) == ([], None)
        assert rosplan.kb.holds("(at kenny hall)")


@pytest.mark.parametrize(
    ("kind", "item", "why"),
    [
        (ADD, ITEMS.fact("flying", BATTERY), "flying"),
        (ADD, ITEMS.fact("at", (("r", "kenny"), ("p", "moon"))), "moon"),
        (ADD, ITEMS.fact("at", (("r", "kenny"), ("p", ""))), "the name '' is empty"),
        (ADD, ITEMS.instance("home", "place"), "constant"),
        (ADD, ITEMS.instance("kenny", "place"), "exists with the type robot"),
        (ADD, ITEMS.instance("jonas", "boat"), "no type boat"),
        (ADD_GOAL, ITEMS.instance("kenny", "robot"), "not a goal"),
        (ADD_METRIC, ITEMS.fact("at", AT_HALL), "not a metric"),
        (6, ITEMS.fact("at", AT_HALL), "REMOVE_METRIC 5"),
        (ADD, ITEMS.item(9), "knowledge_type"),
    ],
)
def test_an_invalid_item_is_not_a_success(rosplan, kind, item, why):
    """D1: nothing is stored, the response has no success, and the reason is reported."""
    before = list(rosplan.kb.changes())
    assert not rosplan.update(kind, item)
    assert list(rosplan.kb.changes()) == before
    (sentence,) = rosplan.reported
    assert why in sentence


def test_an_array_is_all_or_nothing(rosplan, clock):
    """C1: it is one transaction of the caller, which one invalid item refuses as a whole."""
    clock.advance(seconds(1))
    before = list(rosplan.kb.changes())
    good = (ADD, ITEMS.instance("attic", "room")), (ADD, ITEMS.fact("at", (("r", "kenny"), ("p", "attic"))))
    assert not rosplan.update_array(*good, (ADD, ITEMS.fact("flying", BATTERY)))
    assert list(rosplan.kb.changes()) == before
    assert rosplan.published == []
    assert rosplan.update_array(*good, (REMOVE, ITEMS.fact("at", AT_HALL)), client="/planner")
    (change,) = rosplan.kb.changes(after=before[-1])
    assert (change.transaction.client, change.transaction.time) == ("/planner", START + seconds(1))
    assert [str(fact) for fact in rosplan.kb.propositions("at")] == ["(at kenny attic)"]


def test_an_array_with_too_few_types_is_not_a_success(rosplan):
    """No item is skipped silently, where ROSPlan leaves out the rest."""
    response = rosplan("update_array", update_type=b"\0", knowledge=[ITEMS.fact("busy", BATTERY)] * 2)
    assert not response.success
    assert "1 update types for 2 items" in rosplan.reported[-1]
    assert not rosplan.kb.holds("(busy kenny)")


def test_only_an_array_is_published(rosplan, clock):
    """The topic has update_array alone, with the caller and the time of the transaction."""
    clock.advance(1_500_000_007)
    assert rosplan.update(ADD, ITEMS.fact("busy", BATTERY))
    rosplan("clear")
    assert rosplan.published == []
    assert rosplan.update_array((ADD, ITEMS.instance("kenny", "robot")), client="/planner")
    (status,) = rosplan.published
    assert status.last_update_client == "/planner"
    assert (status.last_update_time.secs, status.last_update_time.nsecs) == (1001, 500_000_007)


def test_clear(rosplan):
    """C12: everything ends, the domain stays, and the past is kept."""
    rosplan.kb.add_goal("(at kenny dock)")
    at = rosplan.kb.now()
    rosplan("clear", client="/operator")
    assert (rosplan.kb.goals(), rosplan.kb.instances(), rosplan.kb.propositions()) == ([], [], [])
    assert rosplan("domain/name").domain_name == "delivery"
    assert list(rosplan.kb.changes())[-1].transaction.client == "/operator"
    assert [str(found.item) for found in rosplan.kb.history("(at kenny ?)", until=at + 1)] == ["(at kenny hall)"]


def test_absent_facts_are_unknown(opened):
    """V2: with use_unknowns neither p nor (not p) is true where p is absent; in a closed world (not p) is."""
    busy, not_busy = ITEMS.fact("busy", BATTERY), ITEMS.fact("busy", BATTERY, is_negative=True)
    closed, unsure = opened(), opened(use_unknowns=True)
    assert closed.query(busy, not_busy).results == [False, True]
    assert unsure.query(busy, not_busy).results == [False, False]
    assert unsure.kb.truth("(busy kenny)") is Truth.UNKNOWN
    assert unsure.update(ADD, not_busy)
    assert unsure.query(busy, not_busy).results == [False, True]


# -- constraints --------------------------------------------------------------------------------------------------

EITHER = ITEMS.fact("at", (("p", "dock"), ("r", "kenny"))), ITEMS.fact("at", (("p", "galley"), ("r", "kenny")))


def test_a_oneof_constraint_is_kept(opened):
    """P4: it is asked, written into the problem, and read back, until one of its atoms is asserted."""
    rosplan = opened(use_unknowns=True)
    assert rosplan("update_constraints_oneof", client="/sensor", knowledge=list(EITHER)).success
    constraint = "(oneof (at kenny dock) (at kenny galley))"
    assert rosplan.kb.constraints() == [constraint]
    assert list(rosplan.kb.changes())[-1].transaction.client == "/sensor"
    problem = rosplan.kb.to_pddl()
    assert constraint in problem
    with kbstore.open("sqlite://", "copy", use_unknowns=True) as copy:
        copy.load(DOMAIN, problem)
        assert copy.constraints() == [constraint]
    assert rosplan.query(EITHER[0]).results == [False]
    assert rosplan.kb.truth("(at kenny dock)") is Truth.UNKNOWN
    assert rosplan.update(ADD, EITHER[0])
    assert rosplan.kb.constraints() == []


def test_a_oneof_constraint_twice(opened):
    """C2: the same constraint changes nothing, and another is kept beside it; removing an object ends both."""
    rosplan = opened(use_unknowns=True)
    for _ in range(2):
        assert rosplan("update_constraints_oneof", knowledge=list(EITHER)).success
    assert len(rosplan.kb.constraints()) == 1
    closed = [ITEMS.fact("closed", (("p", "dock"),), is_negative=True), ITEMS.fact("closed", (("p", "hall"),))]
    assert rosplan("update_constraints_oneof", knowledge=closed).success
    assert rosplan.kb.constraints()[1:] == ["(oneof (not (closed dock)) (closed hall))"]
    assert rosplan.update(REMOVE, ITEMS.instance("dock", "place"))
    assert rosplan.kb.constraints() == []


@pytest.mark.parametrize(
    ("knowledge", "why"),
    [
        ([], "takes conditions"),
        ([ITEMS.fact("at", (("r", "kenny"), ("p", "moon")))], "moon does not exist; add the object first"),
        ([ITEMS.function("battery", BATTERY, 3.0)], "is about facts"),
        ([ITEMS.fact("flying", BATTERY)], "flying"),
        ([ITEMS.fact("at", (("r", "dock"), ("p", "dock")))], "dock"),
    ],
)
def test_a_oneof_constraint_that_does_not_fit(opened, knowledge, why):
    """D1: a constraint is about facts that are possible, of objects that exist."""
    rosplan = opened(use_unknowns=True)
    assert not rosplan("update_constraints_oneof", knowledge=knowledge).success
    assert why in rosplan.reported[-1]
    assert rosplan.kb.constraints() == []


def test_a_closed_world_keeps_no_oneof_constraint(rosplan):
    """P4: where absent is false, nothing is open: refused, with what to do."""
    assert not rosplan("update_constraints_oneof", knowledge=list(EITHER)).success
    assert "use_unknowns=True" in rosplan.reported[-1]
    assert rosplan.kb.constraints() == []


def test_a_restarted_clock_is_refused(rosplan, clock):
    """T3: after a simulation restarts at 0, nothing is stored, and the report says what to do."""
    clock.set(0)
    assert not rosplan.update(ADD, ITEMS.fact("busy", BATTERY))
    assert "a simulation at 0) a knowledge base name of its own" in rosplan.reported[-1]
    with pytest.raises(kbstore.ClockWentBackwards):
        rosplan("clear")
    assert not rosplan.kb.holds("(busy kenny)")


# -- ROSPlan's own expectations -----------------------------------------------------------------------------------

AMAZON = HERE.parents[2] / "shared" / "data" / "rosplan" / "amazon"


@pytest.mark.skipif(not AMAZON.is_dir(), reason="ROSPlan's files are not here")
def test_the_checks_of_rosplan_itself():
    """The checks of ROSPlan's own tests with one of its domains, in their order."""
    with kbstore.open("sqlite://", "amazon") as kb:
        kb.load(AMAZON / "domain.pddl", AMAZON / "problem.pddl")
        rosplan = Rosplan(kb)
        assert rosplan("domain/name").domain_name == "driverlog-simple"
        assert rosplan("domain/functions").items == []
        assert [found.name for found in rosplan("domain/predicates").items] == ["at", "in", "link", "path"]
        assert [found.name for found in rosplan("domain/operators").operators] == [
            "load-truck",
            "unload-truck",
            "board-truck",
            "get-out",
            "drive-truck",
            "walk",
        ]
        types = rosplan("domain/types")
        assert types.types == ["place", "locatable", "driver", "truck", "item"]
        assert types.super_types == ["object", "object", "locatable", "locatable", "locatable"]
        assert rosplan("domain/operator_details", name="load-truck").op.formula.name == "load-truck"
        assert rosplan("domain/predicate_details", name="path").predicate.name == "path"
        assert rosplan("state/instances", type_name="place").instances == ["home", "amazon", "london", "myhouse"]
        assert rosplan("state/functions", predicate_name="link").attributes == []
        links = rosplan("state/propositions", predicate_name="link").attributes
        assert [found.attribute_name for found in links] == ["link"] * 4
        for name in ("at", "", "dgfhfhjfgh"):
            assert texts(rosplan("state/goals", predicate_name=name).attributes) == ["(at mydvd myhouse)"]
        assert rosplan("state/metric").metric.attribute_name == ""
        assert rosplan("state/timed_knowledge", predicate_name="at").attributes == []
        rosplan("clear")
        assert rosplan("state/goals").attributes == []
        assert rosplan.update(ADD, ITEMS.instance("martin", "driver"))
        assert rosplan("state/instances", type_name="driver").instances == ["martin"]
        rosplan("clear")
        added = [ITEMS.instance("Martin", "driver"), ITEMS.instance("home", "place"), ITEMS.instance("london", "place")]
        assert rosplan.update_array(*((ADD, item) for item in added))
        found = rosplan.query(*added[:2], ITEMS.instance("Jonas", "driver"))
        assert (found.all_true, found.results) == (False, [True, True, False])
        assert found.false_knowledge[0].instance_name == "Jonas"
