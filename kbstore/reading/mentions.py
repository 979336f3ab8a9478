"""The objects that an assertion refers to: it ends with any of them (rule C9)."""

from collections.abc import Sequence
from functools import lru_cache

from kbstore.messages import KnowledgeType
from kbstore.model.expressions import atoms_of
from kbstore.model.formulas import Formula, names_in, terms_in
from kbstore.model.timelines import Role, Timeline, Value
from kbstore.names import key
from kbstore.pddl.parse import parse_expression, parse_initial, parse_stored


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
            return _in_initial_condition(value[2])
        case _:
            return _in_condition(timeline.spelling)


@lru_cache(maxsize=1024)
def _in_expression(text: str) -> Sequence[str]:
    return tuple({key(argument) for atom in atoms_of(parse_expression(text)) for argument in atom.arguments})


@lru_cache(maxsize=1024)
def _in_condition(text: str) -> Sequence[str]:
    return tuple(sorted(objects_in(parse_stored(text))))


@lru_cache(maxsize=1024)
def _in_initial_condition(text: str) -> Sequence[str]:
    """Return the objects in a condition on the initial state; a constraint on a plan mentions none (it never ends)."""
    return tuple(sorted(set().union(*map(objects_in, parse_initial(text)))))


def objects_in(condition: Formula) -> set[str]:
    """Return the keys of the objects that a condition mentions by name."""
    names = {key(name) for term in terms_in(condition) for name in names_in(term)}
    return {name for name in names if name and name[0] != "?"}
