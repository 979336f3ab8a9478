"""The state of a knowledge base at one time: what holds, what is scheduled, and what runs."""

from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import cached_property
from typing import TYPE_CHECKING, Any, Literal, TypeVar, cast, overload

from kbstore.clock import isoformat
from kbstore.conversion import MessageDomain
from kbstore.errors import KbStoreError
from kbstore.evaluation.argument_types import check_types
from kbstore.messages import (
    Condition,
    Expression,
    Fact,
    Function,
    Goal,
    Inequality,
    Instance,
    KnowledgeItem,
    KnowledgeType,
    Truth,
)
from kbstore.model.html import table
from kbstore.model.pictures import Bar, Lane, Look, timeline
from kbstore.model.plain import Data, Result, plain, times
from kbstore.model.results import QueryResult, Run
from kbstore.model.symbols import SymbolTable
from kbstore.model.timelines import EndCause, Identity, Mentions, Role, fact_value
from kbstore.names import check_is_text
from kbstore.pddl.parse import uncertain_atoms
from kbstore.pddl.strict_names import StrictPddl, strict_problem
from kbstore.pddl.writer import write_problem
from kbstore.planning.simulator import Simulator
from kbstore.reading.bindings import bindings
from kbstore.reading.item_factory import ItemFactory
from kbstore.reading.prepared import PreparedQuestions
from kbstore.reading.questions import Question, as_item
from kbstore.reading.state_data import PARTS, StateData, state_schema
from kbstore.storage.caches import LRU, STATE_ANSWERS
from kbstore.storage.records import LogPosition

if TYPE_CHECKING:
    from kbstore.model.results import Explanation

_Kind = TypeVar("_Kind")


def query_result(items: Sequence[Question], results: list[bool], symbol_table: SymbolTable) -> QueryResult:
    """Return the answer to a query: which of its items are true, and those that are not."""
    false = [_asked(item, symbol_table) for item, result in zip(items, results, strict=True) if not result]
    return QueryResult(all(results), results, false)


def _asked(question: Question, symbol_table: SymbolTable) -> KnowledgeItem | Condition:
    """Return a question as an item, or as a condition if no item can carry it."""
    if isinstance(question, Condition):
        return question
    try:
        return as_item(question, symbol_table)
    except KbStoreError:
        return Condition(text=str(question))


class State(Result):
    """Everything that held (or is expected to hold) at one time; immutable, and independent of the database.

    Attributes:
        at: The time, in nanoseconds.
        as_of: The time whose belief this is, in nanoseconds; None where it is not a belief of the past.
        name: The name of the knowledge base.
    """

    def __init__(
        self,
        data: StateData,
        *,
        belief: LogPosition | None,
        name: str,
        symbol_table: SymbolTable,
        questions: PreparedQuestions,
        mentions: Mentions,
        explainer: "Callable[[State, Question], Explanation]",
        draft: Mapping[Identity, EndCause] | None = None,
    ) -> None:
        self.snapshot = data.snapshot
        """The interpretation against which conditions are evaluated."""
        self.at = self.snapshot.time
        self.as_of = None if belief is None else belief.time
        self.belief = belief
        self.draft = draft
        """What an open transaction has ended, by timeline, and why; None for a state that is on record."""
        self.name = name
        self._pending = data.pending
        self._running = data.running
        self.symbol_table = symbol_table
        """The symbols at that time."""
        self._questions = questions
        self._answers: LRU[str, Truth] = LRU(STATE_ANSWERS if questions.caching else 0)
        self._mentions = mentions
        self._explainer = explainer
        self._reader = ItemFactory(symbol_table)

    # -- contents ---------------------------------------------------------------------------------------------

    @property
    def domain(self) -> MessageDomain | None:
        """The domain at that time."""
        return cast("MessageDomain | None", self.symbol_table.domain)

    @property
    def use_unknowns(self) -> bool:
        """Whether absent reads as unknown."""
        return self.snapshot.use_unknowns

    @cached_property
    def instances(self) -> list[Instance]:
        """The objects that exist, without the domain's constants."""
        rows = [row for row in self.snapshot.of(KnowledgeType.INSTANCE) if not row[2][0]]
        return cast("list[Instance]", self._reader.items(rows, self.at))

    @cached_property
    def facts(self) -> list[Fact]:
        """The facts, of both signs."""
        return self._items(KnowledgeType.FACT, Fact)

    @cached_property
    def functions(self) -> list[Function]:
        """The numeric functions that are defined, with their values at the time."""
        return self._items(KnowledgeType.FUNCTION, Function)

    @cached_property
    def inequalities(self) -> list[Inequality]:
        """The inequalities that are recorded statements (rule C11)."""
        return self._items(KnowledgeType.INEQUALITY, Inequality)

    @cached_property
    def metric(self) -> Expression | None:
        """The metric."""
        found = self._items(KnowledgeType.EXPRESSION, Expression)
        return found[0] if found else None

    @cached_property
    def goals(self) -> list[Goal]:
        """The parts of the goal."""
        rows = [row for row in self.snapshot.rows if row[0].role is Role.GOAL]
        return cast("list[Goal]", self._reader.items(rows, self.at))

    @cached_property
    def constraints(self) -> list[str]:
        """The parts of loaded problems that no item can carry, in PDDL (rule P4).

        These are constraints on the plan's course, values of object fluents, and ``oneof``, ``or`` and ``unknown`` in
        the initial state, as long as none of their atoms has been asserted.
        """
        kept = sorted((row[0].id, row[2][2]) for row in self.snapshot.rows if row[0].role is Role.CONSTRAINT)
        return [text for _, text in kept if not any(map(self._is_asserted, uncertain_atoms(text)))]

    @cached_property
    def timed_constraints(self) -> list[tuple[int, str]]:
        """The values of object fluents from later times on, each with its time, in PDDL (rule P4)."""
        rows = [(t, timeline.id, value[2]) for timeline, t, value in self._pending if timeline.role is Role.CONSTRAINT]
        return [(t, text) for t, _, text in sorted(rows) if t > self.at]

    def _is_asserted(self, name: str) -> bool:
        return self.snapshot.row(KnowledgeType.FACT, name) is not None

    @cached_property
    def timed_knowledge(self) -> list[KnowledgeItem]:
        """The items on record that take effect after the time, without goals (rule Q1)."""
        # a scheduled item has its own rate, without what runs add to it until then
        rows = [
            (timeline, t, (*value[:3], value[2]) if timeline.kind is KnowledgeType.FUNCTION else value)
            for timeline, t, value in self._pending
            if timeline.role is Role.STATE and t > self.at
        ]
        return cast("list[KnowledgeItem]", self._reader.items(rows, None))

    @cached_property
    def running(self) -> list[Run]:
        """The durative actions that run."""
        return [entry.run for entry in self._running]

    def objects(self, type_name: str = "") -> list[str]:
        """Return the names of the objects of a type and its subtypes, constants included; without a type, of all.

        Raises `UnknownSymbol` for a type that the domain does not know.
        """
        check_is_text("type", type_name)
        if self.domain is not None and type_name:
            self.domain.type_spelling(type_name)
        spellings = {row[0].key: row[0].spelling for row in self.snapshot.of(KnowledgeType.INSTANCE)}
        if self.domain is not None:
            spellings |= {name.lower(): name for name in self.domain.constants}
        return [spellings[name] for name in self.snapshot.objects([type_name.lower() or "object"])]

    def _items(self, kind: KnowledgeType, model: type[_Kind]) -> list[_Kind]:
        items = self._reader.items(self.snapshot.of(kind), self.at)
        return cast("list[_Kind]", items)

    # -- questions --------------------------------------------------------------------------------------------

    def truth(self, question: Question) -> Truth:
        """Return the truth value of a fact or condition: TRUE, FALSE or UNKNOWN (rules V2 to V9)."""
        known = self._answers.get(question) if type(question) is str else None
        if known is not None:
            return known
        prepared = self._questions.condition(question, self.symbol_table)
        check_types(prepared.named, self.snapshot.type_of, self.domain)
        found = prepared.evaluate(self.snapshot)
        if type(question) is str:
            self._answers.put(question, found)
        return found

    def holds(self, question: Question) -> bool:
        """Return whether a fact or condition is true."""
        return self.truth(question) is Truth.TRUE

    def value(self, question: Question) -> float:
        """Return the value of a numeric function or expression.

        Raises `UndefinedFunction` or `DivisionByZero` where it has none.
        """
        prepared = self._questions.expression(question, self.symbol_table)
        check_types(prepared.named, self.snapshot.type_of, self.domain)
        return prepared.evaluate(self.snapshot)

    def find(self, condition: Question) -> list[dict[str, str]]:
        """Find the objects for a condition's free variables for which it is true (rule V11).

        The same as `KnowledgeBase.find` at this time.
        """
        return bindings(condition, self.symbol_table, self.snapshot)

    def explain(self, question: Question) -> "Explanation":
        """Explain why a fact or condition is true, false or unknown, and which transaction made it so."""
        return self._explainer(self, question)

    def query(self, *items: Question) -> QueryResult:
        """Return whether each item is true, as the original's query does; unknown counts as not true."""
        return query_result(items, [self.holds(item) for item in items], self.symbol_table)

    # -- planning ---------------------------------------------------------------------------------------------

    @cached_property
    def end_effects(self) -> list[tuple[int, KnowledgeItem, Run]]:
        """The expected changes at the ends of running actions: time, item, run (rule O4)."""
        ends = [run.expected_end for run in self.running if run.expected_end > self.at]
        last: dict[tuple[int, Identity], tuple[int, KnowledgeItem, Run]] = {}
        for event in self.projection().advance(max(ends, default=self.at)):
            if event.run is None:
                continue
            value = fact_value(is_negative=True) if event.value is None else event.value
            item = cast("KnowledgeItem", self._reader.item(event.timeline, event.time, value, event.time))
            # of several changes at one time, the last counts, in its place
            last.pop((event.time, event.timeline.identity), None)
            last[event.time, event.timeline.identity] = (event.time, item, event.run)
        return list(last.values())

    def projection(self) -> Simulator:
        """Return a simulator that plays the state forward."""
        return Simulator(
            self.at,
            self.snapshot.rows,
            [row for row in self._pending if row[1] > self.at],
            self._running,
            domain=self.domain,
            use_unknowns=self.snapshot.use_unknowns,
            mentions=self._mentions,
        )

    @overload
    def to_pddl(self, *, explicit_negatives: bool = False, strict_names: Literal[False] = False) -> str: ...
    @overload
    def to_pddl(self, *, explicit_negatives: bool = False, strict_names: Literal[True]) -> StrictPddl: ...
    def to_pddl(self, *, explicit_negatives: bool = False, strict_names: bool = False) -> str | StrictPddl:
        """Write the planning problem at that time in PDDL (rules P2, O4); with `strict_names` as a `StrictPddl`."""
        text = write_problem(self, explicit_negatives=explicit_negatives)
        return strict_problem(text, self.domain) if strict_names else text

    # -- as data ----------------------------------------------------------------------------------------------

    def to_dict(self) -> Data:
        """Return the state as plain data for JSON, each time as ISO 8601 text and in nanoseconds."""
        parts = ("instances", "facts", "functions", "inequalities", "metric", "goals", "timed_knowledge", "running")
        return {
            "knowledge_base": self.name,
            **times(at=self.at, as_of=self.as_of),
            "domain": None if self.domain is None else self.domain.name,
            "use_unknowns": self.use_unknowns,
            **{part: plain(getattr(self, part)) for part in parts},
            "constraints": list(self.constraints),
        }

    def keys(self) -> Iterable[str]:
        """Return the names of the parts that a web framework answers with, which ``dict(state)`` has."""
        return PARTS.keys()

    def __getitem__(self, part: str) -> Any:
        if part not in PARTS:
            raise KeyError(part)
        return getattr(self, part)

    # without it, iterating would ask for the parts 0, 1, 2
    __iter__ = None

    @classmethod
    def __get_pydantic_core_schema__(cls, _source: object, handler: Any) -> Any:
        return state_schema(cls, handler)

    @classmethod
    def __get_pydantic_json_schema__(cls, schema: Any, handler: Any) -> Any:
        return {**handler(schema["serialization"]["return_schema"]), "title": cls.__name__}

    def __repr__(self) -> str:
        belief = "" if self.as_of is None else f" as of {isoformat(self.as_of)}"
        kinds = Counter((timeline.role, timeline.kind) for timeline, _, _ in self.snapshot.rows)
        counts = (
            (kinds[Role.STATE, KnowledgeType.INSTANCE], "object"),
            (kinds[Role.STATE, KnowledgeType.FACT], "fact"),
            (kinds[Role.STATE, KnowledgeType.FUNCTION], "function"),
            (sum(number for (role, _), number in kinds.items() if role is Role.GOAL), "goal"),
            (len(self._running), "running action"),
        )
        shown = ", ".join(f"{number} {noun}" + ("" if number == 1 else "s") for number, noun in counts if number)
        return f"State({self.name!r} at {isoformat(self.at)}{belief}: {shown or 'empty'})"

    def _repr_html_(self) -> str:
        def rows(items: Iterable[KnowledgeItem | Condition]) -> list[tuple[object, ...]]:
            return [(item, isoformat(item.initial_time)) for item in items]

        runs = [(run.action, isoformat(run.started)) for run in self.running]
        parts: list[tuple[str, Sequence[Sequence[object]]]] = [
            ("objects", rows(self.instances)),
            ("facts", rows(self.facts)),
            ("functions", rows(self.functions)),
            ("inequalities", rows(self.inequalities)),
            ("goals", rows(self.goals)),
            ("metric", rows([self.metric] if self.metric else [])),
            ("scheduled", rows(self.timed_knowledge)),
            ("running", runs),
        ]
        return timeline(self._lanes(), [(self.at, f"at {isoformat(self.at)}")]) + table(
            repr(self), ("", "since"), parts
        )

    def _lanes(self) -> list[Lane]:
        """Return what runs, is scheduled and holds, as lanes of a small timeline, the latest changes first."""
        lanes = [Lane(run.action, [Bar(run.started, run.expected_end, Look.RUN, str(run))]) for run in self.running]
        for item in self.timed_knowledge:
            look = Look.SCHEDULED_FALSE if getattr(item, "is_negative", False) else Look.SCHEDULED
            lanes.append(
                Lane(str(item), [Bar(item.initial_time, None, look, f"{item} from {isoformat(item.initial_time)}")])
            )
        for fact in sorted(self.facts, key=lambda fact: -fact.initial_time):
            look = Look.FALSE if fact.is_negative else Look.TRUE
            tip = f"{fact} since {isoformat(fact.initial_time)}"
            lanes.append(Lane(str(fact), [Bar(fact.initial_time, self.at, look, tip)]))
        return lanes
