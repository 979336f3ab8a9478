"""Archiving, on a story worked out by hand: what is moved, what stays, what is refused."""

import re
import sqlite3

import pytest

import kbstore
from kbstore import (
    Archived,
    Conflict,
    HistoryUnavailable,
    InvalidKnowledge,
    InvalidTime,
    ManualClock,
    NotApplicable,
    StoreUnavailable,
    Truth,
    seconds,
)
from tests.conftest import DOMAIN, OBJECTS
from tests.transfer import random_histories


def at(n):
    """The n-th second of the story."""
    return seconds(1000 + n)


@pytest.fixture
def kb(open_kb, clock):
    """A story of 50 seconds: transaction 1 is the domain, 2 the objects, and then one every ten seconds.

    The hall is open from 10 to 20 and from 40 on; it rains from 10 on; the battery is at 80 from 10, at 70 from 30 on;
    the galley is open from 20, and at 30 it is scheduled to be closed at 60. The last transaction is at 50.
    """
    kb = open_kb()
    kb.load(DOMAIN)
    kb.add(*OBJECTS)
    clock.set(at(10))
    kb.add("(open hall)", "(raining)", "(= (battery kenny) 80)", client="scout")  # 3
    clock.set(at(20))
    kb.update([(2, "(open hall)"), (0, "(open galley)")], client="scout")  # 4
    clock.set(at(30))
    with kb.transaction(client="planner") as tx:  # 5
        tx.add("(= (battery kenny) 70)")
        tx.add("(not (open galley))", initial_time=at(60))
        tx.add("(near kenny wp0)", initial_time=at(45))
    clock.set(at(40))
    with kb.transaction() as tx:  # 6
        tx.add("(open hall)")
        tx.remove("(near kenny wp0)", initial_time=at(45))
    clock.set(at(50))
    kb.add("(clean hall)")  # 7
    return kb


@pytest.fixture
def archived(kb, archive_path):
    """The same, with everything before the 35th second in the archive."""
    assert kb.archive(at(35), archive_path) == Archived(archive_path, at(35), 2)
    return kb


@pytest.fixture
def archive(archived, archive_path):
    """The archive of it."""
    with kbstore.open(archive_path, archived.name) as kb:
        yield kb


def texts(items):
    return sorted(map(str, items))


def spans(history):
    return [(str(found.item), found.initial_time, found.end_time) for found in history]


def answered(kb, questions, refusal):
    """The questions that are answered where they should be refused."""
    found = []
    for name, question in questions.items():
        try:
            question(kb)
        except HistoryUnavailable as error:
            if re.search(refusal, str(error)):
                continue
        found.append(name)
    return found


# -- the store afterwards -----------------------------------------------------------------------------------------


def test_current_assertions_are_kept_with_their_initial_times(archived):
    """Q7, Q1: assertions that began before, and hold at that time or later, are kept whole, with their transactions."""
    assert archived.history_from == at(35)
    state = archived.state(at=at(35))
    assert texts(state.facts) == ["(open galley)", "(raining)"]
    assert [(item.initial_time, item.function_value) for item in state.functions] == [(at(30), 70.0)]
    assert len(state.instances) == len(OBJECTS)
    assert [(str(item), item.initial_time) for item in state.timed_knowledge] == [
        ("(near kenny wp0)", at(45)),
        ("(not (open galley))", at(60)),
    ]
    explained = archived.explain("(raining)", at=at(35))
    assert (explained.since, explained.transaction.number, explained.transaction.client) == (at(10), 3, "scout")
    assert archived.value("(battery kenny)", at=at(36)) == 70
    assert archived.domain.name == "rooms"


def test_overlapping_assertions_are_listed_whole(archived):
    """Q3: a row that began before and ended later is listed with its true beginning; cancelled ones are, too."""
    (raining,) = archived.history("(raining)", since=at(35))
    assert (raining.initial_time, raining.recorded.number) == (at(10), 3)
    (near,) = archived.history("(near ? ?)", since=at(35))
    assert (near.initial_time, near.recorded.number, near.cancelled.number) == (at(45), 5, 6)
    assert spans(archived.history("(open ?)", since=at(35))) == [
        ("(open galley)", at(20), at(60)),
        ("(open hall)", at(40), None),
        ("(not (open galley))", at(60), None),
    ]
    assert archived.when("(open galley)", at(35), at(70)) == [(at(35), at(60))]


QUESTIONS = {
    "state": lambda kb: kb.state(at=at(35) - 1),
    "a belief about the past": lambda kb: kb.state(at=at(20), as_of=at(40)),
    "a past belief": lambda kb: kb.state(at=at(40), as_of=at(34)),
    "the belief of a transaction": lambda kb: kb.state(as_of=kbstore.Transaction(4, at(20))),
    "holds": lambda kb: kb.holds("(raining)", at=at(34)),
    "a condition": lambda kb: kb.holds("(or (raining) (open hall))", at=at(34)),
    "value": lambda kb: kb.value("(battery kenny)", at=at(34)),
    "an expression": lambda kb: kb.value("(+ (battery kenny) 1)", at=at(34)),
    "explain": lambda kb: kb.explain("(raining)", at=at(34)),
    "query": lambda kb: kb.query("(raining)", at=at(34)),
    "instances": lambda kb: kb.instances(at=at(34)),
    "applicable": lambda kb: kb.applicable("drive", "kenny", at=at(34)),
    "history": lambda kb: kb.history("(raining)"),
    "history from before": lambda kb: kb.history("(raining)", since=at(34)),
    "when": lambda kb: kb.when("(raining)", at(34), at(40)),
    "diff": lambda kb: kb.diff(at(34), at(40)),
    "all changes": lambda kb: list(kb.changes()),
    # its transaction is kept, as (raining) still refers to it, but not all of its changes
    "changes after one that is archived in part": lambda kb: list(kb.changes(after=2)),
    "changes after one that is archived": lambda kb: list(kb.changes(after=4)),
    "watch": lambda kb: list(kb.watch(after=3, timeout=0)),
    # changes by the clock after transaction 5, at 30, might lie before 35
    "watch what came by the clock": lambda kb: list(kb.watch(after=5, timeout=0)),
    "the problem": lambda kb: kb.to_pddl(at=at(34)),
}


def test_questions_about_archived_history_are_refused(archived):
    """Q7: any question that needs archived history is HistoryUnavailable, with the time from which history is kept."""
    assert answered(archived, QUESTIONS, r"from 1970-01-01T00:17:15Z on.*ask the archive") == []


def test_the_reason_of_an_absent_fact_may_be_archived(archived):
    """V6, Q7: the reason "never told" is refused for a fact that has archived assertions, and given for others."""
    with pytest.raises(HistoryUnavailable, match=r"\(open hall\)"):
        archived.explain("(open hall)", at=at(36))
    assert archived.explain("(open wp1)", at=at(36)).reason == "never told"
    assert archived.explain("(open hall)", at=at(40)).transaction.number == 6


def test_an_operator_whose_condition_failed_before(open_kb, clock, archive_path):
    """O1, Q7: failing conditions are named, also where the time since when is archived; nothing is started."""
    kb = open_kb()
    kb.load(random_histories.DOMAIN.replace("(at start (not (busy ?r)))", "(at start (lit))"))
    kb.add("a - place", "r - robot", "(lit)", "(= (cost) 0)", "(= (battery r) 50)")
    clock.set(at(10))
    kb.remove("(lit)")
    clock.set(at(20))
    kb.add("(open a)")
    for since in (at(10), None):
        applicability = kb.applicable("work", "r", "a")
        assert [(failing.condition, failing.since) for failing in applicability.failing] == [("(lit)", since)]
        with pytest.raises(NotApplicable, match=r"\(lit\) is false"):
            kb.start("work", "r", "a", duration=seconds(1))
        kb.archive(at(20), archive_path)


def test_changes_go_on_after_the_archive(archived):
    """Q6, Q7: changes after the last archived transaction are all there, for a follower that is up to date."""
    changes = list(archived.changes(after=5))
    assert [change.number for change in changes] == [6, 7]
    assert [str(found.item) for found in changes[0].asserted] == ["(open hall)"]
    assert [str(found.item) for found in changes[0].cancelled] == ["(near kenny wp0)"]
    assert [change.number for change in archived.watch(after=changes[0], timeout=0)] == [7]


def test_a_watch_continues_through_archiving(kb, clock, archive_path):
    """Q6: a follower that is up to date before archiving misses nothing, nor changes by the clock."""
    *_, seen = kb.changes()
    kb.archive(at(50), archive_path)
    clock.set(at(61))
    kb.add("(open wp1)")
    assert [
        (change.time, texts(found.item for found in change.asserted)) for change in kb.watch(after=seen, timeout=0)
    ] == [
        (at(60), ["(not (open galley))"]),
        (at(61), ["(open wp1)"]),
    ]


def test_beliefs_since_the_archived_time_are_unchanged(archived):
    """Q2: beliefs as of that time or later, about later times, are as they were."""
    assert texts(archived.state(at=at(45), as_of=at(35)).facts) == ["(near kenny wp0)", "(open galley)", "(raining)"]
    assert texts(archived.state(at=at(45), as_of=at(41)).facts) == ["(open galley)", "(open hall)", "(raining)"]


def test_the_archived_time_itself_is_kept(kb, archive_path):
    """Q7: an assertion that ended at exactly the archived time is still there, with its transaction."""
    kb.archive(at(20), archive_path)
    (fourth,) = (change for change in kb.changes(after=3) if change.number == 4)
    assert [str(found.item) for found in fourth.ended] == ["(open hall)"]
    assert kb.truth("(open hall)", at=at(20)) is Truth.FALSE
    assert kb.explain("(open hall)", at=at(20)).transaction.number == 4
    assert texts(item for item in kb.history("(open hall)", since=at(20))) == [
        "(open hall) [1970-01-01T00:17:20Z, )",
    ]


def test_runs_at_the_archived_time_itself_are_kept(open_kb, clock, archive_path):
    """Q2, O3, Q7: the belief as of that very time, before an action ended, is still known."""
    kb = open_kb()
    kb.load(random_histories.DOMAIN)
    kb.add("a - place", "r - robot", "(= (cost) 0)", "(= (battery r) 50)")
    clock.set(at(10))
    kb.end(kb.start("work", "r", "a", duration=seconds(5)))
    clock.set(at(11))
    second = kb.start("work", "r", "a", duration=seconds(30))
    clock.set(at(20))
    added = kb.add("(lit)")
    kb.end(second)
    kb.archive(at(20), archive_path)
    assert kb.state(as_of=added).running == [second]
    assert kb.state(at=at(20)).running == []
    with kbstore.open(archive_path, kb.name) as archive:
        assert archive.state().running == [second]
        assert archive.value("(cost)", at=at(16)) == 10
        assert len(archive.history("(busy r)")) == 2


def test_the_start_conditions_of_a_run_are_kept(open_kb, clock, archive_path):
    """O3, Q7: in the store where the run continues, and in the archive, where its end is expected."""
    kb = open_kb()
    kb.load(random_histories.DOMAIN)
    kb.add("a - place", "r - robot", "(lit)", "(= (cost) 0)", "(= (battery r) 50)")
    clock.set(at(11))
    run = kb.start("work", "r", "a", duration=seconds(30))
    kb.remove("(lit)")
    clock.set(at(20))
    kb.add("(open a)")
    kb.archive(at(20), archive_path)
    with kbstore.open(archive_path, kb.name) as archive:
        assert texts(archive.state().facts) == ["(busy r)"]
        assert (at(41), "(near r a)") in [(time, str(item)) for time, item, _ in archive.state().end_effects]
    clock.set(at(41))
    kb.end(run)
    assert texts(kb.state().facts) == ["(near r a)", "(open a)"]


def test_writing_continues_after_archiving(archived, clock):
    """Adding, scheduling, removing and expiry work on earlier assertions as on others."""
    clock.set(at(55))
    number = archived.remove("(raining)").number
    assert number == 8
    (raining,) = archived.history("(raining)", since=at(35))
    assert (raining.initial_time, raining.end_time, raining.ended.number) == (at(10), at(55), 8)
    archived.add("(open hall)", "(= (battery kenny) 10)")
    archived.remove("hall - room")
    assert texts(archived.state().facts) == ["(open galley)"]


# -- the archive --------------------------------------------------------------------------------------------------


def test_the_archive_is_the_store_just_before(archive):
    """Q7: later transactions are not in the archive: its scheduled assertions are there, and not cancelled."""
    assert archive.now() == at(35) - 1
    assert texts(archive.state(at=at(15)).facts) == ["(open hall)", "(raining)"]
    assert spans(archive.history("(open ?)")) == [
        ("(open hall)", at(10), at(20)),
        ("(open galley)", at(20), at(60)),
        ("(not (open galley))", at(60), None),
    ]
    (near,) = archive.history("(near ? ?)")
    assert (near.initial_time, near.end_time, near.cancelled) == (at(45), None, None)
    assert [change.number for change in archive.changes()] == [1, 2, 3, 4, 5]
    assert archive.when("(open hall)", at(0), at(35)) == [(at(10), at(20))]
    assert [(str(item), a, b) for item, a, b in archive.diff(at(9), at(31)).numbers] == [
        ("(= (battery kenny) 70)", None, 70.0)
    ]


def test_cancelled_assertions_are_cancelled_in_the_archive(kb, archive_path):
    """C5, Q7: an assertion cancelled before is cancelled in the archive, although its time is after its end."""
    kb.archive(at(42), archive_path)
    with kbstore.open(archive_path, kb.name) as archive:
        (near,) = archive.history("(near ? ?)")
        assert (near.initial_time, near.cancelled.number) == (at(45), 6)
        assert texts(archive.state().timed_knowledge) == ["(not (open galley))"]
        assert texts(archive.state(at=at(39)).timed_knowledge) == ["(near kenny wp0)", "(not (open galley))"]


AFTER_THE_END = {
    "state": lambda kb: kb.state(at=at(35)),
    "holds": lambda kb: kb.holds("(raining)", at=at(36)),
    "a belief": lambda kb: kb.state(at=at(45), as_of=at(30)),
    "history": lambda kb: kb.history("(raining)", until=at(36)),
    "when": lambda kb: kb.when("(raining)", at(10), at(36)),
    "diff": lambda kb: kb.diff(at(10), at(36)),
}


def test_an_archive_refuses_later_times(archive):
    """Q7: questions about later times are refused by an archive."""
    assert answered(archive, AFTER_THE_END, r"ends at 1970-01-01T00:17:15Z.*ask the store") == []


def test_an_archive_is_read_only(archive, archive_path):
    """An archive takes no transactions, no new knowledge bases, and is not archived itself."""
    with pytest.raises(StoreUnavailable, match="is an archive"):
        archive.add("(raining)")
    with pytest.raises(StoreUnavailable, match="is an archive"):
        archive.archive(at(20), archive_path)
    with pytest.raises(StoreUnavailable, match="there is no knowledge base 'nobody'"):
        kbstore.open(archive_path, "nobody")


# -- again --------------------------------------------------------------------------------------------------------


def test_an_archive_is_continued(archived, archive_path):
    """Q7: archiving into the same file again extends it: it has all of the past, from the first transaction on."""
    assert archived.archive(at(50), archive_path).rows == 1
    with kbstore.open(archive_path, archived.name) as archive:
        assert archive.history_from == 0
        assert [change.number for change in archive.changes()] == [1, 2, 3, 4, 5, 6]
        assert texts(archive.state(at=at(5)).instances) == texts(archive.state(at=at(49)).instances)
        assert spans(archive.history("(open hall)")) == [("(open hall)", at(10), at(20)), ("(open hall)", at(40), None)]
        (near,) = archive.history("(near ? ?)")
        assert near.cancelled.number == 6
        assert archive.value("(battery kenny)", at=at(29)) == 80


def test_a_new_file_begins_where_history_began(archived, tmp_path, archive_path):
    """Q7: a second file has the time from the first archiving to the second, and refuses earlier times."""
    archived.archive(at(50), tmp_path / "second.db")
    with kbstore.open(tmp_path / "second.db", archived.name) as second:
        assert second.history_from == at(35)
        assert texts(second.state(at=at(35)).facts) == ["(open galley)", "(raining)"]
        assert texts(second.state(at=at(49)).facts) == ["(open galley)", "(open hall)", "(raining)"]
        with pytest.raises(HistoryUnavailable, match="from 1970-01-01T00:17:15Z on"):
            second.state(at=at(34))
    with pytest.raises(HistoryUnavailable, match=r"ends at 1970-01-01T00:17:15Z.*only from 1970-01-01T00:17:30Z"):
        archived.archive(at(50), archive_path)


def test_archiving_again_does_nothing(archived, archive_path):
    """Archived history stays archived; an earlier time is no error, if the file has that history."""
    assert archived.archive(at(35), archive_path) == Archived(archive_path, at(35), 0)
    assert archived.archive(at(20), archive_path) == Archived(archive_path, at(35), 0)
    assert texts(archived.state(at=at(35)).facts) == ["(open galley)", "(raining)"]


def test_archived_history_cannot_be_archived_elsewhere(archived, tmp_path):
    """Archiving into a file without the earlier history is refused, and creates no file."""
    with pytest.raises(HistoryUnavailable, match="has been archived, and is not in"):
        archived.archive(at(35), tmp_path / "new.db")
    assert not (tmp_path / "new.db").exists()


def test_archiving_an_empty_past_does_nothing(kb, tmp_path):
    """Where nothing was recorded before that time, nothing is archived, and no file is created."""
    assert kb.archive(at(0), tmp_path / "new.db") == Archived(tmp_path / "new.db", 0, 0)
    assert not (tmp_path / "new.db").exists()
    assert kb.history_from == 0


def test_the_future_cannot_be_archived(kb, clock, archive_path):
    """A time after the latest transaction is refused: a transaction before it could still come."""
    clock.set(at(1000))
    for later in (at(50) + 1, at(1000), at(2000)):
        with pytest.raises(InvalidTime, match="is after the latest transaction"):
            kb.archive(later, archive_path)
    assert kb.archive(at(50), archive_path).history_from == at(50)


# -- files that are no archive ------------------------------------------------------------------------------------


def test_other_files_are_left_alone(kb, open_kb, tmp_path):
    """Only archives are written to: no store, no other database, no text file."""
    with kbstore.open(tmp_path / "store.db", "kenny", clock=ManualClock()) as store:
        store.add("(raining)")
    with sqlite3.connect(tmp_path / "other.db") as other:
        other.execute("CREATE TABLE songs (title)")
    other.close()
    (tmp_path / "text").write_text("a diary")
    for name in ("store.db", "other.db", "text"):
        before = (tmp_path / name).read_bytes()
        with pytest.raises(InvalidKnowledge, match=f"{name} is not an archive"):
            kb.archive(at(35), tmp_path / name)
        assert (tmp_path / name).read_bytes() == before
    with pytest.raises(StoreUnavailable, match="unable to open"):
        kb.archive(at(35), tmp_path / "nowhere" / "new.db")
    assert kb.history_from == 0


def test_the_archive_of_another(kb, open_kb, tmp_path, clock):
    """An archive of a knowledge base with the same name in another store is not mixed with this one."""
    with kbstore.open(tmp_path / "store.db", kb.name, clock=(other_clock := ManualClock(at(3)))) as other:
        for _ in range(3):
            other_clock.advance(seconds(10))
            other.add("(raining)") if other.holds("(not (raining))") else other.remove("(raining)")
        other.archive(other.now(), tmp_path / "archive.db")
    with pytest.raises(InvalidKnowledge, match="archive of another knowledge base named"):
        kb.archive(at(50), tmp_path / "archive.db")
    assert kb.history_from == 0


def test_archiving_needs_the_right_to_write(kb, store_url, archive_path):
    """Archiving is refused where writing is: read-only, and within a transaction of the same thread."""
    with pytest.raises(Conflict, match="a transaction is open"), kb.transaction():
        kb.archive(at(35), archive_path)
    if store_url != "sqlite://":
        with (
            kbstore.open(store_url, kb.name, read_only=True) as reader,
            pytest.raises(StoreUnavailable, match="read_only=True"),
        ):
            reader.archive(at(35), archive_path)


def test_a_damaged_archive_stops_it(kb, archive_path, monkeypatch):
    """Nothing is deleted before the archive has been verified: the number of rows, and a sound file."""
    from kbstore.transfer import archive_file

    taking = archive_file.ArchiveFile.take

    def losing(self, *arguments):
        taking(self, *arguments)
        with self._database.begin() as session:
            session.driver.execute("DELETE FROM facts")

    monkeypatch.setattr(archive_file.ArchiveFile, "take", losing)
    with pytest.raises(StoreUnavailable, match=r"cannot be trusted \(facts\); nothing has been deleted"):
        kb.archive(at(35), archive_path.with_name("damaged.db"))
    assert kb.history_from == 0
    assert texts(kb.state(at=at(15)).facts) == ["(open hall)", "(raining)"]
