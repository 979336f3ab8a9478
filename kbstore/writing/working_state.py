"""The state as an open transaction leaves it: the stored rows, its changes, and the rates of runs (rule O5)."""

from collections.abc import Collection

from kbstore.clock import OPEN
from kbstore.evaluation.snapshot import Snapshot, by_kind
from kbstore.messages import KnowledgeType
from kbstore.model.domain import Domain
from kbstore.model.formulas import Atom
from kbstore.model.timelines import Identity, Role, StateRow
from kbstore.planning.rates import is_moving, rates, symbols
from kbstore.planning.simulator import Simulator
from kbstore.reading.mentions import mentions
from kbstore.reading.state_data import StateData
from kbstore.storage.records import LogPosition
from kbstore.storage.repository import Repository
from kbstore.writing.action_executor import ActionExecutor
from kbstore.writing.change_set import ChangeSet


class WorkingState:
    """Reads the state at a transaction's now; `domain` is the one before the transaction."""

    def __init__(
        self,
        repository: Repository,
        change_set: ChangeSet,
        executor: ActionExecutor,
        domain: Domain | None,
        *,
        use_unknowns: bool,
    ) -> None:
        self._repository = repository
        self._change_set = change_set
        self._executor = executor
        self._domain_before = domain
        self._rates_before: dict[Atom, float | None] | None = None
        self._use_unknowns = use_unknowns

    def data(self, domain: Domain | None) -> StateData:
        """Return the current state, with the changes made so far."""
        now = self._change_set.now
        rows, pending = self._rows(domain)
        holding = list(rows.values())
        if self._moves_numbers(domain):
            simulator = self._simulator(rows, pending, domain)
            for _ in simulator.advance(now):
                pass
            holding = simulator.rows
        snapshot = Snapshot(now, by_kind(holding), domain, self._use_unknowns)
        return StateData(snapshot, list(pending.values()), self._executor.running)

    def follow_rates(self, domain: Domain | None, *, anew: bool = False) -> None:
        """Recompute the values and rates of numbers that runs move, now and at scheduled changes (rule O5).

        Nothing is read or computed if nothing that the rates depend on has changed, unless `anew` is set.
        """
        names = self._symbols(domain)
        if names and (anew or self._is_touched(names, domain)):
            self._change_set.follow(self._simulator(*self._rows(domain, names), domain).advance(OPEN))

    def _symbols(self, domain: Domain | None) -> set[str]:
        """Return the predicates and functions that matter to the rates of what runs, or ran before the transaction."""
        found: set[str] = set()
        executor = self._executor
        for version, running in ((self._domain_before, executor.running_before), (domain, executor.running)):
            if version is not None:
                for operator in {entry.run.operator for entry in running}:
                    found |= symbols(operator, version)
        return found

    def _is_touched(self, names: Collection[str], domain: Domain | None) -> bool:
        """Return whether the transaction may have changed what rates depend on."""
        return (
            domain is not self._domain_before
            or bool(self._executor.changes or self._change_set.objects_changed)
            or any(
                timeline_key.split(" ")[0] in names
                for kind in (KnowledgeType.FACT, KnowledgeType.FUNCTION)
                for timeline_key in self._change_set.group(Role.STATE, kind)
            )
        )

    def _read(self, kind: KnowledgeType, names: Collection[str] | None) -> list[StateRow]:
        """Return what holds now of a kind; with `names`, only facts and functions of these symbols, and objects."""
        now = self._change_set.now
        if names is None or kind is KnowledgeType.INSTANCE:
            return list(self._repository.state_at(kind, LogPosition(now)))
        if kind not in (KnowledgeType.FACT, KnowledgeType.FUNCTION):
            return []
        return [row for name in sorted(names) for row in self._repository.holding(Role.STATE, kind, now, name)]

    def _rows(
        self, domain: Domain | None, names: Collection[str] | None = None
    ) -> tuple[dict[Identity, StateRow], dict[tuple[Identity, int], StateRow]]:
        """Return what holds now and what is scheduled after this transaction, without the rates of runs.

        With `names`, only facts and functions of these symbols, and objects, are among what holds.
        """
        now = self._change_set.now
        position = LogPosition(now)
        rows: dict[Identity, StateRow] = {}
        pending: dict[tuple[Identity, int], StateRow] = {}
        for kind in KnowledgeType:
            rows |= {row[0].identity: row for row in self._read(kind, names)}
            pending |= {(row[0].identity, row[1]): row for row in self._repository.scheduled_at(kind, position)}
        if self._rates_before is None and self._moves_numbers(domain):
            stored = Snapshot(now, by_kind(rows.values()), self._domain_before, self._use_unknowns)
            self._rates_before = rates(self._executor.running_before, stored)
        self._change_set.overlay(rows, pending)
        return rows, pending

    def _simulator(
        self,
        rows: dict[Identity, StateRow],
        pending: dict[tuple[Identity, int], StateRow],
        domain: Domain | None,
    ) -> Simulator:
        """Return a simulator that plays forward what is scheduled, with the rates of runs."""
        added = self._rates_before
        if added is not None:
            # a number set in this transaction is defined, even if a rate that moves it has no value any more
            added = {atom: None if self._change_set.is_set(atom) else rate for atom, rate in added.items()}
        return Simulator(
            self._change_set.now,
            rows.values(),
            pending.values(),
            self._executor.running,
            domain=domain,
            use_unknowns=self._use_unknowns,
            mentions=mentions,
            recorded=True,
            added=added,
        )

    def _moves_numbers(self, domain: Domain | None) -> bool:
        """Return whether something that runs, or stops in this transaction, moves numbers."""
        executor = self._executor
        return any(is_moving(entry.run.operator, self._domain_before) for entry in executor.running_before) or any(
            is_moving(entry.run.operator, domain) for entry in executor.running
        )
