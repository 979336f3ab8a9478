"""The changes that an operator makes at one time (rules O2 and O3)."""

import pytest

from kbstore.errors import DivisionByZero, InvalidKnowledge, UndefinedFunction
from kbstore.evaluation.interpretation import Number
from kbstore.messages import AssignOp, ComparisonType, Operator
from kbstore.model.formulas import Add, Comparison, Delete, Effect, Exists, ForEach, Not, When
from kbstore.planning.effects import Effects, NumericChange, Rate, StateAfter, evaluate, resulting
from tests.evaluation.interpretations import World
from tests.planning.robots import (
    DURATION,
    END,
    OBJECTS,
    OVER_ALL,
    START,
    action,
    atom,
    change,
    grounded,
    parameters,
    robots,
    tokens,
    world,
)

ASSIGN, INCREASE, DECREASE = AssignOp.ASSIGN, AssignOp.INCREASE, AssignOp.DECREASE
SCALE_UP, SCALE_DOWN, CONTINUOUS = AssignOp.SCALE_UP, AssignOp.SCALE_DOWN, AssignOp.ASSIGN_CTS


def at_start(*effects: Effect) -> list[tuple[object, Effect]]:
    return [(START, effect) for effect in effects]


def after(before: World, *effects: Effect) -> StateAfter:
    """The world after effects without parameters."""
    act = action(effects=at_start(*effects))
    return StateAfter(before, evaluate(grounded(act), START, before))


def value(interpretation: StateAfter, function: str) -> float | None:
    name, *arguments = function.split()
    number = interpretation.number(name, tuple(arguments))
    return None if number is None else number.at(interpretation.time)


def test_a_swap_reads_the_values_before():
    """O2: every right-hand side is evaluated on the state before, so that x := y, y := x swaps."""
    swapped = after(world(numbers={"x": 1, "y": 2}), change(ASSIGN, "x", "y"), change(ASSIGN, "y", "x"))
    assert (value(swapped, "x"), value(swapped, "y")) == (2, 1)


def test_an_increase_does_not_see_an_assignment():
    """O2: ``(assign (x) 10) (increase (y) (x))`` adds the value that x had before."""
    found = after(world(numbers={"x": 1, "y": 5}), change(ASSIGN, "x", 10.0), change(INCREASE, "y", "x"))
    assert (value(found, "x"), value(found, "y")) == (10, 6)


def test_deletes_come_before_adds():
    """O2: an atom that is both deleted and added is added, in any order of the effects."""
    for effects in ([Add(atom("door")), Delete(atom("door"))], [Delete(atom("door")), Add(atom("DOOR"))]):
        assert after(world(), *effects).sign("door", ()) is True
        assert evaluate(grounded(action(effects=at_start(*effects))), START, world()) == Effects(adds=(atom("door"),))


def test_a_delete_removes_in_a_closed_world():
    """O2: in a closed world a deleted fact is absent afterwards; an explicit falsehood is not touched (C4)."""
    before = world(facts={"door": True, "docked kenny": False})
    found = after(before, Delete(atom("door")), Delete(atom("docked kenny")), Delete(atom("docked rob")))
    assert found.sign("door", ()) is None
    assert found.sign("docked", ("kenny",)) is False
    assert found.sign("docked", ("rob",)) is None
    assert list(found.facts("door")) == []


def test_a_delete_makes_explicitly_false_with_use_unknowns():
    """O2: with `use_unknowns` a deleted fact is explicitly false, whether or not it was asserted before."""
    before = world(facts={"docked kenny": True}, use_unknowns=True)
    found = after(before, Delete(atom("docked kenny")), Delete(atom("docked rob")))
    assert found.sign("docked", ("kenny",)) is False
    assert found.sign("docked", ("rob",)) is False
    assert dict(found.facts("docked")) == {("kenny",): False, ("rob",): False}


def test_the_world_after_keeps_what_is_not_changed():
    """O2: facts, numbers, objects and types that no effect mentions are as before."""
    before = world(facts={"seen wp0": True, "seen wp1": True}, numbers={"battery kenny": 50, "x": 1})
    found = after(before, Delete(atom("seen wp0")), Add(atom("seen depot")), change(ASSIGN, "x", 3.0))
    assert dict(found.facts("seen")) == {("wp1",): True, ("depot",): True}
    assert value(found, "battery kenny") == 50
    assert set(found.objects(["mover"])) == {"kenny", "rob", "t1"}
    assert found.type_of("wp0") == "wp"
    assert (found.time, found.domain, found.use_unknowns) == (0, before.domain, False)
    assert (before.sign("seen", ("wp0",)), before.number("x", ())) == (True, Number(1))


def test_conditional_effects_are_decided_on_the_state_before():
    """O2: each ``when`` is evaluated on the state before, so that a toggle toggles once."""
    toggle = (
        When(atom("door"), (Delete(atom("door")),)),
        When(Not(atom("door")), (Add(atom("door")),)),
    )
    assert after(world(facts={"door": True}), *toggle).sign("door", ()) is None
    assert after(world(), *toggle).sign("door", ()) is True


def test_a_condition_that_is_unknown_triggers_nothing():
    """V5, V6: a ``when`` takes place where its condition is true; unknown is not true."""
    full = Comparison(ComparisonType.GREATER, tokens("battery kenny"), (50.0,))
    effect = When(full, (Add(atom("door")),))
    assert after(world(), effect).sign("door", ()) is None
    assert after(world(), When(Not(full), (Add(atom("door")),))).sign("door", ()) is None
    open_world = world(use_unknowns=True)
    assert after(open_world, When(Not(atom("seen wp0")), (Add(atom("door")),))).sign("door", ()) is None


def test_universal_effects_reach_every_object_of_the_type():
    """O2, V4: ``forall`` ranges over the objects of the type and its subtypes, constants included."""
    everywhere = ForEach(parameters("p:wp"), (Add(atom("seen ?p")),))
    assert {arguments for arguments, _ in after(world(), everywhere).facts("seen")} == {("wp0",), ("wp1",), ("depot",)}
    movers = ForEach(parameters("m:mover"), (change(ASSIGN, "battery ?m", 9.0),))
    charged = after(world(), movers)
    assert [value(charged, f"battery {m}") for m in ("kenny", "rob", "t1")] == [9, 9, 9]


def test_effects_nest():
    """O2: ``forall`` and ``when`` nest; an inner variable hides an outer one of the same name."""
    effect = ForEach(
        parameters("p:wp q:wp"),
        (
            When(
                atom("path ?p ?q"),
                (Add(atom("near ?p ?q")), ForEach(parameters("q:mover"), (Delete(atom("at ?q ?p")),))),
            ),
        ),
    )
    before = world(facts={"path wp0 wp1": True, "at kenny wp0": True, "at rob wp1": True})
    found = after(before, effect)
    assert dict(found.facts("near")) == {("wp0", "wp1"): True}
    assert dict(found.facts("at")) == {("rob", "wp1"): True}


def test_a_condition_of_an_effect_may_quantify():
    """O2: the condition of an effect is any condition."""
    reached = When(Exists(parameters("m:mover"), atom("at ?m ?p")), (Add(atom("seen ?p")),))
    found = after(world(facts={"at t1 wp1": True}), ForEach(parameters("p:wp"), (reached,)))
    assert dict(found.facts("seen")) == {("wp1",): True}


def test_parameters_and_constants_take_their_places():
    """O2, D3: parameters are replaced by objects, constants stay as they are, in any case."""
    act = action("r:robot p:wp", effects=at_start(Delete(atom("at ?R ?p")), Add(atom("AT ?r Depot"))))
    found = evaluate(grounded(act, "Kenny", "WP0"), START, world())
    assert found == Effects(deletes=(atom("at kenny wp0"),), adds=(atom("at kenny depot"),))


def test_each_moment_has_its_own_effects():
    """O3: at-start and at-end effects are apart; ``?duration`` is the value in seconds."""
    drain = change(DECREASE, "battery ?r", Operator.MUL, 2.0, DURATION)
    act = action("r:robot", effects=[(START, Delete(atom("docked ?r"))), (END, drain)], durative=True)
    before = world(numbers={"battery kenny": 80})
    assert evaluate(grounded(act, "kenny"), START, before) == Effects(deletes=(atom("docked kenny"),))
    at_end = evaluate(grounded(act, "kenny"), END, before, duration=7.5)
    assert at_end == Effects(changes=(NumericChange(atom("battery kenny"), DECREASE, 15.0),))


@pytest.mark.parametrize(
    ("effects", "expected"),
    [
        ([change(INCREASE, "x", 3.0), change(DECREASE, "x", 1.0), change(INCREASE, "x", 0.5)], 12.5),
        ([change(SCALE_UP, "x", 3.0), change(SCALE_DOWN, "x", 4.0)], 7.5),
        ([change(ASSIGN, "x", 3.0), change(ASSIGN, "x", Operator.ADD, 1.0, 2.0)], 3),
        ([change(INCREASE, "x", "x"), change(INCREASE, "x", "x")], 30),
        ([change(SCALE_DOWN, "x", 4.0)], 2.5),
        ([change(DECREASE, "x", "y")], 6),
    ],
)
def test_changes_of_one_function_combine(effects: list[Effect], expected: float):
    """O2, C7: increases and decreases add up, scalings multiply, equal assignments are one (x is 10, y is 4)."""
    assert value(after(world(numbers={"x": 10, "y": 4}), *effects), "x") == expected


@pytest.mark.parametrize(
    "effects",
    [
        [change(ASSIGN, "x", 3.0), change(ASSIGN, "x", 4.0)],
        [change(ASSIGN, "x", 3.0), change(INCREASE, "x", 3.0)],
        [change(SCALE_UP, "x", 3.0), change(DECREASE, "x", 3.0)],
        [change(SCALE_DOWN, "x", 3.0), change(ASSIGN, "x", 3.0)],
    ],
)
def test_changes_whose_order_matters_conflict(effects: list[Effect]):
    """O2: simultaneous effects have no order, so they are refused; the error names both."""
    act = action(effects=at_start(*effects))
    with pytest.raises(InvalidKnowledge, match="conflict") as caught:
        evaluate(grounded(act), START, world(numbers={"x": 1}))
    for effect in effects:
        assert isinstance(effect, type(change(ASSIGN, "x")))
        assert f"({effect.operation.pddl} (x) {effect.value[0]:g})" in str(caught.value)


def test_conflicts_are_found_between_objects_not_parameters():
    """O2: two effects on two parameters conflict only where both are the same object."""
    act = action(
        "a:robot b:robot", effects=at_start(change(ASSIGN, "battery ?a", 1.0), change(ASSIGN, "battery ?b", 2.0))
    )
    evaluate(grounded(act, "kenny", "rob"), START, world())
    with pytest.raises(InvalidKnowledge, match=r"\(act kenny kenny\)"):
        evaluate(grounded(act, "kenny", "kenny"), START, world())


def test_undefined_functions_are_errors():
    """V5, C7: an undefined right-hand side, and a relative change of an undefined function, are errors."""
    for effect in (change(ASSIGN, "x", "y"), change(INCREASE, "y", 1.0), change(SCALE_UP, "y", 2.0)):
        with pytest.raises(UndefinedFunction, match=r"\(y\)"):
            after(world(numbers={"x": 1}), effect)
    assert value(after(world(), change(ASSIGN, "y", 1.0)), "y") == 1


def test_division_by_zero_is_an_error():
    """V5, C7: dividing by zero, in an expression or by ``scale-down``, is an error."""
    for effect in (change(ASSIGN, "x", Operator.DIV, 1.0, "y"), change(SCALE_DOWN, "x", "y")):
        with pytest.raises(DivisionByZero):
            after(world(numbers={"x": 1, "y": 0}), effect)


def test_numbers_that_overflow_are_refused():
    """C7: a function has finite values and rates only."""
    huge = world(numbers={"x": 1e308, "y": 2.0})
    with pytest.raises(InvalidKnowledge, match=r"\(x\)"):
        after(huge, change(SCALE_UP, "x", 10.0))
    act = action(effects=[(OVER_ALL, change(CONTINUOUS, "y", "x")), (OVER_ALL, change(CONTINUOUS, "y", "x"))])
    with pytest.raises(InvalidKnowledge, match=r"\(y\)"):
        evaluate(grounded(act), OVER_ALL, huge)


def test_continuous_effects_are_rates():
    """O3: continuous effects are evaluated to rates per second; those on one function add up."""
    act = action(
        "r:robot",
        effects=[
            (OVER_ALL, change(CONTINUOUS, "battery ?r", Operator.UMINUS, "speed ?r")),
            (OVER_ALL, change(CONTINUOUS, "battery ?r", 0.5)),
            (OVER_ALL, change(CONTINUOUS, "x", Operator.DIV, 1.0, DURATION)),
        ],
        durative=True,
    )
    before = world(numbers={"speed kenny": 2, "battery kenny": 50, "x": 0})
    found = evaluate(grounded(act, "kenny"), OVER_ALL, before, duration=4.0)
    assert found == Effects(rates=(Rate(atom("battery kenny"), -1.5), Rate(atom("x"), 0.25)))
    assert evaluate(grounded(act, "kenny"), START, before, duration=4.0) == Effects()


@pytest.mark.parametrize(
    ("timing", "effect"),
    [(START, change(CONTINUOUS, "x", 1.0)), (OVER_ALL, change(INCREASE, "x", 1.0)), (OVER_ALL, Add(atom("door")))],
)
def test_only_continuous_effects_last(timing: object, effect: Effect):
    """O3: continuous effects, and no others, belong to the whole of an action; anything else is refused."""
    act = action(effects=[(timing, effect)], durative=True)  # type: ignore[list-item]
    with pytest.raises(InvalidKnowledge, match="cannot be there"):
        evaluate(grounded(act), timing, world(numbers={"x": 1}))  # type: ignore[arg-type]


def test_moving_values_are_read_at_their_value_at_t():
    """C7: a function with a rate is read at its value at t."""
    domain = robots()
    before = World(
        domain, time=12_000_000_000, objects=OBJECTS, numbers={"x": Number(10.0, 0.5, 2_000_000_000), "y": 0}
    )
    found = after(before, change(ASSIGN, "y", "x"), change(INCREASE, "x", 1.0))
    assert (value(found, "y"), value(found, "x")) == (15, 16)


def test_an_unbound_variable_is_refused():
    """D1: the arguments of an effect must be objects."""
    with pytest.raises(InvalidKnowledge, match=r"\?lost"):
        after(world(), Add(atom("docked ?lost")))


def test_resulting_values_do_not_depend_on_each_other():
    """O2: the values after are computed from the values before."""
    before = {atom("x"): 1.0, atom("y"): 10.0}
    changes = [NumericChange(atom("x"), ASSIGN, 5.0), NumericChange(atom("y"), SCALE_DOWN, 4.0)]
    assert resulting(changes, before.get) == {atom("x"): 5.0, atom("y"): 2.5}


def test_effects_of_any_depth_are_evaluated():
    """Effects nested 100,000 deep stay below the recursion limit."""
    deep: Effect = Add(atom("door"))
    for _ in range(100_000):
        deep = When(atom("seen wp0"), (deep,))
    assert after(world(facts={"seen wp0": True}), deep).sign("door", ()) is True
