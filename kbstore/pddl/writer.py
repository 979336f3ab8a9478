"""Writes problems as PDDL text, which reads back to an equal state (rules P2 and O4)."""

from collections.abc import Container, Iterable, Iterator, Sequence
from typing import Protocol

from kbstore.clock import SECOND
from kbstore.messages import Expression, Fact, Function, Goal, Inequality, Instance, KnowledgeItem, format_number
from kbstore.model.domain import ROOT_TYPE, Domain
from kbstore.model.results import Run
from kbstore.names import key
from kbstore.pddl.parse import is_initial
from kbstore.pddl.strict_names import identifier, is_strict

_NAMES_PER_LINE = 10


class StateLike(Protocol):
    """The state that a problem is written from."""

    @property
    def at(self) -> int:
        """Its time, in nanoseconds."""

    @property
    def name(self) -> str:
        """The name of the knowledge base."""

    @property
    def domain(self) -> Domain | None:
        """The domain at that time."""

    @property
    def instances(self) -> Sequence[Instance]:
        """The objects, without constants."""

    @property
    def facts(self) -> Sequence[Fact]:
        """The facts of both signs."""

    @property
    def functions(self) -> Sequence[Function]:
        """The numeric functions with their values."""

    @property
    def inequalities(self) -> Sequence[Inequality]:
        """The recorded inequalities."""

    @property
    def metric(self) -> Expression | None:
        """The metric."""

    @property
    def goals(self) -> Sequence[Goal]:
        """The parts of the goal."""

    @property
    def constraints(self) -> Sequence[str]:
        """The trajectory constraints, and the parts of the initial state that are stored as text, in PDDL."""

    @property
    def timed_constraints(self) -> Sequence[tuple[int, str]]:
        """The parts of the initial state that are stored as text and belong to later times, each with its time."""

    @property
    def timed_knowledge(self) -> Sequence[KnowledgeItem]:
        """The items that take effect later, each at its `initial_time`."""

    @property
    def running(self) -> Sequence[Run]:
        """The actions that run."""

    @property
    def end_effects(self) -> Sequence[tuple[int, KnowledgeItem, Run]]:
        """The expected changes at the ends of running actions: time, item, run."""


def write_problem(state: StateLike, *, explicit_negatives: bool = False) -> str:
    """Write the planning problem of a state.

    Numbers are exact and have no exponent. Timed knowledge, and the end effects of what runs, are timed-initial
    literals and fluents in seconds from the state's time. What PDDL cannot express (rates, scheduled objects and facts
    about them, recorded inequalities) is written as comments; explicit negatives are left out unless asked for.
    """
    lines = [
        f"(define (problem {_problem_name(state.name)})",
        f"  (:domain {state.domain.name if state.domain else 'unknown'})",
        "  (:objects",
        *_objects(state.instances),
        "  )",
        "  (:init",
        *(f"    {fact}" for fact in state.facts if explicit_negatives or not fact.is_negative),
        *_functions(state.functions),
        *(f"    {text}" for text in state.constraints if is_initial(text)),
        *_timed(state),
        *(f"    (at {_seconds(t - state.at)} {text})" for t, text in state.timed_constraints),
        *_running(state),
        *_comments("recorded, which PDDL cannot say: ", state.inequalities),
        "  )",
        *_section("goal", [str(goal) for goal in state.goals], always=True),
        *_section("constraints", [text for text in state.constraints if not is_initial(text)]),
    ]
    if state.metric is not None:
        lines.append(f"  (:metric {state.metric.optimization or 'minimize'} {state.metric.expr})")
    return "\n".join([*lines, ")", ""])


def write_domain(domain: Domain) -> str:
    """Write the domain as it was loaded."""
    return domain.source


def _problem_name(name: str) -> str:
    """Return the name of the knowledge base, as far as it can be a name in PDDL."""
    return name if is_strict(name) else identifier(name) or "problem"


def _objects(instances: Iterable[Instance]) -> Iterator[str]:
    """Write the objects by type; if none has a type, their names alone, which untyped domains expect.

    A name that begins or ends with '-' is on a line of its own, where it cannot be read as the mark before a type.
    """
    by_type: dict[str, list[str]] = {}
    for instance in instances:
        by_type.setdefault(instance.instance_type or ROOT_TYPE, []).append(instance.instance_name)
    dashed = {name for names in by_type.values() for name in names if name[:1] == "-" or name[-1:] == "-"}
    untyped = by_type.keys() <= {ROOT_TYPE} and not dashed
    for type_name, names in by_type.items():
        plain = [name for name in names if name not in dashed]
        lines = [plain[start : start + _NAMES_PER_LINE] for start in range(0, len(plain), _NAMES_PER_LINE)]
        for line in (*lines, *([name] for name in names if name in dashed)):
            yield f"    {' '.join(line)}" + ("" if untyped else f" - {type_name}")


def _functions(functions: Iterable[Function]) -> Iterator[str]:
    for function in functions:
        yield f"    {function}"
        if function.rate:
            yield f"    ; {function.atom} changes by {format_number(function.rate)} per second"


def _timed(state: StateLike) -> Iterator[str]:
    declared = _declared(state)
    for item in state.timed_knowledge:
        yield from _timed_line(item, item.initial_time - state.at, declared if state.domain else None)
        if isinstance(item, Instance) and not item.is_negative:
            name = key(item.instance_name)
            if declared.get(name) != key(item.instance_type):
                # from then on it is another object than the one that the problem declares
                declared.pop(name, None)


def _declared(state: StateLike) -> dict[str, str]:
    """Return the types of the objects that the problem declares, and of constants; all as keys."""
    types = {key(instance.instance_name): key(instance.instance_type) for instance in state.instances}
    return types | (state.domain.constant_types if state.domain else {})


def _timed_line(item: KnowledgeItem, offset: int, declared: Container[str] | None) -> Iterator[str]:
    """Write a timed literal or fluent, or else a comment. Without a domain, objects need not be `declared`."""
    seconds = _seconds(max(0, offset))
    if isinstance(item, Fact | Function) and (declared is None or all(key(a) in declared for a in item.arguments)):
        yield f"    (at {seconds} {item})"
        if isinstance(item, Function) and item.rate:
            yield f"    ; from then on, {item.atom} changes by {format_number(item.rate)} per second"
    else:
        yield from _comments(f"at {seconds}, which PDDL cannot say: ", [item])


def _running(state: StateLike) -> Iterator[str]:
    """Write the end effects of each action that runs, after a comment that names it (rule O4)."""
    declared = _declared(state) if state.domain else None
    for run in state.running:
        past, left = state.at - run.started, run.expected_end - state.at
        end = f"its end is expected in {_seconds(left)} s" if left > 0 else f"its end is overdue by {_seconds(-left)} s"
        yield f"    ; {run.action} has been running for {_seconds(max(0, past))} s, {end}"
        for time, item, owner in state.end_effects:
            if owner == run:
                yield from _timed_line(item, time - state.at, declared)


def _comments(label: str, items: Iterable[KnowledgeItem]) -> Iterator[str]:
    return (f"    ; {label}{item}" for item in items)


def _section(keyword: str, parts: Sequence[str], *, always: bool = False) -> Iterator[str]:
    """Write a section with one condition: the conjunction of its parts."""
    if len(parts) == 1:
        yield f"  (:{keyword} {parts[0]})"
    elif parts or always:
        yield f"  (:{keyword} (and" + ("" if parts else "))")
        yield from (f"    {part}" for part in parts)
        if parts:
            yield "  ))"


def _seconds(nanoseconds: int) -> str:
    """Write nanoseconds as seconds, in decimals, exact to the nanosecond."""
    whole, rest = divmod(nanoseconds, SECOND)
    return f"{whole}.{rest:09d}".rstrip("0").rstrip(".")
