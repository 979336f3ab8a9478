"""JSON Lines codec for the export of a knowledge base, with checks of each line that is read.

The first line is a header, the last one has the number of rows, and each line between is one row of a table, with its
times and transactions as they are stored. Null is left out, and so is an open end time. Every line ends with a checksum
over itself and all lines before it (CRC-32), so that the first line is known from which on a file was cut off or
altered.
"""

import json
import re
from collections.abc import Iterator, Mapping, Sequence
from typing import IO, Any, Final, NoReturn
from zlib import crc32

from kbstore.clock import OPEN, TIME_LIMIT
from kbstore.errors import InvalidKnowledge, SchemaTooNew
from kbstore.storage.assertion_queries import HEAD_COLUMNS
from kbstore.storage.records import Head
from kbstore.transfer.queries import COPIED_HEAD, by_table
from kbstore.transfer.row_checks import WHOLE_NUMBERS, RowChecks, is_text
from kbstore.transfer.rows import Record

VERSION = 1
"""The version of the format that is written, and the latest one that is read."""

_FORMAT: Final = "kbstore knowledge base"
_LONGEST_LINE: Final = 2**28
_SEAL = re.compile(rb', "check": "([0-9a-f]{8})"\}\n?\Z')

WAY_OUT: Final = "nothing has been imported; export the knowledge base again, and leave the file as it is"


class JsonLinesWriter:
    """Writes the lines of one knowledge base."""

    def __init__(self, stream: IO[bytes]) -> None:
        self._stream = stream
        self._seal = 0
        self._rows = 0

    def header(self, name: str, head: Head, rows: Mapping[str, int], *, use_unknowns: bool) -> None:
        """Write the first line: the knowledge base, and how many rows of each table follow."""
        about = {"name": name, "use_unknowns": use_unknowns} | _named(head)
        self._write({"format": _FORMAT, "version": VERSION, **about, "rows": rows})

    def records(self, table: str, records: Sequence[Record]) -> None:
        """Write rows of a table."""
        for record in records:
            shown = {name: value for name, value in record.items() if value is not None}
            if shown.get("end_time") == OPEN:
                del shown["end_time"]
            self._write({"table": table, **shown})
        self._rows += len(records)

    def end(self) -> int:
        """Write the last line, and return the number of rows."""
        self._write({"end": self._rows})
        return self._rows

    def _write(self, line: dict[str, object]) -> None:
        body = json.dumps(line, ensure_ascii=False, allow_nan=False).encode()[:-1]
        self._seal = crc32(body, self._seal)
        self._stream.write(body + b', "check": "%08x"}\n' % self._seal)


class JsonLinesReader:
    """Reads the lines of one knowledge base, and checks each.

    Every refusal is an `InvalidKnowledge` that names the line.
    """

    def __init__(self, stream: IO[bytes], label: str) -> None:
        self._stream = stream
        self._label = label
        self._number = 0
        self._seal = 0
        self._rows: dict[str, int] = {}
        self._head: dict[str, int] = {}
        self._checks: RowChecks

    def header(self) -> dict[str, Any]:
        """Read the first line. Raises `SchemaTooNew` for a format that this kbstore does not know."""
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
            line.keys() == {"format", "version", "name", "use_unknowns", *COPIED_HEAD, "rows"}
            and is_text(line["name"])
            and type(line["use_unknowns"]) is bool
            and all(_is_number(line[column]) for column in COPIED_HEAD)
            and max(line["last_time"], line["history_from"]) < TIME_LIMIT
            and isinstance(rows, dict)
            and rows.keys() == by_table.keys()
            and all(map(_is_number, rows.values()))
        ):
            self._refuse("is not a header as kbstore writes it")
        self._rows = rows
        self._head = {name: line[name] for name in COPIED_HEAD}
        self._checks = RowChecks(self._head, rows, self._refuse)
        return line

    @property
    def head(self) -> Head:
        """The head, as given in the first line."""
        return Head(*(self._head.get(name) for name in HEAD_COLUMNS))  # type: ignore[arg-type]

    @property
    def gone(self) -> int:
        """The last transaction whose history may have been archived; known when all rows have been read."""
        return self._checks.gone

    def records(self, table: str) -> Iterator[Record]:
        """Read the rows of the next table."""
        names = {column.name for column in by_table[table].columns}
        for _ in range(self._rows[table]):
            line = self._line(f"a row of {table}")
            if line.pop("table", None) != table:
                self._refuse(f"is not a row of {table}, where that was expected")
            unknown = sorted(line.keys() - names)
            if unknown:
                self._refuse(
                    f"has {unknown[0]!r:.60}, which a row of {table} has not; it has {', '.join(sorted(names))}"
                )
            yield self._checks.check(table, line)

    def end(self) -> None:
        """Read the last line, and check that nothing follows."""
        if self._line("the last line") != {"end": sum(self._rows.values())}:
            self._refuse("is not the last line, where that was expected")
        self._checks.end()
        self._number += 1
        if self._stream.read(1):
            self._refuse("comes after the last one")

    def refuse(self, line: int, problem: str) -> NoReturn:
        """Refuse a line that has been read."""
        self._number = line
        self._refuse(problem)

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

    def _refuse(self, problem: str) -> NoReturn:
        raise InvalidKnowledge(f"{self._label}: line {self._number} {problem}; {WAY_OUT}")


def _named(head: Head) -> dict[str, object]:
    columns = dict(zip(HEAD_COLUMNS, head, strict=True))
    return {name: columns[name] for name in COPIED_HEAD}


def _is_number(value: object) -> bool:
    return type(value) is int and value in WHOLE_NUMBERS


def _no_constant(text: str) -> NoReturn:
    raise ValueError(text)
