"""PlanSys2's domain expert: its services, answered from the domain of a knowledge base.

Requests and responses are used by the attributes of the messages; no ROS is imported.
"""

from collections.abc import Iterable
from typing import Any, ClassVar

from kbstore.errors import InvalidKnowledge, UnknownSymbol
from kbstore.interop.plansys2 import NodeType
from kbstore.interop.plansys2_messages import MessageWriter
from kbstore.knowledge_base import KnowledgeBase
from kbstore.model.actions import Action
from kbstore.model.domain import ROOT_TYPE, Domain, Signature
from kbstore.names import key
from kbstore.ros.plansys2_service import Expert


class DomainExpert(Expert):
    """Answers the services below ``domain_expert/``; symbols are in lower case, as PlanSys2 has them."""

    TYPES: ClassVar = {
        "get_domain": "GetDomain",
        "get_domain_action_details": "GetDomainActionDetails",
        "get_domain_actions": "GetDomainActions",
        "get_domain_constants": "GetDomainConstants",
        "get_domain_derived_predicate_details": "GetDomainDerivedPredicateDetails",
        "get_domain_derived_predicates": "GetStates",
        "get_domain_durative_action_details": "GetDomainDurativeActionDetails",
        "get_domain_durative_actions": "GetDomainActions",
        "get_domain_function_details": "GetNodeDetails",
        "get_domain_functions": "GetStates",
        "get_domain_name": "GetDomainName",
        "get_domain_predicate_details": "GetNodeDetails",
        "get_domain_predicates": "GetStates",
        "get_domain_types": "GetDomainTypes",
    }

    def __init__(self, kb: KnowledgeBase, messages: Any) -> None:
        """Answer for a knowledge base; `messages` has message types by name, like the module `plansys2_msgs.msg`."""
        self._kb = kb
        self._messages = messages

    @property
    def _domain(self) -> Domain:
        return self._kb.domain

    def _writer(self) -> MessageWriter:
        return MessageWriter(self._messages, self._domain)

    def get_domain(self, request: Any, response: Any) -> None:
        """Answer with the domain in PDDL."""
        response.domain = self._kb.domain_to_pddl()

    def get_domain_name(self, request: Any, response: Any) -> None:
        """Answer with the name of the domain."""
        response.name = key(self._domain.name)

    def get_domain_types(self, request: Any, response: Any) -> None:
        """Answer with all types, ``object`` first."""
        response.types = [ROOT_TYPE, *(name for name in map(key, self._domain.types) if name != ROOT_TYPE)]

    def get_domain_constants(self, request: Any, response: Any) -> None:
        """Answer with the constants of exactly one type."""
        wanted = self._domain.type_spelling(request.type)
        response.constants = [name for name, type_name in self._domain.constants.items() if type_name == wanted]

    # -- predicates and functions -----------------------------------------------------------------------------

    def get_domain_predicates(self, request: Any, response: Any) -> None:
        """Answer with all predicates, by their names alone."""
        response.states = self._named(NodeType.PREDICATE, self._domain.predicate_signatures.values())

    def get_domain_functions(self, request: Any, response: Any) -> None:
        """Answer with all functions, by their names alone."""
        response.states = self._named(NodeType.FUNCTION, self._domain.function_signatures.values())

    def get_domain_derived_predicates(self, request: Any, response: Any) -> None:
        """Answer with the heads of all rules, by their names alone."""
        rules = [rule.head for rules in self._domain.rules.values() for rule in rules]
        response.states = self._named(NodeType.PREDICATE, rules)

    def get_domain_predicate_details(self, request: Any, response: Any) -> None:
        """Answer with a predicate and its parameters."""
        signature = self._domain.predicate_signature(request.expression)
        response.node = self._writer().symbol(NodeType.PREDICATE, signature)

    def get_domain_function_details(self, request: Any, response: Any) -> None:
        """Answer with a function and its parameters."""
        signature = self._domain.function_signature(request.expression)
        response.node = self._writer().symbol(NodeType.FUNCTION, signature)

    def get_domain_derived_predicate_details(self, request: Any, response: Any) -> None:
        """Answer with all rules for a derived predicate."""
        rules = self._domain.rules.get(key(request.predicate))
        if not rules:
            known = ", ".join(self._domain.rules) or "none"
            raise UnknownSymbol(
                f"the domain {self._domain.name} has no rule for {request.predicate}; it derives {known}"
            )
        response.predicates = [self._writer().derived(rule) for rule in rules]

    def _named(self, kind: NodeType, signatures: Iterable[Signature]) -> list[Any]:
        nodes = []
        for signature in signatures:
            node = self._messages.Node()
            node.node_type, node.name = int(kind), key(signature.name)
            nodes.append(node)
        return nodes

    # -- actions ----------------------------------------------------------------------------------------------

    def get_domain_actions(self, request: Any, response: Any) -> None:
        """Answer with the names of the instantaneous actions."""
        response.actions = [key(action.name) for action in self._domain.actions.values() if not action.durative]

    def get_domain_durative_actions(self, request: Any, response: Any) -> None:
        """Answer with the names of the durative actions."""
        response.actions = [key(action.name) for action in self._domain.actions.values() if action.durative]

    def get_domain_action_details(self, request: Any, response: Any) -> None:
        """Answer with an instantaneous action, with the objects that are given for its parameters."""
        action = self._action(request.action, request.parameters)
        if action.durative:
            raise InvalidKnowledge(f"{action.name} takes time; ask get_domain_durative_action_details")
        response.action = self._writer().action(action, request.parameters)

    def get_domain_durative_action_details(self, request: Any, response: Any) -> None:
        """Answer with a durative action, with the objects that are given for its parameters."""
        action = self._action(request.durative_action, request.parameters)
        if not action.durative:
            raise InvalidKnowledge(f"{action.name} takes no time; ask get_domain_action_details")
        response.durative_action = self._writer().durative_action(action, request.parameters)

    def _action(self, name: str, arguments: list[str]) -> Action:
        action = self._domain.action(name)
        if len(arguments) > len(action.parameters) and list(arguments) != [name]:
            # PlanSys2 gives an action without parameters its own name as argument
            raise InvalidKnowledge(f"{name} has {len(action.parameters)} parameters, not {len(arguments)}")
        return action
