"""Domains: from PDDL text to `kbstore.model.domain.Domain`."""

import os
from collections.abc import Iterator
from dataclasses import replace

from kbstore.errors import InvalidKnowledge
from kbstore.evaluation.rules import strata
from kbstore.model.actions import Action
from kbstore.model.domain import ROOT_TYPE, DerivedRule, Domain, Signature, type_keys
from kbstore.model.formulas import Parameter
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
)
_REPEATED = (":derived", ":action", ":durative-action")


def read_domain(source: str | os.PathLike[str]) -> Domain:
    """The domain in a file, or in PDDL text. Its sections may come in any order.

    Raises `PddlSyntaxError`, with the place, for what cannot be read or does not fit: undeclared and repeated names,
    wrong numbers and types of arguments, cycles of types, rules that are not stratified.
    """
    text = SourceText.open(source)
    context = Scope(text, report=fail_at_once(text))
    definition = read_definition(context, "domain", _SECTIONS, _REPEATED)
    domain = Domain(
        check_name(context, "domain", definition.whole, 1, definition.name),
        types=_types(context, definition),
        requirements=read_requirements(context, definition),
        source=text.text,
    )
    context = replace(context, domain=domain)
    domain = replace(domain, constants=_constants(context, definition))
    context = replace(context, domain=domain, objects=domain.constant_types)
    domain = replace(
        domain,
        predicate_signatures=_predicates(context, definition),
        function_signatures=_functions(context, definition),
    )
    derived = list(definition.all(":derived"))
    # no action may change what rules derive, so which predicates these are is known before the actions are read
    context = replace(context, domain=replace(domain, rules={_derived_name(section): () for section in derived}))
    domain = replace(domain, rules=_rules(context, derived), actions=_actions(context, definition))
    for section in definition.all(":constraints"):
        ConstraintReader(context, ConditionReader(context)).read(section)
    _check_stratification(context, domain, derived)
    return domain


def read_requirements(context: Scope, definition: Definition) -> tuple[str, ...]:
    """The requirements, as written; unknown ones are kept."""
    section = definition.one(":requirements")
    return context.words(section, 1) if section else ()


def _types(context: Scope, definition: Definition) -> dict[str, str]:
    """Each type with its parent; a parent that is not declared itself is a type below ``object``."""
    section = definition.one(":types") or Group()
    words = [word for word in section[1:] if isinstance(word, str)]
    glued = replace(context, domain=Domain("", types=dict.fromkeys(words, ROOT_TYPE)))
    types: dict[str, str] = {}
    places: dict[str, int] = {}
    spellings: dict[str, str] = {}
    parents_seen: dict[str, str] = {}
    for index, name, parents, _ in read_typed_list(glued, section, 1):
        check_name(context, "type", section, index, name)
        parent = f"(either {' '.join(parents)})" if len(parents) > 1 else "".join(parents) or ROOT_TYPE
        for each in parents:
            parents_seen.setdefault(key(each), each)
        if key(name) == ROOT_TYPE:
            if key(parent) != ROOT_TYPE:
                raise context.error("the type object is above all types, and has no parent", section, index)
            continue
        known = spellings.setdefault(key(name), name)
        if known in types:
            # some files say first that a type is an object, and then what kind of object
            if (key(types[known]) == ROOT_TYPE) == (key(parent) == ROOT_TYPE):
                raise context.error(f"the type {name} is declared for the second time", section, index)
            parent = types[known] if key(parent) == ROOT_TYPE else parent
        types[known] = parent
        places.setdefault(key(name), index)
    for name in parents_seen.values():
        if key(name) != ROOT_TYPE and key(name) not in spellings:
            types[name] = ROOT_TYPE
    _check_cycles(context, section, types, places)
    return types


def _check_cycles(context: Scope, section: Group, types: dict[str, str], places: dict[str, int]) -> None:
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
        # what is left is in a cycle or below one; going up from anywhere leads into one
        name, path = circular[0], list[str]()
        while name not in path:
            path.append(name)
            name = min(above[name])
        path = path[path.index(name) :]
        name = min(path, key=places.__getitem__)
        shown = path[path.index(name) :] + path[: path.index(name)]
        raise context.error(
            f"the type {name} is below itself: {' - '.join([*shown, name])}; types must not form a cycle",
            section,
            places[name],
        )


def _constants(context: Scope, definition: Definition) -> dict[str, str]:
    section = definition.one(":constants") or Group()
    constants: dict[str, str] = {}
    seen: set[str] = set()
    for typed in read_typed_list(context, section, 1):
        check_name(context, "constant", section, typed.place, typed.name)
        if key(typed.name) in seen:
            raise context.error(f"the constant {typed.name} is declared for the second time", section, typed.place)
        seen.add(key(typed.name))
        constants[typed.name] = object_type(context, section, typed)
    return constants


def object_type(context: Scope, group: Group, typed: Typed) -> str:
    """The one type of a declared object."""
    if len(typed.types) > 1:
        raise context.error(
            f"{typed.name} is declared (either {' '.join(typed.types)}), but an object has one type; "
            "declare a type above these, and an object of it",
            group,
            typed.types_place,
        )
    return context.type_name(typed.types[0], group, typed.types_place) if typed.types else ROOT_TYPE


def _predicates(context: Scope, definition: Definition) -> dict[str, Signature]:
    section = definition.one(":predicates") or Group()
    signatures: dict[str, Signature] = {}
    for index in range(1, len(section)):
        group = section[index]
        if not isinstance(group, Group):
            raise context.error(f"a predicate stands in brackets, like ({group} ?x - type)", section, index)
        if group.word(0) == "=" and len(group) > 1:
            continue  # equality, which some old files declare, is built in
        _declare(context, "predicate", group, signatures)
    return signatures


def _functions(context: Scope, definition: Definition) -> dict[str, Signature]:
    """The numeric functions; those whose value is an object are refused."""
    section = definition.one(":functions") or Group()
    signatures: dict[str, Signature] = {}
    index = 1
    while index < len(section):
        node = section[index]
        if isinstance(node, Group):
            _declare(context, "function", node, signatures)
        elif node[0] == "-" and index > 1:
            if node == "-":
                index += 1
            value = section.word(index).lstrip("-")
            if value != "number":
                shown = node_text(section[index], 60) if index < len(section) else "nothing"
                raise context.error(
                    f"the value of a function is a number here, not {shown}; functions whose value is an object "
                    "(object fluents) cannot be read: say it with a predicate",
                    section,
                    index,
                )
        else:
            raise context.error(f"a function stands in brackets, like ({node} ?x - type)", section, index)
        index += 1
    return signatures


def _declare(context: Scope, what: str, group: Group, signatures: dict[str, Signature]) -> None:
    name = check_name(context, what, group, 0)
    if key(name) in signatures:
        raise context.error(f"the {what} {name} is declared for the second time", group, 0)
    parameters = read_parameters(context, group, 1)
    for parameter in parameters:
        check_name(context, "parameter", group, 1, parameter.name)
    signatures[key(name)] = Signature(name, parameters)


def _derived_name(section: Group) -> str:
    head = section[1] if len(section) > 1 else None
    return head.word(0) if isinstance(head, Group) else ""


def _rules(context: Scope, sections: list[Group]) -> dict[str, tuple[DerivedRule, ...]]:
    rules: dict[str, tuple[DerivedRule, ...]] = {}
    for section in sections:
        if len(section) != 3 or not isinstance(section[1], Group) or not isinstance(section[2], Group):
            raise context.error("a rule is (:derived (predicate ?x - type) (condition))", section)
        head, body = section[1], section[2]
        name = context.name(head, 0, "predicate")
        declared = context.predicate(name, head)
        parameters = read_parameters(context, head, 1)
        if declared is None or len(declared.parameters) != len(parameters):
            raise context.error(
                f"the rule's head has {len(parameters)} parameters, but {name} is declared {declared}", head
            )
        typed = tuple(
            Parameter(own.name, wanted.types if own.types == (ROOT_TYPE,) else own.types)
            for own, wanted in zip(parameters, declared.parameters, strict=True)
        )
        condition = ConditionReader(context, frozenset()).read(body, bound(NO_VARIABLES, typed))
        rules[key(name)] = (*rules.get(key(name), ()), DerivedRule(Signature(name, typed), condition))
    return rules


def _actions(context: Scope, definition: Definition) -> dict[str, Action]:
    actions: dict[str, Action] = {}
    for section in definition.sections:
        if section.word(0) in (":action", ":durative-action"):
            action = ActionReader(context).read(section)
            if key(action.name) in actions:
                raise context.error(f"the action {action.name} is declared for the second time", section, 1)
            actions[key(action.name)] = action
    return actions


def _check_stratification(context: Scope, domain: Domain, sections: list[Group]) -> None:
    """Refuse rules by which a predicate depends on its own negation, at the first of its rules."""
    try:
        strata(domain)
    except InvalidKnowledge as error:
        named: Iterator[Group] = (s for s in sections if f" {_derived_name(s)} " in error.violations[0].lower())
        raise context.error(error.violations[0], next(named, sections[0])) from None
