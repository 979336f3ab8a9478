"""Translation between the reference's plain values and the public interface of kbstore."""

from collections.abc import Iterable
from dataclasses import replace

import kbstore
from tests.oracle import (
    Answer,
    Change,
    Comparison,
    Condition,
    Difference,
    Fact,
    Item,
    Limit,
    Metric,
    Number,
    Object,
    RefAction,
    RefDomain,
    Wanted,
)

OPERATIONS = {
    "assign": kbstore.AssignOp.ASSIGN,
    "increase": kbstore.AssignOp.INCREASE,
    "decrease": kbstore.AssignOp.DECREASE,
    "scale_up": kbstore.AssignOp.SCALE_UP,
    "scale_down": kbstore.AssignOp.SCALE_DOWN,
    "assign_cts": kbstore.AssignOp.ASSIGN_CTS,
}


def pddl(domain: RefDomain, actions: Iterable[RefAction] = ()) -> str:
    """A domain of the reference with actions as PDDL text."""

    def signature(name, parameters):
        words = [f"?p{place} - {types[0]}" for place, types in enumerate(parameters)]
        return f"({' '.join([name, *words])})"

    return "\n".join(
        [
            f"(define (domain {domain.name})",
            f"(:types {' '.join(f'{name} - {parent}' for name, parent in domain.types.items())})",
            f"(:constants {' '.join(f'{name} - {type_name}' for name, type_name in domain.constants.items())})",
            f"(:predicates {' '.join(signature(*entry) for entry in domain.predicates.items())})",
            f"(:functions {' '.join(signature(*entry) for entry in domain.functions.items())})",
            *map(action, actions),
            ")",
        ]
    )


def text(wanted: Wanted) -> str:
    """A condition as PDDL text."""
    atom = f"({' '.join([wanted.name, *wanted.arguments])})"
    if isinstance(wanted, Limit):
        return f"({wanted.comparison} {atom} {wanted.bound:g})"
    return atom if wanted.positive else f"(not {atom})"


def action(act: RefAction) -> str:
    """An action of the reference as PDDL text; its parameters are ?x and ?y."""

    def lifted(wanted):
        return text(replace(wanted, arguments=tuple(f"?{'xy'[int(place)]}" for place in wanted.arguments)))

    def atom(term):
        return lifted(Fact(*term))

    def change(timing, number):
        return f"(at {timing} ({number.operation} {atom((number.name, number.arguments))} {number.value}))"

    def flow(flow):
        terms = [f"(* {factor} {atom(term)})" for factor, term in flow.factors]
        rate = f"(+ {' '.join([str(flow.rate), *terms])})" if terms else str(flow.rate)
        effect = f"(increase {atom(flow.term)} (* #t {f'(/ {rate} {atom(flow.divisor)})' if flow.divisor else rate}))"
        conditions = [
            f"({when} {lifted(fact)})"
            for when, fact in (("over all", flow.condition), ("at start", flow.at_start))
            if fact
        ]
        return f"(when (and {' '.join(conditions)}) {effect})" if conditions else effect

    parameters = " ".join(f"?{'xy'[place]} - {wanted}" for place, wanted in enumerate(act.types))
    conditions = [f"(at start {lifted(fact)})" for fact in act.needs]
    conditions += [f"(over all {lifted(wanted)})" for wanted in act.invariants]
    effects = [f"(at start {lifted(fact)})" for fact in act.at_start]
    effects += [f"(at end {lifted(fact)})" for fact in act.at_end]
    effects += [f"(when (at start {lifted(first)}) (at end {lifted(then)}))" for first, then in act.decided_at_start]
    effects += [change("start", number) for number in act.numbers_at_start]
    effects += [change("end", number) for number in act.numbers_at_end]
    effects += map(flow, act.flows)
    bounds = [
        f"({comparison} ?duration {atom(bound) if isinstance(bound, tuple) else bound})"
        for comparison, bound in act.bounds
    ]
    return (
        f"(:durative-action {act.name} :parameters ({parameters}) :duration (and {' '.join(bounds)})"
        f" :condition (and {' '.join(conditions)}) :effect (and {' '.join(effects)}))"
    )


def sent(item: Item) -> object:
    """An item of the reference as a message, or as text where there is no message for it."""
    match item:
        case Object():
            return kbstore.Instance(instance_name=item.name, instance_type=item.type, is_negative=not item.positive)
        case Fact():
            return kbstore.Fact(attribute_name=item.name, values=item.arguments, is_negative=not item.positive)
        case Number():
            return kbstore.Function(
                attribute_name=item.name,
                values=item.arguments,
                function_value=item.value,
                rate=item.rate,
                assign_op=OPERATIONS[item.operation],
            )
        case Metric():
            return kbstore.item(item.text) if item.text else kbstore.Expression()
        case Comparison():
            return kbstore.item(item.text if item.positive else f"(not {item.text})")
        case Condition():
            return item.text


def pattern(item: Item) -> object:
    """The question for the whole timeline that an item of the reference belongs to."""
    match item:
        case Object():
            return kbstore.Instance(instance_name=item.name)
        case Fact() | Number():
            return f"({' '.join([item.name, *item.arguments])})"
        case Metric():
            return kbstore.Expression()
        case _:
            return item.text


def received(item: object) -> Item:
    """An item that kbstore answered as one of the reference."""
    match item:
        case kbstore.Instance():
            return Object(item.instance_name.lower(), item.instance_type.lower(), not item.is_negative)
        case kbstore.Fact():
            return Fact(item.attribute_name.lower(), tuple(map(str.lower, item.arguments)), not item.is_negative)
        case kbstore.Function():
            assert item.function_value is not None
            assert item.assign_op is kbstore.AssignOp.ASSIGN
            arguments = tuple(map(str.lower, item.arguments))
            return Number(item.attribute_name.lower(), arguments, item.function_value, item.rate)
        case kbstore.Expression():
            return Metric(str(item))
        case kbstore.Inequality():
            return Comparison(str(item.ineq), positive=not item.is_negative)
        case _:
            return Condition(str(item))


def placed(items):
    """Items with their times; every comparison includes that none is listed twice."""
    rows = [(received(item), item.initial_time) for item in items]
    assert len(set(rows)) == len(rows), rows
    return frozenset(rows)


def answer(state) -> Answer:
    """A state of kbstore as the reference answers."""
    return Answer(
        domain=state.domain.name if state.domain else None,
        instances=placed(state.instances),
        facts=placed(state.facts),
        functions=placed(state.functions),
        inequalities=placed(state.inequalities),
        metric=(received(state.metric), state.metric.initial_time) if state.metric else None,
        goals=placed(state.goals),
        timed_knowledge=placed(state.timed_knowledge),
    )


def row(assertion):
    """An assertion of kbstore as a row of the reference's history."""
    return (
        received(assertion.item),
        assertion.initial_time,
        assertion.end_time,
        assertion.recorded.number,
        assertion.ended.number if assertion.ended else None,
        assertion.cancelled.number if assertion.cancelled else None,
        assertion.superseded.number if assertion.superseded else None,
    )


def change(change) -> Change:
    """A change of kbstore as the reference has it."""

    def entries(assertions):
        return frozenset((received(a.item), a.initial_time) for a in assertions)

    return Change(
        change.number,
        entries(change.asserted),
        entries(change.ended),
        entries(change.cancelled),
        entries(change.superseded),
    )


def difference(diff) -> Difference:
    """A difference of kbstore as the reference has it."""
    return Difference(
        became_true=frozenset(map(received, diff.became_true)),
        became_false=frozenset(map(received, diff.became_false)),
        withdrawn=frozenset(map(received, diff.withdrawn)),
        numbers=frozenset((f.key[0], f.key[1:], before, after) for f, before, after in diff.numbers),
        goals_added=frozenset(map(received, diff.goals_added)),
        goals_removed=frozenset(map(received, diff.goals_removed)),
        metric=tuple(str(metric) if metric else None for metric in diff.metric) if diff.metric else None,
    )
