"""Random transactions in kbstore and in the naive reference: both give the same answers about every time.

Usually some sequences of transactions are tried on each store, the same on each run, and a failure is shown as it was
found. KBSTORE_TEST_EXAMPLES asks for more: new ones on each run, and a failure is made as short as possible, which
takes minutes.
"""

import os
from itertools import pairwise

import pytest
from hypothesis import HealthCheck, Phase, settings
from hypothesis import strategies as st
from hypothesis.stateful import (
    RuleBasedStateMachine,
    initialize,
    precondition,
    rule,
    run_state_machine_as_test,
)

import kbstore
from kbstore import Truth, UpdateType
from tests.oracle import Condition, Fact, Number, Object, Reference, Refused, Unsettled, Update
from tests.oracle.memory import TOLERANCE, Event, answer
from tests.property import translation, universe

START = 10
EXAMPLES = int(os.environ.get("KBSTORE_TEST_EXAMPLES", "0"))

SETTINGS = settings(
    max_examples=EXAMPLES or 25,
    stateful_step_count=12,
    deadline=None,
    derandomize=not EXAMPLES,
    database=None,
    report_multiple_bugs=False,
    phases=[Phase.generate, Phase.shrink] if EXAMPLES else [Phase.generate],
    suppress_health_check=list(HealthCheck),
)

UPDATE_TYPES = {
    "add": UpdateType.ADD_KNOWLEDGE,
    "remove": UpdateType.REMOVE_KNOWLEDGE,
    "add_goal": UpdateType.ADD_GOAL,
    "remove_goal": UpdateType.REMOVE_GOAL,
    "add_metric": UpdateType.ADD_METRIC,
    "remove_metric": UpdateType.REMOVE_METRIC,
}


class Agreement(RuleBasedStateMachine):
    """One knowledge base and its reference, given the same updates."""

    def __init__(self, open_kb, *, reopens):
        super().__init__()
        self.open_kb = open_kb
        self.reopens = reopens
        self.reference = Reference()
        self.clock = kbstore.ManualClock(START)
        self.kb = None
        self.transactions = {}
        self.seen = {}
        self.next_number = 1
        self.sound = True

    # -- beginning and end ------------------------------------------------------------------------------------

    @initialize(
        use_unknowns=st.booleans(), with_domain=st.sampled_from([True, True, True, False]), furnished=st.booleans()
    )
    def begin(self, use_unknowns, with_domain, furnished):
        self.use_unknowns = use_unknowns
        self.kb = self.open_kb(clock=self.clock, use_unknowns=use_unknowns)
        self.name = self.kb.name
        if with_domain:
            self._load(universe.ROOMS)
        if furnished:
            furniture = (Object("a", "place"), Object("b", "room"), Object("r", "robot"))
            self._write([Update("add", item) for item in furniture], "update")

    def teardown(self):
        if self.kb is None:
            return
        try:
            if self.sound:
                self._compare_everything()
        finally:
            self.kb.close()

    # -- writing ----------------------------------------------------------------------------------------------

    @rule(tick=universe.ticks, step=universe.steps)
    def one_update(self, tick, step):
        self.clock.advance(tick)
        self._write(self._resolved([step]), "one")

    @rule(
        tick=universe.ticks,
        steps=st.lists(universe.steps, min_size=2, max_size=5),
        how=st.sampled_from(["update", "transaction"]),
    )
    def several_updates(self, tick, steps, how):
        self.clock.advance(tick)
        self._write(self._resolved(steps), how)

    @rule(tick=universe.ticks, step=universe.steps, following=st.lists(universe.steps, max_size=2), first=st.booleans())
    def clear(self, tick, step, following, first):
        self.clock.advance(tick)
        updates = self._resolved([step, *following])
        self._write(
            [Update("clear"), *updates] if first else [updates[0], Update("clear"), *updates[1:]], "transaction"
        )

    @rule(
        tick=universe.ticks,
        kept=st.sets(st.integers(0, 9)),
        added=st.lists(universe.additions, max_size=3),
        wrong=st.sampled_from([(), (), (), (universe.WRONG_IN_A_STATE,)]),
    )
    def replace_the_state(self, tick, kept, added, wrong):
        self.clock.advance(tick)
        world = self.reference.world()
        world.advance(self._now())
        current = universe.state_items(world, self._now())
        items = [item for place, item in enumerate(current) if place in kept]
        self._write([Update("replace", items=(*items, *added, *wrong))], "replace")

    @rule(tick=universe.ticks, domain=st.sampled_from(universe.DOMAINS))
    def load_a_domain(self, tick, domain):
        self.clock.advance(tick)
        self._load(domain)

    @precondition(lambda self: self.reference.world().domain)
    @rule(tick=universe.ticks, step=universe.steps, wrong=universe.wrong_steps, last=st.booleans())
    def a_mistake(self, tick, step, wrong, last):
        self.clock.advance(tick)
        self._write(self._resolved([step, wrong] if last else [wrong, step]), "update")

    @rule(behind=st.sampled_from([1, 2, TOLERANCE, TOLERANCE + 1, 10 * TOLERANCE]), step=universe.steps)
    def write_with_a_clock_that_is_behind(self, behind, step):
        true_time = self.clock.now()
        latest = self.reference.latest.time
        self.clock.set(max(0, latest - behind))
        try:
            assert self.kb.now() == latest
            updates = self._resolved([step])
            if latest - self.clock.now() <= TOLERANCE or not self._invalid(updates):
                self._write(updates, "one")
        finally:
            self.clock.set(true_time)

    @precondition(lambda self: self.reopens)
    @rule()
    def close_and_open_again(self):
        self.kb.close()
        self.kb = self.open_kb(self.name, clock=self.clock)

    # -- asking -----------------------------------------------------------------------------------------------

    @rule(fact=universe.facts, ahead=st.integers(-6, 6))
    def ask_about_a_fact(self, fact, ahead):
        at = max(0, self._now() + ahead)
        if not self._known(fact, at):
            return
        if self._cannot_be_meant(fact, at):
            with pytest.raises(kbstore.InvalidKnowledge, match=r" is an? "):
                self.kb.truth(translation.sent(fact), at=at)
            return
        sign = self.reference.sign(fact, at)
        absent = Truth.UNKNOWN if self.use_unknowns else Truth.FALSE
        expected = absent if sign is None else Truth.of(sign == fact.positive)
        if sign is None and not fact.positive:
            expected = ~absent
        item = translation.sent(fact)
        assert self.kb.truth(item, at=at) is expected
        assert self.kb.holds(item, at=at) is (expected is Truth.TRUE)
        assert self.kb.query(item, at=at).all_true is (expected is Truth.TRUE)
        explanation = self.kb.explain(f"({' '.join([fact.name, *fact.arguments])})", at=at)
        given = (explanation.reason, explanation.transaction.number if explanation.transaction else None)
        assert given == self.reference.reason(fact, at)

    @rule(number=universe.assignments, ahead=st.integers(-6, 6))
    def ask_about_a_number(self, number, ahead):
        at = max(0, self._now() + ahead)
        if not self._known(number, at):
            return
        if self._cannot_be_meant(number, at):
            with pytest.raises(kbstore.InvalidKnowledge, match=r" is an? "):
                self.kb.value(translation.sent(number), at=at)
            return
        found = [
            item.value
            for item, _ in self.reference.state(at).functions
            if (item.name, item.arguments) == (number.name, number.arguments)
        ]
        term = f"({' '.join([number.name, *number.arguments])})"
        if found:
            assert self.kb.value(term, at=at) == found[0]
        else:
            with pytest.raises(kbstore.UndefinedFunction):
                self.kb.value(term, at=at)

    @rule(data=st.data())
    def ask_for_a_state(self, data):
        at = data.draw(st.sampled_from(self._times()), "at")
        self._compare_state(at)
        self._compare_state(at, as_of=data.draw(st.sampled_from(self._times()), "as of"))

    @rule(data=st.data())
    def ask_for_a_difference(self, data):
        first, second = (data.draw(st.sampled_from(self._times())) for _ in range(2))
        expected = self.reference.diff(first, second)
        assert translation.difference(self.kb.diff(first, second)) == expected

    # -- how it is done ---------------------------------------------------------------------------------------

    def _now(self):
        return self.reference.now(self.clock.now())

    def _resolved(self, steps):
        world = self.reference.world()
        world.advance(self._now())
        return [universe.update(step, world, self._now()) for step in steps]

    def _invalid(self, updates):
        """Whether a transaction has another error than the clock's, in which case either may be raised."""
        try:
            overlay = self.reference.tried(Event(0, self._now(), tuple(updates)))
        except Unsettled:
            return True
        return bool(overlay.violations or overlay.failures)

    def _known(self, item, at):
        domain = self.reference.world(at).domain
        symbols = {} if domain is None else {**domain.predicates, **domain.functions}
        return domain is None or item.name in symbols

    def _cannot_be_meant(self, item, at):
        """V10: whether an argument is a constant, or exists, and is of a type that its parameter excludes."""
        domain = self.reference.world(at).domain
        if domain is None:
            return False
        types = {found.name: found.type for found, _ in self.reference.state(at).instances} | domain.constants
        signature = {**domain.predicates, **domain.functions}[item.name]
        return any(
            name in types and not any(domain.is_a(types[name], wanted) for wanted in allowed)
            for name, allowed in zip(item.arguments, signature, strict=True)
        )

    def _write(self, updates, how):
        self.sound = False
        self._write_both(updates, how)
        self.sound = True

    def _write_both(self, updates, how):
        if any(isinstance(update.item, Condition) for update in updates):
            how = "transaction"  # a condition is text, and takes its time from the call
        self.next_number = self.reference.latest.number + 1
        try:
            changes = self.reference.write(self.clock.now(), updates)
        except Unsettled:
            return
        except Refused as refusal:
            # in a transaction of several calls, the first invalid call raises at once
            with pytest.raises(getattr(kbstore, refusal.first if how == "transaction" else refusal.error)):
                self._perform(updates, how)
            assert translation.answer(self.kb.state(self._now())) == self.reference.state(self._now())
            return
        transaction = self._perform(updates, how)
        latest = self.reference.latest
        assert (transaction.number, transaction.changes) == (latest.number, changes)
        if changes:
            assert transaction.time == latest.time
            self.transactions[latest.number] = transaction
        self._compare_state(self._now())

    def _perform(self, updates, how):
        if how == "replace":
            return self.kb.replace(*map(translation.sent, updates[0].items))
        items = [None if update.item is None else translation.sent(update.item) for update in updates]
        if how == "one":
            (update,) = updates
            return _update(self.kb, update, items[0])
        timed = [
            item if isinstance(item, str) or not update.at else item.model_copy(update={"initial_time": update.at})
            for item, update in zip(items, updates, strict=True)
        ]
        if how == "update":
            return self.kb.update([(UPDATE_TYPES[u.what], item) for u, item in zip(updates, timed, strict=True)])
        with self.kb.transaction() as tx:
            for done, (update, item) in enumerate(zip(updates, items, strict=True), 1):
                if update.what == "clear":
                    tx.clear()
                else:
                    _update(tx, update, item)
                self._compare_own_writes(tx, updates[:done])
        return tx.result

    def _compare_own_writes(self, tx, updates):
        """Inside a transaction its own writes are seen, as long as none of them is invalid."""
        past = self.reference.before(self.next_number)
        now = past.now(self.clock.now())
        overlay = past.tried(Event(past.latest.number + 1, now, tuple(updates)))
        if overlay.violations or overlay.failures:
            return
        overlay.finish(past.latest.number + 1)
        assert translation.answer(tx.state()) == answer(overlay.world, now)

    def _load(self, domain):
        before = self.reference.latest
        try:
            self.reference.write(self.clock.now(), [Update("domain", domain)])
        except Unsettled:
            return
        except Refused as refusal:
            with pytest.raises(getattr(kbstore, refusal.error)):
                self.kb.load(translation.pddl(domain))
            return
        transaction = self.kb.load(translation.pddl(domain))
        assert transaction.number == self.reference.latest.number
        if self.reference.latest is not before:
            self.transactions[transaction.number] = transaction
        self._compare_state(self._now())

    # -- comparing --------------------------------------------------------------------------------------------

    def _compare_state(self, at, **belief):
        given = translation.answer(self.kb.state(at, **belief))
        as_of = belief.get("as_of")
        if isinstance(as_of, kbstore.Transaction):
            assert given == self.reference.state(at, number=as_of.number)
        elif as_of is not None:
            assert given == self.reference.state(at, as_of=as_of)
        else:
            assert given == self.reference.state(at)
            if at < self.reference.latest.time:
                assert self.seen.setdefault(at, given) == given, f"the past changed: the state at {at}"

    def _times(self):
        """The time of every event, one nanosecond to each side, and between."""
        moments = {START, self._now(), self._now() + 1}
        for _, start, end, *_ in self.reference.history():
            moments |= {start, start if end is None else end}
        moments |= {event.time for event in self.reference.events}
        ordered = sorted(moments)
        between = [(first + second) // 2 for first, second in pairwise(ordered)]
        return sorted({max(0, t + side) for t in ordered for side in (-1, 0, 1)} | {*between, ordered[-1] + 1000})

    def _compare_everything(self):
        times = self._times()
        for at in times:
            self._compare_state(at)
        for index, event in enumerate(self.reference.events):
            for at in times[index % 3 :: 3]:
                if at >= event.time:
                    self._compare_state(at, as_of=event.time)
            if event.number in self.transactions:
                for at in times[(index + 1) % 3 :: 3]:
                    self._compare_state(at, as_of=self.transactions[event.number])
        self._compare_histories()
        assert [translation.change(change) for change in self.kb.changes()] == self.reference.changes()
        for first, second in zip(times[::4], times[2::3], strict=False):
            assert translation.difference(self.kb.diff(first, second)) == self.reference.diff(first, second)

    def _compare_histories(self):
        """Compare the history of each fact, function, object, inequality and the metric that was ever asserted."""
        roles = {assertion.timeline: [] for assertion in self._assertions()}
        for assertion, expected in zip(self._assertions(), self.reference.history(), strict=True):
            roles[assertion.timeline].append(expected)
        for line, rows in roles.items():
            item = rows[0][0]
            if line[0] == "state" and (not isinstance(item, Fact | Number) or self._known(item, self._now())):
                given = [translation.row(assertion) for assertion in self.kb.history(translation.pattern(item))]
                assert given == rows, line

    def _assertions(self):
        world = self.reference.world()
        world.advance(2**63 - 1)
        return sorted(world.assertions, key=lambda assertion: (assertion.start, assertion.recorded))


def _update(writer, update, item):
    """Make an update by the method of a knowledge base or of a transaction."""
    if update.since is None and update.until is None:
        return getattr(writer, update.what)(item, initial_time=update.at)
    method = getattr(writer, update.what.removesuffix("_metric"))
    return method(item, initial_time=update.at, since=update.since, until=update.until)


def test_the_store_and_the_reference_agree(open_kb, store_url):
    """T1-T5, V1, V2, V7, C1-C12, D1-D4, Q1-Q3, Q5, Q6: on every operation, and about every time."""
    reopens = store_url != "sqlite://"
    run_state_machine_as_test(lambda: Agreement(open_kb, reopens=reopens), settings=SETTINGS)
