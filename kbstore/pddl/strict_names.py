"""Replaces names in PDDL texts that some planners do not read by names that every planner reads (rule P5)."""

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from hashlib import sha256

from kbstore.model.domain import ROOT_TYPE, Domain
from kbstore.names import key
from kbstore.pddl.conditions import COMPARISONS, TRAJECTORY, ConditionReader
from kbstore.pddl.effects import ASSIGNMENTS
from kbstore.pddl.expressions import is_number
from kbstore.pddl.scope import Scope
from kbstore.pddl.sexpr import Group, SourceText
from kbstore.pddl.typed_lists import read_typed_list

_STRICT = re.compile(r"[a-z][a-z0-9_-]*", re.IGNORECASE | re.ASCII)
_UNFIT = re.compile(r"[^a-z0-9_-]+", re.IGNORECASE | re.ASCII)

RESERVED = frozenset(
    (
        *("define", "domain", "problem", "object", "number", "either", "total-time", "is-violated"),
        *("and", "or", "not", "imply", "forall", "exists", "when", "preference", "minimize", "maximize"),
        *ASSIGNMENTS,
    )
)
"""Words of PDDL that some parser takes for keywords anywhere."""


@dataclass(frozen=True)
class StrictPddl:
    """PDDL in names that every planner reads.

    Attributes:
        text: The domain or the problem.
        names: The replaced names, for `read_plan`: from the name in the text to the knowledge base's own.
    """

    text: str
    names: Mapping[str, str] = field(default_factory=dict)

    def __str__(self) -> str:
        return self.text


def is_strict(name: str) -> bool:
    """Return whether every planner reads a name: a letter, then letters, digits, '-', '_', and no word of PDDL's."""
    return _STRICT.fullmatch(name) is not None and key(name) not in RESERVED


def identifier(name: str) -> str:
    """Return a name as a PDDL identifier, with '-' for characters that PDDL excludes; empty if nothing is left."""
    fit = _UNFIT.sub("-", name).strip("-_")
    return f"n-{fit}" if fit[:1].isdigit() or key(fit) in RESERVED else fit


def strict_domain(domain: Domain) -> StrictPddl:
    """Return the domain as it was loaded, in names that every planner reads."""
    return _renamed(domain.source, domain, _used_in(domain.source, domain))


def strict_problem(text: str, domain: Domain | None) -> StrictPddl:
    """Return the problem in names that every planner reads, the same ones as in its domain.

    A name has the same replacement in every problem and domain, unless that is in use.
    """
    names = _used_in(text, domain)
    if domain is not None:
        names = {**_used_in(domain.source, domain), **names}
    return _renamed(text, domain, names)


def _used_in(text: str, domain: Domain | None) -> dict[str, str]:
    """Return the names in a text as they are first spelled, by their keys."""
    names: dict[str, str] = {}
    for _, name in _Names(SourceText(text), domain).places():
        names.setdefault(key(name), name)
    return names


def _renamed(text: str, domain: Domain | None, used: Mapping[str, str]) -> StrictPddl:
    new = _replacements(used)
    pieces: list[str] = []
    end = 0
    for offset, name in sorted(_Names(SourceText(text), domain).places()):
        if key(name) in new:
            pieces += [text[end:offset], new[key(name)]]
            end = offset + len(name)
    # other characters remain in comments only, where some planners fail, too
    written = "".join([*pieces, text[end:]]).encode("ascii", "replace").decode()
    return StrictPddl(written, {strict: used[name_key] for name_key, strict in new.items()})


def _replacements(used: Mapping[str, str]) -> dict[str, str]:
    """Return a replacement for each name that not every planner reads, by their keys: its letters and a digest.

    The digest makes the replacement independent of other names; it gets longer only if the replacement is taken.
    """
    new: dict[str, str] = {}
    taken = set(used)
    for name_key, name in sorted(used.items()):
        if not is_strict(name):
            digest = sha256(name_key.encode("utf-8", "surrogatepass")).hexdigest()
            candidates = (f"{identifier(name)[:40] or 'n'}_{digest[:length]}" for length in range(4, len(digest) + 1))
            new[name_key] = next(name for name in candidates if key(name) not in taken)
            taken.add(key(new[name_key]))
    return new


Place = tuple[int, str]
"""The offset of a name, and the name; a variable's without its ``?``."""


class _Names:
    """The places of names in a domain or problem: of types, symbols, objects, variables and preferences."""

    def __init__(self, source: SourceText, domain: Domain | None) -> None:
        self._source = source
        self._domain = domain
        self._scope = Scope(source, domain, patterns=True)
        self._conditions = ConditionReader(self._scope)

    def places(self) -> Iterator[Place]:
        """Yield each name with its place, in no order."""
        for whole in self._source.read():
            for section in whole[1:] if isinstance(whole, Group) else ():
                if isinstance(section, Group):
                    yield from self._section(section)

    def _section(self, section: Group) -> Iterator[Place]:
        match section.word(0):
            case "domain" | "problem" | ":domain":
                yield from self._word(section, 1)
            case ":types" | ":constants" | ":objects":
                yield from self._typed(section, 1, is_of_types=section.word(0) == ":types")
            case ":predicates" | ":functions":
                for index, node in enumerate(section[1:], 1):
                    if isinstance(node, Group):
                        yield from self._word(node, 0)
                        yield from self._typed(node, 1)
                    elif key(node).lstrip("-") not in ("", "number", ROOT_TYPE):
                        yield from self._word(section, index, "-")
            case ":action" | ":durative-action" | ":process" | ":event":
                yield from self._word(section, 1)
                for index in range(2, len(section) - 1, 2):
                    node = section[index + 1]
                    if isinstance(node, Group):
                        is_list = section.word(index) in (":parameters", ":vars")
                        yield from self._typed(node, 0) if is_list else self._formula(node)
            case ":derived":
                for index, node in enumerate(section[1:], 1):
                    if isinstance(node, Group):
                        if index == 1:
                            yield from self._word(node, 0)
                        yield from self._typed(node, 1) if index == 1 else self._formula(node)
            case ":init" | ":goal" | ":constraints" | ":metric":
                for node in section[1:]:
                    if isinstance(node, Group):
                        yield from self._formula(node)

    def _formula(self, formula: Group) -> Iterator[Place]:
        """Yield the names in a condition, an effect or an expression, without recursion."""
        todo = [formula]
        while todo:
            group = todo.pop()
            parts = [node for node in group if isinstance(node, Group)]
            word, second = group.word(0), group.word(1)
            is_timed = len(group) == 3 and isinstance(group[2], Group) and (is_number(second) or second in _MOMENTS)
            if word in ("forall", "exists") and len(parts) == 2:
                yield from self._typed(parts[0], 0)
                parts = parts[1:]
            elif word in ("preference", "is-violated"):
                yield from self._word(group, 1)
            elif word in _WORDS and not self._conditions.is_atom(group):
                for index in range(1, len(group)):
                    if group.word(index) and not is_number(group[index]):
                        yield from self._word(group, index)
            elif not (word in ("at", "over") and is_timed) and group:
                for index in range(len(group)):
                    yield from self._word(group, index)
            todo += reversed(parts)

    def _word(self, group: Group, index: int, prefix: str = "?") -> Iterator[Place]:
        """Yield the name at a place, without a prefix, unless it is one of PDDL's own words."""
        word = group[index] if index < len(group) else ""
        if isinstance(word, str) and (key(word) not in _SPECIAL or self._scope.is_function(word)):
            name = word.removeprefix(prefix)
            if name:
                yield self._source.offset(group, index) + len(word) - len(name), name

    def _typed(self, group: Group, start: int, *, is_of_types: bool = False) -> Iterator[Place]:
        """Yield the names and the types of a typed list, except the type ``object``, which is PDDL's own."""
        seen = {-1}
        for typed in read_typed_list(self._scope, group, start):
            if not (is_of_types and key(typed.name) == ROOT_TYPE):
                name = typed.name.removeprefix("?")
                yield self._source.offset(group, typed.place) + len(typed.name) - len(name), name
            if typed.types_place in seen:
                continue
            seen.add(typed.types_place)
            node = group[typed.types_place]
            for index, name in enumerate(typed.types, 1):
                if key(name) == ROOT_TYPE:
                    continue
                if isinstance(node, Group):
                    yield self._source.offset(node, index), name
                else:
                    yield self._source.offset(group, typed.types_place) + len(node) - len(name), name


_MOMENTS = ("start", "end", "all")
_SPECIAL = ("#t", "?duration", "total-time", "?", "-")
_WORDS = frozenset(
    (
        *("and", "or", "not", "imply", "when", "oneof", "unknown", "+", "-", "*", "/", "minimize", "maximize"),
        *(*COMPARISONS, *ASSIGNMENTS, *TRAJECTORY),
    )
)
