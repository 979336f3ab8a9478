"""The latched start conditions of an action (rules O2 and O3)."""

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
    """The start conditions of (act kenny) that are true in a world."""
    act = grounded(action("r:robot", effects=[(END, effect) for effect in effects], durative=True), "Kenny")
    return set(remembered(act, END, world(facts=dict.fromkeys(facts, True)), duration=duration))


def test_conditions_that_are_true_are_remembered_as_text():
    """O3: as PDDL with objects for the action's parameters and names in lower case, which others may read."""
    effects = (
        WhenAtStart(Atom("Docked", ("?R",)), (DOOR,)),
        WhenAtStart(And((atom("docked ?r"), Not(atom("seen Depot")))), (DOOR,)),
        WhenAtStart(atom("seen wp0"), (DOOR,)),
    )
    assert known(*effects, facts=("docked kenny",)) == {"(docked kenny)", "(and (docked kenny) (not (seen depot)))"}


def test_conditions_at_other_times_are_not_remembered():
    """O3: nothing is latched for an action without such effects, nor for effects at another time."""
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
    """O3: those of the ``forall`` around it, not those of its own quantifiers or of an inner ``forall``."""
    near, somewhere = atom("near ?p ?q"), Exists(parameters("p:wp"), atom("near ?p ?q"))
    inner = ForEach(parameters("q:wp"), (WhenAtStart(near, (DOOR,)), WhenAtStart(somewhere, (DOOR,))))
    outer = ForEach(parameters("p:wp q:mover"), (When(atom("door"), (inner,)), WhenAtStart(atom("door"), (inner,))))
    assert known(outer, facts=("near wp0 wp1", "near depot wp1")) == {
        "(near wp0 wp1)",
        "(near depot wp1)",
        "(exists (?p - wp) (near ?p wp1))",
    }
    assert known(outer, facts=("door",)) == {"(door)"}


def test_variables_are_found_in_every_form_of_condition():
    """O3: in comparisons, in preferences, and nested."""
    far = Comparison(ComparisonType.GREATER, (atom("distance depot ?p"),), (DURATION,))
    effect = ForEach(parameters("p:wp"), (WhenAtStart(And((Preference("far", far), atom("seen ?p"))), (DOOR,)),))
    act = grounded(action("r:robot", effects=[(END, effect)], durative=True), "kenny")
    start = world(
        facts={"seen wp0": True, "seen wp1": True}, numbers={"distance depot wp0": 7, "distance depot wp1": 3}
    )
    found = remembered(act, END, start, duration=5)
    assert found == {"(and (preference far (> (distance depot wp0) ?duration)) (seen wp0))"}
    assert evaluate(act, END, world(), duration=5, remembered=found).adds == (atom("door"),)
