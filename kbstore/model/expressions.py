"""The abstract syntax of numeric expressions.

Names are kept as written, and compared by `kbstore.names.key`. Arguments that begin
with ``?`` are variables.
"""

from collections.abc import Iterator
from dataclasses import dataclass

from kbstore.messages.enums import Operator, SpecialType
from kbstore.names import bracketed


@dataclass(frozen=True, slots=True)
class Atom:
    """A predicate or a numeric function with its arguments."""

    name: str
    arguments: tuple[str, ...] = ()

    def __str__(self) -> str:
        return bracketed(self.name, *self.arguments)


Token = float | Atom | Operator | SpecialType
"""A number, a function's term, an operator, or a special number."""

NumericExpression = tuple[Token, ...]
"""A numeric expression in prefix order; a flat tuple, so that no depth of nesting needs a deep stack."""


def atoms_of(expression: NumericExpression) -> Iterator[Atom]:
    """Return the functions that an expression reads."""
    return (token for token in expression if isinstance(token, Atom))
