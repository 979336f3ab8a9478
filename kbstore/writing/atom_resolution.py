"""Which timeline an atom is about, after its symbol, its labels and its objects have been checked."""

from collections.abc import Sequence
from typing import NamedTuple
from weakref import WeakKeyDictionary

from kbstore.errors import InvalidKnowledge, KbStoreError
from kbstore.messages import Fact, Function, KnowledgeType
from kbstore.model.domain import Domain
from kbstore.model.formulas import Atom
from kbstore.model.symbols import SymbolTable
from kbstore.model.timelines import Identity, Role
from kbstore.names import key
from kbstore.writing.change_set import ChangeSet, TimelineState
from kbstore.writing.validation import Validator, violations_of

Violations = Sequence[str]


class _Form(NamedTuple):
    """How the atoms of one symbol look: its spelling, its labels, and the types that each argument may have."""

    name: str
    labels: tuple[str, ...]
    allowed: tuple[frozenset[str], ...]


_forms_of: WeakKeyDictionary[Domain, dict[tuple[KnowledgeType, str], _Form]] = WeakKeyDictionary()
"""The forms of the symbols that have been used, by domain: the same in all transactions."""


class AtomResolver:
    """Finds the tracks of facts and functions in a draft."""

    def __init__(self, draft: ChangeSet, validator: Validator, symbol_table: SymbolTable) -> None:
        self._change_set = draft
        self._validator = validator
        self._symbols = symbol_table
        self._now = draft.now
        domain = symbol_table.domain
        self._forms = {} if domain is None else _forms_of.setdefault(domain, {})
        self._objects: dict[str, tuple[str, str]] = {}
        self._objects_seen = draft.objects_changed

    def of(self, item: Fact | Function, kind: KnowledgeType, role: Role, t: int) -> TimelineState | Violations:
        """The track of a fact or function, if its symbol, its labels and its objects are right."""
        if t == self._now and (known := self._plain_track(item, kind, role)) is not None:
            return known
        try:
            name, arguments = self._symbols.ordered(kind, item.attribute_name, item.arguments, item.labels)
        except KbStoreError as error:
            return violations_of(error, item)
        violations = list(self._validator.atom(kind, name, arguments, t))
        if violations:
            return violations
        self._symbols.learn(kind, name, len(arguments), item.labels)
        return self._track(role, kind, name, arguments)

    def _plain_track(self, item: Fact | Function, kind: KnowledgeType, role: Role) -> TimelineState | None:
        """The same in the usual case, where nothing is wrong: the hot path of bulk work; None for any other."""
        keys = item.key
        form = self._forms.get((kind, keys[0]))
        if form is None:
            form = self._form(kind, item.attribute_name)
            if form is None:
                return None
        if len(keys) != len(form.allowed) + 1 or not (item.labels == form.labels or not any(item.labels)):
            return None
        name = " ".join(keys)
        track = self._change_set.group(role, kind).get(name)
        if track is not None and track.value is not None:
            # what stands speaks of objects that exist
            return track
        if self._objects_seen != self._change_set.objects_changed:
            self._objects_seen = self._change_set.objects_changed
            self._objects.clear()
        spelling = form.name
        for argument, argument_key, allowed in zip(item.arguments, keys[1:], form.allowed, strict=True):
            known = self._objects.get(argument_key)
            if known is None:
                type_name = self._validator.type_at(argument, self._now)
                if type_name is None:
                    return None
                known = key(type_name), self._validator.object_track(argument).timeline.spelling
                self._objects[argument_key] = known
            if known[0] not in allowed:
                return None
            spelling += f" {known[1]}"
        return track or self._change_set.track(Identity(role, kind, name), spelling)

    def _form(self, kind: KnowledgeType, name: str) -> "_Form | None":
        """How atoms of a symbol of the domain look; None without a domain, or where the symbol is not known."""
        domain = self._symbols.domain
        if domain is None or not self._symbols.known(kind, name):
            return None
        signature = self._symbols.signature(kind, name)
        assert signature is not None
        allowed = tuple(domain.subtypes(parameter.types) for parameter in signature.parameters)
        form = self._forms[kind, key(name)] = _Form(signature.name, signature.labels, allowed)
        return form

    def _track(self, role: Role, kind: KnowledgeType, name: str, arguments: Sequence[str]) -> TimelineState:
        objects = [self._validator.object_track(argument).timeline for argument in arguments]
        spelling = " ".join((name, *(timeline.spelling for timeline in objects)))
        return self._change_set.track(Identity(role, kind, key(spelling)), spelling)

    def of_effect(self, kind: KnowledgeType, atom: Atom) -> TimelineState:
        """The track of a ground atom that an operator's effect names. Raises `InvalidKnowledge` if it does not fit."""
        name, arguments = self._symbols.ordered(kind, atom.name, atom.arguments, ())
        violations = list(self._validator.atom(kind, name, arguments, self._now))
        if violations:
            raise InvalidKnowledge(*violations)
        return self._track(Role.STATE, kind, name, arguments)
