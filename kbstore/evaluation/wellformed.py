"""Checks of questions: known symbols, the right number of arguments, no free variables (rules V7, V8)."""

from collections.abc import Mapping

from kbstore.errors import InvalidKnowledge
from kbstore.evaluation.expressions import fold, ground, number, special
from kbstore.evaluation.substitution import Bindings, keyed, term
from kbstore.messages.enums import SpecialType
from kbstore.model.domain import Domain, Signature
from kbstore.model.expressions import NumericExpression, Token
from kbstore.model.formulas import (
    And,
    Atom,
    Comparison,
    Defined,
    Exists,
    Forall,
    Formula,
    Imply,
    IsA,
    Not,
    Or,
    Parameter,
    Preference,
    Same,
    Truism,
    children,
    object_terms,
)
from kbstore.model.symbols import arity_problem
from kbstore.names import key

MAX_DEPTH = 160
"""Conditions nested deeper are refused, so that functions over them may be recursive."""


def check(
    condition: Formula,
    domain: Domain | None,
    bindings: Mapping[str, str] = {},
    *,
    duration: float | None = None,
) -> None:
    """Refuse a condition without a meaning, in any of its branches.

    A variable without a binding is a wildcard in an atom, and refused elsewhere. Objects need not exist. Without a
    domain every symbol is known.

    Raises:
        UnknownSymbol: a predicate, function or type that the domain does not know.
        InvalidKnowledge: a wrong number of arguments, a variable without a binding outside of atoms, ``?duration``
            without a duration, nesting beyond `MAX_DEPTH`.
    """
    todo: list[tuple[Formula, Bindings, int]] = [(condition, keyed(bindings), 1)]
    while todo:
        node, known, depth = todo.pop()
        if depth > MAX_DEPTH:
            raise InvalidKnowledge(f"the condition is nested deeper than {MAX_DEPTH} levels; split it")
        match node:
            case Atom():
                _check_computed(node, domain)
                _check_arity(node, domain.predicate_signature(node.name) if domain else None)
            case Exists(parameters) | Forall(parameters):
                known = {**known, **_declared(parameters, domain)}
            case Same(left, right):
                _check_computed(Atom("=", (left, right)), domain)
                _check_object(left, known)
                _check_object(right, known)
            case Comparison():
                check_expression(node.left, domain, known, duration=duration)
                check_expression(node.right, domain, known, duration=duration)
            case Defined(function):
                _check_computed(function, domain)
                _check_arity(function, domain.function_signature(function.name) if domain else None)
            case IsA(_, type_name):
                _check_types((type_name,) if type_name else (), domain)
            case Not() | And() | Or() | Imply() | Preference() | Truism():
                pass
            case _:
                raise InvalidKnowledge(f"{node!r:.80} is not a condition")
        todo.extend((part, known, depth + 1) for part in reversed(children(node)))


def _check_computed(atom: Atom, domain: Domain | None) -> None:
    """Refuse what is stored but not computed: object fluents, and after now what processes and events change."""
    if domain is not None and domain.uncomputed:
        named = (atom.name, *(name for argument in atom.arguments for name in object_terms(argument)))
        reason = next(filter(None, (domain.uncomputed.get(key(name)) for name in named)), None)
        if reason:
            raise InvalidKnowledge(f"{atom!s:.200} cannot be answered: {reason}")


def _check_arity(atom: Atom, signature: Signature | None) -> None:
    problem = arity_problem(atom, signature) if signature is not None else None
    if problem:
        raise InvalidKnowledge(problem)


def _declared(parameters: tuple[Parameter, ...], domain: Domain | None) -> dict[str, str]:
    """Return a binding for each variable that a quantifier binds."""
    declared: dict[str, str] = {}
    for parameter in parameters:
        _check_types(parameter.types, domain)
        if key(parameter.name) in declared:
            raise InvalidKnowledge(f"one quantifier declares ?{parameter.name} twice; give each variable its own name")
        declared[key(parameter.name)] = parameter.name
    return declared


def _check_types(types: tuple[str, ...], domain: Domain | None) -> None:
    if domain is not None:
        for type_name in types:
            domain.type_spelling(type_name)


def _check_object(argument: str, known: Bindings) -> None:
    if term(argument, known) is None:
        raise InvalidKnowledge(
            f"{argument or '?'} in (= ...) between objects stands for no definite object; name one, or say exists: "
            f"(exists ({argument if len(argument) > 1 else '?x'} - object) ...)"
        )


def check_expression(
    expression: NumericExpression,
    domain: Domain | None,
    bindings: Mapping[str, str] = {},
    *,
    duration: float | None = None,
) -> None:
    """Refuse an expression without a meaning; arguments and errors are those of `check`."""
    known = keyed(bindings)

    def check_token(token: Token) -> None:
        if isinstance(token, Atom):
            _check_computed(token, domain)
            _check_arity(token, domain.function_signature(token.name) if domain else None)
            ground(token, known)
        elif isinstance(token, SpecialType):
            special(token, duration=duration)
        else:
            number(token)

    fold(expression, check_token, lambda _operator, _operands: None)
