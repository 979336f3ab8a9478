"""Answers to `find`: the bindings of a query's variables in one world (rule V11)."""

from collections.abc import Iterable

from kbstore.evaluation.argument_types import check_types, named_arguments
from kbstore.evaluation.find import find, ranges
from kbstore.evaluation.snapshot import Snapshot
from kbstore.evaluation.wellformed import check
from kbstore.messages import KnowledgeType
from kbstore.model.formulas import Exists, Parameter
from kbstore.model.symbols import SymbolTable
from kbstore.pddl.query_reader import parse_query, query_of
from kbstore.reading.lazy_state import LazyState
from kbstore.reading.questions import Question, as_condition

_FEW = 16
"""The most names that are looked up one by one; for more, all objects are read at once."""


def bindings(question: Question, symbols: SymbolTable, world: LazyState | Snapshot) -> list[dict[str, str]]:
    """Return the objects for a condition's free variables for which it is true, in the order of the objects.

    Raises what asking the condition raises, and `InvalidKnowledge` for a variable that needs a type.
    """
    domain = symbols.domain
    query = parse_query(question, domain) if isinstance(question, str) else query_of(as_condition(question, symbols))
    given = {variable.name.lower(): variable.types for variable in query.variables}
    check(query.condition, domain, {name: name for name in given})
    typed = tuple(Parameter(name, types) for name, types in given.items() if types)
    check_types(named_arguments(Exists(typed, query.condition), domain), world.type_of, domain)
    found = find(query.condition, ranges(query.condition, given, domain), world)
    spellings = _spelled({name for names in found for name in names}, symbols, world)
    variables = [variable.name for variable in query.variables]
    return [dict(zip(variables, (spellings[name] for name in names), strict=True)) for names in found]


def _spelled(names: Iterable[str], symbols: SymbolTable, world: LazyState | Snapshot) -> dict[str, str]:
    """Return the names as they were first written, by key."""
    names = list(names)
    if len(names) > _FEW:
        world.objects(("object",))
    found: dict[str, str] = {}
    for name in names:
        constant = None if symbols.domain is None else symbols.domain.constant_spelling(name)
        row = None if constant is not None else world.row(KnowledgeType.INSTANCE, name)
        found[name] = constant or (name if row is None else row[0].spelling)
    return found
