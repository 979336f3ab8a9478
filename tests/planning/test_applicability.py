"""Whether an operator is applicable, and which conditions fail (rule O1)."""

import pytest

from kbstore.errors import InvalidKnowledge
from kbstore.messages import AssignOp, ComparisonType, Operator
from kbstore.model.formulas import Add, And, Comparison, Defined, Delete, Exists, ForEach, Not, Or, Same, When
from kbstore.planning import applicability as planning
from tests.planning.robots import (
    DURATION,
    END,
    OVER_ALL,
    START,
    action,
    atom,
    change,
    grounded,
    parameters,
    tokens,
    world,
)

ASSIGN, INCREASE, CONTINUOUS = AssignOp.ASSIGN, AssignOp.INCREASE, AssignOp.ASSIGN_CTS
MORE, LESS, EQUALS = ComparisonType.GREATEREQ, ComparisonType.LESSEQ, ComparisonType.EQUALS


def unsatisfied(*asked, **options):
    """The failing conditions, without their truth values."""
    return [condition for condition, _ in planning.unsatisfied(*asked, **options)]


def failing(*asked):
    return [condition for condition, _ in planning.failing(*asked)]


def test_conditions_that_hold_are_not_named():
    """O1: an operator is applicable where each at-start condition is true."""
    act = action("r:robot p:wp", conditions=[(START, And((atom("at ?r ?p"), Not(atom("docked ?r")))))])
    assert unsatisfied(grounded(act, "kenny", "wp0"), world(facts={"at kenny wp0": True})) == []


def test_each_condition_that_fails_is_named():
    """O1: the answer names each failing part, with objects, and no part that holds."""
    enough = Comparison(MORE, tokens("battery ?r"), (20.0,))
    act = action("r:robot p:wp", conditions=[(START, And((atom("at ?r ?p"), Not(atom("docked ?r")), enough)))])
    before = world(facts={"docked kenny": True, "at kenny wp0": True}, numbers={"battery kenny": 5})
    assert unsatisfied(grounded(act, "Kenny", "wp0"), before) == [
        Not(atom("docked Kenny")),
        Comparison(MORE, tokens("battery Kenny"), (20.0,)),
    ]


def test_unknown_is_not_applicable():
    """V3, V6: with `use_unknowns` a condition has to be true; an unknown one is not enough."""
    act = action("r:robot", conditions=[(START, Not(atom("docked ?r")))])
    assert unsatisfied(grounded(act, "kenny"), world(use_unknowns=True)) == [Not(atom("docked kenny"))]
    assert unsatisfied(grounded(act, "kenny"), world(facts={"docked kenny": False}, use_unknowns=True)) == []


def test_quantified_conditions_and_disjunctions_are_named_whole():
    """O1: anything but a conjunction is one condition."""
    some = Exists(parameters("p:wp"), atom("at ?r ?p"))
    either = Or((atom("door"), atom("docked ?r")))
    act = action("r:robot", conditions=[(START, And((some, either)))])
    assert unsatisfied(grounded(act, "rob"), world()) == [
        Exists(parameters("p:wp"), atom("at rob ?p")),
        Or((atom("door"), atom("docked rob"))),
    ]


def test_an_action_may_establish_its_own_invariant():
    """O1: over-all conditions are evaluated on the state after the at-start effects."""
    act = action(
        "r:robot p:wp",
        durative=True,
        conditions=[(START, atom("at ?r ?p")), (OVER_ALL, Not(atom("at ?r ?p"))), (OVER_ALL, atom("door"))],
        effects=[(START, Delete(atom("at ?r ?p"))), (START, Add(atom("door"))), (END, Add(atom("at ?r ?p")))],
    )
    assert unsatisfied(grounded(act, "kenny", "wp0"), world(facts={"at kenny wp0": True})) == []


def test_an_action_may_break_its_own_invariant():
    """O1: an over-all condition that the at-start effects make false fails, although it held before."""
    low = Comparison(LESS, tokens("x"), (5.0,))
    act = action(durative=True, conditions=[(OVER_ALL, low)], effects=[(START, change(INCREASE, "x", 3.0))])
    assert failing(grounded(act), OVER_ALL, world(numbers={"x": 3})) == []
    assert unsatisfied(grounded(act), world(numbers={"x": 3})) == [low]


def test_over_all_conditions_see_universal_and_conditional_effects():
    """O1, O2: they are evaluated after all of the at-start effects."""
    clean = Not(Exists(parameters("p:wp"), atom("seen ?p")))
    wipe = ForEach(parameters("p:wp"), (When(atom("seen ?p"), (Delete(atom("seen ?p")),)),))
    act = action(durative=True, conditions=[(OVER_ALL, clean)], effects=[(START, wipe)])
    assert unsatisfied(grounded(act), world(facts={"seen wp0": True, "seen depot": True})) == []


def test_at_end_conditions_are_not_asked_at_the_start():
    """O1, O3: at-end conditions belong to the end."""
    act = action(durative=True, conditions=[(END, atom("door"))])
    assert unsatisfied(grounded(act), world()) == []
    assert failing(grounded(act), END, world()) == [atom("door")]


def test_the_duration_is_known_to_conditions():
    """O3: ``?duration`` is the duration in seconds, given or fixed by the domain."""
    enough = Comparison(MORE, tokens("battery ?r"), (Operator.MUL, 2.0, DURATION))
    act = action("r:robot", conditions=[(START, enough)], durative=True)
    before = world(numbers={"battery kenny": 10, "x": 5})
    assert unsatisfied(grounded(act, "kenny"), before, duration=5.0) == []
    assert unsatisfied(grounded(act, "kenny"), before, duration=5.5) == [
        Comparison(MORE, tokens("battery kenny"), (Operator.MUL, 2.0, DURATION))
    ]
    fixed = action("r:robot", conditions=[(START, enough)], duration=[(EQUALS, tokens("x"))])
    assert unsatisfied(grounded(fixed, "kenny"), before) == []
    before.values[("x", ())] = before.values[("battery", ("kenny",))]
    assert len(unsatisfied(grounded(fixed, "kenny"), before)) == 1


@pytest.mark.parametrize(
    ("effect", "names"),
    [
        (change(ASSIGN, "x", "battery ?r"), ["battery kenny"]),
        (change(INCREASE, "y", 1.0), ["y"]),
        (change(INCREASE, "y", Operator.ADD, "battery ?r", "x"), ["battery kenny", "x", "y"]),
        (When(Not(atom("door")), (change(ASSIGN, "x", "y"),)), ["y"]),
        (When(atom("door"), (change(ASSIGN, "x", "y"),)), []),
        (ForEach(parameters("m:robot"), (change(INCREASE, "battery ?m", 1.0),)), ["battery kenny", "battery rob"]),
    ],
)
def test_undefined_numbers_of_effects_are_named(effect: object, names: list[str]):
    """O1, V5: an operator is not applicable if one of its effects needs an undefined function."""
    act = action("r:robot", effects=[(START, effect)])  # type: ignore[list-item]
    assert unsatisfied(grounded(act, "kenny"), world()) == [Defined(atom(name)) for name in names]


def test_an_undefined_number_does_not_hide_a_condition():
    """O1: each failing condition is named, beside undefined functions."""
    act = action("r:robot", conditions=[(START, atom("door"))], effects=[(START, change(INCREASE, "x", 1.0))])
    assert unsatisfied(grounded(act, "kenny"), world()) == [atom("door"), Defined(atom("x"))]


def test_undefined_numbers_of_continuous_effects_are_named():
    """O3: a rate is evaluated after the at-start effects, and moves a function that is defined by then."""
    effects = [(START, change(ASSIGN, "x", 0.0)), (OVER_ALL, change(CONTINUOUS, "x", "speed ?r"))]
    act = action("r:robot", effects=effects, durative=True)
    assert unsatisfied(grounded(act, "kenny"), world()) == [Defined(atom("speed kenny"))]
    assert unsatisfied(grounded(act, "kenny"), world(numbers={"speed kenny": 1})) == []
    moved = action("r:robot", effects=effects[1:], durative=True)
    assert unsatisfied(grounded(moved, "kenny"), world(numbers={"speed kenny": 1})) == [Defined(atom("x"))]


@pytest.mark.parametrize(
    ("effect", "divisor"),
    [
        (change(ASSIGN, "x", Operator.DIV, 1.0, "y"), tokens("y")),
        (
            change(ASSIGN, "x", Operator.ADD, 1.0, Operator.DIV, "y", Operator.SUB, "y", "y"),
            tokens(Operator.SUB, "y", "y"),
        ),
        (change(AssignOp.SCALE_DOWN, "x", Operator.MUL, 2.0, "y"), tokens(Operator.MUL, 2.0, "y")),
        (change(ASSIGN, "x", Operator.DIV, 1.0, Operator.DIV, 1.0, "y"), tokens("y")),
    ],
)
def test_zero_divisors_are_named(effect: object, divisor: tuple[object, ...]):
    """O1, V5: an operator is not applicable if one of its effects divides by zero; the divisor is named."""
    act = action(effects=[(START, effect)])  # type: ignore[list-item]
    expected = Not(Comparison(EQUALS, divisor, (0.0,)))  # type: ignore[arg-type]
    assert unsatisfied(grounded(act), world(numbers={"x": 1, "y": 0})) == [expected]


def test_an_invalid_fixed_duration_is_named():
    """O1, O3: a fixed duration that is undefined, divides by zero or is negative is among the failing conditions."""
    travel = tokens(Operator.DIV, "distance ?a ?b", "speed ?r")
    act = action("r:robot a:wp b:wp", duration=[(EQUALS, travel)])
    ground_action = grounded(act, "kenny", "wp0", "wp1")
    assert unsatisfied(ground_action, world()) == [
        Defined(atom("distance wp0 wp1")),
        Defined(atom("speed kenny")),
    ]
    still = world(numbers={"distance wp0 wp1": 3, "speed kenny": 0})
    assert unsatisfied(ground_action, still) == [Not(Comparison(EQUALS, tokens("speed kenny"), (0.0,)))]
    backwards = world(numbers={"distance wp0 wp1": 3, "speed kenny": -1})
    bound = tokens(Operator.DIV, "distance wp0 wp1", "speed kenny")
    assert unsatisfied(ground_action, backwards) == [Comparison(MORE, bound, (0.0,))]


def test_a_duration_that_is_missing_does_not_hide_conditions():
    """O1: where the duration is undefined, the failing conditions are named all the same."""
    long = Comparison(MORE, (DURATION,), (1.0,))
    act = action(duration=[(EQUALS, tokens("x"))], conditions=[(START, And((atom("door"), long)))])
    assert unsatisfied(grounded(act), world()) == [Defined(atom("x")), atom("door"), long]


def test_conflicting_effects_are_refused():
    """O2: where no condition fails, but the effects conflict, the action is refused, naming both effects."""
    act = action(effects=[(START, change(ASSIGN, "x", 1.0)), (START, change(ASSIGN, "x", 2.0))])
    with pytest.raises(InvalidKnowledge, match="conflict"):
        unsatisfied(grounded(act), world())


def test_a_failing_condition_comes_before_a_conflict():
    """O1: a failing condition is the answer, also where the effects would conflict."""
    different = Not(Same("?a", "?b"))
    swap = [(START, change(ASSIGN, "battery ?a", 1.0)), (START, change(ASSIGN, "battery ?b", 2.0))]
    act = action("a:robot b:robot", conditions=[(START, different)], effects=swap)
    assert unsatisfied(grounded(act, "kenny", "rob"), world()) == []
    assert unsatisfied(grounded(act, "kenny", "kenny"), world()) == [Not(Same("kenny", "kenny"))]


def test_a_deep_division_is_searched_once():
    """A zero divisor is found in an expression of any depth, in time linear in its length."""
    deep = tokens(*[part for _ in range(50_000) for part in (Operator.DIV, 1.0)], "x")
    act = action(effects=[(START, change(ASSIGN, "y", *deep))])
    assert unsatisfied(grounded(act), world(numbers={"x": 0})) == [Not(Comparison(EQUALS, tokens("x"), (0.0,)))]
