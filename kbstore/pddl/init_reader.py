"""Reads the initial state of a problem: facts, values, and timed-initial literals and fluents.

Nearly all of a large problem consists of facts, so these take a short path: an argument that has once been found to
fit a parameter is from then on one look-up, which returns the labelled value that all its facts share.
"""

from dataclasses import dataclass, field

from kbstore.clock import seconds
from kbstore.errors import InvalidKnowledge, InvalidTime
from kbstore.messages import AssignOp, Fact, Function, KeyValue, KnowledgeType
from kbstore.messages.items import trusted_fact
from kbstore.model.domain import Signature
from kbstore.names import is_wildcard, key
from kbstore.pddl.conditions import UNCERTAIN, ConditionReader
from kbstore.pddl.effects import ASSIGNMENTS, EffectReader, function_group
from kbstore.pddl.expressions import NUMBER, number_at
from kbstore.pddl.item_reader import labelled
from kbstore.pddl.scope import NO_VARIABLES, Scope
from kbstore.pddl.sexpr import Group, node_text

_TAKES = {"oneof": "conditions", "or": "conditions", "unknown": "one fact"}

Entry = Fact | Function
Values = tuple[KeyValue, ...]


class Fitting:
    """Arguments that are known to fit: for each predicate or function, a table for each of its parameters."""

    def __init__(self) -> None:
        self._tables: dict[str, list[dict[str, KeyValue]]] = {}

    def values(self, term: Group) -> Values | None:
        """Return the labelled arguments of a term if all of them are known to fit, or None."""
        try:
            tables = self._tables[term[0]]  # type: ignore[index]
            if len(term) == len(tables) + 1:
                return tuple([table[name] for table, name in zip(tables, term[1:], strict=True)])  # type: ignore[index]
        except (LookupError, TypeError):  # an argument that is not known yet, or a group instead of a name
            pass
        return None

    def add(self, name: str, values: Values) -> None:
        """Record that these arguments fit."""
        tables = self._tables.setdefault(name, [{} for _ in values])
        if len(tables) == len(values):
            for table, value in zip(tables, values, strict=True):
                table[value.value] = value


@dataclass
class InitReader:
    """Reads an ``(:init ...)`` section into `entries` and `timed` (with times in nanoseconds), with their offsets.

    Parts that are stored as text (rule P4): `object_values` has the values of object fluents by term, `timed_values`
    those of later times (time, term and text), and `uncertain` the constraints on unknown atoms.
    """

    scope: Scope
    entries: list[Entry] = field(default_factory=list)
    offsets: list[int] = field(default_factory=list)
    timed: list[tuple[int, Entry]] = field(default_factory=list)
    timed_offsets: list[int] = field(default_factory=list)
    object_values: dict[str, str] = field(default_factory=dict)
    timed_values: list[tuple[int, str, str]] = field(default_factory=list)
    uncertain: list[str] = field(default_factory=list)
    uncertain_offsets: list[int] = field(default_factory=list)
    _facts: Fitting = field(default_factory=Fitting)
    _functions: Fitting = field(default_factory=Fitting)
    _values: dict[str, float] = field(default_factory=dict)

    def read(self, section: Group) -> None:
        """Read the section. Raises `PddlSyntaxError` for what is not PDDL; reports what does not fit."""
        only = section[1] if len(section) == 2 else None
        if isinstance(only, Group) and only.word(0) == "and" and not self.scope.is_predicate("and"):
            section = only  # contingent problems have their initial state in one conjunction
        for index in range(1, len(section)):
            group = section[index]
            if not isinstance(group, Group):
                raise self.scope.error(f"a fact is in brackets, like ({group})", section, index)
            values = self._facts.values(group)
            if values is not None:
                self.entries.append(trusted_fact(str(group[0]), values, arguments=tuple(group[1:])))
            elif group.word(0) == "at" and len(group) == 3 and isinstance(group[2], Group):
                if self._is_object_value(group[2], ("=", "assign")):
                    self.timed_values.append((self._time(group), *self._object_value(group[2])))
                    continue
                self.timed.append((self._time(group), self._entry(group[2], timed=True)))
                self.timed_offsets.append(group.start)
                continue
            elif self._is_kept(group):
                continue
            else:
                self.entries.append(self._entry(group))
            self.offsets.append(group.start)
        self._check_contradictions()

    def _is_kept(self, group: Group) -> bool:
        """Read a part that is stored as text; return False for any other."""
        scope, word = self.scope, group.word(0)
        if self._is_object_value(group, ("=",)):
            name, text = self._object_value(group)
            if self.object_values.setdefault(name, text) != text:
                scope.diagnose(InvalidKnowledge, f"{text}: the function was given another value before", group)
            return True
        if word in UNCERTAIN and not (scope.is_predicate(word) and group.is_flat()):
            if len(group) < 2 or (word == "unknown" and len(group) != 2):
                raise scope.error(f"({word} ...) takes {_TAKES[word]}, not {node_text(group, 60)}", group)
            for index in range(1, len(group)):
                part = group[index]
                if not isinstance(part, Group):
                    raise scope.error(f"({word} ...) takes {_TAKES[word]}, not {part}", group, index)
                ConditionReader(scope, frozenset()).read(part)
            self.uncertain.append(node_text(group))
            self.uncertain_offsets.append(group.start)
            return True
        return False

    def _is_object_value(self, group: Group, words: tuple[str, ...]) -> bool:
        """Return whether a group gives an object fluent its value."""
        return group.word(0) in words and len(group) == 3 and self.scope.is_object_term(group[1])

    def _object_value(self, group: Group) -> tuple[str, str]:
        """Read an object fluent's value: its term as a key, and the equation as text."""
        read = EffectReader(self.scope, ConditionReader(self.scope, frozenset()), frozenset()).object_assignment
        assigned = read(group, NO_VARIABLES)
        return key(str(assigned.function)), f"(= {assigned.function} {assigned.value})"

    def _time(self, group: Group) -> int:
        """Read the time of a timed literal, in nanoseconds."""
        word = group[1]
        if not isinstance(word, str) or not NUMBER.fullmatch(word):
            raise self.scope.error(
                f"a timed literal is (at 12.5 (fact)), with a number of seconds, not {node_text(word, 60)}", group, 1
            )
        try:
            time = seconds(word)
        except InvalidTime as error:
            raise self.scope.error(str(error), group, 1) from None
        if time < 0:
            raise self.scope.error(f"the time {word} lies before the initial state", group, 1)
        return time

    def _entry(self, group: Group, *, timed: bool = False) -> Entry:
        word = group.word(0)
        if word == "=" or (timed and word == "assign" and len(group) == 3 and not group.is_flat()):
            return self._value(group, timed=timed)
        if timed and word in ASSIGNMENTS and len(group) == 3 and isinstance(group[1], Group):
            raise self.scope.error(
                f"a change relative to a value cannot be scheduled: {node_text(group, 60)}; give the value itself, as "
                "(at 5 (= (f a) 3))",
                group,
            )
        if word == "not" and len(group) == 2 and isinstance(group[1], Group) and group[1].word(0) != "=":
            return self._fact(group[1], is_negative=True)
        if not group or word in ("not", "and") or (word == "at" and not group.is_flat()):
            raise self.scope.error(
                "the initial state lists facts (p a), negative facts (not (p a)), values (= (f a) 3) and timed ones "
                f"(at 5 (p a)), not {node_text(group, 60)}",
                group,
            )
        return self._fact(group, is_negative=False)

    def _fact(self, group: Group, *, is_negative: bool) -> Fact:
        scope = self.scope
        name = scope.name(group, 0, "predicate")
        is_derived = scope.domain is not None and scope.domain.is_derived(name)
        if is_derived:
            scope.diagnose(InvalidKnowledge, f"{name} is derived by rules, and cannot be asserted", group)
        values = self._checked(group, scope.predicate(name, group), Fitting() if is_derived else self._facts)
        return trusted_fact(name, values, is_negative=is_negative)

    def _value(self, group: Group, *, timed: bool) -> Function:
        scope = self.scope
        if len(group) != 3:
            raise scope.error(f"the value of a function is (= (f a) 3), not {node_text(group, 60)}", group)
        value = number_at(scope, group, 2)
        if value is None:
            raise scope.error(f"the value of a function is a number here, not {node_text(group[2], 60)}", group, 2)
        term = function_group(scope, group, 1)
        values = self._functions.values(term)
        if values is None:
            name = scope.name(term, 0, "numeric function")
            if NUMBER.fullmatch(name):
                raise scope.error("a function and its value are expected here, not two numbers", group)
            values = self._checked(term, scope.function(name, term), self._functions)
        if not timed and self._values.setdefault(" ".join(map(str, term)).lower(), value) != value:
            scope.diagnose(InvalidKnowledge, f"{node_text(group)}: the function was given another value before", group)
        return Function.trusted(
            initial_time=0,
            is_negative=False,
            attribute_name=str(term[0]),
            values=values,
            knowledge_type=KnowledgeType.FUNCTION,
            function_value=value,
            assign_op=AssignOp.ASSIGN,
            rate=0.0,
        )

    def _checked(self, term: Group, signature: Signature | None, fitting: Fitting) -> Values:
        """Return the labelled arguments of a term, and report each that does not fit."""
        before = self.scope.diagnosed
        atom = self.scope.atom(term, signature, NO_VARIABLES, asserted=True)
        values = labelled(atom.arguments, signature)
        is_known = signature is not None or self.scope.domain is None
        if is_known and self.scope.diagnosed == before and not any(map(is_wildcard, atom.arguments)):
            fitting.add(atom.name, values)
        return values

    def _check_contradictions(self) -> None:
        """Report facts that are both asserted and denied."""
        facts = [
            (entry, offset) for entry, offset in zip(self.entries, self.offsets, strict=True) if type(entry) is Fact
        ]
        denied = {entry.key for entry, _ in facts if entry.is_negative}
        for entry, offset in facts if denied else ():
            if not entry.is_negative and entry.key in denied:
                self.scope.diagnose_at(InvalidKnowledge, f"both {entry} and (not {entry}) are asserted", offset)
