"""Makes the items of messages from rows."""

from collections.abc import Iterable
from itertools import pairwise
from operator import itemgetter

from kbstore.conversion import composite_of, unlabelled
from kbstore.messages import (
    AssignOp,
    ComparisonType,
    Condition,
    DomainFormula,
    DomainInequality,
    ExprComposite,
    Expression,
    Fact,
    Function,
    Inequality,
    Instance,
    KeyValue,
    KnowledgeItem,
    KnowledgeType,
    key_values,
)
from kbstore.model.formulas import Atom
from kbstore.model.symbols import SymbolTable
from kbstore.model.timelines import StateRow, Timeline, Value, number_at
from kbstore.names import key
from kbstore.pddl.parse import parse_expression

_ATOMS = (KnowledgeType.FACT, KnowledgeType.FUNCTION)


class ItemFactory:
    """Makes items with the labels of one symbol table."""

    def __init__(self, symbol_table: SymbolTable) -> None:
        self._symbols = symbol_table
        self._domain = symbol_table.domain

    def item(self, timeline: Timeline, initial_time: int, value: Value, t: int) -> KnowledgeItem | Condition:
        """Return the item of a row; a function's has its value at `t`."""
        return self._items([(timeline, initial_time, value)], t)[0]

    def items(self, rows: Iterable[StateRow], t: int | None) -> list[KnowledgeItem | Condition]:
        """Return the items of rows, in order of their initial times; without `t` each function's is its first value."""
        return self._items(_in_order(rows), t)

    def _items(self, rows: Iterable[StateRow], t: int | None) -> list[KnowledgeItem | Condition]:
        """Return the items of rows. The item of the row shown last on a timeline is cached with it."""
        domain, found = self._domain, []
        for timeline, initial_time, value in rows:
            # read the attribute once: other threads may set it in between
            latest = timeline.latest
            if latest is not None and latest[0] is domain and latest[1] == initial_time and latest[2] == value:
                found.append(latest[3])
                continue
            item = self._made(timeline, initial_time, value, initial_time if t is None else t)
            is_moving = timeline.kind is KnowledgeType.FUNCTION and value[3]
            # without a domain, a later use may add labels (rule D2)
            if domain is not None and not is_moving:
                timeline.latest = (domain, initial_time, value, item)
            found.append(item)
        return found

    def _made(self, timeline: Timeline, initial_time: int, value: Value, t: int) -> KnowledgeItem | Condition:
        match timeline.kind:
            case KnowledgeType.FACT:
                return Fact.trusted(
                    initial_time=initial_time,
                    is_negative=bool(value[0]),
                    attribute_name=timeline.name,
                    values=self._values(timeline),
                    knowledge_type=KnowledgeType.FACT,
                )
            case KnowledgeType.FUNCTION:
                return Function.trusted(
                    initial_time=initial_time,
                    is_negative=False,
                    attribute_name=timeline.name,
                    values=self._values(timeline),
                    knowledge_type=KnowledgeType.FUNCTION,
                    function_value=number_at(value, initial_time, t),
                    assign_op=AssignOp.ASSIGN,
                    rate=value[3],
                )
            case KnowledgeType.INSTANCE:
                return Instance.trusted(
                    initial_time=initial_time,
                    is_negative=bool(value[0]),
                    knowledge_type=KnowledgeType.INSTANCE,
                    instance_type=value[1],
                    instance_name=timeline.spelling,
                )
            case KnowledgeType.EXPRESSION:
                if not value[1]:
                    return Condition(text=value[2], initial_time=initial_time)
                return Expression(initial_time=initial_time, optimization=value[1], expr=self._expression(value[2]))
            case KnowledgeType.INEQUALITY:
                inequality = DomainInequality(
                    comparison_type=ComparisonType(value[1]),
                    LHS=self._expression(value[2]),
                    RHS=self._expression(value[3]),
                    grounded=bool(value[4]),
                )
                return Inequality(initial_time=initial_time, is_negative=bool(value[0]), ineq=inequality)

    def _expression(self, text: str) -> ExprComposite:
        return composite_of(parse_expression(text), self._formula)

    def _formula(self, function: Atom) -> DomainFormula:
        """Return a function's term with its parameters' labels; PDDL's own, like ``(is-violated p)``, have none."""
        if not self._symbols.known(KnowledgeType.FUNCTION, function.name):
            return unlabelled(function)
        labels = self._symbols.labels(KnowledgeType.FUNCTION, key(function.name), len(function.arguments))
        return DomainFormula.trusted(name=function.name, typed_parameters=key_values(labels, function.arguments))

    def _values(self, timeline: Timeline) -> tuple[KeyValue, ...]:
        """Return the arguments with their labels, cached with the timeline for all states with the same labels."""
        labels = self._symbols.labels(timeline.kind, timeline.keys[0], len(timeline.arguments))
        # read the attribute once: other threads may set it in between
        shown = timeline.shown
        if shown is None or shown[0] is not labels:
            shown = timeline.shown = (labels, key_values(labels, timeline.arguments))
        return shown[1]


def _in_order(rows: Iterable[StateRow]) -> list[StateRow]:
    """Return rows in order of their initial times, and of their timelines' numbers."""
    found = sorted(rows, key=itemgetter(1))
    # rows of one time are mostly in order already; to sort by both numbers at once takes twice as long
    if any(before[1] == row[1] and before[0].id > row[0].id for before, row in pairwise(found)):
        found.sort(key=lambda row: (row[1], row[0].id))
    return found
