"""Types, fluents and objects of a unified_planning problem."""

from fractions import Fraction

import pytest

from kbstore.errors import InvalidKnowledge
from kbstore.interop.unified_planning import to_problem
from kbstore.messages import Condition
from tests.interop.states import state

UNTYPED = """
(define (domain blocks)
  (:predicates (on ?x ?y) (clear ?x))
"""


def test_types_keep_their_hierarchy():
    """A subtype has its parent as father; a type below ``object`` has none, unless something is an ``object``."""
    problem = to_problem(state())
    types = {user_type.name: user_type for user_type in problem.user_types}
    assert set(types) == {"Robot", "truck", "mover", "place"}
    assert types["truck"].father == types["mover"]
    assert types["mover"].father is None


def test_the_type_object_exists_where_it_is_used():
    """A predicate, an object or a quantifier of the type ``object`` makes it the root of all types."""
    head = "(define (domain d) (:types robot) (:predicates (seen ?x) (at ?r - robot))"
    problem = to_problem(state(head=head, objects="kenny - robot"))
    assert problem.user_type("robot").father == problem.user_type("object")
    quantified = "(:action a :parameters () :precondition (exists (?x - object) (= ?x ?x)) :effect (open))"
    assert to_problem(state(quantified)).has_type("object")
    assert to_problem(state(objects="thing - object")).has_type("object")
    assert to_problem(state(goals=[Condition(text="(exists (?x - object) (= ?x wp0))")])).has_type("object")
    assert to_problem(state(constraints=["(forall (?x - object) (always (open)))"])).has_type("object")


def test_untyped_domains_are_of_objects():
    """Without types, everything is an ``object``."""
    problem = to_problem(state(head=UNTYPED, objects="a - object b - object", init=["(on a b)"]))
    assert [parameter.type.name for parameter in problem.fluent("on").signature] == ["object", "object"]
    assert {thing.name for thing in problem.all_objects} == {"a", "b"}


def test_names_are_spelled_as_the_domain_spells_them():
    """D3: names are compared without case here, and with case there; they are written as in the domain."""
    problem = to_problem(state(init=["(AT KENNY WP0)", "(at kenny DEPOT)", "(= (Battery Kenny) 3)"]))
    at, kenny = problem.fluent("At"), problem.object("kenny")
    assert problem.initial_value(at(kenny, problem.object("wp0"))).is_true()
    assert problem.initial_value(at(kenny, problem.object("Depot"))).is_true()
    assert problem.initial_value(problem.fluent("battery")(kenny)).constant_value() == 3


def test_absent_and_explicitly_false_facts_are_false():
    """V2: a planning problem is a closed world."""
    problem = to_problem(state(init=["(open)", "(not (visited wp0))"]))
    visited = problem.fluent("visited")
    assert problem.initial_value(problem.fluent("open")).is_true()
    assert problem.initial_value(visited(problem.object("wp0"))).is_false()
    assert problem.initial_value(visited(problem.object("wp1"))).is_false()


@pytest.mark.parametrize(
    ("text", "exact"),
    [("0.1", Fraction(1, 10)), ("-2.5", Fraction(-5, 2)), ("1e-7", Fraction(1, 10**7)), ("12", Fraction(12))],
)
def test_numbers_are_the_decimals_that_they_are_written_as(text: str, exact: Fraction):
    """P2: numbers are exact."""
    problem = to_problem(state(init=[f"(= (speed) {text})"]))
    assert problem.initial_value(problem.fluent("speed")).constant_value() == exact


def test_undefined_functions_stay_undefined():
    """V5: an undefined function is not 0."""
    problem = to_problem(state(init=["(= (battery kenny) 3)"]))
    assert problem.initial_value(problem.fluent("speed")) is None
    assert problem.kind.has_undefined_initial_numeric()


def test_a_domain_may_use_one_name_for_several_things():
    """A predicate, an operator, a type and an object may share a name, as in PDDL, without a warning."""
    head = "(define (domain d) (:types open - object) (:predicates (open ?o - open))"
    act = "(:action open :parameters (?o - open) :effect (open ?o))"
    problem = to_problem(state(act, head=head, objects="open - open", init=["(open open)"]))
    fluent, thing = problem.fluent("open"), problem.object("open")
    assert problem.initial_value(fluent(thing)).is_true()
    assert problem.action("open").effects[0].fluent.fluent() == fluent


def test_a_predicate_of_an_either_type_takes_the_common_supertype():
    """D1: a parameter has one type there; the facts are the same."""
    head = """(define (domain d) (:types a b - ab ab c - object)
      (:predicates (p ?x - (either a b)) (q ?x - (either a c)) (r ?x - (either b ab)))"""
    problem = to_problem(state(head=head, objects="x - a y - b z - c", init=["(p y)", "(q z)"]))
    kinds = [problem.fluent(name).signature[0].type.name for name in "pqr"]
    assert kinds == ["ab", "object", "ab"]
    assert problem.initial_value(problem.fluent("q")(problem.object("z"))).is_true()


def test_a_type_of_several_parents_is_refused():
    """The error names the type."""
    head = "(define (domain d) (:types a b - object ab - (either a b)) (:predicates (p ?x - ab))"
    with pytest.raises(InvalidKnowledge, match=r"ab.*\(either a b\)"):
        to_problem(state(head=head, objects=""))


def test_a_problem_needs_a_domain():
    """Without a domain there are no operators to plan with."""
    nothing = state()
    nothing.domain = None
    with pytest.raises(InvalidKnowledge, match="load"):
        to_problem(nothing)
