"""Strategies of random transactions: a small world, in which updates often affect each other."""

from dataclasses import replace

from hypothesis import strategies as st

from tests.oracle import Comparison, Condition, Fact, Metric, Number, Object, RefDomain, Update
from tests.oracle.world import World

SECOND = 1_000_000_000

TYPES = {"place": "object", "room": "place", "robot": "object"}
ROOMS = RefDomain(
    "rooms",
    TYPES,
    {"home": "place"},
    {"lit": (), "open": (("place",),), "near": (("robot",), ("place",))},
    {"cost": (), "load": (("robot",),)},
)
DOMAINS = (
    ROOMS,
    replace(ROOMS, name="wider", predicates={**ROOMS.predicates, "dusty": (("place",),)}),
    replace(ROOMS, name="narrow", predicates={**ROOMS.predicates, "open": (("room",),)}),
    replace(ROOMS, name="dark", predicates={k: v for k, v in ROOMS.predicates.items() if k != "lit"}),
    replace(ROOMS, name="fixed", constants={"home": "place", "a": "place"}),
    replace(ROOMS, name="homeless", constants={}),
)


def weighted(*choices):
    """One of several strategies, each as often as its weight says (`one_of` counts equal ones once)."""
    strategies = [strategy for weight, strategy in choices for _ in range(weight)]
    return st.sampled_from(range(len(strategies))).flatmap(lambda place: strategies[place])


delays = st.sampled_from([0, 0, 0, 0, 1, 2, 3, 4, 6, 9, SECOND, -1])
ticks = st.sampled_from([0, 0, 1, 1, 2, 3, 5, 8, SECOND // 2, 2 * SECOND])
signs = st.booleans()

likely_objects = st.sampled_from([Object("a", "place"), Object("b", "room"), Object("r", "robot")])
odd_objects = st.sampled_from(
    [Object("a", "room"), Object("b", "robot"), Object("r", "place"), Object("home", "place"), Object("a", "dragon")]
)
objects = weighted((7, likely_objects), (1, odd_objects))
ends = objects.map(lambda item: replace(item, positive=False))

places = st.sampled_from([*["a", "b"] * 8, "home", "home", "r", "x"])
robots = st.sampled_from([*["r"] * 14, "a", "x"])
facts = st.one_of(
    st.builds(Fact, st.just("lit"), st.just(()), signs),
    st.builds(Fact, st.just("open"), st.tuples(places), signs),
    st.builds(Fact, st.just("open"), st.tuples(places), signs),
    st.builds(Fact, st.just("near"), st.tuples(robots, places), signs),
)
patterns = st.one_of(
    facts,
    st.builds(Fact, st.just("open"), st.just(("?",)), signs),
    st.builds(Fact, st.just("near"), st.tuples(robots, st.just("?")), signs),
    st.builds(Fact, st.just("near"), st.tuples(st.just("?"), places), signs),
    st.just(Number("load", ("?",))),
)
mistakes = st.sampled_from(
    [
        Fact("flying", ("a",)),
        Fact("lit", ("a",)),
        Fact("near", ("r",)),
        Number("speed", ("r",)),
        Number("cost", ("r",)),
        Comparison("(> (speed r) 1)", (("speed", ("r",)),)),
    ]
)

terms = st.one_of(st.just(("cost", ())), st.tuples(st.just("load"), st.tuples(robots)))
values = st.sampled_from([0.0, 1.0, 2.5, -3.0, 0.1])
rates = st.sampled_from([0.0, 0.0, 0.0, 2.0, -0.5])
operations = st.sampled_from(["increase", "decrease", "scale_up", "scale_down", "assign_cts"])
assignments = st.builds(lambda term, value, rate: Number(*term, value, rate), terms, values, rates)
relative_changes = st.builds(
    lambda term, value, operation: Number(*term, value, 0.0, operation), terms, values, operations
)
numbers = weighted((2, assignments), (1, relative_changes))

metrics = st.sampled_from(
    [
        Metric("minimize (cost)", (("cost", ()),)),
        Metric("maximize (cost)", (("cost", ()),)),
        Metric("minimize (load r)", (("load", ("r",)),)),
    ]
)
comparisons = st.builds(
    replace,
    st.sampled_from([Comparison("(> (cost) 1)", (("cost", ()),)), Comparison("(<= (load r) 3)", (("load", ("r",)),))]),
    positive=signs,
)
conditions = st.sampled_from(
    [
        Condition("(or (lit) (open a))", (Fact("lit"), Fact("open", ("a",)))),
        Condition("(imply (lit) (open b))", (Fact("lit"), Fact("open", ("b",)))),
    ]
)

additions = weighted((2, objects), (2, ends), (6, facts), (4, numbers), (1, comparisons))
goals = weighted((2, facts), (1, comparisons), (1, conditions))
removals = weighted(
    (1, objects), (1, likely_objects), (3, patterns), (1, terms.map(lambda term: Number(*term, 77.0))), (1, comparisons)
)
goal_patterns = patterns.filter(lambda item: isinstance(item, Fact))

writes = weighted(
    (8, st.tuples(st.just("add"), additions)),
    (3, st.tuples(st.just("remove"), removals)),
    (1, st.tuples(st.just("add_goal"), goals)),
    (1, st.tuples(st.just("remove_goal"), st.one_of(goals, goal_patterns))),
    (1, st.tuples(st.just("add_metric"), metrics)),
    (1, st.tuples(st.just("remove_metric"), st.one_of(metrics, st.just(Metric())))),
)
again = st.tuples(st.sampled_from(["cancel", "cancel", "reschedule", "end", "repeat"]), st.integers(0, 20))

steps = st.tuples(weighted((3, writes), (1, again)), delays)
"""A step is an update, and how far ahead it is; `again` repeats a scheduled or a current item."""

late_writes = weighted(
    (2, st.tuples(st.just("add"), weighted((3, likely_objects), (1, objects), (1, ends)))),
    (5, st.tuples(st.just("add"), facts)),
    (3, st.tuples(st.just("add"), assignments)),
    (2, st.tuples(st.just("remove"), removals)),
    (1, st.tuples(st.just("add_goal"), goals)),
    (1, st.tuples(st.just("remove_goal"), st.one_of(goals, goal_patterns))),
    (1, writes),
)
late_steps = st.tuples(
    st.tuples(weighted((4, late_writes), (1, again)), weighted((3, st.just(0)), (1, delays))),
    st.integers(0, 40),
    weighted((3, st.none()), (3, st.integers(1, 12))),
    weighted((12, st.none()), (1, st.sampled_from([(1, None), (0, 1), (-3, -3), (None, -2)]))),
)
"""A step with the past time at which it begins, the number of times until it ends, and wrong times."""

wrong_steps = st.tuples(st.tuples(st.sampled_from(["add", "remove"]), mistakes), delays)

ROLES = {"state": ("add", "remove"), "goal": ("add_goal", "remove_goal")}


WRONG_IN_A_STATE = Metric("minimize (cost)", (("cost", ()),))


def state_items(world: World, now: int) -> list[object]:
    """The current items without goals and metric; objects first."""
    items = []
    for line, assertion in world.current.items():
        item = assertion.item
        if isinstance(item, Number):
            item = replace(item, value=world.value(item, assertion.start, now))
        if line[0] == "state" and line[1] != "metric" and not (isinstance(item, Object) and not item.positive):
            items.append(item)
    return sorted(items, key=lambda item: not isinstance(item, Object))


def update(step, world: World, now: int) -> Update:
    """The update for a step, in a world that has been advanced to now."""
    (what, which), delay = step
    at = max(0, now + delay) if delay else 0
    if what in ("cancel", "reschedule"):
        choices = [(line, start, assertion.item) for (line, start), assertion in world.pending.items()]
        if not choices:
            return Update("remove", Fact("lit"), at)
        line, start, item = choices[which % len(choices)]
        return Update(_method(line, item, what == "reschedule"), item, start)
    if what in ("end", "repeat"):
        current = [(line, assertion.item) for line, assertion in world.current.items()]
        if not current:
            return Update("remove", Fact("lit"), at)
        line, item = current[which % len(current)]
        return Update(_method(line, item, what == "repeat"), item, at if what == "repeat" else 0)
    return Update(what, which, at)


def late_update(late_step, world: World, now: int) -> Update:
    """The update for a late step, in a world that has been advanced to now."""
    step, where, length, wrong = late_step
    found = update(step, world, now)
    if wrong is not None:
        since, until = (None if offset is None else max(0, now + offset) for offset in wrong)
        return replace(found, since=since, until=until)
    times = {each.start for each in world.assertions} | {each.end for each in world.assertions if each.end} | {now}
    moments = sorted({max(0, t + side) for t in times for side in (-1, 0, 1) if t + side <= now})
    place = where % len(moments)
    until = None if length is None else moments[min(place + length, len(moments) - 1)]
    return replace(found, at=0, since=moments[place], until=until)


def _method(line, item, adding):
    if isinstance(item, Metric):
        return "add_metric" if adding else "remove_metric"
    return ROLES[line[0]][0 if adding else 1]
