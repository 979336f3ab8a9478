"""Rules V1 to V3 and V6 to V8: what holds, what is true, and why."""

import pytest

import kbstore
from kbstore import Fact, Function, Truth, seconds
from tests.conftest import DOMAIN, OBJECTS, START
from tests.rules.reading import facts


@pytest.fixture
def open_world(open_kb):
    """The knowledge base `kb`, but with `use_unknowns`."""
    kb = open_kb(use_unknowns=True)
    kb.load(DOMAIN)
    kb.add(*OBJECTS)
    return kb


# -- V1 -----------------------------------------------------------------------------------------------------------


def test_the_latest_assertion_of_a_timeline_holds(kb, clock):
    """V1: at t the assertion with the greatest initial time not after t holds."""
    for value in (1, 2, 3):
        clock.set(START + 10 * value)
        kb.add(f"(= (cost) {value})")
    values = {at: kb.value("(cost)", at=START + at) for at in (10, 19, 20, 29, 30, 1000)}
    assert values == {10: 1, 19: 1, 20: 2, 29: 2, 30: 3, 1000: 3}


def test_among_equal_initial_times_the_last_recorded_holds(kb):
    """V1: of several transactions at one time, the last counts."""
    kb.add("(raining)")
    kb.add("(not (raining))")
    kb.add("(= (cost) 1)")
    kb.add("(= (cost) 2)")
    assert facts(kb, START) == ["(not (raining))"]
    assert kb.value("(cost)", at=START) == 2


def test_an_item_added_now_replaces_one_scheduled_for_now(kb, clock):
    """V1: among equal initial times the last recorded holds, also where the earlier one was scheduled."""
    kb.add("(raining)", initial_time=START + 10)
    clock.set(START + 10)
    kb.add("(not (raining))")
    assert facts(kb, START + 10) == ["(not (raining))"]
    assert facts(kb, START + 11) == ["(not (raining))"]


def test_before_the_first_assertion_and_after_a_removal_a_fact_is_absent(kb, clock):
    """V1: there the fact is absent."""
    clock.set(START + 10)
    kb.add("(raining)")
    clock.set(START + 20)
    kb.remove("(raining)")
    holding = {at: facts(kb, START + at) for at in (9, 10, 19, 20, 21)}
    assert holding == {9: [], 10: ["(raining)"], 19: ["(raining)"], 20: [], 21: []}


def test_a_cancelled_assertion_never_holds(kb):
    """V1: cancelled assertions do not count."""
    kb.add("(raining)")
    kb.add("(not (raining))", initial_time=START + 10)
    kb.remove("(not (raining))", initial_time=START + 10)
    assert facts(kb, START + 10) == ["(raining)"]


# -- V2, V3 -------------------------------------------------------------------------------------------------------


def test_in_a_closed_world_absent_is_false(kb):
    """V2: this is the default."""
    kb.add("(open wp0)", "(not (open wp1))")
    truths = {wp: kb.truth(f"(open {wp})") for wp in ("wp0", "wp1", "hall")}
    assert truths == {"wp0": Truth.TRUE, "wp1": Truth.FALSE, "hall": Truth.FALSE}


def test_in_an_open_world_absent_is_unknown(open_world):
    """V2: with `use_unknowns`."""
    open_world.add("(open wp0)", "(not (open wp1))")
    truths = {wp: open_world.truth(f"(open {wp})") for wp in ("wp0", "wp1", "hall")}
    assert truths == {"wp0": Truth.TRUE, "wp1": Truth.FALSE, "hall": Truth.UNKNOWN}


def test_not_in_a_closed_world_holds_wherever_it_is_not_asserted(kb):
    """V3: both absent and explicitly false facts satisfy `not`."""
    kb.add("(open wp0)", "(not (open wp1))")
    assert [kb.holds(f"(not (open {wp}))") for wp in ("wp0", "wp1", "hall")] == [False, True, True]


def test_not_in_an_open_world_holds_only_where_explicitly_false(open_world):
    """V3: an absent fact does not satisfy `not`."""
    open_world.add("(open wp0)", "(not (open wp1))")
    assert [open_world.holds(f"(not (open {wp}))") for wp in ("wp0", "wp1", "hall")] == [False, True, False]
    assert open_world.truth("(not (open hall))") is Truth.UNKNOWN


def test_the_world_is_chosen_at_creation_and_stored(open_kb, tmp_path, clock):
    """V2: opening with another value than the stored one is refused; the default is the stored one."""
    url = f"sqlite:///{tmp_path / 'world.db'}"
    with kbstore.open(url, "open", clock=clock, use_unknowns=True):
        pass
    with kbstore.open(url, "open", clock=clock) as kb:
        assert kb.truth("(raining)") is Truth.UNKNOWN
    with pytest.raises(kbstore.KbStoreError, match="use_unknowns"):
        kbstore.open(url, "open", clock=clock, use_unknowns=False)
    with kbstore.open(url, "closed", clock=clock) as kb:
        assert kb.truth("(raining)") is Truth.FALSE
    with pytest.raises(kbstore.KbStoreError, match="use_unknowns"):
        kbstore.open(url, "closed", clock=clock, use_unknowns=True)


def test_a_truth_has_no_truth_value():
    """V2: unknown is neither true nor false; the error of `bool()` says what to use."""
    with pytest.raises(TypeError, match="holds"):
        bool(Truth.TRUE)


# -- V6 -----------------------------------------------------------------------------------------------------------


def test_holds_is_true_exactly_when_the_truth_is(kb, open_world):
    """V6: unknown and false do not hold."""
    for world in (kb, open_world):
        world.add("(open wp0)", "(not (open wp1))")
        for text in (
            "(open wp0)",
            "(open wp1)",
            "(open hall)",
            "(not (open wp0))",
            "(not (open wp1))",
            "(not (open hall))",
        ):
            assert world.holds(text) is (world.truth(text) is Truth.TRUE)


def test_explain_gives_the_reason_and_its_transaction(kb, clock):
    """V6: asserted, explicitly false, never told, removed, expired with its instance."""
    added = kb.add("(open wp0)", "(not (open wp1))", "(near kenny wp1)", "(clean hall)")
    clock.set(START + 10)
    removed = kb.remove("(clean hall)")
    gone = kb.remove("kenny")
    reasons = {
        "(open wp0)": ("asserted", added.number),
        "(open wp1)": ("explicitly false", added.number),
        "(raining)": ("never told", None),
        "(clean hall)": ("removed", removed.number),
        "(near kenny wp1)": ("expired with its instance", gone.number),
    }
    for text, (reason, number) in reasons.items():
        explanation = kb.explain(text)
        assert explanation.reason == reason, text
        assert (explanation.transaction.number if explanation.transaction else None) == number, text


def test_explain_is_about_the_time_asked_for(kb, clock):
    """V6: the reason is the one at the time of the question."""
    added = kb.add("(raining)")
    clock.set(START + 10)
    kb.remove("(raining)")
    assert kb.explain("(raining)", at=START + 5).transaction.number == added.number
    assert kb.explain("(raining)", at=START - 1).reason == "never told"


def test_explain_names_an_undefined_function(kb):
    """V6: for a comparison that reads it."""
    assert "undefined" in str(kb.explain("(> (battery kenny) 1)")).lower()


MOVING = """
(define (domain moving)
  (:types thing)
  (:predicates (seen ?t - thing) (low) (busy))
  (:functions (level))
  (:derived (low) (< (level) 4)))
"""


@pytest.fixture
def tank(open_kb, clock):
    """A level that falls from 10 by 1 a second from START + 10 s on; a and b, of which a is seen until START + 20 s."""
    kb = open_kb()
    kb.load(MOVING)
    kb.add("a - thing", "b - thing", "(seen a)")
    clock.set(START + seconds(10))
    kb.add("(= (level) 10)", "(increase (level) (* #t -1))", client="gauge")
    clock.set(START + seconds(20))
    kb.remove("(seen a)", client="camera")
    clock.set(START + seconds(30))
    return kb


@pytest.mark.parametrize(
    ("condition", "since", "client"),
    [
        # the level is 5 at 15 s, and 4 at 16 s
        ("(> (level) 5)", seconds(15), "gauge"),
        ("(<= (level) 5)", seconds(15), "gauge"),
        ("(not (> (level) 5))", seconds(15), "gauge"),
        ("(or (busy) (> (level) 5))", seconds(15), "gauge"),
        ("(low)", seconds(16) + 1, None),
        ("(exists (?t - thing) (seen ?t))", seconds(20), "camera"),
        ("(seen ?)", seconds(20), "camera"),
        ("(forall (?t - thing) (not (seen ?t)))", seconds(20), "camera"),
        ("(and (forall (?t - thing) (not (seen ?t))) (> (level) 5))", 0, ""),
        ("(and (not (= a b)) (> (level) 5))", seconds(15), "gauge"),
        ("(> (level) 20)", seconds(10), "gauge"),
        ("(busy)", None, None),
        ("(and (busy) (= a b))", None, None),
        # always so, independently of the facts that make it so now
        ("(imply (seen a) (not (busy)))", None, None),
        ("(= a b)", None, None),
    ],
)
def test_explain_says_since_when(tank, condition, since, client):
    """V6: the truth of a condition may change by the clock, and by objects that do not decide it any more."""
    explanation = tank.explain(condition)
    assert explanation.since == (None if since is None else START + since)
    assert (explanation.transaction.client if explanation.transaction else None) == client


def test_explain_says_since_when_the_condition_has_failed(tank, clock):
    """V6: it was false before and after the last change of a part that decides it, which is one span."""
    with tank.transaction(client="pump") as tx:
        tx.add("(= (level) 2)")
        assert tx.state().explain("(> (level) 5)").since == START + seconds(15)
        tx.add("(= (level) 7)")
        assert tx.state().explain("(> (level) 5)").since == START + seconds(30)
    clock.set(START + seconds(40))
    tank.add("(= (level) 3)", client="leak")
    clock.set(START + seconds(5000))
    tank.add("(= (level) 2)", client="leak")
    found = tank.explain("(> (level) 5)")
    assert (found.since, found.transaction.time) == (START + seconds(40), START + seconds(40))
    assert tank.explain("(> (level) 5)", at=START + seconds(35)).since == START + seconds(30)
    assert tank.explain("(exists (?t - thing) (seen ?t))").since == START + seconds(20)


DRYING = """
(define (domain drying)
  (:types sheet)
  (:constants Linen - sheet)
  (:predicates (dry ?s - sheet) (wet ?s - sheet) (hung ?s - sheet))
  (:functions (water ?s - sheet))
  (:durative-action hang
    :parameters (?s - sheet)
    :duration (= ?duration 10)
    :effect (and (at start (hung ?s)) (at end (dry ?s)) (at end (not (wet ?s))) (at end (assign (water ?s) 1)))))
"""


def test_explain_names_the_action_that_is_expected_to_make_it_so(open_kb, clock):
    """V6, O3: an expected effect is the reason, not the assertion before it."""
    kb = open_kb()
    kb.load(DRYING)
    added = kb.add("(wet linen)", "(= (water linen) 5)", client="laundry")
    clock.set(START + seconds(1))
    kb.start("hang", "Linen", client="maid")
    end = START + seconds(11)
    clock.set(START + seconds(2))
    kb.add("(wet linen)", initial_time=end + seconds(9), client="forecast")

    for text in ("(dry linen)", "(wet linen)", "(exists (?s - sheet) (dry ?s))", "(not (wet linen))"):
        found = kb.explain(text, at=end)
        assert (found.reason, found.since) == ("expected at the end of (hang Linen)", end), text
        assert found.transaction.client == "maid"
    found = kb.explain("(> (water linen) 3)", at=end)
    assert (found.truth, found.since, found.transaction.client) == (Truth.FALSE, end, "maid")
    assert kb.explain("(hung linen)", at=end).reason == "asserted"
    assert "(dry Linen)" in facts(kb, end)
    assert kb.explain("(wet linen)", at=end - 1).transaction.number == added.number
    assert kb.explain("(dry linen)", at=end - 1).reason == "never told"
    assert kb.explain("(wet linen)", at=end + seconds(9)).transaction.client == "forecast"
    assert kb.explain("(dry linen)", at=end, as_of=added).reason == "never told"

    clock.set(START + seconds(5))
    kb.abort(kb.state().running[0])
    assert kb.explain("(dry linen)", at=end).reason == "never told"
    assert kb.explain("(dry linen)", at=end, as_of=START + seconds(4)).reason == "expected at the end of (hang Linen)"


# -- V7 -----------------------------------------------------------------------------------------------------------


def test_a_wildcard_in_a_question_is_an_exists(kb):
    """V7: `?`, `?name` and an empty argument match any object of the parameter's type."""
    assert not kb.holds("(near kenny ?)")
    kb.add("(near kenny wp1)")
    assert kb.holds("(near kenny ?)")
    assert kb.holds("(near ?r ?p)")
    assert kb.holds(Fact(attribute_name="near", values=["", "wp1"]))
    assert not kb.holds("(near ? wp0)")


def test_two_wildcards_do_not_join(kb):
    """V7: the same name twice is two wildcards."""
    kb.add("(= (distance wp0 wp1) 5)")
    assert kb.holds(Function(attribute_name="distance", values=["?x", "?x"]))


def test_not_applies_outside_the_wildcard(kb):
    """V7: `(not (open ?))` means that no place is open, as text and as an item."""
    assert kb.holds("(not (open ?))")
    kb.add("(not (open wp0))")
    assert kb.holds("(not (open ?))")
    kb.add("(open wp1)")
    assert not kb.holds("(not (open ?))")
    assert not kb.holds(Fact(attribute_name="open", values=["?"], is_negative=True))


def test_a_wildcard_in_an_open_world_follows_the_exists(open_world):
    """V7, V2: true if one is, false only if all are, else unknown."""
    assert open_world.truth("(clean ?)") is Truth.UNKNOWN
    open_world.add("(not (clean hall))")
    assert open_world.truth("(clean ?)") is Truth.UNKNOWN
    open_world.add("(not (clean galley))")
    assert open_world.truth("(clean ?)") is Truth.FALSE
    assert open_world.truth("(not (clean ?))") is Truth.TRUE
    open_world.add("(clean hall)")
    assert open_world.truth("(clean ?)") is Truth.TRUE


def test_a_negative_pattern_in_a_removal_matches_explicit_negatives(kb):
    """V7: in a removal `not` is the sign of what is removed."""
    kb.add("(open wp0)", "(not (open wp1))", "(not (open hall))")
    kb.remove("(not (open ?))")
    assert facts(kb) == ["(open wp0)"]


def test_a_wildcard_in_a_comparison_is_refused(kb):
    """V7: the error says what to write."""
    kb.add("(= (battery kenny) 5)")
    with pytest.raises(kbstore.KbStoreError, match="exists"):
        kb.holds("(> (battery ?) 3)")


def test_a_function_item_asks_whether_it_is_defined_or_equal(kb):
    """V7: without a value whether it is defined, with one whether it is equal."""
    battery = Function(attribute_name="battery", values=["kenny"])
    assert not kb.holds(battery)
    kb.add("(= (battery kenny) 5)")
    assert kb.holds(battery)
    assert kb.holds(Function(attribute_name="battery", values=["kenny"], function_value=5))
    assert not kb.holds(Function(attribute_name="battery", values=["kenny"], function_value=6))
    assert kb.holds("(= (battery kenny) 5)")


def test_a_query_takes_several_items(kb):
    """V6, V7: `all_true`, one result for each item, and those that do not hold."""
    kb.add("(open wp0)", "(= (battery kenny) 5)")
    result = kb.query("(open wp0)", "(not (open wp0))", "(= (battery kenny) 5)", "(> (battery kenny) 7)", "wp0 - place")
    assert result.all_true is False
    assert list(result.results) == [True, False, True, False, True]
    assert [str(item) for item in result.false_knowledge] == ["(not (open wp0))", "(> (battery kenny) 7)"]
    assert kb.query("(open wp0)").all_true is True


def test_a_query_of_conditions_names_those_that_do_not_hold(kb):
    """V4, V6: a condition in a query is an item like any other, and is named by its text."""
    kb.add("(open wp0)")
    true, false = "(or (open wp1) (open wp0))", "(or (open wp1) (not (open wp0)))"
    result = kb.query(true, "(open wp1)", false, "(forall (?p - place) (open ?p))")
    assert (result.all_true, list(result.results)) == (False, [True, False, False, False])
    assert [str(item) for item in result.false_knowledge] == ["(open wp1)", false, "(forall (?p - place) (open ?p))"]
    assert kb.query(true).false_knowledge == []


def test_the_goals_can_be_given_to_a_query(kb):
    """V6, C10: goals that are conditions, too."""
    kb.add("(open wp0)")
    kb.add_goal("(and (open wp0) (or (open wp1) (not (open wp0))) (exists (?p - place) (open ?p)) (open wp1))")
    result = kb.query(*kb.goals())
    truth = dict(zip(map(str, kb.goals()), result.results, strict=True))
    assert truth == {
        "(open wp0)": True,
        "(open wp1)": False,
        "(or (open wp1) (not (open wp0)))": False,
        "(exists (?p - place) (open ?p))": True,
    }
    assert {str(item) for item in result.false_knowledge} == {"(open wp1)", "(or (open wp1) (not (open wp0)))"}


def test_unknown_is_false_in_a_query(open_world):
    """V6: a result is a bool."""
    assert list(open_world.query("(open wp0)", "(not (open wp0))").results) == [False, False]


def test_an_object_can_be_asked_for(kb, clock):
    """V7: an INSTANCE item asks whether the object exists and is of that type or a subtype."""
    assert kb.holds("galley - kitchen")
    assert kb.holds("galley - place")
    assert not kb.holds("wp0 - room")
    assert not kb.holds("nobody - robot")
    assert not kb.holds("galley - kitchen", at=START - 1)


# -- V8 -----------------------------------------------------------------------------------------------------------


def test_a_question_may_name_objects_that_do_not_exist(kb, open_world):
    """V8: facts about it are absent."""
    for world, absent in ((kb, Truth.FALSE), (open_world, Truth.UNKNOWN)):
        assert world.truth("(near nobody nowhere)") is absent
    assert kb.holds("(not (near nobody nowhere))")


@pytest.mark.parametrize(
    "question", ["(flying kenny)", "(> (speed kenny) 3)", "kenny - dragon", "(exists (?d - dragon) (open ?d))"]
)
def test_a_symbol_that_the_domain_lacks_is_an_unknown_symbol(kb, question):
    """V8: predicate, function, type; the message has the name."""
    with pytest.raises(kbstore.UnknownSymbol, match=r"flying|speed|dragon"):
        kb.holds(question)


def test_an_unknown_function_or_operator_is_an_unknown_symbol(kb):
    """V8: also where a value is asked for."""
    with pytest.raises(kbstore.UnknownSymbol, match="speed"):
        kb.value("(speed kenny)")
    with pytest.raises(kbstore.UnknownSymbol, match="flying"):
        kb.domain.predicate("flying")
    with pytest.raises(kbstore.UnknownSymbol, match="speed"):
        kb.domain.function("speed")


def test_a_name_with_a_space_matches_no_two_names(bare):
    """V8, D3: no such name is stored, so the fact is absent in questions, removals and patterns."""
    bare.add("(near kenny wp0)", "(= (distance wp0 wp1) 3)", "(p)")
    facts = [
        Fact(attribute_name="near kenny", values=["wp0"]),
        Fact(attribute_name="near", values=["kenny wp0"]),
        Fact(attribute_name="near kenny wp0"),
    ]
    function = Function(attribute_name="distance wp0", values=["wp1"])
    for fact in facts:
        assert not bare.holds(fact)
        assert not bare.state().holds(fact)
        assert bare.when(fact, since=START, until=START + 1) == []
        assert bare.explain(fact).reason == "never told"
    assert not bare.holds(function)
    assert not bare.state().holds(function)
    with pytest.raises(kbstore.UndefinedFunction):
        bare.value(function)
    assert bare.history(facts[0]) == bare.history(function) == []
    assert bare.remove(facts[0], function).changes == 0
    assert bare.holds("(near kenny wp0)")


def test_the_value_of_an_undefined_function_is_an_error(kb, clock):
    """V5, C7: it is not 0."""
    with pytest.raises(kbstore.UndefinedFunction, match=r"battery kenny"):
        kb.value("(battery kenny)")
    clock.set(START + seconds(1))
    kb.add("(= (battery kenny) 5)")
    with pytest.raises(kbstore.UndefinedFunction):
        kb.value("(battery kenny)", at=START)
    assert kb.value("(battery kenny)") == 5
    assert kb.truth("(> (cost) 1)") is Truth.UNKNOWN
    assert not kb.holds("(not (> (cost) 1))")
