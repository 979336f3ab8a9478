"""Name resolution for writing: checks the symbols and objects of an atom, and finds its timeline (rules D1 to D3)."""

from collections.abc import Iterable, Iterator, Sequence
from typing import NamedTuple
from weakref import WeakKeyDictionary

from kbstore import names
from kbstore.clock import isoformat
from kbstore.errors import InvalidKnowledge, KbStoreError
from kbstore.messages import Fact, Function, KnowledgeType
from kbstore.model.domain import Domain
from kbstore.model.formulas import Atom
from kbstore.model.symbols import SymbolTable
from kbstore.model.timelines import Identity, Role
from kbstore.names import key
from kbstore.pddl.parse import parse_condition, parse_item
from kbstore.writing.change_set import ChangeSet
from kbstore.writing.timeline_state import TimelineState

Violations = Sequence[str]
"""The violations of an item, each in one sentence; empty if there are none."""


class _Declared(NamedTuple):
    """A declared symbol: its spelling, its labels, and for each argument the keys of the types that it may have."""

    name: str
    labels: tuple[str, ...]
    allowed: tuple[frozenset[str], ...]


_forms_of: WeakKeyDictionary[Domain, dict[tuple[KnowledgeType, str], _Declared]] = WeakKeyDictionary()
"""The forms of the symbols used so far, by domain, shared by all transactions."""


class NameResolver:
    """Finds the timelines of atoms and objects in a change set; without a domain, it checks names and arities only."""

    def __init__(self, change_set: ChangeSet, symbols: SymbolTable) -> None:
        self.symbols = symbols
        self.domain = symbols.domain
        self._change_set = change_set
        self._now = change_set.now
        self._forms: dict[tuple[KnowledgeType, str], _Declared] = {}
        self._objects: dict[str, tuple[str, str]] = {}
        self._objects_seen = change_set.objects_changed

    # -- objects ----------------------------------------------------------------------------------------------

    def object(self, name: str) -> TimelineState:
        """Return the INSTANCE timeline of an object, spelled as the domain spells a constant, or as first written."""
        name_key = key(name)
        constant = self.domain.constant_spelling(name_key) if self.domain is not None else None
        return self._change_set.state(Identity(Role.STATE, KnowledgeType.INSTANCE, name_key), constant or name)

    def type_at(self, name: str, t: int) -> str | None:
        """Return the type of an object or constant at `t`; None if it does not exist then."""
        if self.domain is not None:
            constant = self.domain.constant_types.get(key(name))
            if constant is not None:
                return constant
        state = self._change_set.find(Identity(Role.STATE, KnowledgeType.INSTANCE, key(name)))
        if state is None:
            return None
        if t == self._now:
            value = state.value
            return None if value is None or value[0] else str(value[1])
        lifespans = self._change_set.lifespans(state) if t > self._now else self._change_set.existences(state)
        for lifespan in lifespans:
            if lifespan.start <= t < lifespan.end:
                return lifespan.type_name
        return None

    def object_violations(
        self, atom: str, arguments: Sequence[str], types: Iterable[tuple[str, ...]], t: int
    ) -> Iterator[str]:
        """Check the names, existence and types of an atom's arguments at a time; yield violations.

        This use fixes the spelling of a name that the knowledge base does not know yet (rule D3).
        """
        for argument, allowed in zip(arguments, types, strict=True):
            wrong = names.problem(argument)
            if wrong:
                yield f"{atom:.200}: the name {argument!r:.60} {wrong}"
                continue
            self.object(argument)
            if self.domain is not None:
                type_name = self.type_at(argument, t)
                if type_name is None:
                    missing = "does not exist" + ("" if t == self._now else f" at {isoformat(t)}")
                    advice = f"add it first, as: {argument} - {allowed[0]}"
                    yield f"{atom}: {argument} {missing}; {_expected(allowed)}; {advice}"
                elif key(type_name) not in self.domain.subtypes(allowed):
                    yield f"{atom}: {argument} is of type {type_name}; {_expected(allowed)}"

    # -- atoms ------------------------------------------------------------------------------------------------

    def atom(self, item: Fact | Function, kind: KnowledgeType, role: Role, t: int) -> TimelineState | Violations:
        """Return the timeline of a fact or function; or its violations, if its symbol, labels or objects are wrong."""
        if t == self._now and (state := self._usual(item, kind, role)) is not None:
            return state
        try:
            name, arguments = self.symbols.ordered(kind, item.attribute_name, item.arguments, item.labels)
        except KbStoreError as error:
            return violations_of(error, item)
        violations = list(self.atom_violations(kind, name, arguments, t))
        if violations:
            return violations
        self.symbols.learn(kind, name, len(arguments), item.labels)
        return self._state(role, kind, name, arguments)

    def effect_atom(self, kind: KnowledgeType, atom: Atom) -> TimelineState:
        """Return the timeline of a ground atom in an effect. Raises `InvalidKnowledge` if the atom does not fit."""
        name, arguments = self.symbols.ordered(kind, atom.name, atom.arguments, ())
        violations = list(self.atom_violations(kind, name, arguments, self._now))
        if violations:
            raise InvalidKnowledge(*violations)
        return self._state(Role.STATE, kind, name, arguments)

    def atom_violations(self, kind: KnowledgeType, name: str, arguments: Sequence[str], t: int) -> Iterator[str]:
        """Check a ground atom, whose arity has been checked, at a time; yield violations."""
        atom = str(Atom(name, tuple(arguments)))
        signature = self.symbols.signature(kind, name)
        if signature is not None:
            yield from self.object_violations(atom, arguments, (p.types for p in signature.parameters), t)
            return
        wrong = names.problem(name)
        if wrong:
            yield f"the name {name!r:.60} {wrong}"
        elif (kind, key(name)) not in self.symbols.inferred and not can_be_read_back(kind, name, len(arguments)):
            yield f"{atom:.200} means something else in PDDL; give the {_SYMBOLS[kind]} another name"
        yield from self.object_violations(atom, arguments, [("object",)] * len(arguments), t)

    def _usual(self, item: Fact | Function, kind: KnowledgeType, role: Role) -> TimelineState | None:
        """Return the timeline of an item in the usual case, in which nothing is wrong; None in any other case.

        The hot path of bulk updates.
        """
        state = self._change_set.group(role, kind).get(item.timeline_key)
        labels = item.labels
        # an assertion that holds was checked, and mentions only objects that exist
        holds = state is not None and state.value is not None
        if holds and not any(labels):
            return state
        keys = item.key
        form = self._forms.get((kind, keys[0])) or self._form(kind, item.attribute_name)
        if form is None or len(keys) != len(form.allowed) + 1 or (labels != form.labels and any(labels)):
            return None
        if holds:
            return state
        if self._objects_seen != self._change_set.objects_changed:
            self._objects_seen = self._change_set.objects_changed
            self._objects.clear()
        spelling = form.name
        for argument, argument_key, allowed in zip(item.arguments, keys[1:], form.allowed, strict=True):
            seen = self._objects.get(argument_key)
            if seen is None:
                type_name = self.type_at(argument, self._now)
                if type_name is None:
                    return None
                seen = key(type_name), self.object(argument).timeline.spelling
                self._objects[argument_key] = seen
            if seen[0] not in allowed:
                return None
            spelling += f" {seen[1]}"
        if state is None:
            state = self._change_set.state((role, kind, item.timeline_key), spelling)
            state.timeline.keys = keys
        return state

    def _form(self, kind: KnowledgeType, name: str) -> "_Declared | None":
        """Return the domain's declaration of a symbol; None without a domain, or where it does not know the symbol."""
        if self.domain is None or not self.symbols.known(kind, name):
            return None
        forms = _forms_of.setdefault(self.domain, {})
        form = forms.get((kind, key(name)))
        if form is None:
            signature = self.symbols.signature(kind, name)
            assert signature is not None
            allowed = tuple(self.domain.subtypes(parameter.types) for parameter in signature.parameters)
            form = forms[kind, key(name)] = _Declared(signature.name, signature.labels, allowed)
        self._forms[kind, key(name)] = form
        return form

    def _state(self, role: Role, kind: KnowledgeType, name: str, arguments: Sequence[str]) -> TimelineState:
        spelling = " ".join((name, *(self.object(argument).timeline.spelling for argument in arguments)))
        return self._change_set.state(Identity(role, kind, key(spelling)), spelling)


_SYMBOLS = {KnowledgeType.FACT: "predicate", KnowledgeType.FUNCTION: "function"}


def can_be_read_back(kind: KnowledgeType, name: str, arity: int) -> bool:
    """Return whether PDDL text with an undeclared symbol reads back as itself: ``(and a)`` does not (rule D3)."""
    atom = Atom(name, tuple(f"x{index}" for index in range(arity)))
    text = str(atom) if kind is KnowledgeType.FACT else f"(= {atom} 0)"
    try:
        item = parse_item(text)
        return item.knowledge_type is kind and (kind is KnowledgeType.FUNCTION or parse_condition(text) == atom)
    except KbStoreError:
        return False


def violations_of(error: KbStoreError, about: object) -> tuple[str, ...]:
    """Return the sentences of an error that counts as violations, each with its item."""
    return naming(about, error.violations if isinstance(error, InvalidKnowledge) else (str(error),))


def naming(about: object, sentences: Iterable[str]) -> tuple[str, ...]:
    """Return sentences, each prefixed with its item unless it names it anyway."""
    text = str(about)
    return tuple(sentence if text in sentence else f"{text:.200}: {sentence}" for sentence in sentences)


def _expected(allowed: Sequence[str]) -> str:
    return f"an object of type {' or '.join(allowed)} is expected"
