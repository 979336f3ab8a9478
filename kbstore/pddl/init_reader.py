"""The initial state of a problem: facts, values, and timed-initial literals and fluents.

Nearly all of a large problem consists of facts, so these take a short path: an argument that has once been found to
fit a parameter is from then on one look-up, which gives the labelled value that all its facts share.
"""

from dataclasses import dataclass, field

from kbstore.clock import seconds
from kbstore.domain import Signature
from kbstore.errors import InvalidKnowledge, InvalidTime
from kbstore.logic import Atom
from kbstore.messages import Fact, Function, KeyValue, KnowledgeType
from kbstore.names import is_wildcard, key
from kbstore.pddl.context import Context
from kbstore.pddl.effects import function_group
from kbstore.pddl.expressions import NUMBER, number_at
from kbstore.pddl.item_reader import fact_of, function_of
from kbstore.pddl.sexpr import Group, node_text

Entry = Fact | Function
_Fitting = list[dict[str, KeyValue]]
"""For each parameter of a predicate, the arguments that are known to fit, with their labels."""


@dataclass
class InitReader:
    """Reads an ``(:init ...)`` section into `facts` and `timed` (with times in nanoseconds), with their offsets."""

    context: Context
    entries: list[Entry] = field(default_factory=list)
    offsets: list[int] = field(default_factory=list)
    timed: list[tuple[int, Entry]] = field(default_factory=list)
    timed_offsets: list[int] = field(default_factory=list)
    _fitting: dict[str, _Fitting] = field(default_factory=dict)
    _values: dict[tuple[str, ...], float] = field(default_factory=dict)

    def read(self, section: Group) -> None:
        """Read the section. Raises `PddlSyntaxError` for what is not PDDL, and complains of what does not fit."""
        entries, offsets, fitting = self.entries, self.offsets, self._fitting
        for index in range(1, len(section)):
            group = section[index]
            if not isinstance(group, Group):
                raise self.context.error(f"a fact stands in brackets, like ({group})", section, index)
            try:
                parameters = fitting[group[0]]  # type: ignore[index]
                if len(group) == len(parameters) + 1:
                    values = tuple([known[name] for known, name in zip(parameters, group[1:], strict=True)])  # type: ignore[index]
                    entries.append(
                        Fact.trusted(
                            initial_time=0,
                            is_negative=False,
                            attribute_name=group[0],
                            values=values,
                            knowledge_type=KnowledgeType.FACT,
                        )
                    )
                    offsets.append(group.start)
                    continue
            except (LookupError, TypeError):  # not seen before, or a group where only a name has been seen
                pass
            self._read_slowly(group)
        self._check_contradictions()

    def _read_slowly(self, group: Group) -> None:
        if group.word(0) == "at" and len(group) == 3 and isinstance(group[2], Group):
            self.timed.append((self._time(group), self._entry(group[2], timed=True)))
            self.timed_offsets.append(group.start)
            return
        self.entries.append(self._entry(group))
        self.offsets.append(group.start)

    def _time(self, group: Group) -> int:
        """The time of a timed literal, in nanoseconds."""
        word = group[1]
        if not isinstance(word, str) or not NUMBER.fullmatch(word):
            raise self.context.error(
                f"a timed literal is (at 12.5 (fact)), with a number of seconds, not {node_text(word, 60)}", group, 1
            )
        try:
            time = seconds(word)
        except InvalidTime as error:
            raise self.context.error(str(error), group, 1) from None
        if time < 0:
            raise self.context.error(f"the time {word} lies before the initial state", group, 1)
        return time

    def _entry(self, group: Group, *, timed: bool = False) -> Entry:
        context, word = self.context, group.word(0)
        if word == "=":
            return self._value(group, timed=timed)
        if word == "not" and len(group) == 2 and isinstance(group[1], Group) and group[1].word(0) != "=":
            return self._fact(group[1], is_negative=True)
        if not group or word in ("not", "and") or (word == "at" and not context.is_predicate("at")):
            raise context.error(
                "the initial state lists facts (p a), negative facts (not (p a)), values (= (f a) 3) and timed ones "
                f"(at 5 (p a)), not {node_text(group, 60)}",
                group,
            )
        return self._fact(group, is_negative=False)

    def _fact(self, group: Group, *, is_negative: bool) -> Fact:
        context = self.context
        name = context.name(group, 0, "predicate")
        signature = context.predicate(name, group)
        if context.domain is not None and context.domain.is_derived(name):
            context.complain(InvalidKnowledge, f"{name} is derived by rules, and cannot be told", group)
        atom = context.atom(group, signature, asserted=True)
        fact = fact_of(atom, signature, is_negative)
        self._remember(atom, signature, fact)
        return fact

    def _remember(self, atom: Atom, signature: Signature | None, fact: Fact) -> None:
        """Let the arguments that fit take the short path from now on."""
        context = self.context
        if context.domain is not None and (
            signature is None
            or context.domain.is_derived(atom.name)
            or len(signature.parameters) != len(atom.arguments)
        ):
            return
        parameters = self._fitting.setdefault(atom.name, [{} for _ in atom.arguments])
        if atom.name in ("=", "not", "and") or len(parameters) != len(atom.arguments):
            return
        for index, (known, value) in enumerate(zip(parameters, fact.values, strict=True)):
            parameter = signature.parameters[index] if signature else None
            if not is_wildcard(value.value) and context.misfit(value.value, {}, parameter, asserted=True) is None:
                known[value.value] = value

    def _value(self, group: Group, *, timed: bool) -> Function:
        context = self.context
        if len(group) != 3:
            raise context.error(f"the value of a function is (= (f a) 3), not {node_text(group, 60)}", group)
        value = number_at(context, group, 2)
        if value is None:
            raise context.error(f"the value of a function is a number here, not {node_text(group[2], 60)}", group, 2)
        term = function_group(context, group, 1)
        name = context.name(term, 0, "numeric function")
        if NUMBER.fullmatch(name):
            raise context.error("a function and its value are expected here, not two numbers", group)
        signature = context.function(name, term)
        atom = context.atom(term, signature, asserted=True)
        if not timed:
            terms = tuple(map(key, (atom.name, *atom.arguments)))
            if self._values.setdefault(terms, value) != value:
                context.complain(InvalidKnowledge, f"{node_text(group)}: {atom} has another value before", group)
        return function_of(atom, signature, value)

    def _check_contradictions(self) -> None:
        """Complain of facts that are both told and denied."""
        negative = [entry for entry in self.entries if isinstance(entry, Fact) and entry.is_negative]
        if not negative:
            return
        denied = {entry.key for entry in negative}
        for entry, offset in zip(self.entries, self.offsets, strict=True):
            if isinstance(entry, Fact) and not entry.is_negative and entry.key in denied:
                group = Group()
                group.start = offset
                self.context.complain(InvalidKnowledge, f"both {entry} and (not {entry}) are told", group)
