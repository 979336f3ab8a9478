"""Finds invariants that are expected to break: simulates an action from its start to its expected end (rule O6)."""

from collections import defaultdict
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import cached_property

from kbstore.errors import InvalidKnowledge, NotLinear
from kbstore.evaluation.interpretation import Arguments, Number, Span
from kbstore.evaluation.snapshot import is_of
from kbstore.evaluation.when import truths
from kbstore.messages import KnowledgeType, Truth
from kbstore.model.domain import Domain
from kbstore.model.formulas import Formula, Timing
from kbstore.model.lifespans import Lifespan, joined
from kbstore.model.timelines import Identity, Role, StateRow, Value, atom_key
from kbstore.names import key
from kbstore.planning.effects import Effects
from kbstore.planning.grounding import GroundAction
from kbstore.planning.rates import RunningAction
from kbstore.planning.simulator import Simulator, TimelineEvent

Break = tuple[Formula, Truth, int]
"""An over-all condition that is expected not to be true, its truth then, and the time from which on."""


def expected_breaks(
    action: GroundAction,
    entry: RunningAction,
    at_start: Effects,
    project: Callable[[], Simulator],
    *,
    force: bool = False,
) -> list[Break]:
    """Return the over-all conditions of an action that are expected to break before its expected end (rule O6).

    `project` returns a simulator of the state before the start, at the time of the start. Raises `NotLinear` where a
    break cannot be decided; with `force` such a condition is unknown from the start on. Conditions that processes or
    events may change are left out (rule P4).
    """
    start, end = entry.run.started, entry.run.expected_end
    conditions = action.conditions(Timing.OVER_ALL)
    if not conditions or start >= end:
        return []
    simulator = project()
    domain = simulator.domain
    assert domain is not None
    unwritten = simulator.begin(entry, at_start)
    rows = [*simulator.rows, *unwritten]
    events = list(simulator.advance(end - 1))
    if not events and not any(row[0].kind is KnowledgeType.FUNCTION and row[2][3] for row in rows):
        return []
    trajectory = ExpectedTrajectory((start, end), rows, events, domain, simulator.use_unknowns)
    found: list[Break] = []
    for condition in conditions:
        try:
            pieces = truths(condition, trajectory, duration=entry.run.seconds)
        except InvalidKnowledge:
            continue
        except NotLinear:
            if not force:
                raise
            pieces = [(start, end, Truth.UNKNOWN)]
        broken = next(((since, truth) for since, _, truth in pieces if truth is not Truth.TRUE), None)
        if broken is not None:
            found.append((condition, broken[1], broken[0]))
    return found


class ExpectedTrajectory:
    """The expected trajectory over a span (a `Trajectory`): the rows at its beginning, and the events within it."""

    def __init__(
        self,
        span: Span,
        rows: Iterable[StateRow],
        events: Iterable[TimelineEvent],
        domain: Domain,
        use_unknowns: bool,
    ) -> None:
        self.span = span
        self.domain = domain
        self.use_unknowns = use_unknowns
        changes: dict[Identity, list[tuple[int, Value | None]]] = defaultdict(list)
        for timeline, since, value in rows:
            changes[timeline.identity].append((since, value))
        for event in events:
            changes[event.timeline.identity].append((event.time, event.value))
        self._pieces: dict[Identity, list[tuple[int, int, Value, int]]] = {}
        for identity, line in changes.items():
            ends = [min(t, span[1]) for t, _ in line[1:]] + [span[1]]
            self._pieces[identity] = [
                (max(t, span[0]), end, value, t)
                for (t, value), end in zip(line, ends, strict=True)
                if value is not None and end > max(t, span[0])
            ]

    def signs(self, name: str, arguments: Arguments) -> Sequence[tuple[int, int, bool]]:
        """The pieces in which one fact is asserted or denied, each with its sign."""
        return self._signs(Identity(Role.STATE, KnowledgeType.FACT, atom_key((name, *arguments))))

    def all_signs(self, name: str) -> Mapping[Arguments, Sequence[tuple[int, int, bool]]]:
        """The same for every fact of a predicate."""
        return {
            tuple(identity.key.split(" ")[1:]): self._signs(identity)
            for identity in self._pieces
            if identity[:2] == (Role.STATE, KnowledgeType.FACT) and identity.key.split(" ")[0] == name
        }

    def numbers(self, name: str, arguments: Arguments) -> Sequence[tuple[int, int, Number]]:
        """The pieces in which one numeric function is defined."""
        identity = Identity(Role.STATE, KnowledgeType.FUNCTION, atom_key((name, *arguments)))
        return [(s, e, Number(value[1], value[3], since)) for s, e, value, since in self._pieces.get(identity, ())]

    def lifespans(self, types: Iterable[str]) -> Mapping[str, Sequence[Span]]:
        """The objects that exist somewhere in the span and are of one of the types, with their lifespans."""
        wanted = list(types)
        found = {
            name: [(start, end) for start, end, kind in pieces if is_of(self.domain, kind, wanted)]
            for name, pieces in self._objects.items()
        }
        return {name: spans for name, spans in found.items() if spans}

    def lifespan(self, name: str) -> Sequence[tuple[int, int, str]]:
        """Return the spans in which an object exists, each with its type; a constant exists for the whole span."""
        return self._objects.get(name, [])

    @cached_property
    def _objects(self) -> dict[str, Sequence[tuple[int, int, str]]]:
        found: dict[str, Sequence[tuple[int, int, str]]] = {
            name: [(*self.span, type_name)] for name, type_name in self.domain.constant_types.items()
        }
        for identity, pieces in self._pieces.items():
            if identity.kind is KnowledgeType.INSTANCE and identity.key not in found:
                existences = (Lifespan(s, e, key(value[1])) for s, e, value, _ in pieces if not value[0])
                found[identity.key] = joined(existences)
        return found

    def _signs(self, identity: Identity) -> list[tuple[int, int, bool]]:
        return [(start, end, not value[0]) for start, end, value, _ in self._pieces.get(identity, ())]
