"""Parses knowledge and questions: from text to items and formulas, and between items and formulas."""

from functools import lru_cache

from kbstore.conversion import from_composite
from kbstore.errors import InvalidKnowledge
from kbstore.messages import ComparisonType, Fact, Function, Goal, Inequality, Instance, KnowledgeItem
from kbstore.messages import Condition as ConditionMessage
from kbstore.model.domain import Domain
from kbstore.model.expressions import NumericExpression
from kbstore.model.formulas import Atom, Comparison, Defined, Formula, IsA, Not, terms_in, walk
from kbstore.model.symbols import SymbolTable
from kbstore.model.timelines import atom_key
from kbstore.names import key
from kbstore.pddl.conditions import UNCERTAIN, ConditionReader, conjuncts
from kbstore.pddl.expressions import read_expression
from kbstore.pddl.item_reader import ItemReader, fact_of
from kbstore.pddl.printer import condition_text
from kbstore.pddl.scope import Scope
from kbstore.pddl.sexpr import Group, SourceText, node_text

__all__ = [
    "condition_of",
    "goals_of",
    "parse_condition",
    "parse_expression",
    "parse_item",
]


def parse_item(text: str, domain: Domain | None = None) -> KnowledgeItem:
    """Read an item from its text.

    Reads ``wp7 - waypoint``, ``(p a b)``, ``(not (p a b))``, ``(= (f a) 3.5)``, ``(increase (f a) 2)`` and its like,
    ``(increase (f a) (* #t 2))`` (a rate), ``(> (f a) (+ (g) 32))``, ``minimize (total-time)``; and where the domain
    says that f is a numeric function, ``(f a)``, which asks whether it is defined. With a domain the arguments get
    their labels; whether they fit is checked where the item is stored.

    Raises:
        PddlSyntaxError: for what cannot be read.
        InvalidKnowledge: for what can be read, but is not an item.
    """
    source = SourceText(text)
    return ItemReader(Scope(source, domain, patterns=True)).read(source.read())


def parse_condition(text: str, domain: Domain | None = None) -> Formula:
    """Read a condition from its text.

    ``?`` and ``?name`` in facts are patterns where no quantifier binds them (rule V7). ``(= (f a) 3)`` compares;
    ``wp7 - waypoint`` asks for an object.

    Raises:
        PddlSyntaxError: for what cannot be read, and for conditions nested too deep.
        UnknownSymbol: for a predicate, function or type that the domain does not have.
        InvalidKnowledge: for a wrong number of arguments, and for a free variable in a comparison.
    """
    source = SourceText(text)
    scope = Scope(source, domain, patterns=True)
    top = source.read()
    if len(top) == 1 and isinstance(top[0], Group):
        return ConditionReader(scope).read(top[0])
    item = ItemReader(scope).read(top)
    if isinstance(item, Instance):
        return condition_of(item, domain)
    raise scope.error(f"{node_text(top, 60)} is not a condition; a condition is in brackets", top, 0)


def parse_stored(text: str) -> Formula:
    """Read a condition from a stored text, which was checked before; it may name object fluents (rule P4)."""
    source = SourceText(text)
    top = source.read()
    return ConditionReader(Scope(source, patterns=True, is_stored=True)).read(_one_group(source, top))


def parse_initial(text: str) -> list[Formula]:
    """Read a part of an initial state beyond facts and numbers from its stored text, as conditions (rule P4).

    ``(oneof (p) (q))`` gives its parts, an object fluent's value the equation, and any other constraint nothing.
    """
    source = SourceText(text)
    group = _one_group(source, source.read())
    reader = ConditionReader(Scope(source, patterns=True, is_stored=True))
    if group.word(0) in UNCERTAIN:
        return [reader.read(part) for part in group if isinstance(part, Group)]
    return [reader.read(group)] if is_initial(text) else []


def is_initial(text: str) -> bool:
    """Return whether a stored text is a part of the initial state, and not a trajectory constraint."""
    return text.startswith(tuple(f"({word} " for word in ("=", *UNCERTAIN)))


@lru_cache(maxsize=1024)
def uncertain_atoms(text: str) -> frozenset[str]:
    """Return the keys of the facts that a part of an initial state declares unknown; mostly none."""
    if not is_initial(text) or text.startswith("(= "):
        return frozenset()
    nodes = (node for part in parse_initial(text) for node, _, _ in walk(part, {}))
    return frozenset(
        atom_key([key(word) for word in (node.name, *node.arguments)]) for node in nodes if isinstance(node, Atom)
    )


def _one_group(source: SourceText, top: Group) -> Group:
    if len(top) != 1 or not isinstance(top[0], Group):
        raise source.error("one condition in brackets is expected", 0)
    return top[0]


def parse_expression(text: str, domain: Domain | None = None) -> NumericExpression:
    """Read a numeric expression from its text, like ``(+ (battery kenny) 5)``, of any depth.

    Raises `PddlSyntaxError`; with a domain also `UnknownSymbol` and `InvalidKnowledge`, as `parse_condition` does.
    """
    source = SourceText(text)
    scope = Scope(source, domain, patterns=True)
    top = source.read()
    if len(top) != 1:
        raise scope.error(f"one numeric expression is expected, not {len(top)}", top, min(1, len(top)))
    return read_expression(scope, top, 0)


def condition_of(item: KnowledgeItem | ConditionMessage, domain: Domain | None = None) -> Formula:
    """Return the question whether an item holds (rule V7).

    With a domain, its labels may come in any order. Raises `UnknownSymbol`, and `InvalidKnowledge` for labels or a
    number of arguments that do not fit, and for a metric, which cannot be asked this way.
    """
    if isinstance(item, ConditionMessage):
        return parse_condition(item.text, domain)
    condition: Formula
    match item:
        case Fact():
            condition = _arranged(item, domain)
        case Function():
            atom = _arranged(item, domain)
            if item.function_value is None:
                condition = Defined(atom)
            else:
                condition = Comparison(ComparisonType.EQUALS, (atom,), (item.function_value,))
        case Inequality():
            left, right = from_composite(item.ineq.LHS), from_composite(item.ineq.RHS)
            condition = Comparison(item.ineq.comparison_type, left, right)
        case Instance():
            if domain and item.instance_type:
                domain.type_spelling(item.instance_type)
            condition = IsA(item.instance_name or "?", item.instance_type)
        case _:
            raise InvalidKnowledge(
                f"the metric {item} is not a question; ask for the metric, or for the value of {item.expr}"
            )
    return Not(condition) if item.is_negative else condition


def goals_of(condition: Formula, domain: Domain | None = None) -> list[Goal]:
    """Split a goal into facts, negative facts and inequalities; what is none of these is a condition (rule C10).

    Raises `InvalidKnowledge` for goals that no planner takes: that an object exists, or a function is defined.
    """
    items = ItemReader(Scope(SourceText(""), domain))
    return [goal_of(part, items) for part in conjuncts(condition)]


def goal_of(part: Formula, items: ItemReader) -> Goal:
    """Return one part of a goal. Raises `InvalidKnowledge` as `goals_of` does."""
    positive = part.part if isinstance(part, Not) else part
    if any(term[:1] == "(" for term in terms_in(positive)):
        return ConditionMessage(text=condition_text(part))  # no other message can carry object fluents
    match positive:
        case Atom():
            return fact_of(positive.name, positive.arguments, items.predicate(positive.name), positive is not part)
        case Comparison():
            return items.inequality(positive, positive is not part)
    for occurrence in walk(part, {}):
        if isinstance(occurrence.node, IsA | Defined):
            raise InvalidKnowledge(
                f"{condition_text(occurrence.node)} can be asked, but is not a goal: a goal is about facts and values, "
                "not about what exists or is defined"
            )
    return ConditionMessage(text=condition_text(part))


def _arranged(item: Fact | Function, domain: Domain | None) -> Atom:
    """Return an item's atom, with the arguments in the order of the parameters; an empty argument becomes ``?``."""
    arguments = tuple(argument or "?" for argument in item.arguments)
    if domain is not None:
        name = item.attribute_name
        _, arguments = SymbolTable(domain).ordered(item.knowledge_type, name, arguments, item.labels)
    return Atom(item.attribute_name, arguments)
