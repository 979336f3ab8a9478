"""A knowledge base and the naive reference with running actions: given the same updates, and compared.

Values are compared to six decimals, as the order of adding the contributions of runs is not specified.
"""

from contextlib import suppress
from dataclasses import replace

import pytest

import kbstore
from tests.oracle import Reference, Refused, Start, Unsettled, Update
from tests.property import translation


def comparable(answer):
    """An answer without the details of moving functions that the rules leave open: initial time, rate, and rounding."""
    values = frozenset((replace(item, value=round(item.value, 6), rate=0.0), 0) for item, _ in answer.functions)
    return replace(answer, functions=values)


def received(state):
    """A state of kbstore with its runs."""
    running = frozenset((run.operator, run.arguments, run.started, run.duration) for run in state.running)
    return comparable(replace(translation.answer(state), running=running))


class ActingAgreement:
    """One knowledge base and its reference, given the same updates.

    Args:
        kb: the knowledge base, empty.
        clock: its clock.
        domain, actions: loaded first.
        sensed: the names of sensed symbols.
    """

    def __init__(self, kb, clock, domain, actions, *, sensed=frozenset()):
        self.kb = kb
        self.clock = clock
        self.reference = Reference(kb.use_unknowns)
        self.runs = {}
        self.transactions = []
        with kb.transaction() as tx:
            tx.load(translation.pddl(domain, actions))
            for name in sensed:
                tx.set_sensed(name, True)
        self.reference.write(clock.now(), [Update("domain", replace(domain, sensed=sensed))])

    @property
    def now(self):
        return self.reference.now(self.clock.now())

    def write(self, update):
        """Make one update in both; they refuse the same, and are compared afterwards."""
        try:
            changes = self.reference.write(self.clock.now(), [update])
        except Unsettled:
            return
        except Refused as refusal:
            self.refused(update, refusal.error)
            with pytest.raises(getattr(kbstore, refusal.error)):
                self._perform(update)
        else:
            self._perform(update)
            if changes:
                last = self.reference.latest.number
                self.transactions.append(next(iter(self.kb.changes(after=last - 1))).transaction)
        self.compare(self.now)

    def refused(self, update, error):
        """Check more about an update that is going to be refused."""

    def _perform(self, update):
        item = update.item
        if isinstance(item, Start) and update.what == "start":
            self.runs[item] = self.kb.start(item.action.name, *item.arguments, duration=item.duration, force=item.force)
        elif isinstance(item, Start):
            getattr(self.kb, update.what)(self.runs[item])
        elif update.what == "clear":
            self.kb.clear()
        elif update.since is not None:
            getattr(self.kb, update.what)(translation.sent(item), since=update.since, until=update.until)
        else:
            getattr(self.kb, update.what)(translation.sent(item), initial_time=update.at)

    def compare_states(self, times, step):
        """Compare the states at times as known now, and some of them, by a step, as of several transactions."""
        for at in times:
            self.compare(at)
        for index, transaction in enumerate(self.transactions[:: max(1, len(self.transactions) // 3)]):
            for at in times[index % step :: step]:
                self.compare(at, as_of=transaction.time)
                self.compare(at, as_of=transaction)

    def compare(self, at, as_of=None):
        # results that the rules leave open (two expected changes at one time) are not compared
        with suppress(Unsettled):
            if as_of is None:
                expected = self.reference.state(at, clock=self.clock.now())
            elif isinstance(as_of, kbstore.Transaction):
                expected = self.reference.state(at, number=as_of.number)
            else:
                expected = self.reference.state(at, as_of=as_of)
            assert received(self.kb.state(at, as_of)) == comparable(expected), (at, as_of)
