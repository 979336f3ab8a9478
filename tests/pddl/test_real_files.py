"""P4: declarations of domains and problems from robot repositories, in files of our own."""

import pytest

import kbstore
from kbstore import Fact, InvalidKnowledge, KnowledgeBase, ManualClock, seconds
from kbstore.pddl.domain_reader import read_domain
from kbstore.pddl.problem_reader import read_problem

START = seconds(1000)


@pytest.fixture
def kb() -> KnowledgeBase:
    """An empty knowledge base in memory."""
    return kbstore.open("sqlite://", "kenny", clock=ManualClock(START))


def problem_of(domain: str, body: str) -> str:
    """A problem of the domain `d` (or another name)."""
    return f"(define (problem p) (:domain {domain}) {body})"


def labelled(**values: str) -> list[dict[str, str]]:
    """Arguments with their labels, as a message has them."""
    return [{"key": label, "value": value} for label, value in values.items()]


# -- a name given twice -------------------------------------------------------------------------------------------

CUPBOARD = """(define (domain cupboard) (:requirements :typing :fluents) (:types thing)
  (:predicates (inside ?obj - thing ?obj - thing)) (:functions (gap ?obj ?obj - thing))
  (:action put :parameters (?a ?b - thing) :precondition (not (inside ?a ?b)) :effect (inside ?a ?b)))"""
CUPBOARD_PROBLEM = problem_of(
    "cupboard", "(:objects cup box - thing) (:init (inside cup box) (= (gap cup box) 3)) (:goal (inside box cup))"
)


def test_arguments_of_a_name_given_twice_are_positional(kb: KnowledgeBase):
    """P4: (inside cup box) is not (inside box cup), with any names of parameters."""
    kb.load(CUPBOARD, CUPBOARD_PROBLEM)
    assert kb.holds("(inside cup box)")
    assert not kb.holds("(inside box cup)")
    assert kb.value("(gap cup box)") == 3
    kb.apply("put", "box", "cup")
    assert kb.query(*kb.goals()).all_true


def test_messages_with_a_label_given_twice_are_positional(kb: KnowledgeBase):
    """P4, D1: messages from the store are accepted; labels that are ambiguous are refused."""
    kb.load(CUPBOARD, CUPBOARD_PROBLEM)
    (fact,) = kb.state().facts
    assert fact.labels == ("obj", "obj")
    assert kb.add(fact).changes == 0
    assert kb.holds(fact)
    reverse = Fact.model_validate({"attribute_name": "inside", "values": labelled(obj="box") + labelled(obj="cup")})
    assert not kb.holds(reverse)
    kb.add(reverse)
    assert kb.holds("(inside box cup)")
    with pytest.raises(InvalidKnowledge, match="labels"):
        kb.add(Fact.model_validate({"attribute_name": "inside", "values": labelled(obj="box", thing="cup")}))


def test_a_name_given_twice_reaches_unified_planning(kb: KnowledgeBase):
    """P4: a fluent of unified_planning needs different names; its arguments stay in place."""
    pytest.importorskip("unified_planning")
    kb.load(CUPBOARD, CUPBOARD_PROBLEM)
    problem = kb.to_problem()
    inside = problem.fluent("inside")
    assert [parameter.name for parameter in inside.signature] == ["obj", "obj_2"]
    cup, box = problem.object("cup"), problem.object("box")
    assert problem.initial_value(inside(cup, box)).is_true()
    assert problem.initial_value(inside(box, cup)).is_false()


# -- types --------------------------------------------------------------------------------------------------------


def test_a_type_with_several_parents_is_a_subtype_of_each():
    """P4: whether they are declared in one line or in several."""
    domain = read_domain(
        """(define (domain d) (:types door - place door - openable box - openable box - openable place openable)
        (:predicates (at ?p - place) (open ?o - openable)))"""
    )
    assert dict(domain.types) == {
        "door": "(either place openable)",
        "box": "openable",
        "place": "object",
        "openable": "object",
    }
    assert domain.is_subtype("door", ["place"])
    assert domain.is_subtype("door", ["openable"])
    assert not domain.is_subtype("box", ["place"])
    problem = read_problem(
        problem_of("d", "(:objects front - door) (:init (at front) (open front)) (:goal (and))"), domain
    )
    assert [str(fact) for fact in problem.init] == ["(at front)", "(open front)"]


def test_a_type_below_itself_is_a_top_type():
    """P4: some files write `thing - thing` for a type without a parent."""
    domain = read_domain("(define (domain d) (:types thing - thing cup box - thing))")
    assert dict(domain.types) == {"thing": "object", "cup": "thing", "box": "thing"}


def test_top_types_on_lines_of_their_own():
    """P4: `shape` is on a line before `square`, whose type then is that of both."""
    domain = read_domain("(define (domain d)\n (:types\n   shape\n   square triangle - shape\n ))")
    assert dict(domain.types) == {"shape": "object", "square": "shape", "triangle": "shape"}


# -- equal declarations -------------------------------------------------------------------------------------------


def test_an_equal_declaration_twice_is_one():
    """P4: types, constants, predicates, functions, actions and objects; the first spelling counts."""
    domain = read_domain(
        """(define (domain d) (:types room room)
        (:constants Hall - room hall - room)
        (:predicates (lit ?r - room) (LIT ?x - room)) (:functions (size ?r - room) (size ?r - room) - number)
        (:action light :parameters (?r - room) :effect (lit ?r))
        (:action light :parameters (?r - room) :effect (lit ?r)))"""
    )
    assert dict(domain.types) == {"room": "object"}
    assert dict(domain.constants) == {"Hall": "room"}
    assert [str(signature) for signature in domain.predicate_signatures.values()] == ["(lit ?r - room)"]
    assert list(domain.function_signatures) == ["size"]
    assert list(domain.actions) == ["light"]
    problem = read_problem(problem_of("d", "(:objects den den - room Den - room) (:goal (and))"), domain)
    assert [item.instance_name for item in problem.instances] == ["den"]


# -- a problem without a goal -------------------------------------------------------------------------------------


def test_a_problem_without_a_goal(kb: KnowledgeBase):
    """P4: a file with the state of a robot, and no goal."""
    kb.load("(define (domain d) (:predicates (lit)))", problem_of("d", "(:init (lit))"))
    assert kb.holds("(lit)")
    assert kb.goals() == []
    assert "(:goal (and))" in kb.to_pddl()


# -- timed numbers ------------------------------------------------------------------------------------------------

BATTERY = "(define (domain b) (:types robot) (:predicates (idle ?r - robot)) (:functions (battery ?r - robot)))"


@pytest.mark.parametrize("timed", ["(at 6.0 (assign (battery k) 80))", "(at 6 (= (battery k) 80))"])
def test_timed_numbers_written_with_assign(kb: KnowledgeBase, timed: str):
    """P4: unified_planning's writer writes `assign` where PDDL 2.2 has `=`."""
    kb.load(BATTERY, problem_of("b", f"(:objects k - robot) (:init (= (battery k) 90) {timed}) (:goal (and))"))
    assert kb.value("(battery k)", at=START + seconds(6) - 1) == 90
    assert kb.value("(battery k)", at=START + seconds(6)) == 80


def test_a_fact_may_be_called_assign(kb: KnowledgeBase):
    """P4: with plain names only, (assign k home) is a fact, also at a time."""
    kb.load(
        "(define (domain a) (:predicates (assign ?x ?y)))",
        problem_of("a", "(:objects k home) (:init (at 5 (assign k home))) (:goal (and))"),
    )
    assert kb.holds("(assign k home)", at=START + seconds(5))


def test_a_written_problem_of_unified_planning_is_read(kb: KnowledgeBase):
    """P4: a timed number of its writer is read as the same number at the same time."""
    io = pytest.importorskip("unified_planning.io")
    kb.load(BATTERY, problem_of("b", "(:objects k - robot) (:init (= (battery k) 90) (at 6 (= (battery k) 80)))"))
    kb.add_goal("(idle k)")
    writer = io.PDDLWriter(kb.to_problem())
    other = kbstore.open("sqlite://", "other", clock=ManualClock(START))
    other.load(writer.get_domain(), writer.get_problem())
    assert other.value("(battery k)", at=START + seconds(6)) == 80
