"""Checks that what holds, is scheduled and runs fits another version of the domain (rule D4)."""

from collections.abc import Iterable, Iterator

from kbstore.errors import KbStoreError
from kbstore.messages import KnowledgeType
from kbstore.model.domain import Domain
from kbstore.model.symbols import SymbolTable
from kbstore.model.timelines import Role, Value
from kbstore.pddl.parse import parse_condition, parse_expression
from kbstore.planning.rates import RunningAction
from kbstore.writing.change_set import ChangeSet
from kbstore.writing.formulas import condition_violations, expression_violations
from kbstore.writing.resolution import NameResolver, naming, violations_of
from kbstore.writing.timeline_state import TimelineState


def violations(
    domain: Domain, change_set: ChangeSet, states: Iterable[TimelineState], running: Iterable[RunningAction]
) -> list[str]:
    """Return the violations under a domain, each in one sentence."""
    resolver = NameResolver(change_set, SymbolTable(domain))
    sentences: list[str] = []
    for state in states:
        values = [(change_set.now, state.value)] if state.value is not None else []
        for t, value in (*values, *sorted(state.ahead.items())):
            sentences += _timeline_violations(domain, resolver, state, t, value)
    for entry in running:
        sentences += _run_violations(domain, resolver, entry, change_set.now)
    return list(dict.fromkeys(sentences))


def _timeline_violations(
    domain: Domain, resolver: NameResolver, state: TimelineState, t: int, value: Value
) -> Iterable[str]:
    timeline = state.timeline
    match timeline.kind:
        case KnowledgeType.INSTANCE:
            return _object_violations(domain, timeline.spelling, value)
        case KnowledgeType.FACT | KnowledgeType.FUNCTION:
            try:
                SymbolTable(domain).ordered(timeline.kind, timeline.name, timeline.arguments, ())
            except KbStoreError as error:
                return violations_of(error, f"({timeline.spelling})")
            if timeline.role is Role.STATE and timeline.kind is KnowledgeType.FACT and domain.is_derived(timeline.name):
                return [
                    f"({timeline.spelling}) is asserted, but {timeline.name} is derived in the domain {domain.name}"
                ]
            return resolver.atom_violations(timeline.kind, timeline.name, timeline.arguments, t)
        case KnowledgeType.EXPRESSION if timeline.role is Role.STATE:
            return naming(f"{value[1]} {value[2]}", expression_violations(resolver, parse_expression(value[2]), t))
        case _ if timeline.role is Role.CONSTRAINT:
            return ()
        case _:
            try:
                formula = parse_condition(timeline.spelling, domain)
                return naming(timeline.spelling, condition_violations(resolver, formula, t))
            except KbStoreError as error:
                return violations_of(error, timeline.spelling)


def _object_violations(domain: Domain, name: str, value: Value) -> Iterator[str]:
    if value[0]:
        return
    if not domain.knows_type(value[1]):
        yield f"{name} - {value[1]}: the domain {domain.name} has no type {value[1]}"
    if domain.constant_spelling(name) is not None:
        yield f"{name} - {value[1]}: the domain {domain.name} has a constant {name}; remove the object first"


def _run_violations(domain: Domain, resolver: NameResolver, entry: RunningAction, t: int) -> Iterator[str]:
    run = entry.run
    try:
        action = domain.action(run.operator)
    except KbStoreError as error:
        yield f"{run.action} runs: {error}"
        return
    if len(action.parameters) != len(run.arguments) or not action.durative:
        yield f"{run.action} runs, but is another action in the domain {domain.name}"
        return
    types = [parameter.types for parameter in action.parameters]
    yield from resolver.object_violations(run.action, run.arguments, types, t)
