"""Archives of random histories: scheduled, cancelled and ended items, objects, goals, metric, domains and runs."""

import pytest

import kbstore
from kbstore import HistoryUnavailable, ManualClock, seconds
from tests.transfer.random_histories import START, answers, live, picture, reasons

STEPS = 32


def lived(open_kb, seed, until=None, *, late=False):
    """A knowledge base after random transactions, or after those before a time; and its clock."""
    clock = ManualClock(START)
    kb = open_kb(clock=clock)
    for t in live(kb, clock, seed, STEPS, late=late):
        if until is not None and t >= until:
            break
    return kb, clock


def middle(kb):
    """Times about a third and two thirds through a story, at or between transactions."""
    changes = list(kb.changes())
    return changes[len(changes) // 3].time, changes[2 * len(changes) // 3].time + seconds(1) // 2


@pytest.mark.parametrize(("seed", "late"), [(0, False), (1, False), (0, True), (1, True), (2, True)])
def test_an_archive_answers_as_the_store_did(open_kb, archive_path, seed, late):
    """Q7, L8: an archive answers as the store would have without the transactions from that time on."""
    kb, _ = lived(open_kb, seed, late=late)
    for before in middle(kb):
        kb.archive(before, archive_path)
        stopped, clock = lived(open_kb, seed, until=before, late=late)
        clock.set(before - 1)
        with kbstore.open(archive_path, kb.name) as archive:
            assert archive.now() == before - 1
            assert answers(archive, 0, before - 1, expected=False) == answers(stopped, 0, before - 1, expected=False)
            assert reasons(archive, before - 1) == reasons(stopped, before - 1)
            assert picture(archive.state()) == picture(stopped.state())
            with pytest.raises(HistoryUnavailable, match="ends at"):
                archive.state(at=before)


@pytest.mark.parametrize(("seed", "late"), [(4, False), (5, False), (4, True), (5, True), (6, True)])
def test_the_store_answers_as_before(open_kb, archive_path, seed, late):
    """Q7: questions that need no archived history get the same answers after archiving, now and about the future."""
    kb, _ = lived(open_kb, seed, late=late)
    record = [(change.number, change.time) for change in kb.changes()]
    latest = record[-1][1]
    for before in (*middle(kb), latest):
        last = max(number for number, t in record if t < before)
        expected = answers(kb, before, latest, last)
        why = {t: reasons(kb, t) for t in (before, latest)}
        kb.archive(before, archive_path)
        assert kb.history_from == before
        assert answers(kb, before, latest, last) == expected
        for t, known in why.items():
            found = reasons(kb, t)
            assert found == {atom: found[atom] if found[atom] == "archived" else known[atom] for atom in known}
        with pytest.raises(HistoryUnavailable, match="archived"):
            kb.state(at=before - 1)
    assert kb.add("new - robot", "(= (battery new) 3)").number == record[-1][0] + 1
