"""Answers to single questions: cached only while they are right, and read with as few rows as possible."""

import random
from contextlib import suppress

import pytest

import kbstore
from kbstore import InvalidKnowledge, KbStoreError, seconds
from kbstore.storage.memory import TimelineCache
from kbstore.storage.sqlite_connection import SqliteConnection
from tests.conftest import START

DOMAIN = """
(define (domain house)
  (:requirements :typing :fluents :derived-predicates :negative-preconditions)
  (:types robot place room - place)
  (:constants hall - place)
  (:predicates (at ?r - robot ?p - place) (open ?p - place) (linked ?a ?b - place) (alarm) (reachable ?p - place))
  (:functions (charge ?r - robot) (cost))
  (:derived (reachable ?p - place) (exists (?q - place) (and (open ?q) (linked ?q ?p))))
  (:action go :parameters (?r - robot ?a ?b - place)
    :precondition (and (at ?r ?a) (not (alarm)) (> (charge ?r) 5))
    :effect (and (not (at ?r ?a)) (at ?r ?b))))
"""
QUESTIONS = (
    "(open p0)",
    "(not (open p1))",
    "(and (at r0 p0) (or (open p0) (not (alarm))) (imply (alarm) (open p1)))",
    "(>= (charge r0) 20)",
    "(and (open p0) (< (+ (charge r0) (cost)) 60))",
    "(exists (?p - place) (at r0 ?p))",
    "(exists (?r - robot) (at ?r p1))",
    "(exists (?p - place) (and (at r0 ?p) (open ?p)))",
    "(forall (?p - room) (or (open ?p) (linked ?p hall)))",
    "(at r0 ?)",
    "(at ? p0)",
    "(linked ? ?)",
    "(reachable p1)",
    "p1 - place",
    "p1 - object",
)
GOALS = ("(open p0)", "(not (alarm))", "(>= (charge r0) 5)", "(or (alarm) (open p0))")
NUMBERS = ("(charge r0)", "(cost)", "(+ (charge r0) (* 2 (cost)))")


def answers(kb):
    """The answers to all questions, with refusals as their errors."""
    found = [kb.truth(question) for question in QUESTIONS]
    for number in NUMBERS:
        try:
            found.append(kb.value(number))
        except KbStoreError as error:
            found.append(type(error))
    found += [kb.instances(), kb.instances("place", include_subtypes=True), kb.propositions(), kb.propositions("at")]
    found += [kb.functions("charge"), kb.goals(), kb.metric(), kb.timed_knowledge("open"), kb.query(*QUESTIONS[:5])]
    found += [kb.applicable("go", "r0", "p0", place) for place in ("hall", "p1") if kb.holds(f"{place} - place")]
    return found


def write_something(kb, clock, chance):
    """One more transaction, for now or for a little later."""
    atoms = ("(open p0)", "(open p1)", "(alarm)", "(at r0 p0)", "(at r0 p1)", "(linked p0 p1)", "(linked p1 hall)")
    later = {"initial_time": clock.now() + seconds(chance.randrange(1, 5))} if chance.random() < 0.4 else {}
    match chance.randrange(9):
        case 8:
            kb.add_goal(chance.choice(GOALS))
            kb.add_metric(chance.choice(("minimize (cost)", "maximize (charge r0)")))
        case 0:
            kb.remove(chance.choice(atoms), **later)
        case 1:
            kb.add(f"(not {chance.choice(atoms)})", **later)
        case 2:
            kb.add(f"(= (charge r0) {chance.randrange(25)})", f"(= (cost) {chance.randrange(3)})", **later)
        case 3:
            kb.add(f"(increase (charge r0) (* #t {chance.choice((-3, 0, 5))}))")
        case 4:
            kb.add("(not (p1 - room))", **later)
        case 5:
            kb.add("p1 - room")
        case _:
            kb.add(chance.choice(atoms), **later)


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("unknowns", [False, True])
def test_cached_answers_equal_fresh_ones(tmp_path, seed, unknowns):
    """T3, C9, Q1: after any writes, and any changes by the clock, a cached answer is never an old one."""
    chance = random.Random(seed)
    clock = kbstore.ManualClock(START)
    store = tmp_path / "store.db"
    with (
        kbstore.open(store, clock=clock, use_unknowns=unknowns) as kb,
        kbstore.open(store, clock=clock) as other,
        kbstore.open(store, clock=clock, cache=False) as forgetful,
    ):
        kb.load(DOMAIN)
        kb.add("r0 - robot", "p0 - place", "p1 - room")
        for _ in range(25):
            # a question about an object that does not exist at that time is refused
            with suppress(KbStoreError):
                write_something(chance.choice((kb, other)), clock, chance)
            for _ in range(chance.randrange(4)):
                assert answers(kb) == answers(kb) == answers(forgetful)
                clock.advance(chance.choice((1, seconds(1) - 1, seconds(1))))


def test_questions_of_one_call_are_answered_at_one_time(tmp_path):
    """Questions of one call agree while a number passes a limit, also where all are answered from the cache."""

    class Ticking(kbstore.ManualClock):
        ticks = 0

        def now(self):
            self.advance(self.ticks)
            return super().now()

    clock = Ticking(START)
    alike = ("(>= (level) 11)", "(>= (level) 11.0)")
    with kbstore.open(tmp_path / "store.db", clock=clock) as kb:
        kb.load("(define (domain tank) (:requirements :fluents) (:functions (level)))")
        kb.add("(= (level) 10)")
        kb.add("(increase (level) (* #t 1))")
        assert kb.query(*alike).results == [False, False]
        assert [kb.holds(question) for question in alike] == [False, False]
        for before in range(5):
            clock.set(START + seconds(1) - before)
            clock.ticks = 1
            first, second = kb.query(*alike).results
            clock.ticks = 0
            assert first == second


def test_a_condition_broken_by_the_action_fails_since_the_start(tmp_path):
    """O1: an over-all condition that the at-start effects break fails from the time of the start on."""
    clock = kbstore.ManualClock(START)
    with kbstore.open(tmp_path / "store.db", clock=clock) as kb:
        kb.load("""
        (define (domain doors)
          (:requirements :durative-actions)
          (:predicates (shut))
          (:durative-action pass :parameters () :duration (= ?duration 5)
            :condition (over all (shut)) :effect (at start (not (shut)))))""")
        kb.add("(shut)")
        for _ in range(3):
            clock.advance(1)
            assert [condition.since for condition in kb.applicable("pass").failing] == [clock.now()]


def test_an_interrupt_just_after_the_commit_leaves_no_old_answer(tmp_path, monkeypatch):
    """T3: Ctrl-C while waiting for the disk is raised after the writes are stored."""

    def interrupted(_connection):
        raise KeyboardInterrupt

    with kbstore.open(tmp_path / "store.db") as kb:
        kb.add("(open p0)")
        assert kb.holds("(open p0)")
        with monkeypatch.context() as patch:
            patch.setattr(SqliteConnection, "_committed", interrupted)
            with pytest.raises(KeyboardInterrupt):
                kb.remove("(open p0)")
        assert not kb.holds("(open p0)")
        assert kb.propositions() == []


def test_the_parts_of_a_state_are_those_of_the_state(tmp_path):
    """A question about a part of the state, at any time, agrees with the whole state."""
    chance = random.Random(7)
    clock = kbstore.ManualClock(START)
    with kbstore.open(tmp_path / "store.db", clock=clock) as kb:
        kb.load(DOMAIN)
        kb.add("r0 - robot", "p0 - place", "p1 - room")
        for number in range(25):
            with suppress(KbStoreError):
                write_something(kb, clock, chance)
            if number % 5 == 0:
                kb.add_goal(chance.choice(GOALS))
                kb.add_metric(chance.choice(("minimize (cost)", "maximize (charge r0)")))
            clock.advance(seconds(chance.randrange(3)))
            at = chance.choice((clock.now(), clock.now() + seconds(2), chance.randrange(START, clock.now() + 1)))
            state = kb.state(at=at)
            assert kb.instances(at=at) == state.instances
            assert kb.instances("room", at=at) == [item for item in state.instances if item.instance_type == "room"]
            assert kb.propositions(at=at) == state.facts
            for name in ("at", "OPEN", "linked", "alarm"):
                expected = [item for item in state.facts if item.attribute_name == name.lower()]
                assert kb.propositions(name, at=at) == expected
            assert kb.functions("charge", at=at) == [f for f in state.functions if f.attribute_name == "charge"]
            assert kb.functions(at=at) == state.functions
            assert kb.goals(at=at) == state.goals
            assert kb.metric(at=at) == state.metric
            assert kb.timed_knowledge(at=at) == state.timed_knowledge
            later = [item for item in state.timed_knowledge if getattr(item, "attribute_name", "") == "at"]
            assert kb.timed_knowledge("at", at=at) == later
            asked = ("(open p0)", "(at r0 ?)", "(exists (?p - place) (at r0 ?p))", "(>= (charge r0) 20)")
            assert kb.query(*asked, at=at) == state.query(*asked)
            needed = ("(at r0 p0)", "(not (alarm))", "(> (charge r0) 5)")
            judged = kb.applicable("go", "r0", "p0", "hall", at=at)
            assert [part.condition for part in judged.failing] == [part for part in needed if not state.holds(part)]


@pytest.fixture
def large(tmp_path):
    """A thousand facts, ten of them the places of the robot; and all statements that are run."""
    with kbstore.open(tmp_path / "store.db", clock=kbstore.ManualClock(START)) as kb:
        kb.load(DOMAIN)
        kb.add("r0 - robot", *(f"p{n} - place" for n in range(1000)))
        kb.add(
            "(at r0 p3)",
            "(= (charge r0) 9)",
            *(f"(open p{n})" for n in range(1000)),
            *(f"(linked p{n} p{n + 1})" for n in range(10)),
        )
        statements = []
        with kb._database.connect() as connection:
            connection.driver.set_trace_callback(statements.append)
        kb.holds("(alarm)")
        statements.clear()
        yield kb, statements


WHOLE = "level"
"""Text of the statements that read all facts or objects at a time, and of no others."""


def test_the_statement_of_a_whole_state_is_recognized(large):
    """The statement that the following tests look for is run where everything is read."""
    kb, statements = large
    kb.state()
    assert [text for text in statements if WHOLE in text and "facts" in text]


@pytest.mark.parametrize(
    ("question", "most"),
    [
        ("(exists (?p - place) (at r0 ?p))", 6),
        ("(exists (?p - place) (and (at r0 ?p) (open ?p)))", 7),
        ("(at r0 ?)", 6),
        ("(linked ? p4)", 7),
    ],
)
def test_a_bound_object_is_looked_up(large, question, most):
    """A question that names an object reads its mentions by an index: begin, head, a few look-ups, rollback."""
    kb, statements = large
    assert kb.holds(question)
    reading = [text for text in statements if "data_version" not in text]
    assert not [text for text in reading if WHOLE in text]
    assert len(reading) <= most, reading
    statements.clear()
    assert kb.holds(question)
    assert [text for text in statements if "data_version" not in text] == []


def test_an_absent_timeline_is_looked_up_once(large, tmp_path):
    """The timeline of a fact that was never asserted is looked up again only after one was added by any process."""
    kb, statements = large

    def looked_up(t):
        statements.clear()
        answer = kb.holds("(and (at r0 p3) (or (alarm) (open p9)) (not (at r0 p4)))", at=t)
        return answer, len([text for text in statements if "timelines" in text])

    # the other place: the alarm has been asked about before
    assert looked_up(START) == (True, 1)
    assert looked_up(START + 1) == (True, 0)
    kb._clock.advance(10)
    kb.add("(not (open p9))")
    assert looked_up(START + 10) == (False, 0)
    with kbstore.open(tmp_path / "store.db", clock=kb._clock) as other:
        other.add("(alarm)")
    assert looked_up(START + 11) == (True, 2)
    assert looked_up(START + 12) == (True, 0)
    kb.add("(at r0 p4)")
    assert looked_up(START + 13) == (False, 0)


def test_a_number_that_moves_is_read_once(large):
    """A condition, or a sum, of a moving number is computed for each time from the first read (C7, V5)."""
    kb, statements = large
    clock = kb._clock
    kb.add("(increase (charge r0) (* #t -1))", "(= (cost) 1)")
    asked = "(and (at r0 p3) (>= (charge r0) 5))"
    assert kb.holds(asked)
    assert kb.value("(+ (charge r0) (cost))") == 10
    statements.clear()
    for second, truth in ((1, True), (3, True), (1, False), (1, False)):
        clock.advance(seconds(second))
        assert kb.holds(asked) is truth
        assert kb.value("(+ (charge r0) (cost))") == 10 - (clock.now() - START) / seconds(1)
    # the first time that it does not hold, it is checked whether the question can be meant
    assert len([text for text in statements if "data_version" not in text]) <= 12
    statements.clear()
    clock.advance(seconds(1))
    assert not kb.holds(asked)
    assert [text for text in statements if "data_version" not in text] == []
    kb.add("(= (charge r0) 9)")
    assert kb.holds(asked)


def test_answers_outlast_writes_to_other_knowledge_bases(large, tmp_path):
    """A commit to another knowledge base of the file costs a read of the head, and no cached answer."""
    kb, statements = large
    asked = ("(exists (?p - place) (at r0 ?p))", "(and (at r0 p3) (not (alarm)))")
    with kbstore.open(tmp_path / "store.db", "elsewhere") as elsewhere:
        assert [kb.holds(question) for question in asked] == [True, True]
        elsewhere.add("(alarm)")
        statements.clear()
        assert [kb.holds(question) for question in asked] == [True, True]
        assert len([text for text in statements if "data_version" not in text]) == 1
    with kbstore.open(tmp_path / "store.db", clock=kb._clock) as other:
        other.add("(alarm)")
        assert [kb.holds(question) for question in asked] == [True, False]


def test_a_question_is_checked_again_once_an_object_is_recorded(tmp_path):
    """V10: that no object ever had a wrong type is read once, and again after an object was recorded."""
    store = tmp_path / "store.db"
    with kbstore.open(store) as kb, kbstore.open(store) as other:
        kb.load(DOMAIN)
        kb.add("p0 - place")
        assert not kb.holds("(at r7 p0)")
        kb.add("(alarm)")
        assert not kb.holds("(at r7 p0)")
        other.add("r7 - place")
        with pytest.raises(InvalidKnowledge):
            kb.holds("(at r7 p0)")


@pytest.mark.parametrize(
    "ask",
    [
        lambda kb: kb.propositions("at"),
        lambda kb: kb.functions("charge"),
        lambda kb: kb.instances("robot"),
        lambda kb: kb.goals(),
        lambda kb: kb.metric(),
        lambda kb: kb.timed_knowledge("at"),
        lambda kb: kb.query("(at r0 p3)", "(open p9)", "(exists (?p - place) (at r0 ?p))"),
        lambda kb: kb.applicable("go", "r0", "p3", "p4"),
    ],
)
def test_a_part_of_the_state_is_read_by_itself(large, ask):
    """A question that few facts decide is answered without reading the rest, now and in the past."""
    kb, statements = large
    ask(kb)
    assert not [text for text in statements if WHOLE in text and "facts" in text]


def test_without_a_cache_ingestion_keeps_no_timelines(tmp_path, monkeypatch):
    """`cache=False` also holds for the caches that a batch of `ingest` has, and one without reads what it wrote."""
    bounds = []
    made = TimelineCache.__init__
    monkeypatch.setattr(TimelineCache, "__init__", lambda self, bound=9: bounds.append(bound) or made(self, bound))
    with kbstore.open(tmp_path / "store.db", cache=False) as kb:
        kb.ingest(["(p a)", "(p b)", "(not (p a))"], batch=1)
        assert kb.holds("(and (p b) (not (p a)))")
    assert set(bounds) == {0}
