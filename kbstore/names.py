"""Names of objects, types, predicates and functions (rule D3): how they are compared, and which are accepted."""

import re
from collections.abc import Iterator, Mapping, Sequence
from typing import TypeVar

from kbstore.errors import InvalidKnowledge

_Value = TypeVar("_Value")

MAX_LENGTH = 255

_PLAIN = re.compile(r"[A-Za-z][A-Za-z0-9_\-]*\Z")
_FORBIDDEN = re.compile(
    r"[\s()\[\]{}\"'`;\x00-\x1f\x7f-\x9f\u200b-\u200f\u2028-\u202e\u2060-\u206f\ufeff\ud800-\udfff]"
)


key = str.lower
"""Returns the form in which names are compared: case does not matter."""


def bracketed(name: str, *arguments: str) -> str:
    """Return a symbol with its arguments in PDDL.

    >>> bracketed("robot_at", "kenny", "hall")
    '(robot_at kenny hall)'
    """
    return f"({' '.join((name, *arguments))})"


class NameMapping(Mapping[str, _Value]):
    """A read-only mapping by name: found in any case, listed in order and as written.

    >>> NameMapping({"Robot": "object"})["robot"]
    'object'
    """

    __slots__ = ("_by_key", "_values")

    def __init__(self, values: Mapping[str, _Value]) -> None:
        self._values = dict(values)
        self._by_key = {key(name): value for name, value in values.items()}

    def __getitem__(self, name: str) -> _Value:
        try:
            return self._by_key[key(name)]
        except (KeyError, TypeError):
            raise KeyError(name) from None

    def __iter__(self) -> Iterator[str]:
        return iter(self._values)

    def __len__(self) -> int:
        return len(self._values)

    def __repr__(self) -> str:
        return repr(self._values)


def is_wildcard(name: str) -> bool:
    """Return whether an argument of a question or a removal matches any object: ``?``, ``?name`` or empty (rule V7)."""
    return not name or name[0] == "?"


def matches(pattern: Sequence[str], names: Sequence[str]) -> bool:
    """Return whether a pattern matches names, both as keys: as many, and each the same or a wildcard."""
    return len(pattern) == len(names) and all(
        is_wildcard(wanted) or wanted == name for wanted, name in zip(pattern, names, strict=True)
    )


def problem(name: str) -> str | None:
    """Return the problem of a name, as the end of a sentence that begins with it; None if there is none.

    Accepts PDDL names, and other names of message-based clients as long as PDDL text with them can be read back.
    """
    if _PLAIN.match(name) and len(name) <= MAX_LENGTH:
        return None
    if not name:
        return "is empty; give a PDDL name, like wp7"
    if len(name) > MAX_LENGTH:
        return f"has {len(name)} characters; at most {MAX_LENGTH} are accepted"
    if name[0] == "?":
        return "is a variable; knowledge refers to objects by name"
    found = _FORBIDDEN.search(name)
    if found:
        return (
            f"contains {found.group()!r}; names are PDDL names: a letter, then letters, digits, '-' and '_' "
            "(no white space, brackets, quotes, ';' or control characters)"
        )
    if name == "-":
        return "is PDDL's mark between names and their type, and cannot be a name"
    return None


def check(name: str, what: str) -> None:
    """Raise `InvalidKnowledge` if `name`, the name of `what` ("object", "type"), is not acceptable."""
    wrong = problem(name)
    if wrong:
        raise InvalidKnowledge(f"the {what} name {_shown(name)} {wrong}")


def check_knowledge_base(name: str) -> None:
    """Raise `InvalidKnowledge` if `name` cannot be the name of a knowledge base."""
    if not isinstance(name, str) or not name.strip() or not name.isprintable():
        raise InvalidKnowledge(
            f"{name!r:.80} cannot be the name of a knowledge base; give printable text, like 'kenny'"
        )


def check_is_text(what: str, *given: object) -> None:
    """Raise `InvalidKnowledge` unless everything given, each a `what` ("type"), is text."""
    for value in given:
        if not isinstance(value, str):
            raise InvalidKnowledge(f"{value!r:.80} was given as a {what}, which is text: give a str")


_UNSTORABLE = re.compile("[\x00\ud800-\udfff]")


def unstorable(text: str) -> int | None:
    """Return the index of a character that no store takes: a NUL, or half a surrogate pair; None if there is none."""
    found = _UNSTORABLE.search(text)
    return None if found is None else found.start()


def check_text(text: str, what: str) -> None:
    """Raise `InvalidKnowledge` if `text`, which is a `what` ("note"), has a character that not every store takes."""
    check_is_text(what, text)
    place = unstorable(text)
    if place is not None:
        raise InvalidKnowledge(
            f"the {what} {text[:place]!r} goes on with {text[place]!r}, which no store keeps; "
            "leave out NUL characters, and decode bytes as what they are encoded in"
        )


def _shown(name: str) -> str:
    return repr(name if len(name) <= 60 else name[:57] + "...")
