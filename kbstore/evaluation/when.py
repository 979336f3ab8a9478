"""Computes when a condition is true over a span, exact to the nanosecond (rule Q4).

The truth of each part of the condition over time is a signal (`kbstore.evaluation.signals`); signals are combined in
sweeps. The answer agrees with `kbstore.evaluation.conditions.truth` at every nanosecond.
"""

from collections.abc import Iterator, Mapping, Sequence

from kbstore.evaluation import signals
from kbstore.evaluation.evaluator import Evaluation
from kbstore.evaluation.interpretation import Arguments, Trajectory
from kbstore.evaluation.intervals import Intervals
from kbstore.evaluation.joins import Guard, Relation, assignments, guards, is_variable
from kbstore.evaluation.leaf_signals import LeafSignals
from kbstore.evaluation.rules import program
from kbstore.evaluation.signals import Signal
from kbstore.evaluation.substitution import ArgumentPattern, Bindings, keyed, pattern, term
from kbstore.evaluation.trajectory_views import CachedTrajectory, TrajectoryAt
from kbstore.evaluation.wellformed import check
from kbstore.messages.enums import Truth
from kbstore.model.expressions import atoms_of
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
    Preference,
    Same,
    Truism,
    Types,
    Variables,
    variables_of,
    walk,
)
from kbstore.names import is_wildcard, key


def intervals(
    condition: Formula, trajectory: Trajectory, bindings: Mapping[str, str] = {}, *, duration: float | None = None
) -> Intervals:
    """Return the maximal half-open intervals within the trajectory's span in which a condition is true.

    The condition has been checked (`kbstore.evaluation.wellformed.check`); symbols that the trajectory's domain does
    not know assert nothing (rule D4). Raises `InvalidKnowledge` and `NotLinear` as `truths` does.
    """
    if trajectory.span[0] >= trajectory.span[1]:
        return Intervals()
    signal = SignalEvaluator(trajectory, duration=duration).of(condition, keyed(bindings))
    pieces = signals.pieces(signal, trajectory.span)
    return Intervals((start, end) for start, end, truth in pieces if truth is Truth.TRUE)


def truths(
    condition: Formula, trajectory: Trajectory, bindings: Mapping[str, str] = {}, *, duration: float | None = None
) -> list[tuple[int, int, Truth]]:
    """Return the truth of a condition throughout the trajectory's span, as maximal pieces in order.

    Raises:
        UnknownSymbol: a predicate, function or type that the domain does not know.
        InvalidKnowledge: the condition has no meaning, or needs numbers of absurd size to be decided exactly.
        NotLinear: a comparison is not linear in time somewhere in the span.
    """
    check(condition, trajectory.domain, bindings, duration=duration)
    if trajectory.span[0] >= trajectory.span[1]:
        return []
    return signals.pieces(
        SignalEvaluator(trajectory, duration=duration).of(condition, keyed(bindings)), trajectory.span
    )


class SignalEvaluator:
    """Computes the signals of conditions over one trajectory; the conditions have been checked (`check`)."""

    def __init__(self, trajectory: Trajectory, *, duration: float | None = None) -> None:
        self._trajectory = CachedTrajectory(trajectory)
        self._start = trajectory.span[0]
        self._leaves = LeafSignals(self._trajectory, duration)
        self._derived_names = frozenset(trajectory.domain.rules) if trajectory.domain else frozenset[str]()
        self._derived: dict[str, dict[Arguments, Signal]] = {}
        self._rows: dict[str, Relation] = {}

    def of(self, condition: Formula, bindings: Bindings) -> Signal:
        """Return the signal of a condition, with objects for its free variables."""
        for node, _, scope in walk(condition, {}):
            # a predicate with a quantified variable is read for many objects: one read of everything is cheaper
            if isinstance(node, Atom) and any(is_variable(a, scope) for a in node.arguments):
                self._trajectory.all_signs(key(node.name))
        return self._signal(condition, bindings)

    def _signal(self, condition: Formula, bindings: Bindings) -> Signal:
        match condition:
            case Atom(name):
                if key(name) in self._derived_names:
                    return self._derived_atom(key(name), pattern(condition, bindings))
                return self._leaves.fact(condition, bindings)
            case Not(part):
                return signals.inverted(self._signal(part, bindings))
            case And(parts):
                return self._all([self._signal(part, bindings) for part in parts])
            case Or(parts):
                return self._any([self._signal(part, bindings) for part in parts])
            case Imply(premise, conclusion):
                return self._any(
                    [signals.inverted(self._signal(premise, bindings)), self._signal(conclusion, bindings)]
                )
            case Exists() | Forall():
                return self._quantified(condition, bindings)
            case Comparison():
                return self._leaves.comparison(condition, bindings)
            case Same(left, right):
                return self._leaves.constant(Truth.of(term(left, bindings) == term(right, bindings)))
            case Defined(function):
                return self._leaves.defined(function, bindings)
            case IsA(name, type_name):
                return self._leaves.is_a(term(name, bindings), (key(type_name or "object"),))
            case Preference(_, part):
                return self._signal(part, bindings)
            case Truism():
                return self._leaves.constant(Truth.TRUE)

    def _all(self, parts: Sequence[Signal]) -> Signal:
        return signals.conjunction(parts, self._start)

    def _any(self, parts: Sequence[Signal]) -> Signal:
        return signals.disjunction(parts, self._start)

    def _quantified(self, quantified: Exists | Forall, bindings: Bindings) -> Signal:
        """Return the signal of a quantifier: `Forall` has no counterexample; objects count only while they exist."""
        variables, witness = variables_of(quantified.parameters), isinstance(quantified, Exists)
        guarded = [guard for atom in guards(quantified.part, witness) for guard in self._guard(atom)]
        instances = []
        for found in assignments(variables, guarded, bindings, self._leaves.objects):
            signal = self._signal(quantified.part, found)
            presence = [self._leaves.presence(found[variable], types) for variable, types in variables.items()]
            instances.append(self._all([signal if witness else signals.inverted(signal), *presence]))
        return self._any(instances) if witness else signals.inverted(self._any(instances))

    def _guard(self, atom: Atom) -> Iterator[Guard]:
        """Yield the rows without which an atom is false throughout the span; in an open world they cannot be listed."""
        if self._trajectory.use_unknowns:
            return
        name = key(atom.name)
        if name in self._derived_names:
            self._derived_signals(name)
        elif name not in self._rows:
            known = self._trajectory.all_signs(name).items()
            self._rows[name] = Relation(row for row, pieces in known if any(sign for _, _, sign in pieces))
        yield atom, self._rows[name]

    # -- derived predicates -----------------------------------------------------------------------------------

    def _derived_atom(self, name: str, wanted: ArgumentPattern) -> Signal:
        """Return the signal of a derived atom; it is absent while one of its objects does not exist (rule V8)."""
        signal_of = self._derived_signals(name)
        found = [signal_of[row] for row in self._rows[name].matching(wanted)]
        if self._trajectory.use_unknowns:
            exist = [self._leaves.is_a(value, ("object",)) for value in wanted if value is not None]
            matching = [self._leaves.is_a(None, types) for types in self._leaves.wild_ranges(name, wanted)]
            found.append(self._all([signals.false_else_unknown(self._all(exist)), *matching]))
        return self._any(found)

    def _derived_signals(self, name: str) -> Mapping[Arguments, Signal]:
        """Return the signals of all rows for which a derived predicate is not false throughout the span."""
        if name not in self._derived:
            rows: dict[Arguments, Signal] = {}
            before: dict[Arguments, Truth] = {}
            for t in sorted(self._turning_points(name)):
                certain, possible = Evaluation(TrajectoryAt(self._trajectory, t)).derived.relations(name)
                now = dict.fromkeys(possible, Truth.UNKNOWN) | dict.fromkeys(certain, Truth.TRUE)
                for row in before.keys() | now.keys():
                    truth = now.get(row, Truth.FALSE)
                    if t == self._start:
                        rows[row] = self._leaves.constant(truth)
                    elif truth is not before.get(row, Truth.FALSE):
                        rows.setdefault(row, self._leaves.constant(Truth.FALSE)).append((t, truth))
                before = now
            self._derived[name] = rows
            self._rows[name] = Relation(rows)
        return self._derived[name]

    def _turning_points(self, name: str) -> set[int]:
        """Return the start of the span, and each time at which something that a derived predicate reads changes."""
        domain = self._trajectory.domain
        if domain is None:
            raise ValueError("only a domain has derived predicates")
        rules = program(domain)
        reachable = rules.reachable(name)
        found = [signal for each in reachable for types in rules.ranges[each] for signal in self._presences(types)]
        for rule in (rule for each in reachable for rule in rules.rules[each]):
            for node, _, scope in walk(rule.condition, rule.variables):
                match node:
                    case Exists(parameters) | Forall(parameters):
                        found += [t for types in variables_of(parameters).values() for t in self._presences(types)]
                    case Atom():
                        found += self._fact_signals(node, scope)
                    case Comparison() | Defined() | IsA():
                        used = {
                            v: types for v, types in scope.items() if any(is_variable(a, {v}) for a in _arguments(node))
                        }
                        for bindings in assignments(used, (), {}, self._leaves.objects):
                            found.append(self._signal(node, bindings))
        return {self._start} | signals.changes(found)

    def _fact_signals(self, atom: Atom, scope: Variables) -> Iterator[Signal]:
        """Yield signals that change wherever an atom in a rule may change, for any binding of its variables."""
        name, wanted = key(atom.name), pattern(atom, {variable: variable for variable in scope})
        for argument in atom.arguments:
            if not is_wildcard(argument):
                yield self._leaves.is_a(key(argument), ("object",))
        for types in self._leaves.wild_ranges(name, wanted):
            yield from self._presences(types)
        if name not in self._derived_names:
            for row in self._trajectory.all_signs(name):
                yield self._leaves.fact(Atom(name, row), {})

    def _presences(self, types: Types) -> list[Signal]:
        return [self._leaves.presence(name, types) for name in self._leaves.objects(types)]


def _arguments(node: Comparison | Defined | IsA) -> list[str]:
    """The arguments in a leaf."""
    match node:
        case Comparison(_, left, right):
            return [argument for function in atoms_of((*left, *right)) for argument in function.arguments]
        case Defined(function):
            return list(function.arguments)
        case IsA(name):
            return [name]
