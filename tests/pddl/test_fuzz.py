"""Mutated files end in a result or in a typed refusal, never in another exception."""

import re

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from kbstore.errors import KbStoreError
from kbstore.pddl.domain_reader import read_domain
from kbstore.pddl.parse import condition_of, goals_of, parse_condition, parse_expression, parse_item
from kbstore.pddl.printer import condition_text, expression_text
from kbstore.pddl.problem_reader import read_problem

DOMAIN_TEXT = """(define (domain d) (:requirements :typing) (:types kitchen - room room robot)
  (:constants home - room) (:predicates (at ?r - robot ?x - room) (dark) (lit ?x - room))
  (:functions (battery ?r - robot) (total-cost) - number)
  (:derived (lit ?x - room) (and (not (dark)) (exists (?r - robot) (at ?r ?x))))
  (:action go :parameters (?r - robot ?to - room) :precondition (and (not (at ?r ?to)) (> (battery ?r) (+ 1 2)))
    :effect (and (at ?r ?to) (forall (?x - room) (when (at ?r ?x) (not (at ?r ?x)))) (increase (total-cost) 1)))
  (:durative-action charge :parameters (?r - robot) :duration (and (>= ?duration 1) (<= ?duration 9))
    :condition (and (at start (at ?r home)) (over all (dark)))
    :effect (and (at end (not (dark))) (increase (battery ?r) (* #t 2)))))"""
PROBLEM_TEXT = """(define (problem p) (:domain d) (:objects kenny - robot k - kitchen)
  (:init (at kenny home) (= (battery kenny) 8.5) (not (dark)) (at 5 (dark)) (at 6.5 (= (total-cost) 1)))
  (:goal (and (at kenny k) (or (dark) (> (battery kenny) 1)) (preference q (dark))))
  (:constraints (always (dark))) (:metric minimize (+ (total-time) (is-violated q))))"""
DOMAIN = read_domain(DOMAIN_TEXT)

WORDS = st.sampled_from(
    [
        *("(", ")", "((((", "?x", "?r", "?", "kenny", "home", "k", "at", "not", "and", "or", "=", ">", "+", "-", "*"),
        *("/", "#t", "?duration", "5", "-1", "1e9", "nan", ":init", ":goal", ":action", "forall", "exists", "when"),
        *("imply", "assign", "increase", "either", "room", "robot", "start", "end", "over", "all", "dark", "battery"),
        *(
            "total-time",
            "minimize",
            "preference",
            ":effect",
            ":parameters",
            ":types",
            ";",
            "\x00",
            "é",
            "(at",
            "(dark)",
        ),
    ]
)


def outcome(read, *arguments):
    """The result of reading; None if it is refused with a sentence."""
    try:
        return read(*arguments)
    except KbStoreError as error:
        return None if str(error) else error


@st.composite
def mutated(draw, text):
    """The text with some of its words dropped, doubled, swapped or replaced, and possibly cut off."""
    words = re.findall(r"[()]|[^\s()]+", text)
    for _ in range(draw(st.integers(1, 4))):
        index = draw(st.integers(0, max(0, len(words) - 2)))
        if len(words) < 2:
            break
        match draw(st.integers(0, 4)):
            case 0:
                del words[index]
            case 1:
                words.insert(index, words[index])
            case 2:
                other = draw(st.integers(0, len(words) - 1))
                words[index], words[other] = words[other], words[index]
            case 3:
                words[index] = draw(WORDS)
            case _:
                words.insert(index, draw(WORDS))
    return " ".join(words[: draw(st.just(len(words)) | st.integers(0, len(words)))])


@settings(max_examples=250, deadline=None)
@given(mutated(DOMAIN_TEXT))
def test_domains(text):
    """A mutated domain is read or refused."""
    domain = outcome(read_domain, text)
    assert domain is None or len(domain.operators) == len(domain.actions)


@settings(max_examples=250, deadline=None)
@given(mutated(PROBLEM_TEXT), st.booleans())
def test_problems(text, has_domain):
    """A mutated problem is read or refused, with and without its domain."""
    domain = DOMAIN if has_domain else None
    problem = outcome(read_problem, text, domain)
    if problem is not None:
        assert len(problem.places["init"]) == len(problem.init)
        assert all(line == 1 for places in problem.places.values() for line, _ in places)


TEXTS = (
    mutated("(and (at kenny home) (not (dark)) (forall (?x - room) (imply (lit ?x) (> (battery kenny) (- 3)))))")
    | mutated("(increase (battery kenny) (* #t 2))")
    | mutated("minimize (+ 1 (total-time))")
    | mutated("wp7 - waypoint")
    | st.lists(WORDS, max_size=12).map(" ".join)
    | st.text(max_size=30)
)


@settings(max_examples=250, deadline=None)
@given(TEXTS, st.booleans())
@example("\x08", False)
def test_items(text, has_domain):
    """A mutated item is read or refused; an item that is read can be written and asked."""
    domain = DOMAIN if has_domain else None
    item = outcome(parse_item, text, domain)
    if item is not None:
        assert parse_item(str(item), domain) == item
        outcome(condition_of, item, domain)


@settings(max_examples=250, deadline=None)
@given(TEXTS, st.booleans())
def test_conditions(text, has_domain):
    """A mutated condition is read or refused; a condition that is read can be written."""
    domain = DOMAIN if has_domain else None
    condition = outcome(parse_condition, text, domain)
    if condition is not None:
        outcome(goals_of, condition, domain)
        written = condition_text(condition)
        assert condition_text(parse_condition(written, domain)) == written


@settings(max_examples=250, deadline=None)
@given(TEXTS, st.booleans())
def test_expressions(text, has_domain):
    """A mutated expression is read or refused; an expression that is read can be written."""
    domain = DOMAIN if has_domain else None
    expression = outcome(parse_expression, text, domain)
    if expression is not None:
        assert parse_expression(expression_text(expression), domain) == expression


@pytest.mark.parametrize(
    "piece", ["(p a) ", "() ", "a ", "; x\n", "(= (f) 1) ", "(at 5 (p)) ", "(not (p)) ", "- t ", "\n"]
)
def test_long(piece):
    """A text of very many pieces ends in a result or a refusal."""
    many = piece * 5_000
    for text in (many, f"(define (problem p) (:domain d) (:init {many}) (:objects {many}) (:goal ()))"):
        for read in (parse_item, parse_condition, parse_expression, read_problem, read_domain):
            with pytest.raises(KbStoreError) as caught:
                read(text + " (")
            assert len(str(caught.value)) < 5000
