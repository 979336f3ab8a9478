"""Random stories with late knowledge in kbstore and in the naive reference (rules L1 to L9).

At the end of a story every state is compared as of the time of every event, one nanosecond around, and as of every
transaction; and beliefs read during the story are read again at its end.
"""

from hypothesis import given
from hypothesis import strategies as st

from kbstore import Truth
from tests.oracle import Fact
from tests.property import translation, universe
from tests.property.test_model import SETTINGS, Agreement
from tests.property.universe import weighted


class LateAgreement(Agreement):
    """One knowledge base and its reference, given the same updates, some of them late."""

    def __init__(self, open_kb, *, reopens):
        super().__init__(open_kb, reopens=reopens)
        self.believed = {}

    def update(self, tick, steps):
        """Make several updates in one transaction, each for now, or late."""
        self.clock.advance(tick)
        updates = [self._late(step) if late else self._resolved([step[0]])[0] for step, late in steps]
        self._write(updates, "transaction" if len(updates) > 1 else "one")

    def _late(self, step):
        world = self.reference.world()
        world.advance(self._now())
        return universe.late_update(step, world, self._now())

    def _write_both(self, updates, how):
        super()._write_both(updates, how)
        number = self.reference.latest.number
        if number in self.transactions and number not in self.believed:
            times = self._times()[:: 1 + number % 3]
            belief = self.transactions[number]
            self.believed[number] = [(t, translation.answer(self.kb.state(t, belief))) for t in times]

    def _compare_state(self, at, **belief):
        self.seen.clear()
        super()._compare_state(at, **belief)

    def _compare_everything(self):
        times = self._times()
        for at in times:
            self._compare_state(at)
        moments = sorted({t for event in self.reference.events for t in (event.time - 1, event.time, event.time + 1)})
        for as_of in moments:
            for at in times:
                self._compare_state(at, as_of=as_of)
        for number, transaction in self.transactions.items():
            for at in times[number % 3 :: 3]:
                self._compare_state(at, as_of=transaction)
            for at, answer in self.believed.get(number, ()):
                assert translation.answer(self.kb.state(at, transaction)) == answer, (number, at)
        self._compare_histories()
        self._compare_beliefs(times)
        for change, expected in zip(self.kb.changes(), self.reference.changes(), strict=True):
            assert translation.change(change) == expected
        for first, second in zip(times[::4], times[2::3], strict=False):
            assert translation.difference(self.kb.diff(first, second)) == self.reference.diff(first, second)

    def _compare_beliefs(self, times):
        """L4: when each truth of one time began to be believed, by the truth as of each transaction."""
        facts = sorted(
            {assertion.item for assertion in self._assertions() if isinstance(assertion.item, Fact)}, key=str
        )
        moments = sorted({event.time for event in self.reference.events})
        for at in times[::9]:
            for fact in facts[::2]:
                if self._cannot_be_meant(fact, at):
                    continue
                expected = []
                for moment in sorted({*moments, *({at} if moments[0] < at <= self._now() else set())}):
                    truth = self._truth(fact, self.reference.state(at, as_of=moment))
                    if not expected or expected[-1][2] is not truth:
                        expected[-1:] = [(expected[-1][0], moment, expected[-1][2])] if expected else []
                        expected.append((moment, None, truth))
                assert self.kb.beliefs(translation.sent(fact), at) == expected, (fact, at)

    def _truth(self, fact, answer):
        """The truth value of a fact in an answer of the reference (rules V2, V3)."""
        signs = [
            item.positive
            for item, _ in answer.facts
            if isinstance(item, Fact) and item.name == fact.name and item.arguments == fact.arguments
        ]
        if signs:
            return Truth.of(signs[0] == fact.positive)
        return Truth.UNKNOWN if self.use_unknowns else Truth.of(not fact.positive)


steps = st.tuples(universe.late_steps, weighted((2, st.just(True)), (1, st.just(False))))
stories = st.lists(
    st.tuples(
        universe.ticks,
        weighted((4, st.lists(steps, min_size=1, max_size=1)), (1, st.lists(steps, min_size=2, max_size=4))),
    ),
    min_size=6,
    max_size=14,
)


def test_random_late_knowledge_agrees_with_the_reference(open_kb, store_url):
    """L1 to L9, T5, Q1 to Q3, Q6: on every operation, and about every pair of times."""

    @SETTINGS
    @given(use_unknowns=st.booleans(), with_domain=st.sampled_from([True, True, False]), story=stories)
    def agree(use_unknowns, with_domain, story):
        both = LateAgreement(open_kb, reopens=store_url != "sqlite://")
        try:
            both.begin(use_unknowns, with_domain, furnished=True)
            for tick, steps in story:
                both.update(tick, steps)
        finally:
            both.teardown()

    agree()
