"""The reference's actions, on scenarios worked out by hand from the rules O5 to O8."""

import pytest

from tests.oracle import Fact, Flow, Limit, Number, RefAction, RefDomain, Reference, Refused, Start, Update

DOMAIN = RefDomain("tank", predicates={"open": (), "calm": ()}, functions={"level": (), "inflow": ()})
FILL = RefAction("fill", (), flows=(Flow(("level", ()), factors=((2.0, ("inflow", ())),)),))
S = 1_000_000_000
OPEN, SHUT, CALM = Fact("open"), Fact("open", positive=False), Fact("calm")


def number(name, value, rate=0.0):
    return Number(name, (), value, rate)


def add(item, at=0, **span):
    return Update("add", item, at * S, **span)


def start(action, lasts, force=False):
    return Update("start", Start(action, (), lasts * S, force))


def reference(sensed=()):
    """A level of 0 and an inflow of 1 from 1 s on."""
    kb = Reference()
    kb.write(1 * S, [Update("domain", RefDomain("tank", {}, {}, DOMAIN.predicates, DOMAIN.functions, sensed))])
    kb.write(1 * S, [add(number("level", 0.0)), add(number("inflow", 1.0))])
    return kb


def levels(kb, *times, clock=0, **belief):
    states = (kb.state(t * S, clock=clock * S, **belief) for t in times)
    return [sum(item.value for item, _ in state.functions if item.name == "level") for state in states]


def test_a_rate_follows_what_it_reads():
    """O5: 2 a second from 2 s, 6 a second from 4 s, nothing from 6 s as scheduled; known as of 3 s, 2 a second."""
    kb = reference()
    kb.write(2 * S, [start(FILL, 20)])
    kb.write(3 * S, [add(number("inflow", 0.0), 6)])
    kb.write(4 * S, [add(number("inflow", 3.0))])
    assert levels(kb, 2, 3, 4, 5, 6, 9) == [0, 2, 4, 10, 16, 16]
    assert levels(kb, 5, 9, as_of=3 * S) == [6, 8]


def test_without_a_rate_a_number_is_undefined_until_it_is_set():
    """O5: a value that is set does not move, until the rate is defined again."""
    kb = reference()
    kb.write(2 * S, [start(FILL, 20)])
    kb.write(3 * S, [Update("remove", number("inflow", 0.0))])
    assert not any(item.name == "level" for item, _ in kb.state(3 * S).functions)
    kb.write(4 * S, [add(number("level", 5.0))])
    kb.write(6 * S, [add(number("inflow", 1.0))])
    assert levels(kb, 2, 5, 6, 7) == [0, 5, 5, 7]


def test_a_moving_number_is_not_read():
    """O5: added, scheduled, or started."""
    kb = reference()
    kb.write(2 * S, [start(FILL, 20)])
    for wrong in (add(number("inflow", 1.0, 1.0)), add(number("inflow", 1.0, 1.0), 9)):
        with pytest.raises(Refused, match="NotLinear"):
            kb.write(3 * S, [wrong])
    with pytest.raises(Refused, match="NotLinear"):
        kb.write(3 * S, [start(RefAction("grow", (), flows=(Flow(("inflow", ()), 0.0),)), 1)])


def test_past_rates_are_not_computed_again():
    """L6, L7: a late level moves at 2 a second; a late inflow counts from now on."""
    kb = reference()
    kb.write(2 * S, [start(FILL, 20)])
    kb.write(5 * S, [add(number("level", 10.0), since=3 * S)])
    assert levels(kb, 2, 3, 5) == [0, 10, 14]
    kb.write(6 * S, [add(number("inflow", 4.0), since=4 * S)])
    assert levels(kb, 5, 6, 7) == [14, 16, 24]


def test_an_invariant_that_is_expected_to_break():
    """O6: the level is 6 at 5 s; with force it starts, and the break is on record from the nanosecond after."""
    kb = reference()
    fill = RefAction("fill", (), invariants=(Limit("level", (), "<=", 6.0), SHUT), flows=FILL.flows)
    with pytest.raises(Refused, match="NotApplicable"):
        kb.write(2 * S, [start(fill, 4)])
    kb.write(2 * S, [start(fill, 3)])
    kb.write(3 * S, [Update("abort", Start(fill, (), 3 * S))])
    kb.write(4 * S, [start(fill, 9, force=True)])
    kb.write(8 * S, [add(OPEN)])
    run = kb.world().runs[-1]
    assert run.forced == {fill.invariants[0]}
    truths = [(kb.world().truth(wanted, t, run)) for wanted in fill.invariants for t in (6 * S, 6 * S + 1, 8 * S)]
    assert truths == [True, False, False, True, True, False]


def test_effects_on_sensed_symbols_are_expected_and_not_written():
    """O8: the start counts for its invariant until the next assertion; the level moves only in forecasts."""
    kb = reference(frozenset({"open", "level"}))
    fill = RefAction("fill", (), invariants=(OPEN,), at_start=(OPEN,), at_end=(SHUT,), flows=FILL.flows)
    kb.write(2 * S, [start(fill, 5)])
    run = kb.world().runs[-1]
    assert not kb.state(2 * S).facts
    assert levels(kb, 2, 4, 7, 9, clock=2) == [0, 4, 10, 10]
    assert levels(kb, 2, 4, 7, 9, clock=4) == [0, 0, 6, 6]
    kb.write(5 * S, [add(SHUT)])
    assert [kb.world().truth(OPEN, t * S, run) for t in (2, 4, 5)] == [True, True, False]


def test_an_end_that_changes_an_undefined_number_is_refused():
    """O3: nothing of it happens, and with the number defined again it ends."""
    kb = reference()
    widen = RefAction("widen", (), numbers_at_end=(Number("level", (), 2.0, operation="increase"),))
    kb.write(2 * S, [start(widen, 9)])
    kb.write(3 * S, [Update("remove", number("level", 0.0))])
    with pytest.raises(Refused, match="NotApplicable"):
        kb.write(4 * S, [Update("end", Start(widen, (), 9 * S))])
    kb.write(5 * S, [add(number("level", 3.0))])
    kb.write(6 * S, [Update("end", Start(widen, (), 9 * S))])
    assert levels(kb, 5, 6) == [3, 5]
