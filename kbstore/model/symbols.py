"""Symbol table: the domain's declarations, or, without a domain, signatures inferred from the first use."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from typing import NamedTuple

from kbstore.errors import InvalidKnowledge, UnknownSymbol, one_line
from kbstore.messages.enums import KnowledgeType
from kbstore.model.actions import Action
from kbstore.model.domain import Domain, Signature
from kbstore.model.formulas import Atom
from kbstore.names import key


class InferredSignature(NamedTuple):
    """The signature of a symbol without a domain, from its first use (rule D2); without labels until some are given."""

    name: str
    arity: int
    labels: tuple[str, ...] | None


@dataclass
class SymbolTable:
    """The symbols that items may use: those of the domain, or, without one, those in `inferred`."""

    domain: Domain | None = None
    inferred: dict[tuple[KnowledgeType, str], InferredSignature] = field(default_factory=dict)

    def signature(self, kind: KnowledgeType, name: str) -> Signature | None:
        """The domain's declaration of a predicate or function; None without a domain. Raises `UnknownSymbol`."""
        if self.domain is None:
            return None
        if kind is KnowledgeType.FACT:
            return self.domain.predicate_signature(name)
        return self.domain.function_signature(name)

    def labels(self, kind: KnowledgeType, name: str, arity: int) -> Sequence[str]:
        """Return the labels with which the arguments of a stored atom are shown."""
        if self.domain is not None:
            symbols = (
                self.domain.predicate_signatures if kind is KnowledgeType.FACT else self.domain.function_signatures
            )
            signature = symbols.get(name)
            if signature is not None and len(signature.labels) == arity:
                return signature.labels
        inferred = self.inferred.get((kind, name))
        if inferred is not None and inferred.labels is not None and len(inferred.labels) == arity:
            return inferred.labels
        return _numbered(arity)

    def is_function(self, name: str) -> bool:
        """Return whether a name is that of a numeric function, and not of a predicate as well."""
        if self.domain is not None:
            return key(name) in self.domain.function_signatures and key(name) not in self.domain.predicate_signatures
        inferred = self.inferred
        return (KnowledgeType.FUNCTION, key(name)) in inferred and (KnowledgeType.FACT, key(name)) not in inferred

    def known(self, kind: KnowledgeType, name: str) -> bool:
        """Return whether a predicate or function may be asked about; without a domain, any may."""
        try:
            self.signature(kind, name)
        except UnknownSymbol:
            return False
        return True

    def ordered(
        self, kind: KnowledgeType, name: str, arguments: Sequence[str], labels: Sequence[str]
    ) -> tuple[str, tuple[str, ...]]:
        """Return the symbol as it is spelled, and the arguments in the order of its parameters.

        Raises `UnknownSymbol` for a symbol that the domain does not know, `InvalidKnowledge` for a wrong number of
        arguments or for labels that are not those of the parameters (rules D1, D2).
        """
        atom = Atom(name, tuple(arguments))
        signature = self.signature(kind, name)
        if signature is not None:
            wrong = arity_problem(atom, signature)
            spelled, known, declared = signature.name, signature.labels, str(signature)
        else:
            inferred = self.inferred.get((kind, key(name)))
            if inferred is None:
                _refuse_repeated(atom, labels)
                return name, atom.arguments
            spelled, known = inferred.name, inferred.labels or _numbered(inferred.arity)
            declared = f"{inferred.name} was first used with {_count(inferred.arity, 'argument')}"
            if inferred.labels is not None:
                declared += f", labelled {', '.join(inferred.labels)}"
            wrong = None if len(arguments) == inferred.arity else _wrong_arity(atom, declared)
            if inferred.labels is None and wrong is None:
                _refuse_repeated(atom, labels)
                return spelled, atom.arguments
        if wrong:
            raise InvalidKnowledge(wrong)
        if not any(labels):
            return spelled, atom.arguments
        expected = [key(label) for label in known]
        if [key(label) for label in labels] == expected:
            return spelled, atom.arguments
        by_label = dict(zip(map(key, labels), arguments, strict=True))
        if len(by_label) != len(expected) or by_label.keys() != set(expected):
            given = ", ".join(label or "(none)" for label in labels)
            raise InvalidKnowledge(f"{atom}: its labels are {given}; expected {', '.join(known)}: {declared}")
        return spelled, tuple(by_label[label] for label in expected)

    def learn(self, kind: KnowledgeType, name: str, arity: int, labels: Sequence[str]) -> InferredSignature | None:
        """Record the signature of a symbol's first use, and its first labels; return it if that is new."""
        if self.domain is not None:
            return None
        known = self.inferred.get((kind, key(name)))
        given = tuple(labels) if labels and all(labels) else None
        if known is not None and (known.labels is not None or given is None):
            return None
        inferred = InferredSignature(known.name if known else name, arity, given)
        self.inferred[kind, key(name)] = inferred
        return inferred


@lru_cache(maxsize=64)
def _numbered(arity: int) -> tuple[str, ...]:
    return tuple(f"arg{index + 1}" for index in range(arity))


def arity_problem(atom: Atom, declared: Signature | Action) -> str | None:
    """Return the reason why a number of arguments is not the declared one; None if it is."""
    if len(atom.arguments) == len(declared.parameters):
        return None
    parameters = " ".join((declared.name, *(f"?{p.name} - {p.type_text}" for p in declared.parameters)))
    return _wrong_arity(atom, f"({parameters}) takes {len(declared.parameters)}")


def _wrong_arity(atom: Atom, expected: str) -> str:
    return f"{one_line(str(atom)):.200} has {_count(len(atom.arguments), 'argument')}, but {expected}"


def _refuse_repeated(atom: Atom, labels: Sequence[str]) -> None:
    given = [key(label) for label in labels if label]
    if len(set(given)) != len(given):
        raise InvalidKnowledge(
            f"{one_line(str(atom))}: a label is given twice among {', '.join(given)}; give each argument its own label"
        )


def _count(number: int, noun: str) -> str:
    return f"{number} {noun}" if number == 1 else f"{number} {noun}s"
