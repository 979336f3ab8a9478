"""Reads domains, from PDDL text to `kbstore.model.domain.Domain`."""

import os
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace

from kbstore.conversion import MessageDomain
from kbstore.errors import InvalidKnowledge
from kbstore.model.actions import Action
from kbstore.model.domain import ROOT_TYPE, DerivedRule, Domain, Event, ObjectFluent, Signature, type_keys
from kbstore.model.formulas import Parameter
from kbstore.model.stratification import strata
from kbstore.names import key
from kbstore.pddl.action_reader import ActionReader
from kbstore.pddl.conditions import ConditionReader
from kbstore.pddl.constraints import ConstraintReader
from kbstore.pddl.definition import Definition, check_name, read_definition
from kbstore.pddl.scope import NO_VARIABLES, Scope, fail_at_once
from kbstore.pddl.sexpr import Group, SourceText, node_text
from kbstore.pddl.typed_lists import Typed, bound, read_parameters, read_typed_list

_SECTIONS = (
    ":requirements",
    ":types",
    ":constants",
    ":predicates",
    ":functions",
    ":constraints",
    ":derived",
    ":action",
    ":durative-action",
    ":process",
    ":event",
)
_REPEATED = (":derived", ":action", ":durative-action", ":process", ":event")


def read_domain(source: str | os.PathLike[str] | SourceText) -> MessageDomain:
    """Read the domain in a file, or in PDDL text. Its sections may come in any order.

    Raises `PddlSyntaxError`, with the place, for what cannot be read or does not fit: undeclared and repeated names,
    wrong numbers and types of arguments, cycles of types, rules that are not stratified.
    """
    text = SourceText.open(source)
    scope = Scope(text, report=fail_at_once(text))
    definition = read_definition(scope, "domain", _SECTIONS, _REPEATED)
    domain = MessageDomain(
        check_name(scope, "domain", definition.whole, 1, definition.name),
        types=_types(scope, definition),
        requirements=read_requirements(scope, definition),
        source=text.text,
    )
    scope = replace(scope, domain=domain)
    domain = replace(domain, constants=_constants(scope, definition))
    scope = replace(scope, domain=domain, objects=domain.constant_types)
    functions, object_fluents = _functions(scope, definition)
    domain = replace(
        domain,
        predicate_signatures=_predicates(scope, definition),
        function_signatures=functions,
        object_fluents=object_fluents,
    )
    derived = list(definition.all(":derived"))
    # no action may change a derived predicate, so these are declared before the actions are read
    scope = replace(scope, domain=replace(domain, rules={_derived_name(section): () for section in derived}))
    domain = replace(
        domain,
        rules=_rules(scope, derived),
        actions=_actions(scope, definition),
        events=_events(scope, definition),
    )
    for section in definition.all(":constraints"):
        ConstraintReader(scope, ConditionReader(scope)).read(section)
    _check_stratification(scope, domain, derived)
    return domain


def read_requirements(scope: Scope, definition: Definition) -> tuple[str, ...]:
    """Read the requirements as written, unknown ones included."""
    section = definition.one(":requirements")
    return scope.words(section, 1) if section else ()


def _types(scope: Scope, definition: Definition) -> dict[str, str]:
    """Read each type with its parent; a parent that is not declared itself is a type below ``object``."""
    section = definition.one(":types") or Group()
    words = [word for word in section[1:] if isinstance(word, str)]
    glued = replace(scope, domain=Domain("", types=dict.fromkeys(words, ROOT_TYPE)))
    declared = list(read_typed_list(glued, section, 1))
    parents_of: dict[str, dict[str, str]] = {}
    places: dict[str, int] = {}
    spellings: dict[str, str] = {}
    for index, name, parents, types_place in declared:
        check_name(scope, "type", section, index, name)
        # a type that is declared below itself is one of the top types
        above = {key(parent): parent for parent in parents if key(parent) != key(name)}
        if key(name) == ROOT_TYPE:
            if above:
                raise scope.error(
                    f"the type object is above all types, and is not below {' or '.join(above.values())}"
                    f"{_shared_type(declared, types_place, parents)}",
                    section,
                    index,
                )
            continue
        spellings.setdefault(key(name), name)
        places.setdefault(key(name), index)
        # a type that is declared again is a subtype of each of its parents (rule P4)
        parents_of.setdefault(key(name), {}).update({k: v for k, v in above.items() if k != ROOT_TYPE})
    for _, _, parents, _ in declared:
        for parent in parents:
            if key(parent) != ROOT_TYPE:
                spellings.setdefault(key(parent), parent)
    types = {name: _type_text(list(parents_of.get(name_key, {}).values())) for name_key, name in spellings.items()}
    _check_cycles(scope, section, types, places, declared)
    return types


def _type_text(types: Sequence[str]) -> str:
    return f"(either {' '.join(types)})" if len(types) > 1 else types[0] if types else ROOT_TYPE


def _shared_type(declared: Iterable[Typed], types_place: int, parents: Sequence[str]) -> str:
    """Return the meaning of a typed list in which several names share a type, as the end of a sentence."""
    names = [typed.name for typed in declared if typed.types_place == types_place]
    if len(names) < 2:
        return ""
    shown = ", ".join(names[:12]) + (" ..." if len(names) > 12 else "")
    return (
        f"; '- {_type_text(parents)}' is the type of all names since the type before it, also across lines: {shown}; "
        "write names without a type last, or give them '- object'"
    )


def _check_cycles(
    scope: Scope, section: Group, types: dict[str, str], places: dict[str, int], declared: Sequence[Typed]
) -> None:
    """Refuse a type that is below itself: types are taken away as long as nothing is left above them (Kahn, 1962)."""
    above = {key(name): set(type_keys(parent)) - {ROOT_TYPE} for name, parent in types.items()}
    below: dict[str, list[str]] = {}
    for name, parents in above.items():
        for parent in parents:
            below.setdefault(parent, []).append(name)
    free = [name for name, parents in above.items() if not parents]
    for parent in free:
        for name in below.get(parent, ()):
            above[name].discard(parent)
            if not above[name]:
                free.append(name)
    circular = [name for name, parents in above.items() if parents]
    if circular:
        # a type that is left is in a cycle or below one, so going up from any of them leads into a cycle
        name, path = circular[0], list[str]()
        while name not in path:
            path.append(name)
            name = min(above[name])
        path = path[path.index(name) :]
        name = min(path, key=places.__getitem__)
        shown = path[path.index(name) :] + path[: path.index(name)]
        shared = (
            _shared_type(declared, typed.types_place, typed.types)
            for typed in declared
            if key(typed.name) in path and any(key(parent) in path for parent in typed.types)
        )
        raise scope.error(
            f"the type {name} is below itself: {' - '.join([*shown, name])}; types must not form a cycle"
            f"{next(filter(None, shared), '')}",
            section,
            places[name],
        )


def _constants(scope: Scope, definition: Definition) -> dict[str, str]:
    section = definition.one(":constants") or Group()
    constants: dict[str, tuple[str, str]] = {}
    for typed in read_typed_list(scope, section, 1):
        check_name(scope, "constant", section, typed.place, typed.name)
        type_name = object_type(scope, section, typed)
        _, known = constants.setdefault(key(typed.name), (typed.name, type_name))
        if known != type_name:
            raise scope.error(
                f"the constant {typed.name} is declared for the second time, as {type_name}; before it is {known}",
                section,
                typed.place,
            )
    return dict(constants.values())


def object_type(scope: Scope, group: Group, typed: Typed) -> str:
    """Return the one type of a declared object. Raises `PddlSyntaxError` for an ``either``."""
    if len(typed.types) > 1:
        raise scope.error(
            f"{typed.name} is declared (either {' '.join(typed.types)}), but an object has one type; "
            "declare a type above these, and an object of it",
            group,
            typed.types_place,
        )
    return scope.type_name(typed.types[0], group, typed.types_place) if typed.types else ROOT_TYPE


def _predicates(scope: Scope, definition: Definition) -> dict[str, Signature]:
    section = definition.one(":predicates") or Group()
    signatures: dict[str, Signature] = {}
    for index in range(1, len(section)):
        group = section[index]
        if not isinstance(group, Group):
            raise scope.error(f"a predicate is in brackets, like ({group} ?x - type)", section, index)
        if group.word(0) == "=" and len(group) > 1:
            continue  # equality, which some old files declare, is built in
        _declare(scope, "predicate", group, signatures)
    return signatures


def _functions(scope: Scope, definition: Definition) -> tuple[dict[str, Signature], dict[str, ObjectFluent]]:
    """Read the numeric functions, and the object fluents, which are followed by ``- type``."""
    section = definition.one(":functions") or Group()
    signatures: dict[str, Signature] = {}
    types: dict[str, tuple[str, ...]] = {}
    pending: list[Group] = []

    def declare(value: tuple[str, ...]) -> None:
        for group in pending:
            signature = _declare(scope, "function", group, signatures)
            if types.setdefault(key(signature.name), value) != value:
                raise scope.error(
                    f"the function {signature.name} is declared for the second time, with other values", group, 0
                )
        pending.clear()

    index = 1
    while index < len(section):
        node = section[index]
        if isinstance(node, Group):
            pending.append(node)
        elif node[0] == "-" and index > 1:
            index += node == "-"
            declare(_value_types(scope, section, index))
        else:
            raise scope.error(f"a function is in brackets, like ({node} ?x - type)", section, index)
        index += 1
    declare(())
    numeric = {name: signature for name, signature in signatures.items() if not types[name]}
    fluents = {name: ObjectFluent(signatures[name], value) for name, value in types.items() if value}
    return numeric, fluents


def _value_types(scope: Scope, section: Group, index: int) -> tuple[str, ...]:
    """Read the types of a function's value, none for a number."""
    node = section[index] if index < len(section) else ""
    if isinstance(node, Group):
        types = scope.words(node, 1) if node.word(0) == "either" else ()
    else:
        types = (node.lstrip("-"),)
    if not types or not types[0]:
        shown = node_text(node, 60) or "nothing"
        raise scope.error(f"the value of a function is a number or of a type, not {shown}", section, index)
    if key(types[0]) == "number" and not scope.knows_type("number"):
        return ()
    return tuple(scope.type_name(type_name, section, index) for type_name in types)


def _declare(scope: Scope, what: str, group: Group, signatures: dict[str, Signature]) -> Signature:
    name = check_name(scope, what, group, 0)
    parameters = read_parameters(scope, group, 1, positional=True)
    for parameter in parameters:
        check_name(scope, "parameter", group, 1, parameter.name)
    known = signatures.setdefault(key(name), Signature(name, parameters))
    if [parameter.types for parameter in known.parameters] != [parameter.types for parameter in parameters]:
        raise scope.error(
            f"the {what} {name} is declared for the second time, and differently: before it is {known}", group, 0
        )
    return known


def _derived_name(section: Group) -> str:
    head = section[1] if len(section) > 1 else None
    return head.word(0) if isinstance(head, Group) else ""


def _rules(scope: Scope, sections: list[Group]) -> dict[str, tuple[DerivedRule, ...]]:
    rules: dict[str, tuple[DerivedRule, ...]] = {}
    for section in sections:
        if len(section) != 3 or not isinstance(section[1], Group) or not isinstance(section[2], Group):
            raise scope.error("a rule is (:derived (predicate ?x - type) (condition))", section)
        head, body = section[1], section[2]
        name = scope.name(head, 0, "predicate")
        declared = scope.predicate(name, head)
        parameters = read_parameters(scope, head, 1)
        if declared is None or len(declared.parameters) != len(parameters):
            raise scope.error(
                f"the rule's head has {len(parameters)} parameters, but {name} is declared {declared}", head
            )
        typed = tuple(
            Parameter(own.name, wanted.types if own.types == (ROOT_TYPE,) else own.types)
            for own, wanted in zip(parameters, declared.parameters, strict=True)
        )
        condition = ConditionReader(scope, frozenset()).read(body, bound(NO_VARIABLES, typed))
        rules[key(name)] = (*rules.get(key(name), ()), DerivedRule(Signature(name, typed), condition))
    return rules


def _actions(scope: Scope, definition: Definition) -> dict[str, Action]:
    actions: dict[str, Action] = {}
    for section in definition.sections:
        if section.word(0) in (":action", ":durative-action"):
            action = ActionReader(scope).read(section)
            if actions.setdefault(key(action.name), action) != action:
                raise scope.error(
                    f"the action {action.name} is declared for the second time, and differently", section, 1
                )
    return actions


def _events(scope: Scope, definition: Definition) -> tuple[Event, ...]:
    """Read the processes and events of PDDL+, which are stored but not computed (rule P4)."""
    reader = ActionReader(scope)
    events: dict[tuple[str, str], tuple[Event, Group]] = {}
    for section in definition.sections:
        if section.word(0) in (":process", ":event"):
            event = reader.read_event(section)
            _, known = events.setdefault((event.kind, key(event.name)), (event, section))
            if known != section:
                raise scope.error(
                    f"the {event.kind} {event.name} is declared for the second time, and differently", section, 1
                )
    return tuple(event for event, _ in events.values())


def _check_stratification(scope: Scope, domain: Domain, sections: list[Group]) -> None:
    """Refuse a predicate that depends on its own negation, with the place of the first of its rules."""
    try:
        strata(domain)
    except InvalidKnowledge as error:
        named: Iterator[Group] = (s for s in sections if f" {_derived_name(s)} " in error.violations[0].lower())
        raise scope.error(error.violations[0], next(named, sections[0])) from None
