"""Computes past rates of runs, for numbers that were undefined while a run would have moved them (rules L6, L7)."""

from collections.abc import Sequence

from kbstore.clock import OPEN
from kbstore.evaluation.snapshot import Snapshot
from kbstore.messages import KnowledgeType
from kbstore.model.domain import Domain
from kbstore.model.formulas import Atom
from kbstore.model.symbols import SymbolTable
from kbstore.planning.rates import is_moving, rates
from kbstore.reading.reader import as_running
from kbstore.storage.records import LogPosition
from kbstore.storage.repository import Repository


class PastRates:
    """Computes the rates that runs added to functions, from what was believed at the time.

    `versions` are those of the domain, each with the time from which on it is in force.
    """

    def __init__(
        self, repository: Repository, versions: Sequence[tuple[int, SymbolTable]], *, use_unknowns: bool
    ) -> None:
        self._repository = repository
        self._versions = versions
        self._use_unknowns = use_unknowns

    def added(self, function: Atom, start: int, end: int) -> list[tuple[int, float]]:
        """Return what runs added to the rate of a function in ``[start, end)``: times, each with a rate per second.

        It is 0 while the rate had no value, and for a sensed function (rule O8).
        """
        runs = self._repository.runs_between(start, end)
        if not any(is_moving(row.operator, self._domain(row.started)) for row in runs):
            return [(start, 0.0)]
        first, last = (self._repository.last_number_at(t) for t in (start, end - 1))
        times = {start, *(row[1] for row in self._repository.transactions(range(first + 1, last + 1)))}
        times |= {t for row in self._repository.due_between(start, end - 1) for t in (row.initial_time, row.end_time)}
        return [(t, self._added_at(function, t)) for t in sorted(times) if start <= t < end]

    def _added_at(self, function: Atom, t: int) -> float:
        domain = self._domain(t)
        if domain is None or function.name in domain.sensed:
            return 0.0
        number = self._repository.last_number_at(t)
        position = LogPosition(t, number, number)
        parts = {kind: self._repository.state_at(kind, position) for kind in KnowledgeType}
        running = [as_running(row) for row in self._repository.running(LogPosition(t))]
        world = Snapshot(t, parts, domain, self._use_unknowns)
        return rates(running, world).get(function) or 0.0

    def _domain(self, t: int) -> Domain | None:
        ends = [start for start, _ in self._versions[1:]] + [OPEN]
        return next(
            (table.domain for (start, table), end in zip(self._versions, ends, strict=True) if start <= t < end), None
        )
