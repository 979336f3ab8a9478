"""The scope of a formula: what names refer to in it, and how one that refers to nothing is reported."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field

from kbstore.errors import InvalidKnowledge, KbStoreError, PddlSyntaxError, UnknownSymbol
from kbstore.model.domain import ROOT_TYPE, Domain, Signature
from kbstore.model.formulas import Atom, Parameter, Variables, object_terms
from kbstore.model.symbols import arity_problem
from kbstore.names import is_wildcard, key
from kbstore.pddl.sexpr import Group, Node, SourceText, bounded, node_text

Report = Callable[[type[KbStoreError], str, int], None]
"""The handler of something that can be read but does not fit: its kind of error, a sentence, an offset."""

NO_VARIABLES: Variables = {}
_MAX_TERMS = 50
_LISTED = 12


@dataclass
class Scope:
    """The text that is read, and what its names may refer to.

    Without `domain` every predicate, function and type is known. `objects` maps the objects that may be named to
    their types (both as keys); without it any object may be named. In `patterns`, such as questions, free variables
    match any object (rule V7), and functions and objects may be conditions. A text that `is_stored` has been checked:
    without a domain, terms in it are those of object fluents.
    """

    source: SourceText
    domain: Domain | None = None
    objects: Mapping[str, str] | None = None
    report: Report | None = None
    patterns: bool = False
    is_stored: bool = False
    diagnosed: int = 0
    _fits: dict[tuple[tuple[str, ...], tuple[str, ...], bool], bool] = field(default_factory=dict)

    def error(self, problem: str, group: Group, index: int | None = None) -> PddlSyntaxError:
        """Return the error for text that is not PDDL, with its place: a group, or its child at an index."""
        return self.source.error(problem, self.source.offset(group, index))

    def diagnose(self, kind: type[KbStoreError], problem: str, group: Group, index: int | None = None) -> None:
        """Report a part that is PDDL but does not fit; without `report`, as for questions, raise it at once."""
        self.diagnose_at(kind, problem, -1 if self.report is None else self.source.offset(group, index))

    def diagnose_at(self, kind: type[KbStoreError], problem: str, offset: int) -> None:
        """Report a part that does not fit, at an offset of the text."""
        self.diagnosed += 1
        if self.report is None:
            raise kind(bounded(problem))
        self.report(kind, problem, offset)

    # -- words ------------------------------------------------------------------------------------------------

    def name(self, group: Group, index: int, what: str) -> str:
        """Return the word at a place, as written: the name of a `what` ("predicate"). Raises `PddlSyntaxError`."""
        if index >= len(group):
            raise self.error(f"the name of the {what} is missing", group, index)
        node = group[index]
        if isinstance(node, Group):
            raise self.error(f"the name of a {what} is expected here, not {node_text(node, 60)}", group, index)
        return node

    def words(self, group: Group, start: int) -> tuple[str, ...]:
        """Return the words of a group from a place on, names of objects or variables. Raises `PddlSyntaxError`."""
        for index in range(start, len(group)):
            if isinstance(group[index], Group):
                raise self.error(
                    f"the arguments of {group.word(0)} are names of objects or variables, not "
                    f"{node_text(group[index], 60)}",
                    group,
                    index,
                )
        return tuple(group[start:])  # type: ignore[arg-type]

    # -- object fluents ---------------------------------------------------------------------------------------

    def is_object_term(self, node: Node) -> bool:
        """Return whether a group is the term of an object fluent, as in ``(= (location ?r) wp0)`` (rule P4)."""
        if not isinstance(node, Group):
            return False
        if self.domain is None:
            return self.is_stored and node.word(0) not in ("", "+", "-", "*", "/", "total-time", "is-violated")
        return key(node.word(0)) in self.domain.object_fluents

    def object_term(self, term: Group, variables: Variables, depth: int = 0) -> str:
        """Check the arguments of an object fluent's term, and return it as text."""
        if depth > _MAX_TERMS:
            raise self.error(f"terms nested deeper than {_MAX_TERMS} levels cannot be read", term)
        signature = self.domain.object_fluents[key(term.word(0))].signature if self.domain else None
        return str(self.atom(term, signature, variables, depth=depth + 1))

    # -- symbols ----------------------------------------------------------------------------------------------

    def predicate(self, name: str, group: Group) -> Signature | None:
        """Return the predicate of that name; if the domain has none, report it and return None."""
        if self.domain is None:
            return None
        found = self.domain.predicate_signatures.get(key(name))
        if found is None:
            if key(name) in self.domain.object_fluents:
                self.diagnose(
                    InvalidKnowledge, f"{self.domain.uncomputed[key(name)]}; it is not true or false", group, 0
                )
                return None
            if key(name) in self.domain.function_signatures:
                problem = (
                    f"{name:.80} is a numeric function, not a predicate; compare its value, as in (> ({name:.80}) 0)"
                )
            else:
                problem = _unknown("predicate", name, self.domain, self.domain.predicate_signatures.values())
            self.diagnose(UnknownSymbol, problem, group, 0)
        return found

    def function(self, name: str, group: Group, index: int | None = 0) -> Signature | None:
        """Return the numeric function of that name; if the domain has none, report it and return None."""
        if self.domain is None:
            return None
        found = self.domain.function_signatures.get(key(name))
        if found is None:
            if key(name) in self.domain.object_fluents:
                self.diagnose(
                    InvalidKnowledge, f"{self.domain.uncomputed[key(name)]}; it has no numeric value", group, index
                )
                return None
            if key(name) in self.domain.predicate_signatures:
                problem = f"{name:.80} is a predicate, not a numeric function, and has no value"
            else:
                problem = _unknown("numeric function", name, self.domain, self.domain.function_signatures.values())
            self.diagnose(UnknownSymbol, problem, group, index)
        return found

    def is_predicate(self, name: str) -> bool:
        """Return whether the domain declares a predicate of that name."""
        return self.domain is not None and key(name) in self.domain.predicate_signatures

    def is_function(self, name: str) -> bool:
        """Return whether a name is that of a numeric function of the domain, and not of a predicate as well."""
        return (
            self.domain is not None
            and key(name) in self.domain.function_signatures
            and key(name) not in self.domain.predicate_signatures
        )

    def is_bare_function(self, word: str) -> bool:
        """Return whether a word is a function without parameters, as in the old spelling ``(= total-cost 0)``."""
        if self.domain is None or self.is_object(word):
            return False
        found = self.domain.function_signatures.get(key(word))
        return found is not None and not found.parameters

    def is_object(self, word: str) -> bool:
        """Return whether a word is known to be an object."""
        return self.objects is not None and key(word) in self.objects

    def type_name(self, name: str, group: Group, index: int) -> str:
        """Return a type in the domain's spelling; report an unknown one, and return it as written."""
        if self.domain is None:
            return name
        if not self.domain.knows_type(name):
            known = ", ".join(list(self.domain.types)[:_LISTED]) or "none but object"
            problem = f"the type {name:.80} is not declared; the domain {self.domain.name} has {known}"
            self.diagnose(UnknownSymbol, problem, group, index)
            return name
        return self.domain.type_spelling(name)

    def knows_type(self, name: str) -> bool:
        """Return whether a word is a type of the domain."""
        return self.domain is not None and self.domain.knows_type(name)

    def unglued(self, group: Group) -> Group:
        """Return a group with its variable split off the predicate where both are glued, as in ``(aircraft?a)``."""
        head = group.word(0)
        if "?" not in head[1:] or self.domain is None or self.is_predicate(head):
            return group
        name, _, variable = str(group[0]).partition("?")
        if not self.is_predicate(name):
            return group
        split = Group([name, f"?{variable}", *group[1:]])
        split.start = group.start
        return split

    # -- atoms ------------------------------------------------------------------------------------------------

    def atom(
        self,
        group: Group,
        signature: Signature | None,
        variables: Variables = NO_VARIABLES,
        *,
        asserted: bool = False,
        depth: int = 0,
    ) -> Atom:
        """Read an atom, and check its arguments against the signature.

        If it is `asserted`, as in an effect, a variable has to be of the parameter's type. In a condition it may be of
        a type above, as some of its values may fit.
        """
        atom = Atom(str(group[0]), self._arguments(group, variables, depth))
        wrong = arity_problem(atom, signature) if signature is not None else None
        if wrong:
            self.diagnose(InvalidKnowledge, wrong, group)
            signature = None
        for index, argument in enumerate(atom.arguments, 1):
            parameter = signature.parameters[index - 1] if signature else None
            problem = self.misfit(argument, variables, parameter, asserted=asserted)
            if problem:
                declared = f"; it is declared {signature}" if signature else ""
                self.diagnose(InvalidKnowledge, f"{node_text(group, 80)}: {problem}{declared}", group, index)
        return atom

    def misfit(
        self, argument: str, variables: Variables, parameter: Parameter | None = None, *, asserted: bool = False
    ) -> str | None:
        """Return the reason why an argument does not fit a parameter; None if it fits."""
        types: tuple[str, ...] | None
        if argument[:1] == "(":
            types = self._term_types(argument)
        elif is_wildcard(argument):
            types = variables.get(key(argument[1:]))
            if types is None:
                return None if self.patterns else _unbound(argument, variables)
        elif self.objects is None:
            return None
        elif key(argument) in self.objects:
            types = (self.objects[key(argument)],)
            asserted = True
        else:
            return f"{argument:.80} is not a declared object or constant"
        if parameter is None or self.domain is None or self.patterns:
            return None
        if self._fit(types, parameter.types, asserted):
            return None
        return f"{argument:.80} is of type {Parameter('', types).type_text}, but {parameter.type_text} is expected"

    def _arguments(self, group: Group, variables: Variables, depth: int) -> tuple[str, ...]:
        """The arguments of an atom, terms of object fluents as text."""
        if not any(map(self.is_object_term, group)):
            return self.words(group, 1)
        terms = [self.object_term(node, variables, depth) if isinstance(node, Group) else node for node in group[1:]]
        return tuple(terms)

    def _term_types(self, term: str) -> tuple[str, ...]:
        """The types of the value of an object fluent's term."""
        return self.domain.object_fluents[key(object_terms(term)[0])].types if self.domain else (ROOT_TYPE,)

    def _fit(self, types: tuple[str, ...], wanted: tuple[str, ...], asserted: bool) -> bool:
        question = (types, wanted, asserted)
        if question not in self._fits:
            self._fits[question] = self.domain is None or _fit(self.domain, *question)
        return self._fits[question]


def _fit(domain: Domain, types: tuple[str, ...], wanted: tuple[str, ...], asserted: bool) -> bool:
    if all(domain.is_subtype(type_name, wanted) for type_name in types):
        return True
    return not asserted and any(
        domain.is_subtype(one, wanted) or any(domain.is_subtype(other, (one,)) for other in wanted) for one in types
    )


def fail_at_once(source: SourceText) -> Report:
    """Return a `Report` that raises `PddlSyntaxError`, with the place, for the first thing that does not fit."""

    def report(_kind: type[KbStoreError], problem: str, offset: int) -> None:
        raise source.error(problem, offset)

    return report


def _unbound(variable: str, variables: Variables) -> str:
    if not variables:
        return f"{variable:.80} is a variable, but an object is expected here"
    return f"the variable {variable:.80} is not declared here; there are {', '.join(f'?{name}' for name in variables)}"


def _unknown(what: str, name: str, domain: Domain, known: Iterable[Signature]) -> str:
    names = [signature.name for signature in known]
    listed = ", ".join(names[:_LISTED]) + (f" and {len(names) - _LISTED} more" if len(names) > _LISTED else "")
    return f"the domain {domain.name} has no {what} {name:.80}; it has {listed or 'none'}"
