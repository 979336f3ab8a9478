"""Executes operators in a transaction: checks them, records their effects, and starts and ends runs (O1 to O3)."""

from collections.abc import Callable, Sequence
from dataclasses import replace

from kbstore.clock import SECOND, DurationLike, isoformat
from kbstore.errors import DivisionByZero, HistoryUnavailable, InvalidKnowledge, NotApplicable, UndefinedFunction
from kbstore.evaluation import conditions
from kbstore.evaluation.interpretation import Interpretation
from kbstore.evaluation.snapshot import Snapshot
from kbstore.messages import AssignOp, KnowledgeType, Truth
from kbstore.model.domain import Domain
from kbstore.model.formulas import Atom, Defined, Formula, Timing
from kbstore.model.results import Applicability, FailingCondition, Run
from kbstore.model.timelines import EndCause, Role, atom_key
from kbstore.names import key
from kbstore.pddl.printer import condition_text
from kbstore.planning import applicability as planning
from kbstore.planning import effects, start_conditions
from kbstore.planning.durations import (
    Duration,
    Failing,
    chosen_duration,
    failing_constraints,
    fixed_duration,
    given_duration,
)
from kbstore.planning.effects import Effects, NumericChange
from kbstore.planning.foresight import Break, expected_breaks
from kbstore.planning.grounding import GroundAction, ground
from kbstore.planning.rates import RunningAction, is_moving, rates, value_at_end
from kbstore.reading.explanation import Explained
from kbstore.reading.state import State
from kbstore.storage.records import RowChanges, RunRow
from kbstore.writing.change_set import ChangeSet
from kbstore.writing.formulas import canonical_term
from kbstore.writing.handlers import Handlers

_Runs = tuple[list[RunningAction], int, list[RunningAction], list[tuple[RunningAction, str]]]


class ActionExecutor:
    """The durative actions that run, as a transaction leaves them.

    Its lists are replaced and never changed, so that states and copies keep theirs.

    Attributes:
        running: what runs.
        running_before: what ran before the transaction.
        last_run: the number of the last run.
    """

    def __init__(self, change_set: ChangeSet, running: list[RunningAction], last_run: int) -> None:
        self._change_set = change_set
        self.running = self.running_before = running
        self.last_run = last_run
        self._started: list[RunningAction] = []
        self._ended: list[tuple[RunningAction, str]] = []

    @property
    def changes(self) -> int:
        """The number of runs that begin and end."""
        return len(self._started) + len(self._ended)

    @property
    def is_idle(self) -> bool:
        """Whether nothing runs, and nothing ran before the transaction."""
        return not (self.running or self.running_before)

    def copy(self) -> _Runs:
        """Return a copy of the mutable parts, for `restore`."""
        return self.running, self.last_run, self._started, self._ended

    def restore(self, copy: _Runs) -> None:
        """Undo the changes since the copy was made."""
        self.running, self.last_run, self._started, self._ended = copy

    # -- operators --------------------------------------------------------------------------------------------

    def apply(self, state: State, handlers: Handlers, operator: str, arguments: Sequence[str]) -> None:
        """Apply an instantaneous action. Raises `NotApplicable`."""
        action = _grounded(state.domain, state.snapshot, operator, arguments)
        if action.action.durative:
            raise NotApplicable(f"{action} takes time; start() it, and end() it when it is done")
        at_start = _at_start(state, action)
        _refuse(state, action, planning.unsatisfied(action, state.snapshot, at_start=at_start))
        self._carry_out(handlers, at_start, state.snapshot)

    def start(
        self,
        state: State,
        handlers: Handlers,
        operator: str,
        arguments: Sequence[str],
        duration: DurationLike | None,
        force: bool,
    ) -> Run:
        """Start a durative action; `force` overrules constraints on its duration and expected breaks (O6, O7).

        Raises `NotApplicable` if it runs already, if a condition does not hold, or if it would break an invariant.
        """
        action = _grounded(state.domain, state.snapshot, operator, arguments)
        if not action.action.durative:
            raise NotApplicable(f"{action} takes no time; apply() does the whole of it")
        world = state.snapshot
        length = chosen_duration(action, world, None if duration is None else given_duration(duration))
        self._refuse_running(action)
        seconds = length.seconds
        forced = failing_constraints(action, Timing.AT_START, world, seconds) if force else []
        at_start = _at_start(state, action, duration=seconds, force=force)
        _refuse(state, action, planning.unsatisfied(action, world, duration=seconds, at_start=at_start, force=force))
        remembered = frozenset[str]().union(
            *(
                start_conditions.remembered(action, timing, world, duration=seconds)
                for timing in (Timing.OVER_ALL, Timing.AT_END)
            )
        )
        run = self._next_run(handlers, action, length)
        breaks = expected_breaks(action, RunningAction(run, remembered), at_start, state.projection, force=force)
        if breaks and not force:
            raise NotApplicable(_refusal(action, _foreseen(breaks)))
        overruled = [*(condition for condition, _ in forced), *(condition for condition, _, _ in breaks)]
        run = replace(run, forced=tuple(map(condition_text, overruled)))
        entry = RunningAction(run, remembered)
        self._carry_out(handlers, at_start, state.snapshot)
        if state.domain is not None and is_moving(run.operator, state.domain):
            # raises an error if a rate is not linear
            after = effects.StateAfter(world, at_start.written(state.domain))
            rates([*self.running, entry], after, state.projection().moving())
        self._begin(entry)
        return run

    def end(self, state: State, handlers: Handlers, run: Run) -> Applicability:
        """End a durative action, and return the at-end conditions and constraints that fail.

        Raises `NotApplicable` if it does not run, or its effects cannot be computed.
        """
        entry = self._running(run)
        try:
            action = _grounded(state.domain, state.snapshot, entry.run.operator, entry.run.arguments)
        except InvalidKnowledge as error:
            raise NotApplicable(f"{entry.run} cannot end: {error}; abort() it") from error
        world, seconds = self._stopped(entry, handlers, state.snapshot), entry.run.seconds
        failing = failing_constraints(action, Timing.AT_END, world, seconds)
        failing += planning.failing(action, Timing.AT_END, world, duration=seconds)
        try:
            at_end = effects.evaluate(action, Timing.AT_END, world, duration=seconds, remembered=entry.remembered)
            self._stop(entry, "ended")
            self._carry_out(handlers, at_end, world)
        except (UndefinedFunction, DivisionByZero, InvalidKnowledge) as error:
            raise NotApplicable(f"{action} cannot end: {error}; mend the state, or abort() it") from error
        return _explained(state, failing)

    def report_start(
        self,
        state: State,
        handlers: Handlers,
        operator: str,
        arguments: Sequence[str],
        duration: DurationLike | None,
    ) -> Run:
        """Record that an action has started elsewhere: conditions are not evaluated, and effects not carried out."""
        action = _grounded(state.domain, state.snapshot, operator, arguments)
        self._refuse_running(action)
        try:
            length = chosen_duration(action, state.snapshot, None if duration is None else given_duration(duration))
        except (UndefinedFunction, DivisionByZero, InvalidKnowledge):
            # its duration is unknown: as 0, the run is overdue from its start on
            length = Duration(0.0, 0)
        entry = RunningAction(self._next_run(handlers, action, length))
        self._begin(entry)
        return entry.run

    def report_end(self, run: Run) -> None:
        """Record that an action has ended elsewhere; effects are not carried out."""
        self._stop(self._running(run), "ended")

    def abort(self, run: Run) -> None:
        """Abort a durative action."""
        self._stop(self._running(run), "aborted")

    def abort_with(self, name: str) -> None:
        """Abort the runs of an object that is removed (rule C12)."""
        for entry in self.running:
            if name in map(key, entry.run.arguments):
                self._stop(entry, "aborted")

    def abort_all(self) -> None:
        """Abort everything that runs."""
        for entry in self.running:
            self._stop(entry, "aborted")

    def _stopped(self, entry: RunningAction, handlers: Handlers, world: Snapshot) -> Interpretation:
        """Return the state in which a run ends.

        At its expected end it has moved numbers for exactly ``?duration``, which nanoseconds only approximate (O7).
        """
        run = entry.run
        if self._change_set.now != run.expected_end or not is_moving(run.operator, world.domain):
            return world
        exact: list[NumericChange] = []
        for function, added in rates([entry], world).items():
            row = world.row(KnowledgeType.FUNCTION, atom_key((function.name, *function.arguments)))
            if row is not None and not _is_sensed(world, function):
                number = value_at_end(row[2], row[1], added or 0.0, run)
                exact.append(NumericChange(function, AssignOp.ASSIGN, number))
                state = handlers.resolver.effect_atom(KnowledgeType.FUNCTION, function)
                self._change_set.put(state, (False, number, *row[2][2:]), self._change_set.now)
        return effects.StateAfter(world, Effects(changes=tuple(exact)))

    def _begin(self, entry: RunningAction) -> None:
        self.last_run = entry.run.number
        self.running = [*self.running, entry]
        self._started = [*self._started, entry]

    def _stop(self, entry: RunningAction, outcome: str) -> None:
        self.running = [other for other in self.running if other is not entry]
        if entry in self._started:
            self._started = [other for other in self._started if other is not entry]
        else:
            self._ended = [*self._ended, (entry, outcome)]

    def _running(self, run: Run) -> RunningAction:
        if not isinstance(run, Run):
            raise InvalidKnowledge(
                f"{run!r:.80} is not a run; give what start() returned, or one of kb.state().running"
            )
        for entry in self.running:
            if entry.run.number == run.number:
                return entry
        raise NotApplicable(f"{run.action} does not run; it has ended or was aborted")

    def _refuse_running(self, action: GroundAction) -> None:
        wanted = [key(name) for name in (action.action.name, *action.arguments)]
        for entry in self.running:
            if [key(name) for name in (entry.run.operator, *entry.run.arguments)] == wanted:
                raise NotApplicable(f"{action} runs already, since {isoformat(entry.run.started)}; end it first")

    def _next_run(self, handlers: Handlers, action: GroundAction, length: Duration) -> Run:
        return Run(
            action.action.name,
            tuple(canonical_term(handlers.resolver, name) for name in action.arguments),
            self._change_set.now,
            length.nanoseconds,
            self.last_run + 1,
            None if length.seconds == length.nanoseconds / SECOND else length.seconds,
        )

    # -- effects ----------------------------------------------------------------------------------------------

    def _carry_out(self, handlers: Handlers, found: Effects, world: Interpretation) -> None:
        """Record the effects of one time, all of which were evaluated on `world`, the state before (rule O2).

        Effects on sensed symbols are not recorded (rule O8).
        """
        change_set, now, resolve = self._change_set, self._change_set.now, handlers.resolver.effect_atom
        functions = {change.function for change in found.changes}
        for kind, touched in ((KnowledgeType.FACT, {*found.deletes, *found.adds}), (KnowledgeType.FUNCTION, functions)):
            change_set.load(Role.STATE, kind, {atom_key((atom.name, *atom.arguments)) for atom in touched})
            change_set.load(Role.STATE, KnowledgeType.INSTANCE, {name for atom in touched for name in atom.arguments})

        def own_rate(function: Atom) -> float:
            value = resolve(KnowledgeType.FUNCTION, function).value
            return 0.0 if value is None else value[2]

        for kind, atom, value in effects.outcome(found, world, own_rate):
            timeline_state = resolve(kind, atom)
            if _is_sensed(world, atom):
                continue
            if value is not None:
                change_set.put(timeline_state, value, now)
            elif timeline_state.value is not None:
                change_set.take(timeline_state, now, EndCause.REMOVED)

    def write(self, changes: RowChanges) -> None:
        """Add the runs that begin and end to what a transaction writes."""
        for run, remembered in self._started:
            changes.runs.append(
                RunRow(
                    run.number,
                    run.operator,
                    run.arguments,
                    run.started,
                    run.duration,
                    run.seconds,
                    remembered,
                    run.forced,
                )
            )
        changes.ended_runs += [(entry.run.number, entry.run.started, outcome) for entry, outcome in self._ended]
        changes.last_run = self.last_run
        changes.changes += self.changes


def _is_sensed(world: Interpretation, atom: Atom) -> bool:
    return world.domain is not None and atom.name in world.domain.sensed


def applicability(
    state: Explained,
    read_state: Callable[[], State],
    operator: str,
    arguments: Sequence[str],
    duration: DurationLike | None = None,
) -> Applicability:
    """Return whether an operator is applicable in a state, and the failing conditions, each with since when (O1).

    `read_state` is called only if invariants have to be checked against what is expected during the run.
    """
    world = state.snapshot
    action = _grounded(state.domain, world, operator, arguments)
    if duration is None:
        failing = planning.unsatisfied(action, world)
        length = None if failing or not action.action.durative else fixed_duration(action, world)
    elif not action.action.durative:
        raise InvalidKnowledge(f"{action} takes no time; ask for it without a duration")
    else:
        length = chosen_duration(action, world, given_duration(duration))
        failing = planning.unsatisfied(action, world, duration=length.seconds)
    if failing:
        return _explained(state, failing)
    if length is None:
        return Applicability([])
    seconds = length.seconds
    remembered = start_conditions.remembered(action, Timing.OVER_ALL, world, duration=seconds)
    at_start = effects.evaluate(action, Timing.AT_START, world, duration=seconds)
    run = RunningAction(
        Run(action.action.name, action.arguments, world.time, length.nanoseconds, 0, seconds), remembered
    )
    return Applicability(_foreseen(expected_breaks(action, run, at_start, lambda: read_state().projection())))


def _foreseen(breaks: Sequence[Break]) -> list[FailingCondition]:
    return [_failing(condition, since, truth) for condition, truth, since in breaks]


def _at_start(state: State, action: GroundAction, *, duration: float | None = None, force: bool = False) -> Effects:
    """Evaluate the at-start effects of an action. Raises `NotApplicable` if its at-start conditions do not hold.

    Raises `UndefinedFunction` or `DivisionByZero` if an effect reads an undefined function or divides by zero.
    """
    world = state.snapshot
    failing = planning.failing(action, Timing.AT_START, world, duration=duration)
    if duration is not None and not force:
        failing += failing_constraints(action, Timing.AT_START, world, duration)
    if failing:
        _refuse(state, action, planning.unsatisfied(action, world, duration=duration, force=force))
    return effects.evaluate(action, Timing.AT_START, world, duration=duration)


def _explained(state: Explained, failing: Sequence[Failing]) -> Applicability:
    return Applicability([_failing(condition, _since(state, condition), truth) for condition, truth in failing])


def _failing(condition: Formula, since: int | None, truth: Truth) -> FailingCondition:
    return FailingCondition(condition_text(condition), since, truth, isinstance(condition, Defined))


def _since(state: Explained, condition: Formula) -> int | None:
    try:
        if conditions.truth(condition, state.snapshot) is Truth.TRUE:
            # an over-all condition that holds now: the action's own at-start effects will break it
            return state.at
        return state.explain(condition).since
    except HistoryUnavailable:
        # it has failed since before the history in the store
        return None
    except InvalidKnowledge:
        # it refers to ?duration, so the state alone does not decide it
        return None


def _grounded(domain: Domain | None, world: Interpretation, operator: str, arguments: Sequence[str]) -> GroundAction:
    if domain is None:
        raise InvalidKnowledge(f"({operator} ...) needs a domain that declares it; load one first")
    return ground(domain, operator, tuple(arguments), world)


def _refuse(state: State, action: GroundAction, failing: Sequence[Failing]) -> None:
    """Raise `NotApplicable`, with each condition that fails and since when, if there are any."""
    if failing:
        raise NotApplicable(_refusal(action, _explained(state, failing).failing))


def _refusal(action: GroundAction, failing: Sequence[FailingCondition]) -> str:
    reasons = "\n".join(f"  - {condition}" for condition in failing)
    return f"{action} is not applicable:\n{reasons}"
