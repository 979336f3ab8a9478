"""The services of ROSPlan's knowledge base, without ROS: from a request to its response.

Requests may be of any type with the attributes of ROSPlan's messages, and the caller makes the messages of responses,
so nothing here needs ROS. `kbstore.ros.rosplan_node` serves it on a graph.
"""

from collections.abc import Callable, Iterable
from functools import lru_cache
from typing import Any

from kbstore.errors import InvalidKnowledge, KbStoreError, UnknownSymbol
from kbstore.knowledge_base import KnowledgeBase
from kbstore.messages import Condition, Expression, Fact, Function, KnowledgeType, Message, UpdateType, from_message
from kbstore.messages.gc_pause import gc_paused
from kbstore.model.results import Transaction
from kbstore.model.symbols import SymbolTable
from kbstore.names import bracketed, key
from kbstore.reading.state import State
from kbstore.ros.ros1_messages import Make, stamp, to_ros

SERVICES = {
    "domain/name": "GetDomainNameService",
    "domain/types": "GetDomainTypeService",
    "domain/predicates": "GetDomainAttributeService",
    "domain/functions": "GetDomainAttributeService",
    "domain/operators": "GetDomainOperatorService",
    "domain/operator_details": "GetDomainOperatorDetailsService",
    "domain/predicate_details": "GetDomainPredicateDetailsService",
    "query_state": "KnowledgeQueryService",
    "clear": "Empty",
    "update": "KnowledgeUpdateService",
    "update_array": "KnowledgeUpdateServiceArray",
    "update_constraints_oneof": "KnowledgeUpdateServiceArray",
    "update_sensed_predicates": "SetNamedBool",
    "state/instances": "GetInstanceService",
    "state/propositions": "GetAttributeService",
    "state/functions": "GetAttributeService",
    "state/timed_knowledge": "GetAttributeService",
    "state/goals": "GetAttributeService",
    "state/metric": "GetMetricService",
}
"""The type of each service, by its name below the node's."""

MOST = 10_000
"""The most messages that are cached; about 20 MB."""


class RosplanServices:
    """Answers ROSPlan's services from a knowledge base, by `kbstore`'s rules.

    Args:
        kb: the knowledge base.
        make: makes the messages of the responses, which must not be changed: those of items are cached.
        publish: is called with the StatusUpdate that follows a call of ``update_array``.
        report: is called with the reason of a failure that a response can only report as a bool.
    """

    def __init__(
        self,
        kb: KnowledgeBase,
        make: Make,
        *,
        publish: Callable[[Any], None],
        report: Callable[[str], None],
    ) -> None:
        self._kb = kb
        self._make = make
        self._cached = lru_cache(MOST)(lambda message: to_ros(message, make))
        self._publish = publish
        self._report = report

    def call(self, service: str, request: Any, client: str = "") -> Any:
        """Answer a request.

        Args:
            service: a name of `SERVICES`.
            request: the request's message.
            client: who calls; the client of the transaction.

        Raises:
            KbStoreError: a question cannot be answered, or ``clear`` fails; the other services that change something
                report a failure in their response.
        """
        response = self._make(f"{SERVICES[service]}Response")
        getattr(self, f"_{service.replace('/', '_')}")(request, response, client)
        return response

    # -- the domain -------------------------------------------------------------------------------------------

    def _domain_name(self, _request: Any, response: Any, _client: str) -> None:
        response.domain_name = self._kb.domain.name

    def _domain_types(self, _request: Any, response: Any, _client: str) -> None:
        types = self._kb.domain.types
        response.types, response.super_types = list(types), list(types.values())

    def _domain_predicates(self, _request: Any, response: Any, _client: str) -> None:
        response.items = self._messages(self._kb.domain.predicates)

    def _domain_functions(self, _request: Any, response: Any, _client: str) -> None:
        response.items = self._messages(self._kb.domain.functions)

    def _domain_operators(self, _request: Any, response: Any, _client: str) -> None:
        response.operators = self._messages(operator.formula for operator in self._kb.domain.operators.values())

    def _domain_operator_details(self, request: Any, response: Any, _client: str) -> None:
        response.op = self._message(self._kb.domain.operator(request.name))

    def _domain_predicate_details(self, request: Any, response: Any, _client: str) -> None:
        domain = self._kb.domain
        response.predicate = self._message(domain.predicate(request.name))
        response.is_sensed = domain.is_sensed(request.name)

    # -- the state --------------------------------------------------------------------------------------------

    def _query_state(self, request: Any, response: Any, _client: str) -> None:
        # as items: prepared questions are cached by items, not by messages of ROS
        found = self._kb.query(*map(from_message, request.knowledge))
        response.all_true, response.results = found.all_true, list(found.results)
        # as they were asked, for a caller that compares them with its question
        response.false_knowledge = [
            item for item, is_true in zip(request.knowledge, found.results, strict=True) if not is_true
        ]

    def _state_instances(self, request: Any, response: Any, _client: str) -> None:
        found = self._kb.instances(
            request.type_name,
            include_constants=request.include_constants,
            include_subtypes=request.include_subtypes,
        )
        response.instances = [item.instance_name for item in found]

    def _state_propositions(self, request: Any, response: Any, _client: str) -> None:
        response.attributes = self._named(self._kb.propositions, request.predicate_name)

    def _state_functions(self, request: Any, response: Any, _client: str) -> None:
        response.attributes = self._named(self._kb.functions, request.predicate_name)

    def _state_timed_knowledge(self, request: Any, response: Any, _client: str) -> None:
        response.attributes = self._named(self._kb.timed_knowledge, request.predicate_name)

    def _named(self, ask: Callable[[str], Iterable[Any]], name: str) -> list[Any]:
        """Return the items of a symbol, or all; none for a symbol of the other kind (predicate or function)."""
        try:
            return self._messages(ask(name))
        except UnknownSymbol:
            self._kb.domain.symbol(name)
            return []

    def _state_goals(self, _request: Any, response: Any, _client: str) -> None:
        goals = self._kb.goals()
        beyond = [str(goal) for goal in goals if isinstance(goal, Condition)]
        if beyond:
            raise InvalidKnowledge(
                f"the goal has parts that no KnowledgeItem can carry: {', '.join(beyond)}; ask for the problem by "
                "kb.to_pddl(), which has all of them"
            )
        response.attributes = self._messages(goals)

    def _state_metric(self, _request: Any, response: Any, _client: str) -> None:
        metric = self._kb.metric()
        if metric is not None:
            response.metric = self._message(metric)

    # -- changes ----------------------------------------------------------------------------------------------

    def _clear(self, _request: Any, _response: Any, client: str) -> None:
        self._kb.clear(client=client)

    def _update(self, request: Any, response: Any, client: str) -> None:
        updates = [_update_of(request.update_type, request.knowledge)]
        self._attempt(response, "update", client, lambda: self._kb.update(updates, client=client))

    def _update_array(self, request: Any, response: Any, client: str) -> None:
        def update() -> Transaction:
            # ROS reads an array of bytes as bytes; a list of them has the numbers
            kinds, items = list(request.update_type), request.knowledge
            if len(kinds) != len(items):
                raise InvalidKnowledge(f"there are {len(kinds)} update types for {len(items)} items; give one for each")
            return self._kb.update([_update_of(*each) for each in zip(kinds, items, strict=True)], client=client)

        done = self._attempt(response, "update_array", client, update)
        if done is not None:
            status = self._make("StatusUpdate")
            status.last_update_client = client
            stamp(status.last_update_time, done.time)
            self._publish(status)

    def _update_sensed_predicates(self, request: Any, response: Any, client: str) -> None:
        self._attempt(
            response,
            "update_sensed_predicates",
            client,
            lambda: self._kb.set_sensed(request.name, bool(request.value), client=client),
        )

    def _update_constraints_oneof(self, request: Any, response: Any, client: str) -> None:
        def update() -> Transaction:
            with self._kb.transaction(client=client) as tx:
                tx.load(None, _oneof_problem([from_message(item) for item in request.knowledge], tx.state()))
            return tx.result

        self._attempt(response, "update_constraints_oneof", client, update)

    def _attempt(
        self, response: Any, service: str, client: str, change: Callable[[], Transaction]
    ) -> Transaction | None:
        """Call `change`, and set `success` in the response; report the reason of a failure."""
        try:
            done = change()
        except KbStoreError as error:
            self._report(f"{service} by {client or 'an unnamed client'} changed nothing: {error}")
            response.success = False
            return None
        response.success = True
        return done

    def _message(self, found: Message) -> Any:
        # functions are not cached: a number seldom has the same value again
        return to_ros(found, self._make) if isinstance(found, Function) else self._cached(found)

    def _messages(self, found: Iterable[Message]) -> list[Any]:
        with gc_paused():
            return [self._message(message) for message in found]


def _update_of(kind: int, item: Any) -> tuple[int, Any]:
    """Return an update for `kb.update`; the removal of the metric may come without an expression."""
    if kind == UpdateType.REMOVE_METRIC and item.knowledge_type != KnowledgeType.EXPRESSION:
        return kind, Expression()
    return kind, item


def _oneof_problem(items: list[Any], state: State) -> str:
    """Return a problem in PDDL that only states that exactly one of some facts is true.

    Raises `InvalidKnowledge` for other items, and for objects that do not exist.
    """
    atoms, named = [], set[str]()
    symbols = SymbolTable(state.domain)
    for item in items:
        if not isinstance(item, Fact):
            raise InvalidKnowledge(f"{item} cannot be one of several facts; a oneof constraint is about facts")
        name, arguments = symbols.ordered(KnowledgeType.FACT, item.attribute_name, item.arguments, item.labels)
        atom = bracketed(name, *arguments)
        atoms.append(f"(not {atom})" if item.is_negative else atom)
        named.update(map(key, arguments))
    declared = [str(item) for item in state.instances if key(item.instance_name) in named]
    missing = named - {key(name) for name in state.objects()}
    if missing and state.domain is not None:
        raise InvalidKnowledge(
            f"(oneof {' '.join(atoms)}): {', '.join(sorted(missing))} does not exist; add the object first"
        )
    domain = state.domain.name if state.domain else "none"
    init = f"(oneof {' '.join(atoms)})"
    return f"(define (problem oneof) (:domain {domain}) (:objects {' '.join(declared)}) (:init {init}))"
