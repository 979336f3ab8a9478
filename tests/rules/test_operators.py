"""Rules O1 to O3: checking, applying, starting and ending operators."""

import pytest

import kbstore
from kbstore import Truth, seconds
from kbstore.storage.repository import Repository
from tests.conftest import START
from tests.rules.reading import facts, picture, scheduled, texts

DEPOT = """
(define (domain depot)
  (:requirements :typing :fluents :durative-actions :conditional-effects :universal-preconditions)
  (:types robot place)
  (:predicates (near ?r - robot ?p - place) (ready ?r - robot) (moving ?r - robot) (visited ?p - place)
               (lit) (broken ?r - robot) (charging ?r - robot))
  (:functions (battery ?r - robot) (distance ?a ?b - place) (one) (two) (log))

  (:action swap :parameters () :precondition (and)
    :effect (and (assign (one) (two)) (assign (two) (one))))
  (:action relight :parameters () :effect (and (lit) (not (lit))))
  (:action turn :parameters ()
    :effect (and (when (lit) (not (lit))) (when (not (lit)) (lit))))
  (:action reset :parameters ()
    :effect (forall (?r - robot) (when (broken ?r) (and (ready ?r) (not (broken ?r))))))
  (:action double :parameters (?r - robot) :precondition (ready ?r)
    :effect (and (increase (battery ?r) (battery ?r)) (not (ready ?r))))

  (:durative-action goto :parameters (?r - robot ?from ?to - place)
    :duration (= ?duration (/ (distance ?from ?to) 2))
    :condition (and (at start (near ?r ?from)) (at start (ready ?r)) (over all (moving ?r))
                    (over all (>= (battery ?r) 10)) (at end (lit)))
    :effect (and (at start (not (near ?r ?from))) (at start (moving ?r)) (at start (not (ready ?r)))
                 (at end (not (moving ?r))) (at end (near ?r ?to)) (at end (visited ?to)) (at end (ready ?r))
                 (decrease (battery ?r) (* #t 2)) (at end (increase (log) ?duration))))
  (:durative-action charge :parameters (?r - robot)
    :duration (and (>= ?duration 1) (<= ?duration 100))
    :condition (over all (charging ?r))
    :effect (and (at start (charging ?r)) (at end (not (charging ?r))) (increase (battery ?r) (* #t 3)))))
"""

ROUTE = ("goto", "kenny", "wp0", "wp1")


@pytest.fixture
def depot(open_kb):
    """A robot at wp0 with a battery of 80; wp1 is 20 away, ten seconds."""
    return furnished(open_kb())


@pytest.fixture
def open_depot(open_kb):
    """The same in an open world."""
    return furnished(open_kb(use_unknowns=True))


def furnished(kb):
    kb.load(DEPOT)
    kb.add("kenny - robot", "robby - robot", "wp0 - place", "wp1 - place")
    kb.add("(near kenny wp0)", "(ready kenny)", "(lit)", "(= (battery kenny) 80)", "(= (distance wp0 wp1) 20)")
    kb.add("(= (one) 1)", "(= (two) 2)", "(= (log) 0)")
    return kb


def level(kb, at, **belief):
    return kb.value("(battery kenny)", at=START + seconds(at), **belief)


# -- O1 -----------------------------------------------------------------------------------------------------------


def test_an_action_may_establish_its_own_invariant(depot):
    """O1: over-all conditions are evaluated after the at-start effects; at-end conditions are not checked."""
    assert not depot.holds("(moving kenny)")
    depot.remove("(lit)")
    assert depot.applicable(*ROUTE)
    assert depot.applicable(*ROUTE).failing == []


def test_applicable_names_each_failing_condition_and_since_when(depot, clock):
    """O1: at-start and over-all conditions."""
    clock.set(START + 10)
    depot.remove("(near kenny wp0)")
    depot.add("(= (battery kenny) 9)")
    clock.set(START + 20)
    answer = depot.applicable(*ROUTE)
    assert not answer
    failing = {condition.condition: condition.since for condition in answer.failing}
    assert len(failing) == 2
    (near,) = (since for condition, since in failing.items() if "near kenny wp0" in condition)
    (battery,) = (since for condition, since in failing.items() if "battery kenny" in condition)
    assert (near, battery) == (START + 10, START + 10)


def test_a_comparison_of_a_moving_number_fails_since_the_crossing(depot, clock):
    """O1: not since the number began to move; a further decrease does not make it later."""
    depot.add("(increase (battery kenny) (* #t -2))")
    clock.set(START + seconds(36))
    (failing,) = depot.applicable(*ROUTE).failing
    # 80 - 2 * 35 = 10, which is enough
    assert (failing.condition, failing.since) == ("(>= (battery kenny) 10)", START + seconds(35) + 1)
    depot.add("(= (battery kenny) 3)")
    (failing,) = depot.applicable(*ROUTE).failing
    assert failing.since == START + seconds(35) + 1


def test_applicability_can_be_asked_at_any_time(depot, clock):
    """O1: it is evaluated on the state at t."""
    clock.set(START + 10)
    depot.remove("(ready kenny)")
    assert depot.applicable(*ROUTE, at=START + 9)
    assert not depot.applicable(*ROUTE, at=START + 10)


def test_an_unknown_condition_fails(open_depot):
    """O1, V6: a condition that is unknown does not hold."""
    open_depot.remove("(ready kenny)")
    answer = open_depot.applicable(*ROUTE)
    assert [condition.truth for condition in answer.failing] == [Truth.UNKNOWN]


INVARIANTS = """
(define (domain invariants)
  (:predicates (open) (sealed) (spare))
  (:functions (level))
  (:durative-action drain :parameters () :duration (= ?duration 3)
    :condition (and (over all (open)) (over all (not (sealed))) (over all (> (level) 3)) (over all (or (open) (spare))))
    :effect (and (at start (not (open))) (at start (sealed)) (at start (decrease (level) 5))))
  (:durative-action idle :parameters () :duration (= ?duration 2)
    :condition (and (at start (open)) (at start (>= ?duration 30))))
  (:durative-action rest :parameters () :duration (>= ?duration 2)
    :condition (and (at start (open)) (over all (>= ?duration 30)))))
"""


@pytest.mark.parametrize("use_unknowns", [False, True])
def test_an_invariant_that_the_at_start_effects_break_is_named(open_kb, clock, use_unknowns):
    """O1: over-all conditions are evaluated on the state after the at-start effects, and fail from the start on."""
    kb = open_kb(use_unknowns=use_unknowns)
    kb.load(INVARIANTS)
    kb.add("(open)", "(not (sealed))", "(= (level) 5)")
    clock.set(START + 10)
    either = Truth.UNKNOWN if use_unknowns else Truth.FALSE
    assert [(found.condition, found.truth, found.since) for found in kb.applicable("drain").failing] == [
        ("(open)", Truth.FALSE, START + 10),
        ("(not (sealed))", Truth.FALSE, START + 10),
        ("(> (level) 3)", Truth.FALSE, START + 10),
        ("(or (open) (spare))", either, START + 10),
    ]


def test_a_condition_on_the_duration_can_fail(open_kb):
    """O1, O3: it is `NotApplicable`, and named; `since` is None, as the state does not decide it."""
    kb = open_kb()
    kb.load(INVARIANTS)
    kb.add("(open)")
    assert [(found.condition, found.since) for found in kb.applicable("idle").failing] == [("(>= ?duration 30)", None)]
    with pytest.raises(kbstore.NotApplicable, match="duration 30"):
        kb.start("rest", duration=seconds(10))
    assert kb.start("rest", duration=seconds(30))


@pytest.mark.parametrize("call", [("fly", "kenny"), ("goto", "kenny", "wp0"), ("goto", "wp0", "wp0", "wp1")])
def test_the_call_of_an_operator_must_match_its_declaration(depot, call):
    """O1, D1: name, and number and types of the arguments, must match."""
    before = picture(depot)
    for method in (depot.applicable, depot.start):
        with pytest.raises(kbstore.KbStoreError):
            method(*call)
    assert picture(depot) == before


# -- O2 -----------------------------------------------------------------------------------------------------------


def test_right_hand_sides_are_evaluated_on_the_state_before(depot):
    """O2: an action can swap two functions."""
    depot.apply("swap")
    assert (depot.value("(one)"), depot.value("(two)")) == (2, 1)


def test_conditional_effects_are_decided_on_the_state_before(depot):
    """O2: turning the light off does not turn it on again."""
    depot.apply("turn")
    assert not depot.holds("(lit)")
    depot.apply("turn")
    assert depot.holds("(lit)")


def test_deletes_come_before_adds(depot):
    """O2: a fact that an action both deletes and adds holds afterwards."""
    depot.apply("relight")
    assert depot.holds("(lit)")
    depot.remove("(lit)")
    depot.apply("relight")
    assert depot.holds("(lit)")


def test_an_action_is_one_transaction(depot):
    """O2: all of its changes are in that transaction."""
    before = list(depot.changes())[-1].number
    transaction = depot.apply("double", "kenny")
    assert transaction.number == before + 1
    (change,) = depot.changes(after=before)
    assert texts(a.item for a in change.ended) == ["(= (battery kenny) 80)", "(ready kenny)"]
    assert depot.value("(battery kenny)") == 160


def test_a_delete_effect_in_a_closed_world_removes_the_fact(depot):
    """O2: afterwards the fact is absent."""
    depot.apply("double", "kenny")
    assert not [text for text in facts(depot) if "ready" in text]


def test_a_delete_effect_in_an_open_world_makes_the_fact_explicitly_false(open_depot):
    """O2: afterwards the fact is explicitly false."""
    open_depot.apply("double", "kenny")
    assert "(not (ready kenny))" in facts(open_depot)
    assert open_depot.truth("(ready kenny)") is Truth.FALSE


def test_a_universal_effect_reaches_every_object(depot):
    """O2: with a condition for each object."""
    depot.add("(broken robby)")
    depot.apply("reset")
    assert depot.holds("(and (ready robby) (ready kenny) (not (broken robby)))")


def test_applying_an_inapplicable_action_stores_nothing(depot):
    """O3: `NotApplicable` lists the conditions."""
    depot.remove("(ready kenny)")
    before = picture(depot)
    with pytest.raises(kbstore.NotApplicable, match="ready kenny"):
        depot.apply("double", "kenny")
    with pytest.raises(kbstore.NotApplicable, match="ready kenny"):
        depot.start(*ROUTE)
    assert picture(depot) == before


def test_an_effect_on_an_undefined_function_is_an_error(depot):
    """O2, V5: it is not taken as 0; nothing of the action is stored."""
    depot.add("(ready robby)")
    before = picture(depot)
    with pytest.raises(kbstore.UndefinedFunction, match="battery robby"):
        depot.apply("double", "robby")
    assert picture(depot) == before


# -- O3: start, end, abort ----------------------------------------------------------------------------------------


def test_a_start_has_the_at_start_effects_and_is_part_of_the_state(depot, clock):
    """O3: the duration is the one that the domain fixes; a run at t is part of the state at t."""
    clock.set(START + seconds(1))
    run = depot.start(*ROUTE)
    assert (run.operator, run.arguments, run.started, run.duration) == (
        "goto",
        ("kenny", "wp0", "wp1"),
        START + seconds(1),
        seconds(10),
    )
    assert facts(depot) == ["(lit)", "(moving kenny)"]
    assert depot.state().running == [run]
    assert depot.state(START).running == []
    assert depot.state(START + seconds(5)).running == [run]


def test_a_state_within_a_transaction_keeps_what_ran(depot):
    """O3: it is the state at the time of reading; later starts and aborts of the transaction do not change it."""
    with depot.transaction() as tx:
        before = tx.state()
        run = tx.start(*ROUTE)
        between = tx.state()
        tx.abort(run)
        assert (before.running, between.running, tx.state().running) == ([], [run], [])


def test_an_end_has_the_at_end_effects(depot, clock):
    """O3: and the continuous effects stop."""
    run = depot.start(*ROUTE)
    clock.set(START + seconds(12))
    depot.end(run)
    assert facts(depot) == ["(lit)", "(near kenny wp1)", "(ready kenny)", "(visited wp1)"]
    assert [level(depot, at) for at in (0, 1, 10, 12, 50)] == [80, 78, 60, 56, 56]
    assert depot.value("(log)") == 10
    assert depot.state().running == []
    assert depot.state(START + seconds(11)).running == [run]


def test_an_abort_has_no_at_end_effects(depot, clock):
    """O3: only the continuous effects stop."""
    run = depot.start(*ROUTE)
    clock.set(START + seconds(4))
    depot.abort(run)
    assert facts(depot) == ["(lit)", "(moving kenny)"]
    assert [level(depot, at) for at in (2, 4, 50)] == [76, 72, 72]
    assert depot.state().running == []


@pytest.mark.parametrize("wrong", ["goto", None, 1, ("goto", "kenny")])
def test_ending_something_else_than_a_run_is_refused(depot, wrong):
    """O3: a typed error says what to give."""
    depot.start(*ROUTE)
    for act in (depot.end, depot.abort):
        with pytest.raises(kbstore.InvalidKnowledge, match=r"is not a run; give what start\(\) returned"):
            act(wrong)


def test_the_caller_gives_the_duration_where_the_domain_does_not_fix_it(depot):
    """O3: within the bounds of the domain."""
    run = depot.start("charge", "kenny", duration=seconds(20))
    assert run.duration == seconds(20)
    depot.end(run)
    for wrong in (None, seconds(1000)):
        with pytest.raises(kbstore.KbStoreError):
            depot.start("charge", "robby", duration=wrong)


def test_contributions_of_several_actions_add_up_and_end_independently(depot, clock):
    """O3: a moving robot on a charging floor."""
    going = depot.start(*ROUTE)
    clock.set(START + seconds(2))
    charging = depot.start("charge", "kenny", duration=seconds(50))
    assert [level(depot, at) for at in (1, 2, 3, 6)] == [78, 76, 77, 80]
    clock.set(START + seconds(6))
    depot.end(going)
    assert [level(depot, at) for at in (6, 7)] == [80, 83]
    clock.set(START + seconds(8))
    depot.end(charging)
    assert [level(depot, at) for at in (8, 20)] == [86, 86]


def test_an_assignment_during_a_run_resets_only_the_functions_own_rate(depot, clock):
    """O3, C7: the contributions of runs continue."""
    depot.add("(increase (battery kenny) (* #t 1))")
    run = depot.start(*ROUTE)
    assert [level(depot, at) for at in (0, 2)] == [80, 78]
    clock.set(START + seconds(2))
    depot.add("(= (battery kenny) 50)")
    assert [level(depot, at) for at in (2, 4)] == [50, 46]
    clock.set(START + seconds(4))
    depot.end(run)
    assert [level(depot, at) for at in (4, 9)] == [46, 46]


def test_a_running_action_cannot_be_started_again_with_the_same_arguments(depot):
    """O3: with other arguments it can."""
    depot.start("charge", "kenny", duration=seconds(20))
    depot.add("(= (battery robby) 1)")
    with pytest.raises(kbstore.NotApplicable):
        depot.start("charge", "kenny", duration=seconds(20))
    depot.start("charge", "robby", duration=seconds(20))
    assert len(depot.state().running) == 2


def test_a_run_ends_only_once(depot):
    """O3: after its end it can be neither ended nor aborted."""
    run = depot.start(*ROUTE)
    depot.end(run)
    for method in (depot.end, depot.abort):
        with pytest.raises(kbstore.KbStoreError):
            method(run)


def test_an_end_reports_the_conditions_that_fail(depot, clock):
    """O3: the at-end conditions; the action has ended all the same."""
    run = depot.start(*ROUTE)
    clock.set(START + seconds(10))
    depot.remove("(lit)")
    report = depot.end(run)
    assert "lit" in str(report) or "lit" in str(report.note) or "lit" in str(getattr(report, "failing", ""))
    assert depot.holds("(near kenny wp1)")


def test_a_run_of_a_removed_object_cannot_end(depot, clock):
    """O3, C12: removing an object aborts its runs, in the same transaction."""
    run = depot.start(*ROUTE)
    clock.set(START + seconds(5))
    depot.remove("wp1")
    assert depot.state().running == []
    assert level(depot, 5) == level(depot, 50) == 70
    with pytest.raises(kbstore.NotApplicable):
        depot.end(run)


def test_an_end_that_changes_an_undefined_number_is_refused(depot, clock):
    """O3: the error says what to do, nothing of the end is stored, and with the number defined again it ends."""
    run = depot.start(*ROUTE)
    clock.set(START + seconds(5))
    depot.remove("(log)")
    with pytest.raises(kbstore.NotApplicable, match=r"\(log\) has no value.*mend the state, or abort\(\) it"):
        depot.end(run)
    assert [each.number for each in depot.state().running] == [run.number]
    assert not depot.holds("(near kenny wp1)")
    depot.add("(= (log) 3)")
    depot.end(run)
    assert depot.holds("(near kenny wp1)")
    assert depot.value("(log)") == 3 + run.duration / seconds(1)


def test_clear_aborts_runs(depot, clock):
    """C12: in the same transaction."""
    depot.start(*ROUTE)
    clock.set(START + seconds(5))
    depot.clear()
    assert depot.state().running == []
    assert depot.state(START + seconds(20)).facts == []
    assert len(depot.state(START + seconds(4)).running) == 1


# -- O3: what is expected -----------------------------------------------------------------------------------------


def test_a_question_about_the_future_includes_the_expected_end(depot, clock):
    """O3: at the expected end its effects hold; none of them is stored."""
    depot.start(*ROUTE)
    clock.set(START + seconds(5))
    expected = depot.state(START + seconds(10))
    assert texts(expected.facts) == ["(lit)", "(near kenny wp1)", "(ready kenny)", "(visited wp1)"]
    assert expected.running == []
    assert len(depot.state(START + seconds(10) - 1).running) == 1
    assert [level(depot, at) for at in (9, 10, 30)] == [62, 60, 60]
    assert scheduled(depot) == []
    assert [str(a.item) for a in depot.history("(visited wp1)")] == []


def test_an_expectation_never_becomes_the_past(depot, clock):
    """O3: an action whose expected end has passed is overdue, and is expected to run on."""
    depot.start(*ROUTE)
    clock.set(START + seconds(12))
    for at in (10, 11, 12):
        assert "(moving kenny)" in facts(depot, START + seconds(at))
    assert len(depot.state(START + seconds(20)).running) == 1
    assert level(depot, 20) == 40


def test_a_belief_includes_the_expected_ends_of_what_ran_then(depot, clock):
    """O3, Q2: as of then the end was expected, although it never came."""
    run = depot.start(*ROUTE)
    clock.set(START + seconds(4))
    depot.abort(run)
    assert "(visited wp1)" in facts(depot, START + seconds(15), as_of=START + seconds(3))
    assert "(visited wp1)" not in facts(depot, START + seconds(15))
    assert level(depot, 15, as_of=START + seconds(3)) == 60
    assert level(depot, 15) == 72


def test_a_run_is_expected_to_be_aborted_where_an_object_ends_before(depot):
    """O3: at a scheduled end of the object."""
    depot.start(*ROUTE)
    depot.add("(not (wp1 - place))", initial_time=START + seconds(6))
    state = depot.state(START + seconds(30))
    assert texts(state.facts) == ["(lit)", "(moving kenny)"]
    assert state.running == []
    assert [level(depot, at) for at in (5, 6, 30)] == [70, 68, 68]


def test_scheduled_knowledge_and_expected_effects_come_in_order_of_time(depot):
    """O3: the expected state includes everything scheduled and expected, in order."""
    depot.start(*ROUTE)
    depot.add("(not (ready kenny))", "(= (log) 100)", initial_time=START + seconds(9))
    depot.add("(not (visited wp1))", initial_time=START + seconds(11))
    after = facts(depot, START + seconds(12))
    assert "(ready kenny)" in after
    assert "(not (visited wp1))" in after
    assert depot.value("(log)", at=START + seconds(12)) == 110


def test_expected_effects_spell_names_as_first_written(open_kb, clock):
    """O3, D3: objects as they were added, and constants as in the domain, like after the real end."""
    kb = open_kb()
    kb.load(DEPOT.replace("(:types robot place)", "(:types robot place) (:constants Dock - place)"))
    kb.add("Kenny - robot", "WP0 - place", "(near kenny wp0)", "(ready kenny)", "(lit)")
    kb.add("(= (battery kenny) 80)", "(= (distance wp0 dock) 20)", "(= (log) 0)")
    run = kb.start("GOTO", "KENNY", "wp0", "DOCK")
    assert (run.operator, run.arguments) == ("goto", ("Kenny", "WP0", "Dock"))
    assert kb.state().running == [run]
    expected = ["(lit)", "(near Kenny Dock)", "(ready Kenny)", "(visited Dock)"]
    assert facts(kb, START + seconds(10)) == expected
    clock.set(START + seconds(10))
    kb.end(run)
    assert facts(kb) == expected


def test_an_action_reads_its_effects_timelines_at_once(depot, monkeypatch):
    """O2: an action on many objects needs as many statements as one on a few."""
    asked = []
    live = Repository.rows_for_update

    def counted(self, kind, *arguments):
        asked.append(kind)
        return live(self, kind, *arguments)

    monkeypatch.setattr(Repository, "rows_for_update", counted)
    depot.add("(broken kenny)", "(broken robby)")
    asked.clear()
    depot.apply("reset")
    for_two = len(asked)
    robots = [f"r{number}" for number in range(60)]
    depot.add(*(f"{name} - robot" for name in robots), *(f"(broken {name})" for name in robots))
    asked.clear()
    assert depot.apply("reset").changes == 120
    assert 0 < len(asked) <= for_two


def test_runs_survive_a_restart(store_url, clock, tmp_path):
    """O3: a run is part of the state, and is stored."""
    if store_url == "sqlite://":
        store_url = f"sqlite:///{tmp_path / 'runs.db'}"
    name = f"runs-{tmp_path.name}"
    with kbstore.open(store_url, name, clock=clock) as kb:
        run = furnished(kb).start(*ROUTE)
    clock.set(START + seconds(3))
    with kbstore.open(store_url, name, clock=clock) as kb:
        assert kb.state().running == [run]
        assert level(kb, 3) == 74
        kb.end(run)
        assert kb.holds("(near kenny wp1)")
