"""Where a watch begins."""

import kbstore


def test_a_watch_begins_when_it_is_called(kb):
    """Q6: what is told between the call and the first look is not missed."""
    watch = kb.watch(timeout=0.0)
    told = kb.add("(raining)")
    assert [change.number for change in watch] == [told.number]
    assert isinstance(told, kbstore.Transaction)
