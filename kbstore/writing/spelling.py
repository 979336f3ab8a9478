"""Formulas that are kept, with their names as first written (rule D3), whatever case they come in."""

from kbstore.domain import Domain
from kbstore.logic import (
    And,
    Atom,
    Comparison,
    Condition,
    Defined,
    Exists,
    Expression,
    Forall,
    Imply,
    IsA,
    Not,
    Or,
    Parameter,
    Preference,
    Same,
    Truism,
)
from kbstore.messages import KnowledgeType
from kbstore.names import is_wildcard, key
from kbstore.vocabulary import Vocabulary
from kbstore.writing.checks import VIOLATION_METRIC, Checks


class Spelling:
    """Spells symbols and types as they were declared, and objects as they were first named.

    What it is given has been checked. Without a domain, the use of a symbol in a formula may be its first, which
    fixes its arity (rule D2).
    """

    def __init__(self, vocabulary: Vocabulary, checks: Checks) -> None:
        self._vocabulary = vocabulary
        self._checks = checks

    def condition(self, condition: Condition) -> Condition:
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
                domain = self._vocabulary.domain
                spelled = parameters if domain is None else tuple([_parameter(domain, p) for p in parameters])
                return type(condition)(spelled, self.condition(part))
            case Truism():
                return condition

    def expression(self, expression: Expression) -> Expression:
        """The numeric expression, as it is shown."""
        return tuple(
            [self._atom(KnowledgeType.FUNCTION, token) if isinstance(token, Atom) else token for token in expression]
        )

    def _atom(self, kind: KnowledgeType, atom: Atom) -> Atom:
        if key(atom.name) == VIOLATION_METRIC:
            return atom
        name, arguments = self._vocabulary.ordered(kind, atom.name, atom.arguments, ())
        self._vocabulary.learn(kind, name, len(arguments), ())
        return Atom(name, tuple(map(self.term, arguments)))

    def term(self, name: str) -> str:
        """The object's name, as it is shown; a variable stays as it is."""
        return name if is_wildcard(name) else self._checks.object_track(name).timeline.spelling


def _parameter(domain: Domain, parameter: Parameter) -> Parameter:
    return Parameter(parameter.name, tuple(map(domain.type_spelling, parameter.types)))
