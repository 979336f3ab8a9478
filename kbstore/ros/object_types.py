"""Infers the types of objects that messages name without types, from the arguments in which the objects occur."""

from collections.abc import Iterable, Mapping

from kbstore.errors import InvalidKnowledge
from kbstore.model.actions import Action
from kbstore.model.domain import ROOT_TYPE, Domain, Signature
from kbstore.names import key

MOST = 10
"""The most objects without a type that an error names."""


class ObjectTypes:
    """The types of objects by name: given ones, and inferred ones, which are the only types that fit."""

    def __init__(self, domain: Domain, given: Mapping[str, str]) -> None:
        self._domain = domain
        self._types = {key(name): type_name for name, type_name in given.items()}
        self._possible: dict[str, frozenset[str]] = {}

    def give(self, name: str, type_name: str) -> None:
        """Set the type of an object; it replaces one that was given or inferred before."""
        self._types[key(name)] = type_name

    def knows(self, name: str) -> bool:
        """Return whether the type of an object is given or inferred, or the object is a constant."""
        return key(name) in self._types or self._domain.constant_spelling(name) is not None

    def observe(self, symbol: Signature | Action, arguments: Iterable[str]) -> None:
        """Infer from arguments: each is of the type of its parameter, or of one below it."""
        for name, parameter in zip(arguments, symbol.parameters, strict=False):
            if self.knows(name):
                continue
            fitting = self._candidates(name) & self._domain.subtypes(parameter.types)
            self._possible[key(name)] = fitting
            if len(fitting) == 1:
                self.give(name, self._domain.type_spelling(*fitting))

    def types_of(self, names: Iterable[str]) -> dict[str, str]:
        """Return the type of each object, without constants.

        Raises `InvalidKnowledge` with the objects whose types are neither given nor can be inferred.
        """
        found, unknown = {}, []
        for name in names:
            type_name = self._types.get(key(name)) or self._only_type(name)
            if self._domain.constant_spelling(name) is not None:
                continue
            if type_name is None:
                unknown.append(self._unknown(name))
            else:
                found[name] = type_name
        if len(unknown) > MOST:
            unknown[MOST:] = [f"and {len(unknown) - MOST} more objects"]
        if unknown:
            raise InvalidKnowledge(*unknown)
        return found

    def _candidates(self, name: str) -> frozenset[str]:
        return self._possible.get(key(name), self._domain.subtypes((ROOT_TYPE,)))

    def _only_type(self, name: str) -> str | None:
        candidates = self._candidates(name)
        return self._domain.type_spelling(*candidates) if len(candidates) == 1 else None

    def _unknown(self, name: str) -> str:
        fitting = sorted(map(self._domain.type_spelling, self._candidates(name)))
        if not fitting:
            return f"{name} occurs where no type fits all of its places; give the problem that declares it"
        return f"the type of {name} is not given, and may be {' or '.join(fitting)}; give the problem that declares it"
