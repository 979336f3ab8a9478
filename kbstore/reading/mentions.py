"""Which objects an assertion mentions: with any of them it ends (rule C9)."""

from collections.abc import Sequence
from functools import lru_cache

from kbstore.messages import KnowledgeType
from kbstore.model.formulas import (
    Atom,
    Comparison,
    Defined,
    Exists,
    Forall,
    Formula,
    Imply,
    IsA,
    Not,
    Preference,
    Same,
    Truism,
)
from kbstore.model.timelines import Role, Timeline, Value
from kbstore.names import key
from kbstore.pddl.parse import parse_condition, parse_expression


def mentions(timeline: Timeline, value: Value) -> Sequence[str]:
    """The keys of the objects that an assertion mentions."""
    match timeline.kind:
        case KnowledgeType.FACT | KnowledgeType.FUNCTION:
            return timeline.keys[1:]
        case KnowledgeType.INSTANCE:
            return ()
        case KnowledgeType.EXPRESSION if timeline.role is Role.STATE:
            return _in_expression(value[2])
        case _ if timeline.role is Role.CONSTRAINT:
            return ()
        case _:
            return _in_condition(timeline.spelling)


@lru_cache(maxsize=1024)
def _in_expression(text: str) -> Sequence[str]:
    atoms = [token for token in parse_expression(text) if isinstance(token, Atom)]
    return tuple({key(argument) for atom in atoms for argument in atom.arguments})


@lru_cache(maxsize=1024)
def _in_condition(text: str) -> Sequence[str]:
    return tuple(sorted(objects_in(parse_condition(text))))


def objects_in(condition: Formula) -> set[str]:
    """The keys of the objects that a condition mentions by name."""
    found: set[str] = set()
    stack: list[Formula] = [condition]
    while stack:
        part = stack.pop()
        match part:
            case Atom() | Defined(Atom()):
                atom = part if isinstance(part, Atom) else part.function
                found.update(map(key, atom.arguments))
            case Comparison():
                for token in (*part.left, *part.right):
                    if isinstance(token, Atom):
                        found.update(map(key, token.arguments))
            case Same():
                found.update((key(part.left), key(part.right)))
            case IsA():
                found.add(key(part.name))
            case Imply():
                stack += (part.premise, part.conclusion)
            case Not() | Exists() | Forall() | Preference():
                stack.append(part.part)
            case Truism():
                pass
            case _:
                stack += part.parts
    return {name for name in found if name and name[0] != "?"}
