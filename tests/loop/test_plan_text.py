"""Plans as planners print them, and what runs when one begins."""

import contextlib
from fractions import Fraction
from typing import Any

import pytest
from unified_planning.plans import SequentialPlan, TimeTriggeredPlan

from kbstore import KnowledgeBase, ManualClock, NotApplicable, PddlSyntaxError, UnknownSymbol, seconds
from kbstore.interop.plan_text import read_plan
from kbstore.interop.plans import Happening, Step, execute, steps
from tests.loop.conftest import BEGIN

APPLY, START, END = Happening.APPLY, Happening.START, Happening.END

DOMAIN = """
(define (domain garden)
  (:requirements :typing :fluents :durative-actions :negative-preconditions)
  (:types bed)
  (:predicates (wet ?b - bed) (dug ?b - bed) (rain))
  (:action Dig :parameters (?b - bed) :precondition (not (dug ?b)) :effect (dug ?b))
  (:durative-action water :parameters (?b - bed) :duration (>= ?duration 1)
    :condition (at start (dug ?b)) :effect (at end (wet ?b))))
"""


@pytest.fixture
def garden(kb: KnowledgeBase) -> KnowledgeBase:
    kb.load(DOMAIN)
    kb.add("roses - bed", "beans - bed", "(dug roses)")
    return kb


def read(kb: KnowledgeBase, text: str) -> list[Step]:
    return read_plan(text, kb.domain)


# -- reading ------------------------------------------------------------------------------------------------------


def test_a_plan_with_times_is_read(garden: KnowledgeBase):
    """Actions in any order and spelling, comments, exact decimals; what takes no time has no end."""
    text = """
    ; makespan 8
    2.500: (WATER beans) [5.25] ; by night
      .5 :( dig   beans ) [0.001]
    0: (water roses)[2.]
    """
    assert read(garden, text) == [
        Step(START, "water", ("roses",), 0, seconds(2)),
        Step(APPLY, "Dig", ("beans",), seconds("0.5")),
        Step(END, "water", ("roses",), seconds(2), seconds(2)),
        Step(START, "water", ("beans",), seconds("2.5"), seconds("5.25")),
        Step(END, "water", ("beans",), seconds("7.75"), seconds("5.25")),
    ]


def test_a_plan_without_times_is_a_sequence(garden: KnowledgeBase):
    """The order is that of the lines; an empty plan has nothing to do."""
    assert read(garden, "(dig beans)\r\n(Dig roses)\n") == [
        Step(APPLY, "Dig", ("beans",)),
        Step(APPLY, "Dig", ("roses",)),
    ]
    assert read(garden, "; nothing to do\n\n") == []


def test_times_are_rounded_to_the_nanosecond(garden: KnowledgeBase):
    """T1: a plan may be finer than a nanosecond; half of one goes to the even neighbour."""
    found = read(garden, "0.0000000014: (dig beans)\n0.0000000015: (dig beans)\n0.0000000025: (dig beans)")
    assert [step.at for step in found] == [1, 2, 2]


def test_an_end_and_what_needs_it_are_not_parted_by_rounding(garden: KnowledgeBase):
    """A start and a duration in decimals may add up to more than what waits for the end was given as its time.

    An end is moved back by two nanoseconds at most, and never to its own start.
    """
    text = """
    0.000000001: (water roses) [0.333333333]
    0.333333333: (dig roses)
    0.333333336: (dig beans)
    0.500000000: (water beans) [0.000000002]
    0.500000001: (dig beans)
    """
    assert [str(step) for step in read(garden, text)] == [
        "0.000000001: start (water roses)",
        "0.333333333: end (water roses)",
        "0.333333333: apply (Dig roses)",
        "0.333333336: apply (Dig beans)",
        "0.5: start (water beans)",
        "0.500000001: end (water beans)",
        "0.500000001: apply (Dig beans)",
    ]
    late = "0: (water roses) [0.333333336]\n0.333333333: (dig beans)"
    assert [step.at for step in read(garden, late)] == [0, 333_333_333, 333_333_336]
    short = "0: (water roses) [0.000000001]"
    assert [step.at for step in read(garden, short)] == [0, 1]


@pytest.mark.parametrize(
    ("text", "line", "message"),
    [
        ("0: (dig beans)\nstep 1: DIG BEANS", 2, "one action a line"),
        ("0: (dig (beans))", 1, "one action a line"),
        ("0: (dig beans", 1, "one action a line"),
        ("-1: (dig beans)", 1, "one action a line"),
        ("0: ()", 1, "one action a line"),
        ("0: (dig beans) (dig roses)", 1, "one action a line"),
        ("0: (water beans)", 1, "water takes time"),
        ("(water beans) [3]", 1, "water takes time"),
        ("(dig beans)\n3: (dig beans)", 2, "have a time and others have none"),
        ("4611686019: (dig beans)", 1, "below"),
        ("0: (water beans) [99999999999]", 1, "below"),
    ],
)
def test_what_is_no_plan_is_refused(garden: KnowledgeBase, text: str, line: int, message: str):
    """The error says which line, and what is expected."""
    with pytest.raises(PddlSyntaxError, match=message) as refused:
        read(garden, text)
    assert refused.value.line == line
    assert str(refused.value).startswith(f"plan:{line}:1:")


def test_an_unknown_operator_is_named(garden: KnowledgeBase):
    """V8: with those that the domain has."""
    with pytest.raises(UnknownSymbol, match=r"no operator mow; it has Dig, water"):
        read(garden, "0: (mow beans)")


@pytest.mark.parametrize("part", ["(", " ", "(x ", "9", "[", "(dig ", ";", "\n", ")"])
def test_hostile_text_is_read_or_refused(garden: KnowledgeBase, part: str):
    """A line of a megabyte ends in a plan or in a refusal, whatever it is made of."""
    for text in (part * (1_000_000 // len(part)), f"0: (dig {part * (1_000_000 // len(part))}"):
        with contextlib.suppress(PddlSyntaxError):
            read(garden, text)


# -- what runs when a plan begins ---------------------------------------------------------------------------------


def test_steps_are_executed(garden: KnowledgeBase, clock: ManualClock):
    """Steps in text need no other library."""
    done = [(str(step), clock.now() - BEGIN) for step, _ in execute(garden, read(garden, "1: (dig beans)"), clock.set)]
    assert done == [("1: apply (Dig beans)", seconds(1))]
    assert garden.holds("(dug beans)")


@pytest.mark.parametrize("empty", [[], TimeTriggeredPlan([])])
def test_what_runs_is_ended_when_it_is_expected_to(garden: KnowledgeBase, clock: ManualClock, empty: Any):
    """O4: the problem that a plan solves has the end effects of what runs; so has its execution."""
    garden.start("water", "roses", duration=seconds(10))
    clock.advance(seconds(4))
    (done,) = [(str(step), clock.now() - BEGIN) for step, _ in execute(garden, empty, clock.set)]
    assert done == ("6: end (water roses)", seconds(10))
    assert garden.when("(wet roses)", BEGIN, BEGIN + seconds(20))[0][0] == BEGIN + seconds(10)


def test_ends_come_in_their_place(garden: KnowledgeBase, clock: ManualClock):
    """O4: of one time, before what begins; so that what has ended by then can be started again."""
    garden.start("water", "roses", duration=seconds(10))
    plan = read(garden, "9: (dig beans)\n10: (WATER ROSES) [5]")
    assert [str(step) for step, _ in execute(garden, plan, clock.set)] == [
        "9: apply (Dig beans)",
        "10: end (water roses)",
        "10: start (water ROSES)",
        "15: end (water ROSES)",
    ]


def test_what_others_have_ended_is_left_alone(garden: KnowledgeBase, clock: ManualClock):
    """O3: somebody else may end or abort what ran before the plan."""
    run = garden.start("water", "roses", duration=seconds(10))
    executed = execute(garden, read(garden, "2: (dig beans)"), clock.set)
    next(executed)
    garden.abort(run)
    assert list(executed) == []
    assert not garden.holds("(wet roses)")


def test_what_is_late_is_left_alone(garden: KnowledgeBase, clock: ManualClock):
    """O3: nobody knows when it ends; it is no part of the problem either."""
    garden.start("water", "roses", duration=seconds(10))
    clock.advance(seconds(11))
    assert "late by 1 s" in garden.to_pddl()
    assert [str(step) for step, _ in execute(garden, read(garden, "2: (dig beans)"), clock.set)] == [
        "2: apply (Dig beans)"
    ]
    assert len(garden.state().running) == 1


def test_a_sequence_leaves_alone_what_runs(garden: KnowledgeBase, clock: ManualClock):
    """A plan without times says nothing about when; the caller ends what runs."""
    garden.start("water", "roses", duration=seconds(10))
    dig = garden.to_problem().action("Dig")
    plan = SequentialPlan([dig(garden.to_problem().object("beans"))])
    assert [str(step) for step, _ in execute(garden, plan, clock.set)] == ["apply (Dig beans)"]
    assert len(garden.state().running) == 1


def test_what_a_plan_started_is_ended_by_it_alone(garden: KnowledgeBase, clock: ManualClock):
    """O3: if somebody else ended what a plan started, its own end is refused, and the execution stops."""
    executed = execute(garden, read(garden, "0: (water roses) [5]\n9: (dig beans)"), clock.set)
    _, run = next(executed)
    garden.abort(run)
    with pytest.raises(NotApplicable, match="does not run"):
        next(executed)


def test_a_plan_of_the_library_and_its_text_are_the_same_steps(garden: KnowledgeBase):
    """The exact fractions of the one are the decimals of the other."""
    problem = garden.to_problem()
    roses = problem.object("roses")
    plan = TimeTriggeredPlan([(Fraction(1, 2), problem.action("water")(roses), Fraction(9, 4))])
    text = "0.5: (water roses) [2.25]"
    assert steps(plan) == read(garden, text)
