"""P4: parts that are kept and written back, but not computed: PDDL+, object fluents, observations, and unknowns.

The files here are our own, one of each kind.
"""

import pytest

import kbstore
from kbstore import InvalidKnowledge, KnowledgeBase, ManualClock, Truth, seconds
from kbstore.pddl.domain_reader import read_domain
from kbstore.pddl.problem_reader import read_problem

START = seconds(1000)


@pytest.fixture
def clock() -> ManualClock:
    """A clock that is moved by hand."""
    return ManualClock(START)


@pytest.fixture
def kb(clock: ManualClock) -> KnowledgeBase:
    """An empty knowledge base with a closed world."""
    return kbstore.open("sqlite://", "kenny", clock=clock)


@pytest.fixture
def open_kb(clock: ManualClock) -> KnowledgeBase:
    """An empty knowledge base with unknowns."""
    return kbstore.open("sqlite://", "kenny", clock=clock, use_unknowns=True)


# -- PDDL+ --------------------------------------------------------------------------------------------------------

FALLING = """(define (domain falling)
  (:requirements :typing :fluents :time :derived-predicates)
  (:types ball)
  (:predicates (held ?b - ball) (broken ?b - ball) (safe ?b - ball) (dry))
  (:functions (height ?b - ball) (speed ?b - ball) (weight ?b - ball))
  (:derived (safe ?b - ball) (> (height ?b) 1))
  (:action drop :parameters (?b - ball) :precondition (held ?b) :effect (not (held ?b)))
  (:durative-action carry :parameters (?b - ball) :duration (= ?duration 10)
    :condition (and (at start (held ?b)) (over all (held ?b))) :effect (at end (dry)))
  (:process fall :parameters (?b - ball) :precondition (and (not (held ?b)) (> (height ?b) 0))
    :effect (and (decrease (height ?b) (* #t (speed ?b))) (increase (speed ?b) (* #t 9.8))))
  (:event crash :parameters (?b - ball) :precondition (and (<= (height ?b) 0) (> (speed ?b) 0))
    :effect (and (assign (speed ?b) 0) (forall (?x - ball) (when (held ?x) (broken ?b))))))
"""
FALLING_PROBLEM = """(define (problem p) (:domain falling) (:objects b - ball)
  (:init (held b) (= (height b) 5) (= (speed b) 0) (= (weight b) 1)) (:goal (broken b)))"""


def test_processes_and_events_are_kept_and_written_back(kb: KnowledgeBase):
    """P4: the domain is read, with their changes, and written as it was."""
    kb.load(FALLING, FALLING_PROBLEM)
    assert kb.domain_to_pddl() == FALLING
    assert [(event.kind, event.name, sorted(event.changes)) for event in kb.domain.events] == [
        ("process", "fall", ["height", "speed"]),
        ("event", "crash", ["broken", "speed"]),
    ]


@pytest.mark.parametrize(
    ("question", "named"),
    [
        ("(> (height b) 2)", r"height .*process fall"),
        ("(< (+ 1 (speed b)) 2)", r"speed .*process fall"),
        ("(broken b)", r"broken .*event crash"),
        ("(not (broken ?))", r"broken .*event crash"),
        ("(safe b)", r"safe is derived .*height .*process fall"),
        ("(forall (?b - ball) (or (dry) (safe ?b)))", r"process fall"),
    ],
)
def test_a_question_about_a_time_after_now_is_refused(kb: KnowledgeBase, question: str, named: str):
    """P4: the changes of a process or an event are not known there; now and before, they are."""
    kb.load(FALLING, FALLING_PROBLEM)
    later = START + 1
    for ask in (
        lambda: kb.holds(question, at=later),
        lambda: kb.truth(question, at=later, as_of=START),
        lambda: kb.explain(question, at=later),
        lambda: kb.query(question, at=later),
        lambda: kb.state(later).holds(question),
        lambda: kb.when(question, START, START + 2),
    ):
        with pytest.raises(InvalidKnowledge, match=named):
            ask()
    assert kb.truth(question) is not Truth.UNKNOWN
    assert kb.truth(question, at=START) is kb.state().truth(question)
    kb.when(question, START, START + 1)


def test_a_value_at_a_time_after_now_is_refused(kb: KnowledgeBase, clock: ManualClock):
    """P4: it is answered once the clock has reached that time, from what a sensor reported."""
    kb.load(FALLING, FALLING_PROBLEM)
    assert kb.value("(height b)") == 5
    for _ in range(2):
        with pytest.raises(
            InvalidKnowledge, match=r"\(height b\) cannot be answered: after now, height .*process fall"
        ):
            kb.value("(height b)", at=START + seconds(1))
    with pytest.raises(InvalidKnowledge, match=r"process fall"):
        kb.state(START + seconds(1)).value("(+ (height b) 1)")
    assert kb.value("(weight b)", at=START + seconds(1)) == 1
    assert kb.holds("(held b)", at=START + seconds(1))
    clock.advance(seconds(1))
    kb.add("(= (height b) 0.1)")
    assert kb.value("(height b)") == 0.1
    assert kb.value("(height b)", at=START) == 5


def test_operators_of_a_domain_with_processes_are_applied(kb: KnowledgeBase, clock: ManualClock):
    """P4: actions are computed as usual; a question about later checks the conditions of an operator, too."""
    kb.load(FALLING, FALLING_PROBLEM)
    run = kb.start("carry", "b")
    assert kb.holds("(dry)", at=START + seconds(10))
    clock.advance(seconds(10))
    kb.end(run)
    kb.apply("drop", "b")
    assert not kb.holds("(held b)")


def test_an_independent_reader_reads_the_written_files(kb: KnowledgeBase):
    """P4: Kairos, if it is installed, reads the domain and the problem as they are written back."""
    kairos = pytest.importorskip("kairos")
    kb.load(FALLING, FALLING_PROBLEM)
    try:
        domain = kairos.parse_domain(kb.domain_to_pddl())
    except kairos.PddlError:
        pytest.skip("this version of Kairos has no PDDL+")
    kairos.parse_problem(kb.to_pddl(), domain)


# -- object fluents -----------------------------------------------------------------------------------------------

VISITS = """(define (domain visits)
  (:requirements :typing :object-fluents :numeric-fluents :derived-predicates)
  (:types robot place - object door - place)
  (:predicates (visited ?p - place) (at_home ?r - robot) (lit ?p - place) (dark))
  (:functions (location ?r - robot) (home ?r - robot) - place (battery ?r - robot) (distance ?a ?b - place) - number)
  (:derived (at_home ?r - robot) (= (location ?r) (home ?r)))
  (:derived (dark) (not (lit hall)))
  (:constants hall - place)
  (:action move :parameters (?r - robot ?to - place)
    :precondition (and (not (= (location ?r) ?to)) (> (battery ?r) (distance (location ?r) ?to)) (lit (location ?r)))
    :effect (and (assign (location ?r) ?to) (visited (location ?r))))
  (:action light :parameters (?p - place) :precondition (dark) :effect (lit ?p))
  (:durative-action patrol :parameters (?r - robot ?to - place) :duration (= ?duration (distance (location ?r) ?to))
    :condition () :effect (at end (visited ?to))))
"""
VISITS_PROBLEM = """(define (problem p) (:domain visits) (:objects kenny - robot den - place)
  (:init (= (location kenny) den) (= (home Kenny) hall) (= (battery kenny) 80) (= (distance den hall) 3))
  (:goal (and (= (location kenny) hall) (visited hall) (lit (location kenny))
    (> (distance (location kenny) hall) 2))))"""


def test_object_fluents_are_kept_and_written_back(kb: KnowledgeBase):
    """P4: domain, initial values and goals are written; a problem that is read again is the same."""
    kb.load(VISITS, VISITS_PROBLEM)
    assert kb.domain_to_pddl() == VISITS
    fluents = kb.domain.object_fluents
    assert {name: fluent.types for name, fluent in fluents.items()} == {"location": ("place",), "home": ("place",)}
    assert sorted(kb.domain.function_signatures) == ["battery", "distance"]
    assert kb.constraints() == ["(= (location kenny) den)", "(= (home Kenny) hall)"]
    text = kb.to_pddl()
    assert "    (= (location kenny) den)\n    (= (home Kenny) hall)\n" in text
    goals = [
        "(= (location kenny) hall)",
        "(visited hall)",
        "(lit (location kenny))",
        "(> (distance (location kenny) hall) 2)",
    ]
    assert sorted(str(goal) for goal in kb.goals()) == sorted(goals)
    problem = read_problem(text, kb.domain)
    assert list(problem.object_values.values()) == kb.constraints()
    assert sorted(str(goal) for goal in problem.goals) == sorted(goals)


@pytest.mark.parametrize(
    "question",
    [
        "(= (location kenny) den)",
        "(= den (location kenny))",
        "(lit (location kenny))",
        "(not (lit (location kenny)))",
        "(> (distance (location kenny) hall) 2)",
        "(> (location kenny) 2)",
        "(exists (?p - place) (and (lit ?p) (= (location kenny) ?p)))",
        "(at_home kenny)",
        "(location kenny)",
    ],
)
def test_a_question_that_reads_an_object_fluent_is_refused(kb: KnowledgeBase, question: str):
    """P4: it is not computed, and the refusal names it; the same holds for predicates derived from it."""
    kb.load(VISITS, VISITS_PROBLEM)
    for ask in (kb.holds, kb.truth, kb.explain, kb.query, kb.state().holds, lambda q: kb.when(q, START, START + 5)):
        with pytest.raises(InvalidKnowledge, match=r"(location|home).* is an object fluent"):
            ask(question)
    assert not kb.holds("(lit den)")
    assert kb.holds("(dark)")
    assert kb.value("(distance den hall)") == 3


def test_object_fluents_have_no_value_and_cannot_be_added(kb: KnowledgeBase):
    """P4: neither as a number, nor as an item, nor in a pattern."""
    kb.load(VISITS, VISITS_PROBLEM)
    for attempt in (
        lambda: kb.value("(location kenny)"),
        lambda: kb.value("(+ 1 (location kenny))"),
        lambda: kb.add("(= (location kenny) den)"),
        lambda: kb.add("(= (location kenny) 3)"),
        lambda: kb.add("(location kenny)"),
        lambda: kb.remove("(location ?)"),
        lambda: kb.history("(location kenny)"),
    ):
        with pytest.raises(InvalidKnowledge, match=r"location.* is an object fluent"):
            attempt()


def test_an_operator_with_object_fluents_is_not_applied(kb: KnowledgeBase):
    """P4: its conditions and effects are not computed; another operator of the domain is applied."""
    kb.load(VISITS, VISITS_PROBLEM)
    for attempt in (
        lambda: kb.applicable("move", "kenny", "hall"),
        lambda: kb.apply("move", "kenny", "hall"),
        lambda: kb.start("patrol", "kenny", "hall"),
    ):
        with pytest.raises(InvalidKnowledge, match=r"location is an object fluent"):
            attempt()
    kb.apply("light", "hall")
    assert kb.holds("(lit hall)")


def test_goals_with_object_fluents_are_added_and_removed(kb: KnowledgeBase):
    """P4, C10, C9: they are kept as conditions, and end with the objects that they mention."""
    kb.load(VISITS, VISITS_PROBLEM)
    kb.remove_goal(*kb.goals())
    assert kb.goals() == []
    kb.add_goal("(= (location KENNY) hall)")
    kb.add("robbie - robot")
    kb.add_goal("(lit (location robbie))")
    with pytest.raises(InvalidKnowledge, match=r"nobody does not exist"):
        kb.add_goal("(lit (location nobody))")
    with pytest.raises(InvalidKnowledge, match=r"location"):
        kb.query(*kb.goals())
    kb.remove("robbie")
    assert [str(goal).lower() for goal in kb.goals()] == ["(= (location kenny) hall)"]


def test_a_value_of_an_object_fluent_at_a_later_time(kb: KnowledgeBase, clock: ManualClock):
    """P3, P4: it is scheduled, written at its relative time, replaces the value then, and is removed with it."""
    timed = "(:init (at 5 (= (location kenny) hall)) (at 8.5 (assign (home kenny) den)) (= (location kenny) den)"
    kb.load(VISITS, VISITS_PROBLEM.replace("(:init (= (location kenny) den)", timed))
    assert "    (at 5 (= (location kenny) hall))\n    (at 8.5 (= (home kenny) den))\n" in kb.to_pddl()
    assert read_problem(kb.to_pddl(), kb.domain).timed_values == [
        (seconds(5), "(location kenny)", "(= (location kenny) hall)"),
        (seconds("8.5"), "(home kenny)", "(= (home kenny) den)"),
    ]
    clock.advance(seconds(5))
    assert kb.constraints() == ["(= (location kenny) hall)", "(= (home Kenny) hall)"]
    assert "(at 3.5 (= (home kenny) den))" in kb.to_pddl()
    assert "(at 5 (= (location kenny) hall))" in kb.to_pddl(at=START)
    kb.clear()
    clock.advance(seconds(5))
    assert kb.constraints() == []


def test_a_value_of_an_object_fluent_ends_with_its_objects_and_is_replaced(kb: KnowledgeBase):
    """P4, C9: a written problem mentions only objects that it declares; a later problem replaces the value."""
    kb.load(VISITS, VISITS_PROBLEM)
    kb.load(
        None,
        "(define (problem q) (:domain visits) (:objects den - place kenny - robot) (:init (= (location kenny) hall)))",
    )
    assert kb.constraints() == ["(= (location kenny) hall)", "(= (home Kenny) hall)"]
    kb.remove("kenny")
    assert kb.constraints() == []
    assert kb.constraints(at=START) == []


def test_an_undeclared_object_fluent_is_refused():
    """P4: a group among arguments has a meaning only where the domain declares the object fluent."""
    domain = read_domain("(define (domain d) (:predicates (p ?x)) (:functions (f)))")
    with pytest.raises(kbstore.PddlSyntaxError, match=r"names of objects or variables"):
        read_problem("(define (problem q) (:domain d) (:init (p (f))) (:goal (and)))", domain)


def test_export_to_unified_planning_refuses_parts_that_are_not_computed(kb: KnowledgeBase):
    """P1, P4: nothing is left out silently; every such part is named."""
    pytest.importorskip("unified_planning")
    kb.load(VISITS, VISITS_PROBLEM)
    with pytest.raises(InvalidKnowledge) as refused:
        kb.to_problem()
    assert "the function (location ?r - robot): location is an object fluent" in str(refused.value)
    other = kbstore.open("sqlite://", "other", clock=ManualClock(START))
    other.load(FALLING, FALLING_PROBLEM)
    with pytest.raises(InvalidKnowledge, match=r"the process fall: .*kept"):
        other.to_problem()


# -- contingent problems ------------------------------------------------------------------------------------------

WUMPUS = """(define (domain wumpus)
  (:requirements :typing :contingent)
  (:types pos)
  (:predicates (at ?p - pos) (pit ?p - pos) (stench ?p - pos) (gold ?p - pos) (alive))
  (:action smell :parameters (?p - pos) :precondition (and (alive) (at ?p)) :observe (stench ?p))
  (:action move :parameters (?a ?b - pos) :precondition (and (alive) (at ?a) (not (pit ?b)))
    :effect (and (not (at ?a)) (at ?b))))
"""
WUMPUS_PROBLEM = """(define (problem p) (:domain wumpus) (:objects p1 p2 p3 - pos)
  (:init (at p1) (alive)
    (oneof (gold p1) (gold p2) (gold p3))
    (or (not (stench p1)) (pit p2))
    (unknown (stench p1)) (unknown (pit p3)))
  (:goal (exists (?p - pos) (and (at ?p) (gold ?p)))))"""
KEPT = [
    "(oneof (gold p1) (gold p2) (gold p3))",
    "(or (not (stench p1)) (pit p2))",
    "(unknown (stench p1))",
    "(unknown (pit p3))",
]


def test_unknowns_are_kept_and_written_back(open_kb: KnowledgeBase):
    """P4: with use_unknowns its atoms are unknown; domain and problem are written back."""
    open_kb.load(WUMPUS, WUMPUS_PROBLEM)
    assert open_kb.domain_to_pddl() == WUMPUS
    assert open_kb.constraints() == KEPT
    for atom in ("(gold p1)", "(stench p1)", "(pit p2)", "(pit p3)"):
        assert open_kb.truth(atom) is Truth.UNKNOWN
    written = read_problem(open_kb.to_pddl(), open_kb.domain)
    assert written.uncertain == KEPT
    assert "(:constraints" not in open_kb.to_pddl()
    assert open_kb.domain.actions["smell"].observe is not None
    assert open_kb.domain.actions["move"].observe is None


def test_unknowns_are_refused_in_a_closed_world(kb: KnowledgeBase):
    """P4: in a closed world absent is false; each is named with its position, and nothing is stored."""
    with pytest.raises(InvalidKnowledge, match=r"use_unknowns=True") as refused:
        kb.load(WUMPUS, WUMPUS_PROBLEM)
    assert [violation.partition(" says")[0] for violation in refused.value.violations] == [
        f"line {line}, column {column}: {text}"
        for (line, column), text in zip([(3, 5), (4, 5), (5, 5), (5, 27)], KEPT, strict=True)
    ]
    assert kb.state().facts == []


@pytest.mark.parametrize(
    ("atom", "left"), [("(gold p2)", [1, 2, 3]), ("(not (stench p1))", [0, 3]), ("(pit p3)", [0, 1, 2])]
)
def test_it_is_written_until_one_of_its_atoms_is_asserted(
    open_kb: KnowledgeBase, clock: ManualClock, atom: str, left: list[int]
):
    """P4: as true or as false; it does not come back when the atom is removed, and stays in the past."""
    open_kb.load(WUMPUS, WUMPUS_PROBLEM)
    clock.advance(seconds(1))
    open_kb.add(atom)
    remaining = [KEPT[index] for index in left]
    assert open_kb.constraints() == remaining
    assert read_problem(open_kb.to_pddl(), open_kb.domain).uncertain == remaining
    clock.advance(seconds(1))
    open_kb.remove(atom)
    assert open_kb.constraints() == remaining
    assert open_kb.constraints(at=START) == KEPT


def test_an_asserted_atom_is_not_unknown(open_kb: KnowledgeBase):
    """P4: also where the same problem asserts it, or it is scheduled by then."""
    open_kb.load(WUMPUS)
    open_kb.add("p1 - pos", "p2 - pos", "p3 - pos", "(gold p3)")
    open_kb.add("(pit p3)", initial_time=START + seconds(5))
    open_kb.load(None, WUMPUS_PROBLEM.replace("(alive)", "(alive) (not (stench p1))"))
    assert open_kb.constraints() == ["(unknown (pit p3))"]
    assert open_kb.constraints(at=START + seconds(5)) == []


def test_an_effect_asserts_an_atom_too(open_kb: KnowledgeBase):
    """P4: an effect counts like any assertion."""
    open_kb.load(
        "(define (domain d) (:predicates (open) (shut)) (:action look :effect (open)))",
        "(define (problem p) (:domain d) (:init (oneof (open) (shut))))",
    )
    open_kb.apply("look")
    assert open_kb.constraints() == []


def test_unknowns_end_with_their_objects_and_by_clear(open_kb: KnowledgeBase):
    """P4, C9, C12: a written problem mentions only objects that it declares."""
    open_kb.load(WUMPUS, WUMPUS_PROBLEM)
    open_kb.remove("p3")
    assert open_kb.constraints() == [KEPT[1], KEPT[2]]
    open_kb.clear()
    assert open_kb.constraints() == []


def test_an_initial_state_may_be_one_conjunction(open_kb: KnowledgeBase):
    """P4: contingent problems write (:init (and ...)); it is the same as its parts."""
    begin, end = "(:init", "(:goal"
    head, rest = WUMPUS_PROBLEM.split(begin)
    parts, tail = rest.split(end)
    whole = f"{head}(:init (and {parts.rstrip().removesuffix(')')})) {end}{tail}"
    open_kb.load(WUMPUS, whole)
    assert open_kb.constraints() == KEPT
    assert sorted(map(str, open_kb.state().facts)) == ["(alive)", "(at p1)"]


def test_symbols_of_unknowns_are_checked():
    """P4, D1: like any other condition."""
    domain = read_domain(WUMPUS)
    for text, problem in (
        ("(oneof (gold p1) (silver p1))", "no predicate silver"),
        ("(unknown (gold p9))", "p9 is not a declared object"),
        ("(or (gold p1 p1))", "takes 1"),
    ):
        with pytest.raises(InvalidKnowledge, match=problem):
            read_problem(f"(define (problem p) (:domain wumpus) (:objects p1 - pos) (:init {text}))", domain)
    for text in ("(oneof)", "(unknown (gold p1) (gold p1))", "(or gold)"):
        with pytest.raises(kbstore.PddlSyntaxError, match=r"takes"):
            read_problem(f"(define (problem p) (:domain wumpus) (:objects p1 - pos) (:init {text}))", domain)


def test_export_to_unified_planning_refuses_observations(open_kb: KnowledgeBase):
    """P1, P4: an action that observes would do nothing there."""
    pytest.importorskip("unified_planning")
    open_kb.load(WUMPUS)
    with pytest.raises(InvalidKnowledge, match=r"the operator smell: .*observe"):
        open_kb.to_problem()
