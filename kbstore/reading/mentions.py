"""The objects that an assertion refers to: it ends with any of them (rule C9)."""

from collections.abc import Sequence
from functools import lru_cache

from kbstore.messages import KnowledgeType
from kbstore.model.expressions import atoms_of
from kbstore.model.formulas import Atom, Comparison, Defined, Formula, IsA, Same, walk
from kbstore.model.timelines import Role, Timeline, Value
from kbstore.names import is_wildcard, key
from kbstore.pddl.parse import parse_condition, parse_expression


def mentions(timeline: Timeline, value: Value) -> Sequence[str]:
    """Return the keys of the objects that an assertion refers to."""
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
    return tuple({key(argument) for atom in atoms_of(parse_expression(text)) for argument in atom.arguments})


@lru_cache(maxsize=1024)
def _in_condition(text: str) -> Sequence[str]:
    return tuple(sorted(objects_in(parse_condition(text))))


def objects_in(condition: Formula) -> set[str]:
    """Return the keys of the objects that a condition refers to by name."""
    found: set[str] = set()
    for node, _, _ in walk(condition, {}):
        match node:
            case Atom(_, arguments) | Defined(Atom(_, arguments)):
                found.update(arguments)
            case Comparison(_, left, right):
                found.update(argument for atom in atoms_of((*left, *right)) for argument in atom.arguments)
            case Same(left, right):
                found.update((left, right))
            case IsA(name):
                found.add(name)
    return {key(name) for name in found if not is_wildcard(name)}
