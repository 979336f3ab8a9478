"""What an action remembers of its start (rules O2 and O3)."""

from kbstore.messages import AssignOp, ComparisonType
from kbstore.model.formulas import (
    Add,
    And,
    Atom,
    Comparison,
    Delete,
    Effect,
    Exists,
    ForEach,
    Not,
    Preference,
    When,
    WhenAtStart,
)
from kbstore.planning.effects import Effects, Rate, evaluate
from kbstore.planning.start_conditions import NOTHING, remembered
from tests.planning.robots import DURATION, END, OVER_ALL, START, action, atom, change, grounded, parameters, world

DOOR = Add(atom("door"))


def known(*effects: Effect, facts: tuple[str, ...] = (), duration: float | None = None) -> set[str]:
    """What (act kenny) remembers of a world for effects at its end."""
    act = grounded(action("r:robot", effects=[(END, effect) for effect in effects], durative=True), "Kenny")
    return set(remembered(act, END, world(facts=dict.fromkeys(facts, True)), duration=duration))


def test_conditions_that_are_true_are_remembered_as_text():
    """O3: PDDL with objects for the action's parameters and names in lower case, as others may read it."""
    effects = (
        WhenAtStart(Atom("Docked", ("?R",)), (DOOR,)),
        WhenAtStart(And((atom("docked ?r"), Not(atom("seen Depot")))), (DOOR,)),
        WhenAtStart(atom("seen wp0"), (DOOR,)),
    )
    assert known(*effects, facts=("docked kenny",)) == {"(docked kenny)", "(and (docked kenny) (not (seen depot)))"}


def test_conditions_of_other_moments_are_not():
    """O3: nothing is kept of an action without such effects, nor for effects of another moment."""
    assert known(When(atom("door"), (Delete(atom("door")),)), DOOR, facts=("door",)) == set()
    effects = [
        (START, When(atom("door"), (DOOR,))),
        (OVER_ALL, WhenAtStart(atom("docked ?r"), (change(AssignOp.ASSIGN_CTS, "x", 2.0),))),
        (END, WhenAtStart(atom("door"), (DOOR,))),
    ]
    act = grounded(action("r:robot", effects=effects, durative=True), "kenny")
    start = world(facts={"door": True, "docked kenny": True}, numbers={"x": 0})
    assert remembered(act, END, start) == {"(door)"}
    assert remembered(act, OVER_ALL, start) == {"(docked kenny)"}
    assert remembered(act, START, start) == NOTHING
    assert evaluate(act, OVER_ALL, world(), remembered=frozenset({"(docked kenny)"})).rates == (Rate(atom("x"), 2.0),)
    assert evaluate(act, OVER_ALL, start).rates == ()
    assert evaluate(act, END, world(), remembered=frozenset({"(door)"})) == Effects(adds=(atom("door"),))
    assert evaluate(act, END, start) == Effects()


def test_only_variables_that_a_condition_mentions_are_replaced():
    """O3: of the ``forall`` around it, and not those that a quantifier of its own or an inner ``forall`` binds."""
    near, somewhere = atom("near ?p ?q"), Exists(parameters("p:wp"), atom("near ?p ?q"))
    inner = ForEach(parameters("q:wp"), (WhenAtStart(near, (DOOR,)), WhenAtStart(somewhere, (DOOR,))))
    outer = ForEach(parameters("p:wp q:mover"), (When(atom("door"), (inner,)), WhenAtStart(atom("door"), (inner,))))
    assert known(outer, facts=("near wp0 wp1", "near depot wp1")) == {
        "(near wp0 wp1)",
        "(near depot wp1)",
        "(exists (?p - wp) (near ?p wp1))",
    }
    assert known(outer, facts=("door",)) == {"(door)"}


def test_every_form_of_condition_mentions_its_variables():
    """O3: in comparisons, in preferences, and below one another."""
    far = Comparison(ComparisonType.GREATER, (atom("distance depot ?p"),), (DURATION,))
    effect = ForEach(parameters("p:wp"), (WhenAtStart(And((Preference("far", far), atom("seen ?p"))), (DOOR,)),))
    act = grounded(action("r:robot", effects=[(END, effect)], durative=True), "kenny")
    start = world(
        facts={"seen wp0": True, "seen wp1": True}, numbers={"distance depot wp0": 7, "distance depot wp1": 3}
    )
    found = remembered(act, END, start, duration=5)
    assert found == {"(and (preference far (> (distance depot wp0) ?duration)) (seen wp0))"}
    assert evaluate(act, END, world(), duration=5, remembered=found).adds == (atom("door"),)
