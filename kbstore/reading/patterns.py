"""Patterns of assertions, as `history` and `watch` take them: an item in which ``?`` matches any object."""

from collections.abc import Sequence

from kbstore.errors import InvalidKnowledge
from kbstore.evaluation.snapshot import is_of
from kbstore.evaluation.wellformed import check
from kbstore.messages import Condition, Expression, Fact, Function, Inequality, Instance, KnowledgeItem, KnowledgeType
from kbstore.model.symbols import SymbolTable
from kbstore.model.timelines import METRIC_KEY, Role, Timeline, atom_key
from kbstore.names import is_wildcard, key, matches
from kbstore.pddl.parse import condition_of
from kbstore.pddl.printer import condition_text
from kbstore.reading.questions import Knowledge, as_item
from kbstore.storage.records import RecordedAssertion
from kbstore.storage.repository import Repository


class Pattern:
    """A pattern, read under one version of the domain.

    Raises `UnknownSymbol` for a symbol that the domain does not know, `InvalidKnowledge` for arguments or labels that
    do not fit.
    """

    def __init__(self, pattern: Knowledge, symbols: SymbolTable) -> None:
        self._symbols = symbols
        self._item = item = as_item(pattern, symbols)
        self.kind = item.knowledge_type
        self._keys: Sequence[str] = ()
        match item:
            case Fact() | Function():
                name, arguments = symbols.ordered(self.kind, item.attribute_name, item.arguments, item.labels)
                self._keys = (key(name), *map(key, arguments))
            case Instance():
                self._keys = (key(item.instance_name),)

    def timelines(self, repository: Repository) -> list[Timeline]:
        """Return the timelines of the state on which something that matches has ever been asserted.

        Raises `InvalidKnowledge` for a pattern without a predicate or function, with a derived one, or with ``?`` in a
        comparison.
        """
        match self._item:
            case Fact() | Function():
                return self._of_atoms(repository)
            case Instance(instance_type=type_name):
                if type_name and self._symbols.domain is not None:
                    self._symbols.domain.type_spelling(type_name)
                if is_wildcard(self._keys[0]):
                    return repository.of_kind(Role.STATE, self.kind)
                name = self._keys[0]
            case Inequality() as item:
                comparison = condition_of(item.changed(is_negative=False), self._symbols.domain)
                check(comparison, self._symbols.domain)
                name = key(condition_text(comparison))
            case Expression():
                name = METRIC_KEY
        return list(repository.find(Role.STATE, self.kind, [name]).values())

    def _of_atoms(self, repository: Repository) -> list[Timeline]:
        name, domain = self._keys[0], self._symbols.domain
        if is_wildcard(name):
            raise InvalidKnowledge(f"{self._item}: a pattern names its predicate or function; its arguments may be ?")
        if self.kind is KnowledgeType.FACT and domain is not None and domain.is_derived(name):
            raise InvalidKnowledge(f"{self._item} is derived by rules and never asserted; ask when() it was true")
        if not any(map(is_wildcard, self._keys)):
            return list(repository.find(Role.STATE, self.kind, [atom_key(self._keys)]).values())
        return [line for line in repository.of_symbol(Role.STATE, self.kind, name) if matches(self._keys, line.keys)]

    def matches_row(self, row: RecordedAssertion) -> bool:
        """Return whether an assertion on one of the timelines matches: an object's type may be given."""
        return not isinstance(self._item, Instance) or self._has_type(row.value[1])

    def matches(self, item: KnowledgeItem | Condition) -> bool:
        """Return whether an item matches."""
        if isinstance(item, Condition) or item.knowledge_type is not self.kind:
            return False
        match item:
            case Fact() | Function():
                return matches(self._keys, item.key)
            case Instance():
                return matches(self._keys, (key(item.instance_name),)) and self._has_type(item.instance_type)
            case Inequality():
                return key(str(self._item)) == key(str(item))
            case Expression():
                return True

    def _has_type(self, type_name: str) -> bool:
        wanted = self._item.instance_type if isinstance(self._item, Instance) else ""
        return not wanted or is_of(self._symbols.domain, type_name, [wanted])
