"""Translates types, predicates, functions and objects to those of unified_planning."""

import importlib
from collections import Counter, OrderedDict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from typing import Any

from kbstore.errors import InvalidKnowledge, MissingLibrary
from kbstore.model.domain import ROOT_TYPE, Domain, Signature
from kbstore.model.formulas import Effect, Exists, Forall, ForEach, Formula, Parameter, children
from kbstore.names import key


def library() -> Any:
    """Import the package unified_planning. Raises `MissingLibrary` if it is not installed."""
    try:
        importlib.import_module("unified_planning.shortcuts")
        return importlib.import_module("unified_planning")
    except ImportError as error:
        raise MissingLibrary(
            f"planning needs the library unified_planning, which cannot be imported ({error});"
            " install it with: pip install 'kbstore[planning]'"
        ) from error


class Refusals:
    """Collects what unified_planning cannot express, so that all of it is reported together."""

    def __init__(self) -> None:
        self.violations: list[str] = []
        up = library()
        # besides its own exceptions the library raises assertions, and recurses into deep formulas
        self._kinds = (up.exceptions.UPException, AssertionError, RecursionError)

    @contextmanager
    def of(self, what: str) -> Iterator[None]:
        """Collect the refusals of the block, which is about `what`."""
        try:
            yield
        except InvalidKnowledge as error:
            self.violations += [f"{what}: {violation}" for violation in error.violations]
        except self._kinds as error:
            reason = str(error) or type(error).__name__
            self.violations.append(f"{what}: unified_planning refuses it: {reason}")

    def report(self) -> None:
        """Raise `InvalidKnowledge` with everything that was refused, if anything was."""
        if self.violations:
            raise InvalidKnowledge(*self.violations)


class SymbolTranslator:
    """Translates the symbols of a problem; finds them by name in any case, and spells them as the domain does.

    A predicate or function of an ``either`` type takes the nearest common supertype. The type ``object`` is made only
    where something is of that type, so that flat domains stay flat.
    """

    def __init__(
        self, domain: Domain, objects: Mapping[str, str], types_in_use: Iterable[str], environment: Any
    ) -> None:
        self.domain = domain
        self.environment = environment
        self.has_root = any(key(name) == ROOT_TYPE for name in types_in_use)
        self._up = library()
        self._parents = {key(name): key(parent) for name, parent in domain.types.items()}
        self._types: dict[str, Any] = {}
        self._fluents: dict[str, Any] = {}
        self._objects: dict[str, Any] = {}
        self._named = {key(name): (name, type_name) for name, type_name in objects.items()}

    def object(self, name: str) -> Any:
        """Translate an object or constant. Raises `InvalidKnowledge` if there is none of that name."""
        name_key = key(name)
        if name_key not in self._named:
            raise InvalidKnowledge(f"{name} does not exist")
        if name_key not in self._objects:
            spelling, type_name = self._named[name_key]
            self._objects[name_key] = self._up.model.Object(spelling, self.type(type_name), self.environment)
        return self._objects[name_key]

    def types(self) -> list[Any]:
        """Translate all types of the domain."""
        return [self.type(name) for name in self.domain.types if self.has_root or key(name) != ROOT_TYPE]

    def type(self, name: str) -> Any:
        """Translate a type. Raises `InvalidKnowledge` for one that has several parents, or is below itself."""
        above = [key(name)]
        while above[-1] != ROOT_TYPE:
            parent = self._parents.get(above[-1], ROOT_TYPE)
            if parent.startswith("(") or parent in above:
                raise InvalidKnowledge(
                    f"the type {name} is below {parent}; a type of unified_planning has one parent, above itself"
                )
            above.append(parent)
        father = None
        for type_key in reversed(above):
            if type_key == ROOT_TYPE and not self.has_root:
                continue
            if type_key not in self._types:
                spelling = self.domain.type_spelling(type_key)
                self._types[type_key] = self.environment.type_manager.UserType(spelling, father)
            father = self._types[type_key]
        return father

    def parameters(self, parameters: Sequence[Parameter]) -> "OrderedDict[str, Any]":
        """Translate parameters with their types."""
        return OrderedDict((p.name, self.type(common_type(self.domain, p.types))) for p in parameters)

    def predicate(self, name: str) -> Any:
        """Translate a predicate to a fluent. Raises `InvalidKnowledge` for a derived one."""
        if self.domain.is_derived(name):
            raise InvalidKnowledge(f"{name} is a derived predicate, and unified_planning has none")
        return self._fluent(self.domain.predicate_signature(name), self.environment.type_manager.BoolType())

    def function(self, name: str) -> Any:
        """Translate a numeric function to a fluent."""
        return self._fluent(self.domain.function_signature(name), self.environment.type_manager.RealType())

    def _fluent(self, signature: Signature, values: Any) -> Any:
        name = key(signature.name)
        if name not in self._fluents:
            parameters = self.parameters(_distinct(signature.parameters))
            self._fluents[name] = self._up.model.Fluent(signature.name, values, parameters, self.environment)
        return self._fluents[name]


def _distinct(parameters: Sequence[Parameter]) -> list[Parameter]:
    """Number the names of parameters that are given twice, as PDDL allows for predicates and functions."""
    names: dict[str, str] = {}
    for parameter in parameters:
        name, number = parameter.name, 2
        while key(name) in names:
            name, number = f"{parameter.name}_{number}", number + 1
        names[key(name)] = name
    return [replace(p, name=name) for p, name in zip(parameters, names.values(), strict=True)]


def common_type(domain: Domain, types: Sequence[str]) -> str:
    """Return the nearest common supertype of types."""
    first, *others = types
    return next(
        above for above in domain.supertypes(first) if all(domain.is_subtype(other, (above,)) for other in others)
    )


def quantified(formula: Formula | Effect) -> Iterator[str]:
    """Yield the types that the quantifiers of a condition or an effect range over."""
    todo: list[Formula | Effect] = [formula]
    while todo:
        node = todo.pop()
        if isinstance(node, Exists | Forall | ForEach):
            yield from (type_name for parameter in node.parameters for type_name in parameter.types)
        todo.extend(children(node))


def ambiguous_names(domain: Domain, objects: Iterable[str]) -> list[str]:
    """Return the names that mean several things; PDDL distinguishes these, unified_planning only if asked to."""
    predicates = (signature.name for signature in domain.predicate_signatures.values())
    functions = (signature.name for signature in domain.function_signatures.values())
    operators = (action.name for action in domain.actions.values())
    counted = Counter((*domain.types, *predicates, *functions, *operators, *objects))
    return [name for name, count in counted.items() if count > 1]
