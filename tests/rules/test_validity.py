"""Rules D1 to D4: validation before anything is written, and the domain's part in it."""

import hashlib
import re

import pytest

import kbstore
from kbstore import (
    ComparisonType,
    DomainFormula,
    DomainInequality,
    ExprBase,
    ExprComposite,
    Expression,
    ExprType,
    Fact,
    Function,
    Inequality,
    Instance,
    Truth,
    UpdateType,
    seconds,
)
from tests.conftest import DOMAIN, OBJECTS, START
from tests.rules.reading import facts, instances, picture, scheduled, texts

DEEP = 100_000


def function_token(name, **values):
    formula = DomainFormula(name=name, typed_parameters=values)
    return ExprBase(expr_type=ExprType.FUNCTION, function=formula)


def inequality(comparison, left, right):
    ineq = DomainInequality(
        comparison_type=comparison, LHS=ExprComposite(tokens=left), RHS=ExprComposite(tokens=right), grounded=True
    )
    return Inequality(ineq=ineq)


def near(**values):
    return Fact(attribute_name="near", values=values)


# -- D1: what is wrong with one item ------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("text", "offender", "expected"),
    [
        ("(flying kenny)", "flying", ""),
        ("(= (speed kenny) 3)", "speed", ""),
        ("kit - dragon", "dragon", ""),
        ("(> (speed kenny) 3)", "speed", ""),
        ("minimize (speed kenny)", "speed", ""),
        ("(open wp0 wp1)", r"\(open wp0 wp1\)", "place"),
        ("(near kenny)", r"\(near kenny\)", "place"),
        ("(raining wp0)", r"\(raining wp0\)", ""),
        ("(= (battery) 3)", "battery", "robot"),
        ("(= (cost kenny) 3)", "cost kenny", ""),
        ("(open nowhere)", "nowhere", "exist"),
        ("(not (open nowhere))", "nowhere", "exist"),
        ("(= (battery nobody) 3)", "nobody", "exist"),
        ("(> (battery nobody) 3)", "nobody", "exist"),
        ("minimize (battery nobody)", "nobody", "exist"),
        ("(open kenny)", "kenny", "place"),
        ("(near wp0 kenny)", "wp0", "robot"),
        ("(clean wp0)", "wp0", "room"),
        ("(= (battery cup) 3)", "cup", "robot"),
        ("(tagged hall)", "hall", "robot"),
        ("(open ?)", r"\?", ""),
        ("(open ?p)", r"\?p", ""),
        ("(= (battery ?) 3)", r"\?", ""),
    ],
)
def test_items_that_do_not_fit_the_domain_are_refused(kb, text, offender, expected):
    """D1: the message has the item in PDDL and what was expected; nothing is stored, for now or for later."""
    before = picture(kb)
    for options in ({}, {"initial_time": START + 10}):
        with pytest.raises(kbstore.InvalidKnowledge, match=offender) as refusal:
            kb.add(text, **options)
        assert expected in str(refusal.value)
    assert picture(kb) == before


def test_subtypes_constants_and_either_types_fit(kb):
    """D1: an argument is of the declared type or a subtype, at any depth, and may be a constant."""
    kb.add("(open galley)", "(open hall)", "(open home)", "(clean galley)", "(tagged kenny)", "(tagged cup)")
    assert len(facts(kb)) == 6


def test_labels_may_come_in_any_order(kb):
    """D1: they are stored in the domain's order."""
    kb.add(
        near(p="wp0", who="kenny"),
        Function(attribute_name="distance", values={"to": "wp1", "from": "wp0"}, function_value=5),
    )
    (fact,) = kb.state().facts
    assert str(fact) == "(near kenny wp0)"
    assert [value.key for value in fact.values] == ["who", "p"]
    assert kb.value("(distance wp0 wp1)") == 5
    assert kb.holds(near(p="wp0", who="kenny"))
    assert kb.add(near(who="kenny", p="wp0")).changes == 0
    assert kb.remove(near(p="wp0", who="?")).changes == 1


def test_labels_in_expressions_may_come_in_any_order(kb, clock):
    """D1: in an inequality, a metric, a goal and an expression in a question, as in a fact."""
    kb.add("(= (distance wp0 wp1) 1)", "(= (distance wp1 wp0) 2)")
    swapped = function_token("distance", to="wp1", **{"from": "wp0"})
    distance = ExprComposite(tokens=[swapped])
    statement = inequality(ComparisonType.EQUALS, [swapped], [ExprBase.of(1)])
    metric = Expression(optimization="minimize", expr=distance)
    assert kb.value(distance) == 1
    assert kb.value(metric) == 1
    assert kb.holds(statement)
    kb.add(statement)
    kb.add_goal(statement)
    kb.add_metric(metric)
    state = kb.state()
    assert texts(state.inequalities) == texts(state.goals) == ["(= (distance wp0 wp1) 1)"]
    assert str(state.metric) == "minimize (distance wp0 wp1)"
    (token,) = state.inequalities[0].ineq.LHS.tokens
    assert [(p.key, p.value) for p in token.function.typed_parameters] == [("from", "wp0"), ("to", "wp1")]
    assert state.metric.expr == state.inequalities[0].ineq.LHS
    clock.set(START + 10)
    assert kb.add(*state.inequalities, state.metric).changes == 0
    assert kb.remove(statement).changes == kb.remove_goal(statement).changes == kb.remove_metric(metric).changes == 1


def test_wrong_labels_in_expressions_are_refused(kb):
    """D1: in knowledge and in questions."""
    wrong = function_token("distance", to="wp1", start="wp0")
    statement = inequality(ComparisonType.EQUALS, [wrong], [ExprBase.of(1)])
    for use in (kb.add, kb.add_goal, kb.remove, kb.remove_goal, kb.holds):
        with pytest.raises(kbstore.InvalidKnowledge, match="start"):
            use(statement)
    with pytest.raises(kbstore.InvalidKnowledge, match="start"):
        kb.value(ExprComposite(tokens=[wrong]))


@pytest.mark.parametrize("values", [{"who": "kenny", "where": "wp0"}, {"who": "kenny"}, {"x": "kenny", "y": "wp0"}])
def test_unknown_or_missing_labels_are_refused(kb, values):
    """D1: the message has the labels of the domain."""
    with pytest.raises(kbstore.InvalidKnowledge, match="near"):
        kb.add(near(**values))
    assert facts(kb) == []


def away(**values):
    """The token of a message's expression that reads the distance."""
    parameters = [{"key": label, "value": name} for label, name in values.items()]
    return {"expr_type": 1, "function": {"name": "distance", "typed_parameters": parameters}}


def compared(comparison, constant, **values):
    """A message that compares the distance with a number."""
    right = {"tokens": [{"expr_type": 0, "constant": constant}]}
    return {
        "knowledge_type": 4,
        "ineq": {"comparison_type": comparison, "LHS": {"tokens": [away(**values)]}, "RHS": right, "grounded": True},
    }


def measured(**values):
    """A message with a metric that is the distance."""
    return {"knowledge_type": 3, "optimization": "minimize", "expr": {"tokens": [away(**values)]}}


@pytest.fixture
def walks(kb):
    """From wp0 it is 7 to wp1, which is 9 back."""
    kb.add("(= (distance wp0 wp1) 7)", "(= (distance wp1 wp0) 9)")
    return kb


@pytest.mark.parametrize("values", [{"from": "wp0", "to": "wp1"}, {"to": "wp1", "from": "wp0"}])
def test_labels_of_functions_in_messages_may_come_in_any_order(walks, values):
    """D1: labels of the functions that an inequality or a metric reads, in questions and in knowledge."""
    seven = compared(4, 7.0, **values)
    assert walks.truth(seven) is Truth.TRUE
    assert walks.query(seven, Inequality.model_validate(seven)).results == [True, True]
    assert walks.when(seven, START, START + 1) == [(START, START + 1)]
    assert walks.value(measured(**values)) == walks.value(Expression.model_validate(measured(**values)).expr) == 7
    walks.add_goal(seven)
    walks.add_goal(Inequality.model_validate(seven))
    walks.add(compared(1, 7.0, **values))
    walks.add_metric(measured(**values))
    assert [str(goal) for goal in walks.goals()] == ["(= (distance wp0 wp1) 7)"]
    assert [str(item) for item in walks.state().inequalities] == ["(>= (distance wp0 wp1) 7)"]
    assert str(walks.metric()) == "minimize (distance wp0 wp1)"
    assert len(walks.history(compared(1, 7.0, **values))) == 1
    assert str(kbstore.item(measured(**values), walks.domain)) == "minimize (distance wp0 wp1)"
    assert walks.remove(compared(1, 7.0, **values)).changes == 1
    assert walks.remove_goal(seven).changes == walks.remove_metric(measured(**values)).changes == 1


@pytest.mark.parametrize("values", [{"from": "wp0", "via": "wp1"}, {"from": "wp0", "": "wp1"}])
def test_unknown_labels_in_expressions_are_refused(walks, values):
    """D1: as those of facts and functions are; nothing is stored, and nothing answered."""
    before = picture(walks)
    for method in ("add", "remove", "add_goal", "remove_goal", "holds", "query"):
        with pytest.raises(kbstore.InvalidKnowledge, match="from, to"):
            getattr(walks, method)(compared(4, 7.0, **values))
    for method in ("add_metric", "remove_metric", "value"):
        with pytest.raises(kbstore.InvalidKnowledge, match="from, to"):
            getattr(walks, method)(measured(**values))
    assert picture(walks) == before


def test_functions_in_expressions_have_the_domains_labels(walks):
    """D1: in results, as the arguments of facts and functions have."""
    walks.add_goal("(> (distance wp0 wp1) 7)")
    walks.add("(> (distance wp0 wp1) 7)")
    walks.add_metric("minimize (distance wp0 wp1)")
    state = walks.state()
    for composite in (state.goals[0].ineq.LHS, state.inequalities[0].ineq.LHS, state.metric.expr):
        assert [(p.key, p.value) for p in composite.tokens[0].function.typed_parameters] == [
            ("from", "wp0"),
            ("to", "wp1"),
        ]


def test_a_label_twice_is_refused(kb):
    """D1: one argument for each parameter."""
    with pytest.raises(kbstore.InvalidKnowledge):
        kb.add(
            {
                "knowledge_type": 1,
                "attribute_name": "near",
                "values": [{"key": "who", "value": "kenny"}, {"key": "who", "value": "kenny"}],
            }
        )


def test_an_argument_must_exist_at_the_items_time(kb, clock):
    """D1: not only at now; scheduled starts and ends of objects count."""
    kb.add("box - item", initial_time=START + 10)
    kb.add("(not (box - item))", initial_time=START + 20)
    for at in (None, START + 9, START + 20):
        with pytest.raises(kbstore.InvalidKnowledge, match="box"):
            kb.add("(tagged box)", initial_time=at)
    for at in (10, 19):
        kb.add("(tagged box)", initial_time=START + at)
    assert scheduled(kb) == [
        (START + 10, "(tagged box)"),
        (START + 10, "box - item"),
        (START + 19, "(tagged box)"),
        (START + 20, "(not (box - item))"),
    ]


def test_an_argument_may_be_added_earlier_in_the_same_transaction(kb):
    """D1, C1: earlier, not later."""
    kb.add("box - item", "(tagged box)")
    with pytest.raises(kbstore.InvalidKnowledge, match="crate"):
        kb.add("(tagged crate)", "crate - item")
    with pytest.raises(kbstore.InvalidKnowledge, match="box"), kb.transaction() as tx:
        _remove_and_mention(tx)
    assert facts(kb) == ["(tagged box)"]


def _remove_and_mention(tx):
    tx.remove("box")
    tx.add("(not (tagged box))")


# -- D1: all violations together ----------------------------------------------------------------------------------


def test_all_violations_of_a_transaction_are_reported_together(kb):
    """D1: in one `InvalidKnowledge`, each naming its item."""
    bad = ["(flying kenny)", "(open nowhere)", "(near wp0 wp0)", "(clean wp0)", "kit - dragon"]
    with pytest.raises(kbstore.InvalidKnowledge) as refusal:
        kb.add("(raining)", *bad, "(open wp0)")
    assert len(refusal.value.violations) == len(bad)
    for text, violation in zip(bad, refusal.value.violations, strict=True):
        assert text in violation
        assert text in str(refusal.value)
    assert facts(kb) == []


def test_violations_come_before_any_other_error(kb):
    """D1: also where the other error comes first in the transaction."""
    with pytest.raises(kbstore.InvalidKnowledge, match="flying"):
        kb.add("(increase (cost) 3)", "(flying kenny)")
    later = Function(attribute_name="cost", function_value=1, assign_op=1, initial_time=START + 10)
    with pytest.raises(kbstore.InvalidKnowledge, match="flying"):
        kb.add(later, "(flying kenny)")


def test_a_bad_item_at_the_end_of_ten_thousand_good_ones(kb):
    """D1, C1: nothing is stored."""
    good = [Instance(instance_name=f"w{index}", instance_type="place") for index in range(10_000)]
    before = instances(kb)
    with pytest.raises(kbstore.InvalidKnowledge, match="nowhere") as refusal:
        kb.add(*good, "(open nowhere)")
    assert len(refusal.value.violations) == 1
    assert instances(kb) == before
    assert kb.add("(raining)").number == 3


def test_a_violation_in_a_file_names_file_and_line(kb, tmp_path):
    """D1: for items that come from a file."""
    problem = tmp_path / "task.pddl"
    problem.write_text(
        "(define (problem task)\n  (:domain rooms)\n  (:objects w7 - place)\n"
        "  (:init (open w7)\n         (open kenny))\n  (:goal (open w7)))\n"
    )
    with pytest.raises(kbstore.KbStoreError, match=r"task\.pddl:5"):
        kb.load(DOMAIN, problem)
    assert facts(kb) == []


# -- bad input ----------------------------------------------------------------------------------------------------

BAD_NAMES = [
    "",
    "a b",
    "a\tb",
    "a\nb",
    "a(b",
    "a)b",
    "a;b",
    'a"b',
    "a'b",
    "?a",
    "a\x00b",
    "a\x1bb",
    "a\x7fb",
    "a\u202eb",
    "a\ud800b",
    "a" * 256,
]


@pytest.mark.parametrize("has_domain", [False, True])
@pytest.mark.parametrize(
    ("method", "first"),
    [
        ("add_goal", "(> (level Base) (+ (level Base) 1))"),
        ("add_goal", "(or (wet Base) (forall (?p - object) (imply (wet ?p) (wet Base))))"),
        ("add_goal", "(or (wet Base) (not (= Base Base)))"),
        ("add_metric", "minimize (level Base)"),
        ("add", "(<= (level Base) 3)"),
        ("add", "(wet Base)"),
    ],
)
def test_a_name_is_shown_as_it_was_first_written(bare, has_domain, method, first):
    """D3: also where a goal, a metric or the domain was the first to mention it."""
    if has_domain:
        bare.load(
            "(define (domain d) (:types place) (:constants Base - place)"
            " (:predicates (wet ?p - place) (dry ?p - place)) (:functions (level ?p - place)))"
        )
    getattr(bare, method)(first)
    bare.add("(dry base)", "(= (level BASE) 2)")
    assert "(dry Base)" in facts(bare)
    assert [str(item) for item in bare.functions()] == ["(= (level Base) 2)"]


@pytest.mark.parametrize("name", BAD_NAMES)
def test_names_that_pddl_cannot_read_back_are_refused(kb, bare, name):
    """D3: white space, brackets, quotes, `;`, a leading `?`, control characters, more than 255 characters."""
    for world in (kb, bare):
        with pytest.raises(kbstore.InvalidKnowledge):
            world.add(Instance(instance_name=name, instance_type="place"))
    with pytest.raises(kbstore.InvalidKnowledge):
        bare.add(Instance(instance_name="wp0", instance_type=name or "a b"))
    with pytest.raises(kbstore.InvalidKnowledge):
        bare.add(Fact(attribute_name=name, values=["wp0"]))
    with pytest.raises(kbstore.InvalidKnowledge):
        bare.add(Fact(attribute_name="open", values=[name]))
    with pytest.raises(kbstore.InvalidKnowledge):
        bare.add(Function(attribute_name=name, function_value=1))
    assert [change.number for change in bare.changes()] == []


@pytest.fixture
def one_kb():
    """A knowledge base in memory, for tests that do not depend on the store."""
    with kbstore.open("sqlite://", clock=kbstore.ManualClock(START)) as kb:
        kb.load(DOMAIN)
        kb.add(*OBJECTS)
        yield kb


@pytest.mark.parametrize(
    ("text", "methods"),
    [
        ("(" * DEEP, ("add", "add_goal", "add_metric", "remove", "holds", "history")),
        (")" * DEEP, ("add", "add_goal", "add_metric", "remove", "holds", "history")),
        ("(not " * DEEP + "(raining)" + ")" * DEEP, ("add", "add_goal", "holds", "explain")),
        ("(and " * DEEP + "(raining)" + ")" * DEEP, ("add", "holds")),
        ("(or " * DEEP + "(raining)" + ")" * DEEP, ("add_goal",)),
        ("(imply (raining) " * DEEP + "(raining)" + ")" * DEEP, ("truth",)),
        ("(exists (?x - room) " * DEEP + "(raining)" + ")" * DEEP, ("add_goal",)),
        ("(> " + "(- " * DEEP + "1" + ")" * DEEP + " 3)", ("add",)),
        ("minimize " + "(+ 1 " * DEEP + "1" + ")" * DEEP, ("add_metric",)),
    ],
    ids=["open", "close", "not", "and", "or", "imply", "exists", "minus", "plus"],
)
def test_text_nested_very_deep_is_stored_or_refused(one_kb, text, methods):
    """D1: a result or an error of kbstore's, never Python's recursion limit; the message stays readable."""
    for method in methods:
        try:
            getattr(one_kb, method)(text)
        except kbstore.KbStoreError as refusal:
            reason = str(refusal)
        else:
            reason = ""
        assert len(reason) < 2_000
    one_kb.add("(open wp0)")
    assert one_kb.holds("(open wp0)")


@pytest.mark.parametrize("kind", ["goal", "inequality", "metric"])
def test_long_formulas_are_stored(bare, kind):
    """C10, C11: a goal, an inequality or a metric of tens of thousands of characters is added twice, and removed."""
    terms = [f"(cost-{hashlib.sha256(str(index).encode()).hexdigest()})" for index in range(500)]
    total = f"(+ {' '.join(terms)})"
    text = {"goal": f"(or {' '.join(terms)})", "inequality": f"(> {total} 1)", "metric": f"minimize {total}"}[kind]
    add, remove = {
        "goal": (bare.add_goal, bare.remove_goal),
        "inequality": (bare.add, bare.remove),
        "metric": (bare.add_metric, bare.remove_metric),
    }[kind]
    assert add(text).changes == 1
    assert add(text).changes == 0
    assert remove(text).changes == 1


@pytest.mark.parametrize(
    "text",
    ["", "   ", "(", ")", "()", "(open wp0", "(open wp0))", "(open wp0) (open wp1)", "open wp0", "(= 3)", "- place"],
)
def test_text_that_is_not_an_item_is_refused(kb, text):
    """D1: with a typed error."""
    with pytest.raises(kbstore.KbStoreError):
        kb.add(text)


@pytest.mark.parametrize("kind", [6, -1, "add", None])
def test_an_unknown_kind_of_update_is_refused(kb, kind):
    """D1, C1: it is a violation beside the others; the message lists the kinds, and nothing is stored."""
    before = picture(kb)
    with pytest.raises(kbstore.InvalidKnowledge, match="REMOVE_METRIC 5") as refusal:
        kb.update([(UpdateType.ADD_KNOWLEDGE, "(raining)"), (kind, "(raining)"), (0, "(no_such_thing)")])
    assert len(refusal.value.violations) == 2
    assert picture(kb) == before


@pytest.mark.parametrize("update", [(9, "(raining)"), ("(raining)", 0), "(raining)", (0,), (0, "(raining)", 1), None])
def test_anything_but_an_update_is_refused(kb, update):
    """D1, C1: with a typed error that names the kinds; the other updates are not applied."""
    with pytest.raises(kbstore.InvalidKnowledge, match="ADD_KNOWLEDGE 0"):
        kb.update([(kbstore.UpdateType.ADD_KNOWLEDGE, "(open wp0)"), update])
    assert facts(kb) == []


@pytest.mark.parametrize("thing", [None, 3, 2.5, b"(raining)", object(), {}, {"knowledge_type": 9}, ["(raining)"]])
def test_anything_but_knowledge_is_refused(kb, thing):
    """D1: with a typed error, in every method."""
    for method in ("add", "remove", "add_goal", "holds"):
        with pytest.raises(kbstore.KbStoreError):
            getattr(kb, method)(thing)
    assert facts(kb) == []


@pytest.mark.parametrize("text", ["(= (cost) nan)", "(= (cost) inf)", "(= (cost) 1e999)", "(= (cost) ten)"])
def test_values_in_text_have_to_be_finite(kb, text):
    """C7, D1: in text, too."""
    with pytest.raises(kbstore.KbStoreError):
        kb.add(text)
    assert kb.state().functions == []


# -- D2 -----------------------------------------------------------------------------------------------------------


def test_without_a_domain_only_the_shape_is_checked(bare):
    """D2: objects need not exist, and symbols need not be declared."""
    bare.add("(open nowhere)", "(= (battery nobody) 3)", "kenny - robot", "(> (cost) 3)")
    assert facts(bare) == ["(open nowhere)"]


@pytest.mark.parametrize(("first", "second"), [("(open a)", "(open a b)"), ("(= (f a) 1)", "(= (f) 1)")])
def test_without_a_domain_a_symbol_keeps_the_arity_of_its_first_use(bare, first, second):
    """D2: also after its facts have been removed."""
    bare.add(first)
    with pytest.raises(kbstore.InvalidKnowledge):
        bare.add(second)
    bare.clear()
    with pytest.raises(kbstore.InvalidKnowledge):
        bare.add(second)


@pytest.mark.parametrize("name", ["and", "NOT", "or", "imply", "exists", "forall", "=", ">", "increase", "minimize"])
def test_without_a_domain_a_predicate_is_not_named_like_a_word_of_pddl(bare, name):
    """D3: stored items can be read back from their text; `(and a)` would be something else."""
    for use in (bare.add, bare.add_goal):
        with pytest.raises(kbstore.InvalidKnowledge, match="another name"):
            use(Fact(attribute_name=name, values=["a", "b"]))
    assert facts(bare) == []


@pytest.mark.parametrize("name", ["+", "*", "/"])
def test_without_a_domain_a_function_is_not_named_like_an_operator(bare, name):
    """D3: as for predicates."""
    with pytest.raises(kbstore.InvalidKnowledge, match="another name"):
        bare.add(Function(attribute_name=name, values=["a"], function_value=1))


@pytest.mark.parametrize("text", ["(at a b)", "(over a)", "(when a b)", "(within a)", "(3d a)", "(= (total-cost) 0)"])
def test_without_a_domain_names_that_read_back_are_accepted(bare, text):
    """D3: also where PDDL uses the word elsewhere."""
    bare.add(text)
    assert texts((*bare.state().facts, *bare.state().functions)) == [text]
    assert bare.holds(text)


@pytest.mark.parametrize("first", ["(> (f a) 3)", "minimize (f a)"])
def test_without_a_domain_a_formula_may_be_a_symbols_first_use(bare, first):
    """D2: a recorded formula that reads f with one argument is a use of it."""
    bare.add(first)
    with pytest.raises(kbstore.InvalidKnowledge, match="first used with 1 argument"):
        bare.add("(= (f a b) 3)")
    with pytest.raises(kbstore.InvalidKnowledge, match="1 argument"):
        bare.add_goal("(or (p) (< (f a b) 3))")
    bare.add("(= (f a) 3)")
    bare.add(Function(attribute_name="f", values={"label": "b"}, function_value=4))
    assert bare.value("(f b)") == 4


def test_without_a_domain_questions_about_numbers_use_labels(bare):
    """D2: the labels of the first use, in any order."""
    bare.add(Function(attribute_name="f", values={"x": "a", "y": "b"}, function_value=1))
    bare.add(Function(attribute_name="f", values={"x": "b", "y": "a"}, function_value=2))
    assert bare.value(Function(attribute_name="f", values={"y": "b", "x": "a"})) == 1
    statement = inequality(ComparisonType.EQUALS, [function_token("f", y="b", x="a")], [ExprBase.of(1)])
    assert bare.holds(statement)
    bare.add(statement)
    assert texts(bare.state().inequalities) == ["(= (f a b) 1)"]


def test_without_a_domain_a_symbol_keeps_the_labels_of_its_first_use(bare):
    """D2: in the order of the first use."""
    bare.add(near(who="kenny", p="wp0"))
    bare.add(near(p="wp1", who="kenny"))
    assert facts(bare) == ["(near kenny wp0)", "(near kenny wp1)"]
    with pytest.raises(kbstore.InvalidKnowledge):
        bare.add(near(robot="kenny", place="wp0"))


def test_without_a_domain_a_question_asked_again_uses_labels_learned_since(bare):
    """D2: once labels and their order are known, the same item asks about other arguments."""
    bare.add("(near wp0 kenny)", "(= (distance wp0 wp1) 1)", "(= (distance wp1 wp0) 2)")
    fact = near(who="wp0", p="kenny")
    function = Function(attribute_name="distance", values={"to": "wp0", "from": "wp1"})
    assert [bare.holds(fact), bare.value(function), bare.holds(near(p="kenny", who="wp0"))] == [True, 1, False]
    bare.add(
        near(p="wp1", who="kenny"),
        Function(attribute_name="distance", values={"from": "a", "to": "b"}, function_value=3),
    )
    assert [bare.holds(fact), bare.value(function), bare.holds(near(p="kenny", who="wp0"))] == [False, 2, False]
    assert [bare.holds(near(who="kenny", p="wp0")), bare.holds(near(p="wp0", who="kenny"))] == [True, True]


def test_without_a_domain_a_name_means_the_predicate_once_there_is_one(bare):
    """D2: while only a function has the name, its text asks whether that is defined, also where it was asked before."""
    bare.add("(= (level tank) 1)")
    assert [bare.holds("(level tank)"), bare.holds("(level pool)")] == [True, False]
    bare.add(Fact(attribute_name="level", values=["pool"]))
    assert [bare.holds("(level tank)"), bare.holds("(level pool)")] == [False, True]
    assert [bare.state().holds("(level tank)"), bare.state().holds("(level pool)")] == [False, True]


# -- D3 -----------------------------------------------------------------------------------------------------------


def test_names_are_compared_without_case_and_shown_as_first_written(kb):
    """D3: for objects, predicates, functions and types."""
    kb.add("Box - ITEM", "(TAGGED bOX)", "(= (Battery KENNY) 3)")
    assert kb.add("(tagged box)", "box - item", "(= (battery kenny) 3)").changes == 0
    assert "Box - item" in [str(found).replace("ITEM", "item") for found in kb.state().instances]
    assert kb.holds("(Tagged BOX)")
    assert kb.value("(BATTERY kenny)") == 3
    (fact,) = kb.state().facts
    assert fact.arguments == ("Box",)
    assert kb.remove("(tAgged boX)").changes == 1


@pytest.mark.parametrize(
    ("add", "first", "again"),
    [
        ("add", "(> (battery Kit) (cost))", "(> (BATTERY kIT) (Cost))"),
        ("add", "(not (> (battery Kit) 3))", "(NOT (> (battery kit) 3.0))"),
        ("add_goal", "(> (battery Kit) 3)", "(> (battery KIT) 3)"),
        ("add_goal", "(or (near Kit home) (raining))", "(OR (Near kit HOME) (RAINING))"),
        ("add_goal", "(forall (?p - place) (near Kit ?p))", "(forall (?P - PLACE) (near kit ?P))"),
        ("add_metric", "minimize (battery Kit)", "MINIMIZE (Battery kit)"),
    ],
)
def test_a_formula_in_another_case_is_the_same(kb, clock, add, first, again):
    """D3, C2: adding it again changes nothing, for now or for later, and it is shown as first written."""
    kb.add("Kit - robot")
    later = START + 100
    assert getattr(kb, add)(again).changes == 1
    assert getattr(kb, add)(first).changes == 0
    assert getattr(kb, add)(first, initial_time=later).changes == 1
    clock.set(START + 10)
    assert getattr(kb, add)(again, initial_time=later).changes == 0
    state = kb.state()
    (shown,) = [str(item) for item in (*state.inequalities, *state.goals, state.metric) if item is not None]
    assert shown.replace("?P", "?p") == first


def test_a_type_in_another_case_is_the_same_without_a_domain(bare, clock):
    """D3, C2: for a current, a scheduled, and a removed and added object."""
    later = START + 100
    bare.add("wp0 - Place")
    bare.add("wp1 - Place", initial_time=later)
    clock.set(START + 10)
    assert bare.add("wp0 - PLACE").changes == 0
    assert bare.add("wp1 - place", initial_time=later).changes == 0
    with bare.transaction() as tx:
        tx.remove("wp0 - place")
        tx.add("wp0 - place")
    assert tx.result.changes == 0
    assert instances(bare, later) == ["wp0 - Place", "wp1 - Place"]


def test_case_is_that_of_str_lower(bare):
    """D3: names of other scripts are compared by `str.lower()`."""
    bare.add("(öffnet ÄTNA)")
    assert bare.holds("(ÖFFNET ätna)")
    assert bare.add("(Öffnet Ätna)").changes == 0


@pytest.mark.parametrize("name", ["a", "A-b_3", "9lives", "dock/2", "room.7", "ns:kenny", "廊下", "a" * 255])
def test_names_of_message_based_clients_are_accepted(kb, name):
    """D3: as far as the PDDL text can be read back."""
    kb.add(Instance(instance_name=name, instance_type="place"), Fact(attribute_name="open", values=[name]))
    assert facts(kb) == [f"(open {name})"]
    assert kb.holds(f"(open {name})")
    assert kb.remove(f"(open {name})").changes == 1


# -- D4 -----------------------------------------------------------------------------------------------------------

LARGER = DOMAIN.replace("(raining)", "(raining) (dusty ?p - place)").replace("domain rooms", "domain larger")


def test_loading_a_domain_is_a_transaction(open_kb, clock):
    """D4: the state at t is read with the domain at t."""
    kb = open_kb()
    first = kb.load(DOMAIN)
    kb.add(*OBJECTS)
    clock.set(START + 10)
    second = kb.load(LARGER)
    assert (first.number, second.number) == (1, 3)
    assert [kb.state(START + at).domain.name for at in (0, 9, 10, 11)] == ["rooms", "rooms", "larger", "larger"]
    assert kb.state(START - 1).domain is None
    assert kb.state(START + 20, as_of=first).domain.name == "rooms"
    assert kb.domain.name == "larger"
    assert not kb.holds("(dusty wp0)")
    with pytest.raises(kbstore.UnknownSymbol):
        kb.holds("(dusty wp0)", at=START + 9)


def test_marking_a_predicate_as_sensed_is_a_transaction(kb, clock):
    """D4: and has a time."""
    latest = kb.add("(raining)")
    clock.set(START + 10)
    marked = kb.set_sensed("open", True)
    assert marked.number == latest.number + 1
    assert kb.domain.is_sensed("open")
    assert not kb.state(START + 9).domain.is_sensed("open")
    assert not kb.domain.is_sensed("near")
    kb.set_sensed("open", False)
    assert not kb.domain.is_sensed("open")
    with pytest.raises(kbstore.UnknownSymbol):
        kb.set_sensed("flying", True)


@pytest.mark.parametrize(
    ("knowledge", "options"),
    [
        ("(raining)", {}),
        ("(not (raining))", {}),
        ("(raining)", {"initial_time": START + 100}),
        ("goal", {}),
    ],
)
def test_a_domain_that_invalidates_an_item_is_refused(kb, knowledge, options):
    """D4: current and scheduled items and goals are checked."""
    (kb.add_goal("(raining)") if knowledge == "goal" else kb.add(knowledge, **options))
    before = picture(kb)
    with pytest.raises(kbstore.InvalidKnowledge, match="raining"):
        kb.load(DOMAIN.replace("(raining)", ""))
    assert picture(kb) == before
    (kb.remove_goal("(raining)") if knowledge == "goal" else kb.remove(knowledge, **options))
    kb.load(DOMAIN.replace("(raining)", ""))
    with pytest.raises(kbstore.InvalidKnowledge):
        kb.add("(raining)")


def test_a_domain_without_a_used_metric_function_or_type_is_refused(kb):
    """D4: the error names each."""
    kb.add("(= (battery kenny) 3)", "(> (battery kenny) 2)", "minimize (battery kenny)")
    with pytest.raises(kbstore.InvalidKnowledge) as refusal:
        kb.load(DOMAIN.replace("(battery ?r - robot)", ""))
    assert len(refusal.value.violations) == 3
    kb.remove("kenny")
    kb.load(DOMAIN.replace("(battery ?r - robot)", ""))
    smaller = "(define (domain d) (:types place robot - object) (:predicates (raining)))"
    with pytest.raises(kbstore.InvalidKnowledge, match="cup"):
        kb.load(smaller)


def test_a_constant_with_the_name_of_an_object_is_refused(kb):
    """D4: two objects would have one name."""
    with pytest.raises(kbstore.InvalidKnowledge, match="wp0"):
        kb.load(DOMAIN.replace("home - place", "home wp0 - place"))
    kb.remove("wp0")
    kb.load(DOMAIN.replace("home - place", "home wp0 - place"))
    kb.add("(open wp0)")


def test_a_constant_that_is_mentioned_cannot_be_dropped(kb):
    """D4, C9: no assertion mentions an object that does not exist."""
    kb.add("(open home)")
    with pytest.raises(kbstore.InvalidKnowledge, match="home"):
        kb.load(DOMAIN.replace("(:constants home - place)", ""))
    kb.remove("(open home)")
    kb.load(DOMAIN.replace("(:constants home - place)", ""))


def test_knowledge_recorded_without_a_domain_must_fit_the_first_domain(bare):
    """D4, D2: objects that never existed do not fit."""
    bare.add("kenny - robot", "wp0 - place", "(near kenny wp0)", "(near kenny wp9)", "(= (battery kenny) 3)")
    with pytest.raises(kbstore.InvalidKnowledge, match="wp9"):
        bare.load(DOMAIN)
    bare.remove("(near kenny wp9)")
    bare.load(DOMAIN)
    with pytest.raises(kbstore.InvalidKnowledge):
        bare.add("(near kenny wp9)")


def test_an_inequality_message_is_checked_like_text(kb):
    """D1: its functions are known, with their arguments."""
    good = kbstore.item("(> (battery kenny) 3)")
    assert isinstance(good, Inequality)
    kb.add(good)
    with pytest.raises(kbstore.InvalidKnowledge):
        kb.add(kbstore.item("(> (battery kenny kenny) 3)"))
    with pytest.raises(kbstore.InvalidKnowledge):
        kb.add(kbstore.item("(> (battery wp0) 3)"), initial_time=START + seconds(1))


@pytest.mark.parametrize("name", ["", "  ", "a\nb", "a\x00b", "\ud800", None, 7])
def test_the_name_of_a_knowledge_base_must_be_printable(open_kb, store_url, name):
    """Spaces, brackets and other scripts are accepted; for a name that is refused, nothing is created."""
    with pytest.raises(kbstore.InvalidKnowledge, match="give printable text"):
        kbstore.open(store_url, name)
    odd = open_kb(f"Küche (2. Stock), {name!r}")
    odd.add("wp0 - place")
    assert odd.holds("wp0 - place")


@pytest.mark.parametrize("character", ["\0", "\ud800"], ids=["NUL", "half a surrogate"])
@pytest.mark.parametrize("field", ["client", "note"])
def test_a_client_and_a_note_can_be_exported(kb, field, character):
    """D3: a client or a note with a character that no export can write is refused, and nothing is stored."""
    with pytest.raises(kbstore.InvalidKnowledge, match=f"the {field} 'two words' goes on with"):
        kb.add("(open hall)", **{field: f"two words{character}"})
    assert not kb.holds("(open hall)")
    assert kb.add("(open hall)", note="two words\nand a line, ä 😀").changes == 1


@pytest.mark.parametrize("character", ["\0", "\ud800"], ids=["NUL", "half a surrogate"])
def test_a_comment_of_a_domain_can_be_exported(bare, character):
    """D3: the text of a domain is stored whole; a character that cannot be exported is refused with its position."""
    with pytest.raises(kbstore.PddlSyntaxError, match="cannot be stored") as refused:
        bare.load(f"(define (domain d)\n  ; a{character}b\n  (:predicates (p)))")
    assert (refused.value.line, refused.value.column) == (2, 6)
    with pytest.raises(kbstore.UnknownSymbol):
        bare.domain  # noqa: B018


GIVEN_WITHOUT_TEXT = {
    "type": lambda kb, given: kb.instances(given),
    "type in a state": lambda kb, given: kb.state().objects(given),
    "predicate": lambda kb, given: kb.propositions(given),
    "function": lambda kb, given: kb.functions(given),
    "timed knowledge": lambda kb, given: kb.timed_knowledge(given),
    "operator": lambda kb, given: kb.start(given),
    "applicable operator": lambda kb, given: kb.applicable(given),
    "argument": lambda kb, given: kb.apply("clean", given),
    "pattern of runs": lambda kb, given: kb.runs(given),
    "client": lambda kb, given: kb.add("(raining)", client=given),
    "note": lambda kb, given: kb.add("(raining)", note=given),
    "transaction": lambda kb, given: kb.changes(given),
}


@pytest.mark.parametrize("given", [b"wp0", 1.5, ["wp0"]], ids=repr)
@pytest.mark.parametrize("use", GIVEN_WITHOUT_TEXT.values(), ids=GIVEN_WITHOUT_TEXT)
def test_what_is_not_text_is_refused_where_text_is_expected(bare, use, given):
    """D1: in a sentence that shows what was given, not in Python's about `str.lower`."""
    bare.load("(define (domain d) (:predicates (raining)) (:action clean :parameters (?x) :effect (raining)))")
    with pytest.raises(kbstore.InvalidKnowledge, match=re.escape(repr(given))):
        use(bare, given)
