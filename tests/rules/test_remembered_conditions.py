"""Rules O2 and O3: conditional effects at the end of an action that depend on conditions at its start."""

import pytest
import sqlalchemy as sa

import kbstore
from kbstore import seconds
from kbstore.clock import isoformat
from kbstore.storage import tables
from tests.conftest import START
from tests.rules.reading import facts

YARD = """
(define (domain yard)
  (:requirements :typing :fluents :durative-actions :conditional-effects :universal-effects :negative-preconditions)
  (:types robot place)
  (:constants Home - place)
  (:predicates (Lit) (open) (noted) (dark) (fresh ?r - robot) (rested ?r - robot) (near ?r - robot ?p - place)
               (Dirty ?p - place) (clean ?p - place) (alert) (path ?a ?b - place) (linked ?a ?b - place))
  (:functions (level) (log))
  (:derived (alert) (or (Lit) (open)))

  (:durative-action watch :parameters () :duration (= ?duration 10)
    :effect (when (at start (lit)) (at end (noted))))
  (:durative-action compare :parameters () :duration (= ?duration 10)
    :effect (and (when (and (at start (lit)) (at end (open))) (at end (noted)))
                 (when (at start (not (lit))) (and (at start (open)) (at end (dark))))))
  (:durative-action rest :parameters (?r - robot) :duration (= ?duration 10)
    :effect (and (at start (not (fresh ?r))) (when (at start (fresh ?r)) (at end (rested ?r)))))
  (:durative-action sweep :parameters () :duration (= ?duration 10)
    :effect (forall (?p - place) (when (at start (dirty ?p)) (at end (and (clean ?p) (not (dirty ?p)))))))
  (:durative-action polish :parameters () :duration (= ?duration 10)
    :effect (forall (?p - place) (when (at start (not (dirty ?p))) (at end (clean ?p)))))
  (:durative-action flood :parameters () :duration (= ?duration 10)
    :effect (forall (?p - place) (when (at start (lit)) (at end (clean ?p)))))
  (:durative-action link :parameters () :duration (= ?duration 10)
    :effect (forall (?a - place) (when (at end (clean ?a))
              (forall (?b - place) (when (at start (path ?a ?b)) (at end (linked ?a ?b)))))))
  (:durative-action tally :parameters () :duration (>= ?duration 0)
    :effect (and (when (at start (>= (level) ?duration)) (at end (increase (log) (level))))
                 (when (at start (alert)) (at end (noted)))))
  (:durative-action fill :parameters () :duration (= ?duration 10)
    :effect (and (at start (not (lit))) (when (at start (lit)) (increase (level) (* #t 2))))))
"""


@pytest.fixture
def yard(open_kb):
    """A robot and two places beside the constant Home."""
    return furnished(open_kb())


@pytest.fixture
def open_yard(open_kb):
    """The same in an open world."""
    return furnished(open_kb(use_unknowns=True))


def furnished(kb):
    kb.load(YARD)
    kb.add("Kenny - robot", "wp0 - place", "wp1 - place", "(= (level) 6)", "(= (log) 0)")
    return kb


def test_a_condition_true_at_the_start_counts_at_the_end(yard, clock):
    """O2, O3: the condition has become false meanwhile, and the effect happens all the same."""
    yard.add("(lit)")
    run = yard.start("watch")
    clock.set(START + seconds(4))
    yard.remove("(lit)")
    clock.set(START + seconds(10))
    yard.end(run)
    assert facts(yard) == ["(noted)"]


def test_a_condition_false_at_the_start_does_not_count_at_the_end(yard, clock):
    """O2, O3: the condition has become true meanwhile, and the effect does not happen."""
    run = yard.start("watch")
    clock.set(START + seconds(4))
    yard.add("(lit)")
    clock.set(START + seconds(10))
    yard.end(run)
    assert facts(yard) == ["(Lit)"]


def test_each_run_remembers_its_own_start(yard, clock):
    """O3: the condition was true when the second run began, and false when the first one did."""
    yard.end(yard.start("watch"))
    assert facts(yard) == []
    clock.set(START + seconds(1))
    yard.add("(lit)")
    run = yard.start("watch")
    yard.remove("(lit)")
    yard.end(run)
    assert facts(yard) == ["(noted)"]


def test_the_start_is_the_state_before_the_at_start_effects(yard):
    """O2: a fact that the action's own at-start effects delete was true at its start."""
    yard.add("(fresh kenny)")
    run = yard.start("rest", "kenny")
    assert facts(yard) == []
    yard.end(run)
    assert facts(yard) == ["(rested Kenny)"]
    yard.remove("(rested kenny)")
    yard.end(yard.start("rest", "kenny"))
    assert facts(yard) == []


@pytest.mark.parametrize(
    ("lit", "opened", "expected"),
    [
        (True, True, ["(noted)", "(open)"]),
        (True, False, []),
        (False, True, ["(dark)", "(open)"]),
        (False, False, ["(dark)"]),
    ],
)
def test_each_part_of_a_condition_is_evaluated_at_its_own_time(yard, clock, lit, opened, expected):
    """O2: one part is evaluated at the start, the other at the end, before the at-end effects."""
    if lit:
        yard.add("(lit)")
    run = yard.start("compare")
    # an effect at start and one at end may depend on one condition
    assert yard.holds("(open)") == (not lit)
    clock.set(START + seconds(5))
    yard.update([(2, "(lit)"), (0 if opened else 2, "(open)")])
    yard.end(run)
    assert facts(yard) == expected


def test_a_universal_effect_remembers_each_object(yard):
    """O2, V4: constants and objects, each separately."""
    yard.add("(dirty wp0)", "(dirty home)")
    run = yard.start("sweep")
    yard.update([(2, "(dirty wp0)"), (0, "(dirty wp1)")])
    yard.end(run)
    assert facts(yard) == ["(Dirty wp1)", "(clean Home)", "(clean wp0)"]


def test_objects_that_appear_during_a_run(yard):
    """O3, V4: at-end effects range over the objects that exist at the end, start conditions over those at the start."""
    yard.add("(lit)")
    runs = [yard.start(name) for name in ("polish", "flood")]
    yard.add("wp2 - place")
    yard.end(runs[0])
    # nothing recorded that (dirty wp2) was false at the start
    assert facts(yard) == ["(Lit)", "(clean Home)", "(clean wp0)", "(clean wp1)"]
    yard.remove("(lit)")
    yard.end(runs[1])
    assert facts(yard) == ["(clean Home)", "(clean wp0)", "(clean wp1)", "(clean wp2)"]


def test_a_start_condition_without_variables_is_decided_without_objects(yard):
    """O3: since it names no object, it applies to objects that appear before the end."""
    yard.load(YARD.replace("(:constants Home - place)", ""))
    yard.remove("wp0 - place", "wp1 - place")
    yard.add("(lit)")
    run = yard.start("flood")
    yard.remove("(lit)")
    yard.add("wp2 - place")
    yard.end(run)
    assert facts(yard) == ["(clean wp2)"]


def test_objects_that_end_during_a_run(yard):
    """O3, C9: effects apply only to the objects that still exist at the end."""
    yard.add("(dirty wp0)", "(dirty wp1)")
    run = yard.start("sweep")
    yard.remove("wp0 - place")
    yard.end(run)
    assert facts(yard) == ["(clean wp1)"]


def test_start_and_end_conditions_nest(yard):
    """O2: an effect at the end may be inside conditions of both times, in either order."""
    yard.add("(path wp0 wp1)", "(path wp1 wp0)", "(clean wp1)")
    run = yard.start("link")
    yard.update([(2, "(path wp0 wp1)"), (0, "(path wp1 home)"), (2, "(clean wp1)"), (0, "(clean wp0)")])
    yard.end(run)
    assert facts(yard) == ["(clean wp0)", "(linked wp0 wp1)", "(path wp1 Home)", "(path wp1 wp0)"]


def test_numbers_and_derived_predicates_at_the_start(yard, clock):
    """O2, V9: any condition may be latched, also one on the duration; the effect reads the state at the end."""
    yard.add("(open)")
    run = yard.start("tally", duration=seconds(6))
    yard.remove("(open)")
    yard.add("(= (level) 4)")
    yard.end(run)
    assert (yard.value("(log)"), facts(yard)) == (4, ["(noted)"])
    yard.remove("(noted)")
    longer = yard.start("tally", duration=seconds("4.000000001"))
    yard.add("(= (level) 100)", "(lit)")
    yard.end(longer)
    assert (yard.value("(log)"), facts(yard)) == (4, ["(Lit)"])


def test_a_condition_unknown_at_the_start_is_not_true(open_yard):
    """V6, O2: neither the fact nor its negation is known, so neither effect happens."""
    run = open_yard.start("compare")
    open_yard.add("(lit)", "(open)")
    open_yard.end(run)
    assert facts(open_yard) == ["(Lit)", "(open)"]
    open_yard.add("(not (lit))")
    run = open_yard.start("compare")
    open_yard.add("(lit)")
    open_yard.end(run)
    assert facts(open_yard) == ["(Lit)", "(dark)", "(open)"]


def test_an_aborted_action_has_no_such_effects(yard, clock):
    """O3: even if the condition was true at the start."""
    yard.add("(lit)")
    yard.abort(yard.start("watch"))
    assert facts(yard) == ["(Lit)"]


def test_a_continuous_effect_may_depend_on_the_start(yard, clock):
    """O2, O3: on the state before the at-start effects, which delete the condition here."""
    yard.add("(lit)")
    run = yard.start("fill")
    assert not yard.holds("(lit)")
    clock.set(START + seconds(3))
    assert yard.value("(level)") == 12
    yard.end(run)
    assert yard.value("(level)", at=START + seconds(20)) == 12
    yard.start("fill")
    clock.set(START + seconds(7))
    assert yard.value("(level)") == 12


def test_an_undefined_number_matters_only_if_the_effect_would_happen(yard):
    """O1: a continuous effect on an undefined function is refused only where it would happen."""
    yard.remove("(level)")
    assert yard.applicable("fill")
    yard.add("(lit)")
    assert list(map(str, yard.applicable("fill").failing)) == [f"(level) is undefined since {isoformat(START)}"]
    with pytest.raises(kbstore.NotApplicable, match=r"\(level\) is undefined"):
        yard.start("fill")


# -- what is expected ---------------------------------------------------------------------------------------------


def test_a_forecast_uses_what_was_true_at_the_start(yard, clock):
    """O3: a condition that is scheduled to become false changes nothing."""
    yard.add("(lit)")
    yard.add("(not (lit))", initial_time=START + seconds(5))
    yard.add("(open)", initial_time=START + seconds(8))
    yard.start("compare")
    clock.set(START + seconds(6))
    assert facts(yard, START + seconds(10) - 1) == ["(not (Lit))", "(open)"]
    assert facts(yard, START + seconds(10)) == ["(not (Lit))", "(noted)", "(open)"]
    assert yard.when("(noted)", START, START + seconds(20)) == [(START + seconds(10), START + seconds(20))]
    assert yard.explain("(noted)").truth is kbstore.Truth.FALSE
    assert yard.explain("(noted)", at=START + seconds(10)).truth is kbstore.Truth.TRUE


def test_a_forecast_ignores_start_conditions_that_become_true_later(yard, clock):
    """O3: whether by the schedule or by a later transaction."""
    yard.start("watch")
    yard.add("(lit)", initial_time=START + seconds(5))
    assert facts(yard, START + seconds(10)) == ["(Lit)"]
    clock.set(START + seconds(1))
    yard.add("(lit)")
    assert facts(yard, START + seconds(10)) == ["(Lit)"]


def test_a_belief_uses_the_start_of_the_run_at_that_time(yard, clock):
    """O3, Q2: as of the first run, as of the second, and now that both have ended."""
    yard.add("(lit)")
    first = yard.start("watch")
    clock.set(START + seconds(2))
    yard.abort(first)
    yard.remove("(lit)")
    clock.set(START + seconds(3))
    second = yard.start("watch")
    clock.set(START + seconds(5))
    yard.abort(second)
    later = START + seconds(15)
    assert [facts(yard, later, as_of=START + seconds(at)) for at in (1, 4, 5)] == [["(Lit)", "(noted)"], [], []]
    assert facts(yard, later, as_of=START) == ["(Lit)", "(noted)"]
    assert facts(yard, later) == []


def test_a_problem_has_the_end_effects_that_were_decided_at_the_start(yard, clock):
    """O4: as timed-initial literals."""
    yard.add("(dirty wp0)")
    yard.start("sweep")
    clock.set(START + seconds(4))
    yard.remove("(dirty wp0)")
    problem = yard.to_pddl()
    assert "(at 6 (clean wp0))" in problem
    assert "(clean wp1)" not in problem


# -- where it is kept ---------------------------------------------------------------------------------------------


def test_a_transaction_sees_the_latched_conditions_of_its_own_run(yard, clock):
    """O3: started, expected and ended in one transaction."""
    with yard.transaction() as tx:
        tx.add("(lit)")
        run = tx.start("watch")
        tx.remove("(lit)")
        tx.end(run)
        assert tx.state().holds("(noted)")
    assert facts(yard) == ["(noted)"]
    yard.remove("(noted)")
    yard.add("(lit)")
    run = yard.start("watch")
    with yard.transaction() as tx:
        tx.remove("(lit)")
        tx.end(run)
        assert tx.state().holds("(noted)")
    assert facts(yard) == ["(noted)"]


def test_a_start_that_is_rolled_back_latches_nothing(yard):
    """C1: a transaction that fails stores nothing, and the next run latches its own start."""
    yard.add("(lit)")

    def interrupted():
        with yard.transaction() as tx:
            tx.start("watch")
            raise InterruptedError

    with pytest.raises(InterruptedError):
        interrupted()
    yard.remove("(lit)")
    yard.end(yard.start("watch"))
    assert facts(yard) == []


def test_start_conditions_survive_a_restart(store_url, clock, tmp_path):
    """O3: the store is opened again between the start and the end."""
    if store_url == "sqlite://":
        store_url = f"sqlite:///{tmp_path / 'runs.db'}"
    name = f"remembered-{tmp_path.name}"
    with kbstore.open(store_url, name, clock=clock) as kb:
        furnished(kb).add("(dirty wp0)", "(dirty Home)", "(lit)")
        run = kb.start("sweep")
        kb.start("rest", "kenny")
    clock.set(START + seconds(3))
    with kbstore.open(store_url, name, clock=clock) as kb:
        kb.remove("(dirty ?)")
        assert facts(kb, START + seconds(10)) == ["(Lit)", "(clean Home)", "(clean wp0)"]
    engine = sa.create_engine(store_url)
    with engine.connect() as connection:
        mine = tables.runs.c.kb_id == sa.select(tables.knowledge_bases.c.id).filter_by(name=name).scalar_subquery()
        stored = connection.execute(sa.select(tables.runs.c.remembered).where(mine).order_by("number")).scalars()
        assert stored.all() == ["(dirty home)\n(dirty wp0)", None]
    engine.dispose()
    clock.set(START + seconds(11))
    with kbstore.open(store_url, name, clock=clock) as kb:
        kb.end(run)
        assert facts(kb) == ["(Lit)", "(clean Home)", "(clean wp0)"]


def test_a_domain_loaded_during_a_run(yard):
    """D3, D4: a start condition that only the new version has was not true at the start, in any case of its names."""
    yard.add("(lit)", "(open)")
    run = yard.start("watch")
    before = ":effect (when (at start (lit)) (at end (noted))))"
    after = ":effect (and (when (at start (LIT)) (at end (noted))) (when (at start (open)) (at end (dark)))))"
    assert before in YARD
    yard.load(YARD.replace(before, after))
    yard.remove("(lit)")
    yard.end(run)
    assert facts(yard) == ["(noted)", "(open)"]
