"""Polynomials in time with exact rational coefficients: the values of expressions whose numbers move at a rate."""

from dataclasses import dataclass
from fractions import Fraction
from itertools import zip_longest

from kbstore.clock import SECOND
from kbstore.errors import InvalidKnowledge
from kbstore.evaluation.interpretation import Number

MAX_BITS = 2**14
"""Numbers with more bits are refused: only absurd expressions have them, and each step takes longer."""

_ZERO = Fraction(0)


def bounded(number: Fraction) -> Fraction:
    """Return the number itself. Raises `InvalidKnowledge` if it needs more than `MAX_BITS`."""
    if number.numerator.bit_length() > MAX_BITS or number.denominator.bit_length() > MAX_BITS:
        raise InvalidKnowledge(
            f"deciding the comparison exactly, as is done where a function has a rate, needs numbers of more than "
            f"{MAX_BITS} bits; write a simpler expression"
        )
    return number


def exactly(number: Number, t: int) -> Fraction:
    """Return the value of a numeric function at a time in nanoseconds (rule C7), without rounding."""
    (value, below), (rate, under) = number.value.as_integer_ratio(), number.rate.as_integer_ratio()
    # one fraction is reduced instead of five
    return Fraction(value * under * SECOND + rate * (t - number.since) * below, below * under * SECOND)


@dataclass(frozen=True, slots=True)
class Polynomial:
    """Coefficients of rising powers of the time in nanoseconds; the last one is not zero."""

    coefficients: tuple[Fraction, ...] = ()

    @classmethod
    def of(cls, value: float) -> "Polynomial":
        """Make a constant."""
        return cls.trimmed([Fraction(value)])

    @classmethod
    def moving(cls, number: Number) -> "Polynomial":
        """Make the value of a numeric function as it depends on time (rule C7), without rounding."""
        rate = Fraction(number.rate) / SECOND
        return cls.trimmed([Fraction(number.value) - rate * number.since, rate])

    @classmethod
    def trimmed(cls, coefficients: list[Fraction]) -> "Polynomial":
        """Make a polynomial of coefficients, the last of which may be zero. Raises what `bounded` does."""
        while coefficients and not coefficients[-1]:
            coefficients.pop()
        return cls(tuple([bounded(c) for c in coefficients]))

    @property
    def degree(self) -> int:
        """The highest power of time; 0 for constants."""
        return max(0, len(self.coefficients) - 1)

    @property
    def root(self) -> Fraction:
        """The time at which a polynomial of degree 1 is zero."""
        constant, slope = self.coefficients
        return -constant / slope

    def __call__(self, t: int) -> Fraction:
        """The value at a time."""
        value = _ZERO
        for c in reversed(self.coefficients):
            value = value * t + c
        return value

    def __neg__(self) -> "Polynomial":
        return Polynomial(tuple(-c for c in self.coefficients))

    def __add__(self, other: "Polynomial") -> "Polynomial":
        pairs = zip_longest(self.coefficients, other.coefficients, fillvalue=_ZERO)
        return Polynomial.trimmed([a + b for a, b in pairs])

    def __sub__(self, other: "Polynomial") -> "Polynomial":
        pairs = zip_longest(self.coefficients, other.coefficients, fillvalue=_ZERO)
        return Polynomial.trimmed([a - b for a, b in pairs])

    def __mul__(self, other: "Polynomial") -> "Polynomial":
        if not self.coefficients or not other.coefficients:
            return Polynomial()
        product = [_ZERO] * (len(self.coefficients) + len(other.coefficients) - 1)
        for i, a in enumerate(self.coefficients):
            for j, b in enumerate(other.coefficients):
                product[i + j] += a * b
        return Polynomial.trimmed(product)

    def __divmod__(self, divisor: "Polynomial") -> tuple["Polynomial", "Polynomial"]:
        """Quotient and remainder. Raises `ZeroDivisionError` for the divisor 0."""
        if not divisor.coefficients:
            raise ZeroDivisionError("division by the polynomial 0")
        rest, quotient = list(self.coefficients), [_ZERO] * len(self.coefficients)
        while len(rest) >= len(divisor.coefficients):
            shift = len(rest) - len(divisor.coefficients)
            factor = rest.pop() / divisor.coefficients[-1]
            quotient[shift] = factor
            for i, c in enumerate(divisor.coefficients[:-1]):
                rest[shift + i] -= factor * c
        return Polynomial.trimmed(quotient), Polynomial.trimmed(rest)
