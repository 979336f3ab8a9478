"""Checks a line of an export on its own, and against the lines before it.

Rows are in the order of their keys, refer only to earlier lines, and fit the first line's description of the whole.
Checks that need other rows are in `kbstore.transfer.consistency` and `kbstore.transfer.content`.
"""

import json
import math
from array import array
from bisect import bisect_left
from collections.abc import Callable, Mapping
from typing import Any, Final, NoReturn

from kbstore.clock import OPEN, SECOND, TIME_LIMIT
from kbstore.messages import ComparisonType, KnowledgeType
from kbstore.model.timelines import EndCause, Role
from kbstore.names import unstorable
from kbstore.storage import tables
from kbstore.storage.tables import PRESENT_SCHEDULES, RevisionKind
from kbstore.transfer.queries import TransferColumn, by_table
from kbstore.transfer.rows import Record

WHOLE_NUMBERS: Final = range(2**63)

_CHOICES: dict[str, frozenset[object]] = {
    "role": frozenset(map(int, Role)),
    "knowledge_type": frozenset(map(int, KnowledgeType)),
    "comparison_type": frozenset(map(int, ComparisonType)),
    "end_cause": frozenset(map(int, EndCause)),
    "outcome": frozenset(("ended", "aborted")),
    "what": frozenset(map(int, RevisionKind)),
}
_TIMES: Final = frozenset(("late_from", "duration", "end_before"))
_KINDS: dict[str, int] = {table.name: int(kind) for kind, table in tables.assertion_tables.items()}
_TIMELINES: Final = ("timeline_id", "object_id")
_TRANSACTIONS: Final = ("recorded_tx", "ended_tx", "retired_tx", "told_tx", "tx")
_TOKENS: Final = range(2**62)


class RowChecks:
    """Checks the rows of one file in their order. `refuse` raises, with the end of a sentence about the line.

    Attributes:
        gone: the last transaction whose history may have been archived.
    """

    def __init__(self, head: Mapping[str, int], rows: Mapping[str, int], refuse: Callable[[str], NoReturn]) -> None:
        self._head = head
        self._refuse = refuse
        self._versions = 0
        self._last_late = 0
        self._before: Record = {}
        self._table = ""
        # the targets of references: a byte for each timeline, 8 for each transaction
        self._kinds = array("b")
        self._transactions = array("q")
        self.gone = head["last_number"] if head["history_from"] else 0
        self._check_head(rows)

    def check(self, table: str, line: Mapping[str, Any]) -> Record:
        """Return the row of a line, if it can be one of a table."""
        queries = by_table[table]
        record = {column.name: self._value(column, line.get(column.name)) for column in queries.columns}
        if self._table != table:
            self._table, self._before = table, {}
        if self._before:
            key, before = ([row[name] for name in queries.key] for row in (record, self._before))
            if key <= before:
                self._refuse(
                    f"has the key {_shown(key)}, which does not follow that of the line before, {_shown(before)}"
                )
        match table:
            case "timelines":
                self._check_timeline(record)
            case "transactions":
                self._check_transaction(record)
            case "domains":
                self._check_domain(record)
            case "runs":
                self._check_run(record)
        self._check_references(table, record)
        self._before = record
        return record

    def end(self) -> None:
        """Check the lines against the first line."""
        head = self._head
        number, time, timeline = (head[name] for name in ("last_number", "last_time", "last_timeline"))
        last = self._transactions[-1] if self._transactions else 0
        if last != number and (time >= head["history_from"] or not number):
            self._refuse(f"ends a file whose last transaction is {last}, where the first line says {number}")
        if self._versions != head["domain_version"]:
            self._refuse(f"ends a file with {self._versions} versions of the domain, which the first line contradicts")
        if not (self._last_late == head["last_late"] or self._last_late < head["last_late"] <= self.gone):
            self._refuse(
                f"ends a file whose last late knowledge is of transaction {self._last_late}, not of the "
                f"{head['last_late']} that the first line says"
            )
        if last == number and len(self._kinds) != timeline:
            self._refuse(f"ends a file with {len(self._kinds)} timelines, where the first line says {timeline}")

    # -- values -----------------------------------------------------------------------------------------------

    def _value(self, column: TransferColumn, value: Any) -> Any:
        if value is None and column.name == "end_time":
            return OPEN
        if value is None and column.nullable:
            return None
        choices = _CHOICES.get(column.name)
        fits = type(value) is column.type and (choices is None or value in choices)
        if fits and column.type is int:
            fits = 0 <= value <= column.largest
            if _is_time(column):
                fits = 0 <= value < TIME_LIMIT or (column.name == "end_before" and value == OPEN)
        elif fits and column.type is float:
            fits = math.isfinite(value)
        elif fits and column.type is str:
            fits = is_text(value)
        if not fits:
            self._refuse(f"has {_shown(value)} as {column.name}, where {_expected(column)} is expected")
        return value

    # -- tables -----------------------------------------------------------------------------------------------

    def _check_head(self, rows: Mapping[str, int]) -> None:
        head = self._head
        present = sum(1 << kind for table, kind in _KINDS.items() if rows[table])
        present |= PRESENT_SCHEDULES if rows["schedules"] else 0
        # knowledge types that were there once, and are archived, count
        if present & ~head["present"] or head["present"] >= 2 * PRESENT_SCHEDULES:
            self._refuse(f"has {head['present']} as present, where {present} follows from the numbers of rows")
        if not head["last_number"] and (any(rows.values()) or any(head.values())):
            self._refuse("is of a knowledge base without transactions, but announces rows")
        if head["last_late"] > head["last_number"]:
            self._refuse("has a last_late after last_number")

    def _check_timeline(self, record: Record) -> None:
        expected = len(self._kinds) + 1
        if record["id"] != expected or expected > self._head["last_timeline"]:
            self._refuse(f"has the number {record['id']}; {expected} is expected, up to the last_timeline of line 1")
        self._kinds.append(record["knowledge_type"])

    def _check_transaction(self, record: Record) -> None:
        head, before = self._head, self._before
        number, time, since = record["number"], record["recorded_time"], head["history_from"]
        if number > head["last_number"]:
            self._refuse(f"is transaction {number}, after the last one of line 1, {head['last_number']}")
        if not before.get("recorded_time", 0) <= time <= head["last_time"]:
            self._refuse(
                f"has the time {time}, before that of the transaction before, or after the last_time of line 1"
            )
        if not since or (before and before["recorded_time"] >= since):
            expected = before.get("number", 0) + 1
            if number != expected:
                self._refuse(f"is transaction {number}; {expected} is expected, numbers have no gaps")
        elif time >= since:
            self.gone = number - 1
        if record["token"] not in _TOKENS:
            self._refuse(f"has the token {record['token']}; a number below 2**62 is expected")
        timelines = record["last_timeline"]
        if not before.get("last_timeline", 0) <= timelines <= len(self._kinds):
            self._refuse(
                f"has {timelines} as last_timeline, which is not that of the transaction before or a later one"
            )
        if number == head["last_number"] and (
            [record["token"], timelines] != [head[name] for name in ("last_token", "last_timeline")]
        ):
            self._refuse("is the last transaction, and not what line 1 says of it: last_token, last_timeline")
        if record["late_from"] is not None:
            if record["late_from"] >= time:
                self._refuse("has a late_from that is not before its time")
            self._last_late = number
        self._transactions.append(number)

    def _check_domain(self, record: Record) -> None:
        self._versions += 1
        if record["version"] != self._versions or not is_list_of_texts(record["sensed"]):
            self._refuse(f"is not version {self._versions} of the domain, with a list of texts as sensed")
        if self._before and record["recorded_tx"] <= self._before["recorded_tx"]:
            self._refuse("is of the transaction of the version before, or an earlier one")

    def _check_run(self, record: Record) -> None:
        if record["number"] > self._head["last_run"]:
            self._refuse(f"is run {record['number']}, after the last one of line 1, {self._head['last_run']}")
        if abs(record["duration_s"] * SECOND - record["duration"]) > 1 + record["duration"] * 1e-15:
            self._refuse("has a duration that is not duration_s in nanoseconds")

    def _check_references(self, table: str, record: Record) -> None:
        for name in _TIMELINES:
            if name in record:
                id = record[name]
                if not 1 <= id <= len(self._kinds) or self._kinds[id - 1] != _KINDS.get(table, self._kinds[id - 1]):
                    self._refuse(f"has {id} as {name}, which is no timeline of its type in the file")
        for name in _TRANSACTIONS:
            number = record.get(name)
            if number is not None and not self._has(number):
                self._refuse(f"has {number} as {name}, and the file has no such transaction")

    def _has(self, number: int) -> bool:
        place = bisect_left(self._transactions, number)
        return place < len(self._transactions) and self._transactions[place] == number


def is_text(value: object) -> bool:
    """Return whether a value is text that every database takes: no halves of characters, no NUL."""
    return type(value) is str and unstorable(value) is None


def is_list_of_texts(text: str) -> bool:
    """Return whether a text is a list of texts in JSON."""
    try:
        found = json.loads(text)
    except (ValueError, RecursionError):
        return False
    return isinstance(found, list) and all(map(is_text, found))


def _expected(column: TransferColumn) -> str:
    """Return the values that a column takes, in words."""
    choices = _CHOICES.get(column.name)
    if choices is not None:
        return f"one of {', '.join(map(repr, sorted(choices, key=str)))}"
    if column.type is int:
        return "a time, 0 <= t < 2**62," if _is_time(column) else f"a whole number up to {column.largest}"
    if column.type is float:
        return "a finite number with a decimal point"
    return {bool: "true or false", str: "text without NUL and halves of characters"}[column.type]


def _is_time(column: TransferColumn) -> bool:
    return column.name in _TIMES or column.name.endswith("_time")


def _shown(value: object) -> str:
    return f"{value!r:.60}"
