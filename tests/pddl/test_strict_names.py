"""P5: problems and domains with names that every planner reads."""

import re

import pytest

import kbstore
from kbstore import KnowledgeBase, ManualClock, StrictPddl, seconds
from kbstore.interop.plan_text import read_plan
from kbstore.interop.plans import execute
from kbstore.pddl.domain_reader import read_domain
from kbstore.pddl.expressions import is_number
from kbstore.pddl.problem_reader import read_problem
from kbstore.pddl.sexpr import Group, SourceText
from kbstore.pddl.strict_names import strict_domain, strict_problem

START = seconds(1000)

DOMAIN = """; für Größe
(define (domain site.1)
  (:requirements :typing :fluents :durative-actions :derived-predicates :preferences)
  (:types räume - object robot.type -object)
  (:constants dock#1 - räume)
  (:predicates (at ?r - robot.type ?wo.immer - räume) (2nd ?x- räume) (clean ?x - (either räume object)) (open))
  (:functions (größe ?x - räume) - number (total.cost) total-time.x)
  (:derived (clean ?x - räume) (and (2nd ?x) (> (größe ?x) (+ 1 2 (total.cost)))))
  (:action wisch-größe
    :parameters (?r.1 - robot.type ?x - räume)
    :precondition (and (at ?r.1 ?x) (forall (?y.z - räume) (imply (2nd ?y.z) (not (= ?y.z dock#1)))))
    :effect (and (2nd ?x) (when (open) (increase (total.cost) (größe ?x)))))
  (:durative-action fahr:hin
    :parameters (?r - robot.type ?a ?b - räume)
    :duration (= ?duration (größe ?b))
    :condition (and (at start (at ?r ?a)) (over all (open)))
    :effect (and (at start (not (at ?r ?a))) (at end (at ?r ?b)) (increase (total.cost) (* #t (größe ?b))))))
""".replace(" total-time.x)", ")")
PROBLEM = """(define (problem p) (:domain site.1)
  (:objects r/1 - robot.type küche 5 hall - räume)
  (:init (at r/1 küche) (= (größe hall) 4) (= (größe küche) 5) (= (größe 5) 1) (= (größe dock#1) 2) (= (total.cost) 0)
    (open) (at 100 (not (open))) (at 90 (2nd 5)))
  (:goal (and (at r/1 hall) (preference p.1 (2nd hall)) (>= (größe 5) 1)))
  (:metric minimize (+ (total.cost) (total-time) (is-violated p.1))))"""

NAMES = {
    "site.1", "räume", "robot.type", "dock#1", "2nd", "größe", "total.cost", "wisch-größe", "fahr:hin",
    "wo.immer", "r.1", "y.z",
}  # fmt: skip
"""The names of the domain that not every planner reads."""


@pytest.fixture
def clock() -> ManualClock:
    """A clock that is moved by hand."""
    return ManualClock(START)


@pytest.fixture
def kb(clock: ManualClock) -> KnowledgeBase:
    """The site, whose names no planner reads."""
    kb = kbstore.open("sqlite://", "site/robot1", clock=clock)
    kb.load(DOMAIN, PROBLEM)
    return kb


def words(text: str) -> set[str]:
    """All words of a PDDL text that are neither numbers nor marks."""
    found, todo = set[str](), [SourceText(text).read()]
    while todo:
        for node in todo.pop():
            if isinstance(node, Group):
                todo.append(node)
            elif not is_number(node):
                found.add(node.lstrip("?:#-"))
    return found - {"", "=", "+", "*", ">", ">="}


def restored(strict: StrictPddl) -> str:
    """The text with the original names, without its comments."""
    text = re.sub(";.*", "", strict.text)
    return re.sub(r"[A-Za-z][\w-]*", lambda word: strict.names.get(word[0], word[0]), text)


def test_every_name_is_one_that_every_planner_reads(kb: KnowledgeBase):
    """P5: of the domain and of the problem, its own name included, and in comments."""
    for text in (kb.domain_to_pddl(strict_names=True).text, kb.to_pddl(strict_names=True).text):
        assert text.isascii()
        assert [word for word in words(text) if not re.fullmatch(r"[A-Za-z][A-Za-z0-9_-]*", word)] == []
    assert "(problem site-robot1)" in kb.to_pddl(strict_names=True).text


def test_names_are_the_same_in_both(kb: KnowledgeBase):
    """P5: the problem's mapping has the domain's, and one name for each."""
    domain, problem = kb.domain_to_pddl(strict_names=True).names, kb.to_pddl(strict_names=True).names
    assert set(domain.values()) == NAMES
    assert domain.items() <= problem.items()
    assert set(problem.values()) - NAMES == {"r/1", "küche", "5", "p.1"}
    assert len(set(problem.values())) == len(problem)


def test_the_text_with_the_original_names_is_the_same(kb: KnowledgeBase):
    """P5: only names are replaced, at each of their positions."""
    domain = kb.domain_to_pddl(strict_names=True)
    assert restored(domain) == re.sub(";.*", "", kb.domain_to_pddl())
    assert restored(kb.to_pddl(strict_names=True)) == kb.to_pddl()


def test_a_name_that_every_planner_reads_stays(kb: KnowledgeBase):
    """P5: only other names are replaced; by names that are not in use."""
    names = kb.to_pddl(strict_names=True).names
    assert not {"hall", "open", "at", "clean"} & set(names.values())
    used = words(kb.domain_to_pddl()) | words(kb.to_pddl())
    assert not set(names) & used


def test_a_replacement_that_is_in_use_is_not_taken(kb: KnowledgeBase):
    """P5: not even the name of an object that another one would get."""
    taken = next(new for new, own in kb.to_pddl(strict_names=True).names.items() if own == "küche")
    kb.add(f"{taken} - räume", f"(= (größe {taken}) 1)")
    problem = kb.to_pddl(strict_names=True)
    assert taken not in problem.names
    assert f" {taken} " in problem.text
    assert sorted(problem.names.values()).count("küche") == 1


def test_a_name_is_replaced_by_the_same_at_any_time(kb: KnowledgeBase):
    """P5: also where the domain's text was written before an object with a similar name was added."""
    before = kb.domain_to_pddl(strict_names=True).names
    kb.add("größe - räume", "gr-e - räume")
    assert before.items() <= kb.to_pddl(strict_names=True).names.items()


def test_pddls_own_words_are_replaced_as_names_alone():
    """P5: a parser may fail on a predicate `when`, or an object `object`; keywords stay."""
    domain = read_domain(
        """(define (domain domain) (:predicates (when ?x) (p ?x ?y)) (:constants define)
        (:action and :parameters (?x) :precondition (and (when ?x) (not (p ?x define)))
          :effect (when (when ?x) (p ?x ?x))))"""
    )
    strict = strict_domain(domain)
    assert sorted(strict.names.values()) == ["and", "define", "domain", "when"]
    assert restored(strict) == domain.source
    named = {own: new for new, own in strict.names.items()}
    assert f":effect (when ({named['when']} ?x) (p ?x ?x))" in strict.text
    problem = strict_problem(
        "(define (problem q) (:domain domain) (:objects object - object either - object)"
        " (:init (when object) (p either define)) (:goal (when either)))",
        domain,
    )
    assert re.search(r"\(:objects (\S+) - object (\S+) - object\)", problem.text)
    assert read_problem(problem.text, read_domain(strict.text)).goals


def test_kairos_reads_it_and_its_plan_is_carried_out(kb: KnowledgeBase, clock: ManualClock):
    """P5, P6: an independent reader and planner; its plan is executed with the names of the knowledge base."""
    kairos = pytest.importorskip("kairos")
    kb.load(DOMAIN.replace("?x- ", "?x - ").replace(" -object", " - object"))
    kb.remove_goal(*kb.goals())
    kb.add_goal("(at r/1 hall)")
    kb.remove_metric()
    domain, problem = kb.domain_to_pddl(strict_names=True), kb.to_pddl(strict_names=True)
    with pytest.raises(Exception, match=r"."):
        kairos.parse_problem(kb.to_pddl(), kairos.parse_domain(kb.domain_to_pddl()))
    parsed = kairos.parse_problem(problem.text, kairos.parse_domain(domain.text))
    plan = kairos.Planner().solve(parsed, timeout=20, anytime=False).plan.to_string(precision=9)
    steps = read_plan(plan, kb.domain, names=problem.names)
    assert [str(step) for step in steps] == ["0: start (fahr:hin r/1 küche hall)", "4: end (fahr:hin r/1 küche hall)"]
    for _ in execute(kb, steps, clock.set):
        pass
    assert kb.holds("(at r/1 hall)")


def test_a_state_is_written_in_the_same_names(kb: KnowledgeBase):
    """P5: `State.to_pddl` like `KnowledgeBase.to_pddl`, at any time."""
    for t in (START, START + seconds(95)):
        assert kb.state(t).to_pddl(strict_names=True) == kb.to_pddl(t, strict_names=True)
    assert kb.state().to_pddl(strict_names=False) == kb.to_pddl()


def test_the_text_is_read_back(kb: KnowledgeBase):
    """P2, P5: as the same problem with other names."""
    domain, problem = kb.domain_to_pddl(strict_names=True), kb.to_pddl(strict_names=True)
    own, new = read_problem(kb.to_pddl(), kb.domain), read_problem(problem.text, read_domain(domain.text))
    assert (len(own.init), len(own.timed), len(own.goals), own.metric is None) == (
        len(new.init),
        len(new.timed),
        len(new.goals),
        new.metric is None,
    )
    assert restored(StrictPddl("\n".join(map(str, new.init)), problem.names)) == "\n".join(map(str, own.init))
