"""Questions over a span in which the domain changed."""

import pytest

import kbstore
from kbstore import ManualClock, seconds

OLD = "(define (domain d) (:predicates (raining) (windy)))"
NEW = "(define (domain d) (:predicates (windy)))"


@pytest.fixture
def changed(open_kb):
    """Under the first domain, rain from 10 s to 20 s; from 30 s on, a domain without rain."""
    clock = ManualClock(seconds(10))
    kb = open_kb(clock=clock)
    kb.load(OLD)
    kb.add("(raining)")
    clock.set(seconds(20))
    kb.remove("(raining)")
    clock.set(seconds(30))
    kb.load(NEW)
    return kb


def test_a_symbol_of_an_earlier_domain_can_be_asked_over_a_span(changed):
    """D4, Q4: it is known to a version in the span; where it is not known, it is absent."""
    assert changed.when("(raining)", seconds(10), seconds(40)) == [(seconds(10), seconds(20))]
    assert changed.when("(not (raining))", seconds(10), seconds(40)) == [(seconds(20), seconds(40))]
    assert len(changed.history("(raining)")) == 1


def test_a_symbol_that_no_version_in_the_span_knows_is_refused(changed):
    """D4: a symbol that no version has is refused, and so is one of another time."""
    with pytest.raises(kbstore.UnknownSymbol, match="snowing"):
        changed.when("(snowing)", seconds(10), seconds(40))
    with pytest.raises(kbstore.UnknownSymbol, match="raining"):
        changed.when("(raining)", seconds(30), seconds(40))
