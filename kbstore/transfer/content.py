"""Checks that an import contains what could have been recorded: names, domains, texts, types, derived ends.

Timelines are read one after another, with their rows in the order of time. An end that no transaction made follows
from other rows (rules V1, C9): it is derived again, and compared.
"""

import json
from bisect import bisect_right
from collections.abc import Iterator, Mapping, Sequence
from functools import lru_cache
from typing import Any, NamedTuple

from kbstore.clock import OPEN
from kbstore.errors import KbStoreError
from kbstore.messages import ComparisonType, KnowledgeType
from kbstore.model.domain import Domain
from kbstore.model.formulas import Comparison
from kbstore.model.lifespans import Lifespan, joined
from kbstore.model.symbols import InferredSignature, SymbolTable
from kbstore.model.timelines import METRIC_KEY, Role, Timeline, stored_key
from kbstore.names import key, problem
from kbstore.pddl.domain_reader import read_domain
from kbstore.pddl.parse import parse_condition, parse_expression, parse_initial, parse_stored
from kbstore.pddl.printer import condition_text, expression_text
from kbstore.reading.mentions import mentions
from kbstore.storage import tables
from kbstore.transfer import scratch_queries as queries
from kbstore.transfer.consistency import Contradiction
from kbstore.transfer.scratch import Scratch
from kbstore.writing.resolution import can_be_read_back

_KINDS: Mapping[Role, frozenset[KnowledgeType]] = {
    Role.STATE: frozenset(KnowledgeType),
    Role.GOAL: frozenset((KnowledgeType.FACT, KnowledgeType.EXPRESSION, KnowledgeType.INEQUALITY)),
    Role.CONSTRAINT: frozenset((KnowledgeType.EXPRESSION,)),
    Role.LOAD: frozenset((KnowledgeType.EXPRESSION,)),
}
"""The knowledge types of each role."""

_ATOMS = (KnowledgeType.FACT, KnowledgeType.FUNCTION)

_TABLES = {kind: table.name for kind, table in tables.assertion_tables.items()}

_LIFESPANS = 100_000
"""The number of objects whose lifespans are held in memory."""


class Version(NamedTuple):
    """A version of the domain, in force from a time on; the first version is that without a domain."""

    time: int
    symbols: SymbolTable


class _Row(NamedTuple):
    """A row of a timeline."""

    recorded_tx: int
    seq: int
    start: int
    end: int
    ended: int | None
    retired: int | None
    value: tuple[Any, ...]


class _Wrong(Exception):
    """Raised for the fault of a row, or of a timeline if there is no row."""

    def __init__(self, sentence: str, row: _Row | None = None) -> None:
        super().__init__(sentence)
        self.row = row


class Content:
    """Checks the content of a scratch file, which has history from the time `since` on."""

    def __init__(self, scratch: Scratch, since: int) -> None:
        self._scratch = scratch
        self._since = since
        self._versions = [Version(0, SymbolTable())]
        self.existences = lru_cache(maxsize=_LIFESPANS)(self._existences)

    def contradictions(self) -> Iterator[Contradiction]:
        """Yield the rows that no store would have accepted, in the order of the tables."""
        for check in (self._domains, self._symbols, self._timelines, self._runs):
            yield from check()

    # -- symbols ----------------------------------------------------------------------------------------------

    def _domains(self) -> Iterator[Contradiction]:
        for version, time, domain_name, source, sensed in self._scratch.rows(queries.domains):
            try:
                domain = read_domain(source)
                marked = json.loads(sensed)
                if domain.name != domain_name:
                    raise _Wrong(f"has a domain of another name than {domain_name!r:.80}")
                for name in marked:
                    domain.is_sensed(name)
                    if key(name) != name:
                        raise _Wrong(f"has {name!r:.80} as sensed, where {key(name)!r:.80} is expected")
            except (KbStoreError, _Wrong) as error:
                yield Contradiction("domains", [version], _sentence("has a domain that cannot be read", error))
                return
            self._versions.append(Version(time, SymbolTable(domain.marked(marked))))

    def _symbols(self) -> Iterator[Contradiction]:
        inferred = self._versions[0].symbols.inferred
        for number, name_key, name, arity, labels in self._scratch.rows(queries.symbols):
            kind, given = KnowledgeType(number), labels.split()
            wrong = problem(name)
            if kind not in _ATOMS or key(name) != name_key or wrong:
                sentence = f"has the symbol {name!r:.80} with the key {name_key!r:.80}, {wrong or 'which does not fit'}"
            elif arity > _MOST_ARGUMENTS or not can_be_read_back(kind, name, arity):
                sentence = f"has the symbol {name!r:.80} with {arity} arguments, which PDDL text cannot have"
            elif labels != " ".join(given) or (given and len(set(map(key, given))) != arity):
                sentence = f"has the labels {labels!r:.80}, which are not {arity} different ones"
            else:
                inferred[kind, name_key] = InferredSignature(name, arity, tuple(given) or None)
                continue
            yield Contradiction("symbols", [number, name_key], sentence)

    # -- timelines --------------------------------------------------------------------------------------------

    def _timelines(self) -> Iterator[Contradiction]:
        for id, role, kind, text, spelling in self._scratch.rows(queries.timelines):
            if kind not in _KINDS[Role(role)]:
                yield Contradiction("timelines", [id], "has a role that its knowledge type cannot have")
                continue
            timeline = Timeline(id, role, kind, text, spelling)
            try:
                _check_spelling(timeline, text)
                self._check_rows(timeline)
            except _Wrong as wrong:
                row = wrong.row
                where, place = ("timelines", [id]) if row is None else (_TABLES[timeline.kind], [*row[:2]])
                yield Contradiction(where, place, str(wrong))

    def _check_rows(self, timeline: Timeline) -> None:
        # archived rows of a metric or a constraint may have mentioned other objects
        is_fixed = timeline.kind is not KnowledgeType.EXPRESSION or timeline.role is Role.GOAL
        mentioned = set(mentions(timeline, ())) if is_fixed else set[str]()
        before: _Row | None = None
        emptied = self._emptied(timeline)
        for row in self._rows(timeline):
            _check_value(timeline, row)
            mentioned.update(mentions(timeline, row.value))
            if row.retired is None:
                if before is not None:
                    self._check_end(timeline, before, row.start, emptied)
                before = row
                self._check_symbols(timeline, row)
        if before is not None:
            self._check_end(timeline, before, OPEN, emptied)
        known = {name for (name,) in self._scratch.rows(queries.mentioned, timeline=timeline.id)}
        if mentioned - known or (is_fixed and known - mentioned):
            names = ", ".join(sorted(mentioned)) or "none"
            raise _Wrong(f"is a timeline that mentions other objects than the lines in mentions say: {names:.200}")

    def _rows(self, timeline: Timeline) -> Iterator[_Row]:
        for row in self._scratch.rows(queries.assertions[timeline.kind], timeline=timeline.id):
            yield _Row._make((*row[:6], (bool(row[6]), *row[7:])))

    def _emptied(self, timeline: Timeline) -> list[int]:
        return [t for (t,) in self._scratch.rows(queries.emptied[timeline.kind], timeline=timeline.id)]

    def _check_end(self, timeline: Timeline, row: _Row, following: int, emptied: Sequence[int]) -> None:
        if row.end > following:
            raise _Wrong(f"holds until {row.end}, and a later one on its timeline begins at {following}", row)
        if row.ended is not None:
            return
        ends = [following, *emptied[(place := bisect_right(emptied, row.start)) : place + 1]]
        for name in mentions(timeline, row.value):
            spans = self.existences(name)
            place = bisect_right(spans, row.start, key=lambda span: span.end)
            ends += [span.end for span in spans[place : place + 1]]
        if row.end == min(ends) or (row.end < min(ends) and self._was_followed(timeline, row)):
            return
        expected = "no end_time" if min(ends) == OPEN else f"the end_time {min(ends)}"
        raise _Wrong(f"has an end that nothing makes; {expected} follows from the other lines", row)

    def _was_followed(self, timeline: Timeline, row: _Row) -> bool:
        """Return whether the cause of a row's end was superseded by late knowledge, or was a run (rule O5)."""
        if any(self._scratch.rows(queries.began_and_retired[timeline.kind], timeline=timeline.id, t=row.end)):
            return True
        if any(
            any(self._scratch.rows(queries.ended_and_retired, key=name, t=row.end))
            for name in mentions(timeline, row.value)
        ):
            return True
        # a number becomes undefined when its rate reads an undefined function
        return timeline.kind is KnowledgeType.FUNCTION and any(self._scratch.rows(queries.running, t=row.end))

    # -- domains ----------------------------------------------------------------------------------------------

    def _check_symbols(self, timeline: Timeline, row: _Row) -> None:
        """Check that a row fits each version of the domain that is in force while it holds (rule D4)."""
        for place, version in enumerate(self._versions):
            until = self._versions[place + 1].time if place + 1 < len(self._versions) else OPEN
            t = max(row.start, version.time, self._since)
            if t < min(row.end, until):
                try:
                    self._check_symbols_at(timeline, row, version.symbols, t)
                except KbStoreError as error:
                    raise _Wrong(_sentence("does not fit the domain", error), row) from error

    def _check_symbols_at(self, timeline: Timeline, row: _Row, symbols: SymbolTable, t: int) -> None:
        domain = symbols.domain
        match timeline.kind:
            case KnowledgeType.INSTANCE if domain is not None and not row.value[0]:
                if domain.constant_spelling(timeline.key) is not None:
                    raise _Wrong(f"is about {timeline.spelling}, which is a constant of the domain", row)
                domain.type_spelling(row.value[1])
            case KnowledgeType.FACT | KnowledgeType.FUNCTION:
                self._check_atom(timeline, row, symbols, t)
            case KnowledgeType.EXPRESSION if timeline.role is Role.STATE:
                parse_expression(row.value[2], domain)
            case KnowledgeType.EXPRESSION | KnowledgeType.INEQUALITY if timeline.role is not Role.CONSTRAINT:
                parse_condition(timeline.spelling, domain)
        if domain is not None and timeline.role is not Role.CONSTRAINT:
            for name in mentions(timeline, row.value):
                if self._type_at(domain, name, t) is None:
                    raise _Wrong(f"mentions {name}, which does not exist at {t}", row)

    def _check_atom(self, timeline: Timeline, row: _Row, symbols: SymbolTable, t: int) -> None:
        domain = symbols.domain
        symbols.ordered(timeline.kind, timeline.name, timeline.arguments, ())
        if domain is None:
            if (timeline.kind, timeline.keys[0]) not in symbols.inferred:
                raise _Wrong(f"has the symbol {timeline.name}, which no line in symbols has", row)
            return
        if timeline.kind is KnowledgeType.FACT and timeline.role is Role.STATE and domain.is_derived(timeline.name):
            raise _Wrong(f"states ({timeline.spelling}), which is derived in the domain", row)
        signature = symbols.signature(timeline.kind, timeline.name)
        assert signature is not None
        for name, parameter in zip(timeline.keys[1:], signature.parameters, strict=True):
            type_name = self._type_at(domain, name, t)
            if type_name is None or key(type_name) not in domain.subtypes(parameter.types):
                found = "does not exist" if type_name is None else f"is of type {type_name}"
                raise _Wrong(f"mentions {name}, which {found} at {t}; {parameter.type_text} is expected", row)

    def _type_at(self, domain: Domain, name: str, t: int) -> str | None:
        constant = domain.constant_types.get(name)
        if constant is not None:
            return constant
        spans = self.existences(name)
        place = bisect_right(spans, t, key=lambda span: span.start) - 1
        return spans[place].type_name if place >= 0 and t < spans[place].end else None

    def _existences(self, name: str) -> Sequence[Lifespan]:
        rows = self._scratch.rows(queries.existences, key=name)
        return tuple(joined(Lifespan(*row) for row in rows))

    # -- runs -------------------------------------------------------------------------------------------------

    def _runs(self) -> Iterator[Contradiction]:
        ends: dict[tuple[str, ...], int] = {}
        recorded = 0
        for number, transaction, start, end, operator, arguments in self._scratch.rows(queries.runs):
            words = (key(operator), *map(key, arguments.split(" ") if arguments else ()))
            sentence = _name_problem(operator, *(arguments.split(" ") if arguments else ()))
            if sentence is None and transaction < recorded:
                sentence = "is of a transaction before that of the run before"
            elif sentence is None and ends.get(words, 0) > start:
                sentence = f"is of ({operator} {arguments}), which runs already".replace(" )", ")")
            if sentence is None:
                sentence = self._action_problem(operator, words, start)
            if sentence is not None:
                yield Contradiction("runs", [number], sentence)
                return
            recorded, ends[words] = transaction, end

    def _action_problem(self, operator: str, words: Sequence[str], start: int) -> str | None:
        domain = [version for version in self._versions if version.time <= start][-1].symbols.domain
        if domain is None:
            return "was started without a domain"
        try:
            action = domain.action(operator)
        except KbStoreError as error:
            return _sentence("is of an action that the domain does not have", error)
        if not action.durative or len(action.parameters) != len(words) - 1:
            return f"is of ({' '.join(words)}), which is not a durative action of the domain"
        # its objects need not have existed, by late knowledge (rule L7)
        return None


_MOST_ARGUMENTS = 1000


def _check_spelling(timeline: Timeline, stored: str) -> None:
    """Check a timeline's PDDL: its key is that of its spelling, and its names can be names."""
    if stored_key(key(timeline.spelling)) != stored:
        raise _Wrong("has a spelling that is not that of its key")
    sentence = None
    match timeline.kind:
        case KnowledgeType.FACT | KnowledgeType.FUNCTION:
            sentence = _name_problem(*timeline.spelling.split(" "))
        case KnowledgeType.INSTANCE:
            sentence = _name_problem(timeline.spelling)
        case KnowledgeType.EXPRESSION if timeline.role is Role.STATE:
            sentence = None if stored == METRIC_KEY else f"has the key {stored!r:.80}; a metric has none"
        case _ if timeline.role in (Role.GOAL, Role.STATE):
            try:
                text = condition_text(parse_stored(timeline.spelling))
            except KbStoreError as error:
                raise _Wrong(_sentence("has a condition that cannot be read", error)) from error
            if text != timeline.spelling:
                sentence = f"has the condition {timeline.spelling!r:.80}, where {text!r:.80} is expected"
    if sentence is not None:
        raise _Wrong(sentence)


def _check_value(timeline: Timeline, row: _Row) -> None:
    value = row.value
    try:
        match timeline.kind:
            case KnowledgeType.INSTANCE:
                sentence = _name_problem(value[1])
            case KnowledgeType.INEQUALITY:
                sides = (parse_expression(side) for side in value[2:4])
                text = condition_text(Comparison(ComparisonType(value[1]), *sides))
                fits = text == timeline.spelling and value[4]
                sentence = None if fits else f"is {text:.80}, which is not what its timeline is about"
            case KnowledgeType.EXPRESSION:
                sentence = _formula_problem(timeline, *value[1:])
            case _:
                return
    except KbStoreError as error:
        sentence = _sentence("has a text that cannot be read", error)
    if sentence is not None:
        raise _Wrong(sentence, row)


def _formula_problem(timeline: Timeline, optimization: str, text: str) -> str | None:
    """Return the problem of the text of a metric, a goal or a constraint; None if there is none."""
    if timeline.role is Role.STATE:
        fits = optimization in ("minimize", "maximize") and expression_text(parse_expression(text)) == text
        return None if fits else f"is not a metric: {optimization!r:.80}, {text!r:.80}"
    if timeline.role is Role.LOAD or optimization:
        return f"says {optimization!r:.80} and {text!r:.80}, which its timeline cannot have"
    if timeline.role is Role.CONSTRAINT:
        parse_initial(text)
        return None
    return None if text == timeline.spelling else f"is {text!r:.80}, which is not what its timeline is about"


def _name_problem(*names: str) -> str | None:
    for name in names:
        wrong = problem(name)
        if wrong:
            return f"has the name {name!r:.80}, which {wrong}"
    return None


def _sentence(what: str, error: Exception) -> str:
    """Return an error in one sentence on one line."""
    return f"{what}: {' '.join(str(error).split()):.300}"
