"""The lanes of a timeline: assigns assertions, runs and expected events to lanes, and selects lanes by patterns."""

import re
from collections.abc import Sequence

from kbstore.messages import Fact, Function, Instance, KnowledgeType
from kbstore.model.results import Assertion, Run
from kbstore.model.timelines import Role, Timeline
from kbstore.names import bracketed, key, matches

KINDS = ("run", "goal", "fact", "number", "object", "other")
"""The kinds of groups of lanes, in the order in which they are shown."""

_KINDS = {KnowledgeType.FACT: "fact", KnowledgeType.FUNCTION: "number"}


class Lanes:
    """The lanes that have occurred so far, each with its group, its label and the objects that it refers to.

    Attributes:
        groups: The kind, one of `KINDS`, and the name of each group.
        described: For each lane its group, its label, and the keys of its objects.
    """

    def __init__(self, patterns: Sequence[str] = ()) -> None:
        self.groups: list[tuple[str, str]] = []
        self.described: list[tuple[int, str, list[str]]] = []
        self._numbers: dict[tuple[str, str], int] = {}
        self._lanes: dict[tuple[int, str], int | None] = {}
        self._wanted = [_words(pattern) for pattern in patterns]

    def of_assertion(self, assertion: Assertion) -> int | None:
        """Return the lane of an assertion; None if no pattern asks for it."""
        item = assertion.item
        if not assertion.is_goal:
            match item:
                case Fact() | Function():
                    return self._atom(_KINDS[item.knowledge_type], item.attribute_name, item.arguments)
                case Instance():
                    return self._lane("object", "objects", item.instance_name, (item.instance_name,))
        kind, name = ("goal", "goals") if assertion.is_goal else ("other", "statements")
        return self._lane(kind, name, item.text, _words(item.text))

    def of_run(self, run: Run) -> int | None:
        """Return the lane of a run; None if no pattern asks for it."""
        words = (run.operator, *run.arguments)
        return self._lane("run", "actions", bracketed(*words), words)

    def of_timeline(self, timeline: Timeline) -> int | None:
        """Return the lane of an atom or object of the state; None for anything else, or if no pattern asks for it."""
        if timeline.role is not Role.STATE:
            return None
        if timeline.kind is KnowledgeType.INSTANCE:
            return self._lane("object", "objects", timeline.spelling, (timeline.spelling,))
        if timeline.kind in _KINDS:
            return self._atom(_KINDS[timeline.kind], timeline.name, timeline.arguments)
        return None

    def _atom(self, kind: str, name: str, arguments: Sequence[str]) -> int | None:
        return self._lane(kind, name, " ".join(arguments), (name, *arguments))

    def _lane(self, kind: str, name: str, label: str, words: Sequence[str]) -> int | None:
        group = self._numbers.setdefault((kind, key(name)), len(self._numbers))
        if group == len(self.groups):
            self.groups.append((kind, name))
        place = group, key(label)
        if place not in self._lanes:
            found = None
            # lanes need the ends of the objects that they refer to
            if kind == "object" or self._is_wanted(words):
                found = len(self.described)
                self.described.append((group, label, [] if kind == "run" else [key(word) for word in words[1:]]))
            self._lanes[place] = found
        return self._lanes[place]

    def _is_wanted(self, words: Sequence[str]) -> bool:
        """Return whether a pattern matches: a single word is any symbol or object, several words are all, in order."""
        keys = tuple(map(key, words))
        return not self._wanted or any(
            wanted[0] in keys if len(wanted) == 1 else matches(wanted, keys) for wanted in self._wanted
        )


def _words(text: str) -> tuple[str, ...]:
    """Return the words of PDDL text, as they are compared.

    >>> _words("(robot_at Kenny ?)")
    ('robot_at', 'kenny', '?')
    """
    return tuple(key(word) for word in re.findall(r"[^\s()]+", text)) or ("",)
