"""The versions of a knowledge base's domain, and the symbols that are known at a position in the log (rule D4)."""

import json
import threading
from collections.abc import Iterator
from typing import NamedTuple

from kbstore.messages import KnowledgeType
from kbstore.model.domain import Domain
from kbstore.model.symbols import InferredSignature, SymbolTable
from kbstore.pddl.domain_reader import read_domain
from kbstore.storage.records import Head, LogPosition
from kbstore.storage.repository import Repository


class DomainVersion(NamedTuple):
    """A version of the domain, in force from `time` on; version 0 is that before the first domain."""

    version: int = 0
    time: int = 0
    transaction: int = 0
    domain: Domain | None = None


class DomainVersions:
    """The versions of one knowledge base's domain. With `caching` each is read once: a version never changes."""

    def __init__(self, *, caching: bool = True) -> None:
        self.latest = DomainVersion()
        """The latest version that has been read."""
        self._caching = caching
        self._known: tuple[int, list[DomainVersion]] = (0, [])
        """The generation of the store when the versions were read (it counts how often the store went back), and the
        versions."""
        self._loading = threading.Lock()

    def copy(self) -> "DomainVersions":
        """Return a copy, for a reader that may see further versions that are never committed."""
        made = DomainVersions(caching=self._caching)
        made.latest, made._known = self.latest, (0, list(self._known[1]))
        return made

    def forget(self, generation: int) -> None:
        """Forget the versions, as the store has gone back and is now in this generation."""
        with self._loading:
            self._known = (generation, [])
            self.latest = DomainVersion()

    def all(self, repository: Repository, head: Head) -> list[DomainVersion]:
        """Return all versions of the domain, in order."""
        generation, known = self._known
        if generation != repository.generation or len(known) < head.domain_version:
            with self._loading:
                generation, known = self._known
                known = list(known) if generation == repository.generation else []
                for version, since, number, source, sensed in repository.domain_versions(len(known)):
                    domain = read_domain(source).marked(json.loads(sensed))
                    known.append(DomainVersion(version, since, number, domain))
                # a snapshot from before the store went back may have versions that are gone: they are not cached
                if known and generation <= repository.generation:
                    self.latest = known[-1]
                    if self._caching:
                        self._known = repository.generation, known
        return known[: head.domain_version]

    def in_force(self, repository: Repository, head: Head, position: LogPosition) -> DomainVersion:
        """Return the version in force at a position in the log."""
        found = DomainVersion()
        for version in self.all(repository, head):
            if version.time <= position.time and (position.number is None or version.transaction <= position.number):
                found = version
        return found

    def symbol_table(self, repository: Repository, head: Head, position: LogPosition) -> SymbolTable:
        """Return the symbols known at a position in the log: the domain's; without a domain, those used so far."""
        domain = self.in_force(repository, head, position).domain
        return SymbolTable(domain) if domain is not None else self.inferred(repository)

    def inferred(self, repository: Repository) -> SymbolTable:
        """Return the symbols of a knowledge base without a domain, by their first uses (rule D2)."""
        return SymbolTable(
            None,
            {
                (KnowledgeType(kind), name_key): InferredSignature(
                    name, arity, tuple(labels.split()) if labels else None
                )
                for kind, name_key, name, arity, labels in repository.symbols()
            },
        )

    def within(
        self, repository: Repository, head: Head, first: int, last: int, upto: int | None = None
    ) -> Iterator[tuple[int, int, SymbolTable]]:
        """Yield the versions in force within a span, each with its part of it: start, end, symbols.

        With `upto`, only versions up to that transaction count.
        """
        versions = self.all(repository, head)
        if upto is not None:
            versions = [version for version in versions if version.transaction <= upto]
        has_undeclared = not versions or first < versions[0].time
        starts = [(0, self.inferred(repository) if has_undeclared else SymbolTable())]
        starts += [(version.time, SymbolTable(version.domain)) for version in versions]
        for index, (since, symbol_table) in enumerate(starts):
            until = starts[index + 1][0] if index + 1 < len(starts) else last
            start, end = max(first, since), min(last, until)
            if start < end or (first == last and index + 1 == len(starts)):
                yield start, end, symbol_table
