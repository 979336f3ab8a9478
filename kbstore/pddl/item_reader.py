"""Reads items from their groups: facts, values and changes of numeric functions, inequalities, objects, metrics."""

from dataclasses import dataclass

from kbstore.conversion import composite_of
from kbstore.errors import InvalidKnowledge
from kbstore.messages import (
    AssignOp,
    DomainFormula,
    DomainInequality,
    ExprComposite,
    Fact,
    Function,
    Inequality,
    Instance,
    KeyValue,
    KnowledgeItem,
    KnowledgeType,
    SpecialType,
    key_values,
)
from kbstore.messages import Expression as Metric
from kbstore.messages.items import trusted_fact
from kbstore.model.domain import Signature
from kbstore.model.expressions import NumericExpression
from kbstore.model.formulas import Atom, Comparison
from kbstore.names import is_wildcard, key
from kbstore.pddl.conditions import COMPARISONS
from kbstore.pddl.effects import ASSIGNMENTS, function_group, negated, rate_of
from kbstore.pddl.expressions import ANY_SPECIAL, is_number, number_at, read_expression
from kbstore.pddl.scope import Scope
from kbstore.pddl.sexpr import Group, node_text

OPTIMIZATIONS = ("minimize", "maximize")

_ADVICE = (
    "an item is an object (wp7 - waypoint), a fact (visited wp7), a value (= (battery kenny) 80), a change "
    "(increase (battery kenny) 5), an inequality (> (battery kenny) 20) or a metric (minimize (total-time))"
)


def labelled(arguments: tuple[str, ...], signature: Signature | None) -> tuple[KeyValue, ...]:
    """Label arguments by the signature; without one, or if their number does not fit, labels are empty."""
    return key_values(_labels(arguments, signature), arguments)


def _labels(arguments: tuple[str, ...], signature: Signature | None) -> tuple[str, ...]:
    if signature is not None and len(signature.labels) == len(arguments):
        return signature.labels
    return ("",) * len(arguments)


def fact_of(name: str, arguments: tuple[str, ...], signature: Signature | None, is_negative: bool = False) -> Fact:
    """Make a fact of an atom's parts."""
    labels = _labels(arguments, signature)
    values = key_values(labels, arguments)
    return trusted_fact(name, values, is_negative=is_negative, arguments=arguments, labels=labels)


def function_of(
    atom: Atom, signature: Signature | None, value: float | None, operation: AssignOp = AssignOp.ASSIGN
) -> Function:
    """Make the item that sets or changes a numeric function; without `value`, it asks whether that is defined."""
    return Function.trusted(
        initial_time=0,
        is_negative=False,
        attribute_name=atom.name,
        values=labelled(atom.arguments, signature),
        knowledge_type=KnowledgeType.FUNCTION,
        function_value=value,
        assign_op=operation,
        rate=0.0,
    )


@dataclass
class ItemReader:
    """Reads items of one text. The symbols and objects in them are checked where they are stored or asked."""

    scope: Scope

    def read(self, top: Group) -> KnowledgeItem:
        """Read the one item that a text consists of. Raises `PddlSyntaxError`, or `InvalidKnowledge` with advice."""
        if len(top) == 1 and isinstance(top[0], Group):
            return self.item(top[0])
        words = [node for node in top if isinstance(node, str)]
        if len(top) == 2 and top.word(0) in OPTIMIZATIONS:
            return self.metric(top, 0)
        if len(words) == len(top):
            return self._words(top, words)
        if not words:
            raise self.scope.error(f"there are {len(top)} items here, but one is expected", top, 1)
        raise self.scope.error(f"{node_text(top, 60)} is not an item; {_ADVICE}", top, 0)

    def item(self, group: Group) -> KnowledgeItem:
        """Read the item in a group."""
        negative = False
        while (word := group.word(0)) == "not":
            inner = group[1] if len(group) == 2 else None
            if not isinstance(inner, Group):
                raise self.scope.error(f"(not ...) takes one item in brackets: {node_text(group, 60)}", group)
            group, negative = inner, not negative
        item = self._positive(group, word)
        if not negative:
            return item
        if isinstance(item, Metric) or (isinstance(item, Function) and item.function_value is not None):
            raise InvalidKnowledge(
                f"(not {item}) is not an item: a value or a metric is not negated; assign another one, or remove it"
            )
        return item.changed(is_negative=True)

    def metric(self, group: Group, index: int) -> Metric:
        """Read the metric whose ``minimize`` or ``maximize`` is at a place, followed by its expression."""
        optimization, expression = read_metric(self._unchecked(), group, index, ANY_SPECIAL)
        return Metric(optimization=optimization, expr=self.composite(expression))

    def composite(self, expression: NumericExpression) -> ExprComposite:
        """Return the expression as a message, labelled by the domain."""
        return composite_of(expression, self._formula)

    def inequality(self, comparison: Comparison, is_negative: bool = False) -> Inequality:
        """Return a comparison as an item."""
        ineq = DomainInequality.trusted(
            comparison_type=comparison.comparison,
            LHS=self.composite(comparison.left),
            RHS=self.composite(comparison.right),
            grounded=True,
        )
        return Inequality(ineq=ineq, is_negative=is_negative)

    def predicate(self, name: str) -> Signature | None:
        """The signature by which a fact is labelled, if the domain has one."""
        return self.scope.domain.predicate_signatures.get(key(name)) if self.scope.domain else None

    def function(self, name: str) -> Signature | None:
        """The signature by which a numeric function is labelled, if the domain has one."""
        return self.scope.domain.function_signatures.get(key(name)) if self.scope.domain else None

    def _unchecked(self) -> Scope:
        """The scope for expressions, whose symbols are checked with those of all other items."""
        return Scope(self.scope.source, patterns=True)

    def _formula(self, atom: Atom) -> DomainFormula:
        values = labelled(atom.arguments, self.function(atom.name))
        return DomainFormula.trusted(name=atom.name, typed_parameters=values)

    def _words(self, top: Group, words: list[str]) -> KnowledgeItem:
        """Read an object with its type, ``wp7 - waypoint``, or without, as removals and questions may have it."""
        scope = self.scope
        if not words:
            raise scope.error(f"the text is empty; {_ADVICE}", top)
        name, type_name = words[0], ""
        if len(words) == 3 and words[1] == "-":
            type_name = words[2]
        elif len(words) == 2 and words[1][0] == "-" and len(words[1]) > 1:
            type_name = words[1][1:]
        elif len(words) == 2 and name[-1] == "-" and len(name) > 1:
            name, type_name = name[:-1], words[1]
        elif len(words) > 1 or scope.is_predicate(name) or scope.is_function(name):
            raise scope.error(f"a fact is in brackets, like ({' '.join(words)})", top, 0)
        if name == "-" or type_name == "-":
            raise scope.error(
                f"an object and its type are written like wp7 - waypoint, not {node_text(top, 60)}", top, 0
            )
        return Instance(instance_name=name, instance_type=type_name)

    def _positive(self, group: Group, word: str) -> KnowledgeItem:
        """Read the item in a group that begins with a word, or with a group if that is empty, and not with `not`."""
        scope, words = self.scope, group.is_flat()
        if words and group and word not in _RESERVED and "-" not in group[1:2]:
            # nearly all that there is to read
            return self._atom(str(group[0]), tuple(group[1:]))  # type: ignore[arg-type]
        if not group:
            raise scope.error(f"() is not an item; {_ADVICE}", group)
        if word in OPTIMIZATIONS or (word == ":metric" and len(group) > 1):
            return self.metric(group, int(word == ":metric"))
        if word in COMPARISONS:
            return self._compared(group)
        if word in ASSIGNMENTS and len(group) == 3 and not (words and scope.is_predicate(word)):
            return self._change(group)
        if len(group) == 3 and group[1] == "-" and words:
            return Instance(instance_name=str(group[0]), instance_type=str(group[2]))
        if not words and word in _CONDITIONS:
            raise InvalidKnowledge(f"{node_text(group, 60)} is a condition, which is not one item; {_ADVICE}")
        if word == "at" and len(group) == 3 and is_number(group[1]) and isinstance(group[2], Group):
            raise InvalidKnowledge(
                f"{node_text(group, 60)} is a timed literal, which only a problem has; as an item, give "
                f"{node_text(group[2], 60)}, and its time as initial_time"
            )
        return self._atom(scope.name(group, 0, "predicate"), scope.words(group, 1))

    def _atom(self, name: str, arguments: tuple[str, ...]) -> KnowledgeItem:
        """Make a fact, or the question whether a function is defined."""
        predicate = self.predicate(name)
        if predicate is None and (function := self.function(name)) is not None:
            return function_of(Atom(name, arguments), function, None)
        return fact_of(name, arguments, predicate)

    def _compared(self, group: Group) -> KnowledgeItem:
        """Read a comparison: ``(= (f a) 3)`` is the value of a function, every other one an inequality."""
        scope = self.scope
        if len(group) != 3:
            raise scope.error(f"({group[0]} ...) compares two values: {node_text(group, 60)}", group)
        left, right = group[1], group[2]
        is_term = isinstance(left, Group) and left.word(0) not in ("+", "-", "*", "/", "total-time")
        if group[0] == "=" and (is_term or (isinstance(left, str) and not is_number(left) and left[0] not in "?#")):
            value = number_at(scope, group, 2)
            if value is not None:
                atom = self._term(group)
                return function_of(atom, self.function(atom.name), value)
        if group[0] == "=" and isinstance(left, str) and isinstance(right, str) and not is_number(left):
            raise InvalidKnowledge(
                f"{node_text(group, 60)} compares two objects, which can be asked, but is not an item; {_ADVICE}"
            )
        unchecked = self._unchecked()
        first, second = read_expression(unchecked, group, 1), read_expression(unchecked, group, 2)
        return self.inequality(Comparison(COMPARISONS[group.word(0)], first, second))

    def _change(self, group: Group) -> Function:
        scope, operation = self.scope, ASSIGNMENTS[group.word(0)]
        atom = self._term(group)
        value = number_at(scope, group, 2)
        if value is None and operation in (AssignOp.INCREASE, AssignOp.DECREASE):
            rate = rate_of(read_expression(self._unchecked(), group, 2))
            value = _constant(rate) if rate is not None else None
            if value is not None:
                value = -value if operation is AssignOp.DECREASE else value
                operation = AssignOp.ASSIGN_CTS
        if value is None:
            raise InvalidKnowledge(
                f"{node_text(group, 80)}: the value of a change is a number, or a rate like (* #t 2), "
                f"not {node_text(group[2], 60)}"
            )
        return function_of(atom, self.function(atom.name), value, operation)

    def _term(self, group: Group) -> Atom:
        """Read the function's term that a group begins with."""
        term = function_group(self.scope, group, 1)
        name = self.scope.name(term, 0, "numeric function")
        if is_wildcard(name) or is_number(name):
            raise self.scope.error(f"the name of a numeric function is expected here, not {name}", term)
        return Atom(name, self.scope.words(term, 1))


def read_metric(
    scope: Scope, group: Group, index: int, specials: frozenset[SpecialType]
) -> tuple[str, NumericExpression]:
    """Read the word ``minimize`` or ``maximize`` at a place, and the expression after it."""
    if group.word(index) not in OPTIMIZATIONS or len(group) != index + 2:
        raise scope.error(
            f"a metric is minimize or maximize and one expression, not {node_text(group, 60)}", group, index
        )
    return group.word(index), read_expression(scope, group, index + 1, specials=specials)


_RESERVED = frozenset((*OPTIMIZATIONS, ":metric", *COMPARISONS, *ASSIGNMENTS))
"""The words that a group begins with that is not an atom, even if it has no inner groups."""

_CONDITIONS = ("and", "or", "imply", "forall", "exists", "preference", "when")


def _constant(expression: NumericExpression) -> float | None:
    """Return the number that an expression is, with any number of signs; None for any other expression."""
    while len(expression) == 2:
        expression = negated(expression[1:])
    return float(expression[0]) if len(expression) == 1 and isinstance(expression[0], float) else None
