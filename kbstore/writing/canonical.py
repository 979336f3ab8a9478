"""Formulas that are kept, with their names as first written (rule D3), whatever case they come in."""

from kbstore.messages import KnowledgeType
from kbstore.model.domain import Domain
from kbstore.model.expressions import NumericExpression
from kbstore.model.formulas import (
    And,
    Atom,
    Comparison,
    Defined,
    Exists,
    Forall,
    Formula,
    Imply,
    IsA,
    Not,
    Or,
    Parameter,
    Preference,
    Same,
    Truism,
)
from kbstore.model.symbols import SymbolTable
from kbstore.names import is_wildcard, key
from kbstore.writing.validation import VIOLATION_METRIC, Validator


class Canonicalizer:
    """Spells symbols and types as they were declared, and objects as they were first named.

    What it is given has been checked. Without a domain, the use of a symbol in a formula may be its first, which
    fixes its arity (rule D2).
    """

    def __init__(self, symbol_table: SymbolTable, validator: Validator) -> None:
        self._symbols = symbol_table
        self._validator = validator

    def condition(self, condition: Formula) -> Formula:
        """The condition, as it is shown."""
        match condition:
            case Atom():
                return self._atom(KnowledgeType.FACT, condition)
            case Defined(function):
                return Defined(self._atom(KnowledgeType.FUNCTION, function))
            case Comparison(comparison, left, right):
                return Comparison(comparison, self.expression(left), self.expression(right))
            case Same(left_term, right_term):
                return Same(self.term(left_term), self.term(right_term))
            case IsA(name, type_name):
                return IsA(self.term(name), type_name)
            case Not(part):
                return Not(self.condition(part))
            case Preference(name, part):
                return Preference(name, self.condition(part))
            case And(parts) | Or(parts):
                return type(condition)(tuple([self.condition(part) for part in parts]))
            case Imply(premise, conclusion):
                return Imply(self.condition(premise), self.condition(conclusion))
            case Exists(parameters, part) | Forall(parameters, part):
                domain = self._symbols.domain
                spelled = parameters if domain is None else tuple([_parameter(domain, p) for p in parameters])
                return type(condition)(spelled, self.condition(part))
            case Truism():
                return condition

    def expression(self, expression: NumericExpression) -> NumericExpression:
        """The numeric expression, as it is shown."""
        return tuple(
            [self._atom(KnowledgeType.FUNCTION, token) if isinstance(token, Atom) else token for token in expression]
        )

    def _atom(self, kind: KnowledgeType, atom: Atom) -> Atom:
        if key(atom.name) == VIOLATION_METRIC:
            return atom
        name, arguments = self._symbols.ordered(kind, atom.name, atom.arguments, ())
        self._symbols.learn(kind, name, len(arguments), ())
        return Atom(name, tuple(map(self.term, arguments)))

    def term(self, name: str) -> str:
        """The object's name, as it is shown; a variable stays as it is."""
        return name if is_wildcard(name) else self._validator.object_track(name).timeline.spelling


def _parameter(domain: Domain, parameter: Parameter) -> Parameter:
    return Parameter(parameter.name, tuple(map(domain.type_spelling, parameter.types)))
