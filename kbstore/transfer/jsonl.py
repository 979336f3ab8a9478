"""The JSON Lines that a knowledge base is exported to, and how far they are believed when they are read.

The first line is a header, the last one says how many rows there were, and each line between is one row of a table,
with its times and transactions as they are stored. What is null is left out; so is the end time of what is open.
Every line ends with a checksum over itself and all lines before it (CRC-32), so that of a file that was cut off or
altered the line is known from which on it cannot be trusted.
"""

import json
import math
import re
from array import array
from bisect import bisect_left
from collections.abc import Iterator, Mapping, Sequence
from typing import IO, Any, Final, NoReturn
from zlib import crc32

from kbstore.clock import OPEN, TIME_LIMIT
from kbstore.errors import InvalidKnowledge, SchemaTooNew
from kbstore.messages import ComparisonType, KnowledgeType
from kbstore.model.timelines import EndCause, Role, stored_key
from kbstore.names import key
from kbstore.storage import tables
from kbstore.storage.assertion_queries import HEAD_COLUMNS
from kbstore.storage.records import Head
from kbstore.transfer.queries import HEAD, TransferColumn, by_table
from kbstore.transfer.rows import Record

VERSION = 1
"""The version of the format that is written; the latest that is read."""

_FORMAT: Final = "kbstore knowledge base"
_LONGEST_LINE: Final = 2**28
_SEAL = re.compile(rb', "check": "([0-9a-f]{8})"\}\n?\Z')
_WHOLE_NUMBERS: Final = range(2**63)

_CHOICES: dict[str, frozenset[object]] = {
    "role": frozenset(map(int, Role)),
    "knowledge_type": frozenset(map(int, KnowledgeType)),
    "comparison_type": frozenset(map(int, ComparisonType)),
    "end_cause": frozenset(map(int, EndCause)),
    "outcome": frozenset(("ended", "aborted")),
}
_KINDS: dict[str, int] = {table.name: int(kind) for kind, table in tables.assertion_tables.items()}
_TIMELINES: Final = ("timeline_id", "object_id")
_TRANSACTIONS: Final = ("recorded_tx", "ended_tx", "retired_tx", "told_tx", "tx")


class JsonLinesWriter:
    """Writes the lines of one knowledge base."""

    def __init__(self, stream: IO[bytes]) -> None:
        self._stream = stream
        self._seal = 0
        self._rows = 0

    def header(self, name: str, head: Head, rows: Mapping[str, int], *, use_unknowns: bool) -> None:
        """The first line: what the knowledge base is, and how many rows of each table follow."""
        about = {"name": name, "use_unknowns": use_unknowns} | _named(head)
        self._write({"format": _FORMAT, "version": VERSION, **about, "rows": rows})

    def records(self, table: str, records: Sequence[Record]) -> None:
        """Rows of a table."""
        for record in records:
            shown = {name: value for name, value in record.items() if value is not None}
            if shown.get("end_time") == OPEN:
                del shown["end_time"]
            self._write({"table": table, **shown})
        self._rows += len(records)

    def end(self) -> int:
        """The last line. Returns the number of rows."""
        self._write({"end": self._rows})
        return self._rows

    def _write(self, line: dict[str, object]) -> None:
        body = json.dumps(line, ensure_ascii=False, allow_nan=False).encode()[:-1]
        self._seal = crc32(body, self._seal)
        self._stream.write(body + b', "check": "%08x"}\n' % self._seal)


class JsonLinesReader:
    """Reads the lines of one knowledge base, each checked before it is believed.

    Every refusal is an `InvalidKnowledge` that names the line.
    """

    def __init__(self, stream: IO[bytes], label: str) -> None:
        self._stream = stream
        self._label = label
        self._number = 0
        self._seal = 0
        self._left: dict[str, int] = {}
        self._head: dict[str, int] = {}
        self._versions = 0
        self._time = 0
        # what rows refer to: 17 bytes a timeline, 8 a transaction
        self._timelines = array("q")
        self._kinds = array("b")
        self._transactions = array("q")

    def header(self) -> dict[str, Any]:
        """The first line. Raises `SchemaTooNew` for a format that this kbstore does not know."""
        line = self._line("a line about a knowledge base")
        if line.get("format") != _FORMAT or type(line.get("version")) is not int:
            self._refuse("is not the beginning of an export of a knowledge base; make one: kbstore export")
        if line["version"] > VERSION:
            raise SchemaTooNew(
                f"{self._label} has version {line['version']} of the format, this kbstore reads {VERSION}; "
                "upgrade kbstore: pip install --upgrade kbstore"
            )
        rows = line.get("rows")
        if not (
            _is_text(line.get("name"))
            and type(line.get("use_unknowns")) is bool
            and all(_is_number(line.get(column)) for column in HEAD)
            and max(line["last_time"], line["history_from"]) < TIME_LIMIT
            and isinstance(rows, dict)
            and rows.keys() == by_table.keys()
            and all(map(_is_number, rows.values()))
        ):
            self._refuse("is not a header as kbstore writes it")
        self._left = rows
        self._head = {name: line[name] for name in HEAD}
        return line

    @property
    def head(self) -> Head:
        """The head, as given in the first line."""
        return Head(*(self._head.get(name) for name in HEAD_COLUMNS))  # type: ignore[arg-type]

    def records(self, table: str) -> Iterator[Record]:
        """The rows of the next table."""
        columns = by_table[table].columns
        names = {column.name for column in columns}
        for _ in range(self._left[table]):
            line = self._line(f"a row of {table}")
            if line.pop("table", None) != table or not line.keys() <= names:
                self._refuse(f"is not a row of {table}, where that was expected")
            record = {column.name: self._value(column, line.get(column.name)) for column in columns}
            self._check(table, record)
            yield record

    def end(self) -> None:
        """The last line, and nothing after it."""
        if self._line("the last line").get("end") != sum(self._left.values()):
            self._refuse("is not the last line, where that was expected")
        if self._versions != self._head["domain_version"]:
            self._refuse(f"ends a file with {self._versions} versions of the domain, which the first line contradicts")
        self._number += 1
        if self._stream.read(1):
            self._refuse("comes after the last one")

    def _line(self, what: str) -> dict[str, Any]:
        self._number += 1
        text = self._stream.readline(_LONGEST_LINE)
        if not isinstance(text, bytes):
            raise InvalidKnowledge(f"{self._label} is open as text; open it in binary mode: open(path, 'rb')")
        if not text:
            self._refuse(f"is missing: the file was cut off where {what} was expected")
        seal = _SEAL.search(text[-32:])
        body = text[: len(text) - len(seal.group())] if seal else b""
        self._seal = crc32(body, self._seal)
        if seal is None or self._seal != int(seal.group(1), 16):
            if self._number == 1 and seal is None:
                self._refuse("is not the beginning of an export of a knowledge base; make one: kbstore export")
            self._refuse("was cut off or altered, or something before it is missing: its checksum does not fit")
        try:
            line = json.loads(body + b"}", parse_constant=_no_constant)
        except (ValueError, RecursionError):
            line = None
        if not isinstance(line, dict):
            self._refuse("is not JSON as kbstore writes it")
        return line

    # -- what is believed -------------------------------------------------------------------------------------

    def _value(self, column: TransferColumn, value: Any) -> Any:
        if value is None and column.name == "end_time":
            return OPEN
        if value is None and column.nullable:
            return None
        choices = _CHOICES.get(column.name)
        fits = type(value) is column.type and (choices is None or value in choices)
        if fits and column.type is int:
            fits = value in _WHOLE_NUMBERS and (not column.name.endswith("_time") or value < TIME_LIMIT)
        elif fits and column.type is float:
            fits = math.isfinite(value)
        elif fits and column.type is str:
            fits = _is_text(value)
        if not fits:
            self._refuse(f"has {value!r:.60} as {column.name}, which does not fit")
        return value

    def _check(self, table: str, record: Record) -> None:
        """Check that what a row refers to is in the file, and that it follows the row before where it has to."""
        match table:
            case "timelines":
                self._follows(self._timelines, record["id"])
                self._kinds.append(record["knowledge_type"])
                if record["id"] > self._head["last_timeline"]:
                    self._refuse("is a timeline after the last one that the first line names")
                if record["spelling"] is not None and stored_key(key(record["spelling"])) != record["key"]:
                    self._refuse("has a spelling that is not that of its key")
            case "transactions":
                self._follows(self._transactions, record["number"])
                if not self._time <= record["recorded_time"] <= self._head["last_time"]:
                    self._refuse("has a time before that of the transaction before, or after the last one")
                self._time = record["recorded_time"]
                if record["number"] > self._head["last_number"]:
                    self._refuse("is a transaction after the last one that the first line names")
            case "runs":
                if record["number"] > self._head["last_run"]:
                    self._refuse("is a run after the last one that the first line names")
            case "domains":
                self._versions += 1
                if record["version"] != self._versions or not _is_list(record["sensed"]):
                    self._refuse(f"is not version {self._versions} of the domain, where that was expected")
        for name in _TIMELINES:
            if name in record:
                place = _place(self._timelines, record[name])
                if place is None or self._kinds[place] != _KINDS.get(table, self._kinds[place]):
                    self._refuse(f"names {record[name]} as its timeline, which does not fit")
        for name in _TRANSACTIONS:
            number = record.get(name)
            if number is not None and _place(self._transactions, number) is None:
                self._refuse(f"names the transaction {number}, which the file does not have")

    def _follows(self, numbers: "array[int]", number: int) -> None:
        if numbers and number <= numbers[-1]:
            self._refuse(f"has the number {number}, which does not follow {numbers[-1]}")
        numbers.append(number)

    def _refuse(self, problem: str) -> NoReturn:
        raise InvalidKnowledge(f"{self._label}: line {self._number} {problem}; nothing has been imported")


def _named(head: Head) -> dict[str, object]:
    columns = dict(zip(HEAD_COLUMNS, head, strict=True))
    return {name: columns[name] for name in HEAD}


def _place(numbers: "array[int]", wanted: int) -> int | None:
    place = bisect_left(numbers, wanted)
    return place if place < len(numbers) and numbers[place] == wanted else None


def _is_number(value: object) -> bool:
    return type(value) is int and value in _WHOLE_NUMBERS


def _is_text(value: object) -> bool:
    """Return whether it is text that every database takes: no halves of characters, no NUL."""
    return (
        type(value) is str and "\0" not in value and not any("\ud800" <= character <= "\udfff" for character in value)
    )


def _is_list(text: str) -> bool:
    try:
        return isinstance(json.loads(text), list)
    except (ValueError, RecursionError):
        return False


def _no_constant(text: str) -> NoReturn:
    raise ValueError(text)
