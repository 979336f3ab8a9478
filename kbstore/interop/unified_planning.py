"""Converts the state at one time to a ``Problem`` of unified_planning, through that library's own interface.

Everything without a counterpart there is refused in one error. Needs the extra ``planning``:
``pip install 'kbstore[planning]'``.
"""

import warnings
from collections.abc import Iterable, Iterator
from fractions import Fraction
from typing import TYPE_CHECKING, Any

from kbstore.clock import SECOND, isoformat
from kbstore.conversion import from_composite
from kbstore.errors import InvalidKnowledge, MissingLibrary
from kbstore.interop.plans import Happening, Step, execute, steps
from kbstore.interop.up_actions import ActionTranslator, changed_functions
from kbstore.interop.up_constraints import TrajectoryConstraint, read_constraint, translated, types_of
from kbstore.interop.up_formulas import FormulaTranslator
from kbstore.interop.up_symbols import (
    Refusals,
    SymbolTranslator,
    ambiguous_names,
    common_type,
    library,
    quantified,
)
from kbstore.messages import Condition, Expression, Fact, Function, Goal, Inequality, KnowledgeItem, SpecialType
from kbstore.messages.base import format_number
from kbstore.model import formulas
from kbstore.model.domain import Domain
from kbstore.model.expressions import atoms_of
from kbstore.model.formulas import Atom
from kbstore.names import key
from kbstore.pddl.parse import condition_of, is_initial, parse_condition
from kbstore.pddl.printer import condition_text

if TYPE_CHECKING:
    from kbstore.reading.state import State

__all__ = ["Happening", "MissingLibrary", "Step", "execute", "steps", "to_problem"]


def to_problem(state: "State", *, environment: Any = None) -> Any:
    """Return the planning problem of a state as a ``unified_planning.model.Problem``.

    Names are spelled as the domain spells them. Absent facts are false, also where they are unknown. Timed-initial
    knowledge, and the end effects of running actions, become timed effects relative to the state's time; a function
    that only running actions move is constant until their ends. Recorded inequalities are not part of a problem.

    Args:
        state: the state to plan from.
        environment: the ``Environment`` of unified_planning; the library's global one unless given. A domain that
            gives one name to several things (a predicate ``open`` and an operator ``open``) gets an environment of
            its own that permits it.

    Raises:
        InvalidKnowledge: there is no domain, or something has no counterpart in unified_planning: derived
            predicates, preferences, constraints with deadlines, ``?duration`` where it is not fixed, objects that come
            or go, functions that move by themselves.
        MissingLibrary: unified_planning is not installed.
    """
    if state.domain is None:
        raise InvalidKnowledge("a planning problem needs a domain; load one first: kb.load('domain.pddl')")
    return _Translation(state, state.domain, environment).problem()


class _Translation:
    """Translates one state to a problem, and collects the refused parts."""

    def __init__(self, state: "State", domain: Domain, environment: Any) -> None:
        self._up = library()
        self._state = state
        self._domain = domain
        self._objects = {**domain.constants, **{i.instance_name: i.instance_type for i in state.instances}}
        if environment is None:
            environment = self._up.environment.get_environment()
            if ambiguous_names(domain, self._objects):
                environment = self._up.environment.Environment()
                environment.error_used_name = False
        self._environment = environment
        self._refusals = Refusals()
        # a function that only running actions move comes to rest at their ends, with a value among their end effects
        last_rates = {item.key: item.rate for _, item, _ in state.end_effects if isinstance(item, Function)}
        self._coming_to_rest = {function for function, rate in last_rates.items() if not rate}
        self._goals = [_goal_condition(goal, domain) for goal in state.goals]
        self._constraints: dict[str, TrajectoryConstraint] = {}
        for text in state.constraints:
            with self._refusals.of("the initial state" if is_initial(text) else "the constraints"):
                self._constraints[text] = read_constraint(text, domain)
        self._symbols = SymbolTranslator(domain, self._objects, self._types_in_use(), environment)
        self._formulas = FormulaTranslator(self._symbols)
        self._problem = self._up.model.Problem(
            state.name, environment, initial_defaults={environment.type_manager.BoolType(): False}
        )

    def problem(self) -> Any:
        with warnings.catch_warnings():
            # the library warns of each name that has several meanings
            warnings.filterwarnings("ignore", message=".*[Nn]ame .* already .*")
            self._add_symbols()
            self._add_actions()
        self._set_initial_values()
        for t, item, what in self._scheduled():
            with self._refusals.of(what):
                self._add_timed(item, t)
        for goal in self._goals:
            with self._refusals.of(f"the goal {condition_text(goal)}"):
                self._problem.add_goal(self._formulas.condition(goal))
        for text, constraint in self._constraints.items():
            with self._refusals.of(f"the constraint {text}"):
                self._problem.add_trajectory_constraint(translated(constraint, self._formulas))
        if self._state.metric is not None:
            with self._refusals.of(f"the metric {self._state.metric}"):
                self._problem.add_quality_metric(self._metric(self._state.metric))
        self._refusals.report()
        return self._problem

    # -- the domain -------------------------------------------------------------------------------------------

    def _types_in_use(self) -> Iterator[str]:
        """Yield the types of objects, of parameters, and of quantified variables."""
        domain = self._domain
        yield from self._objects.values()
        parameters = (
            *(s.parameters for s in (*domain.predicate_signatures.values(), *domain.function_signatures.values())),
            *(action.parameters for action in domain.actions.values()),
        )
        yield from (common_type(domain, p.types) for declared in parameters for p in declared)
        for action in domain.actions.values():
            for _, formula in (*action.conditions, *action.effects):
                yield from quantified(formula)
        for goal in self._goals:
            yield from quantified(goal)
        for constraint in self._constraints.values():
            yield from types_of(constraint)

    def _add_symbols(self) -> None:
        domain, problem = self._domain, self._problem
        with self._refusals.of("the types"):
            for user_type in self._symbols.types():
                # the library has no public way to add a type without objects and parameters
                problem._add_user_type(user_type)
        for signature in domain.predicate_signatures.values():
            if not domain.is_derived(signature.name):
                with self._refusals.of(f"the predicate {signature}"):
                    problem.add_fluent(self._symbols.predicate(signature.name))
        for signature in domain.function_signatures.values():
            with self._refusals.of(f"the function {signature}"):
                problem.add_fluent(self._symbols.function(signature.name))
        for name, fluent in domain.object_fluents.items():
            with self._refusals.of(f"the function {fluent.signature}"):
                raise InvalidKnowledge(domain.uncomputed[name])
        for event in domain.events:
            with self._refusals.of(f"the {event.kind} {event.name}"):
                raise InvalidKnowledge("it is kept and written back as PDDL, but not computed")
        for name in self._objects:
            with self._refusals.of(f"the object {name}"):
                problem.add_object(self._symbols.object(name))

    def _add_actions(self) -> None:
        timed = (item.attribute_name for item in self._state.timed_knowledge if isinstance(item, Function))
        ends = (item.attribute_name for _, item, _ in self._state.end_effects if isinstance(item, Function))
        changing = frozenset((*changed_functions(self._domain), *map(key, timed), *map(key, ends)))
        actions = ActionTranslator(self._formulas, changing)
        for action in self._domain.actions.values():
            with self._refusals.of(f"the operator {action.name}"):
                if action.observe is not None:
                    raise InvalidKnowledge("what it is to observe is kept and written back as PDDL, but not computed")
                self._problem.add_action(actions.action(action))

    # -- the state --------------------------------------------------------------------------------------------

    def _set_initial_values(self) -> None:
        for fact in self._state.facts:
            with self._refusals.of(str(fact)):
                self._problem.set_initial_value(self._fluent(fact), not fact.is_negative)
        for function in self._state.functions:
            with self._refusals.of(str(function)):
                self._problem.set_initial_value(self._fluent(function), self._value(function))

    def _scheduled(self) -> Iterable[tuple[int, KnowledgeItem, str]]:
        """Return timed knowledge with descriptions; the last of several on one timeline at one time counts."""
        last: dict[tuple[object, ...], tuple[int, KnowledgeItem, str]] = {}
        for item in self._state.timed_knowledge:
            t = item.initial_time
            last[_subject(item), t] = t, item, f"{item} at {isoformat(t)}"
        for t, item, run in self._state.end_effects:
            last[_subject(item), t] = t, item, f"{item} at the end of {run}"
        return last.values()

    def _add_timed(self, item: KnowledgeItem, t: int) -> None:
        if isinstance(item, Inequality):
            return
        if not isinstance(item, Fact | Function):
            raise InvalidKnowledge("objects and the metric of a unified_planning problem stay as they are")
        after = self._up.model.GlobalStartTiming(Fraction(t - self._state.at, SECOND))
        value = self._value(item) if isinstance(item, Function) else not item.is_negative
        self._problem.add_timed_effect(after, self._fluent(item), value)

    def _fluent(self, item: Fact | Function) -> Any:
        atom = Atom(item.attribute_name, item.arguments)
        return self._formulas.fact(atom) if isinstance(item, Fact) else self._formulas.function(atom)

    def _value(self, function: Function) -> Any:
        if function.rate and function.key not in self._coming_to_rest:
            raise InvalidKnowledge(
                f"it moves by {format_number(function.rate)} per second, and the functions of a unified_planning"
                " problem move by actions only; end what moves it, or assign it a value without a rate"
            )
        assert function.function_value is not None
        return self._formulas.number(function.function_value)

    # -- the metric -------------------------------------------------------------------------------------------

    def _metric(self, metric: Expression) -> Any:
        expression = from_composite(metric.expr)
        if any(key(function.name) == "is-violated" for function in atoms_of(expression)):
            raise InvalidKnowledge("(is-violated ...) counts preferences, and unified_planning has none")
        metrics = self._up.model.metrics
        minimize = metric.optimization == "minimize"
        if minimize and len(expression) == 1 and expression[0] is SpecialType.TOTAL_TIME:
            return metrics.MinimizeMakespan(self._environment)
        kind = metrics.MinimizeExpressionOnFinalState if minimize else metrics.MaximizeExpressionOnFinalState
        return kind(self._formulas.expression(expression), self._environment)


def _subject(item: KnowledgeItem) -> tuple[object, ...]:
    """Return the subject of an item: a fact, a function, or the item itself."""
    return (item.knowledge_type, *item.key) if isinstance(item, Fact | Function) else (str(item),)


def _goal_condition(goal: Goal, domain: Domain) -> formulas.Formula:
    if isinstance(goal, Condition):
        return parse_condition(goal.text, domain)
    return condition_of(goal, domain)
