"""Numeric comparisons, at one time and over a span (rules V5 and Q4).

A comparison that reads an undefined function, divides by zero or overflows an IEEE double is unknown. One that reads
a function with a rate is decided in exact rationals of the stored doubles, which do not overflow, so that the answer
for a moment and the crossings over a span agree at every nanosecond.
"""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from fractions import Fraction
from itertools import pairwise
from operator import itemgetter

from kbstore.clock import isoformat
from kbstore.errors import DivisionByZero, NotLinear
from kbstore.evaluation.expressions import doubles, fold, ground, number, special
from kbstore.evaluation.interpretation import Interpretation, Number, Span
from kbstore.evaluation.polynomials import Polynomial, bounded, exactly
from kbstore.evaluation.signals import Signal, painted
from kbstore.evaluation.substitution import Bindings
from kbstore.messages.enums import ComparisonType, Operator, SpecialType, Truth
from kbstore.model.expressions import NumericExpression, Token, atoms_of
from kbstore.model.formulas import Atom, Comparison

_MAX_DEGREE = 8
"""Higher powers of time are refused at once: nobody writes expressions in which they cancel out."""

Numbers = Mapping[Atom, Number]
Pieces = Sequence[tuple[int, int, Number]]


def at_moment(comparison: Comparison, world: Interpretation, bindings: Bindings, duration: float | None) -> Truth:
    """Return the truth of a comparison in a world; `duration`, in seconds, is the value of ``?duration``."""
    numbers: dict[Atom, Number] = {}
    for token in (*comparison.left, *comparison.right):
        if isinstance(token, Atom) and token not in numbers:
            function = ground(token, bindings)
            found = world.number(function.name, function.arguments)
            if found is None:
                return Truth.UNKNOWN
            numbers[token] = found
    return _decided(comparison, numbers, world.time, duration)


def over_span(
    comparison: Comparison,
    span: Span,
    pieces_of: Callable[[Atom], Pieces],
    bindings: Bindings,
    duration: float | None,
) -> Signal:
    """Return the truth of a comparison over a span, from the pieces in which each function is defined.

    Crossings are exact to the nanosecond. Raises `NotLinear` where the difference of both sides is not linear in time.
    """
    ground_comparison = _grounded(comparison, bindings)
    read = {function: pieces_of(function) for function in _functions(ground_comparison)}
    pieces: list[tuple[int, int, Truth]] = []
    for start, end, numbers in _common_pieces(read, span):
        if any(n.rate for n in numbers.values()):
            pieces.extend(_crossings(ground_comparison, numbers, (start, end), duration))
        else:
            pieces.append((start, end, _decided(ground_comparison, numbers, start, duration)))
    return painted(span, pieces, Truth.UNKNOWN)


def _grounded(comparison: Comparison, bindings: Bindings) -> Comparison:
    """The comparison with keys for names and objects for variables."""

    def side(expression: NumericExpression) -> NumericExpression:
        return tuple([ground(token, bindings) if isinstance(token, Atom) else token for token in expression])

    return Comparison(comparison.comparison, side(comparison.left), side(comparison.right))


def _functions(comparison: Comparison) -> list[Atom]:
    """The functions that a comparison reads, each once."""
    return list(dict.fromkeys((*atoms_of(comparison.left), *atoms_of(comparison.right))))


def _decided(comparison: Comparison, numbers: Numbers, t: int, duration: float | None) -> Truth:
    """The truth at one time, where every function has a number."""

    def double(token: Token) -> float:
        return numbers[token].value if isinstance(token, Atom) else _constant(token, duration)

    def rational(token: Token) -> Fraction:
        return exactly(numbers[token], t) if isinstance(token, Atom) else Fraction(_constant(token, duration))

    try:
        if any(n.rate for n in numbers.values()):
            exact = (fold(side, rational, _rationals) for side in (comparison.left, comparison.right))
            return _ordered(comparison.comparison, *exact)
        rounded = (fold(side, double, doubles) for side in (comparison.left, comparison.right))
        return _ordered(comparison.comparison, *rounded)
    except (DivisionByZero, OverflowError):
        return Truth.UNKNOWN


def _crossings(
    comparison: Comparison, numbers: Numbers, span: Span, duration: float | None
) -> Iterator[tuple[int, int, Truth]]:
    """Yield the pieces of equal truth of a span in which all numbers are linear, and at least one moves."""
    divisors: list[Polynomial] = []

    def linear(token: Token) -> Polynomial:
        return (
            Polynomial.moving(numbers[token]) if isinstance(token, Atom) else Polynomial.of(_constant(token, duration))
        )

    def operate(operator: Operator, operands: Sequence[Polynomial]) -> Polynomial:
        match operator:
            case Operator.UMINUS:
                return -operands[0]
            case Operator.ADD:
                return operands[0] + operands[1]
            case Operator.SUB:
                return operands[0] - operands[1]
            case Operator.MUL:
                result, rest = operands[0] * operands[1], Polynomial()
            case Operator.DIV:
                result, rest = divmod(operands[0], operands[1])
                divisors.append(operands[1])
        if rest.coefficients or result.degree > _MAX_DEGREE:
            raise _not_linear(numbers, span)
        return result

    try:
        difference = fold(comparison.left, linear, operate) - fold(comparison.right, linear, operate)
    except DivisionByZero:
        yield (*span, Truth.UNKNOWN)
        return
    if max(p.degree for p in (difference, *divisors)) > 1:
        raise _not_linear(numbers, span)
    # between the roots nothing changes its sign; at a divisor's root the comparison is unknown
    marks = {span[0]}
    for polynomial in (difference, *divisors):
        if polynomial.degree:
            root = polynomial.root
            marks |= {t for t in (math.ceil(root), math.floor(root) + 1) if span[0] < t < span[1]}
    for start, end in pairwise([*sorted(marks), span[1]]):
        if any(not divisor(start) for divisor in divisors):
            yield start, end, Truth.UNKNOWN
        else:
            yield start, end, _ordered(comparison.comparison, difference(start), 0)


def _rationals(operator: Operator, operands: Sequence[Fraction]) -> Fraction:
    """Apply an operator to rationals. Raises `ZeroDivisionError`, and `InvalidKnowledge` for numbers of absurd size."""
    match operator:
        case Operator.UMINUS:
            return -operands[0]
        case Operator.ADD:
            return bounded(operands[0] + operands[1])
        case Operator.SUB:
            return bounded(operands[0] - operands[1])
        case Operator.MUL:
            return bounded(operands[0] * operands[1])
        case Operator.DIV:
            return bounded(operands[0] / operands[1])


def _constant(token: Token, duration: float | None) -> float:
    return special(token, duration=duration) if isinstance(token, SpecialType) else number(token)


def _ordered(comparison: ComparisonType, left: float | Fraction, right: float | Fraction) -> Truth:
    match comparison:
        case ComparisonType.GREATER:
            return Truth.of(left > right)
        case ComparisonType.GREATEREQ:
            return Truth.of(left >= right)
        case ComparisonType.LESS:
            return Truth.of(left < right)
        case ComparisonType.LESSEQ:
            return Truth.of(left <= right)
        case ComparisonType.EQUALS:
            return Truth.of(left == right)


def _not_linear(numbers: Numbers, span: Span) -> NotLinear:
    moving = " and ".join(str(function) for function, n in numbers.items() if n.rate)
    return NotLinear(
        f"the comparison is not linear in time from {isoformat(span[0])} to {isoformat(span[1])}, where {moving} move "
        "at a rate and are multiplied or divided by; ask for a span in which only one of them moves, or at single times"
    )


def _common_pieces(pieces_of: Mapping[Atom, Pieces], span: Span) -> Iterator[tuple[int, int, dict[Atom, Number]]]:
    """The maximal pieces in which each function has one and the same number; the dictionary is the same each time."""
    steps: list[tuple[int, Atom, Number | None]] = []
    for function, pieces in pieces_of.items():
        for start, end, number_there in pieces:
            steps += [(end, function, None), (start, function, number_there)]
    # a stable sort: where pieces of one function meet, the end of the former stays before the start of the latter
    steps.sort(key=itemgetter(0))
    numbers: dict[Atom, Number] = {}
    now = span[0]
    for t, function, step in steps:
        if t > now:
            if len(numbers) == len(pieces_of):
                yield now, t, numbers
            now = t
        if step is None:
            numbers.pop(function, None)
        else:
            numbers[function] = step
    if now < span[1] and len(numbers) == len(pieces_of):
        yield now, span[1], numbers
