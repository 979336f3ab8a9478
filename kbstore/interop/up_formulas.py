"""Translates expressions and conditions to those of unified_planning."""

from collections.abc import Iterator, Mapping, Sequence
from fractions import Fraction
from itertools import product
from typing import Any

from kbstore.errors import InvalidKnowledge
from kbstore.evaluation import expressions
from kbstore.interop.up_symbols import SymbolTranslator, library
from kbstore.messages import ComparisonType, Operator, SpecialType
from kbstore.messages.base import format_number
from kbstore.model.expressions import NumericExpression, Token
from kbstore.model.formulas import (
    And,
    Atom,
    Comparison,
    Exists,
    Forall,
    Formula,
    Imply,
    Not,
    Or,
    Parameter,
    Same,
    Truism,
)
from kbstore.names import key
from kbstore.pddl.printer import condition_text

UpVariables = Mapping[str, Any]
"""The parameter or variable of unified_planning for each variable, by its key."""

NOTHING: UpVariables = {}


class FormulaTranslator:
    """Translates formulas; raises `InvalidKnowledge` for parts without a counterpart."""

    def __init__(self, symbols: SymbolTranslator) -> None:
        self.symbols = symbols
        self._up = library()
        self._make = symbols.environment.expression_manager

    # -- terms and numbers ------------------------------------------------------------------------------------

    def term(self, name: str, scope: UpVariables) -> Any:
        """Return an object, or the binding of a variable."""
        if not name.startswith("?"):
            return self._make.ObjectExp(self.symbols.object(name))
        if key(name[1:]) not in scope:
            raise InvalidKnowledge(f"the variable {name} is not bound")
        return scope[key(name[1:])]

    def fact(self, atom: Atom, scope: UpVariables = NOTHING) -> Any:
        """Translate a predicate with its arguments."""
        return self.symbols.predicate(atom.name)(*(self.term(argument, scope) for argument in atom.arguments))

    def function(self, atom: Atom, scope: UpVariables = NOTHING) -> Any:
        """Translate a numeric function with its arguments."""
        return self.symbols.function(atom.name)(*(self.term(argument, scope) for argument in atom.arguments))

    def number(self, number: float) -> Any:
        """Translate a number exactly as its decimal text."""
        exact = Fraction(format_number(number))
        return self._make.Int(int(exact)) if exact.denominator == 1 else self._make.Real(exact)

    def expression(self, expression: NumericExpression, scope: UpVariables = NOTHING, duration: Any = None) -> Any:
        """Translate a numeric expression; `duration` is the translated value of ``?duration``, if it has one."""

        def leaf(token: Token) -> Any:
            if isinstance(token, Atom):
                return self.function(token, scope)
            if isinstance(token, SpecialType):
                if token is SpecialType.DURATION and duration is not None:
                    return duration
                raise InvalidKnowledge(f"{token.pddl} in an expression has no counterpart in unified_planning")
            return self.number(expressions.number(token))

        def operate(operator: Operator, operands: Sequence[Any]) -> Any:
            match operator:
                case Operator.ADD:
                    return self._make.Plus(*operands)
                case Operator.SUB:
                    return self._make.Minus(*operands)
                case Operator.MUL:
                    return self._make.Times(*operands)
                case Operator.DIV:
                    return self._make.Div(*operands)
                case Operator.UMINUS:
                    return self._make.Minus(self._make.Int(0), *operands)

        return expressions.fold(expression, leaf, operate)

    # -- conditions -------------------------------------------------------------------------------------------

    def condition(self, node: Formula, scope: UpVariables = NOTHING, duration: Any = None) -> Any:
        """Translate a condition; `duration` is the translated value of ``?duration``, if it has one."""
        match node:
            case Truism():
                return self._make.TRUE()
            case Atom():
                return self.fact(node, scope)
            case Not(part):
                return self._make.Not(self.condition(part, scope, duration))
            case And(parts):
                return self._make.And(*[self.condition(part, scope, duration) for part in parts])
            case Or(parts):
                return self._make.Or(*[self.condition(part, scope, duration) for part in parts])
            case Imply(premise, conclusion):
                return self._make.Implies(
                    self.condition(premise, scope, duration), self.condition(conclusion, scope, duration)
                )
            case Exists(parameters, part):
                each = self.bound(parameters, scope)
                return self._make.Or(*[self._make.Exists(self.condition(part, s, duration), *v) for v, s in each])
            case Forall(parameters, part):
                each = self.bound(parameters, scope)
                return self._make.And(*[self._make.Forall(self.condition(part, s, duration), *v) for v, s in each])
            case Same(left, right):
                return self._make.Equals(self.term(left, scope), self.term(right, scope))
            case Comparison(comparison, left_side, right_side):
                left_value = self.expression(left_side, scope, duration)
                right_value = self.expression(right_side, scope, duration)
                return self._compared(comparison, left_value, right_value)
            case _:
                raise InvalidKnowledge(f"{condition_text(node)} has no counterpart in unified_planning")

    def bound(self, parameters: Sequence[Parameter], scope: UpVariables) -> Iterator[tuple[list[Any], UpVariables]]:
        """Yield variables for parameters, and the scope with them.

        A variable of unified_planning has one type, so an ``either`` gives several lists of variables, which together
        range over the same objects. A name that is in use gets a number, so that it hides no other variable.
        """
        for types in product(*(p.types for p in parameters)):
            variables, inner = [], dict(scope)
            for parameter, type_name in zip(parameters, types, strict=True):
                name, count = parameter.name, 1
                while key(name) in inner:
                    count += 1
                    name = f"{parameter.name}_{count}"
                variable = self._up.model.Variable(name, self.symbols.type(type_name), self.symbols.environment)
                variables.append(variable)
                inner[key(parameter.name)] = inner[key(name)] = self._make.VariableExp(variable)
            yield variables, inner

    def is_of(self, term: Any, types: tuple[str, ...], scope: UpVariables) -> Any:
        """Return the condition that an object is of one of the types: it equals some object of them."""
        same = (variable for (variable,), _ in self.bound((Parameter("same", types),), scope))
        return self._make.Or(*(self._make.Exists(self._make.Equals(variable, term), variable) for variable in same))

    def _compared(self, comparison: ComparisonType, left: Any, right: Any) -> Any:
        match comparison:
            case ComparisonType.GREATER:
                return self._make.GT(left, right)
            case ComparisonType.GREATEREQ:
                return self._make.GE(left, right)
            case ComparisonType.LESS:
                return self._make.LT(left, right)
            case ComparisonType.LESSEQ:
                return self._make.LE(left, right)
            case ComparisonType.EQUALS:
                return self._make.Equals(left, right)
