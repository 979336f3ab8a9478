"""Timelines: the subjects of assertions, and the values that hold on them.

A timeline is the whole life of one ground thing in one role. What holds on it at a time is a *value*: a tuple
of `is_negative` and the columns of the knowledge type's own table, in their order:

===========  ===============================================================
INSTANCE     ``(is_negative, type)``
FACT         ``(is_negative,)``
FUNCTION     ``(False, value at its initial time, own rate, rate)``
EXPRESSION   ``(False, optimization, expression)``; a condition: ``(False, "", text)``
INEQUALITY   ``(is_negative, comparison, left side, right side, grounded)``
===========  ===============================================================
"""

from collections.abc import Callable, Sequence
from enum import IntEnum
from hashlib import sha256
from typing import Any, NamedTuple

from kbstore.clock import SECOND
from kbstore.messages.enums import KnowledgeType, plain

Value = tuple[Any, ...]

LONGEST_KEY = 500
"""Characters of a key that are stored; the index entries of PostgreSQL have a limit."""

METRIC_KEY = ""
"""The key of the one timeline of the metric (rule C11)."""


@plain
class Role(IntEnum):
    """The role of a timeline's assertions in the knowledge base."""

    __hash__ = int.__hash__

    STATE = 0
    GOAL = 1
    CONSTRAINT = 2
    LOAD = 3
    """A domain and a problem that have been loaded; the timeline is the record of it, and nothing is asserted on it."""


@plain
class EndCause(IntEnum):
    """Why a transaction ended an assertion at its own time."""

    REMOVED = 1
    REPLACED = 2
    OBJECT = 3
    CLEARED = 4
    RUN = 5


class Identity(NamedTuple):
    """The identity of a timeline: role, knowledge type, and subject, as compared."""

    role: Role
    kind: KnowledgeType
    key: str


class Timeline:
    """One timeline; `id` is 0 until it is stored."""

    __slots__ = ("_words", "id", "identity", "key", "keys", "kind", "latest", "role", "shown", "spelling")

    keys: tuple[str, ...]
    """The words of the key: an atom's symbol and objects, or all of any other key."""
    identity: Identity
    """Role, knowledge type and key."""
    _words: tuple[str, ...]
    shown: tuple[Sequence[str], tuple[Any, ...]] | None
    """The labels with which the arguments were last shown, and the labelled arguments."""
    latest: tuple[object, int, Value, Any] | None
    """The domain, the initial time and the value with which it was last shown, and the item that was made of them."""

    def __init__(self, id: int, role: int, kind: int, key: str, spelling: str | None) -> None:
        self.id = id
        self.role = _ROLES[role]
        self.kind = _KINDS[kind]
        self.key = key
        """The subject, in the form in which it is compared."""
        self.spelling = key if spelling is None else spelling
        self.shown = None
        self.latest = None

    def __getattr__(self, name: str) -> Any:
        """Fill a slot when it is first read: a state has a thousand timelines, and most questions are about one."""
        if name == "keys":
            self.keys = self._split(self.key)
            return self.keys
        if name == "identity":
            self.identity = Identity(self.role, self.kind, self.key)
            return self.identity
        if name == "_words":
            self._words = self._split(self.spelling)
            return self._words
        raise AttributeError(f"a timeline has no {name}")

    def _split(self, text: str) -> tuple[str, ...]:
        return tuple(text.split(" ")) if self.kind in _ATOMS else (text,)

    @property
    def name(self) -> str:
        """The symbol of an atom, or all of any other subject, as first written."""
        return self._words[0]

    @property
    def arguments(self) -> tuple[str, ...]:
        """The objects of an atom, as first written."""
        return self._words[1:]

    def __repr__(self) -> str:
        return f"Timeline({self.id}, {self.role.name}, {self.kind.name}, {self.spelling!r})"


StateRow = tuple[Timeline, int, Value]
"""An assertion that holds or is scheduled: its timeline, its initial time in nanoseconds, and its value."""

Mentions = Callable[[Timeline, Value], Sequence[str]]
"""A function that returns the keys of the objects that an assertion mentions."""


_ROLES = tuple(Role)
_KINDS = tuple(KnowledgeType)
_ATOMS = frozenset((KnowledgeType.FACT, KnowledgeType.FUNCTION))


def atom_key(names: Sequence[str]) -> str:
    """Return the key of an atom's timeline: its symbol and its arguments, each as it is compared.

    A name with a space, which no stored name has, gives a key that no timeline has.
    """
    found = " ".join(names)
    return found if found.count(" ") < len(names) else "\0"


def stored_key(key: str) -> str:
    """Return a key as it is stored: a very long one is cut to `LONGEST_KEY`, and a digest of all of it follows."""
    if len(key) <= LONGEST_KEY:
        return key
    return f"{key[:LONGEST_KEY]} #{sha256(key.encode()).hexdigest()}"


def fact_value(is_negative: bool) -> Value:
    """Return the value of a fact on its timeline."""
    return (is_negative,)


def number_at(value: Value, initial_time: int, t: int) -> float:
    """Return the number at `t` of a function's value that holds from `initial_time` on."""
    return moved(value[1], value[3], t - initial_time)


def moved(number: float, rate: float, ns: int) -> float:
    """Return a number after some nanoseconds at a rate per second (rule C7, in that order of operations)."""
    return number + rate * (ns / SECOND) if rate else number
