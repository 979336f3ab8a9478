"""Converts problems of unified_planning to PDDL, which is loaded like any other (rule P7)."""

import os
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from fractions import Fraction
from itertools import permutations, product
from typing import Any, NamedTuple, Protocol, cast

from kbstore.errors import InvalidKnowledge
from kbstore.interop.up_symbols import Refusals, library
from kbstore.interop.up_text import (
    decimal_text,
    effects_text,
    expression_text,
    name_of,
    number_text,
    objects_in,
    type_name,
    typed,
)
from kbstore.messages.base import format_number
from kbstore.model.domain import ROOT_TYPE
from kbstore.names import key
from kbstore.pddl.strict_names import identifier

_REQUIREMENTS = {
    "FLAT_TYPING": ":typing",
    "HIERARCHICAL_TYPING": ":typing",
    "NEGATIVE_CONDITIONS": ":negative-preconditions",
    "DISJUNCTIVE_CONDITIONS": ":disjunctive-preconditions",
    "EQUALITIES": ":equality",
    "EXISTENTIAL_CONDITIONS": ":existential-preconditions",
    "UNIVERSAL_CONDITIONS": ":universal-preconditions",
    "CONDITIONAL_EFFECTS": ":conditional-effects",
    "FORALL_EFFECTS": ":conditional-effects",
    "INT_FLUENTS": ":fluents",
    "REAL_FLUENTS": ":fluents",
    "OBJECT_FLUENTS": ":object-fluents",
    "ACTIONS_COST": ":action-costs",
    "PLAN_LENGTH": ":action-costs",
    "OVERSUBSCRIPTION": ":preferences",
    "CONTINUOUS_TIME": ":durative-actions",
    "DISCRETE_TIME": ":durative-actions",
    "DURATION_INEQUALITIES": ":duration-inequalities",
    "TIMED_EFFECTS": ":timed-initial-literals",
    "PROCESSES": ":time",
    "EVENTS": ":time",
    "TRAJECTORY_CONSTRAINTS": ":constraints",
    "STATE_INVARIANTS": ":constraints",
    "CONTINGENT": ":contingent",
}
_COST = "total-cost"


class PddlTexts(NamedTuple):
    """The texts of a domain and of a problem."""

    domain: str
    problem: str


class PlanningProblem(Protocol):
    """Structural type of a `unified_planning` Problem, for type checkers without the library."""

    @property
    def user_types(self) -> list[Any]:
        """The types of objects."""

    @property
    def timed_effects(self) -> dict[Any, list[Any]]:
        """Effects at later times."""


Source = str | os.PathLike[str]
"""The path of a PDDL file, or PDDL text."""


def sources(domain: Source | PlanningProblem | None, problem: Source | None) -> tuple[Source | None, Source | None]:
    """Return the domain and the problem to read, which may be given as one `unified_planning` Problem."""
    # compared by name, so that the library need not be imported
    names = [f"{kind.__module__}.{kind.__name__}" for kind in type(domain).__mro__]
    if "unified_planning.model.abstract_problem.AbstractProblem" not in names:
        return cast("Source | None", domain), problem
    if problem is not None:
        raise InvalidKnowledge("a unified_planning Problem has its domain in it; give it alone: kb.load(problem)")
    return pddl_of(cast("PlanningProblem", domain))


def pddl_of(problem: PlanningProblem) -> PddlTexts:
    """Write a `unified_planning` Problem as PDDL, in its own names.

    The bounds of bounded numbers are left out, as PDDL has none. Raises `InvalidKnowledge` with everything else that
    PDDL, or a knowledge base, cannot express.
    """
    up = library()
    if not isinstance(problem, up.model.Problem) or isinstance(problem, up.model.htn.HierarchicalProblem):
        raise InvalidKnowledge(f"a {type(problem).__name__} of unified_planning cannot be loaded; a Problem can")
    return _Writer(up, problem).texts()


class _Writer:
    def __init__(self, up: Any, problem: Any) -> None:
        self._up = up
        self._problem = problem
        self._refusals = Refusals()
        self._costs: dict[str, Any] | None = None
        self._preferences: list[tuple[str, Fraction]] = []
        self._goals: list[str] = []

    def texts(self) -> PddlTexts:
        problem = self._problem
        self._refuse_equal_names()
        for metric in problem.quality_metrics[:1]:
            with self._refusals.of(f"the metric {metric}"):
                self._read_metric(metric)
        if len(problem.quality_metrics) > 1:
            self._refusals.violations.append("a problem in PDDL has one metric")
        if problem.timed_goals:
            self._refusals.violations.append("a timed goal has no counterpart in PDDL")
        name = identifier(problem.name or "") or "problem"
        constants = self._constants()
        domain = "\n".join(["(define (domain " + name + ")", *self._domain(constants), ")", ""])
        text = "\n".join([f"(define (problem {name})", f"  (:domain {name})", *self._instance(constants), ")", ""])
        self._refusals.report()
        return PddlTexts(domain, text)

    def _refuse_equal_names(self) -> None:
        """Refuse names that differ in case alone: PDDL ignores case, unified_planning does not."""
        problem = self._problem
        transitions = (*problem.actions, *problem.processes, *problem.events)
        for group in (problem.fluents, transitions, problem.all_objects, problem.user_types):
            counted = Counter(key(thing.name) for thing in group)
            self._refusals.violations += [
                f"{name} is the name of {count} things that differ in upper and lower case alone, which PDDL ignores"
                for name, count in counted.items()
                if count > 1
            ]

    # -- the domain -------------------------------------------------------------------------------------------

    def _domain(self, constants: Mapping[str, Any]) -> Iterator[str]:
        problem = self._problem
        features = problem.kind.features
        found = dict.fromkeys(word for name, word in _REQUIREMENTS.items() if name in features)
        if any(not fluent.type.is_bool_type() and not fluent.type.is_user_type() for fluent in problem.fluents):
            found[":fluents"] = None
        yield f"  (:requirements {' '.join(found or [':strips'])})"
        types = [user_type for user_type in problem.user_types if key(user_type.name) != ROOT_TYPE]
        if types:
            with self._refusals.of("the types"):
                named = [(name_of(of), name_of(of.father) if of.father else ROOT_TYPE) for of in types]
                yield f"  (:types {' '.join(f'{name} - {father}' for name, father in named)})"
        if constants:
            yield f"  (:constants {typed(constants.values())})"
        declared = {True: list[str](), False: list[str]()}
        for fluent in problem.fluents:
            with self._refusals.of(f"the fluent {fluent.name}"):
                text = f"({' '.join(filter(None, (name_of(fluent), typed(fluent.signature, '?'))))})"
                value = "" if fluent.type.is_bool_type() else f" - {_value_type(fluent.type)}"
                declared[fluent.type.is_bool_type()].append(text + value)
        if self._costs is not None:
            declared[False].append(f"({_COST}) - number")
        yield f"  (:predicates {' '.join(declared[True])})"
        if declared[False]:
            yield f"  (:functions {' '.join(declared[False])})"
        for transition in (*problem.actions, *problem.processes, *problem.events):
            with self._refusals.of(f"{type(transition).__name__} {transition.name}"):
                yield "\n".join(self._transition(transition))

    def _transition(self, transition: Any) -> Iterator[str]:
        if getattr(transition, "simulated_effect", None) or getattr(transition, "simulated_effects", None):
            raise InvalidKnowledge("a simulated effect is a function of Python, which PDDL cannot express")
        model = self._up.model
        is_durative = isinstance(transition, model.DurativeAction)
        words = {model.Process: ":process", model.Event: ":event", model.DurativeAction: ":durative-action"}
        word = next((word for kind, word in words.items() if isinstance(transition, kind)), ":action")
        cost = self._costs.get(transition.name) if self._costs else None
        increase = [] if cost is None else [f"(increase ({_COST}) {expression_text(cost)})"]
        yield f"  ({word} {name_of(transition)}"
        yield f"    :parameters ({typed(transition.parameters, '?')})"
        if is_durative:
            yield f"    :duration {_duration(transition.duration)}"
            yield f"    :condition {_and(_timed_conditions(transition.conditions))}"
            effects = [*_timed_effects(transition), *(f"(at end {text})" for text in increase)]
        else:
            yield f"    :precondition {_and(map(expression_text, transition.preconditions))}"
            effects = [*effects_text(transition.effects), *increase]
        observed = getattr(transition, "observed_fluents", ())
        if observed:
            yield f"    :observe {_and(map(expression_text, observed))}"
        yield f"    :effect {_and(effects)})"

    def _constants(self) -> Mapping[str, Any]:
        """Return the objects that actions, processes and events name; all others belong to the problem."""
        nodes: list[Any] = [] if not self._costs else [cost for cost in self._costs.values() if cost is not None]
        for transition in (*self._problem.actions, *self._problem.processes, *self._problem.events):
            if isinstance(transition, self._up.model.DurativeAction):
                nodes += [transition.duration.lower, transition.duration.upper]
                nodes += [node for conditions in transition.conditions.values() for node in conditions]
                groups = (*transition.effects.values(), *transition.continuous_effects.values())
                effects = [effect for group in groups for effect in group]
            else:
                nodes += [*transition.preconditions, *getattr(transition, "observed_fluents", ())]
                effects = transition.effects
            nodes += [node for effect in effects for node in (effect.fluent, effect.value, effect.condition)]
        return objects_in(nodes)

    # -- the problem ------------------------------------------------------------------------------------------

    def _instance(self, constants: Mapping[str, Any]) -> Iterator[str]:
        problem = self._problem
        objects = [thing for thing in problem.all_objects if thing.name not in constants]
        with self._refusals.of("the objects"):
            yield f"  (:objects {typed(objects)})"
        yield "  (:init"
        for fluent in problem.fluents:
            with self._refusals.of(f"the initial values of {fluent.name}"):
                yield from (f"    {text}" for text in self._initial(fluent))
        if self._costs is not None:
            yield f"    (= ({_COST}) 0)"
        for timing, effects in problem.timed_effects.items():
            with self._refusals.of(f"the effects at {timing}"):
                yield from (f"    {text}" for text in _timed_literals(timing, effects))
        yield from (f"    {text}" for text in self._uncertain())
        yield "  )"
        for goal in problem.goals:
            with self._refusals.of(f"the goal {goal}"):
                self._goals.append(expression_text(goal))
        yield f"  (:goal {_and(self._goals)})"
        if problem.trajectory_constraints:
            with self._refusals.of("the constraints"):
                yield f"  (:constraints {_and(map(expression_text, problem.trajectory_constraints))})"
        yield from self._metric()

    def _initial(self, fluent: Any) -> Iterator[str]:
        """Yield the values of a fluent that are not false."""
        problem = self._problem
        default = problem.fluents_defaults.get(fluent)
        explicit = {node: value for node, value in problem.explicit_initial_values.items() if node.fluent() == fluent}
        if default is not None and not default.is_false():
            make = problem.environment.expression_manager.FluentExp
            ranges = [list(problem.objects(parameter.type)) for parameter in fluent.signature]
            explicit = {make(fluent, chosen): default for chosen in product(*ranges)} | explicit
        for node, value in explicit.items():
            if fluent.type.is_bool_type():
                if value.is_true():
                    yield expression_text(node)
            elif value.is_object_exp():
                yield f"(= {expression_text(node)} {expression_text(value)})"
            else:
                yield f"(= {expression_text(node)} {decimal_text(value)})"

    def _uncertain(self) -> Iterator[str]:
        """Yield the initial constraints of a contingent problem on fluents whose values are unknown."""
        problem = self._problem
        for nodes in getattr(problem, "or_constraints", ()):
            # the library represents (unknown (p)) as (or (not (p)) (p))
            unknown = len(nodes) == 2 and any(f"(not {one})" == str(other) for one, other in permutations(nodes))
            texts = [expression_text(node) for node in nodes]
            yield f"(unknown {min(texts, key=len)})" if unknown else f"(or {' '.join(texts)})"
        for nodes in getattr(problem, "oneof_constraints", ()):
            yield f"(oneof {' '.join(map(expression_text, nodes))})"

    # -- the metric -------------------------------------------------------------------------------------------

    def _read_metric(self, metric: Any) -> None:
        problem = self._problem
        if metric.is_minimize_action_costs():
            self._costs = {action.name: metric.get_action_cost(action) for action in problem.actions}
        elif metric.is_minimize_sequential_plan_length():
            one = problem.environment.expression_manager.Int(1)
            self._costs = {action.name: one for action in problem.actions}
        elif metric.is_oversubscription():
            for number, (goal, gain) in enumerate(metric.goals.items()):
                self._goals.append(f"(preference goal-{number} {expression_text(goal)})")
                self._preferences.append((f"goal-{number}", Fraction(gain)))
        elif metric.is_temporal_oversubscription():
            raise InvalidKnowledge("goals with a time have no counterpart in PDDL")
        if self._costs is not None and problem.has_fluent(_COST):
            raise InvalidKnowledge(f"the costs of actions need a function {_COST}, but there is a fluent of that name")

    def _metric(self) -> Iterator[str]:
        for metric in self._problem.quality_metrics[:1]:
            with self._refusals.of(f"the metric {metric}"):
                if self._costs is not None:
                    yield f"  (:metric minimize ({_COST}))"
                elif metric.is_minimize_makespan():
                    yield "  (:metric minimize (total-time))"
                elif metric.is_minimize_expression_on_final_state():
                    yield f"  (:metric minimize {expression_text(metric.expression)})"
                elif metric.is_maximize_expression_on_final_state():
                    yield f"  (:metric maximize {expression_text(metric.expression)})"
                elif self._preferences:
                    # to maximize the gain is to minimize the loss
                    lost = [f"(* {number_text(gain)} (is-violated {name}))" for name, gain in self._preferences]
                    total = lost[0] if len(lost) == 1 else f"(+ {' '.join(lost)})"
                    yield f"  (:metric minimize {total})"


def _value_type(of: Any) -> str:
    return "number" if of.is_int_type() or of.is_real_type() else type_name(of)


def _and(texts: Iterable[str]) -> str:
    found = list(texts)
    return found[0] if len(found) == 1 else f"(and {' '.join(found)})" if found else "(and)"


def _duration(duration: Any) -> str:
    lower, upper = expression_text(duration.lower), expression_text(duration.upper)
    if lower == upper:
        return f"(= ?duration {lower})"
    first, last = ">" if duration.is_left_open() else ">=", "<" if duration.is_right_open() else "<="
    return f"(and ({first} ?duration {lower}) ({last} ?duration {upper}))"


def _moment(timing: Any) -> str:
    """Return the part of the action, ``start`` or ``end``."""
    if timing.delay or timing.is_global() or timing.timepoint.container is not None:
        raise InvalidKnowledge(f"{timing} is neither the start nor the end of the action, and PDDL has no other times")
    return "start" if timing.is_from_start() else "end"


def _timed_conditions(conditions: Mapping[Any, Iterable[Any]]) -> Iterator[str]:
    for interval, nodes in conditions.items():
        lower, upper = _moment(interval.lower), _moment(interval.upper)
        if lower == upper:
            words = [f"at {lower}"]
        else:
            words = ["at start"] * (not interval.is_left_open()) + ["over all"]
            words += ["at end"] * (not interval.is_right_open())
        yield from (f"({word} {expression_text(node)})" for node in nodes for word in words)


def _timed_effects(action: Any) -> Iterator[str]:
    for timing, effects in action.effects.items():
        yield from (f"(at {_moment(timing)} {text})" for text in effects_text(effects))
    for interval, effects in action.continuous_effects.items():
        if (_moment(interval.lower), _moment(interval.upper)) != ("start", "end"):
            raise InvalidKnowledge(f"a continuous effect in {interval} has no counterpart: in PDDL it lasts throughout")
        yield from effects_text(effects)


def _timed_literals(timing: Any, effects: Iterable[Any]) -> Iterator[str]:
    if not (timing.is_global() and timing.is_from_start()):
        raise InvalidKnowledge("a time in an initial state counts from the start")
    seconds = format_number(float(timing.delay))
    for effect in effects:
        if (
            effect.is_conditional()
            or effect.is_forall()
            or not effect.is_assignment()
            or not effect.value.is_constant()
        ):
            raise InvalidKnowledge(f"{effect} is not a fact or a value at a time, which an initial state is made of")
        fluent = expression_text(effect.fluent)
        if effect.fluent.type.is_bool_type():
            yield f"(at {seconds} {fluent if effect.value.is_true() else f'(not {fluent})'})"
        else:
            yield f"(at {seconds} (= {fluent} {decimal_text(effect.value)}))"
