"""Effects of random shape, compared with a plain and independent evaluator (rules O2, O3)."""

from fractions import Fraction
from itertools import product

from hypothesis import given, settings
from hypothesis import strategies as st

from kbstore.errors import KbStoreError
from kbstore.messages import AssignOp, ComparisonType, Operator
from kbstore.model.expressions import NumericExpression
from kbstore.model.formulas import (
    Add,
    And,
    Comparison,
    Delete,
    Effect,
    Exists,
    Forall,
    ForEach,
    Formula,
    Not,
    NumericEffect,
    Or,
    Parameter,
    Timing,
    When,
    WhenAtStart,
)
from kbstore.planning.effects import StateAfter, evaluate
from kbstore.planning.start_conditions import remembered
from tests.evaluation.interpretations import World
from tests.planning.robots import END, START, action, atom, grounded

PLACES = ("wp0", "wp1", "depot")
FACTS = ["door", *(f"seen {p}" for p in PLACES), *(f"near {a} {b}" for a, b in product(PLACES, PLACES))]
NUMBERS = ["x", "y", *(f"distance {a} {b}" for a, b in product(PLACES[:2], PLACES[:2]))]

# -- random effects --------------------------------------------------------------------------------------------

terms = st.sampled_from(["wp0", "wp1", "depot", "?p", "?q"])
atoms = st.one_of(
    st.just(atom("door")),
    st.builds(lambda a: atom(f"seen {a}"), terms),
    st.builds(lambda a, b: atom(f"near {a} {b}"), terms, terms),
)
functions = st.one_of(
    st.sampled_from([atom("x"), atom("y")]), st.builds(lambda a, b: atom(f"distance {a} {b}"), terms, terms)
)
# divisors are 0 or powers of two, and numbers small, so that doubles are exact
leaves = st.one_of(st.integers(-3, 3).map(lambda n: (float(n),)), functions.map(lambda f: (f,)))
values = st.recursive(
    leaves,
    lambda inner: st.one_of(
        st.builds(lambda a, b: (Operator.ADD, *a, *b), inner, inner),
        st.builds(lambda a, b: (Operator.SUB, *a, *b), inner, inner),
        st.builds(lambda a, b: (Operator.MUL, *a, *b), inner, inner),
        st.builds(lambda a: (Operator.UMINUS, *a), inner),
        st.builds(lambda a, b: (Operator.DIV, *a, float(b)), inner, st.sampled_from([0, 1, 2, -4])),
    ),
    max_leaves=4,
)
variables = st.sampled_from(["p", "q"]).map(lambda name: (Parameter(name, ("wp",)),))
conditions = st.recursive(
    st.one_of(atoms, st.builds(Comparison, st.sampled_from(ComparisonType), values, values)),
    lambda inner: st.one_of(
        st.builds(Not, inner),
        st.builds(lambda a, b: And((a, b)), inner, inner),
        st.builds(lambda a, b: Or((a, b)), inner, inner),
        st.builds(Exists, variables, inner),
        st.builds(Forall, variables, inner),
    ),
    max_leaves=4,
)
powers = st.sampled_from([0.0, 2.0, -0.5]).map(lambda n: (n,))
changes = st.one_of(
    st.builds(
        NumericEffect, st.sampled_from([AssignOp.ASSIGN, AssignOp.INCREASE, AssignOp.DECREASE]), functions, values
    ),
    st.builds(NumericEffect, st.sampled_from([AssignOp.SCALE_UP, AssignOp.SCALE_DOWN]), functions, powers),
)


def nested(*conditional: type[When | WhenAtStart]) -> st.SearchStrategy[Effect]:
    """Effects below ``forall``, and conditions at the given times."""
    return st.recursive(
        st.one_of(st.builds(Add, atoms), st.builds(Delete, atoms), changes),
        lambda inner: st.one_of(
            *(st.builds(kind, conditions, st.lists(inner, max_size=2).map(tuple)) for kind in conditional),
            st.builds(ForEach, variables, st.lists(inner, max_size=2).map(tuple)),
        ),
        max_leaves=5,
    )


some_facts = st.dictionaries(st.sampled_from(FACTS), st.booleans())
some_numbers = st.dictionaries(st.sampled_from(NUMBERS), st.integers(-4, 4))

# -- the plain evaluation ----------------------------------------------------------------------------------------

State = tuple[dict[str, bool], dict[str, Fraction], bool]


class Refused(Exception):
    """The effects cannot take place."""


def ground(term: object, objects: dict[str, str]) -> str:
    words = [term.name, *(objects[a[1:]] if a[0] == "?" else a for a in term.arguments)]  # type: ignore[attr-defined]
    return " ".join(words)


def compute(expression: NumericExpression, objects: dict[str, str], state: State) -> Fraction | None:
    """The value of an expression, None if it has none; by recursion from the left."""
    rest = list(expression)

    def take() -> Fraction | None:
        token = rest.pop(0)
        if not isinstance(token, Operator):
            return Fraction(token) if isinstance(token, float) else state[1].get(ground(token, objects))
        operands = [take() for _ in range(1 if token is Operator.UMINUS else 2)]
        if None in operands or (token is Operator.DIV and operands[1] == 0):
            return None
        match token:
            case Operator.UMINUS:
                return -operands[0]  # type: ignore[operator]
            case Operator.ADD:
                return operands[0] + operands[1]  # type: ignore[operator]
            case Operator.SUB:
                return operands[0] - operands[1]  # type: ignore[operator]
            case Operator.MUL:
                return operands[0] * operands[1]  # type: ignore[operator]
            case Operator.DIV:
                return operands[0] / operands[1]  # type: ignore[operator]

    return take()


def judge(condition: Formula, objects: dict[str, str], state: State) -> float:
    """The truth of a condition: 1, 0, or 1/2 where it is unknown."""
    match condition:
        case Not(part):
            return 1 - judge(part, objects, state)
        case And(parts):
            return min(judge(part, objects, state) for part in parts)
        case Or(parts):
            return max(judge(part, objects, state) for part in parts)
        case Exists((parameter,), part):
            return max(judge(part, {**objects, parameter.name: place}, state) for place in PLACES)
        case Forall((parameter,), part):
            return min(judge(part, {**objects, parameter.name: place}, state) for place in PLACES)
        case Comparison(comparison, left, right):
            a, b = compute(left, objects, state), compute(right, objects, state)
            if a is None or b is None:
                return 0.5
            return float({">": a > b, ">=": a >= b, "<": a < b, "<=": a <= b, "=": a == b}[comparison.pddl])
        case fact:
            absent = 0.5 if state[2] else 0
            return {True: 1, False: 0, None: absent}[state[0].get(ground(fact, objects))]


def expected(effects: list[Effect], state: State, start: State) -> tuple[dict[str, bool], dict[str, Fraction]]:
    """Facts and numbers after the effects, from lists of the changes that each makes to the state before.

    `start` is the state before the start.
    """
    deleted: set[str] = set()
    added: set[str] = set()
    done: dict[str, list[tuple[str, Fraction]]] = {}

    def visit(effect: Effect, objects: dict[str, str]) -> None:
        match effect:
            case Add(term):
                added.add(ground(term, objects))
            case Delete(term):
                deleted.add(ground(term, objects))
            case When(condition, parts):
                if judge(condition, objects, state) == 1:
                    for part in parts:
                        visit(part, objects)
            case WhenAtStart(condition, parts):
                if judge(condition, objects, start) == 1:
                    for part in parts:
                        visit(part, objects)
            case ForEach((parameter,), parts):
                for place in PLACES:
                    for part in parts:
                        visit(part, {**objects, parameter.name: place})
            case NumericEffect(operation, function, value):
                operand = compute(value, objects, state)
                if operand is None:
                    raise Refused
                done.setdefault(ground(function, objects), []).append((operation.pddl, operand))

    for effect in effects:
        visit(effect, {"p": "wp0", "q": "wp1"})
    facts, numbers, open_world = dict(state[0]), dict(state[1]), state[2]
    for fact in deleted:
        if open_world:
            facts[fact] = False
        elif facts.get(fact):
            del facts[fact]
    facts.update(dict.fromkeys(added, True))
    for function, all_done in done.items():
        words = {word for word, _ in all_done}
        if words == {"assign"}:
            if len({operand for _, operand in all_done}) > 1:
                raise Refused
            numbers[function] = all_done[0][1]
            continue
        if function not in numbers or not (words <= {"increase", "decrease"} or words <= {"scale-up", "scale-down"}):
            raise Refused
        for word, operand in all_done:
            if word == "scale-down" and operand == 0:
                raise Refused
            before = numbers[function]
            numbers[function] = {
                "increase": before + operand,
                "decrease": before - operand,
                "scale-up": before * operand,
                "scale-down": before / (operand or 1),
            }[word]
    return facts, numbers


# -- the comparison ----------------------------------------------------------------------------------------------


@given(st.lists(nested(When), max_size=4), some_facts, some_numbers, st.booleans())
@settings(max_examples=300, deadline=None)
def test_random_effects_agree_with_a_plain_evaluation(
    effects: list[Effect], facts: dict[str, bool], numbers: dict[str, int], use_unknowns: bool
):
    """O2: the world after any effects is the same in both; or both refuse."""
    state = plain(facts, numbers, use_unknowns)
    compare(effects, START, state, state)


@given(
    st.lists(nested(WhenAtStart, When), max_size=4), some_facts, some_numbers, some_facts, some_numbers, st.booleans()
)
@settings(max_examples=300, deadline=None)
def test_random_effects_at_start_and_end_agree_with_a_plain_evaluation(
    effects: list[Effect],
    facts_at_start: dict[str, bool],
    numbers_at_start: dict[str, int],
    facts: dict[str, bool],
    numbers: dict[str, int],
    use_unknowns: bool,
):
    """O2, O3: also where conditions are of the start, and the state has changed since."""
    start = plain(facts_at_start, numbers_at_start, use_unknowns)
    compare(effects, END, plain(facts, numbers, use_unknowns), start)


def plain(facts: dict[str, bool], numbers: dict[str, int], use_unknowns: bool) -> State:
    return facts, {function: Fraction(number) for function, number in numbers.items()}, use_unknowns


def world_of(state: State) -> World:
    facts, numbers, use_unknowns = state
    return World(
        None,
        use_unknowns=use_unknowns,
        objects=dict.fromkeys(PLACES, "wp"),
        facts=facts,
        numbers={function: float(number) for function, number in numbers.items()},
    )


def compare(effects: list[Effect], timing: Timing, state: State, start: State) -> None:
    """Compare the effects at one time on a state, after a start in another one."""
    act = grounded(action("p:wp q:wp", effects=[(timing, effect) for effect in effects]), "wp0", "wp1")
    before = world_of(state)
    try:
        facts_after, numbers_after = expected(effects, state, start)
    except Refused:
        facts_after, numbers_after = None, None
    try:
        known = remembered(act, timing, world_of(start))
        after = StateAfter(before, evaluate(act, timing, before, remembered=known))
    except KbStoreError:
        assert facts_after is None
        return
    assert facts_after is not None
    found_facts = {
        " ".join((name, *arguments)): sign for name in ("door", "seen", "near") for arguments, sign in after.facts(name)
    }
    assert found_facts == facts_after
    words = {text: text.split() for text in FACTS}
    assert all(after.sign(name, tuple(rest)) == facts_after.get(text) for text, (name, *rest) in words.items())
    found_numbers = {}
    for text in [*NUMBERS, *(f"distance {a} depot" for a in PLACES), *(f"distance depot {a}" for a in PLACES)]:
        name, *rest = text.split()
        number = after.number(name, tuple(rest))
        if number is not None:
            found_numbers[text] = Fraction(number.value)
    assert found_numbers == numbers_after
