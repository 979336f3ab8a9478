"""Which timeline an atom is about, after its symbol, its labels and its objects have been checked."""

from collections.abc import Sequence
from typing import NamedTuple
from weakref import WeakKeyDictionary

from kbstore.domain import Domain
from kbstore.errors import InvalidKnowledge, KbStoreError
from kbstore.logic import Atom
from kbstore.messages import Fact, Function, KnowledgeType
from kbstore.names import key
from kbstore.timelines import Identity, Role
from kbstore.vocabulary import Vocabulary
from kbstore.writing.checks import Checks, violations_of
from kbstore.writing.draft import Draft, Track

Violations = Sequence[str]


class _Form(NamedTuple):
    """How the atoms of one symbol look: its spelling, its labels, and the types that each argument may have."""

    name: str
    labels: tuple[str, ...]
    allowed: tuple[frozenset[str], ...]


_forms_of: WeakKeyDictionary[Domain, dict[tuple[KnowledgeType, str], _Form]] = WeakKeyDictionary()
"""The forms of the symbols that have been used, by domain: the same in all transactions."""


class AtomTracks:
    """Finds the tracks of facts and functions in a draft."""

    def __init__(self, draft: Draft, checks: Checks, vocabulary: Vocabulary) -> None:
        self._draft = draft
        self._checks = checks
        self._vocabulary = vocabulary
        self._now = draft.now
        domain = vocabulary.domain
        self._forms = {} if domain is None else _forms_of.setdefault(domain, {})
        self._objects: dict[str, tuple[str, str]] = {}
        self._objects_seen = draft.objects_changed

    def of(self, item: Fact | Function, kind: KnowledgeType, role: Role, t: int) -> Track | Violations:
        """The track of a fact or function, if its symbol, its labels and its objects are right."""
        if t == self._now and (known := self._plain_track(item, kind, role)) is not None:
            return known
        try:
            name, arguments = self._vocabulary.ordered(kind, item.attribute_name, item.arguments, item.labels)
        except KbStoreError as error:
            return violations_of(error, item)
        violations = list(self._checks.atom(kind, name, arguments, t))
        if violations:
            return violations
        self._vocabulary.learn(kind, name, len(arguments), item.labels)
        return self._track(role, kind, name, arguments)

    def _plain_track(self, item: Fact | Function, kind: KnowledgeType, role: Role) -> Track | None:
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
        track = self._draft.group(role, kind).get(name)
        if track is not None and track.value is not None:
            # what stands speaks of objects that exist
            return track
        if self._objects_seen != self._draft.objects_changed:
            self._objects_seen = self._draft.objects_changed
            self._objects.clear()
        spelling = form.name
        for argument, argument_key, allowed in zip(item.arguments, keys[1:], form.allowed, strict=True):
            known = self._objects.get(argument_key)
            if known is None:
                type_name = self._checks.type_at(argument, self._now)
                if type_name is None:
                    return None
                known = key(type_name), self._checks.object_track(argument).timeline.spelling
                self._objects[argument_key] = known
            if known[0] not in allowed:
                return None
            spelling += f" {known[1]}"
        return track or self._draft.track(Identity(role, kind, name), spelling)

    def _form(self, kind: KnowledgeType, name: str) -> "_Form | None":
        """How atoms of a symbol of the domain look; None without a domain, or where the symbol is not known."""
        domain = self._vocabulary.domain
        if domain is None or not self._vocabulary.known(kind, name):
            return None
        signature = self._vocabulary.signature(kind, name)
        assert signature is not None
        allowed = tuple(domain.subtypes(parameter.types) for parameter in signature.parameters)
        form = self._forms[kind, key(name)] = _Form(signature.name, signature.labels, allowed)
        return form

    def _track(self, role: Role, kind: KnowledgeType, name: str, arguments: Sequence[str]) -> Track:
        objects = [self._checks.object_track(argument).timeline for argument in arguments]
        spelling = " ".join((name, *(timeline.spelling for timeline in objects)))
        return self._draft.track(Identity(role, kind, key(spelling)), spelling)

    def of_effect(self, kind: KnowledgeType, atom: Atom) -> Track:
        """The track of a ground atom that an operator's effect names. Raises `InvalidKnowledge` if it does not fit."""
        name, arguments = self._vocabulary.ordered(kind, atom.name, atom.arguments, ())
        violations = list(self._checks.atom(kind, name, arguments, self._now))
        if violations:
            raise InvalidKnowledge(*violations)
        return self._track(Role.STATE, kind, name, arguments)
