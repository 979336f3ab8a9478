"""Where a watch begins."""

import kbstore


def test_a_watch_begins_when_it_is_called(kb):
    """Q6: what is told between the call and the first look is not missed."""
    watch = kb.watch(timeout=0.0)
    told = kb.add("(raining)")
    assert [change.number for change in watch] == [told.number]
    assert isinstance(told, kbstore.Transaction)


def test_a_watched_pattern_does_not_match_goals(kb):
    """Q6: a goal of the same shape is not a change of the state."""
    watch = kb.watch("(open ?)", timeout=0.0)
    kb.add_goal("(open wp0)")
    told = kb.add("(open wp1)")
    assert [(change.number, [str(found.item) for found in change.asserted]) for change in watch] == [
        (told.number, ["(open wp1)"])
    ]
