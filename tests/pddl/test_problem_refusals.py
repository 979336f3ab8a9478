"""Problems that are refused, each with file, line and column, and the line quoted."""

import pytest

from kbstore.errors import InvalidKnowledge, KbStoreError, PddlSyntaxError
from kbstore.model.formulas import Atom, Or
from kbstore.pddl.domain_reader import read_domain
from kbstore.pddl.parse import parse_initial
from kbstore.pddl.problem_reader import read_problem
from tests.pddl.marked import marked

DOMAIN = read_domain(
    """(define (domain rooms)
    (:types kitchen - room room robot)
    (:constants home - room)
    (:predicates (at ?r - robot ?x - room) (open ?x - room) (dark) (lit))
    (:functions (battery ?r - robot) (total-cost))
    (:derived (lit) (not (dark))))"""
)

FRAME = "(define (problem p) (:domain rooms)\n  (:objects kenny - robot k - kitchen)\n  "


def init(text):
    """A problem with something in its initial state."""
    return f"{FRAME}(:init (dark)\n    {text})\n  (:goal (and)))"


def goal(text):
    """A problem with a goal."""
    return f"{FRAME}(:goal\n    {text}))"


SYNTAX = {
    "empty": ("«", "empty"),
    "no define": ("«(defie (problem p) (:domain rooms) (:goal ()))", "begins with"),
    "a domain": ("(define («domain rooms))", "a problem is expected"),
    "no domain": ("«(define (problem p) (:goal (and)))", "does not name its domain"),
    "domain without a name": ("(define (problem p) (:domain«) (:goal ()))", "missing"),
    "wrong domain": ("(define (problem p)\n  (:domain «houses) (:goal (and)))", "of the domain houses, not of rooms"),
    "unknown section": ("(define (problem p) (:domain rooms)\n («:inits) (:goal ()))", "did you mean :init"),
    "domain's section": (FRAME + "(«:predicates (p)) (:goal ()))", "not a section of a problem"),
    "section twice": (FRAME + "(:init (dark))\n («:init) (:goal ()))", "second time"),
    "missing bracket": ("«(define (problem p) (:domain rooms) (:goal ())", "never closed"),
    "missing bracket of a section": (FRAME + "«(:init (dark)\n  (:goal (and)))", "on line 4"),
    "extra bracket": ("(define (problem p) (:domain rooms) (:goal ())\n)\n «)", "closes nothing"),
    "two problems": (
        "(define (problem p) (:domain rooms) (:goal ()))\n«(define (problem q) (:domain rooms) (:goal ()))",
        "second definition",
    ),
    "object of several types": (FRAME.replace("- kitchen)", "- «(either kitchen robot))") + "(:goal ()))", "one type"),
    "type without objects": ("(define (problem p) (:domain rooms) (:objects «- room) (:goal ()))", "none"),
    "missing type": ("(define (problem p) (:domain rooms) (:objects a -«) (:goal ()))", "missing"),
    "word in init": (init("«dark"), "brackets"),
    "nothing in init": (init("«()"), "lists facts"),
    "conjunction in init": (init("«(and (dark) (dark))"), "lists facts"),
    "negated value": (init("«(not (= (total-cost) 3))"), "lists facts"),
    "value that is no number": (init("(= (total-cost) «many)"), "a number"),
    "value that is a function": (init("(= (battery kenny) «(total-cost))"), "a number"),
    "value that is an object": (init("(= (battery kenny) «home)"), "a number"),
    "not a number": (init("(= (total-cost) «nan)"), "a number"),
    "infinite": (init("(= (total-cost) «-inf)"), "a number"),
    "too large": (init("(= (total-cost) «1e999)"), "too large"),
    "value without a number": (init("«(= (total-cost))"), "is .= .f a. 3."),
    "two numbers": (init("«(= 3 3)"), "two numbers"),
    "time that is no number": (init("(at «noon (dark))"), "number of seconds"),
    "negative time": (init("(at «-5 (dark))"), "before the initial state"),
    "time finer than a nanosecond": (init("(at «0.0000000001 (dark))"), "nanosecond"),
    "relative change at a time": (
        init("(at 5 «(increase (battery kenny) 3))"),
        "relative to a value cannot be scheduled",
    ),
    "value without a number at a time": (init("(at 5 (assign (battery kenny) «home))"), "a number"),
    "timed literal in a timed literal": (init("(at 5 «(at 6 (dark)))"), "lists facts"),
    "two facts at a time": (init("«(at 5 (dark) (dark))"), "lists facts"),
    "goal without brackets": (goal("«dark"), "brackets"),
    "two goals": (FRAME + "(:goal «(dark) (dark)))", "one condition"),
    "no goal in the section": (FRAME + "(:goal«))", "one condition"),
    "goal of a plan's course": (goal("«(always (dark))"), "constraints"),
    "time in a goal": (goal("(> «(total-time) 5)"), "metric"),
    "variable twice": (goal("(exists (?x «?x) (dark))"), "twice"),
    "metric without a direction": (FRAME + "(:goal ()) (:metric «(total-time)))", "minimize"),
    "metric of two expressions": (
        FRAME + "(:goal ()) (:metric «minimize (total-time) (total-cost)))",
        "one expression",
    ),
    "#t in a metric": (FRAME + "(:goal ()) (:metric minimize (* «#t 2)))", "continuous"),
    "unknown constraint": (FRAME + "(:goal ()) (:constraints «(eventually (dark))))", "not a constraint"),
}

KNOWLEDGE = {
    "object twice": (
        FRAME.replace("k - ", "k - kitchen «K - ").replace("kitchen)", "room)") + "(:goal ()))",
        "the object K is declared twice, as kitchen and as room",
    ),
    "constant as an object of another type": (FRAME.replace("k - ", "«home - ") + "(:goal ()))", "constant"),
    "undeclared type": (FRAME.replace("- kitchen", "- «hall") + "(:goal ()))", "the type hall is not declared"),
    "variable as an object": (FRAME.replace("k - ", "«?k - ") + "(:goal ()))", "is a variable"),
    "bad name": (FRAME.replace("k - ", "«k'k - ") + "(:goal ()))", "contains"),
    "undeclared object": (init("(open «hall)"), "(open hall): hall is not a declared object"),
    "undeclared predicate": (init("(«closed home)"), "no predicate closed"),
    "undeclared function": (init("(= («fuel) 3)"), "no numeric function fuel"),
    "undeclared function without brackets": (init("(= «fuel 3)"), "no numeric function fuel"),
    "predicate with a value": (init("(= («dark) 3)"), "is a predicate"),
    "function without a value": (init("(«total-cost)"), "is a numeric function"),
    "arity": (init("«(open home k)"), "(open home k) has 2 arguments, but (open ?x - room) takes 1"),
    "arity of a function": (init("(= «(battery) 3)"), "(battery) has 0 arguments"),
    "type": (init("(open «kenny)"), "kenny is of type robot, but room is expected"),
    "type of a function's argument": (init("(= (battery «home) 3)"), "home is of type room, but robot"),
    "type in a timed literal": (init("(at 5 (not (open «kenny)))"), "kenny is of type robot"),
    "variable in init": (init("(open «?x)"), "?x is a variable, but an object is expected"),
    "variable in a timed literal": (init("(at 5 (open «?x))"), "?x is a variable"),
    "variable in a value": (init("(= (battery «?r) 1)"), "?r is a variable"),
    "contradiction": (init("(not (open k)) «(open K)"), "both (open K) and (not (open K))"),
    "two values": (init("(= (battery kenny) 1) «(= (Battery Kenny) 2)"), "another value"),
    "derived fact": (init("«(lit)"), "lit is derived"),
    "undeclared object in the goal": (goal("(open «hall)"), "hall is not a declared"),
    "undeclared predicate in the goal": (goal("(and (dark) («closed home))"), "no predicate closed"),
    "type in the goal": (goal("(or (dark) (not (open «kenny)))"), "kenny is of type robot"),
    "arity in the goal": (goal("«(open)"), "takes 1"),
    "variable in the goal": (goal("(open «?x)"), "?x is a variable"),
    "variable compared in the goal": (goal("(= home «?x)"), "?x is a variable"),
    "variable out of scope": (goal("(exists (?y - room) (open «?x))"), "?x is not declared here; there are ?y"),
    "undeclared type in the goal": (goal("(exists (?x - «hall) (dark))"), "type hall"),
    "undeclared function in the goal": (goal("(> («fuel) 3)"), "no numeric function fuel"),
    "undeclared function in the metric": (FRAME + "(:goal ()) (:metric minimize («fuel)))", "no numeric function fuel"),
    "undeclared predicate in a constraint": (FRAME + "(:goal ()) (:constraints (always («closed))))", "no predicate"),
}


@pytest.fixture
def expected(request, tmp_path):
    """A problem in a file: its path, and the position of the expected refusal."""
    case = marked(request.param)
    path = tmp_path / "problem.pddl"
    path.write_text(case.text)
    return path, case


@pytest.mark.parametrize(("expected", "reason"), SYNTAX.values(), ids=SYNTAX, indirect=["expected"])
def test_syntax(expected, reason):
    """Text that is not PDDL is refused with file, line and column, and with the line quoted."""
    path, case = expected
    with pytest.raises(PddlSyntaxError, match=reason) as caught:
        read_problem(path, DOMAIN)
    assert (caught.value.line, caught.value.column) == (case.line, case.column)
    assert str(caught.value).startswith(f"{path}:{case.line}:{case.column}: ")


@pytest.mark.parametrize(("expected", "reason"), KNOWLEDGE.values(), ids=KNOWLEDGE, indirect=["expected"])
def test_knowledge(expected, reason):
    """An item that does not fit is refused with file, line and column, the line quoted, and what was expected (D1)."""
    path, case = expected
    with pytest.raises(InvalidKnowledge) as caught:
        read_problem(path, DOMAIN)
    (violation,) = caught.value.violations
    sentence, shown, mark = violation.split("\n")
    assert sentence.startswith(f"{path}:{case.line}:{case.column}: ")
    assert reason in sentence
    assert shown[mark.index("^") :][:10] == case.quoted[case.column - 1 :][:10]


def test_all_at_once():
    """All violations are reported together, in the order of the file."""
    with pytest.raises(InvalidKnowledge) as caught:
        read_problem(init("(open hall) (open kenny)\n(closed)").replace("(:goal (and))", "(:goal (dark k))"), DOMAIN)
    places = [violation.split(":")[0] for violation in caught.value.violations]
    assert places == ["line 4, column 11", "line 4, column 23", "line 5, column 2", "line 6, column 10"]


def test_variables_without_a_domain():
    """Variables in the initial state and in goals are refused without a domain, too."""
    with pytest.raises(InvalidKnowledge) as caught:
        read_problem("(define (problem p) (:domain d) (:init (p ?x) (p ?x)) (:goal (q ?)))")
    assert len(caught.value.violations) == 3


def test_many_violations():
    """Many violations in one long line are found in time linear in their number."""
    facts = " ".join(f"(open x{index})" for index in range(400))
    objects = " ".join(f"y{index} - nothing" for index in range(400))
    text = f"(define (problem p) (:domain rooms) (:objects {objects}) (:init {facts}) (:goal ()))"
    with pytest.raises(InvalidKnowledge) as caught:
        read_problem(text, DOMAIN)
    assert len(caught.value.violations) == 800


def test_too_many_violations():
    """A file with very many violations is not read to its end, and the refusal says so."""
    text = f"(define (problem p) (:domain rooms) (:init {'(closed) ' * 5000}) (:goal ()))"
    with pytest.raises(InvalidKnowledge) as caught:
        read_problem(text, DOMAIN)
    assert len(caught.value.violations) == 1001
    assert "there may be more" in caught.value.violations[-1]


@pytest.mark.parametrize("opening", ["(", "(not ", "(at 5 ", "(= ", "(or "])
@pytest.mark.parametrize("section", [":init", ":goal", ":metric", ":constraints", ":objects"])
def test_deep(opening, section):
    """A deeply nested problem, in any section, ends in a result or a refusal."""
    depth = 20_000
    text = f"(define (problem p) (:domain rooms) ({section} {opening * depth}(dark){')' * depth}) (:goal ()))"
    if (section, opening) == (":init", "(or "):
        # a disjunction of one disjunction of one ... is that of its one fact
        assert parse_initial(read_problem(text, DOMAIN).uncertain[0]) == [Or((Atom("dark"),))]
        return
    with pytest.raises(KbStoreError) as caught:
        read_problem(text, DOMAIN)
    assert len(str(caught.value)) < 2000
