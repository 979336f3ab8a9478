"""Prepared questions: read, checked and compiled once for each version of the domain."""

from collections.abc import Hashable, Iterable, Iterator
from typing import Protocol, cast, get_args

from kbstore.evaluation import expressions
from kbstore.evaluation.argument_types import named_arguments
from kbstore.evaluation.evaluator import Evaluation
from kbstore.evaluation.interpretation import Interpretation
from kbstore.evaluation.wellformed import check, check_expression
from kbstore.messages import Condition, Fact, Function, KnowledgeType, Truth
from kbstore.model.domain import Domain
from kbstore.model.expressions import NumericExpression, atoms_of
from kbstore.model.formulas import Atom, Comparison, Defined, Forall, Formula, Imply, Not, Or, symbols_in, walk
from kbstore.model.symbols import SymbolTable
from kbstore.model.timelines import StateRow, Timeline, atom_key
from kbstore.names import is_wildcard, key
from kbstore.reading.questions import Question, as_condition, as_expression
from kbstore.storage.caches import LRU, QUESTIONS

_FORMULAS = get_args(Formula)


class World(Interpretation, Protocol):
    """An interpretation whose timelines can be looked at."""

    def row(self, kind: KnowledgeType, name: str) -> StateRow | None:
        """The assertion that holds on a timeline of the state."""


class PreparedCondition:
    """A condition, checked; if a single timeline decides it (`key` is not None), with the truth for each case.

    Attributes:
        kind, key: the knowledge type and the key of that timeline.
        timeline: the generation of the store, and that timeline, once it has been looked up.
        if_asserted, if_denied, if_absent: the truth if the timeline's assertion is positive, explicitly negative, or
            absent.
        named: the objects that the condition names, which have to be of the right types (rule V10).
        plausible: the generation of the store, the number of a transaction after which none of these had ever been of a
            wrong type, and the token of the last one after which that was still so; 0 if it is not known.
        proves_types: whether the condition can be true only if they are of the right types, as each of its atoms is
            true then.
    """

    __slots__ = (
        "formula",
        "if_absent",
        "if_asserted",
        "if_denied",
        "key",
        "kind",
        "named",
        "plausible",
        "proves_types",
        "timeline",
    )

    def __init__(self, formula: Formula, domain: Domain | None, *, use_unknowns: bool) -> None:
        self.formula = formula
        self.named = named_arguments(formula, domain)
        self.plausible = 0, 0, 0
        self.proves_types = not any(isinstance(node, Not | Or | Imply | Forall) for node, _, _ in walk(formula, {}))
        self.timeline: tuple[int, Timeline | None] = (0, None)
        part = formula.part if isinstance(formula, Not) else formula
        absent = Truth.FALSE
        self.key: str | None = None
        self.kind = KnowledgeType.FACT
        if isinstance(part, Defined):
            self.kind = KnowledgeType.FUNCTION
            self.key = ground_key(part.function)
        elif isinstance(part, Atom) and not (domain and domain.is_derived(part.name)):
            self.key = ground_key(part)
            absent = Truth.UNKNOWN if use_unknowns else Truth.FALSE
        if domain is not None and domain.events and not symbols_in(formula).isdisjoint(domain.forecast.uncomputed):
            self.key = None
        outcomes = Truth.TRUE, Truth.FALSE, absent
        if part is not formula:
            outcomes = ~outcomes[0], ~outcomes[1], ~outcomes[2]
        self.if_asserted, self.if_denied, self.if_absent = outcomes

    def evaluate(self, world: World) -> Truth:
        """Return the truth in a world."""
        if self.key is None:
            return Evaluation(world).evaluate(self.formula, {})
        row = world.row(self.kind, self.key)
        return self.if_absent if row is None else self.if_denied if row[2][0] else self.if_asserted


class PreparedExpression:
    """A numeric expression, checked; if it is a single function (`key` is not None), one timeline has its value.

    Attributes:
        kind, key: the knowledge type and the key of that timeline.
        timeline: the generation of the store, and that timeline, once it has been looked up.
        named, plausible, proves_types: as in `PreparedCondition`; if the expression has a value, so has each function.
    """

    __slots__ = ("expression", "key", "named", "plausible", "timeline")

    kind = KnowledgeType.FUNCTION
    proves_types = True

    def __init__(self, expression: NumericExpression, domain: Domain | None) -> None:
        self.expression = expression
        self.named = named_arguments(expression, domain)
        self.plausible = 0, 0, 0
        self.timeline: tuple[int, Timeline | None] = (0, None)
        only = expression[0] if len(expression) == 1 else None
        self.key = ground_key(only) if isinstance(only, Atom) else None
        if isinstance(only, Atom) and domain is not None and key(only.name) in domain.forecast.uncomputed:
            self.key = None

    def evaluate(self, world: World) -> float:
        """Return the value in a world. Raises `UndefinedFunction` or `DivisionByZero` if it has none."""
        return expressions.evaluate(self.expression, world)


class PreparedQuestions:
    """Prepares the questions asked of one knowledge base, and caches them (`kbstore.storage.caches`).

    Attributes:
        conditions, expressions: the caches, by domain and question (see `question_key`).
        caching: whether prepared questions are cached.
    """

    def __init__(self, *, use_unknowns: bool, caching: bool = True) -> None:
        self.caching = caching
        bound = QUESTIONS if caching else 0
        self.conditions: LRU[tuple[Domain | None, Hashable], PreparedCondition] = LRU(bound)
        self.expressions: LRU[tuple[Domain | None, Hashable], PreparedExpression] = LRU(bound)
        self._use_unknowns = use_unknowns

    def forget(self) -> None:
        """Forget the prepared questions, which know the numbers of their timelines, as the store has gone back."""
        self.conditions.clear()
        self.expressions.clear()

    def condition(self, question: Question, symbols: SymbolTable) -> PreparedCondition:
        """Prepare a condition. Raises what `kbstore.reading.questions.as_condition` raises, and `check`."""
        name = question_key(question)
        prepared = None if name is None else self.conditions.find((symbols.domain, name))
        if prepared is None:
            formula = as_condition(question, symbols)
            check(formula, symbols.domain)
            prepared = PreparedCondition(formula, symbols.domain, use_unknowns=self._use_unknowns)
            # without a domain, "(f a)" would mean a predicate f as soon as there is one
            is_ambiguous = symbols.domain is None and isinstance(question, str) and isinstance(formula, Defined)
            if name is not None and not is_ambiguous and _is_lasting(question, symbols, atoms_in(formula)):
                self.conditions.put((symbols.domain, name), prepared)
        return prepared

    def expression(self, question: Question, symbols: SymbolTable) -> PreparedExpression:
        """Prepare an expression. Raises what `kbstore.reading.questions.as_expression` raises, and `check`."""
        name = question_key(question)
        prepared = None if name is None else self.expressions.find((symbols.domain, name))
        if prepared is None:
            expression = as_expression(question, symbols)
            check_expression(expression, symbols.domain)
            prepared = PreparedExpression(expression, symbols.domain)
            atoms = ((KnowledgeType.FUNCTION, atom) for atom in atoms_of(expression))
            if name is not None and _is_lasting(question, symbols, atoms):
                self.expressions.put((symbols.domain, name), prepared)
        return prepared


def question_key(question: Question) -> Hashable | None:
    """Return the cache key of a question: equal for questions that ask the same; None if it is not worth caching."""
    if isinstance(question, str):
        return question
    if isinstance(question, Fact):
        return Fact, question.key, question.is_negative, question.labels
    if isinstance(question, Function):
        return Function, question.key, question.is_negative, question.labels, question.function_value
    if isinstance(question, Condition):
        return Condition, question.text
    if isinstance(question, (*_FORMULAS, tuple)):
        try:
            hash(question)
        except TypeError:
            return None
        return cast("Hashable", question)
    return None


def _is_lasting(question: Question, symbols: SymbolTable, atoms: Iterable[tuple[KnowledgeType, Atom]]) -> bool:
    """Return whether a question keeps its meaning when other symbols are used for the first time later (rule D2)."""
    if symbols.domain is not None:
        return True
    if isinstance(question, Fact | Function) and any(question.labels):
        inferred = symbols.inferred.get((question.knowledge_type, question.key[0]))
        if inferred is None or inferred.labels is None:
            return False
    return all((kind, key(atom.name)) in symbols.inferred for kind, atom in atoms)


def atoms_in(formula: Formula) -> Iterator[tuple[KnowledgeType, Atom]]:
    """Yield the atoms of a condition, each with its knowledge type."""
    for node, _, _ in walk(formula, {}):
        match node:
            case Atom():
                yield KnowledgeType.FACT, node
            case Defined(function):
                yield KnowledgeType.FUNCTION, function
            case Comparison(_, left, right):
                for function in atoms_of((*left, *right)):
                    yield KnowledgeType.FUNCTION, function


def ground_key(atom: Atom) -> str | None:
    """Return the key of an atom's timeline; None if the atom has variables or wildcards."""
    if any(map(is_wildcard, atom.arguments)):
        return None
    return atom_key([key(word) for word in (atom.name, *atom.arguments)])
