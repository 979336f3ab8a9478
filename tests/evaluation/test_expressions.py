import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from kbstore.clock import SECOND
from kbstore.errors import DivisionByZero, InvalidKnowledge, UndefinedFunction
from kbstore.evaluation.expressions import evaluate
from kbstore.evaluation.interpretation import Number
from kbstore.messages import Operator, SpecialType
from kbstore.model.expressions import NumericExpression
from kbstore.model.formulas import Atom
from tests.evaluation.interpretations import World

ADD, SUB, MUL, DIV, MINUS = Operator.ADD, Operator.SUB, Operator.MUL, Operator.DIV, Operator.UMINUS
BATTERY = Atom("Battery", ("Kenny",))
NOWHERE = World()


def infix(tokens: list) -> str:  # type: ignore[type-arg]
    """The expression as Python source; a function is the variable of its name."""
    token = tokens.pop(0)
    if token is MINUS:
        return f"(-{infix(tokens)})"
    if isinstance(token, Operator):
        return f"({infix(tokens)} {token.pddl} {infix(tokens)})"
    return token.name if isinstance(token, Atom) else repr(token)


FUNCTIONS = {"f": 3.0, "g": -0.1, "h": 0.0}
# neither so large nor so small that twelve of them could overflow on the way
LEAVES = st.one_of(
    st.floats(1e-6, 1e6), st.floats(-1e6, -1e-6), st.just(0.0), st.sampled_from([Atom(name) for name in FUNCTIONS])
)


def _combined(parts: st.SearchStrategy[NumericExpression]) -> st.SearchStrategy[NumericExpression]:
    binary = st.tuples(st.sampled_from([ADD, SUB, MUL, DIV]), parts, parts).map(lambda t: (t[0], *t[1], *t[2]))
    return st.one_of(binary, parts.map(lambda part: (MINUS, *part)))


EXPRESSIONS = st.recursive(LEAVES.map(lambda leaf: (leaf,)), _combined, max_leaves=12)


@pytest.mark.parametrize(
    ("expression", "value"),
    [
        ((SUB, 5.0, 3.0), 2),
        ((DIV, 6.0, 3.0), 2),
        ((ADD, MUL, 2.0, 3.0, 4.0), 10),
        ((MUL, ADD, 1.0, 2.0, ADD, 3.0, 4.0), 21),
        ((SUB, ADD, 1.0, 2.0, 10.0), -7),
        ((MINUS, 5.0), -5),
        ((ADD, 1.0, MUL, 2.0, 3.0), 7),
    ],
)
def test_the_seven_expressions_that_the_original_gets_wrong(expression: NumericExpression, value: float) -> None:
    """The last table of the rules: operands are read from left to right, in prefix order."""
    assert evaluate(expression, NOWHERE) == value


@settings(deadline=None)
@given(EXPRESSIONS)
def test_random_expressions_agree_with_python(expression: NumericExpression) -> None:
    """V5: arithmetic is that of IEEE doubles; division by zero is a separate error."""
    try:
        expected = eval(infix(list(expression)), FUNCTIONS.copy())
    except ZeroDivisionError:
        expected = None
    world = World(numbers=FUNCTIONS)
    if expected is None:
        with pytest.raises(DivisionByZero):
            evaluate(expression, world)
    else:
        assert evaluate(expression, world) == expected


def test_a_function_is_read_at_the_worlds_time() -> None:
    """C7: the value at t is value + rate * ((t - initial_time) / 1e9)."""
    world = World(time=4 * SECOND, numbers={"battery kenny": Number(80.0, -0.5, SECOND)})
    assert evaluate((BATTERY,), world) == 80.0 - 0.5 * 3.0


def test_variables_are_replaced_by_their_objects_in_any_case() -> None:
    """D3: a variable is replaced by its object; names are compared without regard to case."""
    world = World(numbers={"battery kenny": 7.0})
    assert evaluate((Atom("battery", ("?R",)),), world, {"r": "Kenny"}) == 7.0


def test_the_error_of_an_undefined_function_names_it_and_the_time() -> None:
    """V5: the value of an undefined function is UndefinedFunction, not 0."""
    with pytest.raises(UndefinedFunction, match=r"\(Battery Kenny\).*1970-01-01T00:00:12\.5Z"):
        evaluate((ADD, 1.0, BATTERY), World(time=12_500_000_000))
    with pytest.raises(UndefinedFunction, match=r"\(Battery kenny\)"):
        evaluate((Atom("Battery", ("?r",)),), NOWHERE, {"r": "kenny"})


@pytest.mark.parametrize(
    ("expression", "divisor"),
    [
        ((DIV, ADD, 1.0, 2.0, BATTERY), r"\(Battery Kenny\)"),
        ((ADD, 1.0, DIV, 1.0, 0.0), "by 0,"),
        ((DIV, 1.0, SpecialType.DURATION), r"\?duration"),
        ((DIV, 1.0, SUB, 2.0, 2.0), "an expression"),
    ],
)
def test_a_division_by_zero_names_the_divisor(expression: NumericExpression, divisor: str) -> None:
    """V5: the value of a division by zero is DivisionByZero."""
    with pytest.raises(DivisionByZero, match=divisor):
        evaluate(expression, World(numbers={"battery kenny": 0.0}), duration=0.0)


@pytest.mark.parametrize(
    ("token", "sentence"),
    [
        (SpecialType.HASHT, "#t has a value only in a continuous effect"),
        (SpecialType.TOTAL_TIME, r"\(total-time\) has a value only in the metric"),
        (SpecialType.DURATION, r"\?duration has a value only in an action"),
    ],
)
def test_special_numbers_without_a_value_are_refused(token: SpecialType, sentence: str) -> None:
    """A special number that is not given has no value, rather than 0."""
    with pytest.raises(InvalidKnowledge, match=sentence):
        evaluate((MUL, token, 2.0), NOWHERE)


def test_special_numbers_have_the_given_value() -> None:
    """``?duration`` and ``total-time`` are seconds that the caller gives."""
    expression = (SUB, SpecialType.TOTAL_TIME, MUL, 2.0, SpecialType.DURATION)
    assert evaluate(expression, NOWHERE, duration=1.5, total_time=10.0) == 7.0


@pytest.mark.parametrize(
    "expression",
    [(MUL, 1e200, 1e200), (DIV, 1e300, 1e-300), (DIV, 1.0, MUL, 1e200, 1e200), (SUB, MUL, 1e200, -1e200, 1.0)],
)
def test_overflow_is_refused_even_if_the_result_were_finite(expression: NumericExpression) -> None:
    """C7: infinities and NaN are InvalidKnowledge; no step of an expression goes through one."""
    with pytest.raises(InvalidKnowledge, match="overflow"):
        evaluate(expression, NOWHERE)


def test_a_function_that_has_moved_beyond_all_doubles_is_refused() -> None:
    """C7: overflow is InvalidKnowledge, also where a rate causes it."""
    with pytest.raises(InvalidKnowledge, match="overflow"):
        evaluate((Atom("f"),), World(time=10 * SECOND, numbers={"f": Number(1e308, 1e308, 0)}))


@pytest.mark.parametrize("token", [math.nan, math.inf, "5", None])
def test_infinities_and_nan_are_refused(token: float) -> None:
    """C7: NaN and infinities are InvalidKnowledge."""
    with pytest.raises(InvalidKnowledge, match="write a finite number or a function"):
        evaluate((ADD, 1.0, token), NOWHERE)


@pytest.mark.parametrize("argument", ["?", "?r", ""])
def test_a_wildcard_in_a_function_is_refused_with_advice(argument: str) -> None:
    """V7: a number is read of one object; the error advises `exists`."""
    with pytest.raises(InvalidKnowledge, match=r"say exists: \(exists \(\?[rx] - object\)"):
        evaluate((Atom("battery", (argument,)),), NOWHERE, {"other": "kenny"})


@pytest.mark.parametrize("expression", [(), (ADD, 1.0), (1.0, 2.0), (MINUS,), (ADD, ADD, 1.0, 2.0)])
def test_tokens_that_are_not_an_expression_are_refused(expression: NumericExpression) -> None:
    """The tokens have to be exactly one expression in prefix order."""
    with pytest.raises(InvalidKnowledge, match=r"prefix order|is empty"):
        evaluate(expression, NOWHERE)


def test_expressions_of_any_depth_and_length() -> None:
    """An expression of 100,000 nested operators stays below Python's recursion limit."""
    deep = (ADD, 1.0) * 100_000 + (Atom("f"),)
    deep_left = (ADD,) * 100_000 + (Atom("f"),) + (1.0,) * 100_000
    world = World(numbers={"f": 0.5})
    assert evaluate(deep, world) == 100_000.5
    assert evaluate(deep_left, world) == 100_000.5
    assert evaluate((MINUS,) * 100_001 + (2.0,), world) == -2.0
