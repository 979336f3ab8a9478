"""Whether what is said fits the domain and the objects that exist (rules D1, D2): each violation in one sentence."""

from collections.abc import Iterable, Iterator, Sequence

from kbstore import names
from kbstore.clock import isoformat
from kbstore.errors import InvalidKnowledge, KbStoreError
from kbstore.messages import KnowledgeType
from kbstore.model.expressions import NumericExpression, atoms_of
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
    Preference,
    Same,
)
from kbstore.model.symbols import SymbolTable
from kbstore.model.timelines import Identity, Role
from kbstore.names import key
from kbstore.pddl.parse import parse_condition, parse_item
from kbstore.writing.change_set import ChangeSet, TimelineState

VIOLATION_METRIC = "is-violated"
"""PDDL 3.0's count of a preference's violations, which stands in metrics like a function."""


class Validator:
    """Checks against a vocabulary and the objects of a draft. Without a domain, shapes only."""

    def __init__(self, draft: ChangeSet, symbol_table: SymbolTable) -> None:
        self._change_set = draft
        self._symbols = symbol_table
        self._domain = symbol_table.domain

    # -- objects ----------------------------------------------------------------------------------------------

    def object_track(self, name: str) -> TimelineState:
        """The INSTANCE timeline of an object, spelled as the domain spells a constant, or as first written."""
        name_key = key(name)
        constant = self._domain.constant_spelling(name_key) if self._domain is not None else None
        return self._change_set.track(Identity(Role.STATE, KnowledgeType.INSTANCE, name_key), constant or name)

    def type_at(self, name: str, t: int) -> str | None:
        """The type of the object that exists at `t` with that name, constants included; None if there is none."""
        if self._domain is not None:
            constant = self._domain.constant_types.get(key(name))
            if constant is not None:
                return constant
        track = self._change_set.known(Identity(Role.STATE, KnowledgeType.INSTANCE, key(name)))
        if track is None:
            return None
        if t <= self._change_set.now:
            value = track.value
            return None if value is None or value[0] else str(value[1])
        for lifespan in self._change_set.lifespans(track):
            if lifespan.start <= t < lifespan.end:
                return lifespan.type_name
        return None

    def objects(self, atom: str, arguments: Sequence[str], types: Iterable[tuple[str, ...]], t: int) -> Iterator[str]:
        """What is wrong with the arguments of an atom at a time: names, existence, types.

        A name that the knowledge base does not know is spelled from then on as it is here (rule D3).
        """
        for argument, allowed in zip(arguments, types, strict=True):
            wrong = names.problem(argument)
            if wrong:
                yield f"{atom:.200}: the name {argument!r:.60} {wrong}"
                continue
            self.object_track(argument)
            if self._domain is not None:
                type_name = self.type_at(argument, t)
                if type_name is None:
                    missing = "does not exist" + ("" if t <= self._change_set.now else f" at {isoformat(t)}")
                    advice = f"add it first, as: {argument} - {allowed[0]}"
                    yield f"{atom}: {argument} {missing}; {_expected(allowed)}; {advice}"
                elif key(type_name) not in self._domain.subtypes(allowed):
                    yield f"{atom}: {argument} is of type {type_name}; {_expected(allowed)}"

    # -- atoms and conditions ---------------------------------------------------------------------------------

    def atom(self, kind: KnowledgeType, name: str, arguments: Sequence[str], t: int) -> Iterator[str]:
        """What is wrong with a ground atom (its arity has been checked) at a time."""
        atom = f"({' '.join((name, *arguments))})"
        signature = self._symbols.signature(kind, name)
        if signature is not None:
            yield from self.objects(atom, arguments, (p.types for p in signature.parameters), t)
            return
        wrong = names.problem(name)
        if wrong:
            yield f"the name {name!r:.60} {wrong}"
        elif (kind, key(name)) not in self._symbols.shapes and not _can_be_read_back(kind, name, len(arguments)):
            yield f"{atom:.200} means something else in PDDL; give the {_SYMBOLS[kind]} another name"
        yield from self.objects(atom, arguments, [("object",)] * len(arguments), t)

    def condition(self, condition: Formula, t: int, bound: frozenset[str] = frozenset()) -> Iterator[str]:
        """What is wrong with a condition or a comparison that is to be kept, for instance as a goal."""
        match condition:
            case Atom():
                yield from self._open_atom(KnowledgeType.FACT, condition, t, bound)
            case Defined():
                yield from self._open_atom(KnowledgeType.FUNCTION, condition.function, t, bound)
            case Comparison():
                yield from self.expression(condition.left, t, bound)
                yield from self.expression(condition.right, t, bound)
            case Same():
                yield from self._terms(condition.left, condition.right, t=t, bound=bound)
            case IsA():
                yield from self._terms(condition.name, t=t, bound=bound)
            case Not() | Preference():
                yield from self.condition(condition.part, t, bound)
            case Imply():
                yield from self.condition(condition.premise, t, bound)
                yield from self.condition(condition.conclusion, t, bound)
            case And() | Or():
                for part in condition.parts:
                    yield from self.condition(part, t, bound)
            case Exists() | Forall():
                for parameter in condition.parameters:
                    for type_name in parameter.types:
                        if self._domain is not None and not self._domain.knows_type(type_name):
                            yield f"?{parameter.name} - {type_name}: the domain has no type {type_name}"
                inner = bound | {key(parameter.name) for parameter in condition.parameters}
                yield from self.condition(condition.part, t, inner)

    def expression(self, expression: NumericExpression, t: int, bound: frozenset[str] = frozenset()) -> Iterator[str]:
        """What is wrong with the functions that an expression reads."""
        for atom in atoms_of(expression):
            if key(atom.name) != VIOLATION_METRIC:
                yield from self._open_atom(KnowledgeType.FUNCTION, atom, t, bound)

    def symbols(self, expression: NumericExpression) -> Iterator[str]:
        """What is wrong with the functions that an expression reads, whatever objects there are."""
        for atom in atoms_of(expression):
            if key(atom.name) != VIOLATION_METRIC:
                try:
                    self._symbols.ordered(KnowledgeType.FUNCTION, atom.name, atom.arguments, ())
                except KbStoreError as error:
                    yield from violations_of(error, atom)

    def _open_atom(self, kind: KnowledgeType, atom: Atom, t: int, bound: frozenset[str]) -> Iterator[str]:
        try:
            self._symbols.ordered(kind, atom.name, atom.arguments, ())
            signature = self._symbols.signature(kind, atom.name)
        except KbStoreError as error:
            yield from violations_of(error, atom)
            return
        types = [p.types for p in signature.parameters] if signature else [("object",)] * len(atom.arguments)
        ground = [
            (argument, allowed)
            for argument, allowed in zip(atom.arguments, types, strict=True)
            if not (argument[:1] == "?" and key(argument[1:]) in bound)
        ]
        yield from self.objects(str(atom), [name for name, _ in ground], [allowed for _, allowed in ground], t)

    def _terms(self, *terms: str, t: int, bound: frozenset[str]) -> Iterator[str]:
        for term in terms:
            if not (term[:1] == "?" and key(term[1:]) in bound):
                yield from self.objects(term, [term], [("object",)], t)


_SYMBOLS = {KnowledgeType.FACT: "predicate", KnowledgeType.FUNCTION: "function"}


def _can_be_read_back(kind: KnowledgeType, name: str, arity: int) -> bool:
    """Whether PDDL text with a symbol that no domain declares says the same again: ``(and a)`` does not (rule D3)."""
    atom = Atom(name, tuple(f"x{index}" for index in range(arity)))
    text = str(atom) if kind is KnowledgeType.FACT else f"(= {atom} 0)"
    try:
        item = parse_item(text)
        return item.knowledge_type is kind and (kind is KnowledgeType.FUNCTION or parse_condition(text) == atom)
    except KbStoreError:
        return False


def violations_of(error: KbStoreError, about: object) -> tuple[str, ...]:
    """The sentences of an error that is one of the violations of a transaction, each naming what it is about."""
    return naming(about, error.violations if isinstance(error, InvalidKnowledge) else (str(error),))


def naming(about: object, sentences: Iterable[str]) -> tuple[str, ...]:
    """Sentences, each beginning with what it is about where it does not name that anyway."""
    text = str(about)
    return tuple(sentence if text in sentence else f"{text:.200}: {sentence}" for sentence in sentences)


def _expected(allowed: Sequence[str]) -> str:
    return f"an object of type {' or '.join(allowed)} is expected"
