"""Parts of the state: the objects, facts, numbers or goals at a time, without reading the rest of it."""

from collections.abc import Callable, Sequence
from functools import cache, partial
from typing import cast

from kbstore.clock import TimeLike
from kbstore.evaluation.snapshot import Snapshot
from kbstore.messages import Condition, Expression, Fact, Function, Goal, Instance, KnowledgeItem, KnowledgeType
from kbstore.model.domain import Domain
from kbstore.model.timelines import Role, StateRow
from kbstore.names import check_is_text, key
from kbstore.reading.answers import Answers, Computed
from kbstore.reading.item_factory import ItemFactory
from kbstore.reading.reader import Reader
from kbstore.reading.resolver import TemporalPoint
from kbstore.reading.state_data import StateData
from kbstore.storage.records import LogPosition
from kbstore.storage.repository import Repository

Part = tuple[Sequence[KnowledgeItem | Condition], Domain | None]
"""The items of a part of the state, and the domain at the same time."""


class Parts:
    """Reads parts of the state of one knowledge base; those of now are cached beside the answers about now."""

    def __init__(self, reader: Reader, answers: Answers) -> None:
        self._reader = reader
        self._answers = answers

    def instances(
        self, type_name: str, at: TimeLike | None, *, include_constants: bool, include_subtypes: bool
    ) -> list[Instance]:
        """Return the objects of a type, or all."""
        check_is_text("type", type_name)
        wanted = key(type_name)

        @cache
        def is_wanted(kind: str, domain: Domain | None) -> bool:
            if not wanted:
                return True
            if include_subtypes and domain is not None:
                return domain.is_subtype(kind, [wanted])
            return key(kind) == wanted

        def fits(row: StateRow, domain: Domain | None) -> bool:
            return not row[2][0] and is_wanted(row[2][1], domain)

        which = (wanted, include_subtypes)
        items, domain = self._items((KnowledgeType.INSTANCE,), at, which=which, fits=fits)
        if domain is not None and type_name:
            domain.type_spelling(type_name)
        found = cast("list[Instance]", list(items))
        if include_constants and domain is not None:
            constants = [(name, kind) for name, kind in domain.constants.items() if is_wanted(kind, domain)]
            found += [Instance(instance_name=name, instance_type=kind) for name, kind in constants]
        return found

    def propositions(self, name: str, at: TimeLike | None) -> list[Fact]:
        """Return the facts of a predicate, or all, of both signs."""
        items, domain = self._items((KnowledgeType.FACT,), at, name)
        if name and domain is not None:
            domain.predicate_signature(name)
        return cast("list[Fact]", list(items))

    def functions(self, name: str, at: TimeLike | None) -> list[Function]:
        """Return the values of a numeric function, or of all."""
        items, domain = self._items((KnowledgeType.FUNCTION,), at, name)
        if name and domain is not None:
            domain.function_signature(name)
        return cast("list[Function]", list(items))

    def goals(self, at: TimeLike | None) -> list[Goal]:
        """Return the parts of the goal."""
        return cast("list[Goal]", list(self._items(tuple(KnowledgeType), at, role=Role.GOAL)[0]))

    def metric(self, at: TimeLike | None) -> Expression | None:
        """Return the metric; None if there is none."""
        found, _ = self._items((KnowledgeType.EXPRESSION,), at)
        return cast("Expression", found[0]) if found else None

    def timed_knowledge(self, name: str, at: TimeLike | None) -> list[KnowledgeItem]:
        """Return the items scheduled to take effect after the time, of one predicate or function, or of all."""
        check_is_text("predicate or function", name)
        items, domain = self._cached(("timed knowledge",), self._read_scheduled, at)
        if name and domain is not None:
            domain.symbol(name)
        return [
            item
            for item in cast("Sequence[KnowledgeItem]", items)
            if not name or (isinstance(item, Fact | Function) and key(item.attribute_name) == key(name))
        ]

    def _items(
        self,
        kinds: Sequence[KnowledgeType],
        at: TimeLike | None,
        name: str = "",
        *,
        role: Role = Role.STATE,
        which: object = None,
        fits: Callable[[StateRow, Domain | None], bool] | None = None,
    ) -> Part:
        """Return the items of some knowledge types; with `name` those of that symbol, with `fits` what it accepts.

        `which` is the key of `fits` in the cache.
        """
        check_is_text("predicate or function", name)
        read = partial(self._read, role=role, kinds=kinds, name=name, fits=fits)
        return self._cached((role, kinds, key(name), which), read, at)

    def _cached(
        self, which: tuple[object, ...], read: Callable[[Repository, TemporalPoint], Part], at: TimeLike | None
    ) -> Part:
        def compute(repository: Repository, point: TemporalPoint) -> Computed[Part]:
            found = read(repository, point)

            def until() -> int:
                is_moving = any(isinstance(item, Function) and item.rate for item in found[0])
                return point.valid_time if is_moving else repository.next_due(point.valid_time)

            return Computed(found, 1 + len(found[0]), until)

        return self._answers.computed(which, compute, at)

    def _read(
        self,
        repository: Repository,
        point: TemporalPoint,
        role: Role,
        kinds: Sequence[KnowledgeType],
        name: str,
        fits: Callable[[StateRow, Domain | None], bool] | None,
    ) -> Part:
        """Read items as in the state at a point; if the point is stored, the rest of the state is not read."""
        symbols = self._reader.symbol_table(repository, point.head, point.position)
        symbol = key(name)
        rows: list[StateRow] = []
        if not point.is_known_now:
            snapshot = cast("Snapshot", self._reader.world(repository, point, symbols.domain))
            rows = [row for kind in kinds for row in snapshot.of(kind, role)]
        elif name or role is not Role.STATE:
            rows = [row for kind in kinds for row in repository.holding(role, kind, point.valid_time, symbol)]
        else:
            position = LogPosition(point.valid_time)
            rows = [row for kind in kinds for row in repository.state_at(kind, position) if row[0].role is role]
        if name:
            rows = [row for row in rows if row[0].keys[0] == symbol]
        if fits is not None:
            rows = [row for row in rows if fits(row, symbols.domain)]
        return ItemFactory(symbols).items(rows, point.valid_time), symbols.domain

    def _read_scheduled(self, repository: Repository, point: TemporalPoint) -> Part:
        """Read the items on record that take effect after a point, as in its state."""
        symbols = self._reader.symbols_at(repository, point)
        scheduled = [row for kind in KnowledgeType for row in repository.scheduled_at(kind, point.position)]
        nothing = Snapshot(point.valid_time, {}, symbols.domain, self._reader.use_unknowns)
        return self._reader.state_of(StateData(nothing, scheduled, []), symbols).timed_knowledge, symbols.domain
