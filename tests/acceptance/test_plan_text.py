"""Plans as planners print them, and runs that exist when a plan begins."""

import time
from dataclasses import replace
from fractions import Fraction
from typing import Any

import pytest
from unified_planning.plans import SequentialPlan, TimeTriggeredPlan

from kbstore import KnowledgeBase, ManualClock, NotApplicable, PddlSyntaxError, UnknownSymbol, seconds
from kbstore.interop.plan_text import read_plan
from kbstore.interop.plans import Happening, Step, execute, steps
from tests.acceptance.conftest import BEGIN

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
    """Actions in any order and spelling, comments, exact decimals; an instantaneous action has no end."""
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
    """The order is that of the lines; an empty plan has no steps."""
    assert read(garden, "(dig beans)\r\n(Dig roses)\n") == [
        Step(APPLY, "Dig", ("beans",)),
        Step(APPLY, "Dig", ("roses",)),
    ]
    assert read(garden, "; nothing to do\n\n") == []


def test_times_are_rounded_to_the_nanosecond(garden: KnowledgeBase):
    """T1: a plan may be finer than a nanosecond; half of one is rounded to the even neighbour."""
    found = read(garden, "0.0000000014: (dig beans)\n0.0000000015: (dig beans)\n0.0000000025: (dig beans)")
    assert [step.at for step in found] == [1, 2, 2]


def test_rounding_does_not_put_an_end_after_the_start_that_needs_it(garden: KnowledgeBase):
    """A start and a duration in decimals may add up to more than the time of a step that waits for the end.

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
        ("0: (dig beans)\nstep 1: DIG BEANS", 2, "have a time and others have none"),
        ("step 0: DIG BEANS\nstep 1: (DIG ROSES)", 2, "one action a line"),
        ("step 0: DIG BEANS\n     1: DIG (ROSES)", 2, "one action a line"),
        ("ff: found legal plan as follows\nstep 0: WATER BEANS", 2, "water takes time"),
        ("Solution found!\n\n(dig beans", 3, "one action a line"),
        ("Problem unsolvable", 1, "no plan in this text"),
        ("; a comment\n\nbest heuristic value: 3", 3, "no plan in this text"),
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
def test_text_that_is_not_a_plan_is_refused(garden: KnowledgeBase, text: str, line: int, message: str):
    """The error has the line, and what is expected."""
    with pytest.raises(PddlSyntaxError, match=message) as refused:
        read(garden, text)
    assert refused.value.line == line
    assert str(refused.value).startswith(f"plan:{line}:1:")


def test_an_unknown_operator_is_named(garden: KnowledgeBase):
    """V8: with those that the domain has."""
    with pytest.raises(UnknownSymbol, match=r"no operator mow; it has Dig, water"):
        read(garden, "0: (mow beans)")


HOSTILE = {"(": 1, " ": None, "(x ": 1, "9": 1, "[": 1, "(dig ": 1, ";": None, "\n": None, ")": 1, "step ": 1}
"""Parts of hostile lines, and the line at which their plan is refused; None where it is an empty plan."""


@pytest.mark.parametrize(("part", "line"), HOSTILE.items())
def test_hostile_text_is_read_or_refused(garden: KnowledgeBase, part: str, line: int | None):
    """A line of a megabyte ends in a plan or in a refusal, in linear time (0.1 s where this was written)."""
    begin = time.process_time()
    many = part * (1_000_000 // len(part))
    if line is None:
        assert read(garden, many) == []
    else:
        with pytest.raises(PddlSyntaxError) as refused:
            read(garden, many)
        assert refused.value.line == line
    with pytest.raises(PddlSyntaxError) as refused:
        read(garden, f"0: (dig {many}")
    assert refused.value.line == 1
    assert time.process_time() - begin < 10


# -- as planners print them ---------------------------------------------------------------------------------------

FF = """
ff: parsing domain file
domain 'GARDEN' defined
 ... done.
ff: search configuration is  EHC, if that fails then  best-first on 1*g(s) + 5*h(s) where
    metric is  plan length

Cueing down from goal distance:    2 into depth [1]
                                   1            [1]
                                   0

ff: found legal plan as follows

step    0: DIG BEANS
        1: DIG ROSES
        2: REACH-GOAL
plan cost: 2.000000

time spent:    0.00 seconds instantiating 2 easy, 0 hard action templates
               0.00 seconds total time
"""
POPF = """Number of literals: 4
Constructing lookup tables: [10%] [20%] [100%]
Post filtering unreachable actions:  [100%]
\x1b[01;34mNo analytic limits found, not considering limit effects of goal-only operators\x1b[00m
Initial heuristic = 2.000
b (1.000 | 5.000);;;; Solution Found
; States evaluated: 4
; Cost: 5.502
; Time 0.00
0.000: (water roses)  [5.250]
0.500: (dig beans)  [0.001]

 * All goal deadlines now no later than 5.250
"""
OPTIC = """b (2.000 | 9.000)
; Plan found with metric 9.000
; States evaluated so far: 5
; Time 0.02
0.000: (dig beans)  [0.001]
9.000: (water roses)  [5.250]
b (1.000 | 0.000)
; Plan found with metric 5.502
; Theoretical reachable cost 5.502
0.000: (water roses)  [5.250]
0.500: (dig beans)  [0.001]
"""
ENHSP = """Domain parsed
Problem parsed
Grounding..
|F|:2
Problem Solved

Found Plan:
0: (water roses) [5.25]
0: -----waiting---- [0.5]
0.5: (dig beans)
5.25: @PlanEND

Plan-Length:2
Metric (Search):5.25
Planning Time (msec): 12
"""
LPG = """Parsing domain file:  domain 'GARDEN' defined ... done.
Plan computed:
   Time: (ACTION) [action Duration; action Cost]
 0.0000: (WATER ROSES) [D:5.2500; C:0.1000]
 0.5000: (DIG BEANS) [D:0.0010; C:0.1000] ; last

Solution number: 1
Total time:      0.01
Actions:         2
"""
LPG_FILE = """
; Version LPG-td-1.4
; Command line: ./lpg -o domain.pddl -f problem.pddl -n 1
; Time 0.02
; MetricValue 5.25

0:   (WATER ROSES) [5.2500]
0.5:   (DIG BEANS) [1]
"""
TFD = """Solution with original makespan 5.2502 found (ignoring no-moving-actions-separation).
Plan length: 2 step(s).
Rescheduled Plan:
0.00000000: (water roses) [5.25000000]
0.50000000: (dig beans) [0.00100000]
Solution was found, but best_first_search was not finished.
"""
FAST_DOWNWARD = """[t=0.000204s, 9964 KB] Conducting best first search without reopening closed nodes.
[t=0.000300s, 9964 KB] New best heuristic value for ff: 1
[t=0.000301s, 9964 KB] Solution found!
[t=0.000302s, 9964 KB] Actual search time: 0.000100s
dig beans (1)
dig roses (1)
[t=0.000303s, 9964 KB] Plan length: 2 step(s).
[t=0.000304s, 9964 KB] Plan cost: 2
Search time: 0.000135s
"""
SAS_PLAN = """(dig beans)
(dig roses)
; cost = 2 (unit cost)
"""

SEQUENCE = [Step(APPLY, "Dig", ("beans",)), Step(APPLY, "Dig", ("roses",))]
TIMED = [
    Step(START, "water", ("roses",), 0, seconds("5.25")),
    Step(APPLY, "Dig", ("beans",), seconds("0.5")),
    Step(END, "water", ("roses",), seconds("5.25"), seconds("5.25")),
]


def in_lower_case(plan: list[Step]) -> list[Step]:
    """The plan with its objects as they are compared: planners write them in either case."""
    return [replace(step, arguments=tuple(map(str.lower, step.arguments))) for step in plan]


@pytest.mark.parametrize("text", [FF, FAST_DOWNWARD, SAS_PLAN], ids=["FF", "Fast Downward", "sas_plan"])
def test_a_sequence_as_planners_print_it(garden: KnowledgeBase, text: str):
    """P6: with the text around it; FF's own action that reaches the goal is left out."""
    assert in_lower_case(read(garden, text)) == SEQUENCE


@pytest.mark.parametrize(
    "text",
    [POPF, OPTIC, ENHSP, LPG, LPG_FILE, TFD],
    ids=["POPF", "OPTIC", "ENHSP", "LPG", "LPG's file", "TFD"],
)
def test_a_plan_with_times_as_planners_print_it(garden: KnowledgeBase, text: str):
    """P6: with the text around it; of several plans, the last."""
    assert in_lower_case(read(garden, text)) == TIMED


@pytest.mark.parametrize("text", [FF, FAST_DOWNWARD, POPF, LPG, ENHSP, TFD])
def test_a_malformed_step_is_refused_with_its_line(garden: KnowledgeBase, text: str):
    """P6: the text around a plan does not hide an error in it."""
    lines = text.splitlines()
    number = next(i for i, line in enumerate(lines, 1) if "dig beans" in line.lower())
    for old, new in (("beans", "(beans"), ("BEANS", "(BEANS")):
        lines[number - 1] = lines[number - 1].replace(old, new)
    with pytest.raises(PddlSyntaxError) as refused:
        read(garden, "\n".join(lines))
    assert refused.value.line == number


@pytest.mark.parametrize(
    "text", [FF.replace("DIG ROSES", "MOW ROSES"), FAST_DOWNWARD.replace("dig roses", "mow roses")]
)
def test_an_unknown_operator_among_the_steps_of_a_log_is_named(garden: KnowledgeBase, text: str):
    """P6, V8: a step between steps is not taken for the text around them."""
    with pytest.raises(UnknownSymbol, match=r"no operator (?i:mow)"):
        read(garden, text)


@pytest.mark.parametrize(
    "text",
    [
        "ff: goal can be simplified to TRUE. The empty plan solves it",
        "Solution found!\nPlan length: 0 step(s).",
        ";;;; Solution Found\n; Cost: 0.000\n",
    ],
)
def test_an_empty_plan(garden: KnowledgeBase, text: str):
    """P6: an empty plan that was found differs from no plan."""
    assert read(garden, text) == []


def test_comments_do_not_begin_another_plan(garden: KnowledgeBase):
    """P6: a comment in a plan, with any text, changes nothing."""
    assert read(garden, "(dig beans)\n; better solution found by hand\n(dig roses)") == SEQUENCE


# -- what runs when a plan begins ---------------------------------------------------------------------------------


def test_steps_are_executed(garden: KnowledgeBase, clock: ManualClock):
    """Steps in text need no other library."""
    done = [(str(step), clock.now() - BEGIN) for step, _ in execute(garden, read(garden, "1: (dig beans)"), clock.set)]
    assert done == [("1: apply (Dig beans)", seconds(1))]
    assert garden.holds("(dug beans)")


@pytest.mark.parametrize("empty", [[], TimeTriggeredPlan([])])
def test_earlier_runs_are_ended_at_their_expected_ends(garden: KnowledgeBase, clock: ManualClock, empty: Any):
    """O4: the problem that a plan solves has the end effects of runs; so has its execution."""
    garden.start("water", "roses", duration=seconds(10))
    clock.advance(seconds(4))
    (done,) = [(str(step), clock.now() - BEGIN) for step, _ in execute(garden, empty, clock.set)]
    assert done == ("6: end (water roses)", seconds(10))
    assert garden.when("(wet roses)", BEGIN, BEGIN + seconds(20))[0][0] == BEGIN + seconds(10)


def test_ends_come_before_starts_of_the_same_time(garden: KnowledgeBase, clock: ManualClock):
    """O4: an action that has ended by then can be started again."""
    garden.start("water", "roses", duration=seconds(10))
    plan = read(garden, "9: (dig beans)\n10: (WATER ROSES) [5]")
    assert [str(step) for step, _ in execute(garden, plan, clock.set)] == [
        "9: apply (Dig beans)",
        "10: end (water roses)",
        "10: start (water ROSES)",
        "15: end (water ROSES)",
    ]


def test_runs_ended_by_others_are_left_alone(garden: KnowledgeBase, clock: ManualClock):
    """O3: another program may end or abort earlier runs."""
    run = garden.start("water", "roses", duration=seconds(10))
    executed = execute(garden, read(garden, "2: (dig beans)"), clock.set)
    next(executed)
    garden.abort(run)
    assert list(executed) == []
    assert not garden.holds("(wet roses)")


def test_overdue_runs_are_left_alone(garden: KnowledgeBase, clock: ManualClock):
    """O3: their end is not known; they are not part of the problem either."""
    garden.start("water", "roses", duration=seconds(10))
    clock.advance(seconds(11))
    assert "overdue by 1 s" in garden.to_pddl()
    assert [str(step) for step, _ in execute(garden, read(garden, "2: (dig beans)"), clock.set)] == [
        "2: apply (Dig beans)"
    ]
    assert len(garden.state().running) == 1


def test_a_plan_without_times_leaves_runs_alone(garden: KnowledgeBase, clock: ManualClock):
    """A plan without times has no time for ends; the caller ends runs."""
    garden.start("water", "roses", duration=seconds(10))
    dig = garden.to_problem().action("Dig")
    plan = SequentialPlan([dig(garden.to_problem().object("beans"))])
    assert [str(step) for step, _ in execute(garden, plan, clock.set)] == ["apply (Dig beans)"]
    assert len(garden.state().running) == 1


def test_execution_stops_if_somebody_else_ends_its_run(garden: KnowledgeBase, clock: ManualClock):
    """O3: the plan's own end is refused then."""
    executed = execute(garden, read(garden, "0: (water roses) [5]\n9: (dig beans)"), clock.set)
    _, run = next(executed)
    garden.abort(run)
    with pytest.raises(NotApplicable, match="does not run"):
        next(executed)


def test_a_plan_of_the_library_and_its_text_have_the_same_steps(garden: KnowledgeBase):
    """The exact fractions of the one are the decimals of the other."""
    problem = garden.to_problem()
    roses = problem.object("roses")
    plan = TimeTriggeredPlan([(Fraction(1, 2), problem.action("water")(roses), Fraction(9, 4))])
    text = "0.5: (water roses) [2.25]"
    assert steps(plan) == read(garden, text)
