"""Domains that are refused, each with file, line and column, and the line quoted."""

import pytest

from kbstore.errors import PddlSyntaxError
from kbstore.pddl.domain_reader import read_domain
from tests.pddl.marked import marked

WITH = """(define (domain d)
  (:types place robot)
  (:constants home - place)
  (:predicates (p) (at ?r - robot ?x - place) (d))
  (:functions (f) (g ?x - place))
  (:derived (d) (p))
"""
ACTION = WITH + "  (:action a :parameters (?r - robot ?x - place)\n    "
DURATIVE = WITH + "  (:durative-action a :parameters (?r - robot ?x - place)\n    "

REFUSALS = {
    "no definition": ("«", "empty"),
    "no define": ("«(defin (domain d))", "begins with"),
    "words only": ("«define (domain d)", "begins with"),
    "no header": ("(define «)", "followed by"),
    "a problem": ("(define («problem p) (:domain d))", "a domain is expected"),
    "missing bracket": ("«(define (domain d)\n  (:predicates (p))", "never closed"),
    "missing bracket of a section": ("(define (domain d)\n  «(:predicates (p)\n  (:functions (f)))", "on line 3"),
    "extra bracket": ("(define (domain d)\n  (:predicates (p)))«))", "closes nothing"),
    "text after the end": ("(define (domain d)\n  (:predicates (p)))\n «(:functions (f))", "outside"),
    "text between sections": ("(define (domain d) «hello (:predicates (p)))", "a section"),
    "unknown section": ("(define (domain d)\n («:predicate (p)))", "did you mean :predicates"),
    "PDDL 1.2": ("(define (domain d) («:axiom x))", r"PDDL 1\.2"),
    "process twice": (WITH + "(:process x :effect (p)) (:process «X))", "second time, and differently"),
    "duration in a process": (WITH + "(:process x :effect (increase (f) «?duration)))", "durative"),
    "elapsed time in an event": (WITH + "(:event x :effect (increase (f) (* «#t 2))))", "durative"),
    "section twice": ("(define (domain d) (:predicates (p))\n («:predicates (q)))", "second time"),
    "object below something": (
        "(define (domain d) (:types «object - thing))",
        "above all types, and is not below thing",
    ),
    "object before a type": (
        "(define (domain d)\n (:types\n   place\n   «object\n   container - place\n   box - place))",
        "'- place' is the type of all names since the type before it, also across lines: place, object, container; "
        "write names without a type last",
    ),
    "cycle by names before a type": (
        "(define (domain d) (:types «room - place\n  area place door - room))",
        "room is below itself: room - place - room; .* '- room' is the type of all names .*: area, place, door",
    ),
    "cycle of types": ("(define (domain d) (:types «a - b b - c c - a))", "below itself"),
    "cycle through either": ("(define (domain d) (:types «b - (either a c) c - b a))", "below itself"),
    "missing type": ("(define (domain d) (:types a -«))", "missing"),
    "type without names": ("(define (domain d) (:types a - b «- c))", "none"),
    "group among types": ("(define (domain d) (:types a «(b)))", "a name is expected"),
    "undeclared type": ("(define (domain d) (:predicates (p ?x - «truck)))", "type truck is not declared"),
    "undeclared type of a constant": ("(define (domain d) (:constants a - «truck))", "type truck"),
    "undeclared type in either": ("(define (domain d) (:types a) (:predicates (p ?x - «(either a b))))", "type b"),
    "constant twice": (
        "(define (domain d) (:types t) (:constants a - t b\n «A))",
        "second time, as object; before it is t",
    ),
    "constant of several types": ("(define (domain d) (:types a b) (:constants x - «(either a b)))", "one type"),
    "predicate twice": ("(define (domain d) (:predicates (p) («P ?x)))", "second time"),
    "predicate without brackets": ("(define (domain d) (:predicates «p))", "brackets"),
    "predicate without a name": ("(define (domain d) (:predicates (p) (q) («)))", "missing"),
    "parameter twice": ("(define (domain d) (:action a :parameters (?x «?X)))", "twice"),
    "parameter without ?": ("(define (domain d) (:predicates (p «x)))", "a variable is expected"),
    "parameter without a name": ("(define (domain d) (:predicates (p «?)))", "a variable is expected"),
    "function twice": ("(define (domain d) (:functions (f ?x) («f)))", r"second time, .* before it is \(f \?x"),
    "unknown type of an object fluent": ("(define (domain d) (:functions (f) - «t))", "type t is not declared"),
    "object fluent as a number": (
        "(define (domain d) (:types t) (:functions (f) - t)\n (:action a :precondition (> («f) 3)))",
        "f is an object fluent",
    ),
    "number as an object": (
        "(define (domain d) (:types t) (:functions (f) - t (g))\n (:action a :precondition (= (f) «(g))))",
        "an object is expected",
    ),
    "value of another type": (
        "(define (domain d) (:types t u) (:functions (f) - t)\n"
        " (:action a :parameters (?x - u) :effect (assign (f) «?x)))",
        "of type u, but t is expected",
    ),
    "function without brackets": ("(define (domain d) (:functions «f))", "brackets"),
    "bad name": ("(define (domain d) (:constants «a'b))", "contains"),
    "action without a name": (WITH + "(:action «))", "missing"),
    "action twice": (WITH + "(:action a) (:action «A :effect (p)))", "second time"),
    "unknown part of an action": (ACTION + "«:preconditions (p)))", "did you mean :precondition"),
    "durative part of an action": (ACTION + "«:condition (p)))", "condition"),
    "word in an action": (ACTION + "«here (p)))", "expected here"),
    "part twice": (ACTION + ":effect (p) «:effect (p)))", "second time"),
    "part without a group": (ACTION + ":effect «p))", "followed by"),
    "part with nothing": (ACTION + ":effect«))", "followed by"),
    "parameter declared in both lists": (ACTION + ":vars «(?x - place)))", "twice"),
    "unknown predicate": (ACTION + ":precondition («near ?x)))", "no predicate near"),
    "function as a predicate": (ACTION + ":precondition («f)))", "numeric function"),
    "predicate as a function": (ACTION + ":precondition (> («p) 1)))", "is a predicate"),
    "unknown function": (ACTION + ":precondition (> («h) 1)))", "no numeric function h"),
    "unknown function without brackets": (ACTION + ":precondition (> «h 1)))", "no numeric function h"),
    "too few arguments": (ACTION + ":precondition «(at ?r)))", "takes 2"),
    "too many arguments": (ACTION + ":precondition (> «(f ?x) 1)))", "takes 0"),
    "undeclared variable": (ACTION + ":precondition (at ?r «?y)))", r"\?y is not declared"),
    "undeclared variable compared": (ACTION + ":precondition (= ?x «?y)))", r"\?y is not declared"),
    "undeclared variable in an expression": (ACTION + ":precondition (> (g «?y) 1)))", r"\?y is not declared"),
    "variable out of scope": (
        ACTION + ":precondition (and (exists (?y - place) (at ?r ?y)) (at ?r «?y))))",
        r"\?y is not declared",
    ),
    "undeclared object": (ACTION + ":precondition (at ?r «wp7)))", "wp7 is not a declared"),
    "wrong type": (ACTION + ":precondition (at «?x ?x)))", "of type place, but robot"),
    "wrong type of a constant": (ACTION + ":precondition (at «home home)))", "of type place, but robot"),
    "wrong type in an effect": (ACTION + ":effect (not (at ?r «?r))))", "of type robot, but place"),
    "wrong type of a function's argument": (ACTION + ":effect (increase (g «?r) 1)))", "of type robot, but place"),
    "supertype in an effect": (
        WITH + "(:action b :parameters (?o) :effect (at «?o home)))",
        "of type object, but robot",
    ),
    "variable twice in a quantifier": (ACTION + ":precondition (exists (?y «?y) (p))))", "twice"),
    "effect of a derived predicate": (ACTION + ":effect «(d)))", "derived"),
    "no effect": (ACTION + ":effect «(= (f) 3)))", "not an effect"),
    "negated conjunction": (ACTION + ":effect «(not (and (p) (p)))))", "one fact"),
    "assignment without a value": (ACTION + ":effect «(increase (f))))", "a function and a value"),
    "when without an effect": (ACTION + ":effect «(when (p))))", "a condition and an effect"),
    "continuous effect of an instantaneous action": (ACTION + ":effect (increase (f) (* «#t 2))))", "durative"),
    "duration in an instantaneous action": (ACTION + ":effect (increase (f) «?duration)))", "durative"),
    "total time in a condition": (ACTION + ":precondition (> «(total-time) 3)))", "the metric"),
    "moment in an instantaneous action": (ACTION + ":precondition «(over all (p))))", "durative"),
    "no number": (ACTION + ":precondition (> (f) «nan)))", "not a number"),
    "no duration": (WITH + "  «(:durative-action a :parameters ()))", "lacks its :duration"),
    "condition without a moment": (DURATIVE + ":duration () :condition «(p)))", "at start"),
    "effect without a moment": (DURATIVE + ":duration () :effect «(p)))", "at end"),
    "numeric effect without moment or rate": (DURATIVE + ":duration () :effect «(increase (f) 2)))", "rate"),
    "effect over all": (DURATIVE + ":duration () :effect «(over all (p))))", "at start or at end"),
    "two groups after a moment": (DURATIVE + ":duration () :condition «(at start (p) (p))))", "one group"),
    "not a duration": (DURATIVE + ":duration «(= (f) 5)))", r"\?duration"),
    "duration squared": (DURATIVE + ":duration «(= ?duration ?duration)))", r"\?duration"),
    "not a rate": (DURATIVE + ":duration () :effect «(increase (f) (* #t #t))))", "rate"),
    "effect at start that depends on the end": (
        DURATIVE + ":duration () :effect «(when (and (at start (p)) (at end (p))) (at start (p)))))",
        "effect at start cannot depend on a condition at end, which is known only later",
    ),
    "one of several effects at start that depends on the end": (
        DURATIVE + ":duration () :effect «(when (at end (p)) (and (at end (p)) (at start (p))))))",
        "effect at start cannot depend on a condition at end",
    ),
    "effect at start that depends on the course": (
        DURATIVE + ":duration () :effect «(when (over all (p)) (at start (p)))))",
        "effect at start cannot depend on a condition over all, which is known only later",
    ),
    "continuous effect that depends on the end": (
        DURATIVE + ":duration () :effect «(when (at end (p)) (increase (f) (* #t 2)))))",
        "continuous effect cannot depend on a condition at end, which is known only later",
    ),
    "effect at end that depends on the course": (
        DURATIVE + ":duration () :effect (forall (?x) «(when (over all (p)) (at end (p))))))",
        "condition over all cannot be read",
    ),
    "rule without a body": (WITH + "«(:derived (d)))", "a rule is"),
    "rule of an unknown predicate": (WITH + "(:derived («e) (p)))", "no predicate e"),
    "rule with another number of parameters": (WITH + "(:derived «(d ?x) (p)))", "is declared"),
    "unstratified rules": (
        "(define (domain d) (:predicates (a) (b) (c))\n  (:derived (c) (a))\n  «(:derived (a) (not (b)))\n"
        "  (:derived (b) (a)))",
        "stratified",
    ),
    "unknown constraint": (WITH + "(:constraints «(never (p))))", "not a constraint"),
    "constraint of an unknown predicate": (WITH + "(:constraints (always («e))))", "no predicate e"),
    "constraint without its number": (WITH + "(:constraints (within «(p) (p))))", "a number is expected"),
    "constraint with too few operands": (WITH + "(:constraints «(sometime-after (p))))", "takes 2"),
    "constraint without brackets": (WITH + "(:constraints «always))", "brackets"),
    "too deep an effect": (ACTION + ":effect " + "(forall () " * 151 + "«(p)" + ")" * 153, "deeper"),
}


@pytest.mark.parametrize("case", REFUSALS)
def test_refusal(case, tmp_path):
    """Each is refused with file, line and column, the line quoted, and what was expected."""
    text, reason = REFUSALS[case]
    expected = marked(text)
    path = tmp_path / "domain.pddl"
    path.write_text(expected.text)
    with pytest.raises(PddlSyntaxError, match=reason) as caught:
        read_domain(path)
    error = caught.value
    assert (error.line, error.column) == (expected.line, expected.column)
    assert str(error).startswith(f"{path}:{expected.line}:{expected.column}: ")
    if expected.column <= 50:
        shown = expected.quoted[:100]
        assert str(error).endswith(f"\n  {shown}\n  {' ' * (expected.column - 1)}^" if shown else problem_of(error))


def problem_of(error):
    """The sentence that ends the message of an empty line."""
    return error.problem


def test_missing_file():
    """A missing domain is a refusal that names it."""
    with pytest.raises(PddlSyntaxError, match=r"nowhere\.pddl"):
        read_domain("nowhere.pddl")


@pytest.mark.parametrize("opening", ["(", "(and ", "(forall (?x) ", "(not ", "(when (p) ", "(or "])
def test_deep(opening):
    """A very deeply nested domain is refused (or, where the levels have no meaning, read)."""
    depth = 20_000
    nested = opening * depth + "(p)" + ")" * depth
    text = f"(define (domain d) (:predicates (p)) (:action a :effect {nested}))"
    if opening == "(and ":
        assert len(read_domain(text).action("a").effects) == 1
    else:
        with pytest.raises(PddlSyntaxError):
            read_domain(text)
