"""Draws a timeline as lanes of text, within the width of a terminal."""

from bisect import bisect_right
from collections import defaultdict
from collections.abc import Iterator, Sequence
from typing import Any

from rich.console import Console, ConsoleOptions, RenderResult
from rich.text import Text

from kbstore.clock import SECOND, isoformat
from kbstore.model.timelines import moved
from kbstore.names import key
from kbstore.report.tables import DIM, FALSE, NUMBER, SCHEDULED, TITLE, plural
from kbstore.report.time_format import DAY
from kbstore.report.timeline.data import Row
from kbstore.report.timeline.lanes import KINDS

Piece = tuple[int, int, Row]

WIDEST = 120
"""The most columns, also without a terminal; wider lanes are not easier to read."""

_ISO = "2026-05-04T09:00:00"

_STEPS = tuple(
    number * unit
    for unit, numbers in (
        (SECOND, (1, 2, 5, 10, 15, 30)),
        (60 * SECOND, (1, 2, 5, 10, 15, 30)),
        (3600 * SECOND, (1, 2, 3, 6, 12)),
        (DAY, (1, 2, 7, 14, 30, 90, 365, 3650)),
    )
    for number in numbers
)
"""The distances between two times of the axis, in nanoseconds."""

_LEVELS = "▁▂▃▄▅▆▇█"
_FOREVER = 1 << 62
_TRUE, _FALSE, _SCHEDULED, _RUNNING, _WANTED, _REACHED = "█", "░", "▒", "━", "─", "═"
_LEGEND = (
    f"{_TRUE} true  {_FALSE} explicitly false  {_SCHEDULED} ahead: scheduled or expected  {_RUNNING} action, × aborted"
)
_GOALS = f"  {_WANTED} wanted, {_REACHED} reached"


class TextTimeline:
    """Lanes of text, by group; groups that never change are counted on one line."""

    def __init__(self, data: dict[str, Any]) -> None:
        self._data = data
        self._belief: int = data["latest"] + 1 if data["as_of"] is None else data["as_of"]
        self._times = {number: t for number, t, *_ in data["transactions"]}
        self._edge: int = self._times.get(self._belief, data["now"] if self._belief > data["latest"] else 0)
        self._rows = _by_lane(data["rows"])
        self._expected = _by_lane(row for row in data["expected"] if row[3] == self._belief)
        self._cut = min((row[1] for rows in self._expected.values() for row in rows), default=_FOREVER)
        self._runs = _by_lane(data["runs"])
        self._reached = dict(data["reached"])
        self._ends = self._ends_of_objects()

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        width = min(options.max_width, WIDEST)
        numbers = [self._data["groups"][group][0] == "number" for group, _, _ in self._data["lanes"]]
        labels = [
            f"{self._label(lane)} {self._range(lane)}" if is_number else self._label(lane)
            for lane, is_number in enumerate(numbers)
        ]
        margin = min(max([len(label) for label in labels] + [12]) + 4, width // 2)
        columns = max(width - margin - 1, 8)
        yield from self._head(margin, columns)
        lanes = defaultdict(list)
        for number, (group, _, _) in enumerate(self._data["lanes"]):
            lanes[group].append(number)
        groups = sorted(enumerate(self._data["groups"]), key=lambda item: KINDS.index(item[1][0]))
        fixed = []
        for group, (kind, name) in groups:
            members = lanes[group]
            if kind == "object" or (kind in ("fact", "number", "other") and all(map(self._is_fixed, members))):
                fixed += [f"{name} ({len(members)})"] if members else []
                continue
            if members:
                yield Text(name, TITLE)
            for lane in members:
                line = Text(f"  {_shortened(labels[lane], margin - 4)}".ljust(margin))
                yield line.append_text(self._drawn(lane, kind, columns))
        if fixed:
            yield Text(f"unchanged: {', '.join(fixed)}", DIM)
        yield Text(_LEGEND + (_GOALS if self._reached else ""), DIM)

    def _head(self, margin: int, columns: int) -> Iterator[Text]:
        """Yield the knowledge base, the belief and the span, and where in it transactions and now are."""
        data, origin = self._data, int(self._data["origin"])
        text = Text(data["name"], TITLE).append(
            f" from {isoformat(origin)} until {isoformat(origin + data['until'])}", "not bold"
        )
        believed = "" if self._belief > data["latest"] else f", as of transaction {self._belief}"
        yield text.append(f"{believed}; a column is {_seconds(data['until'] / columns)}", DIM)
        marks = ["·"] * columns
        for t in self._times.values():
            if 0 <= t <= data["until"]:
                marks[self._column(t, columns)] = "╷"
        if 0 <= self._edge <= data["until"]:
            marks[self._column(self._edge, columns)] = "▼"
        yield Text(" " * margin + axis(origin, data["until"], columns), DIM)
        label = plural(len(self._times), "transaction")
        yield Text(label[: margin - 1].ljust(margin) + "".join(marks), DIM)

    def _label(self, lane: int) -> str:
        group, label, _ = self._data["lanes"][lane]
        return str(label or self._data["groups"][group][1])

    def _range(self, lane: int) -> str:
        """Return the lowest and the highest value of a number within the span."""
        found = []
        for start, end, row in self.pieces(lane):
            if start <= self._data["until"] and end > 0:
                first, last = max(start, 0), min(end, self._data["until"])
                found += [_value(row, first), _value(row, last)]
        low, high = f"{min(found, default=0):.4g}", f"{max(found, default=0):.4g}"
        return low if low == high else f"{low}..{high}"

    def _column(self, t: float, columns: int) -> int:
        return max(0, min(columns - 1, int(t * columns // max(self._data["until"], 1))))

    # -- what holds -------------------------------------------------------------------------------------------

    def _is_known(self, row: Row) -> bool:
        return row[3] <= self._belief and not 0 < row[4] <= self._belief

    def _believed(self, row: Row) -> Row:
        """Return a row; a number that is still ahead has the rate that was recorded."""
        return [*row[:8], row[9]] if len(row) > 9 and row[1] > self._edge else row

    def _is_fixed(self, lane: int) -> bool:
        rows = self._rows[lane]
        begin = min(self._times.values(), default=0)
        return not self._expected[lane] and all(row[1] <= begin and row[2] is None and row[8] == 0 for row in rows)

    def _ends_of_objects(self) -> dict[str, list[int]]:
        """Return the times at which objects end, by the object's key."""
        found = {}
        for lane, (group, label, _) in enumerate(self._data["lanes"]):
            if self._data["groups"][group][0] == "object":
                ends = [row[1] for row in self._rows[lane] if row[7] == 0 and self._is_known(row)]
                found[key(label)] = sorted(ends)
        return found

    def pieces(self, lane: int) -> list[Piece]:
        """Return the pieces of a lane: begin, end and row, in order (rules V1, C9, Q2)."""
        rows = sorted(
            (self._believed(row) for row in self._rows[lane] if self._is_known(row) and row[1] < self._cut),
            key=lambda row: (row[1], row[3]),
        )
        rows += self._expected[lane]
        objects = (
            [] if self._data["groups"][self._data["lanes"][lane][0]][0] == "object" else self._data["lanes"][lane][2]
        )
        found = []
        for row, following in zip(rows, [*rows[1:], None], strict=False):
            end = _FOREVER if following is None else following[1]
            if 0 < row[5] <= self._belief:
                end = min(end, row[2])
            for name in objects:
                ends = self._ends.get(name, [])
                end = min([end, *ends[(place := bisect_right(ends, row[1])) : place + 1]])
            if end > row[1] and row[7] is not None:
                found.append((row[1], end, row))
        return found

    # -- drawing ----------------------------------------------------------------------------------------------

    def _drawn(self, lane: int, kind: str, columns: int) -> Text:
        if kind == "number":
            return self._numbers(self.pieces(lane), columns)
        cells: list[tuple[str, str]] = [(" ", "")] * columns
        if kind == "run":
            for _, start, expected, ended, outcome, by, ended_by, _ in self._runs[lane]:
                if by <= self._belief:
                    is_over = 0 < ended_by <= self._belief
                    end = ended if is_over else max(expected, self._edge)
                    self._fill(cells, start, end, (_RUNNING, NUMBER))
                    if is_over and outcome == "aborted":
                        cells[self._column(end - 1, columns)] = ("×", FALSE)
            return Text.assemble(*cells)
        for start, end, row in self.pieces(lane):
            held = (_WANTED, DIM) if kind == "goal" else (_FALSE, FALSE) if row[7] == 0 else (_TRUE, NUMBER)
            self._fill(cells, start, min(end, max(self._edge, start)), held)
            if end > self._edge:
                ahead = (_SCHEDULED, SCHEDULED) if kind != "goal" and row[7] else held
                self._fill(cells, max(start, self._edge), end, ahead)
        for start, end in self._reached.get(lane, []):
            self._fill(cells, start, self._data["now"] if end is None else end, (_REACHED, NUMBER))
        return Text.assemble(*cells)

    def _fill(self, cells: list[tuple[str, str]], start: int, end: int, cell: tuple[str, str]) -> None:
        """Put a sign into each column that ``[start, end)`` overlaps, and at least into one."""
        if start > self._data["until"] or end < 0 or end <= start:
            return
        first = self._column(start, len(cells))
        last = max(first, self._column(end - 1, len(cells)))
        cells[first : last + 1] = [cell] * (last + 1 - first)

    def _numbers(self, pieces: Sequence[Piece], columns: int) -> Text:
        """Draw the value in the middle of each column, between the lowest and the highest one."""
        values: list[float | None] = []
        for column in range(columns):
            t = int((column + 0.5) * self._data["until"] / columns)
            place = bisect_right(pieces, t, key=lambda piece: piece[0]) - 1
            values.append(_value(pieces[place][2], t) if place >= 0 and t < pieces[place][1] else None)
        known = [value for value in values if value is not None]
        low, room = min(known, default=0.0), max(known, default=0.0) - min(known, default=0.0)
        steps = len(_LEVELS) - 1
        signs = [
            " " if value is None else _LEVELS[round((value - low) / room * steps) if room else 0] for value in values
        ]
        return Text("".join(signs), NUMBER)


def axis(origin: int, length: int, columns: int) -> str:
    """Return round times of the day, or dates if they are days apart, each beginning in its column.

    >>> axis(1_777_885_080 * 10**9, 17 * 60 * 10**9, 40)
    '    09:00       09:05       09:10'
    """
    step, shown = next(
        (found for found in map(_step, _STEPS) if found[0] * columns >= (len(_ISO[found[1]]) + 2) * length),
        _step(_STEPS[-1]),
    )
    line = ""
    for t in range(-(-origin // step) * step, origin + length + 1, step):
        place, text = (t - origin) * columns // max(length, 1), isoformat(t)[shown]
        if place >= len(line) + bool(line) and place + len(text) <= columns:
            line = line.ljust(place) + text
    return line


def _step(step: int) -> tuple[int, slice]:
    """Return a step, and the part of ISO times to show at such steps."""
    return step, slice(0, 10) if step >= DAY else slice(11, 16) if step >= 60 * SECOND else slice(11, 19)


def _shortened(text: str, longest: int) -> str:
    """Cut the middle out of a text that is too long: lanes differ at the ends of their labels."""
    if len(text) <= longest:
        return text
    begin = (longest - 1) // 2
    return f"{text[:begin]}…{text[len(text) - (longest - 1 - begin) :]}"


def _by_lane(rows: Any) -> defaultdict[int, list[Row]]:
    found: defaultdict[int, list[Row]] = defaultdict(list)
    for row in rows:
        found[row[0]].append(row)
    return found


def _value(row: Row, t: int) -> float:
    return moved(row[7], row[8], t - row[1])


def _seconds(ns: float) -> str:
    return f"{ns / SECOND:.3g} s"
