"""Past states, which are cached after the first question."""

import random

import kbstore
from kbstore.clock import seconds
from tests.conftest import DOMAIN, OBJECTS, START

LONGER = DOMAIN.replace("(raining)", "(raining) (foggy)")


def content(state):
    """All content of a state, in its order."""
    return (
        state.at,
        *map(str, (state.instances, state.facts, state.functions, state.goals, state.metric, state.inequalities)),
        [(item.initial_time, str(item)) for item in state.timed_knowledge],
        str(state.running),
        sorted(state.domain.predicate_signatures),
        state.to_pddl(),
    )


def write_something(kb, clock, chance):
    """One more transaction at a random later time."""
    clock.advance(chance.choice((0, 1, seconds(1), seconds(2))))
    sign = chance.choice(("(open wp0)", "(not (open wp0))", "(open wp1)", "(raining)"))
    match chance.randrange(7):
        case 0:
            kb.add(sign, initial_time=clock.now() + seconds(chance.choice((1, 3))))
        case 1:
            kb.remove("(open ?)")
        case 2:
            kb.add_goal(sign)
        case 3:
            kb.load(chance.choice((DOMAIN, LONGER)))
        case 4:
            kb.remove("wp1")
            kb.add("wp1 - place")
        case _:
            kb.add(sign)


def test_a_settled_state_stays_as_it_was(tmp_path):
    """T5: a past state stays the same, and equals that of a reader without caches."""
    chance = random.Random(5)
    clock = kbstore.ManualClock(START)
    store = tmp_path / "store.db"
    first = {}
    with kbstore.open(store, clock=clock) as kb, kbstore.open(store, clock=clock, cache=False) as forgetful:
        kb.load(DOMAIN)
        kb.add(*OBJECTS)
        for _ in range(60):
            write_something(kb, clock, chance)
            latest = kb.add("(raining)").time
            for t in [*chance.sample(sorted(first), min(3, len(first))), START + chance.randrange(latest - START + 1)]:
                found = content(kb.state(at=t))
                assert found == content(forgetful.state(at=t))
                if t < latest:
                    assert first.setdefault(t, found) == found


def test_changing_a_returned_list_does_not_change_the_state(kb, clock):
    """Each caller gets lists of its own."""
    kb.add("(open wp0)")
    kb.add_goal("(open wp1)")
    then = clock.now()
    clock.advance(1)
    kb.add("(raining)")
    before = content(kb.state(at=then))
    state = kb.state(at=then)
    for items in (state.facts, state.instances, state.goals, state.timed_knowledge, state.running):
        items.clear()
    assert content(kb.state(at=then)) == before


def test_the_state_at_the_latest_time_is_not_settled(kb, clock):
    """A later write at the time of the latest transaction changes the state at that time."""
    now = kb.add("(open wp0)").time
    assert not kb.holds("(open wp1)", at=now)
    assert not kb.state(at=now).holds("(open wp1)")
    assert kb.add("(open wp1)").time == now == clock.now()
    assert kb.state(at=now).holds("(open wp1)")


def test_a_cached_state_is_not_read_again(tmp_path):
    """Asking for the same past time again reads no assertions."""
    clock = kbstore.ManualClock(START)
    with kbstore.open(tmp_path / "store.db", clock=clock) as kb:
        then = kb.add("(open door)").time
        clock.advance(1)
        kb.add("(raining)")
        first = kb.state(at=then).snapshot
        assert kb.state(at=then).snapshot is first
        assert kb.state().snapshot is not kb.state().snapshot
